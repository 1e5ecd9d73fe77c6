"""Similarity of two images: peak signal-to-noise ratio (PSNR) and structural similarity (SSIM; Wang et al., IEEE TIP 2004). Pure."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

LUMA = np.array([0.299, 0.587, 0.114])
"""Weights of red, green and blue in luma (ITU-R BT.601)."""
_MAX_PSNR = 60.0
_WINDOW_PX = 1.5
"""Standard deviation of the Gaussian window of SSIM, pixels."""
_K1, _K2 = 0.01, 0.03
"""Stabilising constants of SSIM, relative to the dynamic range."""


def psnr(mean_squared_error: float, peak: float = 255.0) -> float:
    """Returns the peak signal-to-noise ratio, dB; at most 60, so that the mean over images stays finite if some are equal.

    Args:
        mean_squared_error: mean of the squared differences of all values.
        peak: dynamic range of the values.
    """
    return min(_MAX_PSNR, 10.0 * math.log10(peak**2 / max(mean_squared_error, 1e-9 * (peak / 255.0) ** 2)))


def ssim_map(a: NDArray[Any], b: NDArray[Any], peak: float = 255.0) -> NDArray[np.float64]:
    """Returns the structural similarity of the luma of two images at each pixel, (H, W), -1 to 1.

    Args:
        a: (H, W, 3), sRGB.
        b: the other image, of the same size.
        peak: dynamic range of the values.
    """
    x, y = (image @ LUMA for image in (a, b))
    c1, c2 = (_K1 * peak) ** 2, (_K2 * peak) ** 2

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), _WINDOW_PX, borderType=cv2.BORDER_REFLECT))

    mx, my = mean(x), mean(y)
    xx, yy, xy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    return np.asarray((2 * mx * my + c1) * (2 * xy + c2) / ((mx * mx + my * my + c1) * (xx + yy + c2)))
