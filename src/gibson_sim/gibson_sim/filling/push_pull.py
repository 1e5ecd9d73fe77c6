"""Fills holes of an image from the pixels around them, by a pyramid: *push-pull* (Gortler et al., The Lumigraph, 1996, section 3.4).

Pull: each level is the weighted mean of the finer one under the 5x5 binomial kernel, at half the size, until all pixels are known. Weights
are multiplied by four and saturate at 1: a quarter of the kernel's pixels makes a pixel known. Push: from the coarsest level on, each level is
blended over the interpolated coarser one by its weights. The smooth kernel and weights keep filled pixels steady when the camera moves.
Known pixels do not change.
"""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
F32 = NDArray[np.float32]
Value = TypeVar("Value", np.uint8, np.float32)

_SATURATION = np.float32(4.0)
"""Factor on the weights from level to level, before they saturate at 1."""
_TINY = np.float32(1e-20)


def push_pull(values: NDArray[Value], hole: Bools, known: Bools | None = None) -> NDArray[Value]:
    """Returns a copy of an image with its holes filled; an unchanged copy if no pixel is known.

    Args:
        values: (H, W) or (H, W, C), uint8 or float32, finite where known.
        hole: (H, W), the pixels to fill.
        known: (H, W), the pixels to fill them from, none of them in a hole; None = all others.
    """
    known = ~hole if known is None else known
    out = values.copy()
    if not hole.any() or not known.any():
        return out
    filled = _filled(values, known)[hole]
    out[hole] = np.rint(filled) if values.dtype == np.uint8 else filled
    return out


def push_pull_depth(depth: F32, hole: Bools, known: Bools | None = None) -> F32:
    """Returns a copy of a depth image with its holes filled; planes stay planes, since inverse depth is linear in the image of a plane.

    Args:
        depth: (H, W), metres, above 0, +inf or NaN = nothing.
        hole: (H, W), the pixels to fill.
        known: (H, W), the pixels to fill them from, as far as they have a depth, none of them in a hole; None = all others.
    """
    known = (~hole if known is None else known) & np.isfinite(depth)
    inverse = np.zeros_like(depth)
    np.divide(np.float32(1.0), depth, out=inverse, where=known)
    inverse = push_pull(inverse, hole, known)
    out = depth.copy()
    np.divide(np.float32(1.0), inverse, out=out, where=hole & (inverse > 0.0))
    return out


def _filled(values: NDArray[Value], known: Bools) -> F32:
    """Returns an image, float32, with all unknown pixels filled; at least one pixel must be known."""
    weight = known.astype(np.float32)
    levels = [(_masked(values, known), weight)]
    while levels[-1][1].min() < 1.0 and levels[-1][1].size > 1:
        levels.append(_pull(*levels[-1]))
    weighted, weight = levels[-1]
    out = np.asarray(weighted / np.maximum(_per_channel(weight, weighted), _TINY), dtype=np.float32)
    for weighted, weight in levels[-2::-1]:
        height, width = weight.shape
        coarser = np.asarray(cv2.pyrUp(out), dtype=np.float32)[:height, :width]
        out = weighted + (np.float32(1.0) - _per_channel(weight, weighted)) * coarser
    return out


def _masked(values: NDArray[Value], known: Bools) -> F32:
    """Returns an image as float32, 0 where it is unknown."""
    out = np.zeros(values.shape, dtype=np.float32)
    return np.asarray(cv2.copyTo(np.asarray(values, dtype=np.float32), known.astype(np.uint8), out))


def _pull(weighted: F32, weight: F32) -> tuple[F32, F32]:
    """Returns the next coarser level, half the size rounded up: the image multiplied by its weights, and the weights, 0 to 1."""
    height, width = weight.shape

    def halved(image: F32) -> F32:
        even = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_CONSTANT)
        return np.asarray(cv2.pyrDown(even), dtype=np.float32)

    sums, share = halved(weighted), halved(weight)
    new = np.minimum(_SATURATION * share, np.float32(1.0))
    return sums * _per_channel(new / np.maximum(share, _TINY), sums), new


def _per_channel(weight: F32, image: F32) -> F32:
    """Returns weights (H, W) in a shape that multiplies an image (H, W) or (H, W, C)."""
    return weight if image.ndim == 2 else weight[:, :, None]
