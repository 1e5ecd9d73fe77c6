"""The pinhole camera: optical frame (x right, y down, z forward, metres) to pixels and back; pixel centres are at whole numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.geometry.transforms import Mat4


def project(points: ArrayLike, intrinsics: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Projects points to the image.

    Args:
        points: (N, 3), optical frame, metres.
        intrinsics: K, (3, 3), pixels.

    Returns:
        (u, v), (N, 2), pixels, NaN for points at or behind the camera's plane; and their depth along the axis, (N,), metres.
    """
    p = np.asarray(points, dtype=np.float64)
    k = np.asarray(intrinsics, dtype=np.float64)
    depth = p[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = (p @ k.T)[:, :2] / depth[:, None]
    pixels[depth <= 0.0] = np.nan
    return pixels, depth.copy()


def back_project(depth: ArrayLike, intrinsics: ArrayLike) -> NDArray[np.float64]:
    """Returns the points, (H, W, 3), optical frame, metres, of a depth image (H, W), metres along the axis; +inf gives NaN."""
    d = np.asarray(depth, dtype=np.float64)
    d = np.where(np.isfinite(d), d, np.nan)
    k = np.asarray(intrinsics, dtype=np.float64)
    v, u = np.mgrid[: d.shape[0], : d.shape[1]]
    y = (v - k[1, 2]) / k[1, 1]
    x = (u - k[0, 2] - k[0, 1] * y) / k[0, 0]
    return np.stack([x * d, y * d, d], axis=-1)


def clip_from_optical(intrinsics: ArrayLike, width: int, height: int, near: float) -> Mat4:
    """Returns the (4, 4) matrix from the optical frame to clip coordinates, in which x / w and y / w in [-1, 1] is the image.

    y / w = -1 is the image's top edge, so whoever draws bottom-up, as OpenGL does, gets row 0 = top in memory. z / w is
    ``near / depth``: 1 at the near plane, 0 infinitely far, which keeps precision where floats have it. Pixel centres at whole
    numbers put the image's left edge at u = -0.5.
    """
    k = np.asarray(intrinsics, dtype=np.float64)
    to_clip = np.array([[2.0 / width, 0.0, 1.0 / width - 1.0], [0.0, 2.0 / height, 1.0 / height - 1.0]])
    out = np.zeros((4, 4))
    out[:2, :3] = to_clip @ k
    out[2, 3] = near
    out[3, 2] = 1.0
    return out


def frustum_planes(intrinsics: ArrayLike, width: int, height: int, near: float) -> NDArray[np.float64]:
    """Returns the planes left, right, top, bottom and near, (5, 4): x is seen where ``planes @ (x, 1) >= 0`` for all of them."""
    x, y, z, w = clip_from_optical(intrinsics, width, height, near)
    return np.stack([w + x, w - x, w + y, w - y, w - z])
