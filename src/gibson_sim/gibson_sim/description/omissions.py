"""Warnings about elements of a file that could not be used, each with its kind."""

from __future__ import annotations

import re
from collections.abc import Iterable
from enum import Enum, auto

_SOURCE = re.compile(r"\S*\.\S+|model \S.*")
"""What a line may begin with before ``: ``: a file or a model. Other lines stand alone."""


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
    """An element of a model or world that is not simulated; details of meshes are ``OTHER``, for they refuse no spawn."""
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


def grouped(lines: Iterable[str]) -> list[str]:
    """Returns warnings of which those that differ only in the file or model before ``: `` are one line, which counts the others.

    ``a.dae: lines are not drawn`` and the same of two further files become ``a.dae and 2 more: lines are not drawn``, at the first place.
    """
    files: dict[str, list[str]] = {}
    for line in lines:
        file, colon, text = line.partition(": ")
        key = text if colon and _SOURCE.fullmatch(file) else line
        files.setdefault(key, []).append(file if key == text and colon else "")
    found = []
    for text, names in files.items():
        others = len(set(names)) - 1
        first = f"{names[0]}: " if names[0] and others == 0 else f"{names[0]} and {others} more: " if names[0] else ""
        found.append(first + text)
    return found


def kind_of(text: str) -> OmissionKind:
    """Returns the kind of a warning; plain strings are ``OTHER``."""
    return text.kind if isinstance(text, Omission) else OmissionKind.OTHER
