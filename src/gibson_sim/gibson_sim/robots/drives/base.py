"""What all drives share: velocities in the plane, their limits, dead reckoning, and the interface that physics uses."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

from gibson_sim.geometry.transforms import wrap_angle
from gibson_sim.types import Odometry, VelocityCommand


class PlanarVelocity(NamedTuple):
    """Velocity of the base in its own frame."""

    linear: float = 0.0
    """Forward, m/s."""
    lateral: float = 0.0
    """To the left, m/s."""
    angular: float = 0.0
    """Counter-clockwise, rad/s."""


class DriveTargets(NamedTuple):
    """What the motors of a drive shall do until the next step."""

    speeds: tuple[float, ...]
    """rad/s of ``Drive.wheels``, forward positive."""
    angles: tuple[float, ...] = ()
    """Radians of ``Drive.steering``, positive to the left."""


class DriveJoint(NamedTuple):
    """A joint with a motor of the drive."""

    name: str
    sign: float = 1.0
    """-1 when a positive turn of the joint rolls backward or steers to the right."""
    is_left: bool = True
    """Whether it is on the robot's left."""


class BaseServo(NamedTuple):
    """A drive whose wheels slide by nature moves the base itself, with what force the wheels would have.

    No engine simulates rollers cheaply, and Bullet's friction lets a wheel that is driven while it slides sideways slip many times
    too much, the more the slower it turns. So such wheels turn without friction, and the base gets the velocity that they should
    give it: walls stop it, it pushes what is light, and it slides where the floor is too steep.
    """

    traction: float
    """Greatest force along the floor, as a fraction of what presses the wheels onto it."""
    reach: float
    """Metres from the base's origin to the wheels: lever of that force."""


class Drive(ABC):
    """The drive of one robot: what its motors shall do, and where its wheels say that it is. Knows no engine."""

    def __init__(
        self, wheels: Sequence[DriveJoint], wheel_torque: float,
        steering: Sequence[DriveJoint] = (), steering_torque: float = 0.0, servo: BaseServo | None = None,
    ) -> None:  # fmt: skip
        """Sets what never changes.

        Args:
            wheels: Joints that are driven by velocity and whose turns odometry counts.
            wheel_torque: N m, of each.
            steering: Joints that are driven by position and whose angles odometry reads.
            steering_torque: N m, of each.
            servo: How the base is moved where its wheels do not move it.
        """
        self.wheels, self.wheel_torque = tuple(wheels), wheel_torque
        self.steering, self.steering_torque = tuple(steering), steering_torque
        self.servo = servo
        self.velocity = PlanarVelocity()
        """What the base was told last, within the limits."""
        self._path = DeadReckoning()

    @abstractmethod
    def targets(self, wanted: PlanarVelocity, dt: float) -> DriveTargets:
        """Comes nearer to ``wanted``, as far as the limits let it in ``dt`` seconds, and returns what the motors must do for it."""

    @abstractmethod
    def travel(self, increments: Sequence[float], angles: Sequence[float]) -> tuple[float, float, float]:
        """Returns how far the base went, forward and to the left (metres, along an arc) and turned (radians).

        Args:
            increments: Radians that each of ``wheels`` rolled forward.
            angles: Radians at which each of ``steering`` stands, positive to the left.
        """

    def advance(self, forward: float, left: float, turn: float, dt: float) -> None:
        """Adds to the odometry a motion as ``travel`` returns it, which took ``dt`` seconds, above 0."""
        self._path.add(forward, left, turn, dt)

    @property
    def odometry(self) -> Odometry:
        """Where the wheels say that the base is: one that slips deceives them, as on a real robot."""
        return self._path.odometry


class DeadReckoning:
    """Sums small arcs in the plane, each exactly."""

    def __init__(self) -> None:
        self._x = self._y = self._yaw = 0.0
        self._velocity = PlanarVelocity()

    def add(self, forward: float, left: float, turn: float, dt: float) -> None:
        """Adds one arc.

        Args:
            forward: Metres along the base's x axis while it turned.
            left: Metres along its y axis.
            turn: Radians, counter-clockwise.
            dt: Seconds that it took, above 0.
        """
        half = turn / 2
        # The chord of an arc; the series keeps full precision where sin(x)/x would be 0/0.
        shrink = math.sin(half) / half if abs(half) > 1e-4 else 1.0 - half * half / 6.0
        ahead, aside = forward * shrink, left * shrink
        cos, sin = math.cos(self._yaw + half), math.sin(self._yaw + half)
        self._x += ahead * cos - aside * sin
        self._y += ahead * sin + aside * cos
        self._yaw += turn
        self._velocity = PlanarVelocity(forward / dt, left / dt, turn / dt)

    @property
    def odometry(self) -> Odometry:
        """Where the base is, from where it started."""
        linear, lateral, angular = self._velocity
        return Odometry(self._x, self._y, wrap_angle(self._yaw), linear, angular, lateral)


def active_command(command: VelocityCommand | None, now_ns: int, timeout_ns: int) -> PlanarVelocity:
    """Returns what to obey at ``now_ns``: the command's velocity, or zero where it is None or older than ``timeout_ns``."""
    if command is None or now_ns - command.stamp_ns > timeout_ns:
        return PlanarVelocity()
    return PlanarVelocity(command.linear[0], command.linear[1], command.angular[2])


def approach(current: float, wanted: float, limit: float, change: float) -> float:
    """Returns ``wanted`` clipped to +-``limit``, at most ``change`` away from ``current``."""
    target = min(max(wanted, -limit), limit)
    return min(max(target, current - change), current + change)
