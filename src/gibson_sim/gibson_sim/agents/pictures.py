"""PNGs of camera images for an agent. Pure."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.sensors.false_colours import DEPTH_RANGE_M, colourise_depth


def picture(pixels: NDArray[Any], width: int) -> tuple[bytes, dict[str, Any]]:
    """Returns an image as a PNG of at most ``width`` pixels, and its description.

    Args:
        pixels: (H, W, 3) uint8 RGB, or (H, W) float32 depth, m; infinite and NaN = no depth.
        width: greatest width, px.
    """
    found: dict[str, Any] = {}
    if pixels.ndim == 2:
        found = _distances(pixels)
        bgr: NDArray[np.uint8] = colourise_depth(pixels)
    else:
        bgr = np.ascontiguousarray(pixels[:, :, ::-1])
    height = max(1, round(bgr.shape[0] * width / bgr.shape[1]))
    if width < bgr.shape[1]:
        # Interpolated false colours would be wrong depths.
        bgr = np.asarray(
            cv2.resize(bgr, (width, height), interpolation=cv2.INTER_NEAREST if pixels.ndim == 2 else cv2.INTER_AREA)
        )
    encoded, data = cv2.imencode(".png", bgr)
    assert encoded
    return data.tobytes(), {"width": bgr.shape[1], "height": bgr.shape[0], **found}


def _distances(depth_m: NDArray[Any]) -> dict[str, Any]:
    """Returns the nearest, farthest and median depths, and the median of the middle of the image, m."""
    rows, columns = depth_m.shape
    middle = depth_m[rows * 2 // 5 : rows * 3 // 5 + 1, columns * 2 // 5 : columns * 3 // 5 + 1]
    scale = f"red 0 m to blue {DEPTH_RANGE_M:g} m and beyond, black = no depth"
    valid = depth_m[np.isfinite(depth_m) & (depth_m > 0)]
    if not valid.size:
        return {"scale": scale, "depth": "none"}
    in_middle = middle[np.isfinite(middle) & (middle > 0)]
    return {
        "scale": scale,
        "nearest_m": round(float(valid.min()), 3),
        "median_m": round(float(np.median(valid)), 3),
        "farthest_m": round(float(valid.max()), 3),
        "middle_m": round(float(np.median(in_middle)), 3) if in_middle.size else None,
    }
