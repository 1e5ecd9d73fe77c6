"""Refines camera poses by direct photometric alignment, and by point-to-plane ICP where depth was measured.

After Zhou and Koltun, "Color Map Optimization for 3D Reconstruction with Consumer Depth Cameras", SIGGRAPH 2014, with rigid corrections. The
optimisation alternates: the luma of each surface point is its mean over the photographs that show it; then each pose takes a Gauss-Newton step
that reduces the residuals to the mean of the other photographs. Measured depth adds point-to-plane residuals with projective association, which
align surfaces without texture. A Gaussian prior keeps the poses of photographs with little texture. Corrections beyond a limit are rejected.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gibson_sim.geometry.transforms import invert
from gibson_sim.geometry.triangle_meshes import unit_normals
from gibson_sim_tools.scanning.posed_images import Intrinsics, Photographs
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh
from gibson_sim_tools.texturing.exposure import Exposures
from gibson_sim_tools.texturing.quality import SAMPLE_WEIGHTS, Views, normalised_radius, sample_bilinear
from gibson_sim_tools.texturing.surface import project

F16 = NDArray[np.float16]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_ITERATIONS = 20
"""Iterations, each with one Gauss-Newton step of every pose."""
_LONGEST_SIDE_PX = 800
"""Longest side of the aligned images, pixels. All are kept in memory as float16."""
_BLUR_SIGMA_PX = (2.5, 1.0)
"""Standard deviation of their Gaussian blur, pixels: first and second half of the iterations (coarse to fine)."""
_POINTS_PER_FACE = 4
"""Sample points of each triangle."""
_COLOR_NOISE = 0.04
"""Standard deviation of photometric residuals and scale of their Cauchy weights, luma, 0 to 1."""
_PRIOR_TRANSLATION, _PRIOR_ROTATION_DEG = 0.01, 0.5
"""Standard deviations of the prior on corrections, metres and degrees."""
_POINTS_PER_OBSERVATION = 10.0
"""Number of points that count as one observation, because errors of neighbouring points are correlated."""
_DEPTH_NOISE, _DEPTH_NOISE_QUADRATIC = 0.01, 0.003
"""Standard deviation of depth and scale of its Cauchy weights: metres, and metres per squared metre of depth."""
_MAX_FACES = 4000
"""Largest number of triangles by which a photograph is aligned; more take longer and hardly improve the pose."""
_MIN_POINTS = 50
"""Least number of points that a refined photograph shares with others; poses with fewer stay."""


@dataclass(frozen=True, slots=True, eq=False)
class RefinedPoses:
    """Refined poses of P photographs, and the size of their corrections."""

    poses: F64
    """T_world_camera, (P, 4, 4), optical frame."""
    translation_m: F64
    """(P,), distance from the initial position, metres."""
    rotation_deg: F64
    """(P,), angle from the initial orientation, degrees."""
    rejected_count: int
    """Number of photographs whose corrections exceeded the limits; they keep their initial poses."""


def refine_poses(
    surface: TriangleMesh, photographs: Photographs, views: Views, exposures: Exposures, *, max_translation_m: float, max_rotation_deg: float,
    progress: Callable[[float], None] = lambda _: None,
) -> RefinedPoses:  # fmt: skip
    """Returns refined poses.

    Args:
        surface: mesh, world frame.
        photographs: at their initial poses.
        views: visible triangles of each photograph.
        exposures: calibration of the photographs.
        max_translation_m: largest correction of a position, metres.
        max_rotation_deg: largest correction of an orientation, degrees.
        progress: called with the fraction that is done, 0 to 1.
    """
    points = np.einsum("sk,fkc->fsc", SAMPLE_WEIGHTS[:_POINTS_PER_FACE], surface.corners).reshape(-1, 3)
    point_rows = [
        (faces[:, None] * _POINTS_PER_FACE + np.arange(_POINTS_PER_FACE)).ravel()
        for faces in _select_faces(views, len(photographs))
    ]
    normals = unit_normals(surface.corners)
    cameras, images, depths = [], [], []
    for number in range(len(photographs)):
        camera, image = _luma(photographs, number, exposures)
        cameras.append(camera)
        images.append(image.astype(np.float16))
        depths.append(_resized_depth(photographs, number, camera))
        progress(0.3 * (number + 1) / len(photographs))
    given = photographs.poses
    poses = given.copy()
    blurred = images
    for iteration in range(_ITERATIONS):
        sigma = _BLUR_SIGMA_PX[iteration >= _ITERATIONS // 2]
        if iteration in (0, _ITERATIONS // 2):
            blurred = [
                np.asarray(cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma), dtype=np.float16) for image in images
            ]
        values = [
            _sample_at_points(blurred[k].astype(np.float32), points[point_rows[k]], cameras[k], poses[k])
            for k in range(len(poses))
        ]
        total, count = np.zeros(len(points)), np.zeros(len(points))
        for own_rows, own_values in zip(point_rows, values, strict=True):
            is_valid = np.isfinite(own_values)
            total[own_rows[is_valid]] += own_values[is_valid]
            count[own_rows[is_valid]] += 1.0
        for k in range(len(poses)):
            own_rows, own_values = point_rows[k], values[k]
            is_valid = np.isfinite(own_values) & (count[own_rows] >= 2.0)
            if is_valid.sum() < _MIN_POINTS:
                continue
            mean_of_others = (total[own_rows[is_valid]] - own_values[is_valid]) / (count[own_rows[is_valid]] - 1.0)
            residuals = own_values[is_valid] - mean_of_others
            system = _photometric_system(
                blurred[k].astype(np.float32), points[own_rows[is_valid]], residuals, cameras[k], poses[k]
            )
            depth = depths[k]
            if depth is not None:
                measured = _point_to_plane_system(
                    depth, points[own_rows], normals[own_rows // _POINTS_PER_FACE], cameras[k], poses[k]
                )
                system = (system[0] + measured[0], system[1] + measured[1])
            poses[k] = _gauss_newton_step(system, poses[k], given[k])
        progress(0.3 + 0.7 * (iteration + 1) / _ITERATIONS)
    translation = np.linalg.norm(poses[:, :3, 3] - given[:, :3, 3], axis=1)
    rotation = np.degrees(Rotation.from_matrix(given[:, :3, :3].transpose(0, 2, 1) @ poses[:, :3, :3]).magnitude())
    is_rejected = (translation > max_translation_m) | (rotation > max_rotation_deg)
    poses[is_rejected], translation[is_rejected], rotation[is_rejected] = given[is_rejected], 0.0, 0.0
    return RefinedPoses(poses, translation, rotation, int(is_rejected.sum()))


def _select_faces(views: Views, count: int) -> list[I64]:
    """Returns for each of ``count`` photographs the triangles by which it is aligned, at most ``_MAX_FACES``.

    All photographs use the same random order of the triangles, so that those with a common view select the same ones.
    """
    rank = np.random.default_rng(0).permutation(int(views.face.max(initial=-1)) + 1)
    order = np.lexsort((rank[views.face], views.photograph))
    ends = np.searchsorted(views.photograph[order], np.arange(count + 1))
    return [views.face[order[a : min(b, a + _MAX_FACES)]].astype(np.int64) for a, b in pairwise(ends)]


def _luma(photographs: Photographs, number: int, exposures: Exposures) -> tuple[Intrinsics, F32]:
    """Returns a photograph's exposure-compensated luma, (H, W), 0 to 1, scaled down to ``_LONGEST_SIDE_PX``, and its intrinsics."""
    intrinsics = photographs.intrinsics(number)
    corrected = exposures.corrected(number, photographs.image(number), normalised_radius(intrinsics))
    luma = cv2.cvtColor(corrected, cv2.COLOR_RGB2GRAY)
    scale = _LONGEST_SIDE_PX / max(intrinsics.width, intrinsics.height)
    if scale < 1.0:
        intrinsics = intrinsics.resized(round(intrinsics.width * scale), round(intrinsics.height * scale))
        luma = cv2.resize(luma, (intrinsics.width, intrinsics.height), interpolation=cv2.INTER_AREA)
    return intrinsics, np.asarray(luma, dtype=np.float32)


