"""Lidars: directions of their rays, and the ranges that their drivers report (REP 117). Pure: a callable casts the rays.

A planar lidar measures a scan, a lidar with several channels a point cloud. Errors are applied in the order of a sensor: scale, noise,
resolution, range limits, dropouts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import Mat4, matrix_from_quat
from gibson_sim.robots.noise import NoiseSource
from gibson_sim.robots.sensor_specs import TURN, Lidar3DSpec, LidarSpec
from gibson_sim.types import SceneState

CastRays = Callable[[NDArray[np.float64], NDArray[np.float64], float, "str | None"], NDArray[np.float64]]
"""``PhysicsWorld.cast_rays``: (origins (N, 3), directions (N, 3), range_max, ignored body) -> distances (N,)."""
_ERROR, _DROPOUT, _SCALE = 0, 1, 2
"""Purposes of random numbers."""
_MAX_SIGMAS = 3.0
"""Limit of the scale error, in standard deviations: devices with larger errors would fail factory inspection."""


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One revolution of a lidar; all rays are cast at the same instant."""

    stamp_ns: int
    """Stamp of the measured state."""
    link: str
    """``<body>/<link>``, the frame of the angles."""
    angle_min: float
    """Direction of the first ray, radians about z from the x axis, counter-clockwise."""
    angle_increment: float
    """Angle between successive rays, radians."""
    range_min: float
    """Smallest range, metres."""
    range_max: float
    """Largest range, metres."""
    ranges: NDArray[np.float32] = field(repr=False)
    """(beams,) float32, metres; +inf = no return, -inf = nearer than range_min (REP 117)."""
    name: str = "scan"
    """Name of the lidar."""

    @property
    def angle_max(self) -> float:
        """Direction of the last ray, radians."""
        return self.angle_min + self.angle_increment * (len(self.ranges) - 1)


@dataclass(frozen=True, slots=True, eq=False)
class LidarCloud:
    """Points hit by the rays of one revolution, ring by ring; a ray without a return in range has no point."""

    name: str
    """Name of the lidar."""
    stamp_ns: int
    """Stamp of the measured state."""
    link: str
    """``<body>/<link>``, the frame of the points."""
    points: NDArray[np.float32]
    """(N, 3) float32, metres."""
    ring: NDArray[np.uint16]
    """(N,) uint16, ring number, 0 = lowest."""
    intensity: NDArray[np.float32]
    """(N,) float32; always 0, since collision shapes have no colour."""


def ray_directions(spec: LidarSpec) -> NDArray[np.float64]:
    """Returns unit vectors, (beams, 3), in the link's frame, counter-clockwise about z from ``angle_min``, measured from the x axis."""
    angles = spec.angle_min + np.arange(spec.beams) * spec.angle_increment
    return np.stack([np.cos(angles), np.sin(angles), np.zeros(spec.beams)], axis=-1)


@lru_cache(maxsize=8)
def cloud_directions(spec: Lidar3DSpec) -> NDArray[np.float64]:
    """Returns unit vectors, (channels * samples, 3), in the link's frame, ring by ring from the lowest, as a read-only array."""
    middle = (spec.elevation_min + spec.elevation_max) / 2
    first = spec.elevation_min if spec.channels > 1 else middle
    elevation = np.linspace(first, spec.elevation_max, spec.channels)[:, None]
    azimuth = np.arange(spec.samples)[None, :] * (TURN / spec.samples)
    parts = np.broadcast_arrays(np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))
    directions = np.stack(parts, axis=-1).reshape(-1, 3)
    directions.setflags(write=False)
    return directions


