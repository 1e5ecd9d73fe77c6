"""Base class of all drives, as used by physics, and common parts: planar velocities and their limits, command delay, dead reckoning."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from gibson_sim.geometry.transforms import wrap_angle
from gibson_sim.types import Odometry, VelocityCommand


class PlanarVelocity(NamedTuple):
    """Velocity of the base in its own frame."""

    linear: float = 0.0
    """Forward velocity, m/s."""
    lateral: float = 0.0
    """Velocity to the left, m/s."""
    angular: float = 0.0
    """Yaw rate, counter-clockwise, rad/s."""


class DriveTargets(NamedTuple):
    """Targets of the motors of a drive until the next step."""

    speeds: tuple[float, ...]
    """Speeds of ``Drive.wheels``, rad/s, forward positive; without wheels, of what odometry measures."""
    angles: tuple[float, ...] = ()
    """Angles of ``Drive.steering``, radians, positive to the left."""


class DriveJoint(NamedTuple):
    """A motorised joint of a drive."""

    name: str
    sign: float = 1.0
    """Sign of the joint: -1 if positive rotation rolls backward or steers to the right."""
    is_left: bool = True
    """Whether it is on the robot's left."""


class BaseServo(NamedTuple):
    """Moves the base of a drive whose wheels slide by design, with the force that the wheels would have.

    No engine simulates rollers cheaply, and in Bullet a driven wheel that slides sideways slips far too much, the more the slower it rotates.
    Such wheels therefore rotate without friction, and the base is driven at the velocity that they would produce: it stops at walls, pushes light
    objects, and slides where the floor is too steep.
    """

    traction: float
    """Maximum force along the floor, as a fraction of the load on the wheels, or on the whole robot if the drive has none."""
    lever_arm: float
    """Distance from the base's origin to the wheels, metres, at which that force acts; 0 = the robot's radius of gyration."""


class Response(NamedTuple):
    """Deviation of a drive from its commands, within its limits."""

    delay: float = 0.0
    """Time from a command to its effect on the motors, s."""
    slip: float = 0.0
    """Fraction of the distance that the wheels roll and the base does not move."""
    turn_slip: float = 0.0
    """Fraction of the rotation that the wheels roll and the base does not make."""


class Drive(ABC):
    """The drive of one robot: targets of its motors, and its wheel odometry. Independent of the engine."""

    def __init__(
        self, wheels: Sequence[DriveJoint], wheel_torque: float,
        steering: Sequence[DriveJoint] = (), steering_torque: float = 0.0, servo: BaseServo | None = None,
        response: Response | None = None,
    ) -> None:  # fmt: skip
        """Starts at rest.

        Args:
            wheels: Joints that are driven by velocity and whose turns odometry counts.
            wheel_torque: Torque limit of each, N m.
            steering: Joints that are driven by position and whose angles odometry reads.
            steering_torque: Torque limit of each, N m.
            servo: Moves the base in place of the wheels; None = the wheels move it.
            response: Delay and slip; None = none.
        """
        self.wheels, self.wheel_torque = tuple(wheels), wheel_torque
        self.steering, self.steering_torque = tuple(steering), steering_torque
        self.servo = servo
        self.velocity = PlanarVelocity()
        """Commanded velocity of the base, within the limits; with slip the base moves differently."""
        self.response = response or Response()
        self._delay = CommandDelay(self.response.delay)
        self._grip, self._turn_grip = 1.0 - self.response.slip, 1.0 - self.response.turn_slip
        self._path = DeadReckoning()

    def targets(self, commanded: PlanarVelocity, dt: float) -> DriveTargets:
        """Approaches the delayed commanded velocity within the limits for ``dt`` seconds; returns the motor targets.

        Args:
            commanded: Velocity commanded now, without delay.
            dt: Time since the last call, s, constant.
        """
        return self._follow(self._delay.delayed(commanded, dt), dt)

    @property
    def encoders_left(self) -> tuple[bool, ...]:
        """For each value that odometry measures in a step, usually the rotation of a wheel, whether it is on the robot's left."""
        return tuple(wheel.is_left for wheel in self.wheels)

    @property
    def base_velocity(self) -> PlanarVelocity:
        """``velocity`` minus slip."""
        linear, lateral, angular = self.velocity
        return PlanarVelocity(linear * self._grip, lateral * self._grip, angular * self._turn_grip)

    @property
    def _rolled(self) -> PlanarVelocity:
        """Velocity at which the wheels roll in the engine, where the wheels that drive the base do not slip, but rotate less."""
        return self.velocity if self.servo else self.base_velocity

    def encoder_turns(self, increments: Sequence[float]) -> Sequence[float]:
        """Returns the rotations that the encoders of ``wheels`` measure, radians, including slip, which the wheels do not have in the engine.

        Args:
            increments: Rotation of each wheel in the engine, radians, forward positive.
        """
        return increments

    @abstractmethod
    def _follow(self, commanded: PlanarVelocity, dt: float) -> DriveTargets:
        """Approaches ``commanded`` within the limits, and returns the motor targets."""

    @abstractmethod
    def travel(self, increments: Sequence[float], angles: Sequence[float]) -> tuple[float, float, float]:
        """Returns the motion of the base computed from the wheels: forward and left (metres, along an arc), rotation (radians).

        Args:
            increments: Rotation of each of ``wheels``, radians, forward positive.
            angles: Angle of each of ``steering``, radians, positive to the left.
        """

    def advance(self, forward: float, left: float, turn: float, dt: float) -> None:
        """Adds a motion, as returned by ``travel``, to the odometry; ``dt``: its duration, s, above 0."""
        self._path.add(forward, left, turn, dt)

    @property
    def odometry(self) -> Odometry:
        """Pose and velocity of the base computed from the wheels; with errors due to slip, as on a real robot."""
        return self._path.odometry


