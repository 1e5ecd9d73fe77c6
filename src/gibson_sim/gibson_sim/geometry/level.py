"""Finds the normal of the level surfaces of a mesh, for checking, repairing and fusing scenes.

Level surfaces are regions of flat patches at one height. Each step of tiered seating, each landing and each table is a separate region;
only slopes within regions count, not the heights between them. The result is the mode over the regions, supported by the walls; an axis of
the file that fits as well as the mode is preferred.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from gibson_sim.geometry.patches import Patches

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

_CONE_DEG = (25.0, 8.0, 4.0, 2.0)
"""Largest angles between the estimate of up and the patches used to refine it, round by round."""
_MODE_DEG = 0.4
"""Kernel width around the most frequent direction: a ramp beside a level floor must not be averaged with it."""
_ALIKE_DEG, _ALIKE = 0.7, 0.3
"""Angle around the most frequent direction, and the minimum fraction of the roughly level area within it that makes it the first start."""
_LEAST = 0.02
"""Minimum fraction of the whole surface for the same; a smaller one may be accidental."""
_FACING = math.cos(math.radians(30.0))
"""Minimum cosine between up and the normals of triangles of level surfaces, which scatter in scans."""
_ROUGH = 1.6
"""Largest roughness of a patch relative to that of smooth patches; a rougher patch contains a step or the foot of an object."""
_SMOOTH_QUANTILE = 0.25
"""Quantile of the roughness of level patches that counts as smooth."""
_EVEN = 0.01
"""Roughness below which patches always count as smooth, in cube edges."""
_BESIDE = 1.8
"""Largest distance between the centres of neighbouring patches of a region, in cube edges."""
_STEP, _STEP_SLOPE = 0.03, 0.02
"""Largest height difference between neighbours in a region: in cube edges (or their roughness, if larger), and per metre of distance."""
_BEND_DEG, _BEND_NOISE = 1.0, 3.0
"""Largest angle between neighbours in a region: degrees, and standard deviations of the noise of their directions."""
_LEAST_REGION = 4
"""Minimum number of patches of a region."""
_HYPOTHESES = 12
"""Number of regions whose normals are tried, largest first."""
_SLACK = 0.01
"""Misfit of a region that counts as zero, in cube edges."""
_WALL_DEG, _WALL_WEIGHT = 1.0, 0.5
"""Kernel width around the horizontal for walls, and their weight relative to level surfaces."""
_KEPT = 0.98
"""Minimum score of an axis of the file, relative to the best score, for preferring the axis."""
_AXIS_DEG = 8.0
"""Largest angle to an axis of the file that is tried."""
_ROUNDS = 8


def level_direction(patches: Patches, up: F64) -> tuple[F64, float]:
    """Returns the normal of all level surfaces near ``up``, a unit vector (3,), and the fraction of the whole surface that is level.

    Without level surfaces the result is ``up`` and 0.

    Args:
        patches: patches of a mesh.
        up: (3,), unit vector, roughly up, in the frame of the mesh.
    """
    estimate = np.asarray(up, dtype=np.float64)
    total = max(float(patches.weights.sum()), 1.0)
    for cone in _CONE_DEG:
        level = _level_patches(patches, estimate, cone)
        if not level.any():
            return np.asarray(up, dtype=np.float64), 0.0
        estimate = _mean_direction(patches, level, estimate)
    level = _level_patches(patches, estimate, _CONE_DEG[1])
    area = float(patches.weights[level].sum())
    roughness = _roughness(patches)
    smooth = level & (roughness <= _smooth_limit(roughness[level], patches.weights[level], patches.size))
    smooth = smooth if smooth.any() else level
    mode = _most_frequent_direction(patches, smooth, estimate)
    near_mode = smooth & (np.abs(patches.directions @ mode) > math.cos(math.radians(_ALIKE_DEG)))
    starts = [estimate, *_axes_near(estimate)]
    if patches.weights[near_mode].sum() > max(_ALIKE * area, _LEAST * total):
        starts.insert(0, mode)
    return _best_direction(patches, smooth, roughness, starts), area / total


def _level_patches(patches: Patches, up: F64, cone_deg: float) -> Bools:
    """Returns a mask, (P,), of the patches whose normal is within an angle of ``up``."""
    return np.asarray((np.abs(patches.directions @ up) > math.cos(math.radians(cone_deg))) & (patches.weights > 0))


def _mean_direction(patches: Patches, selected: Bools, up: F64) -> F64:
    aligned = patches.directions[selected] * np.sign(patches.directions[selected] @ up)[:, None]
    mean = (patches.weights[selected, None] * aligned).sum(axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def _roughness(patches: Patches) -> F64:
    """Returns the standard deviation, (P,), of the points of each patch about its plane; infinite without a plane."""
    residuals = ((patches.points - patches.centres[patches.cube]) * patches.directions[patches.cube]).sum(axis=1)
    counts = np.bincount(patches.cube, minlength=len(patches.centres))
    squares = np.bincount(patches.cube, residuals**2, minlength=len(patches.centres))
    # A plane has three parameters.
    return np.asarray(np.where(patches.weights > 0, np.sqrt(squares / np.maximum(counts - 3, 1)), np.inf))


def _smooth_limit(roughness: F64, weights: F64, size: float) -> float:
    """Returns the roughness up to which patches contain one surface, not two with a step between them."""
    order = np.argsort(roughness)
    sums = np.cumsum(weights[order])
    low = float(roughness[order][int(np.searchsorted(sums, _SMOOTH_QUANTILE * sums[-1]))])
    return max(_ROUGH * low, _EVEN * size)


def _axes_near(up: F64) -> list[F64]:
    """Returns the signed axis of the file within ``_AXIS_DEG`` of a direction, or an empty list."""
    k = int(np.abs(up).argmax())
    axis = np.zeros(3)
    axis[k] = math.copysign(1.0, up[k])
    return [axis] if float(axis @ up) > math.cos(math.radians(_AXIS_DEG)) else []


def _most_frequent_direction(patches: Patches, selected: Bools, up: F64) -> F64:
    """Returns the most frequent normal, (3,), of the ``selected`` patches, (P,), which are roughly level: mean shift from the mode."""
    aligned = patches.directions[selected] * np.sign(patches.directions[selected] @ up)[:, None]
    width = 1.0 - math.cos(math.radians(_MODE_DEG))
    kernel = np.exp((np.minimum(aligned @ aligned.T, 1.0) - 1.0) / width)
    best = aligned[int((kernel @ patches.weights[selected]).argmax())]
    for _ in range(_ROUNDS):
        weights = np.exp((np.minimum(aligned @ best, 1.0) - 1.0) / width) * patches.weights[selected]
        best = weights @ aligned
        best /= np.linalg.norm(best)
    return np.asarray(best)


@dataclass(frozen=True, slots=True, eq=False)
class _Regions:
    """Level regions and walls."""

    counts: F64
    """(R,), number of points of each region."""
    spread: F64
    """(R, 3, 3), covariance of the points of each region about its centroid."""
    base: F64
    """(R,), variance along the normal of the region's plane."""
    normals: F64
    """(R, 3), normal of each region's plane."""
    slack: float
    """Variance that counts as no misfit."""
    walls: F64
    """(W, 3), normals of the patches of walls."""
    wall_weights: F64
    """(W,), number of points of each wall patch."""

    def agreement(self, up: F64) -> F64:
        """Returns (R,): 1 = the region is level with respect to ``up``, 0 = it slopes. Narrow regions agree with most directions."""
        misfit = np.einsum("i,rij,j->r", up, self.spread, up) - self.base
        return np.asarray(np.exp(-0.5 * np.maximum(misfit, 0.0) / np.maximum(0.25 * self.base, self.slack)))

    def score(self, up: F64) -> float:
        """Returns the amount of surface that supports a direction, in points."""
        deviation = np.degrees(np.arcsin(np.clip(self.walls @ up, -1.0, 1.0))) / _WALL_DEG
        return float(self.counts @ self.agreement(up) + _WALL_WEIGHT * (self.wall_weights @ np.exp(-0.5 * deviation**2)))

    def refined(self, up: F64) -> F64:
        """Returns the common normal, near ``up``, of the regions that agree with it."""
        estimate = up
        for _ in range(_ROUNDS):
            values, vectors = np.linalg.eigh(np.einsum("r,rij->ij", self.counts * self.agreement(estimate), self.spread))
            normal = vectors[:, 0] * (1.0 if float(vectors[:, 0] @ up) >= 0 else -1.0)
            if values[1] <= 4.0 * values[0] or float(normal @ up) < math.cos(math.radians(_CONE_DEG[-1])):
                break
            estimate = normal
        return np.asarray(estimate)


