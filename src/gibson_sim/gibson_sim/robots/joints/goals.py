"""When the goal of an arm or a gripper is reached or missed: the rules of ros2_controllers' joint_trajectory_controller and gripper controllers.

Pure: positions and times go in, an outcome comes out. ``ros/topics/arm_actions.py`` has the actions.
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
"""Default time that a trajectory may be late, s."""
STALL_SPEED = 1e-3
"""Speed of a finger below which it counts as blocked, rad/s or m/s."""
STALL_TIME_NS = NS_PER_S // 5
"""Time that fingers must be blocked for a gripper to count as stalled, usually by what it holds, simulation time, ns."""


class TrajectoryCode(IntEnum):
    """How a trajectory ended: error codes of control_msgs/FollowJointTrajectory."""

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
    """Radians or metres."""
    velocity: float = 0.0
    """rad/s or m/s."""

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
    """The goal of a trajectory: its end, and tolerances."""

    names: tuple[str, ...]
    end: tuple[float, ...]
    """Position of each joint at the end, radians or metres."""
    end_ns: int
    """Simulation time of the end."""
    path: Mapping[str, Tolerance] = field(default_factory=dict)
    """Tolerances on the way; unlimited by default."""
    goal: Mapping[str, Tolerance] = field(default_factory=dict)
    """Tolerances at the end."""
    goal_time: float = 0.0
    """Time that it may be late, s; 0 = the default."""

    def check(self, known: Sequence[str]) -> None:
        """Raises CommandError if the trajectory does not move the joint of a tolerance, or a joint is not one of ``known``."""
        for name in (*self.path, *self.goal):
            if name not in self.names:
                raise CommandError(
                    f"tolerance is given for joint {quoted(name)}, which the trajectory does not move: {', '.join(self.names)}"
                )
        for name in self.names:
            if name not in known:
                raise CommandError(f"joint {quoted(name)} is none of this controller's: {', '.join(known)}")

    def outcome(
        self, now_ns: int, desired: Mapping[str, float], positions: Mapping[str, float], velocities: Mapping[str, float]
    ) -> Ended | None:
        """Returns how the goal ended, or None while it goes on.

        Args:
            now_ns: Simulation time.
            desired: Present setpoints of the trajectory; joints that are missing are at its end.
            positions: Present positions of all joints of the goal.
            velocities: Their velocities.
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
        """Returns which tolerance at the end is not met, in words; empty = all are."""
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
    """Mean of all fingers, radians or metres."""
    effort: float
    """Maximum of all fingers, N or N m."""
    stalled: bool
    """Whether something blocks them."""
    reached_goal: bool

    @property
    def is_over(self) -> bool:
        """Whether the gripper is at its goal, or cannot get there."""
        return self.stalled or self.reached_goal


class GripperGoal:
    """The goal of a gripper."""

    def __init__(self, joints: tuple[str, ...], position: float, now_ns: int) -> None:
        """Begins at ``now_ns``; ``position`` is that of every finger, radians or metres."""
        self._joints, self._position, self._moved_ns = joints, position, now_ns

    def outcome(
        self, now_ns: int, positions: Mapping[str, float], velocities: Mapping[str, float], efforts: Mapping[str, float]
    ) -> GripperOutcome:
        """Returns the state of the fingers now; call it at every tick."""
        if any(abs(velocities[name]) > STALL_SPEED for name in self._joints):
            self._moved_ns = now_ns
        reached = all(abs(positions[name] - self._position) <= GOAL_TOLERANCE / 4 for name in self._joints)
        return GripperOutcome(
            sum(positions[name] for name in self._joints) / len(self._joints),
            max(abs(efforts[name]) for name in self._joints),
            not reached and now_ns - self._moved_ns >= STALL_TIME_NS,
            reached,
        )
