"""Errors, each with a message of one line: what is wrong, the value, what is allowed, and the remedy."""

from __future__ import annotations


class NavigationError(Exception):
    """Root of all errors of this package."""


class SettingError(NavigationError):
    """A parameter has a value that is not allowed."""


class MapError(NavigationError):
    """A map cannot be used."""


class PlanError(NavigationError):
    """There is no path to the goal."""


class TransformError(NavigationError):
    """A transform is unknown, or no longer in the buffer."""


class TransformNotYetError(TransformError):
    """A transform is not known yet: the next message may bring it."""
