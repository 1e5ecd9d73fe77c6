"""Domain randomisation of drives: conditions that differ from the recording (light, camera, wheels, furniture, obstacles), and named domains.

A generator draws the same numbers for every domain, so that domains differ by their ranges alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.settings import nearest
from gibson_sim_learn.path_following.photometry import NEUTRAL_K, Photometry, RoomLight

Range = tuple[float, float]
"""Smallest and largest value of a uniform distribution."""
Counts = tuple[int, int]
"""Smallest and largest number, all equally likely."""
_DEG = math.pi / 180.0
_DRAWN = 32
"""Numbers that are drawn for conditions; some are reserved."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Differences of one drive from the recording of its path. The default is none."""

    light: RoomLight = field(default_factory=RoomLight)
    photometry: Photometry = field(default_factory=Photometry)
    hfov_change: float = 0.0
    """Change of the camera's horizontal field of view, radians."""
    height_change: float = 0.0
    """Change of the camera's height, metres."""
    pitch_change: float = 0.0
    """Change of the camera's pitch, radians, positive down."""
    start_ahead: float = 0.0
    """x of the start in the frame of the path's first pose, metres."""
    start_left: float = 0.0
    """y of the start in that frame, metres."""
    start_yaw: float = 0.0
    """Yaw of the start in that frame, radians."""
    slip: float = 1.0
    """True velocity per commanded velocity."""
    yaw_bias: float = 0.0
    """Turn that each metre adds, rad/m, positive to the left."""
    latency_ticks: int = 0
    """Control ticks from an image until its command takes effect."""
    moved: int = 0
    """Number of objects moved or added since the recording, beside the path."""
    obstacles: int = 0
    """Number of obstacles on the path, objects or standing people, with a detour around them."""


@dataclass(frozen=True, slots=True)
class Domain:
    """Ranges of conditions."""

    name: str
    text: str = ""
    """Short description."""
    ambient: Range = (1.0, 1.0)
    """Factor on the light of the scene; log-uniform."""
    light_k: Range = (NEUTRAL_K, NEUTRAL_K)
    """Colour temperature of the light, kelvin; uniform in its inverse (mired)."""
    sun: Range = (0.0, 0.0)
    unevenness_ev: Range = (0.0, 0.0)
    lamp: Range = (0.0, 0.0)
    lamp_k: Range = (NEUTRAL_K, NEUTRAL_K)
    """Colour temperature of the lamp, kelvin; uniform in its inverse."""
    exposure_ev: Range = (0.0, 0.0)
    auto_exposure: float = 0.0
    """Probability of a camera with automatic exposure."""
    camera_k: Range = (NEUTRAL_K, NEUTRAL_K)
    """White balance of the camera, kelvin; uniform in its inverse."""
    noise: Range = (0.0, 0.0)
    vignette: Range = (0.0, 0.0)
    blur: Range = (0.0, 0.0)
    hfov_deg: float = 0.0
    """Largest change of the field of view, degrees, of either sign."""
    height: float = 0.0
    """Largest change of the camera's height, metres, of either sign."""
    pitch_deg: float = 0.0
    """Largest change of the camera's pitch, degrees, of either sign."""
    start: float = 0.1
    """Largest error of the start along each axis, metres."""
    start_deg: float = 5.0
    """Largest error of the heading at the start, degrees."""
    slip: Range = (0.9, 1.0)
    yaw_bias: float = 0.05
    """Largest bias, rad/m, of either sign."""
    latency_ticks: Counts = (0, 0)
    moved: Counts = (0, 0)
    obstacles: Counts = (0, 0)


