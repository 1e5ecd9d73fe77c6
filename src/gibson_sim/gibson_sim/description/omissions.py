"""What a file names and could not be used, one line each, with its kind for those who must tell them apart."""

from __future__ import annotations

from enum import Enum, auto


class OmissionKind(Enum):
    """Why something was left out or replaced."""

    OTHER = auto()
    """A small thing: a colour that is not defined, a motor that is not simulated."""
    INVALID = auto()
    """A value that cannot be meant."""
    MISSING_ASSET = auto()
    """A model, mesh or texture that is not there."""
    UNSUPPORTED_ASSET = auto()
    """A mesh or texture that is there and cannot be used."""
    UNSUPPORTED_ELEMENT = auto()
    """A kind of thing that is not simulated."""
    UP_UNCLEAR = auto()
    """Which way is up could not be told, and nobody has said it yet."""


class Omission(str):
    """One line for the user; goes wherever a line of text goes."""

    kind: OmissionKind

    def __new__(cls, text: str, kind: OmissionKind = OmissionKind.OTHER) -> Omission:
        """Returns the line ``text`` of this kind."""
        line = super().__new__(cls, text)
        line.kind = kind
        return line


def kind_of(text: str) -> OmissionKind:
    """Returns the kind of a line; plain text is ``OTHER``."""
    return text.kind if isinstance(text, Omission) else OmissionKind.OTHER
