"""Warnings about elements of a file that could not be used, each with its kind."""

from __future__ import annotations

from enum import Enum, auto


class OmissionKind(Enum):
    """Reason why an element was left out or replaced."""

    OTHER = auto()
    """Another reason: a colour that is not defined, a motor that is not simulated."""
    INVALID = auto()
    """An invalid value."""
    MISSING_ASSET = auto()
    """A model, mesh or texture that is missing."""
    UNSUPPORTED_ASSET = auto()
    """A mesh or texture that exists but cannot be used."""
    UNSUPPORTED_ELEMENT = auto()
    """An element that is not simulated."""
    UP_UNCLEAR = auto()
    """The up axis is not given and could not be determined."""


class Omission(str):
    """A warning, one line, with its kind."""

    kind: OmissionKind

    def __new__(cls, text: str, kind: OmissionKind = OmissionKind.OTHER) -> Omission:
        """Returns the line ``text`` with a kind."""
        line = super().__new__(cls, text)
        line.kind = kind
        return line


def kind_of(text: str) -> OmissionKind:
    """Returns the kind of a warning; plain strings are ``OTHER``."""
    return text.kind if isinstance(text, Omission) else OmissionKind.OTHER
