"""Light maps: images of the light on surfaces, which multiplies their base colour (glTF extension ``GIBSON_light_map``).

A light map is an RGB PNG of 16 bits a channel. Its values are square roots of radiances, so that dark and bright surfaces have steps of
about the same visibility: a white diffuse surface has the radiance ``intensity * (value / 65535) ** 2``, linear light, with exposure and
white balance applied. This module converts between pixels and radiances; ``gltf`` reads the extension, ``textures`` decodes the image.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import MeshError

EXTENSION = "GIBSON_light_map"
"""Name of the glTF extension of a material: ``index`` and ``texCoord`` as in a textureInfo, and ``intensity``."""
WHITE = 65535
"""Largest value of a pixel, whose radiance is the intensity."""


def light_map_png(radiance: ArrayLike, intensity: float) -> bytes:
    """Returns a light map as a PNG file.

    Args:
        radiance: radiances of white diffuse surfaces, linear, (H, W, 3); clipped to 0 and ``intensity``.
        intensity: the largest radiance, above 0.

    Raises:
        MeshError: the intensity is not above 0, or the image cannot be encoded.
    """
    if not intensity > 0.0:
        raise MeshError(f"intensity of a light map is {intensity}, must be above 0")
    share = np.clip(np.nan_to_num(np.asarray(radiance, dtype=np.float64)) / intensity, 0.0, 1.0)
    return encoded_light_map(np.rint(np.sqrt(share) * WHITE).astype(np.uint16))


def encoded_light_map(pixels: NDArray[np.uint16]) -> bytes:
    """Returns the pixels of a light map, (H, W, 3) uint16, as a PNG file.

    Raises:
        MeshError: the image cannot be encoded.
    """
    ok, data = cv2.imencode(".png", pixels[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not ok:
        raise MeshError(f"a light map of {pixels.shape[1]} x {pixels.shape[0]} pixels cannot be written as PNG")
    return bytes(data)


def light_map_extensions(texture: int, intensity: float) -> dict[str, Any]:
    """Returns the ``extensions`` of a glTF material with a light map in TEXCOORD_1; viewers that ignore it draw the base colour.

    Args:
        texture: index of the texture in the file.
        intensity: the largest radiance, at least 0.
    """
    light: Mapping[str, Any] = {"index": texture, "texCoord": 1, "intensity": float(intensity)}
    return {"KHR_materials_unlit": {}, EXTENSION: light}


def radiance_of(pixels: NDArray[np.uint16], intensity: float) -> NDArray[np.float32]:
    """Returns the radiances of white diffuse surfaces, linear, of pixels, (..., 3)."""
    root = pixels.astype(np.float32) / np.float32(WHITE)
    return np.asarray(root * root * np.float32(intensity), dtype=np.float32)
