"""Output of the launcher on stderr: lines of several processes, and below them a status line that is rewritten on a terminal."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from typing import TextIO

_ERASE = "\r\x1b[K"
"""Control sequence that moves to the start of the line and erases it."""
_REPEAT_S = 10.0
"""Time within which a warning is not repeated, seconds of wall time."""


class Console:
    """Writes lines, from any thread, and keeps the status line below them.

    Args:
        out: receives the text; None = stderr, looked up at each call.
    """

    def __init__(self, out: TextIO | None = None) -> None:
        self._out = out
        self._lock = threading.Lock()
        self._status = ""
        self._written: dict[str, float] = {}
        """Text given to ``was_written`` -> time of the call."""

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
        """Returns whether it was called with the same text within the last ten seconds, to suppress repeated warnings."""
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
"""Console of this process."""


def say(text: str) -> None:
    """Prints a line on stderr, above the status line."""
    CONSOLE.write(text)
