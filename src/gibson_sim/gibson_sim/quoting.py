"""Quotes untrusted values in messages, always briefly and in one line."""

from __future__ import annotations

import math
import reprlib

LONGEST = 80
"""Largest length of a quoted text, or of the quoted items of a list or mapping, characters."""
_LONGEST_NUMBER_BITS = 200
"""Largest whole number that is written out, bits."""


class _Brief(reprlib.Repr):
    """A ``repr`` limited to a few values on a few levels: a list of YAML aliases can represent more values than fit into memory."""

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
    """Returns the ``repr`` of a value in at most about ``longest`` characters."""
    if isinstance(value, str):
        return repr(value) if len(value) <= longest else f"{value[:longest]!r}... ({len(value)} characters)"
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    text = _BRIEF.repr(value)
    return text if len(text) <= longest else f"{text[:longest]}..."


def clipped(text: str, longest: int) -> str:
    """Returns a text in one line of about ``longest`` characters, without its middle if it is longer, with control characters escaped."""
    line = _plain(text[: 4 * longest])
    if len(line) <= longest and len(text) <= 4 * longest:
        return line
    return f"{line[: longest // 2]} ... {_plain(text[-longest // 2 :])}"


def _plain(text: str) -> str:
    """Returns a text in one line, with characters escaped that would move a terminal's cursor or change its colours."""
    line = " ".join(text.split())
    return line if line.isprintable() else "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
