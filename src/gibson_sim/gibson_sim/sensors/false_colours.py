"""Depth and label images in false colours, for videos, live pages and documents. Pure."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

DEPTH_RANGE_M = 8.0
"""Depth from which the coldest colour is shown, metres; 0 m has the warmest."""


def colourise_depth(depth_m: NDArray[np.floating[Any]], far_m: float = DEPTH_RANGE_M) -> NDArray[np.uint8]:
    """Returns depth in false colours, (H, W, 3) uint8 BGR: red is near, blue is ``far_m`` and beyond, black is no depth.

    Args:
        depth_m: (H, W), metres; infinite, NaN and 0 = no depth.
        far_m: fixed end of the colour scale, metres, so that it is the same in all images.
    """
    something = np.isfinite(depth_m) & (depth_m > 0)
    near = 1.0 - np.clip(np.where(something, depth_m, 0.0) / far_m, 0.0, 1.0)
    colours = cv2.applyColorMap(np.rint(near * 255.0).astype(np.uint8), cv2.COLORMAP_TURBO)
    colours[~something] = 0
    return np.asarray(colours, dtype=np.uint8)


def colourise_labels(labels: NDArray[np.integer[Any]]) -> NDArray[np.uint8]:
    """Returns labels in false colours, (H, W, 3) uint8 BGR: black is 0; consecutive labels differ in hue by the golden ratio.

    Args:
        labels: (H, W), semantic or instance labels, 0 to 65535.
    """
    return np.asarray(_label_palette()[labels])


@lru_cache(maxsize=1)
def _label_palette() -> NDArray[np.uint8]:
    """Returns the colour of each label, (65536, 3) BGR. All at once: OpenCV rounds the last colours of an array differently."""
    number = np.arange(1 << 16)
    hsv = np.stack([number * 0.61803 % 1.0 * 180.0, 110 + number * 53 % 110, 170 + number * 37 % 80], axis=-1).astype(np.uint8)
    palette: NDArray[np.uint8] = cv2.cvtColor(hsv[None], cv2.COLOR_HSV2BGR)[0]
    palette[0] = 0
    return palette
