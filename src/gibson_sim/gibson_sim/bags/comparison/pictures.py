"""Statistics of images: brightness, contrast, sharpness, noise, colour. Pure.

The noise mask is that of J. Immerkaer, "Fast noise variance estimation", Computer Vision and Image Understanding 64 (2), 1996; sharpness is
the variance of the Laplacian (Pech-Pacheco et al., "Diatom autofocusing in brightfield microscopy", ICPR 2000).
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.comparison.recorded_drive import F64
from gibson_sim.geometry.colours import linear_from_srgb

STATISTICS = ("brightness", "contrast", "sharpness", "noise", "red", "green", "blue", "saturation")
"""Columns of ``Pictures.statistics``, 0 to 1 except sharpness."""
BINS = 64
"""Bins of a histogram of luma."""
LUMA = (0.299, 0.587, 0.114)
"""Weights of red, green and blue (ITU-R BT.601)."""
THUMBNAIL_WIDTH = 240
"""Width of thumbnails, pixels."""
_NOISE_MASK = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])


def picture_statistics(rgb: NDArray[np.uint8]) -> tuple[F64, F64]:
    """Returns ``STATISTICS``, (8,), and the histogram of luma, (64,), sum 1.

    Args:
        rgb: (height, width, 3), at least 3 x 3 pixels.
    """
    luma = rgb @ np.array(LUMA) / 255.0
    colours = rgb.reshape(-1, 3).mean(axis=0) / 255.0
    largest = rgb.max(axis=2).astype(np.float64)
    saturation = np.mean((largest - rgb.min(axis=2)) / np.maximum(largest, 1.0))
    sharpness = float(np.var(cv2.Laplacian(luma, cv2.CV_64F)[1:-1, 1:-1]))
    values = [float(luma.mean()), float(luma.std()), sharpness, noise_of(luma), *colours, float(saturation)]
    histogram = np.histogram(luma, bins=BINS, range=(0.0, 1.0))[0] / luma.size
    return np.array(values, dtype=np.float64), histogram


def noise_of(luma: F64) -> float:
    """Returns the standard deviation of pixel-wise independent noise, in the unit of ``luma`` (height, width)."""
    inner = cv2.filter2D(luma, cv2.CV_64F, _NOISE_MASK)[1:-1, 1:-1]
    # Edges respond too, but hardly change the median, since noise affects all pixels.
    return float(np.median(np.abs(inner))) / 0.6745 / 6.0


def histogram_distance(a: F64, b: F64) -> float:
    """Returns the earth mover's distance of two histograms of luma, (64,), 0 (equal) to 1 (black against white)."""
    return float(np.abs(np.cumsum(a - b))[:-1].sum() / (BINS - 1))


def exposure_stops(real: float, sim: float) -> float:
    """Returns the additional exposure, in stops, that makes the simulated images as bright as the real ones; means are sRGB, 0 to 1."""
    linear = np.maximum(linear_from_srgb([real, sim]), 1e-4)
    return math.log2(linear[0] / linear[1])


def thumbnail(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns a small copy, 240 pixels wide."""
    height, width = rgb.shape[:2]
    size = (THUMBNAIL_WIDTH, max(1, round(height * THUMBNAIL_WIDTH / width)))
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
