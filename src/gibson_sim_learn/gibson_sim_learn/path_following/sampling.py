"""Draws augmented batches from shards. NumPy and OpenCV alone."""

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
"""Largest gamma of an image, and the inverse of the smallest."""
_COLOUR_CHANCE = 0.5
"""Probability that the colour channels of an image and of its recorded ones are permuted: six scenes have few colours."""
_MAX_MIX = 0.35
"""Largest share of a colour channel that is mixed into another one."""
_MAX_UNEVENNESS = 0.45
"""Largest natural logarithm of the brightness change across an image."""
_MAX_NOISE = 4.0
"""Largest standard deviation of added noise, grey levels."""
_MAX_BLUR, _BLUR_CHANCE = 0.9, 0.5
"""Largest standard deviation of the blur of a lens, pixels, and the probability of a blur."""
_MAX_VIGNETTE = 0.4
"""Largest loss of light in the corners, 0 to 1."""
_MAX_SHIFT = 1.0
"""Largest vertical shift of an image, pixels: 1.4 degrees of pitch."""
_MAX_LOG_GAIN = 0.35
"""Largest natural logarithm of a gain; bright parts saturate."""


@dataclass(frozen=True, slots=True)
class Batch:
    """L later images, and R recorded ones for each."""

    later: NDArray[np.uint8]
    """(L, 64, 96, 3), RGB."""
    recorded: NDArray[np.uint8]
    """(L, R, 64, 96, 3), RGB."""
    pose: F32
    """(L, R, 3), float32: poses of the recorded cameras in the later camera's frame: x ahead, y to the left, yaw; metres and radians."""
    match: NDArray[np.bool_]
    """(L, R): whether both show the same place, so that ``pose`` can be estimated."""
    free: F32
    """(L, 24), float32: free distances in the later images, metres, leftmost bearing first."""
    has_pairs: NDArray[np.bool_]
    """(L,): whether the later image has recorded ones; False = it has free distances alone."""
    earlier: NDArray[np.uint8]
    """(L, 64, 96, 3), RGB: earlier image of the camera of each later one, in the same light; black = there is none."""
    earlier_pose: F32
    """(L, 3), float32: pose of the earlier camera in the present one's frame: x ahead, y to the left, yaw; metres and radians."""


class Sampler:
    """Draws from the shards of some folders."""

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
        """(N + 1,) of each shard: row of the first pair of each image."""
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
            order[rng.random(later) >= _COLOUR_CHANCE] = np.arange(3)
            images, earlier = (np.take_along_axis(some, order[:, None, None], axis=3) for some in (images, earlier))
            others = np.take_along_axis(others, order[:, None, None, None], axis=4)
            mix = rng.uniform(-_MAX_MIX, _MAX_MIX, (later, 3, 3)).astype(np.float32)
            mix[:, np.arange(3), np.arange(3)] = 0.0
            mix[rng.random(later) >= _COLOUR_CHANCE] = 0.0
            mix += (1.0 - mix.sum(axis=2))[..., None] * np.eye(3, dtype=np.float32)  # grey stays grey
            images, earlier, others = (_mix_channels(some, mix) for some in (images, earlier, others))
            images, earlier = _augment_contrast(images, rng, earlier)
            others = _augment_contrast(others.reshape(-1, HEIGHT, WIDTH, 3), rng)[0].reshape(others.shape)
        return Batch(images, others, pose, match, free, has, earlier, earlier_pose)


def augment_lens(
    images: NDArray[np.uint8], rng: np.random.Generator, earlier: NDArray[np.uint8] | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Returns images and earlier images with a random blur, vignette, pitch, gain and grain; their free distances do not change.

    Args:
        images: (N, H, W, 3), uint8.
        rng: random generator.
        earlier: (N, H, W, 3), uint8, of the same cameras; they get the same changes, but for grain. Black ones stay black. None = all black.
    """
    count, height, width, _ = images.shape
    y, x = np.mgrid[-1.0 : 1.0 : height * 1j, -1.0 : 1.0 : width * 1j].astype(np.float32)
    corner = (x**2 + y**2)[..., None] / 2.0
    out = np.empty_like(images), np.zeros_like(images)
    for k in range(count):
        shift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, rng.uniform(-_MAX_SHIFT, _MAX_SHIFT)]])
        blur = rng.uniform(0.2, _MAX_BLUR) if rng.random() < _BLUR_CHANCE else 0.0
        gain = math.exp(rng.uniform(-_MAX_LOG_GAIN, _MAX_LOG_GAIN)) * (1.0 - rng.uniform(0.0, _MAX_VIGNETTE) * corner)
        grain = rng.uniform(0.0, _MAX_NOISE)
        for row, some in enumerate(_present_and_earlier(images, earlier, k)):
            image = cv2.warpAffine(some, shift, (width, height), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            if blur:
                image = cv2.GaussianBlur(image, (0, 0), blur)
            lit = image.astype(np.float32) * gain + rng.standard_normal(image.shape, dtype=np.float32) * np.float32(grain)
            out[row][k] = np.clip(lit, 0.0, 255.0)
    return out


def _present_and_earlier(images: NDArray[np.uint8], earlier: NDArray[np.uint8] | None, k: int) -> list[NDArray[np.uint8]]:
    """Returns image ``k`` and, unless that is black, its earlier image."""
    return [images[k]] if earlier is None or not earlier[k].any() else [images[k], earlier[k]]


def _mix_channels(images: NDArray[np.uint8], mix: F32) -> NDArray[np.uint8]:
    """Returns images (L, ..., H, W, 3), uint8, with their colours multiplied by matrices (L, 3, 3)."""
    out = images.copy()
    if not images.size:
        return out
    for k in np.flatnonzero(np.abs(mix - np.eye(3, dtype=np.float32)).max(axis=(1, 2)) > 1e-3):
        out[k] = cv2.transform(images[k].reshape(-1, 1, 3), mix[k]).reshape(images[k].shape)
    return out


def _augment_contrast(
    images: NDArray[np.uint8], rng: np.random.Generator, earlier: NDArray[np.uint8] | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Returns images and earlier images, (N, H, W, 3), uint8, with a random gamma, uneven light and noise. Arguments as of ``augment_lens``."""
    out = np.empty_like(images), np.zeros_like(images)
    levels = np.arange(256) / 255.0
    grain = rng.standard_normal((HEIGHT * WIDTH * 3 + 997,), dtype=np.float32)
    for k in range(len(images)):
        table = (255.0 * levels ** (_GAMMA ** rng.uniform(-1.0, 1.0))).astype(np.float32)
        start = int(rng.integers(997))
        amount = rng.uniform(0.0, _MAX_NOISE)
        light = rng.uniform(-1.0, 1.0, (3, 4)).astype(np.float32) * rng.uniform(0.0, _MAX_UNEVENNESS)
        bright = cv2.resize(np.exp(light), (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)[..., None]
        for row, some in enumerate(_present_and_earlier(images, earlier, k)):
            begin = (start + 499 * row) % 997
            noise = amount * grain[begin : begin + some.size].reshape(some.shape)
            out[row][k] = np.clip(table[some] * bright + noise, 0.0, 255.0)
    return out
