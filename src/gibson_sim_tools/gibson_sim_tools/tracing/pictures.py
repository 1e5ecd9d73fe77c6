"""Develops traced pictures as the camera of a scene does: exposure, white balance, tone curve, the view outside."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.geometry.colours import srgb8_from_linear, srgb_from_linear
from gibson_sim.render.draw.environment import load_environment, look_up
from gibson_sim.scenes.spec import LightSpec
from gibson_sim.types import CameraSpec
from gibson_sim_tools.making.pixels import exposure_factors, tone_map
from gibson_sim_tools.tracing.tracer import TracedPicture

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Rgb = NDArray[np.uint8]
Curve = Callable[[F32], Rgb]
"""Maps exposed linear colours to sRGB, 0 to 255."""
_STEP = 0.05
"""Step of the numerical derivatives, in logarithms of the factors."""
_STEPS = 12
_MAX_CHANGE = 1.0
"""Largest change of a factor's logarithm in one step."""


def curve_of(*, generated: bool) -> Curve:
    """Returns the tone curve of a scene's camera: that of the bake for a generated scene, none for others."""
    return tone_map if generated else srgb8_from_linear


def fit_exposure(traced: F32, ours: Rgb, curve: Curve) -> F64:
    """Returns the factors of red, green and blue with which the curve brings traced colours nearest to ours, by least squares (Gauss-Newton).

    Args:
        traced: linear colours, (N, 3).
        ours: our colours at the same places, (N, 3), sRGB.
        curve: the tone curve.

    Raises:
        SceneError: there is no pixel to compare.
    """
    if not len(traced):
        raise SceneError(
            "no picture shows a matte surface that stands still, from which the exposure could be told; use other poses"
        )
    target = ours.astype(np.float64)
    start = exposure_factors([traced]) if curve is tone_map else np.ones(3)
    log_factors = np.log(np.asarray(start, dtype=np.float64))

    def colors(at: F64) -> F64:
        return curve((traced * np.exp(at)).astype(np.float32)).astype(np.float64)

    def error(at: F64) -> float:
        return float(((colors(at) - target) ** 2).mean())

    best = error(log_factors)
    for _ in range(_STEPS):
        steps = _STEP * np.eye(3)
        slopes = np.stack(
            [(colors(log_factors + step) - colors(log_factors - step)).ravel() / (2 * _STEP) for step in steps], axis=1
        )
        residual = (target - colors(log_factors)).ravel()
        change = np.linalg.lstsq(slopes.T @ slopes + 1e-9 * np.eye(3), slopes.T @ residual, rcond=None)[0]
        change = np.clip(change, -_MAX_CHANGE, _MAX_CHANGE)
        while np.abs(change).max() > 1e-3 and error(log_factors + change) >= best:
            change = change / 2
        if np.abs(change).max() <= 1e-3:
            break
        log_factors = log_factors + change
        best = error(log_factors)
    return np.asarray(np.exp(log_factors))


@dataclass(frozen=True, slots=True, eq=False)
class Outside:
    """What a camera sees where the scene ends."""

    image: F32 | None
    """Equirectangular, linear, (H, 2 H, 3); None = a uniform background."""
    background: tuple[float, float, float]
    """Colour of the background, sRGB."""

    @classmethod
    def of(cls, light: LightSpec) -> Outside:
        """Returns the outside of a scene: its backdrop, its environment if that is visible, or its background."""
        path = light.backdrop or (light.environment if light.environment_visible else "")
        return cls(load_environment(Path(path)) if path else None, light.background)

    def seen(self, camera: CameraSpec, T_world_camera: F64) -> F64:
        """Returns the colours that a camera sees outside, (H, W, 3), sRGB, 0 to 255."""
        if self.image is None:
            return np.broadcast_to(np.asarray(self.background) * 255.0, (camera.height, camera.width, 3))
        x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        rays = np.stack([x, y, np.ones_like(x)], axis=2) @ np.linalg.inv(camera.intrinsics()).T @ T_world_camera[:3, :3].T
        return np.asarray(srgb_from_linear(look_up(self.image, rays)) * 255.0, dtype=np.float64)


def developed(picture: TracedPicture, factors: F64, curve: Curve, outside: F64) -> Rgb:
    """Returns a traced picture as the camera shows it, (H, W, 3), sRGB.

    Args:
        picture: the picture.
        factors: exposure and white balance, (3,).
        curve: the tone curve.
        outside: what the camera sees outside, (H, W, 3), sRGB, 0 to 255.
    """
    return _composed(picture.rgb, picture.alpha, factors, curve, outside)


def noise_of(picture: TracedPicture, factors: F64, curve: Curve, outside: F64) -> float:
    """Returns the mean squared error of a developed picture by its noise, before denoising; sRGB, 0 to 255."""
    a, b = (
        _composed(picture.rgb + k * picture.spread, picture.alpha, factors, curve, outside).astype(np.float64) for k in (1, -1)
    )
    return float(((a - b) ** 2).mean() / 4.0)


def _composed(rgb: F32, alpha: F32, factors: F64, curve: Curve, outside: F64) -> Rgb:
    covered = np.clip(alpha, 0.0, 1.0)[..., None]
    inside = curve((np.maximum(rgb, 0.0) / np.maximum(covered, 1e-3) * factors).astype(np.float32))
    return np.asarray(np.rint(inside * covered + outside * (1.0 - covered)), dtype=np.uint8)


def exposure_samples(pairs: Sequence[tuple[TracedPicture, Rgb]], used: Sequence[NDArray[np.bool_]]) -> tuple[F32, Rgb]:
    """Returns linear traced colours and our colours, (N, 3) each, at the pixels that are used, for ``fit_exposure``."""
    traced = np.concatenate([picture.rgb[mask] for (picture, _), mask in zip(pairs, used, strict=True)])
    ours = np.concatenate([image[mask] for (_, image), mask in zip(pairs, used, strict=True)])
    step = max(1, len(ours) // 200_000)
    return traced[::step], ours[::step]