def _sample_at_points(image: F32, points: F64, camera: Intrinsics, T_world_camera: F64) -> F64:
    """Returns the values (N,) of an image at the projections of points (N, 3), world frame, metres; NaN outside the image."""
    uv, _ = project(points, camera, T_world_camera)
    with np.errstate(invalid="ignore"):
        inside = ((uv >= 1.0) & (uv <= (camera.width - 2.0, camera.height - 2.0))).all(axis=1)
    values = np.full(len(points), np.nan)
    values[inside] = sample_bilinear(image, uv[inside].astype(np.float32))
    return values


def _resized_depth(photographs: Photographs, number: int, camera: Intrinsics) -> F16 | None:
    """Returns the measured depth (H, W) at the pixels of a camera, metres, NaN = no depth; None = the photograph has no depth image."""
    depth = photographs.depth(number)
    if depth is None:
        return None
    return np.asarray(cv2.resize(depth, (camera.width, camera.height), interpolation=cv2.INTER_NEAREST), dtype=np.float16)


def _photometric_system(image: F32, points: F64, residuals: F64, camera: Intrinsics, T_world_camera: F64) -> tuple[F64, F64]:
    """Returns the weighted normal equations of the photometric residuals: J^T W J (6, 6) and -J^T W r (6,); translation, then rotation.

    Args:
        image: (H, W), luma, 0 to 1.
        points: (N, 3), world frame, metres.
        residuals: (N,), r, luma.
        camera: intrinsics of the image.
        T_world_camera: (4, 4), optical frame.
    """
    p, uv = _camera_points(points, camera, T_world_camera)
    pixels = uv.astype(np.float32)
    half_column, half_row = np.array([0.5, 0.0], dtype=np.float32), np.array([0.0, 0.5], dtype=np.float32)
    slope_x = (sample_bilinear(image, pixels + half_column) - sample_bilinear(image, pixels - half_column)).astype(np.float64)
    slope_y = (sample_bilinear(image, pixels + half_row) - sample_bilinear(image, pixels - half_row)).astype(np.float64)
    x, y, z = p.T
    # Derivative of the luma with respect to the point in the camera frame; J follows with respect to translation and rotation.
    gradient = np.stack(
        [slope_x * camera.fx / z, slope_y * camera.fy / z, -(slope_x * camera.fx * x + slope_y * camera.fy * y) / z**2], axis=1
    )
    J = np.concatenate([gradient, np.cross(p, gradient)], axis=1)
    weights = 1.0 / (1.0 + (residuals / _COLOR_NOISE) ** 2) / (_COLOR_NOISE**2 * _POINTS_PER_OBSERVATION)
    return (J * weights[:, None]).T @ J, -(J.T @ (weights * residuals))


