"""Views of places made by hand: a random pattern on a cylinder around each place, seen by a pinhole or by two fisheyes."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_path_following.types import Image, PathNode, RecordedPath, Velocity, View

HFOV = math.radians(100.0)
SIZE = (96, 64)
STEP_NS = 500_000_000
"""Time from node to node, ns: 0.2 m at 0.4 m/s."""
_AROUND = 720
"""Columns of a pattern, half a degree each."""


def pattern(place: int) -> NDArray[np.float32]:
    """Returns the pattern around a place, (rows, columns), 0 to 255; column 0 is behind, columns go to the right."""
    rough = np.random.default_rng(place).uniform(0.0, 255.0, (18, 80)).astype(np.float32)
    closed = np.concatenate([rough, rough, rough], axis=1)
    smooth = cv2.resize(closed, (3 * _AROUND, 160), interpolation=cv2.INTER_CUBIC)[:, _AROUND : 2 * _AROUND]
    return np.clip(smooth, 0.0, 255.0)


def pinhole_view(place: float, yaw: float = 0.0, gain: float = 1.0) -> View:
    """Returns what a camera sees at a place, between two whole ones a mixture, turned to the left by ``yaw``, radians."""
    width, height = SIZE
    focal = width / 2.0 / math.tan(HFOV / 2.0)
    x = (np.arange(width) + 0.5 - width / 2.0) / focal
    y = (np.arange(height) + 0.5 - height / 2.0) / focal
    azimuth = np.broadcast_to(-np.arctan(x)[None, :] + yaw, (height, width))
    down = y[:, None] * np.cos(np.arctan(x))[None, :]
    return (_seen(place, azimuth, down, gain),)


def fisheye_view(place: float, yaw: float = 0.0) -> View:
    """Returns what two fisheyes of 180 degrees see, ahead and back, 64x64."""
    size = 64
    grid = (np.arange(size) + 0.5 - size / 2.0) / (size / 2.0)
    right, down = np.broadcast_to(grid[None, :], (size, size)), np.broadcast_to(grid[:, None], (size, size))
    radius = np.hypot(right, down)
    angle = radius * math.pi / 2.0
    sides = np.sin(angle) / np.maximum(radius, 1e-9)
    ahead, across, below = np.cos(angle), sides * right, sides * down
    elevation = below / np.maximum(np.hypot(ahead, across), 1e-6)
    images = []
    for turn in (0.0, math.pi):
        azimuth = np.arctan2(-across, ahead) + yaw + turn
        image = _seen(place, azimuth, elevation, 1.0)
        image[radius > 1.0] = 0
        images.append(image)
    return tuple(images)


def straight_path(nodes: int = 12, angular: float = 0.0) -> RecordedPath:
    """Returns a path with a node every 0.2 m, driven with 0.4 m/s and a yaw rate; node i is place i."""
    return RecordedPath(
        "pinhole",
        HFOV,
        tuple(
            PathNode(pinhole_view(i), i * STEP_NS, 0.2 * i, ((0, Velocity(0.4, angular)),), (0.2 * i, 0.0, 0.0))
            for i in range(nodes)
        ),
    )


def _seen(place: float, azimuth: NDArray[np.float64], down: NDArray[np.float64], gain: float) -> Image:
    first = math.floor(place)
    share = place - first
    around = (1.0 - share) * pattern(first) + (share * pattern(first + 1) if share else 0.0)
    column = ((0.5 - azimuth / (2.0 * math.pi)) % 1.0) * _AROUND
    row = np.clip((down / 1.6 + 0.5) * (len(around) - 1), 0, len(around) - 1)
    closed = np.concatenate([around, around[:, :2]], axis=1)
    grey = cv2.remap(closed, column.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR)
    return np.repeat(np.clip(gain * grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
