"""What a robot does where no way is free: it waits, looks to both sides, backs off a little, and at last stops."""

from __future__ import annotations

from dataclasses import dataclass

from gibson_path_following.errors import check_ranges
from gibson_path_following.types import STOP, Velocity

_ELSEWHERE = 1.0
"""Distance along the path after which another thing blocks it, metres."""


@dataclass(frozen=True, slots=True)
class RecoverySettings:
    """How long the robot waits and what it tries."""

    wait: float = 1.6
    """Time that it waits before it tries something, seconds: people walk on."""
    look_rate: float = 0.6
    """Yaw rate while it looks to a side, rad/s."""
    look_time: float = 1.0
    """Time of a look to a side, and back, each, seconds."""
    back_speed: float = 0.15
    """Speed backwards, m/s."""
    back_time: float = 1.6
    """Time that it backs off, seconds: where it came from was free."""
    tries: int = 2
    """How often it does all that on one metre of the path before it stops for good."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("wait", 0.0, 3600.0),
            ("look_rate", 0.0, 10.0),
            ("look_time", 0.0, 60.0),
            ("back_speed", 0.0, 5.0),
            ("back_time", 0.0, 60.0),
            ("tries", 0, 1000),
        )


class Recovery:
    """Acts while the robot is blocked."""

    def __init__(self, settings: RecoverySettings | None = None) -> None:
        self.settings = settings = settings or RecoverySettings()
        left, right = Velocity(0.0, settings.look_rate), Velocity(0.0, -settings.look_rate)
        self._acts: tuple[tuple[float, Velocity], ...] = (
            (settings.wait, STOP),
            (settings.back_time, Velocity(-settings.back_speed, 0.0)),
            (settings.look_time, left),
            (2.0 * settings.look_time, right),
            (settings.look_time, left),
        )
        """What it does one after the other: time in seconds, and velocity."""
        self._time = 0.0
        """Since it is blocked, seconds."""
        self._tried = 0
        self._where = 0.0
        """Farthest place on the path where it was blocked, metres."""

    def reset(self) -> None:
        """Forgets that the robot was blocked."""
        self._time, self._tried, self._where = 0.0, 0, 0.0

    @property
    def is_backing(self) -> bool:
        """Whether the robot backs off, which it ends before it drives on: where it stood it sees less."""
        start = self.settings.wait
        return start <= self._time < start + self.settings.back_time

    def free(self, along: float) -> None:
        """Notes that a way is free again, at a place on the path, metres."""
        self._time = 0.0
        if along > self._where + _ELSEWHERE:
            self._tried = 0

    def blocked(self, along: float, seconds: float, *, can_back: bool) -> Velocity:
        """Returns the velocity while nothing is free.

        Args:
            along: place on the path, metres.
            seconds: time since it was asked last.
            can_back: whether the floor behind the robot is free.
        """
        if self._time == 0.0:
            self._where = max(self._where, along)
        if self._tried >= self.settings.tries:
            return STOP
        self._time += seconds
        end = 0.0
        for duration, velocity in self._acts:
            end += duration
            if self._time < end and (can_back or velocity.linear >= 0.0):
                return velocity
            self._time = max(self._time, end)  # what it cannot do is left out
        self._time = 0.0
        self._tried += 1
        return STOP
