"""Similarity of adapted images to the simulator's: PSNR and SSIM, over the pairs of shards."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim_learn.goggles.pairs import U8, Pairs

_SSIM_PX = 1.5
"""Standard deviation of the Gaussian window of SSIM, pixels (Wang et al., IEEE TIP 2004)."""
_C1, _C2 = (0.01 * 255.0) ** 2, (0.03 * 255.0) ** 2
_LUMA = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True, slots=True)
class Score:
    """Similarity of images to those of the simulator."""

    psnr: float
    """Mean PSNR of the images over all three channels, dB."""
    ssim: float
    """Mean structural similarity of the luma, -1 to 1."""
    images: int

    def __str__(self) -> str:
        return f"{self.psnr:.2f} dB, SSIM {self.ssim:.3f}"


def score(pairs: Sequence[Pairs], adapt: Callable[[U8], U8], every: int = 1) -> Score:
    """Returns the similarity of adapted images to the simulator's.

    Args:
        pairs: shards.
        adapt: takes a camera's image, (H, W, 3) sRGB, and returns the adapted image.
        every: stride of the views that are scored.
    """
    found = []
    for part in pairs:
        for k in range(0, len(part.clean), every):
            for seen in part.seen[k]:
                image = adapt(np.ascontiguousarray(seen))
                found.append((psnr(image, part.clean[k]), ssim(image, part.clean[k])))
    means = np.mean(found, axis=0)
    return Score(float(means[0]), float(means[1]), len(found))


def mean_of(scores: Sequence[Score]) -> Score:
    """Returns the mean over all images of some scores."""
    images = [one.images for one in scores]

    def mean(values: list[float]) -> float:
        return float(np.average(values, weights=images))

    return Score(mean([one.psnr for one in scores]), mean([one.ssim for one in scores]), sum(images))


def psnr(a: U8, b: U8) -> float:
    """Returns the peak signal-to-noise ratio of two images, dB; at most 60, so that the mean stays finite with equal images."""
    error = float(((a.astype(np.float64) - b) ** 2).mean())
    return min(60.0, 10.0 * math.log10(255.0**2 / max(error, 1e-9)))


def ssim(a: U8, b: U8) -> float:
    """Returns the mean structural similarity of the luma of two images, -1 to 1."""
    x, y = (image @ _LUMA for image in (a, b))

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(ndimage.gaussian_filter(values, _SSIM_PX, mode="reflect"))

    mx, my = mean(x), mean(y)
    xx, yy, xy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    return float(((2 * mx * my + _C1) * (2 * xy + _C2) / ((mx * mx + my * my + _C1) * (xx + yy + _C2))).mean())
