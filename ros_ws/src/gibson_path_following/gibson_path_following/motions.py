"""What was driven: recorded velocities between two nodes, and commands between two views, as distance and turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gibson_path_following.types import STOP, RecordedPath, Velocity

NS_PER_S = 1_000_000_000
_MOVING = 0.01
"""m/s or rad/s below which a velocity counts as standing still."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What was commanded in an interval of time."""

    distance: float
    """Metres forward."""
    turn: float
    """Radians to the left."""
    duration: float
    """Seconds in which anything but a stop was commanded."""


def motion_between(velocities: Sequence[tuple[int, Velocity]], start_ns: int, end_ns: int) -> Motion:
    """Returns the integral of velocities, each of which holds from its time, ns, until the next one's, over an interval.

    Args:
        velocities: (time, velocity), in the order of time; before the first the robot stands.
        start_ns: begin of the interval.
        end_ns: its end.
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
    """Returns what was driven from each node to the next, one fewer than there are nodes.

    The distance is that of the nodes. Without recorded velocities the turn is 0 and the duration unknown, 0.
    """
    found = []
    for node, after in zip(path.nodes[:-1], path.nodes[1:], strict=True):
        driven = motion_between(node.velocities, 0, after.stamp_ns - node.stamp_ns)
        distance = after.distance - node.distance
        if driven.distance < 0.0:  # recorded while driving backwards
            distance = -distance
        found.append(Motion(distance, driven.turn, driven.duration))
    return tuple(found)


class CommandLog:
    """The commands that were sent to a robot, for as long as they matter."""

    def __init__(self, keep_s: float = 10.0) -> None:
        self._keep_ns = round(keep_s * NS_PER_S)
        self._sent: list[tuple[int, Velocity]] = []

    def clear(self) -> None:
        """Forgets all commands; the robot stands."""
        self._sent.clear()

    def add(self, now_ns: int, velocity: Velocity) -> None:
        """Notes a command that holds from ``now_ns`` on."""
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
        """Returns what was commanded in an interval."""
        return motion_between(self._sent, start_ns, end_ns)
