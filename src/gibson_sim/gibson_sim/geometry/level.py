"""Finds the direction across the level surfaces of a mesh, for checking, repairing and fusing scenes.

Level surfaces are regions of flat patches at one height: each step of raised seating, each landing and table is a region of its own, and only
slopes within regions count, never heights between them. The direction is the mode over the regions, with the walls as a second witness;
an axis of the file that is as good as the mode is kept.
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
"""Largest angles between the estimate of up and the patches that improve it, round by round."""
_MODE_DEG = 0.4
"""Width of the kernel about the most frequent direction: a ramp beside a level floor must not be averaged with it."""
_ALIKE_DEG, _ALIKE = 0.7, 0.3
"""Angle about the most frequent direction, and the share of the roughly level area within it from which on it alone decides."""
_LEAST = 0.02
"""Least share of the whole surface for the same; a smaller one may be chance."""
_FACING = math.cos(math.radians(30.0))
"""Least cosine between up and the normals of triangles of level surfaces, which scatter in scans."""
_ROUGH = 1.6
"""Largest roughness of a patch relative to that of the smooth ones; a rougher one holds a step or the foot of a thing."""
_SMOOTH_QUANTILE = 0.25
"""Quantile of the roughness of level patches that counts as smooth."""
_EVEN = 0.01
"""Roughness below which patches are smooth in any case, edges of a cube."""
_BESIDE = 1.8
"""Largest distance between the centres of patches of one region, edges of a cube."""
_STEP, _STEP_SLOPE = 0.03, 0.02
"""Largest height between neighbours in a region: edges of a cube (or their roughness, if that is more), and metres per metre beside it."""
_BEND_DEG, _BEND_NOISE = 1.0, 3.0
"""Largest angle between neighbours in a region: degrees, and standard deviations of the noise of their directions."""
_LEAST_REGION = 4
"""Least number of patches of a region."""
_HYPOTHESES = 12
"""Number of regions whose own direction is tried, the largest first."""
_SLACK = 0.01
"""Misfit of a region that counts as none, edges of a cube."""
_WALL_DEG, _WALL_WEIGHT = 1.0, 0.5
"""Width of the kernel about the horizontal for walls, and their weight relative to level surfaces."""
_KEPT = 0.98
"""Score of an axis of the file relative to the best from which on the axis is kept."""
_AXIS_DEG = 8.0
"""Largest angle to an axis of the file that is tried."""
_ROUNDS = 8


def level_direction(patches: Patches, up: F64) -> tuple[F64, float]:
    """Returns the direction across all level surfaces near ``up``, a unit vector (3,), and the share of the whole surface that is level.

    Without level surfaces the result is ``up`` itself and 0.

    Args:
        patches: patches of a mesh.
        up: (3,), unit vector, roughly up, in the frame of the mesh.
    """
    found = np.asarray(up, dtype=np.float64)
    total = max(float(patches.weights.sum()), 1.0)
    for cone in _CONE_DEG:
        near = _across(patches, found, cone)
        if not near.any():
            return np.asarray(up, dtype=np.float64), 0.0
        found = _mean_direction(patches, near, found)
    near = _across(patches, found, _CONE_DEG[1])
    area = float(patches.weights[near].sum())
    rough = _roughness(patches)
    smooth = near & (rough <= _smooth_below(rough[near], patches.weights[near], patches.size))
    smooth = smooth if smooth.any() else near
    densest = _densest(patches, smooth, found)
    alike = smooth & (np.abs(patches.directions @ densest) > math.cos(math.radians(_ALIKE_DEG)))
    starts = [found, *_axes_near(found)]
    if patches.weights[alike].sum() > max(_ALIKE * area, _LEAST * total):
        starts.insert(0, densest)
    return _mode(patches, smooth, rough, starts), area / total


def _across(patches: Patches, up: F64, cone_deg: float) -> Bools:
    """Returns (P,): which patches lie across ``up`` within an angle."""
    return np.asarray((np.abs(patches.directions @ up) > math.cos(math.radians(cone_deg))) & (patches.weights > 0))


def _mean_direction(patches: Patches, near: Bools, up: F64) -> F64:
    aligned = patches.directions[near] * np.sign(patches.directions[near] @ up)[:, None]
    mean = (patches.weights[near, None] * aligned).sum(axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def _roughness(patches: Patches) -> F64:
    """Returns the standard deviation (P,) of the points of each patch about its plane; infinite without a plane."""
    off = ((patches.points - patches.centres[patches.cube]) * patches.directions[patches.cube]).sum(axis=1)
    counts = np.bincount(patches.cube, minlength=len(patches.centres))
    squares = np.bincount(patches.cube, off**2, minlength=len(patches.centres))
    # A plane has three parameters.
    return np.asarray(np.where(patches.weights > 0, np.sqrt(squares / np.maximum(counts - 3, 1)), np.inf))


def _smooth_below(rough: F64, weights: F64, size: float) -> float:
    """Returns the roughness up to which patches hold one surface, not two with a step between them."""
    order = np.argsort(rough)
    sums = np.cumsum(weights[order])
    low = float(rough[order][int(np.searchsorted(sums, _SMOOTH_QUANTILE * sums[-1]))])
    return max(_ROUGH * low, _EVEN * size)


def _axes_near(up: F64) -> list[F64]:
    """Returns the axis of the file near a direction, with its sign; none if it is farther than ``_AXIS_DEG``."""
    k = int(np.abs(up).argmax())
    axis = np.zeros(3)
    axis[k] = math.copysign(1.0, up[k])
    return [axis] if float(axis @ up) > math.cos(math.radians(_AXIS_DEG)) else []


def _densest(patches: Patches, near: Bools, up: F64) -> F64:
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


@dataclass(frozen=True, slots=True, eq=False)
class _Regions:
    """Level regions, and the walls beside them."""

    counts: F64
    """(R,), number of points."""
    spread: F64
    """(R, 3, 3), covariance of the points of each region about its own centre."""
    base: F64
    """(R,), variance across the region's own plane."""
    normals: F64
    """(R, 3), direction across the region's own plane."""
    slack: float
    """Variance that counts as no misfit."""
    walls: F64
    """(W, 3), directions across the patches of walls."""
    wall_weights: F64
    """(W,), number of points of each."""

    def agreement(self, up: F64) -> F64:
        """Returns (R,): 1 = the region is level if ``up`` is up, 0 = it slopes. Narrow regions agree with most directions."""
        misfit = np.einsum("i,rij,j->r", up, self.spread, up) - self.base
        return np.asarray(np.exp(-0.5 * np.maximum(misfit, 0.0) / np.maximum(0.25 * self.base, self.slack)))

    def score(self, up: F64) -> float:
        """Returns how much surface speaks for a direction, in points."""
        off = np.degrees(np.arcsin(np.clip(self.walls @ up, -1.0, 1.0))) / _WALL_DEG
        return float(self.counts @ self.agreement(up) + _WALL_WEIGHT * (self.wall_weights @ np.exp(-0.5 * off**2)))

    def refined(self, up: F64) -> F64:
        """Returns the direction nearest to ``up`` that the regions which agree with it have in common."""
        found = up
        for _ in range(_ROUNDS):
            values, vectors = np.linalg.eigh(np.einsum("r,rij->ij", self.counts * self.agreement(found), self.spread))
            normal = vectors[:, 0] * (1.0 if float(vectors[:, 0] @ up) >= 0 else -1.0)
            if values[1] <= 4.0 * values[0] or float(normal @ up) < math.cos(math.radians(_CONE_DEG[-1])):
                break
            found = normal
        return np.asarray(found)


