"""Bumpers from the contacts that the physics engine reports. Pure."""

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
    """What pressed against the robot at one tick."""

    name: str
    """Of the sensor."""
    stamp_ns: int
    link: str
    """``<body>/<link>`` in whose frame force and torque are."""
    pressed: bool
    """Whether the force was felt."""
    links: tuple[str, ...]
    """Own parts that were touched, without the body name, sorted; also where the force was too small."""
    total: float
    """N: sum of what all contacts press with, whatever their directions."""
    force: NDArray[np.float64]
    """(3,), N: vector sum of what acts on the robot."""
    torque: NDArray[np.float64]
    """(3,), N m: of these forces, about the link's origin."""


def measure_bumper(spec: BumperSpec, state: SceneState, contacts: Sequence[Contact]) -> BumperReading:
    """Returns whether something presses against the robot from the side.

    Floors and loads are told by the direction of the contact: nearer to the vertical than ``spec.max_slope``.

    Args:
        spec: The sensor; its link must be in the state.
        state: Where the link is.
        contacts: Of the robot that carries it, at the same step; either body of a contact may be the robot.

    Raises:
        ConfigError: the state has no such link.
    """
    T_world_link = link_pose(state, spec.link, "bumper")
    body, steepest = spec.link.partition("/")[0], math.cos(spec.max_slope)
    links: set[str] = set()
    force, torque, total = np.zeros(3), np.zeros(3), 0.0
    for contact in contacts:
        own, towards = (contact.link_a, 1.0) if contact.body_a == body else (contact.link_b, -1.0)
        if abs(contact.normal[2]) > steepest or (spec.links and own not in spec.links) or contact.force <= 0.0:
            continue
        push = np.array(contact.normal) * (towards * contact.force)
        force += push
        torque += np.cross(np.array(contact.position) - T_world_link[:3, 3], push)
        total += contact.force
        links.add(own)
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
