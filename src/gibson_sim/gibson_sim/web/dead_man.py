"""Dead man's switch: the robot drives while a page repeats its command, and stops when the repeats end."""

from __future__ import annotations

from gibson_sim.web.requests import Drive

DEADLINE_S = 0.3
"""Validity of a command, seconds of wall time; a page repeats its command every 0.1 s while a key is down."""
STOPS = 3
"""Number of zero commands published after the release: one may be lost."""
STANDING = Drive(0.0, 0.0, 0.0)


class DeadMan:
    """Dead man's switch of one robot: the driving page and the command to publish. A page holds the robot until its command expires."""

    def __init__(self) -> None:
        self._driver: object | None = None
        self._command = STANDING
        self._until_s = 0.0
        self._stops = 0

    def drive(self, driver: object, command: Drive, now_s: float) -> bool:
        """Accepts a command; returns False if another page is driving.

        Args:
            driver: page that sends the command.
            command: velocities; zero = the page releases the robot.
            now_s: time of a monotonic clock, s.
        """
        busy = self._driver is not None and now_s < self._until_s
        if busy and self._driver is not driver:
            return False
        if command == STANDING:
            self.release(driver)
            return True
        self._driver, self._command, self._until_s = driver, command, now_s + DEADLINE_S
        return True

    def release(self, driver: object) -> None:
        """Stops the robot if this page drives it, after a release or a lost connection."""
        if self._driver is driver:
            self._driver, self._stops = None, STOPS

    @property
    def idle(self) -> bool:
        """Whether no command is to be published until a page drives."""
        return self._driver is None and not self._stops

    def due(self, now_s: float) -> Drive | None:
        """Returns the command to publish now; called at 20 Hz; None = no command, so that other nodes may drive."""
        if self._driver is not None and now_s >= self._until_s:
            self._driver, self._stops = None, STOPS
        if self._driver is not None:
            return self._command
        if self._stops:
            self._stops -= 1
            return STANDING
        return None
