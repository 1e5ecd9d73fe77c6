"""What all drives share: velocities in the plane, their limits, dead reckoning, and the interface that physics uses."""

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


class Response(NamedTuple):
    """How a drive falls short of what it is told, within its limits."""

    delay: float = 0.0
    """Seconds from a command to what the motors do about it."""
    slip: float = 0.0
    """Part of the way along the floor that the wheels roll and the base does not go."""
    turn_slip: float = 0.0
    """Part of the turn."""


class Drive(ABC):
    """The drive of one robot: what its motors shall do, and where its wheels say that it is. Knows no engine."""

    def __init__(
        self, wheels: Sequence[DriveJoint], wheel_torque: float,
        steering: Sequence[DriveJoint] = (), steering_torque: float = 0.0, servo: BaseServo | None = None,
        response: Response | None = None,
    ) -> None:  # fmt: skip
        """Sets what never changes.

        Args:
            wheels: Joints that are driven by velocity and whose turns odometry counts.
            wheel_torque: N m, of each.
            steering: Joints that are driven by position and whose angles odometry reads.
            steering_torque: N m, of each.
            servo: How the base is moved where its wheels do not move it.
            response: Its delay and slip; None = it has none.
        """
        self.wheels, self.wheel_torque = tuple(wheels), wheel_torque
        self.steering, self.steering_torque = tuple(steering), steering_torque
        self.servo = servo
        self.velocity = PlanarVelocity()
        """What the base was told last, within the limits; with slip it is not what the base does."""
        self.response = response or Response()
        """Its delay and slip."""
        self._delay = CommandDelay(self.response.delay)
        self._grip, self._turn_grip = 1.0 - self.response.slip, 1.0 - self.response.turn_slip
        self._path = DeadReckoning()

    def targets(self, wanted: PlanarVelocity, dt: float) -> DriveTargets:
        """Comes nearer to what was wanted a delay ago, as far as the limits let it in ``dt`` seconds; returns what the motors must do.

        Args:
            wanted: What is wanted now.
            dt: Seconds since the last call, always the same.
        """
        return self._follow(self._delay.pass_on(wanted, dt), dt)

    @property
    def base_velocity(self) -> PlanarVelocity:
        """``velocity`` without what slip takes of it."""
        linear, lateral, angular = self.velocity
        return PlanarVelocity(linear * self._grip, lateral * self._grip, angular * self._turn_grip)

    @property
    def _rolled(self) -> PlanarVelocity:
        """At what the wheels roll in the engine: wheels that push the base do not slip there, so they turn less instead."""
        return self.velocity if self.servo else self.base_velocity

    def encoder_turns(self, increments: Sequence[float]) -> Sequence[float]:
        """Returns what the encoders of ``wheels`` see, radians: what wheels that slip do not turn in the engine is put back.

        Args:
            increments: Radians that each of them rolled forward in the engine.
        """
        return increments

    @abstractmethod
    def _follow(self, wanted: PlanarVelocity, dt: float) -> DriveTargets:
        """Comes nearer to ``wanted`` and returns what the motors must do for it."""

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


class CommandDelay:
    """Holds every wanted velocity back for a while; the base stands still until the first one comes out."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._waiting: deque[PlanarVelocity] = deque()

    def pass_on(self, wanted: PlanarVelocity, dt: float) -> PlanarVelocity:
        """Takes in what is wanted at this step, of ``dt`` seconds, and returns what was wanted the delay before, in whole steps."""
        steps = round(self._seconds / dt)
        if steps < 1:
            return wanted
        self._waiting.append(wanted)
        return self._waiting.popleft() if len(self._waiting) > steps else PlanarVelocity()


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
    # Comparisons, not min() and max(), which take twice as long: this runs at every step.
    target = -limit if wanted < -limit else limit if wanted > limit else wanted
    lowest, highest = current - change, current + change
    return lowest if target < lowest else highest if target > highest else target
