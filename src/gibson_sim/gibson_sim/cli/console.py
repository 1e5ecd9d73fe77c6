"""The launcher's output on stderr: lines of several processes, and below them one line that is rewritten on a terminal."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from typing import TextIO

_ERASE = "\r\x1b[K"
"""Moves to the start of the line and erases it."""
_REPEAT_S = 10.0
"""Wall time within which a warning is not repeated, seconds."""


class Console:
    """Writes whole lines, from any thread, and keeps the status line below them.

    Args:
        out: receives the text; None = stderr, looked up at each call.
    """

    def __init__(self, out: TextIO | None = None) -> None:
        self._out = out
        self._lock = threading.Lock()
        self._status = ""
        self._written: dict[str, float] = {}
        """Texts given to ``was_written``, and when."""

    @property
    def is_terminal(self) -> bool:
        """Whether the status line can be rewritten."""
        return self._stream.isatty()

    @property
    def _stream(self) -> TextIO:
        return self._out or sys.stderr

    def write(self, line: str) -> None:
        """Writes a line, above the status line."""
        with self._lock:
            text = f"{line}\n"
            if self._status:
                text = f"{_ERASE}{text}{self._status}"
            self._stream.write(text)
            self._stream.flush()

    def was_written(self, text: str) -> bool:
        """Returns whether this was called with the same text within the last ten seconds: of equal warnings one is enough."""
        now = time.monotonic()
        with self._lock:
            self._written = {known: at for known, at in self._written.items() if now - at < _REPEAT_S}
            repeated = text in self._written
            self._written.setdefault(text, now)
        return repeated

    def status(self, line: str) -> None:
        """Replaces the status line on a terminal, cut to its width; does nothing elsewhere. Empty = no status line."""
        if not self.is_terminal:
            return
        width = shutil.get_terminal_size((100, 24)).columns - 1
        with self._lock:
            line = line[:width]
            if line != self._status:
                self._status = line
                self._stream.write(f"{_ERASE}{line}")
                self._stream.flush()


CONSOLE = Console()
"""That of this process."""


def say(text: str) -> None:
    """Prints a line on stderr, above the status line."""
    CONSOLE.write(text)
