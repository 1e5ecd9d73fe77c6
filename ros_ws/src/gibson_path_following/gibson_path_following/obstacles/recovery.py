"""Recovery behaviours of a robot whose plan is blocked: it waits, backs up, spins to both sides, and after some attempts stops."""

from __future__ import annotations

from dataclasses import dataclass

from gibson_path_following.errors import check_ranges
from gibson_path_following.types import STOP, Velocity

_NEW_PLACE = 1.0
"""Distance along the path from which on a blockage is a new one, with new attempts, metres."""


@dataclass(frozen=True, slots=True)
class RecoverySettings:
    """Durations and speeds of the behaviours."""

    wait_time: float = 1.6
    """Duration of the wait, seconds: people walk on."""
    spin_rate: float = 0.6
    """Yaw rate of a spin, rad/s."""
    spin_time: float = 1.0
    """Duration of a spin to one side, and of the spin back, seconds."""
    backup_speed: float = 0.15
    """Speed of the backup, m/s; positive."""
    backup_time: float = 1.6
    """Duration of the backup, seconds: the floor behind the robot was free when it came."""
    max_attempts: int = 2
    """Attempts on one metre of the path, after which the robot stops for good."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("wait_time", 0.0, 3600.0),
            ("spin_rate", 0.0, 10.0),
            ("spin_time", 0.0, 60.0),
            ("backup_speed", 0.0, 5.0),
            ("backup_time", 0.0, 60.0),
            ("max_attempts", 0, 1000),
        )


class Recovery:
    """Runs the recovery behaviours while the plan is blocked."""

    def __init__(self, settings: RecoverySettings | None = None) -> None:
        self.settings = settings = settings or RecoverySettings()
        left, right = Velocity(0.0, settings.spin_rate), Velocity(0.0, -settings.spin_rate)
        self._behaviours: tuple[tuple[float, Velocity], ...] = (
            (settings.wait_time, STOP),
            (settings.backup_time, Velocity(-settings.backup_speed, 0.0)),
            (settings.spin_time, left),
            (2.0 * settings.spin_time, right),
            (settings.spin_time, left),
        )
        """Duration, seconds, and velocity of each behaviour, in order."""
        self._time = 0.0
        """Time since the plan is blocked, seconds."""
        self._attempts = 0
        self._blocked_at = 0.0
        """Farthest station at which the plan was blocked, metres along the path."""

    def reset(self) -> None:
        """Ends all behaviours, and drops the attempts."""
        self._time, self._attempts, self._blocked_at = 0.0, 0, 0.0

    @property
    def is_backing_up(self) -> bool:
        """Whether the robot backs up. It completes that before it drives on: from nearer it sees less."""
        start = self.settings.wait_time
        return start <= self._time < start + self.settings.backup_time

    def on_free(self, station: float) -> None:
        """Ends the behaviours, since the plan is free again; ``station``: of the robot, metres along the path."""
        self._time = 0.0
        if station > self._blocked_at + _NEW_PLACE:
            self._attempts = 0

    def on_blocked(self, station: float, seconds: float, *, can_back_up: bool) -> Velocity:
        """Returns the velocity of the present behaviour.

        Args:
            station: of the robot, metres along the path.
            seconds: time since the previous call, seconds.
            can_back_up: whether the floor behind the robot is free.
        """
        if self._time == 0.0:
            self._blocked_at = max(self._blocked_at, station)
        if self._attempts >= self.settings.max_attempts:
            return STOP
        self._time += seconds
        end = 0.0
        for duration, velocity in self._behaviours:
            end += duration
            if self._time < end and (can_back_up or velocity.linear >= 0.0):
                return velocity
            self._time = max(self._time, end)  # a backup that is not possible is left out
        self._time = 0.0
        self._attempts += 1
        return STOP
