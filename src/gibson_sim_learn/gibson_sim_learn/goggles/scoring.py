"""Similarity of adapted images to the simulator's: PSNR and SSIM, over the pairs of shards."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gibson_sim.sensors.image_similarity import psnr, ssim_map
from gibson_sim_learn.goggles.pairs import U8, Pairs


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
                error = ((image.astype(np.float64) - part.clean[k]) ** 2).mean()
                found.append((psnr(float(error)), ssim_map(image, part.clean[k]).mean()))
    means = np.mean(found, axis=0)
    return Score(float(means[0]), float(means[1]), len(found))


def mean_of(scores: Sequence[Score]) -> Score:
    """Returns the mean over all images of some scores."""
    images = [one.images for one in scores]

    def mean(values: list[float]) -> float:
        return float(np.average(values, weights=images))

    return Score(mean([one.psnr for one in scores]), mean([one.ssim for one in scores]), sum(images))
