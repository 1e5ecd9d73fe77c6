"""How near filled images are to the truth: PSNR and SSIM in holes and where the scan is seen, GMSD, flicker.

GMSD, the deviation of the similarity of gradients (Xue, Zhang, Mou and Bovik, IEEE TIP 2014), stands for what people see: it falls with
blur and with edges that are not there. It needs no weights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

_SSIM_PX = 1.5
"""Standard deviation of the window of SSIM, pixels (Wang et al., IEEE TIP 2004)."""
_C1, _C2 = (0.01 * 255.0) ** 2, (0.03 * 255.0) ** 2
_GMSD_C = 170.0
"""Constant of GMSD for levels to 255."""
_LUMA = np.array([0.299, 0.587, 0.114])
_MOST_PSNR = 60.0
_NEARBY = 0.05
"""Depths that differ by a smaller share are of one surface."""


@dataclass(frozen=True, slots=True)
class Score:
    """How near images are to the truth."""

    hole_psnr: float
    """dB, of the mean squared error of all pixels in holes, of all images together."""
    seen_psnr: float
    """dB, of all other pixels."""
    hole_ssim: float
    """Mean of the map of SSIM in holes."""
    seen_ssim: float
    gmsd: float
    """Mean over the images; 0 = equal."""

    def __str__(self) -> str:
        return (
            f"holes {self.hole_psnr:.2f} dB, SSIM {self.hole_ssim:.3f}; seen {self.seen_psnr:.2f} dB, SSIM {self.seen_ssim:.3f}; "
            f"GMSD {self.gmsd:.3f}"
        )


class Scoring:
    """Gathers images."""

    def __init__(self) -> None:
        # Rows: in holes, where seen. Columns: pixels, squared error, SSIM.
        self._sums = np.zeros((2, 3))
        self._gmsd: list[float] = []

    def add(self, image: U8, truth: U8, hole: Bools) -> None:
        """Adds an image (H, W, 3), its truth, and where it has holes."""
        error = ((image.astype(np.float64) - truth) ** 2).mean(axis=2)
        alike = ssim_map(image, truth)
        for row, region in zip(self._sums, (hole, ~hole), strict=True):
            row += (region.sum(), error[region].sum(), alike[region].sum())
        self._gmsd.append(gmsd(image, truth))

    def score(self) -> Score:
        """Returns the score of all images so far, at least one; NaN for what they have no pixels of."""
        (hole_psnr, hole_ssim), (seen_psnr, seen_ssim) = (
            (_psnr(error / pixels), alike / pixels) if pixels else (math.nan, math.nan)
            for pixels, error, alike in self._sums.tolist()
        )
        return Score(hole_psnr, seen_psnr, hole_ssim, seen_ssim, float(np.mean(self._gmsd)))


def ssim_map(a: U8, b: U8) -> F64:
    """Returns the structural similarity of the luma of two images for each pixel, (H, W), -1 to 1."""
    x, y = (image @ _LUMA for image in (a, b))

    def mean(values: F64) -> F64:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), _SSIM_PX, borderType=cv2.BORDER_REFLECT))

    mx, my = mean(x), mean(y)
    xx, yy, xy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    return np.asarray((2 * mx * my + _C1) * (2 * xy + _C2) / ((mx * mx + my * my + _C1) * (xx + yy + _C2)))


def gmsd(a: U8, b: U8) -> float:
    """Returns the deviation of the similarity of gradients of two images, of even size; 0 = equal."""
    one, other = (_gradients(image) for image in (a, b))
    similar = (2.0 * one * other + _GMSD_C) / (one * one + other * other + _GMSD_C)
    return float(similar.std())


def warped(image: U8, T_world_camera: F64, matrix: F64, depth: F32, other_T: F64, other_depth: F32) -> tuple[U8, Bools]:
    """Returns another camera's image as seen by this camera, and where that is known: where both see the same surface.

    Args:
        image: (H, W, 3), of the other camera.
        T_world_camera: (4, 4), optical frame of this camera.
        matrix: K of both, (3, 3).
        depth: (H, W), true depth of this camera, metres.
        other_T: as ``T_world_camera``, of the other camera.
        other_depth: true depth of the other camera.
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
    """Returns the magnitudes of the gradients of half the image's luma."""
    luma = cv2.resize(image @ _LUMA, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)
    across = np.repeat([[1.0, 0.0, -1.0]], 3, axis=0) / 3.0
    x, y = (cv2.filter2D(luma, cv2.CV_64F, kernel, borderType=cv2.BORDER_REPLICATE) for kernel in (across, across.T))
    return np.asarray(np.sqrt(x * x + y * y))


def _psnr(error: float) -> float:
    return min(_MOST_PSNR, 10.0 * math.log10(255.0**2 / max(error, 1e-9)))
