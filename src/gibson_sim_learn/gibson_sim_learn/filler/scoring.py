"""Similarity of filled images to the ground truth: PSNR and SSIM in holes and outside, GMSD, and the warping for flicker.

GMSD, the gradient magnitude similarity deviation (Xue, Zhang, Mou and Bovik, IEEE TIP 2014), is a perceptual metric: it penalises blur and
invented edges. It needs no trained weights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.sensors.image_similarity import LUMA, psnr, ssim_map

Bools = NDArray[np.bool_]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

_GMSD_C = 170.0
"""Constant of GMSD for levels from 0 to 255."""
_NEARBY = 0.05
"""Relative depth difference up to which two pixels show the same surface."""


@dataclass(frozen=True, slots=True)
class Score:
    """Similarity of images to the ground truth."""

    hole_psnr: float
    """PSNR of the mean squared error over all pixels in holes of all images, dB."""
    seen_psnr: float
    """The same over all other pixels, dB."""
    hole_ssim: float
    """Mean of the SSIM map in holes."""
    seen_ssim: float
    gmsd: float
    """Mean over the images; 0 = equal."""

    def __str__(self) -> str:
        return (
            f"holes {self.hole_psnr:.2f} dB, SSIM {self.hole_ssim:.3f}; seen {self.seen_psnr:.2f} dB, SSIM {self.seen_ssim:.3f}; "
            f"GMSD {self.gmsd:.3f}"
        )


class Scoring:
    """Accumulates the scores of images."""

    def __init__(self) -> None:
        # Rows: in holes, outside. Columns: number of pixels, sum of squared error, sum of SSIM.
        self._sums = np.zeros((2, 3))
        self._gmsd: list[float] = []

    def add(self, image: U8, truth: U8, hole: Bools) -> None:
        """Adds an image (H, W, 3) with its ground truth and its hole mask (H, W)."""
        error = ((image.astype(np.float64) - truth) ** 2).mean(axis=2)
        alike = ssim_map(image, truth)
        for row, region in zip(self._sums, (hole, ~hole), strict=True):
            row += (region.sum(), error[region].sum(), alike[region].sum())
        self._gmsd.append(gmsd(image, truth))

    def score(self) -> Score:
        """Returns the score of all images so far, at least one; NaN for metrics without any pixel."""
        (hole_psnr, hole_ssim), (seen_psnr, seen_ssim) = (
            (psnr(error / pixels), alike / pixels) if pixels else (math.nan, math.nan)
            for pixels, error, alike in self._sums.tolist()
        )
        return Score(hole_psnr, seen_psnr, hole_ssim, seen_ssim, float(np.mean(self._gmsd)))


def gmsd(a: U8, b: U8) -> float:
    """Returns the gradient magnitude similarity deviation of two images of even size; 0 = equal."""
    one, other = (_gradients(image) for image in (a, b))
    similar = (2.0 * one * other + _GMSD_C) / (one * one + other * other + _GMSD_C)
    return float(similar.std())


def warped(image: U8, T_world_camera: F64, matrix: F64, depth: F32, other_T: F64, other_depth: F32) -> tuple[U8, Bools]:
    """Returns another camera's image, warped to this camera, and a mask (H, W) of the pixels at which both see the same surface.

    Args:
        image: (H, W, 3), image of the other camera.
        T_world_camera: (4, 4), pose of this camera's optical frame.
        matrix: K of both cameras, (3, 3).
        depth: (H, W), true depth of this camera, metres.
        other_T: (4, 4), pose of the other camera's optical frame.
        other_depth: (H, W), true depth of the other camera, metres.
    """
    height, width = depth.shape
    v, u = np.indices(depth.shape, dtype=np.float64)
    finite = np.isfinite(depth)
    z = np.where(finite, depth, 1.0).astype(np.float64)
    rays = np.linalg.inv(matrix) @ np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    points = np.linalg.inv(other_T) @ T_world_camera @ np.vstack([rays * z.ravel(), np.ones(u.size)])
    there = points[2].reshape(depth.shape)
    projected = matrix @ points[:3]
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = (np.nan_to_num(projected[k] / projected[2], nan=-1.0).reshape(depth.shape).astype(np.float32) for k in (0, 1))
    inside = finite & (there > 0.0) & (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    seen = cv2.remap(np.where(np.isfinite(other_depth), other_depth, 0.0).astype(np.float32), x, y, cv2.INTER_NEAREST)
    known = inside & (np.abs(seen - there) <= _NEARBY * there)
    return np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR), dtype=np.uint8), np.asarray(known)


def _gradients(image: U8) -> F64:
    """Returns the gradient magnitudes of the image's luma at half resolution."""
    luma = cv2.resize(image @ LUMA, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)
    across = np.repeat([[1.0, 0.0, -1.0]], 3, axis=0) / 3.0
    x, y = (cv2.filter2D(luma, cv2.CV_64F, kernel, borderType=cv2.BORDER_REPLICATE) for kernel in (across, across.T))
    return np.asarray(np.sqrt(x * x + y * y))
