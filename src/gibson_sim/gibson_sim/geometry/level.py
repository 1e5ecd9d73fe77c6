"""How far what is meant to be level is out of level: one measure for whoever checks, mends or fuses."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.patches import Patches

F64 = NDArray[np.float64]

_CONE_DEG = (25.0, 8.0, 4.0, 2.0)
"""Pieces whose direction is this near to what is taken for up decide, round after round."""
_MODE_DEG = 0.4
"""Pieces are as one direction within about this: a ramp beside a level floor must not be averaged with it."""
_ALIKE_DEG, _ALIKE = 0.7, 0.3
"""Where so much of what is about level lies across one direction so nearly, it alone decides."""
_LEAST = 0.02
"""Of the whole surface: less is chance."""
_FACING = math.cos(math.radians(30.0))
"""Normals of single triangles of a scan scatter."""
_LAYER = 0.15
"""Of the area in the fullest layer: one with less is no floor, no ceiling, no table."""
_THIN = (0.2, 0.1, 0.05)
"""Half the thickness of a layer, in edges of a cube, round after round; but at least ``_BUMPS``."""
_BUMPS = 3.0
"""Standard deviations of the bumps of what is level."""
_ROUNDS = 8
_MEDIAN = 1.4826
"""Standard deviation against the median of what is normally distributed."""
_NARROW = 1.0
"""A surface that is not wider than this many cubes in both directions says nothing: a ledge, a beam."""


def level_direction(patches: Patches, up: F64) -> tuple[F64, float]:
    """Returns the direction across all level surfaces near ``up``, unit length, and the part of the whole surface that it rests on.

    Floors at several heights, stages and tables count each for themselves: no plane is laid through two of them. Where nothing level is
    near, ``up`` itself comes back, and 0.

    Args:
        patches: of a mesh.
        up: unit vector, roughly up.
    """
    found = np.asarray(up, dtype=np.float64)
    total = max(float(patches.weights.sum()), 1.0)
    for cone in _CONE_DEG:
        near = (np.abs(patches.directions @ found) > math.cos(math.radians(cone))) & (patches.weights > 0)
        if not near.any():
            return np.asarray(up, dtype=np.float64), 0.0
        aligned = patches.directions[near] * np.sign(patches.directions[near] @ found)[:, None]
        found = (patches.weights[near, None] * aligned).sum(axis=0)
        found /= np.linalg.norm(found)
    near = (np.abs(patches.directions @ found) > math.cos(math.radians(_CONE_DEG[1]))) & (patches.weights > 0)
    area = float(patches.weights[near].sum())
    densest = _densest(patches, near, found)
    alike = near & (np.abs(patches.directions @ densest) > math.cos(math.radians(_ALIKE_DEG)))
    if patches.weights[alike].sum() > max(_ALIKE * area, _LEAST * total):
        near, found = alike, densest
    return _through_layers(patches, near, found, area / total)


def _densest(patches: Patches, near: NDArray[np.bool_], up: F64) -> F64:
    """Returns the direction, (3,), that most of the pieces ``near`` the direction ``up`` lie across."""
    aligned = patches.directions[near] * np.sign(patches.directions[near] @ up)[:, None]
    width = 1.0 - math.cos(math.radians(_MODE_DEG))
    kernel = np.exp((np.minimum(aligned @ aligned.T, 1.0) - 1.0) / width)
    best = aligned[int((kernel @ patches.weights[near]).argmax())]
    for _ in range(_ROUNDS):
        pull = np.exp((np.minimum(aligned @ best, 1.0) - 1.0) / width) * patches.weights[near]
        best = pull @ aligned
        best /= np.linalg.norm(best)
    return np.asarray(best)


def _through_layers(patches: Patches, near: NDArray[np.bool_], up: F64, area: float) -> tuple[F64, float]:
    """Returns the direction across the layers that the pieces ``near`` lie in, each about its own middle, and ``area``."""
    on = near[patches.cube]
    faces = np.abs(patches.normals @ up) > _FACING
    # Specks of a soup face anywhere: then the pieces alone say what is level.
    on = on & faces if (on & faces).sum() > 0.5 * on.sum() else on
    points = patches.points[on]
    bumps = _MEDIAN * float(
        np.median(np.abs(((points - patches.centres[patches.cube[on]]) * patches.directions[patches.cube[on]]).sum(axis=1)))
    )
    found = up
    for thin in _THIN:
        half = max(thin * patches.size, _BUMPS * bumps)
        heights = points @ found
        layer = _layers(heights, half)
        kept = layer >= 0
        if kept.sum() < 3:
            return up, area
        number = layer[kept]
        counts = np.bincount(number)
        means = np.stack([np.bincount(number, points[kept, k]) for k in range(3)], axis=1) / np.maximum(counts, 1)[:, None]
        offsets = points[kept] - means[number]
        # What stands on a floor is in its layer, too, at the foot: it must not pull.
        across = np.abs(offsets @ found)
        close = across <= max(_BUMPS * _MEDIAN * float(np.median(across)), 1e-9 * patches.size)
        values, vectors = np.linalg.eigh(offsets[close].T @ offsets[close] / max(int(close.sum()), 1))
        if values[1] < (_NARROW * patches.size) ** 2:
            return up, area
        turned = vectors[:, 0] * (1.0 if float(vectors[:, 0] @ up) >= 0 else -1.0)
        if float(turned @ up) < math.cos(math.radians(_CONE_DEG[-1])):
            return up, area
        found = turned
    return found, area


def _layers(heights: F64, half: float) -> NDArray[np.int64]:
    """Returns the layer of each height, (N,); -1 of those in none. Layers are the fullest ones, and ``half`` thick to either side."""
    low = float(heights.min())
    bins = np.floor((heights - low) / half).astype(np.int64)
    sums = np.bincount(bins, minlength=int(bins.max()) + 2).astype(np.float64)
    pairs = sums[:-1] + sums[1:]
    layer = np.full(len(heights), -1, dtype=np.int64)
    number, least = 0, _LAYER * pairs.max()
    while pairs.max() >= max(least, 1.0):
        k = int(pairs.argmax())
        inside = (np.abs(heights - low - (k + 1) * half) <= half) & (layer < 0)
        layer[inside] = number
        number += 1
        pairs[max(0, k - 1) : k + 2] = 0.0
    return layer
