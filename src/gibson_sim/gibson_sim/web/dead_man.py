"""The dead man's rule: the robot drives while a page says so several times a second, and stops once it no longer does. Pure."""

from __future__ import annotations

from gibson_sim.web.requests import Drive

DEADLINE_S = 0.3
"""Seconds of wall time that a command holds; a page repeats its command every 0.1 s while a key is down."""
STOPS = 3
"""Number of zero commands after the last page let go: one may be lost."""
STANDING = Drive(0.0, 0.0, 0.0)


class DeadMan:
    """Who drives a robot, and what is to be published. The page that drove last has the robot until it stands."""

    def __init__(self) -> None:
        self._driver: object | None = None
        self._command = STANDING
        self._until_s = 0.0
        self._stops = 0

    def drive(self, driver: object, command: Drive, now_s: float) -> bool:
        """Takes a command; returns False where another page drives at this moment.

        Args:
            driver: the page.
            command: zero = the page lets go.
            now_s: a clock that never goes back.
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
        """Stops the robot if this page drives: it let go, or its connection is lost."""
        if self._driver is driver:
            self._driver, self._stops = None, STOPS

    @property
    def idle(self) -> bool:
        """Whether nothing is to be published until a page drives."""
        return self._driver is None and not self._stops

    def due(self, now_s: float) -> Drive | None:
        """Returns the command to publish now, at 20 Hz; None = none, so that others may drive."""
        if self._driver is not None and now_s >= self._until_s:
            self._driver, self._stops = None, STOPS
        if self._driver is not None:
            return self._command
        if self._stops:
            self._stops -= 1
            return STANDING
        return None
