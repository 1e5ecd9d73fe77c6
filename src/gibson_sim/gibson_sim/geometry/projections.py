"""Camera models: from the optical frame (x right, y down, z forward, metres) to pixels and back; pixel centres are at whole numbers.

pinhole
    ``K`` maps (x / z, y / z), distorted by plumb_bob or rational_polynomial, to pixels.
fisheye
    ``K`` maps the unit direction in the image times the angle from the axis, distorted by equidistant, to pixels.
equirectangular
    ``K`` maps (longitude, -latitude) to pixels: longitude 0 is the z axis, at the middle of the image, and increases to the right, to
    pi at the right edge; latitude increases upwards (-y), to pi / 2 at the top edge. Square pixels have ``width = 2 height``.

The depth of a pinhole camera is measured along its axis; for the other cameras depth is the distance from the camera's centre.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.geometry.distortion import distort, distort_angle, undistort, undistort_angle
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.types import CameraSpec

_ANGLE_EPSILON = 1e-9
"""Tolerance of the field of view for rounding errors, radians."""


def project(points: ArrayLike, camera: CameraSpec) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Projects points to the image plane, also beyond the edges of the image.

    Args:
        points: (N, 3), optical frame, metres.
        camera: the camera.

    Returns:
        (u, v), (N, 2), pixels, NaN for points without a projection (at or behind a pinhole's plane, outside a fisheye's ``fov``, beyond
        the valid radius of the distortion); and their depth, (N,), metres.
    """
    p = np.asarray(points, dtype=np.float64)
    x, y, z = p[:, 0], p[:, 1], p[:, 2]
    k = camera.intrinsics()
    if camera.projection == "pinhole":
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = np.where(z > 0.0, p[:, :2].T / z, np.nan).T
        if any(camera.distortion):
            plane, _ = distort(plane, camera.distortion)
        return plane @ k[:2, :2].T + k[:2, 2], z.copy()
    distance = np.linalg.norm(p, axis=1)
    axis_distance = np.hypot(x, y)
    if camera.projection == "fisheye":
        theta = np.arctan2(axis_distance, z)
        radius = np.where(theta <= camera.fov / 2.0 + _ANGLE_EPSILON, distort_angle(theta, camera.distortion), np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(axis_distance > 0.0, radius / axis_distance, np.where(radius == 0.0, 0.0, np.nan))
            plane = p[:, :2] * scale[:, None]
    else:
        plane = np.stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))], axis=-1)
    plane[distance == 0.0] = np.nan
    return plane @ k[:2, :2].T + k[:2, 2], distance


def unproject(pixels: ArrayLike, camera: CameraSpec) -> NDArray[np.float64]:
    """Returns the points at depth 1, (..., 3), optical frame, of pixels (..., 2); NaN for pixels outside the field of view."""
    uv = np.asarray(pixels, dtype=np.float64)
    k = camera.intrinsics()
    py = (uv[..., 1] - k[1, 2]) / k[1, 1]
    px = (uv[..., 0] - k[0, 2] - k[0, 1] * py) / k[0, 0]
    if camera.projection == "pinhole":
        if any(camera.distortion):
            px, py = np.moveaxis(undistort(np.stack([px, py], axis=-1), camera.distortion), -1, 0)
        return np.stack([px, py, np.where(np.isnan(px), np.nan, 1.0)], axis=-1)
    if camera.projection == "fisheye":
        radius = np.hypot(px, py)
        theta = undistort_angle(radius, camera.distortion)
        theta = np.where(theta <= camera.fov / 2.0 + _ANGLE_EPSILON, theta, np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(radius > 0.0, np.sin(theta) / radius, 1.0)
        return np.stack([px * scale, py * scale, np.cos(theta)], axis=-1)
    valid = (np.abs(px) <= np.pi + _ANGLE_EPSILON) & (np.abs(py) <= np.pi / 2.0 + _ANGLE_EPSILON)
    rays = np.stack([np.cos(py) * np.sin(px), np.sin(py), np.cos(py) * np.cos(px)], axis=-1)
    rays[~valid] = np.nan
    return rays


def rays(camera: CameraSpec) -> NDArray[np.float64]:
    """Returns the point at depth 1 of each pixel, (H, W, 3), optical frame; NaN for pixels outside the field of view.

    The points are unit vectors for fisheye and equirectangular cameras, and have z = 1 for pinhole cameras.
    """
    v, u = np.mgrid[: camera.height, : camera.width]
    return unproject(np.stack([u, v], axis=-1), camera)


def back_project(depth: ArrayLike, camera: CameraSpec) -> NDArray[np.float64]:
    """Returns the points of a depth image (H, W), metres, in the optical frame, (H, W, 3), metres; NaN where the depth is not finite."""
    d = np.asarray(depth, dtype=np.float64)
    return rays(camera) * np.where(np.isfinite(d), d, np.nan)[..., None]


def clip_from_optical(intrinsics: ArrayLike, width: int, height: int, near: float) -> Mat4:
    """Returns the matrix, (4, 4), from a pinhole's optical frame to clip coordinates; the image is x / w and y / w in [-1, 1].

    y / w = -1 is the top edge of the image, so that OpenGL, whose row 0 is at the bottom, writes the top row first. z / w is
    ``near / depth``, 1 at the near plane and 0 at infinity, which suits the precision of floats. Pixel centres are at whole numbers, so the
    left edge of the image is at u = -0.5.

    Args:
        intrinsics: K, (3, 3), pixels.
        width: width of the image, pixels.
        height: height of the image, pixels.
        near: depth of the near plane, metres.
    """
    k = np.asarray(intrinsics, dtype=np.float64)
    to_clip = np.array([[2.0 / width, 0.0, 1.0 / width - 1.0], [0.0, 2.0 / height, 1.0 / height - 1.0]])
    out = np.zeros((4, 4))
    out[:2, :3] = to_clip @ k
    out[2, 3] = near
    out[3, 2] = 1.0
    return out


def frustum_planes(intrinsics: ArrayLike, width: int, height: int, near: float) -> NDArray[np.float64]:
    """Returns the planes left, right, top, bottom and near, (5, 4): x (optical frame, metres) is inside if ``planes @ (x, 1) >= 0`` for all.

    For the arguments see ``clip_from_optical``.
    """
    x, y, z, w = clip_from_optical(intrinsics, width, height, near)
    return np.stack([w + x, w - x, w + y, w - y, w - z])