def world_rays(T_world_link: ArrayLike, directions: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the origins and directions, (N, 3), world frame, of rays from the origin of a link.

    Args:
        T_world_link: (4, 4).
        directions: (N, 3), in the link's frame.
    """
    T = np.asarray(T_world_link, dtype=np.float64)
    rotated = np.asarray(directions, dtype=np.float64) @ T[:3, :3].T
    return np.broadcast_to(T[:3, 3], rotated.shape).copy(), rotated


def ranges_from_distances(
    distances: ArrayLike, spec: LidarSpec | Lidar3DSpec, noise: NoiseSource | None = None, stamp_ns: int = 0
) -> NDArray[np.float32]:
    """Returns the ranges that a driver reports, (N,) float32, metres.

    Args:
        distances: (N,), distances along the rays, metres, +inf = no hit.
        spec: errors and range limits.
        noise: random numbers of this lidar; None = no errors, regardless of the spec.
        stamp_ns: key of the random numbers.
    """
    d = np.array(distances, dtype=np.float64)
    if noise is not None:
        if spec.range_scale > 0.0:
            d *= 1.0 + spec.range_scale * min(max(float(noise.at(0, _SCALE).standard_normal()), -_MAX_SIGMAS), _MAX_SIGMAS)
        if spec.range_noise > 0.0 or spec.range_noise_ratio > 0.0:
            deviation = np.hypot(spec.range_noise, spec.range_noise_ratio * np.where(np.isfinite(d), d, 0.0))
            d += deviation * noise.at(stamp_ns, _ERROR).standard_normal(d.shape)
        if spec.resolution > 0.0:
            d = np.rint(d / spec.resolution) * spec.resolution
    ranges = np.where(d > spec.range_max, np.inf, np.where(d < spec.range_min, -np.inf, d)).astype(np.float32)
    if noise is not None and spec.dropout > 0.0:
        ranges[noise.at(stamp_ns, _DROPOUT).random(d.shape) < spec.dropout] = np.inf
    return ranges


def noise_of(robot: str, spec: LidarSpec | Lidar3DSpec, seed: int) -> NoiseSource | None:
    """Returns the random numbers for a lidar's errors; None if it has no errors.

    Args:
        robot: name of the robot that carries the lidar.
        spec: the lidar.
        seed: seed of the simulation.
    """
    if not (spec.range_noise or spec.range_noise_ratio or spec.range_scale or spec.resolution or spec.dropout):
        return None
    return NoiseSource(f"{robot}/{spec.name}", seed, spec.seed)


def measure_scan(spec: LidarSpec, state: SceneState, cast_rays: CastRays, noise: NoiseSource | None = None) -> Scan:
    """Returns the scan of a lidar in ``state``; the body that carries it is invisible to it.

    Args:
        spec: the lidar; its link must be in the state.
        state: state with the pose of the link.
        cast_rays: casts rays in the world of ``state``, at the same step.
        noise: random numbers of this lidar; None = no errors, regardless of the spec.

    Raises:
        ConfigError: the link is not in the state.
    """
    distances = _cast(spec, state, cast_rays, ray_directions(spec))
    return Scan(
        stamp_ns=state.stamp_ns,
        link=spec.link,
        angle_min=spec.angle_min,
        angle_increment=spec.angle_increment,
        range_min=spec.range_min,
        range_max=spec.range_max,
        ranges=ranges_from_distances(distances, spec, noise, state.stamp_ns),
        name=spec.name,
    )


def measure_cloud(spec: Lidar3DSpec, state: SceneState, cast_rays: CastRays, noise: NoiseSource | None = None) -> LidarCloud:
    """Returns the point cloud of a lidar with several channels; the body that carries it is invisible to it.

    For arguments and errors see ``measure_scan``.
    """
    directions = cloud_directions(spec)
    ranges = ranges_from_distances(_cast(spec, state, cast_rays, directions), spec, noise, state.stamp_ns)
    hit = np.flatnonzero(np.isfinite(ranges))
    return LidarCloud(
        name=spec.name,
        stamp_ns=state.stamp_ns,
        link=spec.link,
        points=(directions[hit] * ranges[hit, None]).astype(np.float32),
        ring=(hit // spec.samples).astype(np.uint16),
        intensity=np.zeros(len(hit), dtype=np.float32),
    )


def link_pose(state: SceneState, link: str, what: str) -> Mat4:
    """Returns T_world_link.

    Raises:
        ConfigError: the link is not in the state; the message begins with ``what``.
    """
    if link not in state.links:
        raise ConfigError(f"{what} on {link!r}: the link is not in the scene; its links: {', '.join(state.links)}")
    row = state.links.index(link)
    T_world_link = np.eye(4)
    T_world_link[:3, :3] = matrix_from_quat(state.quats_xyzw[row])
    T_world_link[:3, 3] = state.positions[row]
    return T_world_link


def _cast(
    spec: LidarSpec | Lidar3DSpec, state: SceneState, cast_rays: CastRays, directions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Returns the distance along each ray, (N,), metres; +inf = nothing in range."""
    origins, rotated = world_rays(link_pose(state, spec.link, "lidar"), directions)
    # With errors, a wall just beyond the range may be reported in range, as by a real lidar.
    relative = 5.0 * spec.range_noise_ratio + _MAX_SIGMAS * spec.range_scale
    margin = 5.0 * spec.range_noise + spec.resolution + 1.5 * relative * spec.range_max
    return cast_rays(origins, rotated, spec.range_max + margin, spec.link.partition("/")[0])
