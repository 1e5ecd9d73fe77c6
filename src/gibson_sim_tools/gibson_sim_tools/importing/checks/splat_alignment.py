"""Registers the splats of a scene to its mesh: finds their pose and scale.

Both represent the same room, but a capture has an arbitrary origin and scale, and often another up axis. Frequent normals are candidates for
up; for each, the floor plans and the height profiles of both are cross-correlated, at candidate yaws and at scales around the ratio of
their sizes. The best candidates are refined by point-to-plane ICP with seven degrees of freedom (rotation, translation, scale) and robust
weights.
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
    MAX_SPLAT_DISTANCE,
    SOLID_OPACITY,
    SplatDistance,
    Surface,
    has_area,
    measure_distance,
    sample_positions,
    solid_positions,
)

F64 = NDArray[np.float64]

_CLOUD_POINTS, _COARSE_POINTS, _SURFACE_POINTS = 3000, 500, 200_000
"""Number of evenly spread splats used for registration, of those used in its coarse rounds, and of sample points on the mesh."""
_MAX_SPLATS = 100_000
"""Maximum number of splats from which the evenly spread ones are selected."""
_MIN_SPLATS = 100
"""Minimum number of solid splats."""
_NEIGHBOURS = 16
"""Number of neighbours from which the normal at a point is estimated."""
_DIRECTIONS = 1500
"""Number of directions in which frequent normals are searched."""
_UP_DIRECTIONS, _UP_SEPARATION_DEG, _UP_TOLERANCE_DEG = 3, 20.0, 6.0
"""Number of up candidates, each with its opposite; minimum angle between two; maximum angle between a candidate and the normals that vote
for it."""
_HEADING_BINS, _YAWS, _YAW_SEPARATION_DEG = 60, 4, 10.0
"""Number of bins over 180 degrees for the headings of walls; number of yaw candidates, each with its opposite; minimum angle between two."""
_PLAN_CELLS = 56
"""Number of cells of a floor plan along the longer side of the mesh."""
_HEIGHT_CELLS = 50
"""Number of cells of a height profile over the height of the mesh."""
_SCALE_STEP, _SCALES_BELOW, _SCALES_ABOVE = 1.07, 12, 5
"""Ratio of consecutive candidate scales, and their number below and above the ratio of the sizes. A capture of one storey of two has half
the size of the mesh."""
_FLOOR_NORMAL_Z = 0.7
"""z component of a unit normal above which a surface is a floor or ceiling, not a wall."""
_COARSE_CANDIDATES, _FINE_CANDIDATES = 80, 6
"""Number of candidates for coarse registration, and of those for registration with all points."""
_DISTINCT_POSES_M = 0.2
"""Distance between the positions of a reference point above which two results are distinct poses, m."""
_FIT_DISTANCE = 0.05
"""Distance from the mesh within which a splat fits, m."""
_MIN_IMPROVEMENT = 0.001
"""Minimum decrease of the median distance, m."""
_MIN_FIT, _MIN_LEAD = 0.88, 0.02
"""Minimum share of splats that fit, and its minimum lead over any other pose."""


@dataclass(frozen=True, slots=True)
class SplatAlignment:
    """Result of registering the splats of a scene to its mesh."""

    spec: SplatsSpec
    """Splats with the new pose and scale."""
    before: SplatDistance
    """Distance from the mesh before registration."""
    after: SplatDistance
    """Distance from the mesh after registration."""

    def text(self) -> str:
        """Returns the distances before and after as text."""
        return f"before: {self.before.text()}\nafter: {self.after.text()}"


@dataclass(frozen=True, slots=True, eq=False)
class _Cloud:
    points: F64
    """Points, (N, 3), m, about evenly spread over the surfaces."""
    normals: F64
    """Unit normals, (N, 3), of arbitrary sign."""


def align_splats(spec: SplatsSpec, corners: F64, rng: np.random.Generator) -> SplatAlignment:
    """Registers the splats of a scene to its mesh.

    Args:
        spec: the splats of the scene. Among poses with a similar fit, the one near the present pose is selected.
        corners: corners of all visual triangles, (F, 3, 3), world frame, metres, z up.
        rng: samples points.

    Raises:
        MeshError: the file of the splats cannot be read.
        SceneError: the splats or the mesh are too small, no pose fits, several fit, or none fits better than the present one.
    """
    splats = load_splats(Path(spec.file))
    positions = solid_positions(spec, splats)
    if len(positions) < _MIN_SPLATS:
        raise SceneError(
            f"{spec.file}: has {len(positions)} splats with an opacity of at least {SOLID_OPACITY}; {_MIN_SPLATS} are needed to align them"
        )
    low, high = _box(positions)
    if not (high - low).max() > 0.0:
        raise SceneError(f"{spec.file}: all splats are at the same position, {', '.join(f'{c:g}' for c in low)}")
    if not has_area(corners):
        raise SceneError(f"{spec.file}: the scene has no visual mesh to which the splats could be registered")
    surface, sample = Surface(corners, rng, _SURFACE_POINTS), sample_positions(positions, rng)
    before = measure_distance(splats, sample, surface)
    matrix = _register(spec.file, _cloud(positions, rng), surface, rng)
    after = measure_distance(splats, transform_points(matrix, sample), surface)
    if after.median > min(before.median - _MIN_IMPROVEMENT, MAX_SPLAT_DISTANCE):
        reason = (
            "which is not closer than the present pose"
            if after.median <= MAX_SPLAT_DISTANCE
            else f"more than the {100.0 * MAX_SPLAT_DISTANCE:g} cm that are allowed"
        )
        raise SceneError(
            f"{spec.file}: the pose of the splats is unchanged: in the best pose found, half of the solid splats are within "
            f"{100.0 * after.median:.1f} cm of the mesh, {reason}"
        )
    return SplatAlignment(moved_splats(spec, matrix), before, after)


def moved_splats(spec: SplatsSpec, matrix: F64) -> SplatsSpec:
    """Returns splats after a similarity transform, (4, 4), world frame.

    Raises:
        SceneError: their scale would be out of range.
    """
    factor = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    pose, scale = matrix @ matrix_from_pose(spec.pose), spec.scale * factor
    if not SPLAT_SCALES[0] <= scale <= SPLAT_SCALES[1]:
        raise SceneError(
            f"{spec.file}: the splats would fit with a scale of {scale:g}, must be {SPLAT_SCALES[0]:g} to {SPLAT_SCALES[1]:g}"
        )
    pose[:3, :3] /= factor
    return replace(spec, pose=pose_from_matrix(pose), scale=scale)


def _register(file: str, cloud: _Cloud, surface: Surface, rng: np.random.Generator) -> F64:
    """Returns the similarity transform, (4, 4), that registers a cloud to a surface.

    Raises:
        SceneError: no transform fits, or several do.
    """
    coarse_points = cloud.points[rng.permutation(len(cloud.points))[:_COARSE_POINTS]]
    matrices = [np.eye(4), *_candidates(cloud, surface)]
    coarse = [_icp(coarse_points, surface, matrix, (1.0, 0.1), 8) for matrix in matrices]
    order = [0, *(k for k in sorted(range(len(coarse)), key=lambda k: -coarse[k][1]) if k)][: _FINE_CANDIDATES + 1]
    # The first result is the one that started from the present pose.
    fine = [_icp(cloud.points, surface, coarse[k][0], (0.15, 0.02), 15) for k in order]
    best = max(fine, key=lambda pair: pair[1])
    if best[1] < _MIN_FIT:
        raise SceneError(
            f"{file}: no pose and scale fit the splats to the mesh: at best {100.0 * best[1]:.0f} % of the solid ones are "
            f"within {100.0 * _FIT_DISTANCE:g} cm of it, {100.0 * _MIN_FIT:g} % are needed; "
            "use splats of this room, or give an approximate pose and scale in scene.yaml"
        )
    if fine[0][1] > best[1] - _MIN_LEAD:
        return fine[0][0]
    references = _reference_points(cloud)
    positions = [transform_points(matrix, references) for matrix, _ in fine]
    best_positions = transform_points(best[0], references)
    rivals = [
        share
        for (_, share), other in zip(fine, positions, strict=True)
        if np.linalg.norm(other - best_positions, axis=1).max() > _DISTINCT_POSES_M
    ]
    if max(rivals, default=0.0) > best[1] - _MIN_LEAD:
        raise SceneError(
            f"{file}: several poses fit equally well, with {100.0 * best[1]:.0f} % and {100.0 * max(rivals):.0f} % of the solid splats within "
            f"{100.0 * _FIT_DISTANCE:g} cm of the mesh; give an approximate pose and scale in scene.yaml; the nearest pose is then selected"
        )
    return best[0]


def _reference_points(cloud: _Cloud) -> F64:
    """Returns four points, (4, 3), whose positions determine a transform: the middle of a cloud, and one on each axis at its median radius."""
    middle = np.median(cloud.points, axis=0)
    size = float(np.median(np.linalg.norm(cloud.points - middle, axis=1)))
    return np.concatenate([middle[None], middle + size * np.eye(3)])


def _cloud(positions: F64, rng: np.random.Generator) -> _Cloud:
    """Selects about evenly spread points among positions (N, 3), m; a capture has many splats where it has much detail."""
    if len(positions) > _MAX_SPLATS:
        positions = positions[rng.choice(len(positions), _MAX_SPLATS, replace=False)]
    low, high = _box(positions)
    side = float((high - low).max())
    # Remove floaters far outside.
    positions = positions[((positions > low - 0.1 * side) & (positions < high + 0.1 * side)).all(axis=1)]
    fine, coarse = side / 1000.0, side / 4.0  # cell sizes with more and with fewer points than wanted
    for _ in range(12):
        cell = math.sqrt(fine * coarse)
        count = len(np.unique(np.floor(positions / cell), axis=0))
        fine, coarse = (cell, coarse) if count > _CLOUD_POINTS else (fine, cell)
    _, first = np.unique(np.floor(positions / coarse), axis=0, return_index=True)
    selected = positions[first]
    _, neighbours = cKDTree(positions).query(selected, k=min(_NEIGHBOURS, len(positions)))
    centered = positions[neighbours] - positions[neighbours].mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centered, centered))
    return _Cloud(selected, vectors[:, :, 0])


def _up_candidates(normals: F64) -> list[F64]:
    """Returns candidates for up, unit vectors: z, and frequent normals with both signs."""
    k = np.arange(_DIRECTIONS) + 0.5
    z, turn = 1.0 - k / _DIRECTIONS, math.pi * (1.0 + math.sqrt(5.0)) * k  # Fibonacci lattice on the half sphere
    r = np.sqrt(1.0 - z * z)
    directions = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
    votes = (np.abs(directions @ normals.T) > math.cos(math.radians(_UP_TOLERANCE_DEG))).sum(axis=1)
    peaks: list[F64] = []
    for index in np.argsort(-votes, kind="stable"):
        if all(abs(directions[index] @ other) < math.cos(math.radians(_UP_SEPARATION_DEG)) for other in peaks):
            peaks.append(_mean_normal(directions[index], normals))
            if len(peaks) == _UP_DIRECTIONS:
                break
    z_alone = [] if any(abs(up[2]) > math.cos(math.radians(_UP_TOLERANCE_DEG)) for up in peaks) else [np.array([0.0, 0.0, 1.0])]
    return [*z_alone, *(sign * up for up in peaks for sign in (1.0, -1.0))]


def _mean_normal(direction: F64, normals: F64) -> F64:
    """Returns the mean of the normals near a direction, with its sign; the direction itself without any."""
    close_normals = normals[np.abs(normals @ direction) > math.cos(math.radians(_UP_TOLERANCE_DEG))]
    if not len(close_normals):
        return direction
    mean = (close_normals * np.sign(close_normals @ direction)[:, None]).sum(axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def _candidates(cloud: _Cloud, surface: Surface) -> list[F64]:
    """Returns candidate similarity transforms, (4, 4), the best first."""
    plan = _FloorPlan(surface)
    matrices: list[F64] = []
    scores: list[float] = []
    for up in _up_candidates(cloud.normals):
        R = np.eye(4)
        R[:3, :3] = rotation_to_z(up.tolist())
        upright, normals = cloud.points @ R[:3, :3].T, cloud.normals @ R[:3, :3].T
        floor_points, wall_points = _split_floors_and_walls(upright, normals)
        yaws = plan.yaws(normals)
        for scale in plan.scales(upright):
            z, height_score = plan.best_height_shift(scale * floor_points[:, 2])
            for yaw in yaws:
                c, s = math.cos(yaw), math.sin(yaw)
                x, y, plan_score = plan.best_shift(scale * wall_points[:, :2] @ np.array([[c, s], [-s, c]]))
                turn = np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]])
                matrices.append(turn @ np.diag([scale, scale, scale, 1.0]) @ R)
                scores.append(plan_score * height_score)
    transforms, references = np.array(matrices), _reference_points(cloud)
    positions = np.einsum("nij,kj->nki", transforms[:, :3, :3], references) + transforms[:, None, :3, 3]
    sizes = np.linalg.norm(positions[:, 1] - positions[:, 0], axis=1)
    kept: list[int] = []
    for index in np.argsort(-np.array(scores), kind="stable"):
        distances = np.linalg.norm(positions[kept] - positions[index], axis=2).max(axis=1, initial=0.0)
        if (distances > 0.2 * sizes[index]).all():
            kept.append(int(index))
            if len(kept) == _COARSE_CANDIDATES:
                break
    return [transforms[index] for index in kept]


def _split_floors_and_walls(points: F64, normals: F64) -> tuple[F64, F64]:
    """Returns the points on floors and ceilings, and those on walls; all points in place of an empty set."""
    is_floor = np.abs(normals[:, 2]) > _FLOOR_NORMAL_Z
    return points[is_floor if is_floor.any() else slice(None)], points[~is_floor if (~is_floor).any() else slice(None)]


class _FloorPlan:
    """Floor plan and height profile of a mesh, for cross-correlation with those of points."""

    def __init__(self, surface: Surface) -> None:
        levels, walls = _split_floors_and_walls(surface.points, surface.normals)
        self._low, high = _box(surface.points)
        self._radius, size = _radius(surface.points), high - self._low
        self._height = max(float(size[2]), 1e-3)
        self._cell, self._rise = max(float(size[:2].max()), 1e-3) / _PLAN_CELLS, self._height / _HEIGHT_CELLS
        # Zero padding for the largest plan of points, 1.5 times as long as that of the mesh.
        self._side, self._length = (fft.next_fast_len(5 * cells // 2 + 4) for cells in (_PLAN_CELLS, _HEIGHT_CELLS))
        plan = _smoothed(_smoothed(self._image(walls[:, :2] - self._low[:2]), 0), 1)
        self._plan = np.conj(fft.rfft2(_normalised(plan)))
        self._levels = np.conj(fft.rfft(_normalised(_smoothed(self._profile(levels[:, 2] - self._low[2]), 0))))
        self._headings = np.conj(fft.rfft(_heading_histogram(surface.normals)))

    def scales(self, upright: F64) -> list[float]:
        """Returns candidate scales for points (N, 3) with z up."""
        low, high = _box(upright)
        tried: list[float] = []
        for ratio in (self._radius / max(_radius(upright), 1e-9), self._height / max(float(high[2] - low[2]), 1e-9)):
            for scale in ratio * _SCALE_STEP ** np.arange(-_SCALES_BELOW, _SCALES_ABOVE + 1):
                if all(abs(math.log(scale / other)) > 0.5 * math.log(_SCALE_STEP) for other in tried):
                    tried.append(float(scale))
        return tried

    def yaws(self, normals: F64) -> list[float]:
        """Returns candidate yaws, radians, that align walls with unit normals (N, 3) with those of the mesh."""
        correlation = fft.irfft(fft.rfft(_heading_histogram(normals)) * self._headings, n=_HEADING_BINS)
        peaks: list[int] = []
        for index in np.argsort(-correlation, kind="stable"):
            differences = (
                abs((int(index) - other + _HEADING_BINS // 2) % _HEADING_BINS - _HEADING_BINS // 2) * 180.0 / _HEADING_BINS
                for other in peaks
            )
            if all(angle >= _YAW_SEPARATION_DEG for angle in differences):
                peaks.append(int(index))
                if len(peaks) == _YAWS:
                    break
        return [turn - index * math.pi / _HEADING_BINS for index in peaks for turn in (0.0, math.pi)]

    def best_shift(self, points: F64) -> tuple[float, float, float]:
        """Returns the shift of points (N, 2) along x and y, m, with the highest correlation with the plan, and that correlation, 0 to 1."""
        start = np.median(points, axis=0) - 0.75 * _PLAN_CELLS * self._cell
        correlation = fft.irfft2(fft.rfft2(self._image(points - start)) * self._plan, s=(self._side, self._side))
        index = int(np.argmax(correlation))
        shift = (np.array(divmod(index, self._side)) + self._side // 2) % self._side - self._side // 2
        x, y = self._low[:2] - start - shift * self._cell
        return float(x), float(y), float(correlation.flat[index])

    def best_height_shift(self, z: F64) -> tuple[float, float]:
        """Returns the shift of heights (N,), m, with the highest correlation with the profile, and that correlation, 0 to 1."""
        start = float(np.median(z)) - 0.75 * _HEIGHT_CELLS * self._rise
        correlation = fft.irfft(fft.rfft(self._profile(z - start)) * self._levels, n=self._length)
        index = int(np.argmax(correlation))
        shift = (index + self._length // 2) % self._length - self._length // 2
        return float(self._low[2] - start - shift * self._rise), float(correlation[index])

    def _image(self, points: F64) -> F64:
        """Returns the plan of points (N, 2), normalised to length 1."""
        index = np.floor(points / self._cell).astype(np.int64)
        index = index[((index >= 0) & (index < 1.5 * _PLAN_CELLS)).all(axis=1)]
        counts = np.bincount(index[:, 0] * self._side + index[:, 1], minlength=self._side**2)
        image = np.sqrt(counts).reshape(self._side, self._side)
        return _normalised(image)

    def _profile(self, z: F64) -> F64:
        """Returns the profile of heights (N,), normalised to length 1."""
        index = np.floor(z / self._rise).astype(np.int64)
        counts = np.bincount(index[(index >= 0) & (index < 1.5 * _HEIGHT_CELLS)], minlength=self._length)
        return _normalised(np.sqrt(counts))


def _box(points: F64) -> tuple[F64, F64]:
    """Returns the lower and upper corner of the bounding box of points (N, 3), without outliers."""
    low, high = np.percentile(points, [1.0, 99.0], axis=0)
    return low, high


def _radius(points: F64) -> float:
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


def _smoothed(values: F64, axis: int) -> F64:
    return np.asarray(values + 0.5 * np.roll(values, 1, axis) + 0.5 * np.roll(values, -1, axis))


def _normalised(values: F64) -> F64:
    return np.asarray(values / max(float(np.linalg.norm(values)), 1e-9))


def _heading_histogram(normals: F64) -> F64:
    """Returns a smoothed histogram, (_HEADING_BINS,), of the headings of walls over 180 degrees, from unit normals (N, 3)."""
    walls = normals[np.abs(normals[:, 2]) <= _FLOOR_NORMAL_Z]
    angles = np.arctan2(walls[:, 1], walls[:, 0]) % math.pi
    counts = np.bincount(
        np.minimum((angles * _HEADING_BINS / math.pi).astype(np.int64), _HEADING_BINS - 1), minlength=_HEADING_BINS
    )
    return _smoothed(counts.astype(np.float64), 0)


def _icp(points: F64, surface: Surface, start: F64, tolerances: tuple[float, float], rounds: int) -> tuple[F64, float]:
    """Registers points to a surface by ICP; returns the transform, (4, 4), and the share of points that fit.

    Args:
        points: (N, 3), metres.
        surface: the surface.
        start: initial similarity transform, (4, 4).
        tolerances: distances beyond which points have no weight, in the first and in the last round, metres.
        rounds: number of rounds.
    """
    matrix = start.copy()
    for tolerance in np.geomspace(tolerances[0], tolerances[1], rounds):
        moved = transform_points(matrix, points)
        distances, nearest = surface.nearest(moved)
        weights = np.square(np.maximum(1.0 - np.square(distances / tolerance), 0.0))  # Tukey's biweight
        normals, middle = surface.normals[nearest], moved.mean(axis=0)
        offset = moved - middle
        rows = np.concatenate([np.cross(offset, normals), normals, (offset * normals).sum(axis=1, keepdims=True)], axis=1)
        residuals = ((surface.points[nearest] - moved) * normals).sum(axis=1)
        weighted = rows * weights[:, None]
        A = weighted.T @ rows
        # Damping for unconstrained directions, such as sliding along a single floor.
        step = np.linalg.solve(A + np.eye(7) * (1e-6 * np.trace(A) + 1e-9), weighted.T @ residuals)
        matrix = _step_transform(step, middle) @ matrix
    distances, _ = surface.nearest(transform_points(matrix, points))
    return matrix, float((distances < _FIT_DISTANCE).mean())


def _step_transform(step: F64, middle: F64) -> F64:
    """Returns the transform, (4, 4), of a step, (7,): rotation vector and logarithm of the scale about ``middle``, and translation."""
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