def _mode(patches: Patches, smooth: Bools, rough: F64, starts: Sequence[F64]) -> F64:
    """Returns the direction across most of the level regions; the first of ``starts`` if there are no regions."""
    found = starts[0]
    for _ in range(2):  # regions are grown by heights along the estimate
        regions = _regions(patches, smooth, rough, found)
        if regions is None:
            return found
        largest = np.argsort(-regions.counts)[:_HYPOTHESES]
        own = [normal * (1.0 if float(normal @ found) >= 0 else -1.0) for normal in regions.normals[largest]]
        tried = [*starts, *(n for n in own if float(n @ found) > math.cos(math.radians(_CONE_DEG[1])))]
        refined = [regions.refined(up) for up in tried]
        best = max([*starts, *refined], key=regions.score)
        kept = [axis for axis in _axes_near(best) if regions.score(axis) >= _KEPT * regions.score(best)]
        found = kept[0] if kept else best
    return found


def _regions(patches: Patches, smooth: Bools, rough: F64, up: F64) -> _Regions | None:
    """Returns the regions of smooth patches (P,) that are connected without steps; None if there are none."""
    label = _labels(patches, smooth, rough, up)
    of_point = label[patches.cube]
    on = of_point >= 0
    faces = np.abs(patches.normals @ up) > _FACING
    # The triangles of a soup face anywhere; the patches alone then decide what is level.
    on = on & faces if (on & faces).sum() > 0.5 * on.sum() else on
    if not on.any():
        return None
    points, number = patches.points[on], of_point[on]
    counts = np.bincount(number).astype(np.float64)
    means = np.stack([np.bincount(number, points[:, k]) for k in range(3)], axis=1) / np.maximum(counts, 1.0)[:, None]
    offsets = points - means[number]
    spread = np.empty((len(counts), 3, 3))
    for i in range(3):
        for j in range(i, 3):
            spread[:, i, j] = spread[:, j, i] = np.bincount(number, offsets[:, i] * offsets[:, j]) / np.maximum(counts, 1.0)
    values, vectors = np.linalg.eigh(spread)
    upright = (np.abs(patches.directions @ up) < math.sin(math.radians(_CONE_DEG[1]))) & (patches.weights > 0)
    kept = counts >= _LEAST_REGION
    if not kept.any():
        return None
    return _Regions(
        counts[kept], spread[kept], values[kept, 0], vectors[kept][:, :, 0], (_SLACK * patches.size) ** 2,
        patches.directions[upright], patches.weights[upright],
    )  # fmt: skip


