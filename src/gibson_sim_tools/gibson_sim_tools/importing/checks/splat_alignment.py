"""Finds the pose and the scale at which the splats of a scene lie on its mesh.

Both show one room, but a capture begins anywhere, has any scale and often another up axis. Directions that many of its surfaces face are
tried as up; for each, the floor plans of both are correlated at all yaws and at scales about those that their sizes suggest, and so are their
heights. The best candidates are brought onto the mesh point to plane, with seven degrees of freedom (rotation, translation, scale), by
robust least squares: an iterative closest point search.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.spatial import cKDTree

from gibson_sim.errors import SceneError
from gibson_sim.formats.splats import load_splats
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_matrix, transform_points
from gibson_sim.scenes.spec import SPLAT_SCALES, SplatsSpec
from gibson_sim_tools.importing.checks.gravity import rotation_to_z
from gibson_sim_tools.importing.checks.splats import (
    SOLID,
    SPLATS_APART,
    SplatDistance,
    Surface,
    has_area,
    measured,
    solid_positions,
    some_of,
)

F64 = NDArray[np.float64]

_CLOUD, _FEW, _SURFACE = 3000, 500, 200_000
"""Points of the splats, evenly spread, those in the first rounds, and points on the mesh."""
_SAMPLE = 100_000
"""Splats among which those points are chosen."""
_FEWEST = 100
"""Solid splats below which nothing is aligned."""
_NEIGHBOURS = 16
"""Points that give the normal of one."""
_DIRECTIONS = 1500
_UPS, _UP_DEG, _PEAK_DEG = 3, 20.0, 6.0
"""Directions that are tried as up, each with its opposite; the least angle between them; that to the normals which speak for one."""
_BINS, _YAWS, _YAW_DEG = 60, 4, 10.0
"""Bins of half a turn for the headings of walls; headings that are tried, each with its opposite; the least angle between them."""
_CELLS = 56
"""Cells of a floor plan along the longer side of the mesh."""
_LEVELS = 50
"""Cells of its height."""
_SCALE_STEP, _SCALES_BELOW, _SCALES_ABOVE = 1.07, 12, 5
"""Factor between scales that are tried, and how many there are below and above those that the sizes of both suggest: a capture of one
storey of two has half the size of the mesh."""
_STEEP = 0.7
"""z component of a unit normal above which a surface is a floor, not a wall."""
_KEPT, _FINAL = 80, 6
"""Candidates that are brought onto the mesh, and those of them that are with all points."""
_APART_M = 0.2
"""Distance between the places of a point above which two results are two poses."""
_NEAR = 0.05
"""Distance from the mesh within which a splat fits, metres."""
_BETTER = 0.001
"""By how much nearer the splats must be than before, metres."""
_LEAST_SHARE, _LEAD = 0.88, 0.02
"""Share of the splats that must fit, and by how much it must exceed that of any other pose."""


@dataclass(frozen=True, slots=True)
class SplatAlignment:
    """Pose and scale at which the splats of a scene lie on its mesh."""

    spec: SplatsSpec
    """The splats there."""
    before: SplatDistance
    after: SplatDistance

    def text(self) -> str:
        """Returns what was found as text."""
        return f"before: {self.before.text()}\nafter: {self.after.text()}"


@dataclass(frozen=True, slots=True, eq=False)
class _Cloud:
    points: F64
    """(N, 3), about evenly spread over the surfaces."""
    normals: F64
    """(N, 3), unit vectors, without a side."""


def align_splats(spec: SplatsSpec, corners: F64, rng: np.random.Generator) -> SplatAlignment:
    """Returns the pose and the scale at which the splats of a scene lie on its mesh.

    Args:
        spec: the splats of the scene. Among poses that fit alike, the one near theirs is taken.
        corners: (F, 3, 3), corners of all triangles that are drawn, world frame, metres, z up.
        rng: chooses points.

    Raises:
        MeshError: the file of the splats cannot be used.
        SceneError: there is nothing to align, no pose fits, several do, or none fits better than the present one.
    """
    splats = load_splats(Path(spec.file))
    positions = solid_positions(spec, splats)
    if len(positions) < _FEWEST:
        raise SceneError(
            f"{spec.file}: has {len(positions)} splats with an opacity of {SOLID} and more; {_FEWEST} are needed to align them"
        )
    low, high = _box(positions)
    if not (high - low).max() > 0.0:
        raise SceneError(f"{spec.file}: all of the splats are at one place, {', '.join(f'{c:g}' for c in low)}")
    if not has_area(corners):
        raise SceneError(f"{spec.file}: the scene draws no mesh, so the splats cannot be registered to it")
    surface, some = Surface(corners, rng, _SURFACE), some_of(positions, rng)
    before = measured(splats, some, surface)
    matrix = _best(spec.file, _cloud(positions, rng), surface, rng)
    after = measured(splats, transform_points(matrix, some), surface)
    if after.median > min(before.median - _BETTER, SPLATS_APART):
        why = (
            "which is not nearer than they are"
            if after.median <= SPLATS_APART
            else f"more than the {100.0 * SPLATS_APART:g} cm that are allowed"
        )
        raise SceneError(
            f"{spec.file}: the splats stay where they are: in the best pose found half of the solid ones are within "
            f"{100.0 * after.median:.1f} cm of the mesh, {why}"
        )
    return SplatAlignment(moved_splats(spec, matrix), before, after)


def moved_splats(spec: SplatsSpec, matrix: F64) -> SplatsSpec:
    """Returns splats after a transform, (4, 4), rigid times a scale, of the world frame.

    Raises:
        SceneError: their scale would be beyond what scenes may have.
    """
    factor = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    pose, scale = matrix @ matrix_from_pose(spec.pose), spec.scale * factor
    if not SPLAT_SCALES[0] <= scale <= SPLAT_SCALES[1]:
        raise SceneError(
            f"{spec.file}: the splats would fit with a scale of {scale:g}, must be {SPLAT_SCALES[0]:g} to {SPLAT_SCALES[1]:g}"
        )
    pose[:3, :3] /= factor
    return replace(spec, pose=pose_from_matrix(pose), scale=scale)


def _best(file: str, cloud: _Cloud, surface: Surface, rng: np.random.Generator) -> F64:
    """Returns the transform (4, 4) that brings a cloud onto a surface.

    Raises:
        SceneError: none does, or several do.
    """
    few = cloud.points[rng.permutation(len(cloud.points))[:_FEW]]
    matrices = [np.eye(4), *_candidates(cloud, surface)]
    rough = [_onto(few, surface, matrix, (1.0, 0.1), 8) for matrix in matrices]
    order = [0, *(k for k in sorted(range(len(rough)), key=lambda k: -rough[k][1]) if k)][: _FINAL + 1]
    # What began at the present pose is the first one.
    found = [_onto(cloud.points, surface, rough[k][0], (0.15, 0.02), 15) for k in order]
    best = max(found, key=lambda pair: pair[1])
    if best[1] < _LEAST_SHARE:
        raise SceneError(
            f"{file}: no pose and scale were found at which these splats are this mesh: at best {100.0 * best[1]:.0f} % of the solid ones are "
            f"within {100.0 * _NEAR:g} cm of it, {100.0 * _LEAST_SHARE:g} % are needed; "
            "give splats of this room, or a rough pose and scale in scene.yaml"
        )
    if found[0][1] > best[1] - _LEAD:
        return found[0][0]
    marks = _marks(cloud)
    places = [transform_points(matrix, marks) for matrix, _ in found]
    here = transform_points(best[0], marks)
    rivals = [
        share for (_, share), there in zip(found, places, strict=True) if np.linalg.norm(there - here, axis=1).max() > _APART_M
    ]
    if max(rivals, default=0.0) > best[1] - _LEAD:
        raise SceneError(
            f"{file}: several poses fit alike, with {100.0 * best[1]:.0f} % and {100.0 * max(rivals):.0f} % of the solid splats within "
            f"{100.0 * _NEAR:g} cm of the mesh; give a rough pose and scale in scene.yaml, then the nearest one is taken"
        )
    return best[0]


def _marks(cloud: _Cloud) -> F64:
    """Returns four points, (4, 3), whose places tell a transform: the middle of a cloud, and those half way to its rim."""
    middle = np.median(cloud.points, axis=0)
    size = float(np.median(np.linalg.norm(cloud.points - middle, axis=1)))
    return np.concatenate([middle[None], middle + size * np.eye(3)])


def _cloud(positions: F64, rng: np.random.Generator) -> _Cloud:
    """Returns about evenly spread points among positions: a capture has many splats where there is much to see."""
    if len(positions) > _SAMPLE:
        positions = positions[rng.choice(len(positions), _SAMPLE, replace=False)]
    low, high = _box(positions)
    side = float((high - low).max())
    # Floaters far outside.
    positions = positions[((positions > low - 0.1 * side) & (positions < high + 0.1 * side)).all(axis=1)]
    fine, rough = side / 1000.0, side / 4.0  # cells with more and with fewer points than wanted
    for _ in range(12):
        cell = math.sqrt(fine * rough)
        count = len(np.unique(np.floor(positions / cell), axis=0))
        fine, rough = (cell, rough) if count > _CLOUD else (fine, cell)
    _, first = np.unique(np.floor(positions / rough), axis=0, return_index=True)
    chosen = positions[first]
    _, near = cKDTree(positions).query(chosen, k=min(_NEIGHBOURS, len(positions)))
    around = positions[near] - positions[near].mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    return _Cloud(chosen, vectors[:, :, 0])


def _ups(normals: F64) -> list[F64]:
    """Returns directions that may be up: z, and those that many surfaces face, from either side."""
    k = np.arange(_DIRECTIONS) + 0.5
    z, turn = 1.0 - k / _DIRECTIONS, math.pi * (1.0 + math.sqrt(5.0)) * k  # evenly over the half sphere
    r = np.sqrt(1.0 - z * z)
    directions = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
    votes = (np.abs(directions @ normals.T) > math.cos(math.radians(_PEAK_DEG))).sum(axis=1)
    found: list[F64] = []
    for at in np.argsort(-votes, kind="stable"):
        if all(abs(directions[at] @ other) < math.cos(math.radians(_UP_DEG)) for other in found):
            found.append(_refined(directions[at], normals))
            if len(found) == _UPS:
                break
    z_alone = [] if any(abs(up[2]) > math.cos(math.radians(_PEAK_DEG)) for up in found) else [np.array([0.0, 0.0, 1.0])]
    return [*z_alone, *(sign * up for up in found for sign in (1.0, -1.0))]


def _refined(direction: F64, normals: F64) -> F64:
    near = normals[np.abs(normals @ direction) > math.cos(math.radians(_PEAK_DEG))]
    if not len(near):
        return direction
    mean = (near * np.sign(near @ direction)[:, None]).sum(axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def _candidates(cloud: _Cloud, surface: Surface) -> list[F64]:
    """Returns the likeliest transforms, (4, 4), rigid times a scale, the best first."""
    plans = _Plans(surface)
    matrices: list[F64] = []
    scores: list[float] = []
    for up in _ups(cloud.normals):
        R = np.eye(4)
        R[:3, :3] = rotation_to_z(up.tolist())
        upright, normals = cloud.points @ R[:3, :3].T, cloud.normals @ R[:3, :3].T
        levels, walls = _levels_and_walls(upright, normals)
        yaws = plans.yaws(normals)
        for scale in plans.scales(upright):
            z, level = plans.height(scale * levels[:, 2])
            for yaw in yaws:
                c, s = math.cos(yaw), math.sin(yaw)
                x, y, alike = plans.place(scale * walls[:, :2] @ np.array([[c, s], [-s, c]]))
                turn = np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]])
                matrices.append(turn @ np.diag([scale, scale, scale, 1.0]) @ R)
                scores.append(alike * level)
    every, marks = np.array(matrices), _marks(cloud)
    places = np.einsum("nij,kj->nki", every[:, :3, :3], marks) + every[:, None, :3, 3]
    sizes = np.linalg.norm(places[:, 1] - places[:, 0], axis=1)
    kept: list[int] = []
    for at in np.argsort(-np.array(scores), kind="stable"):
        apart = np.linalg.norm(places[kept] - places[at], axis=2).max(axis=1, initial=0.0)
        if (apart > 0.2 * sizes[at]).all():
            kept.append(int(at))
            if len(kept) == _KEPT:
                break
    return [every[at] for at in kept]


def _levels_and_walls(points: F64, normals: F64) -> tuple[F64, F64]:
    """Returns points (N, 3) with normals (N, 3) on floors and on walls; all of them where there are none."""
    steep = np.abs(normals[:, 2]) > _STEEP
    return points[steep if steep.any() else slice(None)], points[~steep if (~steep).any() else slice(None)]


class _Plans:
    """Floor plan and heights of a mesh, to be correlated with those of points."""

    def __init__(self, surface: Surface) -> None:
        levels, walls = _levels_and_walls(surface.points, surface.normals)
        self._low, high = _box(surface.points)
        self._radius, size = _radius(surface.points), high - self._low
        self._height = max(float(size[2]), 1e-3)
        self._cell, self._rise = max(float(size[:2].max()), 1e-3) / _CELLS, self._height / _LEVELS
        # Room for the longest plan of points, which is half as long again, beside that of the mesh.
        self._side, self._length = (fft.next_fast_len(5 * cells // 2 + 4) for cells in (_CELLS, _LEVELS))
        plan = _smoothed(_smoothed(self._image(walls[:, :2] - self._low[:2]), 0), 1)
        self._plan = np.conj(fft.rfft2(_of_length_1(plan)))
        self._levels = np.conj(fft.rfft(_of_length_1(_smoothed(self._profile(levels[:, 2] - self._low[2]), 0))))
        self._headings = np.conj(fft.rfft(_headings(surface.normals)))

    def scales(self, upright: F64) -> list[float]:
        """Returns the scales to try for points (N, 3) with z up."""
        low, high = _box(upright)
        tried: list[float] = []
        for ratio in (self._radius / max(_radius(upright), 1e-9), self._height / max(float(high[2] - low[2]), 1e-9)):
            for scale in ratio * _SCALE_STEP ** np.arange(-_SCALES_BELOW, _SCALES_ABOVE + 1):
                if all(abs(math.log(scale / other)) > 0.5 * math.log(_SCALE_STEP) for other in tried):
                    tried.append(float(scale))
        return tried

    def yaws(self, normals: F64) -> list[float]:
        """Returns the yaws, radians, by which walls with unit normals (N, 3) face where those of the mesh do."""
        both = fft.irfft(fft.rfft(_headings(normals)) * self._headings, n=_BINS)
        found: list[int] = []
        for at in np.argsort(-both, kind="stable"):
            apart = (abs((int(at) - other + _BINS // 2) % _BINS - _BINS // 2) * 180.0 / _BINS for other in found)
            if all(angle >= _YAW_DEG for angle in apart):
                found.append(int(at))
                if len(found) == _YAWS:
                    break
        return [turn - at * math.pi / _BINS for at in found for turn in (0.0, math.pi)]

    def place(self, points: F64) -> tuple[float, float, float]:
        """Returns how far to move points (N, 2) along x and y so that they cover the plan best, and the likeness of both, 0 to 1."""
        start = np.median(points, axis=0) - 0.75 * _CELLS * self._cell
        both = fft.irfft2(fft.rfft2(self._image(points - start)) * self._plan, s=(self._side, self._side))
        at = int(np.argmax(both))
        shift = (np.array(divmod(at, self._side)) + self._side // 2) % self._side - self._side // 2
        x, y = self._low[:2] - start - shift * self._cell
        return float(x), float(y), float(both.flat[at])

    def height(self, z: F64) -> tuple[float, float]:
        """Returns how far to move heights (N,), and the likeness, as ``place``."""
        start = float(np.median(z)) - 0.75 * _LEVELS * self._rise
        both = fft.irfft(fft.rfft(self._profile(z - start)) * self._levels, n=self._length)
        at = int(np.argmax(both))
        shift = (at + self._length // 2) % self._length - self._length // 2
        return float(self._low[2] - start - shift * self._rise), float(both[at])

    def _image(self, points: F64) -> F64:
        """Returns the plan of points (N, 2), of length 1."""
        index = np.floor(points / self._cell).astype(np.int64)
        index = index[((index >= 0) & (index < 1.5 * _CELLS)).all(axis=1)]
        counts = np.bincount(index[:, 0] * self._side + index[:, 1], minlength=self._side**2)
        image = np.sqrt(counts).reshape(self._side, self._side)
        return _of_length_1(image)

    def _profile(self, z: F64) -> F64:
        """Returns how many of heights (N,) are in each cell, of length 1."""
        index = np.floor(z / self._rise).astype(np.int64)
        counts = np.bincount(index[(index >= 0) & (index < 1.5 * _LEVELS)], minlength=self._length)
        return _of_length_1(np.sqrt(counts))


def _box(points: F64) -> tuple[F64, F64]:
    """Returns the corners of the box of points (N, 3), without the few farthest."""
    low, high = np.percentile(points, [1.0, 99.0], axis=0)
    return low, high


def _radius(points: F64) -> float:
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


def _smoothed(values: F64, axis: int) -> F64:
    return np.asarray(values + 0.5 * np.roll(values, 1, axis) + 0.5 * np.roll(values, -1, axis))


def _of_length_1(values: F64) -> F64:
    return np.asarray(values / max(float(np.linalg.norm(values)), 1e-9))


def _headings(normals: F64) -> F64:
    """Returns how many of unit normals (N, 3), those of walls, have each heading of half a turn, smoothed, (_BINS,)."""
    walls = normals[np.abs(normals[:, 2]) <= _STEEP]
    angles = np.arctan2(walls[:, 1], walls[:, 0]) % math.pi
    counts = np.bincount(np.minimum((angles * _BINS / math.pi).astype(np.int64), _BINS - 1), minlength=_BINS)
    return _smoothed(counts.astype(np.float64), 0)


def _onto(points: F64, surface: Surface, start: F64, tolerances: tuple[float, float], rounds: int) -> tuple[F64, float]:
    """Returns the transform that brings points onto a surface, from one near it, and the share of them that are then near it.

    Args:
        points: (N, 3).
        surface: the surface.
        start: (4, 4), a rigid transform times a scale.
        tolerances: distances, metres, beyond which points do not count: in the first round and at last.
        rounds: number of rounds.
    """
    matrix = start.copy()
    for tolerance in np.geomspace(tolerances[0], tolerances[1], rounds):
        moved = transform_points(matrix, points)
        distances, nearest = surface.nearest(moved)
        weights = np.square(np.maximum(1.0 - np.square(distances / tolerance), 0.0))  # Tukey
        normals, middle = surface.normals[nearest], moved.mean(axis=0)
        offset = moved - middle
        rows = np.concatenate([np.cross(offset, normals), normals, (offset * normals).sum(axis=1, keepdims=True)], axis=1)
        off = ((surface.points[nearest] - moved) * normals).sum(axis=1)
        weighted = rows * weights[:, None]
        A = weighted.T @ rows
        # What no surface holds, such as sliding along a single floor, stays as it is.
        step = np.linalg.solve(A + np.eye(7) * (1e-6 * np.trace(A) + 1e-9), weighted.T @ off)
        matrix = _step(step, middle) @ matrix
    distances, _ = surface.nearest(transform_points(matrix, points))
    return matrix, float((distances < _NEAR).mean())


def _step(step: F64, middle: F64) -> F64:
    """Returns the transform (4, 4) of a step (7,): rotation and scale about ``middle``, and translation."""
    angle = float(np.linalg.norm(step[:3]))
    R = np.eye(3)
    if angle > 1e-12:
        x, y, z = step[:3] / angle
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        R = np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * (K @ K)
    out = np.eye(4)
    out[:3, :3] = math.exp(min(max(float(step[6]), -0.2), 0.2)) * R
    out[:3, 3] = middle + step[3:6] - out[:3, :3] @ middle
    return out
