"""Error model of depth cameras: noise, disparity quantisation, holes and range limits. Pure.

Special values follow REP 117 and REP 118: +inf = nothing in range, -inf = too near to measure, NaN = a failed measurement (a hole).
"""

from __future__ import annotations

import math
import zlib
from dataclasses import replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.projections import rays
from gibson_sim.types import CameraSpec, DepthNoise, Frame, ImageEffects, Pose

_NO_NOISE = DepthNoise()
_PIXELS_AT_ONCE = 32_768
"""Number of pixels processed at a time, in strips of rows: intermediate results stay in the CPU cache, which is four times faster."""
F32 = NDArray[np.float32]


def apply_depth_noise(frame: Frame, noise: DepthNoise) -> Frame:
    """Returns the frame with the depths that a real camera would report; other arrays are shared with ``frame``, which is not modified.

    Errors are applied in the order of a sensor: normally distributed noise, ``sigma(z) = constant + linear z + quadratic z^2``; rounding of
    the disparity ``fx baseline / z`` to whole steps; range limits (nearer than ``range_min`` or the camera's ``near``: -inf; beyond its
    ``far``: +inf); then holes, NaN, at grazing angles and at random. The errors depend only on the seed, the stamp and the camera's name,
    so images may be processed in any order.

    Args:
        frame: frame with depth; grazing angles are computed from its normals if it has them, else from the depths.
        noise: error model; without errors, or without depth, the frame itself is returned.

    Raises:
        ConfigError: disparity quantisation is requested for a camera that is not a pinhole.
    """
    if frame.depth is None or noise == replace(_NO_NOISE, seed=noise.seed, baseline=noise.baseline):
        return frame
    camera = frame.camera
    true_depth, depth = frame.depth, np.empty(frame.depth.shape, dtype=np.float32)
    errors, holes = (_generator(frame, noise, purpose) for purpose in (0, 1))
    focal = _focal(camera) if noise.disparity_step_px > 0.0 else 0.0
    least = np.float32(max(noise.range_min, camera.near))
    cosine = math.cos(math.radians(noise.hole_angle_deg))
    rows = max(1, _PIXELS_AT_ONCE // camera.width)
    for first in range(0, camera.height, rows):
        part = slice(first, min(first + rows, camera.height))
        strip = depth[part]
        _add_noise(true_depth[part], noise, errors, strip)
        if focal:
            _quantise(strip, noise, focal)
        with np.errstate(invalid="ignore"):
            strip[strip > camera.far] = np.inf
            strip[strip < least] = -np.inf
        if noise.hole_fraction > 0.0:
            failed = holes.random(strip.shape, dtype=np.float32) < np.float32(noise.hole_fraction)
            strip[failed & np.isfinite(true_depth[part])] = np.nan
        if noise.hole_angle_deg < 90.0:
            strip[_grazing(frame, part, cosine)] = np.nan
    return replace(frame, depth=depth)


def _generator(frame: Frame, noise: DepthNoise, purpose: int) -> np.random.Generator:
    """Returns the generator for an image and a purpose, so that one setting does not change the random numbers of another."""
    entropy = [noise.seed, frame.stamp_ns, zlib.crc32(frame.camera.name.encode()), purpose]
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(entropy)))


def sigma(depth: NDArray[np.floating], noise: DepthNoise) -> F32:
    """Returns the standard deviation of the measured depth, metres, for true depths, metres."""
    z = np.asarray(depth, dtype=np.float32)
    return np.float32(noise.constant) + z * (np.float32(noise.linear) + np.float32(noise.quadratic) * z)


def _add_noise(true_depth: F32, noise: DepthNoise, rng: np.random.Generator, out: F32) -> None:
    """Fills ``out`` with the depths plus normally distributed errors; +inf is kept."""
    if not (noise.constant or noise.linear or noise.quadratic):
        out[:] = true_depth
        return
    rng.standard_normal(dtype=np.float32, out=out)
    with np.errstate(invalid="ignore"):  # +inf times 0
        out *= sigma(true_depth, noise)
        out += true_depth
    out[true_depth == np.inf] = np.inf


def _quantise(depth: F32, noise: DepthNoise, focal: float) -> None:
    """Quantises disparities in place; a disparity of 0 becomes a depth of +inf."""
    steps_at_1_m = np.float32(focal * noise.baseline / noise.disparity_step_px)
    with np.errstate(divide="ignore"):
        np.divide(steps_at_1_m, depth, out=depth)
        np.rint(depth, out=depth)
        np.divide(steps_at_1_m, depth, out=depth)


