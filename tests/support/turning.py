"""Scans without a known up: meshes of depth images, and rotations of all kinds."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.importing.checks.gravity import guess_up
from gibson_sim_tools.scanning.posed_images import PosedRgbd

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
_STEP = 0.06
"""Of the depth: pixels that differ by more are not joined."""


def random_rotation(seed: int) -> F64:
    """Returns a rotation, (3, 3), all of them being as likely."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    q[:, 0] *= np.linalg.det(q)
    return np.asarray(q)


def depth_mesh(rgbd: PosedRgbd, every: int = 4) -> tuple[F64, I64]:
    """Returns vertices (V, 3) and triangles (F, 3) of the pixels of all frames, sheet upon sheet: noisy, with holes and frayed edges.

    Args:
        rgbd: a scan.
        every: take every so many pixels.
    """
    vertices, triangles, count = [], [], 0
    K = rgbd.intrinsics
    for frame in rgbd:
        depth = frame.depth[::every, ::every].astype(np.float64)
        v, u = np.mgrid[: depth.shape[0], : depth.shape[1]] * every
        points = np.stack([(u - K.cx) / K.fx * depth, (v - K.cy) / K.fy * depth, depth], axis=-1).reshape(-1, 3)
        number = np.arange(depth.size).reshape(depth.shape)
        quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
        quads = quads[np.isfinite(depth.ravel()[quads]).all(axis=1)]
        corners = depth.ravel()[quads]
        quads = quads[np.ptp(corners, axis=1) < _STEP * corners.mean(axis=1)]
        used = np.unique(quads)
        new = np.zeros(depth.size, dtype=np.int64)
        new[used] = count + np.arange(len(used))
        vertices.append(points[used] @ frame.T_world_camera[:3, :3].T + frame.T_world_camera[:3, 3])
        triangles.append(new[np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])])
        count += len(used)
    return np.concatenate(vertices), np.concatenate(triangles)


def verdict(vertices: F64, triangles: NDArray[np.integer], rotation: F64, most_deg: float = 2.0) -> str:
    """Returns ``upright``, ``not sure`` or ``wrong``: what comes of a mesh whose z is up once it is turned."""
    guess = guess_up(vertices @ rotation.T, triangles)
    if not guess.sure:
        return "not sure"
    return "upright" if float(np.asarray(guess.up) @ rotation[:, 2]) > math.cos(math.radians(most_deg)) else "wrong"
