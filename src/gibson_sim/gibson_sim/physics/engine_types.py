"""What the engine's class hands out and knows of its bodies. Pure values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.physics.frames import right_multiplication, turn
from gibson_sim.types import Quat, Vec3


@dataclass(frozen=True, slots=True)
class JointReading:
    """Joints of one body, in the order asked for."""

    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]
    efforts: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class EngineContact:
    """A point at which a body touches another one, or is next to it."""

    name: str
    """Of the body asked about."""
    link: int
    """Of that body; -1 = the root."""
    other: str
    """Name of the other body, or of the static shape."""
    other_link: int
    position: Vec3
    """On the other body, world frame, metres."""
    own_position: Vec3
    """On the body itself."""
    normal: Vec3
    """From the other body to this one, unit vector, world frame."""
    force: float
    """N, along the normal."""
    distance: float
    """Metres between the two surfaces; negative = they overlap."""


class BulletBody:
    """What was found out once about a body with joints."""

    __slots__ = (
        "joint_indices",
        "link_count",
        "link_indices",
        "link_turns",
        "links_in_inertial",
        "parts",
        "ray_bit",
        "root_inertial",
        "uid",
    )

    def __init__(
        self, uid: int, joint_indices: dict[str, int], inertial_poses: Sequence[tuple[Vec3, Quat]], parts: float
    ) -> None:
        self.uid = uid
        self.parts = parts
        """How many of its links can be awake, see ``awake``; NaN = nobody knows."""
        self.joint_indices = joint_indices
        self.link_count = len(inertial_poses) - 1
        """Links below the root."""
        self.link_indices = tuple(range(self.link_count))
        conjugates = [(-x, -y, -z, w) for _, (x, y, z, w) in inertial_poses]
        self.links_in_inertial = -turn(np.array(conjugates), np.array([position for position, _ in inertial_poses]))
        """(N, 3): origins of the link frames in the frame that Bullet moves: centre of mass and principal axes."""
        self.link_turns = np.array([right_multiplication(quat) for quat in conjugates])
        """(N, 4, 4): multiply a quaternion of the principal axes to that of the link frame."""
        self.root_inertial = inertial_poses[0]
        """Position and quaternion of what Bullet moves in the root link's frame."""
        self.ray_bit = 0
        """Bit of the collision group that rays can leave out; 0 = rays always hit it."""