def _point_to_plane_system(depth: F16, points: F64, normals: F64, camera: Intrinsics, T_world_camera: F64) -> tuple[F64, F64]:
    """Returns the weighted normal equations, as ``_photometric_system``, of the point-to-plane distances of the depth image to the surface.

    Args:
        depth: (H, W), metres along the optical axis, NaN = no depth.
        points: (N, 3), surface points, world frame, metres.
        normals: (N, 3), their unit normals, world frame.
        camera: intrinsics of the depth image.
        T_world_camera: (4, 4), optical frame.
    """
    p, uv = _camera_points(points, camera, T_world_camera)
    with np.errstate(invalid="ignore"):
        inside = ((uv >= 0.0) & (uv <= (camera.width - 1.0, camera.height - 1.0))).all(axis=1)
    p, (column, row) = p[inside], np.rint(uv[inside]).astype(np.int64).T
    n = normals[inside] @ T_world_camera[:3, :3]
    measured = depth[row, column].astype(np.float64)
    is_known = np.isfinite(measured)
    p, n, measured = p[is_known], n[is_known], measured[is_known]
    residuals = (1.0 - measured / p[:, 2]) * np.einsum("ij,ij->i", n, p)
    J = np.concatenate([n, np.cross(p, n)], axis=1)
    deviation = _DEPTH_NOISE + _DEPTH_NOISE_QUADRATIC * measured**2
    weights = 1.0 / (1.0 + (residuals / deviation) ** 2) / (deviation**2 * _POINTS_PER_OBSERVATION)
    return (J * weights[:, None]).T @ J, -(J.T @ (weights * residuals))


def _camera_points(points: F64, camera: Intrinsics, T_world_camera: F64) -> tuple[F64, F64]:
    """Returns points (N, 3), world frame, in the camera frame, (N, 3), metres, and their projections (N, 2), pixels."""
    T = invert(T_world_camera)
    return points @ T[:3, :3].T + T[:3, 3], project(points, camera, T_world_camera)[0]


def _gauss_newton_step(system: tuple[F64, F64], T_world_camera: F64, given: F64) -> F64:
    """Returns T_world_camera after one Gauss-Newton step.

    Args:
        system: normal equations, (6, 6) and (6,).
        T_world_camera: (4, 4), current pose.
        given: (4, 4), initial T_world_camera, mean of the prior.
    """
    prior = np.array([_PRIOR_TRANSLATION] * 3 + [math.radians(_PRIOR_ROTATION_DEG)] * 3) ** -2.0
    offset = _pose_difference(T_world_camera, given)
    step = np.linalg.solve(system[0] + np.diag(prior), system[1] - prior * offset)
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(step[3:]).as_matrix()
    motion[:3, 3] = step[:3]
    return np.asarray(T_world_camera @ invert(motion))


def _pose_difference(T_world_camera: F64, given: F64) -> F64:
    """Returns translation and rotation vector (6,), metres and radians, of the initial camera frame in the current one."""
    D = invert(T_world_camera) @ given
    return np.concatenate([D[:3, 3], Rotation.from_matrix(D[:3, :3]).as_rotvec()])
