"""Draws batches from shards: which images, mirrored or not, with what is true about them. numpy and OpenCV alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim_learn.path_following.data import (
    Shard,
    load_shard,
)
from gibson_sim_learn.path_following.drawing import HEIGHT, WIDTH

F32 = NDArray[np.float32]
_GAMMA = 1.35
"""Largest exponent of the contrast of an image, and the inverse of the smallest."""
_OTHER_COLOURS = 0.5
"""Probability that the colour channels of an image and of its recorded ones are in a drawn order: six scenes have few colours."""
_MIXED = 0.35
"""Largest share of each colour channel that is given to the others, in other colours."""
_UNEVEN = 0.45
"""Largest change of brightness across an image, in natural logarithms: light that falls from elsewhere."""
_NOISE = 4.0
"""Largest standard deviation of added noise, grey levels."""
_BLUR, _BLURRED = 0.9, 0.5
"""Largest standard deviation of another lens' blur, pixels, and the share of images that have it."""
_VIGNETTE = 0.4
"""Largest share of the light that another lens loses in the corners."""
_SHIFT = 1.0
"""Largest shift of an image up or down, pixels: 1.4 degrees of tilt."""
_BURNT = 0.35
"""Largest natural logarithm of a gain, after which bright parts are white."""


@dataclass(frozen=True, slots=True)
class Batch:
    """L later images, and R recorded ones for each."""

    later: NDArray[np.uint8]
    """(L, 64, 96, 3)."""
    recorded: NDArray[np.uint8]
    """(L, R, 64, 96, 3)."""
    pose: F32
    """(L, R, 3): the recorded camera in the frame of the later one, metres and radians."""
    match: NDArray[np.bool_]
    """(L, R): whether both show one place, so that ``pose`` can be seen."""
    free: F32
    """(L, 24): free distances in the later images, metres."""
    has_pairs: NDArray[np.bool_]
    """(L,): whether ``recorded`` belongs to the later image; False = it was drawn for its free distances alone."""
    earlier: NDArray[np.uint8]
    """(L, 64, 96, 3): what the camera of each later image saw a little earlier, under the same light; black where that is unknown."""
    earlier_pose: F32
    """(L, 3): where it was then, in its present frame: x ahead, y to the left, yaw; metres and radians."""


class Sampler:
    """All shards of a folder."""

    def __init__(self, shards: Sequence[Shard]) -> None:
        """Indexes the pairs by their later images.

        Raises:
            ConfigError: there is no data.
        """
        if not shards:
            raise ConfigError("there is no data to train on: draw some shards first")
        self._shards = tuple(shards)
        self._pairs: list[NDArray[Any]] = []
        self._first: list[NDArray[np.int64]] = []
        """By shard: (N + 1,), where the pairs of each image begin."""
        later: list[tuple[int, int]] = []
        for number, shard in enumerate(self._shards):
            pairs = np.sort(np.asarray(shard.pairs), order="later", kind="stable")
            self._pairs.append(pairs)
            self._first.append(np.searchsorted(pairs["later"], np.arange(len(shard.images) + 1)))
            later += [(number, row) for row in range(len(shard.images))]
        self._images = np.array(later)

    @classmethod
    def of_folders(cls, folders: Sequence[Path]) -> Sampler:
        """Returns a sampler of all shards in some folders, in the order of their names."""
        found = [
            shard for folder in folders if folder.is_dir() for shard in sorted(folder.iterdir()) if not shard.name.startswith(".")
        ]
        return cls([load_shard(path) for path in found])

    @property
    def image_count(self) -> int:
        """Number of images."""
        return len(self._images)

    @property
    def pair_count(self) -> int:
        """Number of pairs."""
        return sum(len(pairs) for pairs in self._pairs)

    def batch(self, rng: np.random.Generator, later: int, recorded: int, *, augment: bool = True) -> Batch:
        """Returns random images; equal generators give equal batches.

        Args:
            rng: random generator.
            later: number of later images.
            recorded: recorded images for each; 0 = the batch is drawn for its free distances alone.
            augment: mirror half of the images, and change colours, contrast and noise.
        """
        chosen = self._images[rng.integers(0, len(self._images), later)]
        images = np.empty((later, HEIGHT, WIDTH, 3), np.uint8)
        others = np.zeros((later, recorded, HEIGHT, WIDTH, 3), np.uint8)
        pose = np.zeros((later, recorded, 3), np.float32)
        match, has = np.zeros((later, recorded), bool), np.zeros(later, bool)
        free = np.empty((later, self._shards[0].free.shape[1]), np.float32)
        earlier, earlier_pose = np.zeros_like(images), np.zeros((later, 3), np.float32)
        for k, (number, row) in enumerate(chosen):
            shard, first = self._shards[number], self._first[number]
            images[k], free[k] = shard.images[row], shard.free[row]
            if shard.earlier is not None and shard.earlier_pose is not None:
                earlier[k], earlier_pose[k] = shard.earlier[row], shard.earlier_pose[row]
            pairs = self._pairs[number][first[row] : first[row + 1]]
            if not len(pairs):
                continue
            has[k] = True
            some = pairs[rng.choice(len(pairs), recorded, replace=len(pairs) < recorded)]
            others[k] = shard.images[some["recorded"]]
            pose[k] = np.stack([some["x"], some["y"], some["yaw"]], axis=-1)
            match[k] = some["match"]
        if augment:
            mirrored = rng.random(later) < 0.5
            for some in (images, earlier):
                some[mirrored] = some[mirrored, :, ::-1]
            others[mirrored] = others[mirrored, :, :, ::-1]
            pose[mirrored, :, 1:] *= -1.0
            earlier_pose[mirrored, 1:] *= -1.0
            free[mirrored] = free[mirrored, ::-1]
            order = rng.permuted(np.tile(np.arange(3), (later, 1)), axis=1)
            order[rng.random(later) >= _OTHER_COLOURS] = np.arange(3)
            images, earlier = (np.take_along_axis(some, order[:, None, None], axis=3) for some in (images, earlier))
            others = np.take_along_axis(others, order[:, None, None, None], axis=4)
            mix = rng.uniform(-_MIXED, _MIXED, (later, 3, 3)).astype(np.float32)
            mix[:, np.arange(3), np.arange(3)] = 0.0
            mix[rng.random(later) >= _OTHER_COLOURS] = 0.0
            mix += (1.0 - mix.sum(axis=2))[..., None] * np.eye(3, dtype=np.float32)  # grey stays grey
            images, earlier, others = (_mixed(some, mix) for some in (images, earlier, others))
            images, earlier = _other_contrast(images, rng, earlier)
            others = _other_contrast(others.reshape(-1, HEIGHT, WIDTH, 3), rng)[0].reshape(others.shape)
        return Batch(images, others, pose, match, free, has, earlier, earlier_pose)


