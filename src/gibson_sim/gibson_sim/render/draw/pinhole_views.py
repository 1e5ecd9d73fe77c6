"""Pinhole views from which the image of a non-pinhole camera is resampled, since OpenGL cannot project straight lines to curves.

A pinhole camera without distortion is its own view. Any other camera is resampled from one wider view if that does not take far more
pixels, else from the visible part of each visible face of a cube. Texels are dense enough that the nearest one is at most half an image
pixel away, wherever neighbouring pixels show different directions (at the poles they do not).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.projections import unproject
from gibson_sim.geometry.transforms import Mat3
from gibson_sim.types import CameraSpec, DepthNoise, ImageEffects, Pose, Projection

GUARD = 2
"""Width of the border around a view, texels, so that every sampled texel has neighbours."""
_ONE_VIEW = math.radians(75.0)
"""Largest angle from the optical axis covered by a single view, radians."""
_ONE_VIEW_COST = 2.0
"""Largest ratio of the pixels of a single view to those of a cube: each cube face plans and transforms the scene once more."""
_WIDEST_PINHOLE = math.radians(175.0)
_LARGEST_VIEW = 16384
"""Longest side of a view, pixels."""
_PROBES = 4096
"""Number of pixels at which the required texel density of a view is computed."""
_STRETCH: dict[Projection, float] = {"pinhole": math.inf, "fisheye": 2.0, "equirectangular": 1.0}
"""Largest anisotropy resolved by a view. Near the poles, and near the point behind a fisheye, whole rows show one direction, so a higher
density gains nothing."""
_CUBE: tuple[tuple[tuple[float, float, float], ...], ...] = (
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
)
"""R_camera_view of the faces front, right, left, below, above and behind."""


@dataclass(frozen=True, slots=True, eq=False)
class PinholeView:
    """A pinhole view from the centre of a camera."""

    R_camera_view: Mat3
    """(3, 3): from the optical frame of the view to that of the camera."""
    intrinsics: NDArray[np.float64]
    """K, (3, 3), pixels, pixel centres at whole numbers."""
    width: int
    """Width, pixels."""
    height: int
    """Height, pixels."""


def is_plain(camera: CameraSpec) -> bool:
    """Returns whether OpenGL can draw the camera directly: a pinhole camera without distortion, with any K."""
    return camera.projection == "pinhole" and not any(camera.distortion)


def views_of(camera: CameraSpec) -> tuple[PinholeView, ...]:
    """Returns the views that a camera's image is resampled from.

    Raises:
        ConfigError: no pixel is within the field of view, the field of view exceeds that of a pinhole, or a view would be too large.
    """
    if is_plain(camera):
        return (PinholeView(np.eye(3), camera.intrinsics(), camera.width, camera.height),)
    return _views(_optics(camera))


def lookup(
    camera: CameraSpec, views: Sequence[PinholeView], pixels: ArrayLike
) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """Returns the positions of a camera's pixels in its views.

    Args:
        camera: camera whose optics are used.
        views: views of the camera.
        pixels: (..., 2), (u, v).

    Returns:
        The index of the view, (...), -1 = outside the field of view; the position in the view, (..., 2), pixels; and the depth along the
        view's axis of a point at depth 1 of the camera, (...).
    """
    rays = unproject(pixels, camera)
    valid = np.asarray(np.isfinite(rays).all(axis=-1))
    number = _nearest_axis(np.where(valid[..., None], rays, 0.0), [view.R_camera_view for view in views])
    position, scale = np.full((*rays.shape[:-1], 2), np.nan), np.zeros(rays.shape[:-1])
    for k, view in enumerate(views):
        in_view = valid & (number == k)
        p = rays[in_view] @ view.R_camera_view @ view.intrinsics.T
        scale[in_view] = p[:, 2]
        position[in_view] = p[:, :2] / p[:, 2:]
    return np.where(valid, number, -1), position, scale


def tap_pixels(camera: CameraSpec) -> NDArray[np.float64]:
    """Returns the positions in the image at which colours are sampled, (n H, n W, 2), n x n positions per pixel."""
    n = 2 if camera.samples > 1 else 1
    v, u = np.mgrid[: camera.height * n, : camera.width * n]
    return (np.stack([u, v], axis=-1) + 0.5) / n - 0.5


def _optics(camera: CameraSpec) -> CameraSpec:
    """Returns the camera with all fields neutral that its views do not depend on, so that a moving camera keeps its views."""
    return replace(
        camera, link="", pose=Pose(), near=0.05, far=100.0, rate_hz=1.0, outputs=("depth",), stereo_baseline=0.0,
        effects=ImageEffects(), depth_noise=DepthNoise(),
    )  # fmt: skip


@lru_cache(maxsize=64)
def _views(camera: CameraSpec) -> tuple[PinholeView, ...]:
    pixels = tap_pixels(camera).reshape(-1, 2)
    rays = unproject(pixels, camera)
    valid = np.isfinite(rays).all(axis=1)
    if not valid.any():
        raise ConfigError(
            f"camera {camera.name!r}: no pixel of the image lies within its distortion and field of view; check k and d"
        )
    pixels, rays = pixels[valid], rays[valid]
    widest = math.acos(min(1.0, float((rays[:, 2] / np.linalg.norm(rays, axis=1)).min())))
    if camera.projection == "pinhole" and 2.0 * widest >= _WIDEST_PINHOLE:
        raise ConfigError(
            f"camera {camera.name!r}: a pixel of the distorted image is {math.degrees(widest):.0f} degrees off the optical axis, "
            f"must be less than {math.degrees(_WIDEST_PINHOLE / 2):g}; check k and d, or use projection fisheye"
        )
    frames = [np.array(axes, dtype=np.float64).T for axes in _CUBE]
    number = _nearest_axis(rays, frames)
    parts = ((frame, number == k) for k, frame in enumerate(frames))
    cube = tuple(_view(camera, frame, pixels[mask], rays[mask]) for frame, mask in parts if mask.any())
    if widest <= _ONE_VIEW:
        one = _view(camera, frames[0], pixels, rays)
        if one.width * one.height <= _ONE_VIEW_COST * sum(view.width * view.height for view in cube):
            cube = (one,)
    for view in cube:
        if max(view.width, view.height) > _LARGEST_VIEW:
            raise ConfigError(
                f"camera {camera.name!r}: resampling its image needs a view of {view.width}x{view.height} pixels, "
                f"each side must be at most {_LARGEST_VIEW}; choose a smaller image or a narrower field of view"
            )
    return cube


def _view(camera: CameraSpec, R_camera_view: Mat3, pixels: NDArray[np.float64], rays: NDArray[np.float64]) -> PinholeView:
    """Returns the view with the given axes that covers the rays of pixels."""
    focal = _focal_lengths(camera, R_camera_view, pixels)
    p = rays @ R_camera_view
    places = p[:, :2] / p[:, 2:] * focal
    first = np.floor(places.min(axis=0)) - GUARD
    width, height = (int(n) for n in np.ceil(places.max(axis=0)) + GUARD - first + 1)
    intrinsics = np.array([[focal[0], 0.0, -first[0]], [0.0, focal[1], -first[1]], [0.0, 0.0, 1.0]])
    return PinholeView(R_camera_view, intrinsics, width, height)


def _focal_lengths(camera: CameraSpec, R_camera_view: Mat3, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the focal lengths of a view, texels, (2,), at which texel corners are half an image pixel from the texel's centre."""
    probes = pixels[np.linspace(0, len(pixels) - 1, min(len(pixels), _PROBES)).astype(np.intp)]
    step = 0.25
    columns = []
    for axis in (0, 1):
        ends = [unproject(probes + sign * step * np.eye(2)[axis], camera) @ R_camera_view for sign in (1, -1)]
        first, last = (p[:, :2] / p[:, 2:] for p in ends)
        columns.append((first - last) / (2.0 * step))
    jacobian = np.stack(columns, axis=-1)  # (N, 2, 2): of the view's plane with respect to the image
    jacobian = jacobian[np.isfinite(jacobian).all(axis=(1, 2))]
    if not len(jacobian):
        return np.diag(camera.intrinsics())[:2].copy()
    most = _STRETCH[camera.projection] / float(np.linalg.norm(jacobian, 2, axis=(1, 2)).min())
    with np.errstate(divide="ignore", invalid="ignore"):
        # The columns of the inverse: motion in the image for a step along x and along y of the plane, (N, 2).
        adjugate = np.stack([jacobian[:, 1, ::-1], jacobian[:, 0, ::-1]], axis=-1) * [[1.0, -1.0], [-1.0, 1.0]]
        along = adjugate / np.linalg.det(jacobian)[:, None, None]
        texels = np.nanmax(np.linalg.norm(along, axis=1), axis=0)
        if (texels > most).any():
            return np.asarray(math.sqrt(2.0) * np.minimum(texels, most))
        across = along / texels
        corners = np.linalg.norm(across @ np.array([[1.0, 1.0], [1.0, -1.0]]), axis=1)
    return np.asarray(float(np.nanmax(corners)) * texels)


def _nearest_axis(rays: NDArray[np.float64], frames: Sequence[Mat3]) -> NDArray[np.intp]:
    """Returns the index of the frame whose z axis is nearest to each ray, (...)."""
    return np.asarray(np.argmax(np.stack([rays @ frame[:, 2] for frame in frames], axis=-1), axis=-1))
