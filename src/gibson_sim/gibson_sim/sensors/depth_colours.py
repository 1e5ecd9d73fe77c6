"""Depth images in false colours, for videos, live pages and documents. Pure."""

from __future__ import annotations

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
