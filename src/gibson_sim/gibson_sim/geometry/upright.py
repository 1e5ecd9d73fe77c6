"""Estimates the up direction of a mesh of an interior in any orientation.

Candidates are the normals of flat patches, over the whole sphere. Cues rank them: buildings are wider than high, free space extends from
floor to ceiling, objects stand on the floor and leave the ceiling free, tables are scanned from above, nothing is below the lowest floor.
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
from gibson_sim.geometry.patches import Patches, in_other_cubes, occupied_cells

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

CUES = ("flat", "gaps", "facing", "clutter", "bounds", "outside")
"""Names of the cues. The first two determine which axis is vertical, the others which of its ends is up."""
WEIGHTS = (4.6, 4.2, 2.1, 4.7, 6.2, 2.2)
"""Change of the log-odds per unit of each cue."""
_DIRECTIONS = 3000
"""Number of directions of the hemisphere at which the density of patches is evaluated."""
_KERNEL_DEG, _PEAK_DEG, _APART_DEG = 5.0, 8.0, 25.0
"""Width of the density kernel, radius of a peak, and minimum angle between two peaks."""
_FAINT = 0.03
"""Minimum density of a peak relative to the highest one."""
_MAX_AXES = 10
_LEVEL = math.cos(math.radians(12.0))
"""Minimum cosine between an axis and the normals of level patches."""
_FACES = 0.9
"""Minimum cosine between an axis and the normals of triangles that face along it."""
_STRUCTURE = 0.03
"""Minimum fraction of the whole surface of a plane that counts as a floor, ceiling or wall; the rest is clutter."""
_LARGE = 0.3
"""Minimum area of a floor or ceiling relative to the largest level plane."""
_LITTLE = 0.03
"""Fraction of clutter in the whole surface at which its cues have half their weight."""
_GAP = 0.25
"""Minimum length of a free column relative to the height of the mesh."""
_SAMPLES = 8
"""Number of grids of cubes over which cues are averaged."""


@dataclass(frozen=True, slots=True, eq=False)
class UpCandidate:
    """A candidate for the up direction."""

    up: tuple[float, float, float]
    """Unit normal of the surfaces that are level for this candidate, frame of the mesh."""
    area: float
    """Fraction of the whole surface that is level for this candidate."""
    cues: tuple[float, ...]
    """Values of ``CUES``."""
    chance: float
    """Probability among the candidates, from the cues alone, 0 to 1."""


def find_candidates(patches: Patches, weights: Sequence[float] = WEIGHTS) -> list[UpCandidate]:
    """Returns the candidates for the up direction, most probable first; an empty list if the mesh has no flat patch.

    Args:
        patches: patches of the mesh.
        weights: weight of each of ``CUES``.
    """
    axes = _axes(patches)
    if not axes:
        return []
    # Averaging over several rotated grids cancels the effect of the position of cubes on furniture.
    samples = [patches, *(in_other_cubes(patches, rotation) for rotation in _rotations(_SAMPLES - 1))]
    structures = [_structure(sample, axes) for sample in samples]
    candidates = []
    for axis in axes:
        cues = [_cues(sample, axis, structure) for sample, structure in zip(samples, structures, strict=True)]
        even, odd = (np.mean([sample[part] for sample in cues], axis=0).tolist() for part in (0, 1))
        area = float(
            np.mean([p.weights[np.abs(p.directions @ axis) > _LEVEL].sum() / max(p.weights.sum(), 1.0) for p in samples])
        )
        for sign in (1.0, -1.0):
            candidates.append((sign * axis, area, (*even, *(sign * cue for cue in odd))))
    scores = np.array([cues for _, _, cues in candidates]) @ np.asarray(weights)
    chances = np.exp(scores - scores.max())
    chances /= chances.sum()
    return [
        UpCandidate((float(up[0]), float(up[1]), float(up[2])), area, tuple(float(c) for c in cues), float(chances[k]))
        for k, (up, area, cues) in sorted(enumerate(candidates), key=lambda item: -chances[item[0]])
    ]


def _rotations(count: int) -> list[F64]:
    """Returns fixed pseudorandom rotations, (3, 3) each."""
    rng = np.random.default_rng(0)
    orthogonal = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(count)]
    return [matrix * np.sign(np.linalg.det(matrix)) for matrix in orthogonal]


def _axes(patches: Patches) -> list[F64]:
    """Returns the normals shared by many patches, unit vectors (3,), one of each pair of opposite directions."""
    normals, weights = patches.directions, patches.weights
    if not weights.sum() > 0:
        return []
    hemisphere = _hemisphere(_DIRECTIONS)
    cosine = np.minimum(np.abs(hemisphere @ normals.T), 1.0)
    density = np.exp((cosine - 1.0) / (1.0 - math.cos(math.radians(_KERNEL_DEG)))) @ weights
    threshold = _FAINT * float(density.max())
    axes: list[F64] = []
    while len(axes) < _MAX_AXES and density.max() > threshold:
        axis = hemisphere[int(density.argmax())]
        for _ in range(5):
            near = np.abs(normals @ axis) > math.cos(math.radians(_PEAK_DEG))
            if not (near & (weights > 0)).any():
                break
            axis = np.linalg.eigh((normals[near] * weights[near, None]).T @ normals[near])[1][:, -1]
        density[np.abs(hemisphere @ axis) > math.cos(math.radians(_APART_DEG))] = 0.0
        axis, _ = level_direction(patches, axis)
        if all(abs(float(axis @ other)) < math.cos(math.radians(_PEAK_DEG)) for other in axes):
            axes.append(axis)
    return axes


def _hemisphere(count: int) -> F64:
    """Returns unit vectors (count, 3) of uniform density on a hemisphere."""
    k = np.arange(count) + 0.5
    z = k / count
    angle, radius = np.pi * (1.0 + math.sqrt(5.0)) * k, np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def _structure(patches: Patches, axes: Sequence[F64]) -> Bools:
    """Returns a mask, (P,), of the patches in large planes: floors, walls, ceilings."""
    out = np.zeros(len(patches.centres), dtype=bool)
    for axis in axes:
        perpendicular = np.abs(patches.directions @ axis) > _LEVEL
        heights = patches.centres @ axis
        for height, area in _planes(heights[perpendicular], patches.weights[perpendicular], patches.size):
            if area > _STRUCTURE * patches.weights.sum():
                near = np.abs(heights - height) < patches.size
                # Cubes in corners of a room contain parts of two planes, and therefore have no patch.
                out |= near & (perpendicular | (patches.weights == 0))
    return out


def _planes(heights: F64, weights: F64, size: float) -> list[tuple[float, float]]:
    """Returns height and area of the planes of parallel patches, lowest first; heights and weights are (N,)."""
    if not len(heights):
        return []
    step = 0.5 * size
    low = float(heights.min()) - 2.0 * step
    bins = np.floor((heights - low) / step).astype(np.int64)
    sums = np.convolve(np.bincount(bins, weights, minlength=int(bins.max()) + 3), np.ones(3), "same")
    tops = [k for k in range(1, len(sums) - 1) if sums[k] > 0 and sums[k] >= sums[k - 1] and sums[k] > sums[k + 1]]
    return [(low + (k + 0.5) * step, float(sums[k])) for k in tops]


def _cues(patches: Patches, axis: F64, structure: Bools) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Returns the even cues of an axis and the odd cues of its positive end; the odd cues of the other end are their negatives."""
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
    """Returns the fractions of free columns that end in a floor or ceiling at their lower and at their upper end, 0 to 1.

    Objects on a floor shorten columns from below.
    """
    edge = 1.5 * patches.size
    cells = np.floor(np.column_stack([patches.points @ sides.T, heights]) / edge).astype(np.int64)
    cells -= cells.min(axis=0)
    counts = cells.max(axis=0) + 1
    codes = (cells[:, 0] * counts[1] + cells[:, 1]) * counts[2] + cells[:, 2]
    occupied, cell, numbers = occupied_cells(codes)
    solid = np.bincount(cell, level_structure[patches.cube]) / numbers > 0.3
    column, row = occupied // counts[2], occupied % counts[2]
    free = (column[1:] == column[:-1]) & ((row[1:] - row[:-1]) * edge > least)
    # Without a ceiling there are only few such columns, below tables and shelves, which are no evidence.
    total = max(int(free.sum()), len(np.unique(column)))
    return float(solid[:-1][free].sum()) / total, float(solid[1:][free].sum()) / total


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
    fraction = (heights - levels[storey]) / np.diff(levels)[storey]
    return 0.5 - float(np.clip(fraction, 0.0, 1.0).mean())


def _outside(heights: F64, floors: Sequence[tuple[float, float]], size: float) -> float:
    """Returns the balance of the surface above and below the level planes: 1 = all above, -1 = all below."""
    total = sum(area for _, area in floors)
    if not total > 0:
        return 0.0
    balance = 0.0
    for z, area in floors:
        above, below = float((heights > z + 1.5 * size).mean()), float((heights < z - 1.5 * size).mean())
        balance += area * (above - below) / (above + below + 0.02)
    return balance / total
