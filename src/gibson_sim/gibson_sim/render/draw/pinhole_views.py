"""The pinhole pictures that cameras are made from. OpenGL draws straight lines only: whatever bends them is put together from these.

A pinhole without distortion is one view, itself. Anything else is made from one wider view where that does not take far more pixels,
and else from the faces of a cube, those that are seen, as much of each as is seen. Texels are so dense that the nearest one is at
most half a pixel of the image away, wherever pixels of the image show different directions (they do not at the poles).
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
"""Texels drawn around those that are needed: neighbours are looked at, and there is no edge to meet."""
_ONE_VIEW = math.radians(75.0)
"""Off the axis: a single view never has to appearance farther."""
_ONE_VIEW_COST = 2.0
"""How many times the pixels of a cube one view may have: each view means to sort and to transform the scene once more."""
_WIDEST_PINHOLE = math.radians(175.0)
_LARGEST_VIEW = 16384
_PROBES = 4096
_STRETCH: dict[Projection, float] = {"pinhole": math.inf, "fisheye": 2.0, "equirectangular": 1.0}
"""How much denser than along its densest direction an image may be drawn along the other one. Towards the poles, and the point behind
a fisheye, whole rows show one direction: there is nothing to be won."""
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
class View:
    """A pinhole picture with the camera's centre as its own."""

    R_camera_view: Mat3
    """(3, 3): optical axes of the view in the optical frame of the camera."""
    intrinsics: NDArray[np.float64]
    """K, (3, 3), pixels, pixel centres at whole numbers."""
    width: int
    """Pixels."""
    height: int
    """Pixels."""


def is_plain(camera: CameraSpec) -> bool:
    """Returns whether OpenGL draws the camera as it is: a pinhole without distortion, whatever its matrix."""
    return camera.projection == "pinhole" and not any(camera.distortion)


def views_of(camera: CameraSpec) -> tuple[View, ...]:
    """Returns the views that a camera is made from.

    Raises:
        ConfigError: the camera shows nothing at all, or more than a pinhole can, or needs views of a size that nothing draws.
    """
    if is_plain(camera):
        return (View(np.eye(3), camera.intrinsics(), camera.width, camera.height),)
    return _views(_optics(camera))


def lookup(
    camera: CameraSpec, views: Sequence[View], pixels: ArrayLike
) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """Says where in the views the camera's pixels are.

    Args:
        camera: its optics.
        views: those of the camera.
        pixels: (..., 2), (u, v).

    Returns:
        The number of the view, (...), -1 = the camera sees nothing there; the place in it, (..., 2), pixels; and the depth along the
        view's axis of what is at depth 1 of the camera, (...).
    """
    rays = unproject(pixels, camera)
    seen = np.asarray(np.isfinite(rays).all(axis=-1))
    number = _nearest_axis(np.where(seen[..., None], rays, 0.0), [view.R_camera_view for view in views])
    place, scale = np.full((*rays.shape[:-1], 2), np.nan), np.zeros(rays.shape[:-1])
    for k, view in enumerate(views):
        mine = seen & (number == k)
        p = rays[mine] @ view.R_camera_view @ view.intrinsics.T
        scale[mine] = p[:, 2]
        place[mine] = p[:, :2] / p[:, 2:]
    return np.where(seen, number, -1), place, scale


def tap_pixels(camera: CameraSpec) -> NDArray[np.float64]:
    """Returns the places in the image at which the colour is sampled, (n H, n W, 2), n x n of them in each pixel."""
    n = 2 if camera.samples > 1 else 1
    v, u = np.mgrid[: camera.height * n, : camera.width * n]
    return (np.stack([u, v], axis=-1) + 0.5) / n - 0.5


def _optics(camera: CameraSpec) -> CameraSpec:
    """Returns the camera without what its views do not depend on: one that moves keeps them."""
    return replace(
        camera, link="", pose=Pose(), near=0.05, far=100.0, rate_hz=1.0, outputs=("depth",), stereo_baseline=0.0,
        effects=ImageEffects(), depth_noise=DepthNoise(),
    )  # fmt: skip


