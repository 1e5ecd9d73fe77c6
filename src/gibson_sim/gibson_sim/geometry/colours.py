"""Conversion between sRGB and linear light (IEC 61966-2-1). Imports only NumPy, because Blender's Python imports this module too.

Values are 0 to 1; values outside are clipped. Arrays of float32 are computed and returned in float32, all others in float64.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Luminance weights of linear red, green and blue (ITU-R BT.709)."""


def linear_from_srgb(values: ArrayLike) -> NDArray[Any]:
    """Converts sRGB values to linear values of the same shape; NaN is kept."""
    srgb = np.clip(_floats(values), 0.0, 1.0)
    return np.asarray(np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4), dtype=srgb.dtype)


def srgb_from_linear(values: ArrayLike) -> NDArray[Any]:
    """Converts linear values to sRGB values of the same shape; NaN is kept."""
    return _encode(np.clip(_floats(values), 0.0, 1.0))


def srgb8_from_linear(values: ArrayLike) -> NDArray[np.uint8]:
    """Converts linear values to sRGB values, 0 to 255, of the same shape; NaN becomes 0."""
    # fmax ignores NaN.
    srgb = _encode(np.minimum(np.fmax(_floats(values), 0.0), 1.0))
    srgb *= 255.0
    return np.asarray(np.rint(srgb, out=srgb), dtype=np.uint8)


def linear16_from_srgb8(colors: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Converts sRGB values, 0 to 255, to linear values, 0 to 65535, of the same shape."""
    return _LINEAR16[colors]


def _floats(values: ArrayLike) -> NDArray[Any]:
    array = np.asarray(values)
    return array if array.dtype == np.float32 else array.astype(np.float64, copy=False)


def _encode(linear: NDArray[Any]) -> NDArray[Any]:
    # In place: images are large, and allocating memory takes as long as the arithmetic.
    curve = linear ** (1 / 2.4)
    curve *= 1.055
    curve -= 0.055
    return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, curve), dtype=linear.dtype)


_LINEAR16 = np.rint(65535.0 * linear_from_srgb(np.arange(256) / 255.0)).astype(np.uint16)