def _best_direction(patches: Patches, smooth: Bools, roughness: F64, starts: Sequence[F64]) -> F64:
    """Returns the normal of most of the level regions; the first of ``starts`` if there are no regions."""
    estimate = starts[0]
    for _ in range(2):  # regions are grown by heights along the estimate
        regions = _regions(patches, smooth, roughness, estimate)
        if regions is None:
            return estimate
        largest = np.argsort(-regions.counts)[:_HYPOTHESES]
        normals = [normal * (1.0 if float(normal @ estimate) >= 0 else -1.0) for normal in regions.normals[largest]]
        tried = [*starts, *(n for n in normals if float(n @ estimate) > math.cos(math.radians(_CONE_DEG[1])))]
        refined = [regions.refined(up) for up in tried]
        best = max([*starts, *refined], key=regions.score)
        preferred = [axis for axis in _axes_near(best) if regions.score(axis) >= _KEPT * regions.score(best)]
        estimate = preferred[0] if preferred else best
    return estimate


def _regions(patches: Patches, smooth: Bools, roughness: F64, up: F64) -> _Regions | None:
    """Returns the regions of smooth patches, (P,), that are connected without steps; None if there are none."""
    label = _labels(patches, smooth, roughness, up)
    of_point = label[patches.cube]
    in_region = of_point >= 0
    facing = np.abs(patches.normals @ up) > _FACING
    # The triangles of a soup face anywhere; then only the patches determine which points are level.
    in_region = in_region & facing if (in_region & facing).sum() > 0.5 * in_region.sum() else in_region
    if not in_region.any():
        return None
    points, number = patches.points[in_region], of_point[in_region]
    counts = np.bincount(number).astype(np.float64)
    means = np.stack([np.bincount(number, points[:, k]) for k in range(3)], axis=1) / np.maximum(counts, 1.0)[:, None]
    offsets = points - means[number]
    spread = np.empty((len(counts), 3, 3))
    for i in range(3):
        for j in range(i, 3):
            spread[:, i, j] = spread[:, j, i] = np.bincount(number, offsets[:, i] * offsets[:, j]) / np.maximum(counts, 1.0)
    values, vectors = np.linalg.eigh(spread)
    vertical = (np.abs(patches.directions @ up) < math.sin(math.radians(_CONE_DEG[1]))) & (patches.weights > 0)
    kept = counts >= _LEAST_REGION
    if not kept.any():
        return None
    return _Regions(
        counts[kept], spread[kept], values[kept, 0], vectors[kept][:, :, 0], (_SLACK * patches.size) ** 2,
        patches.directions[vertical], patches.weights[vertical],
    )  # fmt: skip


