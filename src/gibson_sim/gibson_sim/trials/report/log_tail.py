"""The end of a stack's output, sanitised for display: a stack may print anything, in any amount."""

from __future__ import annotations

import re
from pathlib import Path

SECONDS = 10.0
"""Time before the last line from which stamped lines are tail, seconds of the clock of the stamps."""
_MAX_BYTES, _MAX_LINES, _MAX_LINE_LENGTH, _MAX_UNSTAMPED_LINES = 64_000, 80, 240, 40
_ESCAPE = re.compile(r"\x1b(?:\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(?:\x07|\x1b\\)?|[@-Z\\-_])")
"""ANSI sequences: colours, cursor moves, titles."""
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ufeff]")
"""Control characters, and characters that change the writing direction."""
_STAMP = re.compile(r"\[(\d{1,12}\.\d{3,9})\]")
"""Stamp of lines by rclcpp and rclpy: [INFO] [1764057600.123456789] [node]: text."""


def log_tail(path: Path) -> str:
    """Returns the sanitised last lines of a file, of the last ``SECONDS`` if they have stamps; empty without a file or lines."""
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - _MAX_BYTES))
            data = file.read(_MAX_BYTES)
    except OSError:
        return ""
    lines = [_clean(line) for line in data.decode("utf-8", errors="replace").split("\n")]
    while lines and not lines[-1].strip():
        lines.pop()
    tail = lines[-_MAX_LINES:]
    stamps = [(i, float(match[1])) for i, line in enumerate(tail) for match in [_STAMP.search(line)] if match]
    if not stamps:
        return "\n".join(tail[-_MAX_UNSTAMPED_LINES:])
    first = next(i for i, stamp in stamps if stamp >= stamps[-1][1] - SECONDS)
    return "\n".join(tail[first:])


def _clean(line: str) -> str:
    # Of a line that a program rewrote, such as a progress bar, only the final state is kept.
    text = CONTROL.sub("�", _ESCAPE.sub("", line.rstrip("\r").rpartition("\r")[2]).replace("\t", "    "))
    return text if len(text) <= _MAX_LINE_LENGTH else f"{text[:_MAX_LINE_LENGTH]} ... ({len(text)} characters)"
