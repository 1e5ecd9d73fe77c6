"""Errors, each with a message of one line: what is wrong, the value, what is allowed, and the remedy."""

from __future__ import annotations

_LONGEST = 80
"""Largest length of a quoted value, characters."""


class PathFollowingError(Exception):
    """Root of all errors of this package."""


class SettingError(PathFollowingError):
    """A setting has a value that is not allowed."""


class PathFolderError(PathFollowingError):
    """A folder holds no readable path, or cannot be written."""


class ViewError(PathFollowingError):
    """Images do not match the path: their number, size or camera."""


class ModelError(PathFollowingError):
    """A network cannot be used: the file, its inputs or its outputs."""


def quoted(value: object) -> str:
    """Returns the ``repr`` of an untrusted value in one line of at most about 80 characters."""
    if isinstance(value, str):
        value = value[: 2 * _LONGEST]
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def check_ranges(settings: object, *ranges: tuple[str, float, float]) -> None:
    """Raises SettingError for the first field that is outside its range.

    Args:
        settings: has the fields.
        ranges: name, least and largest value of each.
    """
    for name, least, most in ranges:
        value = getattr(settings, name)
        if not least <= value <= most:
            raise SettingError(f"{name} is {value:g}, must be {least:g} to {most:g}")