def _labels(patches: Patches, smooth: Bools, roughness: F64, up: F64) -> I64:
    """Returns the region number of each patch, (P,); -1 = in no region."""
    rows = np.flatnonzero(smooth)
    centres, noise = patches.centres[rows], roughness[rows]
    pairs = cKDTree(centres).query_pairs(_BESIDE * patches.size, output_type="ndarray")
    a, b = pairs[:, 0], pairs[:, 1]
    offset = centres[b] - centres[a]
    rise = np.abs(offset @ up)
    distance = np.linalg.norm(offset, axis=1)
    median_noise = float(np.median(noise))
    connected = rise <= max(_STEP * patches.size, median_noise) + _STEP_SLOPE * distance
    # Standard deviation of the slope of a plane fitted to n noisy points spread evenly over a cube.
    slope_noise = median_noise / (patches.size * np.sqrt(np.minimum(patches.weights[rows][a], patches.weights[rows][b]) / 12.0))
    cosine = np.abs((patches.directions[rows][a] * patches.directions[rows][b]).sum(axis=1))
    connected &= np.arccos(np.minimum(cosine, 1.0)) <= math.radians(_BEND_DEG) + _BEND_NOISE * slope_noise
    a, b = a[connected], b[connected]
    graph = sparse.coo_matrix((np.ones(len(a), dtype=bool), (a, b)), shape=(len(rows), len(rows)))
    _, component = csgraph.connected_components(graph, directed=False)
    large = np.bincount(component) >= _LEAST_REGION
    number = np.where(large, np.cumsum(large) - 1, -1)
    out = np.full(len(smooth), -1, dtype=np.int64)
    out[rows] = number[component]
    return out
