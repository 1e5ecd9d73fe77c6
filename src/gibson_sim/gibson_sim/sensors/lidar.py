"""A planar lidar: which rays to cast, and what a driver reports for their lengths (REP 117). Pure: a callable casts the rays."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import matrix_from_quat
from gibson_sim.robots.sensor_specs import LidarSpec
from gibson_sim.types import SceneState

CastRays = Callable[[NDArray[np.float64], NDArray[np.float64], float, "str | None"], NDArray[np.float64]]
"""``PhysicsWorld.cast_rays``: (origins (N, 3), directions (N, 3), range_max, body to ignore) to distances (N,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One turn of a lidar; all rays were cast at the same instant."""

    stamp_ns: int
    """Stamp of the state that was measured."""
    link: str
    """``<body>/<link>`` that the angles are counted in."""
    angle_min: float
    """Radians about z from the x axis, counter-clockwise: direction of the first ray."""
    angle_increment: float
    """Radians from one ray to the next."""
    range_min: float
    range_max: float
    """Metres."""
    ranges: NDArray[np.float32]
    """(beams,) float32, metres; +inf = no return, -inf = nearer than range_min (REP 117)."""

    @property
    def angle_max(self) -> float:
        """Direction of the last ray, radians."""
        return self.angle_min + self.angle_increment * (len(self.ranges) - 1)


def ray_directions(spec: LidarSpec) -> NDArray[np.float64]:
    """Returns unit vectors, (beams, 3), in the link's frame: the first along x, then counter-clockwise about z."""
    angles = np.arange(spec.beams) * (2 * math.pi / spec.beams)
    return np.stack([np.cos(angles), np.sin(angles), np.zeros(spec.beams)], axis=-1)


def world_rays(T_world_link: ArrayLike, directions: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns (origins, directions), each (N, 3), world frame, of rays from the origin of a link.

    Args:
        T_world_link: (4, 4).
        directions: (N, 3), in the link's frame.
    """
    T = np.asarray(T_world_link, dtype=np.float64)
    turned = np.asarray(directions, dtype=np.float64) @ T[:3, :3].T
    return np.broadcast_to(T[:3, 3], turned.shape).copy(), turned


def ranges_from_distances(distances: ArrayLike, spec: LidarSpec) -> NDArray[np.float32]:
    """Returns what a driver reports, float32, for distances in metres (+inf = nothing hit)."""
    d = np.asarray(distances, dtype=np.float64)
    return np.where(d > spec.range_max, np.inf, np.where(d < spec.range_min, -np.inf, d)).astype(np.float32)


def measure_scan(spec: LidarSpec, state: SceneState, cast_rays: CastRays) -> Scan:
    """Returns what the lidar sees in ``state``; the body that carries it is invisible to it.

    Args:
        spec: The lidar; its link must be in the state.
        state: Where the link is.
        cast_rays: Casts rays in the world that ``state`` was taken from, at the same step.
    """
    if spec.link not in state.links:
        raise ConfigError(f"lidar on {spec.link!r}: no such link in the scene; known: {', '.join(state.links)}")
    row = state.links.index(spec.link)
    T_world_link = np.eye(4)
    T_world_link[:3, :3] = matrix_from_quat(state.quats_xyzw[row])
    T_world_link[:3, 3] = state.positions[row]
    origins, directions = world_rays(T_world_link, ray_directions(spec))
    distances = cast_rays(origins, directions, spec.range_max, spec.link.partition("/")[0])
    return Scan(
        stamp_ns=state.stamp_ns,
        link=spec.link,
        angle_min=0.0,
        angle_increment=2 * math.pi / spec.beams,
        range_min=spec.range_min,
        range_max=spec.range_max,
        ranges=ranges_from_distances(distances, spec),
    )
