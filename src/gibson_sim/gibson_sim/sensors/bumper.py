"""Bumpers, computed from the contacts of the physics engine. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.robots.sensor_specs import BumperSpec
from gibson_sim.sensors.lidar import link_pose
from gibson_sim.types import Contact, SceneState


@dataclass(frozen=True, slots=True, eq=False)
class BumperReading:
    """The contact forces on a bumper at one tick."""

    name: str
    """Name of the sensor."""
    stamp_ns: int
    link: str
    """``<body>/<link>``, the frame of force and torque."""
    pressed: bool
    """Whether ``total`` reaches the threshold."""
    links: tuple[str, ...]
    """Links of the robot in contact, without the body name, sorted, regardless of the force."""
    total: float
    """Sum of the magnitudes of all contact forces, N."""
    force: NDArray[np.float64]
    """(3,), vector sum of the forces on the robot, N."""
    torque: NDArray[np.float64]
    """(3,), torque of these forces about the link's origin, N m."""


def measure_bumper(spec: BumperSpec, state: SceneState, contacts: Sequence[Contact]) -> BumperReading:
    """Returns the lateral contact forces on the robot.

    Contacts whose normal is within ``spec.max_slope`` of the vertical are with floors or payloads, and are ignored.

    Args:
        spec: the sensor; its link must be in the state.
        state: state with the pose of the link.
        contacts: contacts of the robot at the same step; either body of a contact may be the robot.

    Raises:
        ConfigError: the link is not in the state.
    """
    T_world_link = link_pose(state, spec.link, "bumper")
    body, steepest = spec.link.partition("/")[0], math.cos(spec.max_slope)
    links: set[str] = set()
    force, torque, total = np.zeros(3), np.zeros(3), 0.0
    for contact in contacts:
        link, sign = (contact.link_a, 1.0) if contact.body_a == body else (contact.link_b, -1.0)
        if abs(contact.normal[2]) > steepest or (spec.links and link not in spec.links) or contact.force <= 0.0:
            continue
        contact_force = np.array(contact.normal) * (sign * contact.force)
        force += contact_force
        torque += np.cross(np.array(contact.position) - T_world_link[:3, 3], contact_force)
        total += contact.force
        links.add(link)
    R_world_link = T_world_link[:3, :3]
    return BumperReading(
        name=spec.name,
        stamp_ns=state.stamp_ns,
        link=spec.link,
        pressed=total >= spec.threshold,
        links=tuple(sorted(links)),
        total=total,
        force=force @ R_world_link,
        torque=torque @ R_world_link,
    )