TRAINED = Domain(
    "trained",
    "all that training varies, within its ranges",
    ambient=(0.6, 1.4),
    light_k=(4500.0, 8500.0),
    sun=(0.0, 0.5),
    unevenness_ev=(0.0, 0.5),
    exposure_ev=(-1.0, 0.7),
    auto_exposure=0.5,
    camera_k=(4500.0, 8500.0),
    noise=(0.0, 5.0),
    vignette=(0.0, 0.3),
    blur=(0.0, 0.6),
    hfov_deg=3.0,
    height=0.03,
    pitch_deg=2.0,
    slip=(0.8, 1.0),
    yaw_bias=0.08,
    latency_ticks=(0, 1),
    moved=(0, 3),
)
_LIGHT = Domain(
    "light",
    "light: brightness, colour, direction, brighter and darker places",
    ambient=(0.3, 2.5),
    light_k=(3000.0, 10000.0),
    sun=(0.0, 1.5),
    unevenness_ev=(0.0, 1.2),
    auto_exposure=1.0,
)
_LENS = Domain(
    "lens_exposure",
    "camera: exposure, white balance, noise, vignette, blur, field of view, height, tilt",
    exposure_ev=(-1.6, 1.2),
    camera_k=(3000.0, 10000.0),
    noise=(0.0, 10.0),
    vignette=(0.0, 0.5),
    blur=(0.0, 1.2),
    hfov_deg=6.0,
    height=0.06,
    pitch_deg=4.0,
)
_SLIP = Domain(
    "slip_latency",
    "wheels that slip, a robot that pulls to one side, late commands",
    slip=(0.6, 1.0),
    yaw_bias=0.15,
    latency_ticks=(0, 2),
)
_MOVED = Domain("moved", "0 to 6 objects moved or added since the recording, beside the path", moved=(0, 6))
_OBSTACLES = Domain("obstacles", "0 to 2 obstacles on the path, objects or standing people, with a detour", obstacles=(0, 2))
_REALITY = replace(
    _LIGHT,
    name="reality",
    text="all of these together, wider than in training",
    exposure_ev=_LENS.exposure_ev,
    camera_k=_LENS.camera_k,
    noise=_LENS.noise,
    vignette=_LENS.vignette,
    blur=_LENS.blur,
    hfov_deg=_LENS.hfov_deg,
    height=_LENS.height,
    pitch_deg=_LENS.pitch_deg,
    slip=_SLIP.slip,
    yaw_bias=_SLIP.yaw_bias,
    latency_ticks=_SLIP.latency_ticks,
    moved=_MOVED.moved,
    obstacles=_OBSTACLES.obstacles,
    start=0.15,
    start_deg=8.0,
)
_DEVELOPMENT = Domain(
    "development",
    "half-way between training and reality; for choosing parameters, not for results",
    ambient=(0.45, 1.95),
    light_k=(3750.0, 9250.0),
    sun=(0.0, 1.0),
    unevenness_ev=(0.0, 0.85),
    exposure_ev=(-1.3, 0.95),
    auto_exposure=0.75,
    camera_k=(3750.0, 9250.0),
    noise=(0.0, 7.5),
    vignette=(0.0, 0.4),
    blur=(0.0, 0.9),
    hfov_deg=4.5,
    height=0.045,
    pitch_deg=3.0,
    start=0.125,
    start_deg=6.5,
    slip=(0.7, 1.0),
    yaw_bias=0.115,
    latency_ticks=(0, 2),
    moved=(0, 4),
    obstacles=(0, 1),
)
_NIGHT = Domain(
    "night",
    "recorded at noon, followed by night with a lamp on the robot",
    ambient=(0.01, 0.04),
    light_k=(4000.0, 8500.0),
    lamp=(0.4, 1.2),
    lamp_k=(2700.0, 6000.0),
    exposure_ev=(-0.5, 0.5),
    auto_exposure=1.0,
    noise=(1.0, 3.0),
)
DOMAINS: dict[str, Domain] = {
    domain.name: domain for domain in (TRAINED, _LIGHT, _LENS, _SLIP, _MOVED, _OBSTACLES, _REALITY, _NIGHT, _DEVELOPMENT)
}
"""By name."""
SEEN_IN_TRAINING = frozenset({"trained"})
"""Domains that training may draw from."""
FOR_CHOOSING = SEEN_IN_TRAINING | {"development"}
"""Domains that parameters may be tuned on."""
MEASURED = tuple(name for name in DOMAINS if name != "development")
"""Default domains of a table of results."""


def domain_of(name: str) -> Domain:
    """Returns the domain of a name.

    Raises:
        ConfigError: there is none.
    """
    if name not in DOMAINS:
        hint = nearest(name, tuple(DOMAINS))
        raise ConfigError(f"there is no domain {quoted(name)}; {f'{hint} ' if hint else ''}known: {', '.join(DOMAINS)}")
    return DOMAINS[name]


def draw(domain: Domain, rng: np.random.Generator) -> Conditions:
    """Returns conditions of a domain; equal generators give equal conditions."""
    # All numbers are drawn first, and for every domain as many: its ranges must not change what the others become.
    u: Iterator[float] = iter(rng.random(_DRAWN).tolist())

    def between(limits: Range) -> float:
        return limits[0] + (limits[1] - limits[0]) * next(u)

    def kelvin(limits: Range) -> float:
        drawn = 1.0 / between((1.0 / limits[0], 1.0 / limits[1]))
        return min(max(drawn, limits[0]), limits[1])  # rounding must not make white another colour

    def symmetric(most: float) -> float:
        return between((-most, most))

    def count(limits: Counts) -> int:
        return min(limits[1], limits[0] + int((limits[1] - limits[0] + 1) * next(u)))

    light = RoomLight(
        ambient=math.exp(between((math.log(domain.ambient[0]), math.log(domain.ambient[1])))),
        temperature_k=kelvin(domain.light_k),
        sun=between(domain.sun),
        sun_azimuth=between((-math.pi, math.pi)),
        sun_elevation=between((25.0 * _DEG, 75.0 * _DEG)),
        unevenness_ev=between(domain.unevenness_ev),
        period=between((2.5, 6.0)),
        phase=between((0.0, 2.0 * math.pi)),
        lamp=between(domain.lamp),
        lamp_temperature_k=kelvin(domain.lamp_k),
    )
    photometry = Photometry(
        exposure_ev=between(domain.exposure_ev),
        auto_exposure=next(u) < domain.auto_exposure,
        temperature_k=kelvin(domain.camera_k),
        noise=between(domain.noise),
        vignette=between(domain.vignette),
        blur=between(domain.blur),
    )
    return Conditions(
        light,
        photometry,
        hfov_change=symmetric(domain.hfov_deg * _DEG),
        height_change=symmetric(domain.height),
        pitch_change=symmetric(domain.pitch_deg * _DEG),
        start_ahead=symmetric(domain.start),
        start_left=symmetric(domain.start),
        start_yaw=symmetric(domain.start_deg * _DEG),
        slip=between(domain.slip),
        yaw_bias=symmetric(domain.yaw_bias),
        latency_ticks=count(domain.latency_ticks),
        moved=count(domain.moved),
        obstacles=count(domain.obstacles),
    )
