"""Integrals of velocities, as distance and turn: recorded ones between two nodes, commands between two views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gibson_path_following.types import STOP, RecordedPath, Velocity

NS_PER_S = 1_000_000_000
_MOVING = 0.01
"""Speed, m/s, and yaw rate, rad/s, below which a robot stands still."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Commanded motion in an interval."""

    distance: float
    """Metres, positive forward."""
    turn: float
    """Radians, positive to the left."""
    duration: float
    """Time with a command other than a stop, seconds."""


def motion_between(velocities: Sequence[tuple[int, Velocity]], start_ns: int, end_ns: int) -> Motion:
    """Returns the integral of velocities over an interval.

    Args:
        velocities: times, ns, and velocities from then on, in order; before the first the robot stands.
        start_ns: begin of the interval, ns.
        end_ns: its end, ns.
    """
    distance = turn = duration = 0.0
    for i, (begin_ns, velocity) in enumerate(velocities):
        until_ns = min(end_ns, velocities[i + 1][0] if i + 1 < len(velocities) else end_ns)
        seconds = max(0, until_ns - max(start_ns, begin_ns)) / NS_PER_S
        distance += velocity.linear * seconds
        turn += velocity.angular * seconds
        if abs(velocity.linear) > _MOVING or abs(velocity.angular) > _MOVING:
            duration += seconds
    return Motion(distance, turn, duration)


def segments(path: RecordedPath) -> tuple[Motion, ...]:
    """Returns the motion from each node to the next, (nodes - 1).

    Its distance is that between the nodes. Without recorded velocities, turn and duration are 0.
    """
    found = []
    for node, after in zip(path.nodes[:-1], path.nodes[1:], strict=True):
        driven = motion_between(node.velocities, 0, after.stamp_ns - node.stamp_ns)
        distance = after.distance - node.distance
        if driven.distance < 0.0:  # recorded while driving backwards
            distance = -distance
        found.append(Motion(distance, driven.turn, driven.duration))
    return tuple(found)


def has_motion(path: RecordedPath) -> bool:
    """Returns whether a path has distances or turns: from odometry or commands, not from images alone."""
    return any(part.distance != 0.0 or part.turn != 0.0 for part in segments(path))


class CommandLog:
    """Recent commands to a robot."""

    def __init__(self, keep_s: float = 10.0) -> None:
        self._keep_ns = round(keep_s * NS_PER_S)
        self._sent: list[tuple[int, Velocity]] = []

    def clear(self) -> None:
        """Drops all commands."""
        self._sent.clear()

    def add(self, now_ns: int, velocity: Velocity) -> None:
        """Adds a command that holds from ``now_ns`` on."""
        while self._sent and self._sent[-1][0] >= now_ns:  # replaced before it took effect
            self._sent.pop()
        if not self._sent or self._sent[-1][1] != velocity:
            self._sent.append((now_ns, velocity))
        while len(self._sent) > 1 and self._sent[1][0] < now_ns - self._keep_ns:
            self._sent.pop(0)

    @property
    def last(self) -> Velocity:
        """The newest command."""
        return self._sent[-1][1] if self._sent else STOP

    def motion(self, start_ns: int, end_ns: int) -> Motion:
        """Returns the commanded motion in an interval, ns; before the first command the robot stands."""
        return motion_between(self._sent, start_ns, end_ns)

    def known_motion(self, start_ns: int, end_ns: int) -> Motion | None:
        """Returns the commanded motion in an interval, ns; None = unknown: no command precedes its end."""
        return self.motion(start_ns, end_ns) if self._sent and self._sent[0][0] <= end_ns else None
