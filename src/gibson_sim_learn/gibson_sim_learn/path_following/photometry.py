"""Photometric simulation: relighting of rooms with baked light, exposure, white balance, lens and noise of a camera.

Pure: images and their auxiliary outputs go in, images come out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.colours import LUMINANCE, linear_from_srgb, srgb8_from_linear
from gibson_sim.scenes.randomise import color_of_temperature

Image = NDArray[np.uint8]
F32 = NDArray[np.float32]
NEUTRAL_K = 6500.0
"""Colour temperature of white, kelvin."""
_TARGET = 0.25
"""Target of automatic exposure: mean luminance, linear, 0 to 1."""
_GAINS = (1.0 / 16.0, 64.0)
"""Smallest and largest gain of automatic exposure."""
_WAVES = 4
"""Number of waves whose sum is the unevenness of the light."""
_SOFT = 0.09
"""Added to the squared distance from a lamp, m^2: it is not a point light."""
_LINEAR = linear_from_srgb(np.arange(256, dtype=np.float32) / np.float32(255.0))


@dataclass(frozen=True, slots=True)
class RoomLight:
    """Light that differs from the recording: factors on the reflected light of a surface.

    The homes have their light baked into textures, which ``LightSpec`` does not change. It is changed in the image instead, by the normal and
    the position of each pixel.
    """

    ambient: float = 1.0
    """Factor on the light of the scene; 1 = as it is."""
    temperature_k: float = NEUTRAL_K
    """Colour temperature of that light, kelvin."""
    sun: float = 0.0
    """Directional light, as a multiple of the scene's light on a surface that faces it."""
    sun_azimuth: float = 0.0
    """Direction towards that light, radians from +x of the world, counter-clockwise."""
    sun_elevation: float = math.pi / 4
    """Elevation of that light above the horizon, radians."""
    unevenness_ev: float = 0.0
    """Amplitude of brighter and darker places in the scene, photographic stops."""
    period: float = 4.0
    """Distance from one bright place to the next, metres."""
    phase: float = 0.0
    """Where the bright places are, radians."""
    lamp: float = 0.0
    """Strength of a lamp at the camera, as a multiple of the scene's light on a surface that faces it at a distance of 1 m."""
    lamp_temperature_k: float = NEUTRAL_K
    """Colour temperature of the lamp, kelvin."""

    def __post_init__(self) -> None:
        for name in ("ambient", "sun", "unevenness_ev", "lamp"):
            _check(f"light: {name}", getattr(self, name), 0.0)
        if self.period <= 0.0:
            raise ConfigError(f"light: period is {self.period:g} m, must be above 0")

    @property
    def is_unchanged(self) -> bool:
        """Whether the light is that of the scene."""
        return (self.ambient, self.temperature_k, self.sun, self.unevenness_ev, self.lamp) == (1.0, NEUTRAL_K, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Photometry:
    """Photometric response of a camera."""

    exposure_ev: float = 0.0
    """Exposure, photographic stops; with automatic exposure: exposure compensation."""
    auto_exposure: bool = False
    """Whether each image is brought to the same mean luminance before ``exposure_ev``."""
    temperature_k: float = NEUTRAL_K
    """White balance: colour temperature that the camera renders as white, kelvin; a lower one makes images redder."""
    noise: float = 0.0
    """Standard deviation of the noise, levels of 255; it grows with the root of the gain of automatic exposure."""
    vignette: float = 0.0
    """Loss of light in the corners, 0 to 1."""
    blur: float = 0.0
    """Standard deviation of the blur, pixels of an image 96 pixels wide; in proportion for others."""

    def __post_init__(self) -> None:
        for name in ("noise", "blur"):
            _check(f"photometry: {name}", getattr(self, name), 0.0)
        _check("photometry: vignette", self.vignette, 0.0, 1.0)


def relit_linear(rgb: Image, normal: F32, position: F32, eye: tuple[float, float, float], light: RoomLight) -> F32:
    """Returns an image (H, W, 3), float32, in another light, linear; values above 1 are brighter than white, for ``photographed`` to expose.

    Args:
        rgb: (H, W, 3), uint8, sRGB.
        normal: (H, W, 3), unit normals, world frame; NaN or 0 where no surface is.
        position: (H, W, 3), world frame, metres; NaN where no surface is.
        eye: position of the camera, world frame, metres.
        light: the light.
    """
    if light.is_unchanged:
        return np.asarray(_LINEAR[rgb])
    there = np.asarray(np.isfinite(position).all(axis=2))
    points = np.where(there[..., None], position, 0.0).astype(np.float32)
    normals = np.nan_to_num(normal)
    level = np.full(rgb.shape[:2], light.ambient, dtype=np.float32)
    if light.sun:
        flat = math.cos(light.sun_elevation)
        towards = (flat * math.cos(light.sun_azimuth), flat * math.sin(light.sun_azimuth), math.sin(light.sun_elevation))
        level += light.sun * np.maximum(normals @ np.array(towards, dtype=np.float32), 0.0)
    if light.unevenness_ev:
        level *= np.where(there, np.exp2(light.unevenness_ev * _waves(points, light.period, light.phase)), 1.0)
    factor = level[..., None] * white_gains(light.temperature_k)
    if light.lamp:
        away = points - np.array(eye, dtype=np.float32)
        squared = np.maximum((away**2).sum(axis=2), 1e-6)
        facing = np.maximum(-(away * normals).sum(axis=2) / np.sqrt(squared), 0.0)
        factor += np.where(there, light.lamp * facing / (squared + _SOFT), 0.0)[..., None] * white_gains(light.lamp_temperature_k)
    return np.asarray(_LINEAR[rgb] * factor.astype(np.float32))


def photographed(image: Image | F32, camera: Photometry, rng: np.random.Generator) -> Image:
    """Returns an image as a camera renders it, (H, W, 3), uint8, sRGB.

    Args:
        image: (H, W, 3), sRGB as uint8, or linear as float32.
        camera: the camera.
        rng: of the noise; every camera draws the same number of values.
    """
    grain = rng.standard_normal(image.shape, dtype=np.float32)
    height, width = image.shape[:2]
    linear: F32 = _LINEAR[image] if image.dtype == np.uint8 else image.astype(np.float32, copy=False)
    if camera.blur:
        sigma = camera.blur * width / 96.0
        linear = ndimage.gaussian_filter(linear, (sigma, sigma, 0.0), mode="nearest", truncate=3.0)
    gain = 1.0
    if camera.auto_exposure:
        mean = float((linear @ LUMINANCE.astype(np.float32)).mean())
        gain = min(max(_TARGET / max(mean, 1e-6), _GAINS[0]), _GAINS[1])
    linear = linear * (gain * 2.0**camera.exposure_ev * white_gains(camera.temperature_k))
    if camera.vignette:
        linear *= (1.0 - camera.vignette * _radius_squared(height, width))[..., None]
    out = srgb8_from_linear(linear)
    if camera.noise:
        noisy = out + np.float32(camera.noise * math.sqrt(max(1.0, gain))) * grain
        out = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return out


@lru_cache(maxsize=4096)
def white_gains(kelvin: float) -> F32:
    """Returns (3,): factors on linear red, green and blue of white light of a colour temperature, of luminance 1; ones at ``NEUTRAL_K``."""
    colour, white = (linear_from_srgb(np.array(color_of_temperature(t))) for t in (kelvin, NEUTRAL_K))
    gains = colour / np.maximum(white, 1e-6)
    return np.asarray(gains / float(gains @ LUMINANCE), dtype=np.float32)


def _waves(points: F32, period: float, phase: float) -> F32:
    """Returns (H, W), float32, -1 to 1: a smooth pattern over the floor plan at points (H, W, 3), world frame, metres."""
    total = np.zeros(points.shape[:2], dtype=np.float32)
    for k in range(_WAVES):
        # The golden angle spreads directions and phases evenly.
        angle = phase + 2.399963 * k
        direction = np.array([math.cos(angle), math.sin(angle)], dtype=np.float32)
        total += np.sin(points[..., :2] @ direction * np.float32(2.0 * math.pi / period) + np.float32(3.0 * angle))
    return total / np.float32(_WAVES)


@lru_cache(maxsize=8)
def _radius_squared(height: int, width: int) -> F32:
    """Returns (H, W): the squared distance of each pixel from the middle; 1 in the corners."""
    y = (np.arange(height, dtype=np.float32) + 0.5) * (2.0 / height) - 1.0
    x = (np.arange(width, dtype=np.float32) + 0.5) * (2.0 / width) - 1.0
    corner = float(y[-1] ** 2 * (height / width) ** 2 + x[-1] ** 2)
    return np.asarray((y[:, None] ** 2 * (height / width) ** 2 + x[None] ** 2) / corner, dtype=np.float32)


def _check(what: str, value: float, low: float, high: float = math.inf) -> None:
    if not low <= value <= high or not math.isfinite(value):
        limits = f"{low:g} or more" if high == math.inf else f"from {low:g} to {high:g}"
        raise ConfigError(f"{what} is {value:g}, must be {limits}")
