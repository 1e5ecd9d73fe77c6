"""Estimates the up direction of a mesh of an interior in any orientation.

Candidates are the directions across flat patches, over the whole sphere. Cues rank them: buildings are wider than high, free space reaches
from floor to ceiling, things stand on the floor and leave the ceiling free, tables are seen from above, nothing is below the lowest floor.
The weights come from a logistic regression on 283 scans, models and parts of both. Even cues are equal for up and down, odd cues have
opposite signs. ``tests/benchmarks/upright.py`` measures the accuracy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.level import level_direction
from gibson_sim.geometry.patches import Patches, in_other_cubes

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

CUES = ("flat", "gaps", "facing", "clutter", "bounds", "outside")
"""Names of the cues. The first two decide which axis is vertical, the others which of its ends is up."""
WEIGHTS = (4.6, 4.2, 2.1, 4.7, 6.2, 2.2)
"""Change of the log-odds for a unit of each cue."""
_DIRECTIONS = 3000
"""Directions of the half sphere at which the density of patches is evaluated."""
_KERNEL_DEG, _PEAK_DEG, _APART_DEG = 5.0, 8.0, 25.0
"""Width of the kernel of the density, radius of a peak, and least angle between two peaks."""
_FAINT = 0.03
"""Least density of a peak relative to the highest one."""
_MAX_AXES = 10
_LEVEL = math.cos(math.radians(12.0))
"""Least cosine between an axis and the directions of level patches."""
_FACES = 0.9
"""Least cosine between an axis and the normals of triangles that face along it."""
_STRUCTURE = 0.03
"""Least share of the whole surface of a plane that is a floor, ceiling or wall; the rest is clutter."""
_LARGE = 0.3
"""Least area of a floor or ceiling relative to the largest level plane."""
_LITTLE = 0.03
"""Share of clutter in the whole surface at which its cues have half their weight."""
_GAP = 0.25
"""Least length of a free column relative to the height of the mesh."""
_SAMPLES = 8
"""Grids of cubes over which cues are averaged."""


@dataclass(frozen=True, slots=True, eq=False)
class UpCandidate:
    """A candidate for the up direction."""

    up: tuple[float, float, float]
    """Unit vector across the surfaces that are level if this is up, frame of the mesh."""
    area: float
    """Share of the whole surface that is level if this is up."""
    cues: tuple[float, ...]
    """Values of ``CUES``."""
    chance: float
    """Probability among the candidates by the cues alone, 0 to 1."""


def find_candidates(patches: Patches, weights: Sequence[float] = WEIGHTS) -> list[UpCandidate]:
    """Returns the candidates for up, the most probable first; none if the mesh has no flat patch.

    Args:
        patches: patches of the mesh.
        weights: weight of each of ``CUES``.
    """
    axes = _axes(patches)
    if not axes:
        return []
    # Averaging over many rotated grids cancels the effect of how the cubes lie on furniture.
    samples = [patches, *(in_other_cubes(patches, rotation) for rotation in _rotations(_SAMPLES - 1))]
    structures = [_structure(sample, axes) for sample in samples]
    found = []
    for axis in axes:
        cues = [_cues(sample, axis, structure) for sample, structure in zip(samples, structures, strict=True)]
        even, odd = (np.mean([sample[part] for sample in cues], axis=0).tolist() for part in (0, 1))
        area = float(
            np.mean([p.weights[np.abs(p.directions @ axis) > _LEVEL].sum() / max(p.weights.sum(), 1.0) for p in samples])
        )
        for sign in (1.0, -1.0):
            found.append((sign * axis, area, (*even, *(sign * cue for cue in odd))))
    scores = np.array([cues for _, _, cues in found]) @ np.asarray(weights)
    chances = np.exp(scores - scores.max())
    chances /= chances.sum()
    return [
        UpCandidate((float(up[0]), float(up[1]), float(up[2])), area, tuple(float(c) for c in cues), float(chances[k]))
        for k, (up, area, cues) in sorted(enumerate(found), key=lambda item: -chances[item[0]])
    ]


def _rotations(count: int) -> list[F64]:
    """Returns fixed pseudorandom rotations, (3, 3) each."""
    rng = np.random.default_rng(0)
    orthogonal = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(count)]
    return [matrix * np.sign(np.linalg.det(matrix)) for matrix in orthogonal]


def _axes(patches: Patches) -> list[F64]:
    """Returns the directions across many patches, unit vectors (3,), one of each pair of opposite ones."""
    normals, weights = patches.directions, patches.weights
    if not weights.sum() > 0:
        return []
    half = _half_sphere(_DIRECTIONS)
    alike = np.minimum(np.abs(half @ normals.T), 1.0)
    density = np.exp((alike - 1.0) / (1.0 - math.cos(math.radians(_KERNEL_DEG)))) @ weights
    least = _FAINT * float(density.max())
    found: list[F64] = []
    while len(found) < _MAX_AXES and density.max() > least:
        axis = half[int(density.argmax())]
        for _ in range(5):
            near = np.abs(normals @ axis) > math.cos(math.radians(_PEAK_DEG))
            if not (near & (weights > 0)).any():
                break
            axis = np.linalg.eigh((normals[near] * weights[near, None]).T @ normals[near])[1][:, -1]
        density[np.abs(half @ axis) > math.cos(math.radians(_APART_DEG))] = 0.0
        axis, _ = level_direction(patches, axis)
        if all(abs(float(axis @ other)) < math.cos(math.radians(_PEAK_DEG)) for other in found):
            found.append(axis)
    return found


def _half_sphere(count: int) -> F64:
    """Returns unit vectors (count, 3) of uniform density on one half of the sphere."""
    k = np.arange(count) + 0.5
    z = k / count
    angle, radius = np.pi * (1.0 + math.sqrt(5.0)) * k, np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def _structure(patches: Patches, axes: Sequence[F64]) -> Bools:
    """Returns (P,): whether each patch lies in a large plane: a floor, a wall, a ceiling."""
    out = np.zeros(len(patches.centres), dtype=bool)
    for axis in axes:
        across = np.abs(patches.directions @ axis) > _LEVEL
        heights = patches.centres @ axis
        for height, area in _planes(heights[across], patches.weights[across], patches.size):
            if area > _STRUCTURE * patches.weights.sum():
                near = np.abs(heights - height) < patches.size
                # Cubes in corners of a room hold parts of two planes, and therefore have no patch.
                out |= near & (across | (patches.weights == 0))
    return out


def _planes(heights: F64, weights: F64, size: float) -> list[tuple[float, float]]:
    """Returns height and area of the planes of parallel patches, from the lowest; heights and weights: (N,)."""
    if not len(heights):
        return []
    step = 0.5 * size
    low = float(heights.min()) - 2.0 * step
    bins = np.floor((heights - low) / step).astype(np.int64)
    sums = np.convolve(np.bincount(bins, weights, minlength=int(bins.max()) + 3), np.ones(3), "same")
    tops = [k for k in range(1, len(sums) - 1) if sums[k] > 0 and sums[k] >= sums[k - 1] and sums[k] > sums[k + 1]]
    return [(low + (k + 0.5) * step, float(sums[k])) for k in tops]


def _cues(patches: Patches, axis: F64, structure: Bools) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Returns the even cues of an axis and the odd ones of its positive end; those of the other end are the negatives."""
    level = np.abs(patches.directions @ axis) > _LEVEL
    heights = patches.points @ axis
    low, high = (float(h) for h in np.percentile(heights, (0.3, 99.7)))
    height = max(high - low, patches.size)
    sides = np.linalg.svd(axis[None])[2][1:]
    widths = [max(float(np.ptp(np.percentile(patches.points @ side, (0.5, 99.5)))), patches.size) for side in sides]
    planes = _planes((patches.centres @ axis)[level], patches.weights[level], patches.size)
    largest = max((a for _, a in planes), default=0.0)
    floors = [(z, a) for z, a in planes if a >= _LARGE * largest]
    clutter = ~structure[patches.cube]
    facing = patches.normals @ axis
    above, below = (float((clutter & faces).mean()) for faces in (facing > _FACES, facing < -_FACES))
    lower, upper = _bounds(patches, axis, sides, heights, structure & level, _GAP * height)
    even = (math.log(math.sqrt(widths[0] * widths[1]) / height), lower + upper)
    share = float(clutter.mean())
    odd = (
        (above - below) / (above + below + _LITTLE),
        _hanging(heights[clutter], [z for z, _ in floors], low, high) * share / (share + _LITTLE),
        upper - lower,
        _outside(heights, floors, patches.size),
    )
    return even, odd


