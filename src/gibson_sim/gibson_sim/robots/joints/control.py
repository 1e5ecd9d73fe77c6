"""Joint control: computes the target speed or position of each motor in a step from joint commands. Pure.

The speed is that of a setpoint within the limits, plus a correction proportional to the position error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple, Protocol

from gibson_sim.description.urdf import UrdfJoint
from gibson_sim.errors import CommandError
from gibson_sim.quoting import quoted
from gibson_sim.robots.joints.commands import JointCommand, JointEfforts, JointPositions, JointTrajectory, TrajectoryPoint
from gibson_sim.types import NS_PER_S

DEFAULT_SPEED = 1.0
"""Speed at which a joint without a velocity limit moves to a position, rad/s or m/s."""
_GAIN_PER_S = 50.0
"""Position gain, speed per distance from the setpoint, 1/s: a lag vanishes within 0.1 s."""
_LEAD_S = 0.1
"""Maximum time by which the setpoint leads a blocked joint, s."""
_UNLIMITED_SPEED = 100.0
"""Maximum speed under an effort command of a joint without a velocity limit, rad/s or m/s."""
ARRIVED = 1e-3
"""Distance from the goal at which a motion ends, radians or metres."""
_ROUNDING = 1e-6
"""Tolerated excess of commands over a limit, radians or metres, and per second, for rounding errors of planners."""
_FASTER = 1.01
"""Factor on the velocity limit for the mean velocity between two points of a trajectory, for rounding errors of planners."""


class JointTargets(NamedTuple):
    """Targets of the motors until the next step; joints without a target keep their previous one."""

    speeds: dict[str, float]
    """Speeds to hold, rad/s or m/s."""
    held: dict[str, float]
    """Positions to hold, radians or metres."""
    efforts: dict[str, float]
    """Effort limits, N m or N; missing = that of the joint."""


class _Motion(Protocol):
    """The motion of one joint under a command."""

    effort: float | None
    """Effort limit of its motor, N m or N; None = that of the joint."""

    def speed(self, position: float, now_ns: int, step_ns: int) -> float:
        """Returns the speed for the step that begins at ``now_ns`` with the joint at ``position``."""

    def end(self, position: float, now_ns: int) -> float | None:
        """Returns the position to hold if the motion is over, else None."""


class JointControl:
    """Controls the joints of one robot that accept commands."""

    def __init__(self, joints: Sequence[UrdfJoint], others: Sequence[str] = ()) -> None:
        """Starts without commands.

        Args:
            joints: Joints that accept commands, in the order of the URDF.
            others: Joints that are controlled otherwise (the wheels of the drive), for error messages.
        """
        self._joints = {joint.name: joint for joint in joints}
        self._others = tuple(others)
        self._motions: dict[str, _Motion] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints that accept commands, in the order of the URDF."""
        return tuple(self._joints)

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the joints whose targets may change in the next step."""
        return tuple(self._motions)

    def command(
        self, command: JointCommand, now_ns: int, positions: Mapping[str, float], velocities: Mapping[str, float]
    ) -> None:
        """Replaces the motions of the joints in a command, starting from their current state.

        Args:
            command: The command; a trajectory without points stops its joints, without names all joints.
            now_ns: Simulation time, ns.
            positions: Current positions of all ``names``.
            velocities: Current velocities of all ``names``.

        Raises:
            CommandError: a joint is unknown, a value exceeds a limit, or the trajectory has already ended; the state is unchanged.
        """
        if isinstance(command, JointTrajectory):
            new = self._trajectory(command, now_ns, positions, velocities)
        elif isinstance(command, JointPositions):
            new = {}
            efforts = command.efforts or (0.0,) * len(command.positions)
            for (joint, goal), effort in zip(self._rows(command.names, command.positions, "positions"), efforts, strict=True):
                _check_position(joint, goal, "")
                _check_effort(joint, effort)
                new[joint.name] = _ToPosition(joint, goal, positions[joint.name], effort or None)
        elif isinstance(command, JointEfforts):
            new = {}
            for joint, effort in self._rows(command.names, command.efforts, "efforts"):
                _check_effort(joint, effort)
                new[joint.name] = _AtEffort(joint, effort)
        else:
            new = {}
            for joint, speed in self._rows(command.names, command.velocities, "velocities"):
                _check_velocity(joint, speed, "")
                new[joint.name] = _AtVelocity(joint, speed) if speed else _Hold(positions[joint.name])
        self._motions.update(new)

    def step(self, now_ns: int, step_ns: int, positions: Mapping[str, float]) -> JointTargets:
        """Returns the changed targets for the step from ``now_ns`` of length ``step_ns``; ``positions``: of all ``active`` joints."""
        speeds, held, efforts = {}, {}, {}
        for name, motion in list(self._motions.items()):
            end = motion.end(positions[name], now_ns)
            if motion.effort is not None:
                efforts[name] = motion.effort
            if end is not None:
                held[name] = end
                del self._motions[name]
                continue
            speeds[name] = motion.speed(positions[name], now_ns, step_ns)
            if motion.effort == 0.0:  # a free joint needs no further targets
                del self._motions[name]
        return JointTargets(speeds, held, efforts)

    def setpoint(self, name: str, now_ns: int) -> float | None:
        """Returns the setpoint of a joint on its trajectory, radians or metres; None = no trajectory, or it has ended."""
        motion = self._motions.get(name)
        return motion.setpoint(now_ns) if isinstance(motion, _AlongTrajectory) else None

    def _rows(self, names: tuple[str, ...], row: tuple[float, ...], what: str) -> list[tuple[UrdfJoint, float]]:
        names = names or self.names
        if len(row) != len(names):
            raise CommandError(
                f"joint command has {len(row)} {what}, the robot has {len(names)} joints that accept commands: {', '.join(names) or 'none'}"
            )
        return [(self._joint(name), value) for name, value in zip(names, row, strict=True)]

    def _joint(self, name: str) -> UrdfJoint:
        if name in self._others:
            raise CommandError(f"joint {quoted(name)} belongs to the drive; send a velocity (cmd_vel) instead")
        if name not in self._joints:
            raise CommandError(f"no joint {quoted(name)} that accepts commands; known: {', '.join(self._joints) or 'none'}")
        return self._joints[name]

    def _trajectory(
        self, command: JointTrajectory, now_ns: int, positions: Mapping[str, float], velocities: Mapping[str, float]
    ) -> dict[str, _Motion]:
        if not command.points:
            names = [self._joint(name).name for name in command.names] or self.active
            return {name: _Hold(positions[name]) for name in names}
        start_ns = command.start_ns or now_ns
        out: dict[str, _Motion] = {}
        for i, name in enumerate(command.names):
            joint = self._joint(name)
            knots = [_knot(joint, k, i, point, start_ns) for k, point in enumerate(command.points)]
            if knots[-1].time_ns == now_ns:
                out[name] = _ToPosition(joint, knots[-1].position, positions[name])
                continue
            if knots[-1].time_ns < now_ns:
                raise CommandError(
                    f"joint trajectory ended at {knots[-1].time_ns / NS_PER_S:g} s, now it is {now_ns / NS_PER_S:g} s; "
                    "stamp it 0 to start at once"
                )
            out[name] = _path(
                joint, knots, max(now_ns, start_ns), positions[name], velocities[name] if start_ns <= now_ns else 0.0
            )
        return out


class _Hold:
    """Holds a position."""

    effort: float | None = None

    def __init__(self, position: float) -> None:
        self._position = position

    def speed(self, position: float, now_ns: int, step_ns: int) -> float:
        return 0.0

    def end(self, position: float, now_ns: int) -> float | None:
        return self._position


class _AtVelocity:
    """Moves at a velocity until a position limit, and holds that position."""

    effort: float | None = None

    def __init__(self, joint: UrdfJoint, speed: float) -> None:
        self._joint, self._speed = joint, speed

    def speed(self, position: float, now_ns: int, step_ns: int) -> float:
        if not self._joint.is_bounded:
            return self._speed
        dt = step_ns / NS_PER_S
        return min(max(self._speed, (self._joint.lower - position) / dt), (self._joint.upper - position) / dt)

    def end(self, position: float, now_ns: int) -> float | None:
        return None


class _AtEffort(_AtVelocity):
    """Applies an effort: the target of the motor is the maximum speed, with the effort as limit."""

    def __init__(self, joint: UrdfJoint, effort: float) -> None:
        super().__init__(joint, math.copysign(joint.velocity or _UNLIMITED_SPEED, effort))
        self.effort = abs(effort)


class _ToPosition:
    """Moves to a position at maximum speed."""

    def __init__(self, joint: UrdfJoint, goal: float, position: float, effort: float | None = None) -> None:
        self._fastest, self._goal, self._setpoint = joint.velocity or DEFAULT_SPEED, goal, position
        self.effort = effort

    def speed(self, position: float, now_ns: int, step_ns: int) -> float:
        lead, change = self._fastest * _LEAD_S, self._fastest * step_ns / NS_PER_S
        now = min(max(self._setpoint, position - lead), position + lead)
        self._setpoint = min(max(self._goal, now - change), now + change)
        return servo_speed(now, self._setpoint, position, step_ns, self._fastest)

    def end(self, position: float, now_ns: int) -> float | None:
        return self._goal if self._setpoint == self._goal and abs(position - self._goal) < ARRIVED else None


class _Knot(NamedTuple):
    """A point of a trajectory for one joint."""

    time_ns: int
    """Simulation time."""
    position: float
    velocity: float | None = None
    acceleration: float | None = None


class _AlongTrajectory:
    """Moves through knots."""

    effort: float | None = None

    def __init__(self, joint: UrdfJoint, knots: Sequence[_Knot]) -> None:
        self._fastest = joint.velocity or math.inf
        self._lower, self._upper = (joint.lower, joint.upper) if joint.is_bounded else (-math.inf, math.inf)
        self._knots = knots
        self._polynomials = [_polynomial(a, b) for a, b in pairwise(knots)]
        self._segment = 0

    def speed(self, position: float, now_ns: int, step_ns: int) -> float:
        now = self.setpoint(now_ns)
        return servo_speed(now, self.setpoint(now_ns + step_ns), position, step_ns, self._fastest)

    def end(self, position: float, now_ns: int) -> float | None:
        last = self._knots[-1]
        return last.position if now_ns >= last.time_ns and abs(position - last.position) < ARRIVED else None

    def setpoint(self, time_ns: int) -> float:
        """Returns the setpoint at a time, clamped to the limits, also between two knots."""
        if time_ns <= self._knots[0].time_ns:
            return self._knots[0].position
        if time_ns >= self._knots[-1].time_ns:
            return self._knots[-1].position
        while time_ns >= self._knots[self._segment + 1].time_ns:
            self._segment += 1
        while time_ns < self._knots[self._segment].time_ns:
            self._segment -= 1
        t = (time_ns - self._knots[self._segment].time_ns) / NS_PER_S
        position = 0.0
        for coefficient in reversed(self._polynomials[self._segment]):
            position = position * t + coefficient
        return min(max(position, self._lower), self._upper)


def _path(joint: UrdfJoint, knots: list[_Knot], first_ns: int, position: float, velocity: float) -> _AlongTrajectory:
    """Returns the motion through the knots after ``first_ns``, starting from the state of the joint at that time."""
    ahead = [knot for knot in knots if knot.time_ns > first_ns]
    # Planners repeat the current state as the first point, and only they know its acceleration.
    acceleration = next((knot.acceleration for knot in knots if knot.time_ns == first_ns), None)
    all_knots = [_Knot(first_ns, position, velocity, acceleration or 0.0), *ahead]
    for a, b in pairwise(all_knots):
        mean = (b.position - a.position) / (b.time_ns - a.time_ns) * NS_PER_S
        if joint.velocity and abs(mean) > joint.velocity * _FASTER:
            raise CommandError(
                f"joint trajectory: joint {quoted(joint.name)} would go from {a.position:g} to {b.position:g} at {abs(mean):g} a second, "
                f"its limit is {joint.velocity:g}; give it more time"
            )
    return _AlongTrajectory(joint, all_knots)


def _polynomial(a: _Knot, b: _Knot) -> tuple[float, ...]:
    """Returns the coefficients of a polynomial of seconds since ``a``, constant first: quintic, cubic or linear, by the data of both ends."""
    t, change = (b.time_ns - a.time_ns) / NS_PER_S, b.position - a.position
    if a.velocity is None or b.velocity is None:
        return a.position, change / t
    v0, v1 = a.velocity, b.velocity
    if a.acceleration is None or b.acceleration is None:
        return a.position, v0, (3.0 * change - (2.0 * v0 + v1) * t) / t**2, (-2.0 * change + (v0 + v1) * t) / t**3
    a0, a1 = a.acceleration, b.acceleration
    return (
        a.position,
        v0,
        a0 / 2.0,
        (20.0 * change - (8.0 * v1 + 12.0 * v0) * t - (3.0 * a0 - a1) * t**2) / (2.0 * t**3),
        (-30.0 * change + (14.0 * v1 + 16.0 * v0) * t + (3.0 * a0 - 2.0 * a1) * t**2) / (2.0 * t**4),
        (12.0 * change - 6.0 * (v1 + v0) * t - (a0 - a1) * t**2) / (2.0 * t**5),
    )


def servo_speed(now: float, then: float, position: float, step_ns: int, fastest: float) -> float:
    """Returns the motor speed of a joint at ``position`` while its setpoint moves from ``now`` to ``then``.

    Args:
        now: Setpoint at the beginning of the step.
        then: Setpoint at the end of the step.
        position: Position of the joint at the beginning of the step.
        step_ns: Length of the step, ns.
        fastest: Speed limit, above 0.
    """
    dt = step_ns / NS_PER_S
    speed = (then - now) / dt + min(_GAIN_PER_S, 0.5 / dt) * (now - position)
    return min(max(speed, -fastest), fastest)


def _knot(joint: UrdfJoint, number: int, column: int, point: TrajectoryPoint, start_ns: int) -> _Knot:
    where = f" of point {number}"
    _check_position(joint, point.positions[column], where)
    velocity = point.velocities[column] if point.velocities else None
    if velocity is not None:
        _check_velocity(joint, velocity, where)
    acceleration = point.accelerations[column] if point.accelerations else None
    return _Knot(start_ns + point.time_ns, point.positions[column], velocity, acceleration)


def _check_position(joint: UrdfJoint, value: float, where: str) -> None:
    if joint.is_bounded and not joint.lower - _ROUNDING <= value <= joint.upper + _ROUNDING:
        raise CommandError(
            f"joint {quoted(joint.name)}: position{where} is {value:g}, must be {joint.lower:g} to {joint.upper:g}"
        )


def _check_velocity(joint: UrdfJoint, value: float, where: str) -> None:
    if joint.velocity and abs(value) > joint.velocity + _ROUNDING:
        raise CommandError(
            f"joint {quoted(joint.name)}: velocity{where} is {value:g}, must be {-joint.velocity:g} to {joint.velocity:g}"
        )


def _check_effort(joint: UrdfJoint, value: float) -> None:
    if joint.effort and abs(value) > joint.effort + _ROUNDING:
        raise CommandError(f"joint {quoted(joint.name)}: effort is {value:g}, must be {-joint.effort:g} to {joint.effort:g}")