class CommandDelay:
    """Delays commanded velocities; the initial output is zero."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._waiting: deque[PlanarVelocity] = deque()

    def delayed(self, commanded: PlanarVelocity, dt: float) -> PlanarVelocity:
        """Stores the velocity of this step, of ``dt`` seconds, and returns the delayed one, in whole steps."""
        steps = round(self._seconds / dt)
        if steps < 1:
            return commanded
        self._waiting.append(commanded)
        return self._waiting.popleft() if len(self._waiting) > steps else PlanarVelocity()


class DeadReckoning:
    """Integrates small planar arcs exactly."""

    def __init__(self) -> None:
        self._x = self._y = self._yaw = 0.0
        self._velocity = PlanarVelocity()

    def add(self, forward: float, left: float, turn: float, dt: float) -> None:
        """Adds one arc.

        Args:
            forward: Motion along the base's x axis while it rotates, metres.
            left: Motion along its y axis, metres.
            turn: Rotation, radians, counter-clockwise.
            dt: Duration, s, above 0.
        """
        half = turn / 2
        # Chord of an arc; the series has full precision where sin(x)/x is 0/0.
        shrink = math.sin(half) / half if abs(half) > 1e-4 else 1.0 - half * half / 6.0
        ahead, aside = forward * shrink, left * shrink
        cos, sin = math.cos(self._yaw + half), math.sin(self._yaw + half)
        self._x += ahead * cos - aside * sin
        self._y += ahead * sin + aside * cos
        self._yaw += turn
        self._velocity = PlanarVelocity(forward / dt, left / dt, turn / dt)

    @property
    def odometry(self) -> Odometry:
        """Pose of the base relative to its start, and its velocity."""
        linear, lateral, angular = self._velocity
        return Odometry(self._x, self._y, wrap_angle(self._yaw), linear, angular, lateral)


def active_command(command: VelocityCommand | None, now_ns: int, timeout_ns: int) -> PlanarVelocity:
    """Returns the velocity to apply at ``now_ns``: that of the command, or zero if it is None or older than ``timeout_ns``."""
    if command is None or now_ns - command.stamp_ns > timeout_ns:
        return PlanarVelocity()
    return PlanarVelocity(command.linear[0], command.linear[1], command.angular[2])


def limit_velocity_change(current: float, goal: float, limit: float, change: float) -> float:
    """Returns ``goal`` clipped to +-``limit``, at most ``change`` away from ``current``."""
    # Comparisons, since min() and max() take twice the time, and this runs at every step.
    target = -limit if goal < -limit else limit if goal > limit else goal
    lowest, highest = current - change, current + change
    return lowest if target < lowest else highest if target > highest else target
