"""Corrects poses that are a little off: photographs are moved until they agree with the mean colours of the surface, and depths with it.

After Zhou and Koltun, "Color Map Optimization for 3D Reconstruction with Consumer Depth Cameras", SIGGRAPH 2014, with rigid corrections:
the colour of each point is the mean over the photographs that show it, then every pose takes a Gauss-Newton step towards the mean of the
others, again and again. Where depth was measured, its points are drawn onto the surface along its normals (point-to-plane ICP with
projective association), which aligns what has no pattern. A prior holds poses of photographs with little texture, and none moves farther
than a limit.
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
from gibson_sim.geometry.triangles import unit_normals
from gibson_sim_tools.photographs.photographs import Photographs
from gibson_sim_tools.scanning.posed_rgbd import Intrinsics
from gibson_sim_tools.texturing.exposure import Exposures
from gibson_sim_tools.texturing.quality import SAMPLES, Views, intrinsics_radius, sampled
from gibson_sim_tools.texturing.surface import Surface, project

F16 = NDArray[np.float16]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_ROUNDS = 20
_LARGEST = 800
"""Longest side of the images that are aligned, pixels. All are held in memory, as half floats."""
_BLUR_PX = (2.5, 1.0)
"""Standard deviation of their filter, pixels: in the first half of the rounds and in the second."""
_POINTS = 4
"""Points of each triangle."""
_NOISE = 0.04
"""Residual at which a point counts half, and the scale of residuals beside the prior; luma, 0 to 1."""
_PRIOR_M, _PRIOR_DEG = 0.01, 0.5
"""Standard deviation of corrections that are expected."""
_POINTS_PER_FACT = 10.0
"""Points that count as one observation, since neighbours err alike."""
_DEPTH_NOISE, _DEPTH_NOISE_SQUARE = 0.01, 0.003
"""Distance from the surface at which a depth counts half: metres, and metres by depth squared."""
_MOST_FACES = 4000
"""Triangles of a photograph that it is aligned by: more make it slower, and hardly better."""
_LEAST_POINTS = 50
"""Photographs with fewer points in common with others keep their poses."""


@dataclass(frozen=True, slots=True, eq=False)
class RefinedPoses:
    """Poses, and how they changed."""

    poses: F64
    """T_world_camera, (P, 4, 4)."""
    moved_m: F64
    """(P,): distance from the given position."""
    turned_deg: F64
    """(P,): angle from the given orientation."""
    kept: int
    """Photographs whose correction was beyond the limits, and which keep their poses."""


def refine_poses(
    surface: Surface, photographs: Photographs, views: Views, exposures: Exposures, *, most_m: float, most_deg: float,
    progress: Callable[[float], None] = lambda _: None,
) -> RefinedPoses:  # fmt: skip
    """Returns corrected poses.

    Args:
        surface: what the photographs show.
        photographs: at the poses to correct.
        views: triangles in photographs.
        exposures: of the photographs.
        most_m: largest correction of a position, metres.
        most_deg: largest correction of an orientation, degrees.
        progress: called with the fraction that is done, 0 to 1.
    """
    points = np.einsum("sk,fkc->fsc", SAMPLES[:_POINTS], surface.corners).reshape(-1, 3)
    rows = [(faces[:, None] * _POINTS + np.arange(_POINTS)).ravel() for faces in _chosen_faces(views, len(photographs))]
    normals = unit_normals(surface.corners)
    cameras, images, depths = [], [], []
    for number in range(len(photographs)):
        camera, image = _luma(photographs, number, exposures)
        cameras.append(camera)
        images.append(image.astype(np.float16))
        depths.append(_depth(photographs, number, camera))
        progress(0.3 * (number + 1) / len(photographs))
    given = photographs.poses
    poses = given.copy()
    soft = images
    for turn in range(_ROUNDS):
        blur = _BLUR_PX[turn >= _ROUNDS // 2]
        if turn in (0, _ROUNDS // 2):
            soft = [np.asarray(cv2.GaussianBlur(image.astype(np.float32), (0, 0), blur), dtype=np.float16) for image in images]
        values = [_values(soft[k].astype(np.float32), points[rows[k]], cameras[k], poses[k]) for k in range(len(poses))]
        total, count = np.zeros(len(points)), np.zeros(len(points))
        for row, value in zip(rows, values, strict=True):
            good = np.isfinite(value)
            total[row[good]] += value[good]
            count[row[good]] += 1.0
        for k in range(len(poses)):
            row, value = rows[k], values[k]
            good = np.isfinite(value) & (count[row] >= 2.0)
            if good.sum() < _LEAST_POINTS:
                continue
            others = (total[row[good]] - value[good]) / (count[row[good]] - 1.0)
            rest = value[good] - others
            system = _by_colour(soft[k].astype(np.float32), points[row[good]], rest, cameras[k], poses[k])
            depth = depths[k]
            if depth is not None:
                measured = _by_depth(depth, points[row], normals[row // _POINTS], cameras[k], poses[k])
                system = (system[0] + measured[0], system[1] + measured[1])
            poses[k] = _stepped(system, poses[k], given[k])
        progress(0.3 + 0.7 * (turn + 1) / _ROUNDS)
    moved = np.linalg.norm(poses[:, :3, 3] - given[:, :3, 3], axis=1)
    turned = np.degrees(Rotation.from_matrix(given[:, :3, :3].transpose(0, 2, 1) @ poses[:, :3, :3]).magnitude())
    far = (moved > most_m) | (turned > most_deg)
    poses[far], moved[far], turned[far] = given[far], 0.0, 0.0
    return RefinedPoses(poses, moved, turned, int(far.sum()))


def _chosen_faces(views: Views, count: int) -> list[I64]:
    """Returns the triangles that each of ``count`` photographs is aligned by.

    All photographs choose by one random order, so that those that show the same triangles choose the same ones.
    """
    rank = np.random.default_rng(0).permutation(int(views.face.max(initial=-1)) + 1)
    order = np.lexsort((rank[views.face], views.photograph))
    ends = np.searchsorted(views.photograph[order], np.arange(count + 1))
    return [views.face[order[a : min(b, a + _MOST_FACES)]].astype(np.int64) for a, b in pairwise(ends)]


def _luma(photographs: Photographs, number: int, exposures: Exposures) -> tuple[Intrinsics, F32]:
    """Returns a photograph as luma, 0 to 1, not larger than necessary, with its intrinsics."""
    full = photographs.intrinsics(number)
    corrected = exposures.corrected(number, photographs.picture(number), intrinsics_radius(full))
    luma = cv2.cvtColor(corrected, cv2.COLOR_RGB2GRAY)
    share = _LARGEST / max(full.width, full.height)
    if share < 1.0:
        full = full.resized(round(full.width * share), round(full.height * share))
        luma = cv2.resize(luma, (full.width, full.height), interpolation=cv2.INTER_AREA)
    return full, np.asarray(luma, dtype=np.float32)


def _values(image: F32, points: F64, camera: Intrinsics, T_world_camera: F64) -> F64:
    """Returns the values of an image at points (N, 3) of the world; NaN outside of it."""
    uv, _ = project(points, camera, T_world_camera)
    with np.errstate(invalid="ignore"):
        inside = ((uv >= 1.0) & (uv <= (camera.width - 2.0, camera.height - 2.0))).all(axis=1)
    out = np.full(len(points), np.nan)
    out[inside] = sampled(image, uv[inside].astype(np.float32))
    return out


def _depth(photographs: Photographs, number: int, camera: Intrinsics) -> F16 | None:
    """Returns the measured depth (H, W) at the pixels of a camera, metres, NaN = unknown; None = not measured."""
    depth = photographs.depth(number)
    if depth is None:
        return None
    return np.asarray(cv2.resize(depth, (camera.width, camera.height), interpolation=cv2.INTER_NEAREST), dtype=np.float16)


def _by_colour(image: F32, points: F64, rest: F64, camera: Intrinsics, T_world_camera: F64) -> tuple[F64, F64]:
    """Returns the normal equations, (6, 6) and (6,), of the motion of a camera that lowers the residuals (N,) at points (N, 3)."""
    p, uv = _seen_at(points, camera, T_world_camera)
    at = uv.astype(np.float32)
    across, down = np.array([0.5, 0.0], dtype=np.float32), np.array([0.0, 0.5], dtype=np.float32)
    slope_x = (sampled(image, at + across) - sampled(image, at - across)).astype(np.float64)
    slope_y = (sampled(image, at + down) - sampled(image, at - down)).astype(np.float64)
    x, y, z = p.T
    # Of the value by the point in the frame of the camera, then by shift and turn of that frame.
    by_point = np.stack(
        [slope_x * camera.fx / z, slope_y * camera.fy / z, -(slope_x * camera.fx * x + slope_y * camera.fy * y) / z**2], axis=1
    )
    J = np.concatenate([by_point, np.cross(p, by_point)], axis=1)
    weights = 1.0 / (1.0 + (rest / _NOISE) ** 2) / (_NOISE**2 * _POINTS_PER_FACT)
    return (J * weights[:, None]).T @ J, -(J.T @ (weights * rest))


def _by_depth(depth: F16, points: F64, normals: F64, camera: Intrinsics, T_world_camera: F64) -> tuple[F64, F64]:
    """Returns the normal equations of the motion that brings points (N, 3) with normals (N, 3), world frame, to the depth (H, W)."""
    p, uv = _seen_at(points, camera, T_world_camera)
    with np.errstate(invalid="ignore"):
        inside = ((uv >= 0.0) & (uv <= (camera.width - 1.0, camera.height - 1.0))).all(axis=1)
    p, (column, row) = p[inside], np.rint(uv[inside]).astype(np.int64).T
    n = normals[inside] @ T_world_camera[:3, :3]
    measured = depth[row, column].astype(np.float64)
    known = np.isfinite(measured)
    p, n, measured = p[known], n[known], measured[known]
    rest = (1.0 - measured / p[:, 2]) * np.einsum("ij,ij->i", n, p)
    J = np.concatenate([n, np.cross(p, n)], axis=1)
    noise = _DEPTH_NOISE + _DEPTH_NOISE_SQUARE * measured**2
    weights = 1.0 / (1.0 + (rest / noise) ** 2) / (noise**2 * _POINTS_PER_FACT)
    return (J * weights[:, None]).T @ J, -(J.T @ (weights * rest))


def _seen_at(points: F64, camera: Intrinsics, T_world_camera: F64) -> tuple[F64, F64]:
    """Returns points (N, 3) of the world in the frame of a camera, (N, 3), and their pixels (N, 2)."""
    T = invert(T_world_camera)
    return points @ T[:3, :3].T + T[:3, 3], project(points, camera, T_world_camera)[0]


def _stepped(system: tuple[F64, F64], T_world_camera: F64, given: F64) -> F64:
    """Returns a pose after one Gauss-Newton step of normal equations, (6, 6) and (6,), and the prior around the given pose."""
    prior = np.array([_PRIOR_M] * 3 + [math.radians(_PRIOR_DEG)] * 3) ** -2.0
    offset = _difference(T_world_camera, given)
    change = np.linalg.solve(system[0] + np.diag(prior), system[1] - prior * offset)
    moved = np.eye(4)
    moved[:3, :3] = Rotation.from_rotvec(change[3:]).as_matrix()
    moved[:3, 3] = change[:3]
    return np.asarray(T_world_camera @ invert(moved))


def _difference(T_world_camera: F64, given: F64) -> F64:
    """Returns shift and turn (6,) that took the frame of a camera from its given pose to its present one."""
    D = invert(T_world_camera) @ given
    return np.concatenate([D[:3, 3], Rotation.from_matrix(D[:3, :3]).as_rotvec()])
