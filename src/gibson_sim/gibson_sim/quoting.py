"""Quotes untrusted values in messages, in one line of limited length, and writes durations as text."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Sequence

LONGEST = 80
"""Default maximum length of a quoted value, characters."""
_LONGEST_NUMBER_BITS = 200
"""Maximum size of an integer that is written out, bits."""


class _Brief(reprlib.Repr):
    """A ``repr`` of limited size and depth: a list of YAML aliases can represent more values than fit into memory."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxlist, self.maxtuple, self.maxdict, self.maxset = 3, 8, 8, 6, 6
        self.maxstring = self.maxother = LONGEST

    def repr_int(self, x: int, level: int) -> str:
        # Python raises for more than 4300 digits.
        if x.bit_length() > _LONGEST_NUMBER_BITS:
            return f"a whole number of {int(x.bit_length() * math.log10(2)) + 1} digits"
        return repr(x)


_BRIEF = _Brief()


def quoted(value: object, longest: int = LONGEST) -> str:
    """Returns the ``repr`` of a value in at most about ``longest`` characters."""
    if isinstance(value, str):
        return repr(value) if len(value) <= longest else f"{value[:longest]!r}... ({len(value)} characters)"
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    text = _BRIEF.repr(value)
    return text if len(text) <= longest else f"{text[:longest]}..."


def enumerated(names: Sequence[str], most: int) -> str:
    """Returns the first ``most`` names of a list for a message, and how many more there are."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def clipped(text: str, longest: int) -> str:
    """Returns a text in one line of at most about ``longest`` characters, shortened in the middle, with control characters escaped."""
    line = _printable(text[: 4 * longest])
    if len(line) <= longest and len(text) <= 4 * longest:
        return line
    return f"{line[: longest // 2]} ... {_printable(text[-longest // 2 :])}"


def _printable(text: str) -> str:
    """Returns a text in one line, with control characters, which could move a terminal's cursor or change its colours, escaped."""
    line = " ".join(text.split())
    return line if line.isprintable() else "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


def duration_text(seconds: float) -> str:
    """Returns a duration in a unit that suits it: ``42 s``, ``5 min`` (from 90 s on) or ``2.5 h`` (from 90 min on)."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