def _focal(camera: CameraSpec) -> float:
    if camera.projection != "pinhole":
        raise ConfigError(
            f"camera {camera.name!r}: depth_noise.disparity_step_px needs a pinhole camera, its projection is {camera.projection}; "
            "leave it out or use a pinhole camera"
        )
    return float(camera.intrinsics()[0, 0])


def _grazing(frame: Frame, rows: slice, cosine: float) -> NDArray[np.bool_]:
    """Returns a mask of the pixels in ``rows`` where the cosine between the ray and the normal is below ``cosine``."""
    assert frame.depth is not None
    camera = frame.camera
    around = slice(max(rows.start - 1, 0), min(rows.stop + 1, camera.height))  # slopes need neighbours
    depth, ray = frame.depth[around], _ray(camera, around)
    k = camera.intrinsics().astype(np.float32)
    if frame.normal is None and _is_plain(camera):
        # On a plane w = 1 / z is linear in the pixels, and the normal n follows from its gradient: n = (fx dw/du, fy dw/dv, w - x nx - y ny),
        # with n ray = w.
        along = np.reciprocal(depth)
        nx, ny = _gradient(along, 1) * k[0, 0], _gradient(along, 0) * k[1, 1]
        square = nx * nx + ny * ny + np.square(along - ray[0] * nx - ray[1] * ny)
    else:
        n = np.moveaxis(_normals(depth, ray) if frame.normal is None else frame.normal[around], 2, 0)
        along = n[0] * ray[0] + n[1] * ray[1] + n[2] * ray[2]
        square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
    with np.errstate(invalid="ignore"):
        length = ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]
        flat: NDArray[np.bool_] = along * along < np.float32(cosine * cosine) * square * length
    flat &= np.isfinite(depth)
    return flat[rows.start - around.start : rows.stop - around.start]


def _is_plain(camera: CameraSpec) -> bool:
    return camera.projection == "pinhole" and not any(camera.distortion) and camera.intrinsics()[0, 1] == 0.0


def _ray(camera: CameraSpec, rows: slice) -> tuple[Any, ...]:
    """Returns x, y and z of the points at depth 1 of the pixels in ``rows``, in shapes that broadcast to (rows, W)."""
    if not _is_plain(camera):
        return tuple(np.moveaxis(_rays(_optics(camera))[rows], 2, 0))
    k = camera.intrinsics()
    x = (np.arange(camera.width) - k[0, 2]) / k[0, 0]
    y = (np.arange(rows.start, rows.stop) - k[1, 2]) / k[1, 1]
    return x.astype(np.float32)[None, :], y.astype(np.float32)[:, None], np.float32(1.0)


def _normals(depth: F32, ray: tuple[Any, ...]) -> F32:
    """Returns normals of any length, (H, W, 3), of the surfaces in a depth image."""
    with np.errstate(invalid="ignore"):
        points = np.stack([np.broadcast_to(r, depth.shape) * depth for r in ray], axis=-1)
    points[~np.isfinite(points)] = 0.0
    right, down = (np.stack([_gradient(points[:, :, i], axis) for i in range(3)], axis=-1) for axis in (1, 0))
    return np.asarray(np.cross(right, down), dtype=np.float32)


@lru_cache(maxsize=8)
def _rays(optics: CameraSpec) -> F32:
    return rays(optics).astype(np.float32)


def _optics(camera: CameraSpec) -> CameraSpec:
    """Returns the camera with all fields neutral that its rays do not depend on, so that cameras with equal optics share rays."""
    return replace(
        camera, name="", link="", pose=Pose(), rate_hz=1.0, outputs=("depth",), effects=ImageEffects(), depth_noise=_NO_NOISE
    )


def _gradient(image: F32, axis: int) -> F32:
    """Returns the smaller of the differences to the two neighbours along an axis, to avoid differences across edges."""
    step = np.diff(image, axis=axis)
    leading, trailing = ((1, 0, 0, 0), (0, 1, 0, 0)) if axis == 0 else ((0, 0, 1, 0), (0, 0, 0, 1))
    a = cv2.copyMakeBorder(step, *leading, cv2.BORDER_REPLICATE)
    b = cv2.copyMakeBorder(step, *trailing, cv2.BORDER_REPLICATE)
    return np.where(np.abs(a) < np.abs(b), a, b)
