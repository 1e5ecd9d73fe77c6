"""Results of ``Bullet``, and constant properties of its bodies. Pure values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.physics.frames import right_multiplication, rotate
from gibson_sim.types import Quat, Vec3


@dataclass(frozen=True, slots=True)
class JointReading:
    """States of joints of one body, in the requested order."""

    positions: NDArray[np.float64]
    """Positions, radians or metres."""
    velocities: NDArray[np.float64]
    """Velocities, rad/s or m/s."""
    efforts: NDArray[np.float64]
    """Efforts of the motors, N m or N."""


@dataclass(frozen=True, slots=True)
class EngineContact:
    """A contact point or closest point of two bodies."""

    name: str
    """Name of the queried body."""
    link: int
    """Link of that body; -1 = the root."""
    other: str
    """Name of the other body, or of the static shape."""
    other_link: int
    """Link of the other body; -1 = the root."""
    position: Vec3
    """Point on the other body, world frame, metres."""
    own_position: Vec3
    """Point on the queried body, world frame, metres."""
    normal: Vec3
    """Unit vector from the other body to the queried one, world frame."""
    force: float
    """Normal force, N."""
    distance: float
    """Distance between the two surfaces, metres; negative = they overlap."""


class BulletBody:
    """A body with joints in the engine, and its constant properties."""

    __slots__ = (
        "joint_indices",
        "link_count",
        "link_indices",
        "link_rotations",
        "links_in_inertial",
        "ray_bit",
        "root_inertial",
        "solver_bodies",
        "uid",
    )

    def __init__(
        self, uid: int, joint_indices: dict[str, int], inertial_poses: Sequence[tuple[Vec3, Quat]], solver_bodies: float
    ) -> None:
        self.uid = uid
        self.solver_bodies = solver_bodies
        """Number of solver bodies, see ``active_bodies``; NaN = unknown."""
        self.joint_indices = joint_indices
        """Joint name -> engine index of the joint, and of the link below it."""
        self.link_count = len(inertial_poses) - 1
        """Number of links below the root."""
        self.link_indices = tuple(range(self.link_count))
        conjugates = [(-x, -y, -z, w) for _, (x, y, z, w) in inertial_poses]
        self.links_in_inertial = -rotate(np.array(conjugates), np.array([position for position, _ in inertial_poses]))
        """(N, 3): origins of the link frames in the inertial frames (centre of mass, principal axes) that Bullet moves, metres."""
        self.link_rotations = np.array([right_multiplication(quat) for quat in conjugates])
        """(N, 4, 4): matrices from a quaternion of the inertial frame to that of the link frame."""
        self.root_inertial = inertial_poses[0]
        """Position and quaternion of the root's inertial frame in the root link's frame."""
        self.ray_bit = 0
        """Bit of the collision group by which rays can ignore the body; 0 = rays always hit it."""
