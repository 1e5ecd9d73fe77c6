"""Lines of text about parts of a file that could not be used, each with its kind."""

from __future__ import annotations

from enum import Enum, auto


class OmissionKind(Enum):
    """Why something was left out or replaced."""

    OTHER = auto()
    """A detail: a colour that is not defined, a motor that is not simulated."""
    INVALID = auto()
    """An impossible value."""
    MISSING_ASSET = auto()
    """A model, mesh or texture that is missing."""
    UNSUPPORTED_ASSET = auto()
    """A mesh or texture that exists and cannot be used."""
    UNSUPPORTED_ELEMENT = auto()
    """An element that is not simulated."""
    UP_UNCLEAR = auto()
    """The up axis could not be determined, and is not given."""


class Omission(str):
    """One line for the user, with its kind."""

    kind: OmissionKind

    def __new__(cls, text: str, kind: OmissionKind = OmissionKind.OTHER) -> Omission:
        """Returns the line ``text`` of this kind."""
        line = super().__new__(cls, text)
        line.kind = kind
        return line


def kind_of(text: str) -> OmissionKind:
    """Returns the kind of a line; plain text is ``OTHER``."""
    return text.kind if isinstance(text, Omission) else OmissionKind.OTHER