def _labels(patches: Patches, smooth: Bools, rough: F64, up: F64) -> I64:
    """Returns the number of the region of each patch, (P,); -1 = in none."""
    rows = np.flatnonzero(smooth)
    centres, noise = patches.centres[rows], rough[rows]
    pairs = cKDTree(centres).query_pairs(_BESIDE * patches.size, output_type="ndarray")
    a, b = pairs[:, 0], pairs[:, 1]
    between = centres[b] - centres[a]
    rise = np.abs(between @ up)
    beside = np.linalg.norm(between, axis=1)
    bumps = float(np.median(noise))
    flush = rise <= max(_STEP * patches.size, bumps) + _STEP_SLOPE * beside
    # Slope of a plane through n points with noise, spread evenly over a cube.
    wobble = bumps / (patches.size * np.sqrt(np.minimum(patches.weights[rows][a], patches.weights[rows][b]) / 12.0))
    alike = np.abs((patches.directions[rows][a] * patches.directions[rows][b]).sum(axis=1))
    flush &= np.arccos(np.minimum(alike, 1.0)) <= math.radians(_BEND_DEG) + _BEND_NOISE * wobble
    graph = sparse.coo_matrix((np.ones(int(flush.sum()), dtype=bool), (a[flush], b[flush])), shape=(len(rows), len(rows)))
    _, part = csgraph.connected_components(graph, directed=False)
    large = np.bincount(part) >= _LEAST_REGION
    number = np.where(large, np.cumsum(large) - 1, -1)
    out = np.full(len(smooth), -1, dtype=np.int64)
    out[rows] = number[part]
    return out