def through_another_lens(
    images: NDArray[np.uint8], rng: np.random.Generator, earlier: NDArray[np.uint8] | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Returns images (N, H, W, 3) with a drawn blur, vignette, tilt, gain and grain of each; free distances in them stay what they are.

    Args:
        images: uint8.
        rng: random generator.
        earlier: (N, H, W, 3), by the same camera: they are returned with the same, but for grain; those that are black stay black. None = black.
    """
    count, height, width, _ = images.shape
    y, x = np.mgrid[-1.0 : 1.0 : height * 1j, -1.0 : 1.0 : width * 1j].astype(np.float32)
    corner = (x**2 + y**2)[..., None] / 2.0
    out = np.empty_like(images), np.zeros_like(images)
    for k in range(count):
        shift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, rng.uniform(-_SHIFT, _SHIFT)]])
        blur = rng.uniform(0.2, _BLUR) if rng.random() < _BLURRED else 0.0
        gain = math.exp(rng.uniform(-_BURNT, _BURNT)) * (1.0 - rng.uniform(0.0, _VIGNETTE) * corner)
        grain = rng.uniform(0.0, _NOISE)
        for row, some in enumerate(_taken_alike(images, earlier, k)):
            image = cv2.warpAffine(some, shift, (width, height), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            if blur:
                image = cv2.GaussianBlur(image, (0, 0), blur)
            lit = image.astype(np.float32) * gain + rng.standard_normal(image.shape, dtype=np.float32) * np.float32(grain)
            out[row][k] = np.clip(lit, 0.0, 255.0)
    return out


def _taken_alike(images: NDArray[np.uint8], earlier: NDArray[np.uint8] | None, k: int) -> list[NDArray[np.uint8]]:
    """Returns an image and, unless it is black, that is, unknown, its earlier one."""
    return [images[k]] if earlier is None or not earlier[k].any() else [images[k], earlier[k]]


def _mixed(images: NDArray[np.uint8], mix: F32) -> NDArray[np.uint8]:
    """Returns images (L, ..., H, W, 3) with their colours times matrices (L, 3, 3)."""
    out = images.copy()
    if not images.size:
        return out
    for k in np.flatnonzero(np.abs(mix - np.eye(3, dtype=np.float32)).max(axis=(1, 2)) > 1e-3):
        out[k] = cv2.transform(images[k].reshape(-1, 1, 3), mix[k]).reshape(images[k].shape)
    return out


def _other_contrast(
    images: NDArray[np.uint8], rng: np.random.Generator, earlier: NDArray[np.uint8] | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Returns images (N, H, W, 3) with a drawn exponent of their contrast, light that is uneven, and noise.

    Earlier ones are returned with the same, but for noise; those that are black stay black. None = black.
    """
    out = np.empty_like(images), np.zeros_like(images)
    levels = np.arange(256) / 255.0
    grain = rng.standard_normal((HEIGHT * WIDTH * 3 + 997,), dtype=np.float32)
    for k in range(len(images)):
        table = (255.0 * levels ** (_GAMMA ** rng.uniform(-1.0, 1.0))).astype(np.float32)
        start = int(rng.integers(997))
        amount = rng.uniform(0.0, _NOISE)
        light = rng.uniform(-1.0, 1.0, (3, 4)).astype(np.float32) * rng.uniform(0.0, _UNEVEN)
        bright = cv2.resize(np.exp(light), (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)[..., None]
        for row, some in enumerate(_taken_alike(images, earlier, k)):
            begin = (start + 499 * row) % 997
            noise = amount * grain[begin : begin + some.size].reshape(some.shape)
            out[row][k] = np.clip(table[some] * bright + noise, 0.0, 255.0)
    return out