@lru_cache(maxsize=64)
def _views(camera: CameraSpec) -> tuple[View, ...]:
    pixels = tap_pixels(camera).reshape(-1, 2)
    rays = unproject(pixels, camera)
    seen = np.isfinite(rays).all(axis=1)
    if not seen.any():
        raise ConfigError(
            f"camera {camera.name!r}: no pixel of the image lies within its distortion and field of view; check k and d"
        )
    pixels, rays = pixels[seen], rays[seen]
    widest = math.acos(min(1.0, float((rays[:, 2] / np.linalg.norm(rays, axis=1)).min())))
    if camera.projection == "pinhole" and 2.0 * widest >= _WIDEST_PINHOLE:
        raise ConfigError(
            f"camera {camera.name!r}: a pixel of the distorted image shows what is {math.degrees(widest):.0f} degrees off the axis, "
            f"must be less than {math.degrees(_WIDEST_PINHOLE / 2):g}; check k and d, or use projection fisheye"
        )
    frames = [np.array(axes, dtype=np.float64).T for axes in _CUBE]
    number = _nearest_axis(rays, frames)
    parts = ((frame, number == k) for k, frame in enumerate(frames))
    cube = tuple(_view(camera, frame, pixels[mine], rays[mine]) for frame, mine in parts if mine.any())
    if widest <= _ONE_VIEW:
        one = _view(camera, frames[0], pixels, rays)
        if one.width * one.height <= _ONE_VIEW_COST * sum(view.width * view.height for view in cube):
            cube = (one,)
    for view in cube:
        if max(view.width, view.height) > _LARGEST_VIEW:
            raise ConfigError(
                f"camera {camera.name!r}: to bend its image a view of {view.width}x{view.height} pixels is needed, "
                f"each side must be at most {_LARGEST_VIEW}; choose a smaller image or a narrower field of view"
            )
    return cube


def _view(camera: CameraSpec, R_camera_view: Mat3, pixels: NDArray[np.float64], rays: NDArray[np.float64]) -> View:
    """Returns the view along one frame that covers these rays of these pixels."""
    focal = _texels(camera, R_camera_view, pixels)
    p = rays @ R_camera_view
    places = p[:, :2] / p[:, 2:] * focal
    first = np.floor(places.min(axis=0)) - GUARD
    width, height = (int(n) for n in np.ceil(places.max(axis=0)) + GUARD - first + 1)
    intrinsics = np.array([[focal[0], 0.0, -first[0]], [0.0, focal[1], -first[1]], [0.0, 0.0, 1.0]])
    return View(R_camera_view, intrinsics, width, height)


def _texels(camera: CameraSpec, R_camera_view: Mat3, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns how many texels the plane z = 1 of a view needs along x and y, (2,), so that their corners are half a pixel away."""
    probes = pixels[np.linspace(0, len(pixels) - 1, min(len(pixels), _PROBES)).astype(np.intp)]
    step = 0.25
    columns = []
    for axis in (0, 1):
        ends = [unproject(probes + sign * step * np.eye(2)[axis], camera) @ R_camera_view for sign in (1, -1)]
        first, last = (p[:, :2] / p[:, 2:] for p in ends)
        columns.append((first - last) / (2.0 * step))
    jacobian = np.stack(columns, axis=-1)  # (N, 2, 2): of the plane by the image
    jacobian = jacobian[np.isfinite(jacobian).all(axis=(1, 2))]
    if not len(jacobian):
        return np.diag(camera.intrinsics())[:2].copy()
    most = _STRETCH[camera.projection] / float(np.linalg.norm(jacobian, 2, axis=(1, 2)).min())
    with np.errstate(divide="ignore", invalid="ignore"):
        # Where the image moves for a step along x and along y of the plane, (N, 2): the columns of the inverse.
        adjugate = np.stack([jacobian[:, 1, ::-1], jacobian[:, 0, ::-1]], axis=-1) * [[1.0, -1.0], [-1.0, 1.0]]
        along = adjugate / np.linalg.det(jacobian)[:, None, None]
        texels = np.nanmax(np.linalg.norm(along, axis=1), axis=0)
        if (texels > most).any():
            return np.asarray(math.sqrt(2.0) * np.minimum(texels, most))
        across = along / texels
        corners = np.linalg.norm(across @ np.array([[1.0, 1.0], [1.0, -1.0]]), axis=1)
    return np.asarray(float(np.nanmax(corners)) * texels)


def _nearest_axis(rays: NDArray[np.float64], frames: Sequence[Mat3]) -> NDArray[np.intp]:
    """Returns in front of which frame each ray is most, (...)."""
    return np.asarray(np.argmax(np.stack([rays @ frame[:, 2] for frame in frames], axis=-1), axis=-1))
