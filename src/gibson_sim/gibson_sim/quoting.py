"""Quotes in messages what came from outside: always short, always one line, whatever it is."""

from __future__ import annotations

import math
import reprlib

LONGEST = 80
"""Characters of a text, and of what a list or a mapping holds."""
_LONGEST_NUMBER_BITS = 200


class _Brief(reprlib.Repr):
    """A ``repr`` that visits a few values of a few levels, whatever they hold: a list of aliases may stand for more than memory holds."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxlist, self.maxtuple, self.maxdict, self.maxset = 3, 8, 8, 6, 6
        self.maxstring = self.maxother = LONGEST

    def repr_int(self, x: int, level: int) -> str:
        # Python refuses to write out more than 4300 digits.
        if x.bit_length() > _LONGEST_NUMBER_BITS:
            return f"a whole number of {int(x.bit_length() * math.log10(2)) + 1} digits"
        return repr(x)


_BRIEF = _Brief()


def quoted(value: object, longest: int = LONGEST) -> str:
    """Returns a value as Python writes it, in about ``longest`` characters at most."""
    if isinstance(value, str):
        return repr(value) if len(value) <= longest else f"{value[:longest]!r}... ({len(value)} characters)"
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    text = _BRIEF.repr(value)
    return text if len(text) <= longest else f"{text[:longest]}..."


def clipped(text: str, longest: int) -> str:
    """Returns a text on one line, its middle left out where it is too long, control characters as Python writes them."""
    line = _plain(text[: 4 * longest])
    if len(line) <= longest and len(text) <= 4 * longest:
        return line
    return f"{line[: longest // 2]} ... {_plain(text[-longest // 2 :])}"


def _plain(text: str) -> str:
    """Returns a text on one line, without what moves the cursor or changes colours of a terminal."""
    line = " ".join(text.split())
    return line if line.isprintable() else "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
