"""Finds the direction across the level surfaces of a mesh, for checking, repairing and fusing scenes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.patches import Patches

F64 = NDArray[np.float64]

_CONE_DEG = (25.0, 8.0, 4.0, 2.0)
"""Largest angles between the estimate of up and the patches that improve it, round by round."""
_MODE_DEG = 0.4
"""Width of the kernel about the most frequent direction: a ramp beside a level floor must not be averaged with it."""
_ALIKE_DEG, _ALIKE = 0.7, 0.3
"""Angle about the most frequent direction, and the share of the roughly level area within it from which on it alone decides."""
_LEAST = 0.02
"""Least share of the whole surface for the same; a smaller one may be chance."""
_FACING = math.cos(math.radians(30.0))
"""Least cosine between up and the normals of triangles of level surfaces, which scatter in scans."""
_LAYER = 0.15
"""Least area of a layer as a share of that of the fullest; a smaller one is no floor, ceiling or table."""
_THIN = (0.2, 0.1, 0.05)
"""Half thickness of a layer, edges of a cube, round by round; at least ``_BUMPS``."""
_BUMPS = 3.0
"""Least half thickness of a layer, standard deviations of the roughness of level surfaces."""
_ROUNDS = 8
_MEDIAN = 1.4826
"""Standard deviation of a normal distribution divided by the median absolute deviation."""
_NARROW = 1.0
"""Least width of a level surface in both directions, cubes: a ledge or a beam is narrower."""


def level_direction(patches: Patches, up: F64) -> tuple[F64, float]:
    """Returns the direction across all level surfaces near ``up``, a unit vector (3,), and the share of the whole surface that is level.

    Floors at several heights, stages and tables are fitted separately, each about its own centre. Without level surfaces the result is
    ``up`` itself and 0.

    Args:
        patches: patches of a mesh.
        up: (3,), unit vector, roughly up, in the frame of the mesh.
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
    """Returns the most frequent direction (3,) of the patches ``near`` (P,), which are roughly across ``up``."""
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
    """Returns the direction across the layers of the patches ``near`` (P,), each fitted about its own centre, and ``area``."""
    on = near[patches.cube]
    faces = np.abs(patches.normals @ up) > _FACING
    # The triangles of a soup face anywhere; the patches alone then decide what is level.
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
        # The feet of things on a floor lie in its layer too, but must not affect it.
        across = np.abs(offsets @ found)
        close = across <= max(_BUMPS * _MEDIAN * float(np.median(across)), 1e-9 * patches.size)
        values, vectors = np.linalg.eigh(offsets[close].T @ offsets[close] / max(int(close.sum()), 1))
        if values[1] < (_NARROW * patches.size) ** 2:
            return up, area
        normal = vectors[:, 0] * (1.0 if float(vectors[:, 0] @ up) >= 0 else -1.0)
        if float(normal @ up) < math.cos(math.radians(_CONE_DEG[-1])):
            return up, area
        found = normal
    return found, area


def _layers(heights: F64, half: float) -> NDArray[np.int64]:
    """Returns the number of the layer of each height, (N,), -1 = none; the fullest layers are ``half`` thick to either side."""
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
