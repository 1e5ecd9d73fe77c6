"""Joint commands for arms, grippers and lifts: pure values, validated at construction. Radians or metres, and per second.

``robots.joints.control`` validates them against the limits of a robot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from gibson_sim.errors import CommandError
from gibson_sim.quoting import quoted

Numbers = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class JointPositions:
    """Moves joints to positions as fast as their limits allow, and holds the positions."""

    positions: Numbers
    names: tuple[str, ...] = ()
    """Joint names, one for each number; empty = all joints that accept commands, in the order of the URDF."""
    efforts: Numbers = ()
    """Effort limit of each motor, during the motion and at the goal, N m or N; 0, or empty = that of the joint."""

    def __post_init__(self) -> None:
        _check_row("joint positions", self.names, self.positions)
        if self.efforts:
            _check_count("joint positions", "efforts", len(self.efforts), len(self.positions))
            _check_finite("joint positions: efforts", self.names, self.efforts)
            if min(self.efforts) < 0.0:
                raise CommandError(
                    f"joint positions: an effort is {min(self.efforts):g}, must be 0 or more; 0 = what the joint allows"
                )


@dataclass(frozen=True, slots=True)
class JointVelocities:
    """Moves joints at velocities until the next command or a position limit; 0 = hold the position."""

    velocities: Numbers
    names: tuple[str, ...] = ()
    """Joint names, one for each number; empty = all joints that accept commands, in the order of the URDF."""

    def __post_init__(self) -> None:
        _check_row("joint velocities", self.names, self.velocities)


@dataclass(frozen=True, slots=True)
class JointEfforts:
    """Applies efforts until the next command, within the limits of velocity and position; 0 = the joint moves freely."""

    efforts: Numbers
    """Efforts, N m or N."""
    names: tuple[str, ...] = ()
    """Joint names, one for each number; empty = all joints that accept commands, in the order of the URDF."""

    def __post_init__(self) -> None:
        _check_row("joint efforts", self.names, self.efforts)


@dataclass(frozen=True, slots=True)
class TrajectoryPoint:
    """Joint states of a trajectory at one time, in the order of its names."""

    time_ns: int
    """Time from the start of the trajectory, nanoseconds."""
    positions: Numbers
    velocities: Numbers = ()
    """Velocities; empty = not given."""
    accelerations: Numbers = ()
    """Accelerations; empty = not given; they require velocities."""


@dataclass(frozen=True, slots=True)
class JointTrajectory:
    """Moves joints through points (trajectory_msgs/JointTrajectory); without points, the named joints stop, without names all joints.

    Interpolation between two points: quintic if both have accelerations, cubic if both have velocities, else linear.
    """

    names: tuple[str, ...]
    points: tuple[TrajectoryPoint, ...]
    start_ns: int = 0
    """Simulation time at which it starts, ns; 0 = when it arrives."""

    def __post_init__(self) -> None:
        if not self.points:
            return
        if not self.names:
            raise CommandError(f"joint trajectory has {len(self.points)} points but no joint names; give one for each position")
        _check_names("joint trajectory", self.names)
        last = -1
        for i, point in enumerate(self.points):
            what = f"joint trajectory: point {i}"
            for key in ("positions", "velocities", "accelerations"):
                row = getattr(point, key)
                if row or key == "positions":
                    _check_count(what, key, len(row), len(self.names))
                    _check_finite(f"{what}: {key}", self.names, row)
            if point.accelerations and not point.velocities:
                raise CommandError(f"{what} has accelerations but no velocities; give both, or no accelerations")
            if point.time_ns <= last:
                requirement = "must not be negative" if i == 0 else f"must be after that of point {i - 1}, {last / 1e9:g} s"
                raise CommandError(f"{what}: time_from_start is {point.time_ns / 1e9:g} s, {requirement}")
            last = point.time_ns


JointCommand = JointPositions | JointVelocities | JointEfforts | JointTrajectory


def _check_row(what: str, names: tuple[str, ...], row: Numbers) -> None:
    if not row:
        raise CommandError(f"{what}: there are none; send one number for each joint")
    if names:
        _check_names(what, names)
        _check_count(what, "numbers", len(row), len(names))
    _check_finite(what, names, row)


def _check_names(what: str, names: tuple[str, ...]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise CommandError(f"{what}: joint {quoted(name)} is named twice; name each joint once")


def _check_count(what: str, key: str, count: int, joints: int) -> None:
    if count != joints:
        raise CommandError(f"{what} has {count} {key} for {joints} joints; send one for each")


def _check_finite(what: str, names: tuple[str, ...], row: Numbers) -> None:
    for i, value in enumerate(row):
        if not math.isfinite(value):
            joint = repr(names[i]) if names else f"number {i}"
            raise CommandError(f"{what}: that of joint {joint} is {value}, must be finite")
