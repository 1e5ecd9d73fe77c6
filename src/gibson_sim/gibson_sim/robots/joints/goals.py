"""When the goal of an arm or a gripper is reached, or missed: the rules of ros2_controllers' joint_trajectory_controller and gripper controllers.

Pure: positions and times go in, an outcome comes out. ``ros/topics/arm_actions.py`` puts actions around it.
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
"""Radians or metres by which a joint may miss the end of its trajectory, unless the goal says otherwise."""
GOAL_TIME = 2.0
"""Seconds that it may be late, unless the goal says otherwise."""
STALL_SPEED = 1e-3
"""rad/s or m/s of a finger below which it counts as held up."""
STALL_TIME_NS = NS_PER_S // 5
"""How long, simulation time, fingers must be held up for a gripper to count as stalled: by what it holds, as a rule."""


class TrajectoryCode(IntEnum):
    """How a trajectory ended: the numbers of control_msgs/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


@dataclass(frozen=True, slots=True)
class Tolerance:
    """What one joint may miss; 0 = what is usual, below 0 = anything."""

    position: float = 0.0
    """Radians or metres."""
    velocity: float = 0.0
    """rad/s or m/s."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.position) and math.isfinite(self.velocity)):
            raise CommandError(f"tolerance of a joint is {self.position}, {self.velocity}; its numbers must be finite")


@dataclass(frozen=True, slots=True)
class Ended:
    """A goal is over."""

    code: TrajectoryCode
    reason: str = ""


@dataclass(frozen=True, slots=True)
class TrajectoryGoal:
    """What a trajectory must fulfil."""

    names: tuple[str, ...]
    end: tuple[float, ...]
    """Where each joint shall be at last, radians or metres."""
    end_ns: int
    """Simulation time at which it shall be there."""
    path: Mapping[str, Tolerance] = field(default_factory=dict)
    """On the way; usual is anything."""
    goal: Mapping[str, Tolerance] = field(default_factory=dict)
    """At the end."""
    goal_time: float = 0.0
    """Seconds that it may be late; 0 = what is usual."""

    def check(self, known: Sequence[str]) -> None:
        """Raises CommandError where a tolerance is of a joint that the trajectory does not move, or a joint is not one of ``known``."""
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
            desired: Where joints shall be by the trajectory now; those that are not named are at its end.
            positions: Of all joints of the goal, now.
            velocities: The same.
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
        """Returns what is not yet as it shall be, in words; empty = all is."""
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
    """How fingers are."""

    position: float
    """Radians or metres: the mean of all fingers."""
    effort: float
    """N or N m: the greatest of all."""
    stalled: bool
    """Something holds them up."""
    reached_goal: bool

    @property
    def is_over(self) -> bool:
        """Whether the gripper is there, or cannot get there."""
        return self.stalled or self.reached_goal


class GripperGoal:
    """What a gripper was told."""

    def __init__(self, joints: tuple[str, ...], position: float, now_ns: int) -> None:
        """Begins at ``now_ns``; ``position``: of every finger, radians or metres."""
        self._joints, self._position, self._moved_ns = joints, position, now_ns

    def outcome(
        self, now_ns: int, positions: Mapping[str, float], velocities: Mapping[str, float], efforts: Mapping[str, float]
    ) -> GripperOutcome:
        """Returns how the fingers are now; call it at every tick."""
        if any(abs(velocities[name]) > STALL_SPEED for name in self._joints):
            self._moved_ns = now_ns
        reached = all(abs(positions[name] - self._position) <= GOAL_TOLERANCE / 4 for name in self._joints)
        return GripperOutcome(
            sum(positions[name] for name in self._joints) / len(self._joints),
            max(abs(efforts[name]) for name in self._joints),
            not reached and now_ns - self._moved_ns >= STALL_TIME_NS,
            reached,
        )
