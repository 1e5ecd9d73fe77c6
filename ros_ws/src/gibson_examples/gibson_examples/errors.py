"""What may go wrong, each in one line that says what, which value, what is allowed and what to do."""

from __future__ import annotations


class NavigationError(Exception):
    """Root of all errors of this package."""


class SettingError(NavigationError):
    """A parameter has a value that is not allowed."""


class MapError(NavigationError):
    """A map cannot be used."""


class PlanError(NavigationError):
    """There is no way to the goal."""


class TransformError(NavigationError):
    """A transform is not known, or no longer."""


class TransformNotYetError(TransformError):
    """A transform is not known yet: the next message may bring it."""
