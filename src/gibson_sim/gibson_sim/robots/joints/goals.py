"""Determines whether the goal of an arm or a gripper is reached or missed, as ros2_controllers' joint_trajectory_controller and gripper controllers.

Pure: computes an outcome from positions and times. ``ros/topics/arm_actions.py`` implements the actions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

from gibson_sim.errors import CommandError
from gibson_sim.quoting import quoted
from gibson_sim.types import NS_PER_S

GOAL_TOLERANCE = 0.01
"""Default tolerance of a joint at the end of its trajectory, radians or metres."""
GOAL_TIME = 2.0
"""Default maximum delay after the end of a trajectory, s."""
STALL_SPEED = 1e-3
"""Speed below which a finger counts as blocked, rad/s or m/s."""
STALL_TIME_NS = NS_PER_S // 5
"""Time for which fingers must be blocked for a gripper to count as stalled, usually by the grasped object, simulation time, ns."""


class TrajectoryCode(IntEnum):
    """Result of a trajectory: error codes of control_msgs/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Tolerances of one joint; 0 = the default, below 0 = unlimited."""

    position: float = 0.0
    """Position tolerance, radians or metres."""
    velocity: float = 0.0
    """Velocity tolerance, rad/s or m/s."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.position) and math.isfinite(self.velocity)):
            raise CommandError(f"tolerance of a joint is {self.position}, {self.velocity}; its numbers must be finite")


@dataclass(frozen=True, slots=True)
class Ended:
    """The result of a goal."""

    code: TrajectoryCode
    reason: str = ""


@dataclass(frozen=True, slots=True)
class TrajectoryGoal:
    """The goal of a trajectory: its end state and tolerances."""

    names: tuple[str, ...]
    end: tuple[float, ...]
    """Position of each joint at the end, radians or metres."""
    end_ns: int
    """Simulation time of the end."""
    path: Mapping[str, Tolerance] = field(default_factory=dict)
    """Joint -> tolerance during the motion; unlimited by default."""
    goal: Mapping[str, Tolerance] = field(default_factory=dict)
    """Joint -> tolerance at the end."""
    goal_time: float = 0.0
    """Maximum delay after the end of the trajectory, s; 0 = the default."""

    def check(self, known: Sequence[str]) -> None:
        """Raises CommandError if a tolerance is given for a joint that the trajectory does not move, or a joint is not in ``known``."""
        for name in (*self.path, *self.goal):
            if name not in self.names:
                raise CommandError(
                    f"tolerance is given for joint {quoted(name)}, which the trajectory does not move: {', '.join(self.names)}"
                )
        for name in self.names:
            if name not in known:
                raise CommandError(f"joint {quoted(name)} does not belong to this controller: {', '.join(known)}")

    def outcome(
        self, now_ns: int, desired: Mapping[str, float], positions: Mapping[str, float], velocities: Mapping[str, float]
    ) -> Ended | None:
        """Returns the result of the goal, or None while it is active.

        Args:
            now_ns: Simulation time, ns.
            desired: Current setpoints of the trajectory; missing joints are at its end.
            positions: Current positions of all joints of the goal.
            velocities: Current velocities of all joints of the goal.
        """
        if now_ns < self.end_ns:
            for name, tolerance in self.path.items():
                error = abs(positions[name] - desired.get(name, positions[name]))
                if tolerance.position > 0.0 and error > tolerance.position:
                    reason = f"joint {quoted(name)} is {error:.4g} off its path, allowed are {tolerance.position:g}"
                    return Ended(TrajectoryCode.PATH_TOLERANCE_VIOLATED, reason)
            return None
        missed = self._missed(positions, velocities)
        if not missed:
            return Ended(TrajectoryCode.SUCCESSFUL)
        late_s = (now_ns - self.end_ns) / NS_PER_S
        if late_s > (self.goal_time or GOAL_TIME):
            return Ended(TrajectoryCode.GOAL_TOLERANCE_VIOLATED, f"{missed}, {late_s:.2f} s after the end of the trajectory")
        return None

    def _missed(self, positions: Mapping[str, float], velocities: Mapping[str, float]) -> str:
        """Returns the violated tolerance at the end, as text; empty = all are met."""
        for name, end in zip(self.names, self.end, strict=True):
            tolerance = self.goal.get(name, Tolerance())
            allowed, error = tolerance.position or GOAL_TOLERANCE, abs(positions[name] - end)
            if allowed > 0.0 and error > allowed:
                return f"joint {quoted(name)} is {error:.4g} off its goal, allowed are {allowed:g}"
            if 0.0 < tolerance.velocity < abs(velocities[name]):
                return f"joint {quoted(name)} moves at {abs(velocities[name]):.4g}, allowed are {tolerance.velocity:g}"
        return ""


@dataclass(frozen=True, slots=True)
class GripperOutcome:
    """State of the fingers."""

    position: float
    """Mean position of all fingers, radians or metres."""
    effort: float
    """Maximum effort of all fingers, N or N m."""
    stalled: bool
    """Whether the fingers are blocked."""
    reached_goal: bool

    @property
    def is_over(self) -> bool:
        """Whether the gripper is at its goal, or stalled."""
        return self.stalled or self.reached_goal


class GripperGoal:
    """The goal of a gripper."""

    def __init__(self, joints: tuple[str, ...], position: float, now_ns: int) -> None:
        """Starts at ``now_ns``; ``position``: goal of every finger, radians or metres."""
        self._joints, self._position, self._moved_ns = joints, position, now_ns

    def outcome(
        self, now_ns: int, positions: Mapping[str, float], velocities: Mapping[str, float], efforts: Mapping[str, float]
    ) -> GripperOutcome:
        """Returns the current state of the fingers; call it at every tick."""
        if any(abs(velocities[name]) > STALL_SPEED for name in self._joints):
            self._moved_ns = now_ns
        reached = all(abs(positions[name] - self._position) <= GOAL_TOLERANCE / 4 for name in self._joints)
        return GripperOutcome(
            sum(positions[name] for name in self._joints) / len(self._joints),
            max(abs(efforts[name]) for name in self._joints),
            not reached and now_ns - self._moved_ns >= STALL_TIME_NS,
            reached,
        )