def _bounds(patches: Patches, axis: F64, sides: F64, heights: F64, level_structure: Bools, least: float) -> tuple[float, float]:
    """Returns the shares of free columns that end in a floor or ceiling at their lower and at their upper end, 0 to 1.

    Things on a floor shorten columns from below.
    """
    edge = 1.5 * patches.size
    cells = np.floor(np.column_stack([patches.points @ sides.T, heights]) / edge).astype(np.int64)
    cells -= cells.min(axis=0)
    counts = cells.max(axis=0) + 1
    codes = (cells[:, 0] * counts[1] + cells[:, 1]) * counts[2] + cells[:, 2]
    full, inverse = np.unique(codes, return_inverse=True)
    inverse = inverse.reshape(-1)
    solid = np.bincount(inverse, level_structure[patches.cube]) / np.bincount(inverse) > 0.3
    column, row = full // counts[2], full % counts[2]
    free = (column[1:] == column[:-1]) & ((row[1:] - row[:-1]) * edge > least)
    # Without a ceiling there are few such columns, below tables and shelves, which are no evidence.
    every = max(int(free.sum()), len(np.unique(column)))
    return float(solid[:-1][free].sum()) / every, float(solid[1:][free].sum()) / every


def _hanging(heights: F64, floors: Sequence[float], low: float, high: float) -> float:
    """Returns the mean position of clutter between the level planes below and above it: 0.5 at the floor, -0.5 at the ceiling."""
    if not len(heights) or high <= low:
        return 0.0
    levels = np.unique([low, *floors, high])
    step = 0.1 * (high - low)
    levels = levels[np.concatenate([[True], np.diff(levels) > step])]
    if len(levels) < 2:
        return 0.0
    storey = np.clip(np.searchsorted(levels, heights) - 1, 0, len(levels) - 2)
    part = (heights - levels[storey]) / np.diff(levels)[storey]
    return 0.5 - float(np.clip(part, 0.0, 1.0).mean())


def _outside(heights: F64, floors: Sequence[tuple[float, float]], size: float) -> float:
    """Returns the balance of the surface above and below the level planes: 1 = all above, -1 = all below."""
    total = sum(area for _, area in floors)
    if not total > 0:
        return 0.0
    found = 0.0
    for z, area in floors:
        above, beneath = float((heights > z + 1.5 * size).mean()), float((heights < z - 1.5 * size).mean())
        found += area * (above - beneath) / (above + beneath + 0.02)
    return found / total
