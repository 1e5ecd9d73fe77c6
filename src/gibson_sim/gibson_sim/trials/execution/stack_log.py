"""Log file of limited size for the output of a stack."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import BinaryIO

HALF = 2_000_000
"""Size of the kept beginning and of the kept end of a long output, bytes."""


class StackLog:
    """Writes output to a file as it arrives; of a long output, only the beginning and the end are kept."""

    def __init__(self, path: Path, half: int = HALF) -> None:
        """Creates the file; ``half``: size of the kept beginning and of the kept end, bytes."""
        self._file: BinaryIO | None = path.open("wb", buffering=0)
        self._room, self._half = half, half
        self._tail: deque[bytes] = deque()
        self._tail_bytes = self._dropped = 0
        self._line = b""

    def write(self, data: bytes) -> None:
        """Appends output."""
        if self._file is None or not data:
            return
        self._line = (self._line + data)[-4096:]
        head, rest = data[: self._room], data[self._room :]
        if head:
            self._file.write(head)
            self._room -= len(head)
        if rest:
            self._tail.append(rest)
            self._tail_bytes += len(rest)
            while self._tail_bytes - len(self._tail[0]) >= self._half:
                self._dropped += len(self._tail[0])
                self._tail_bytes -= len(self._tail.popleft())

    @property
    def last_line(self) -> str:
        """The last non-empty line."""
        lines = [line.strip() for line in self._line.decode(errors="replace").splitlines() if line.strip()]
        return lines[-1] if lines else ""

    def close(self) -> None:
        """Writes the kept end and closes the file."""
        if self._file is None:
            return
        file, self._file = self._file, None
        with file:
            if self._dropped:
                file.write(f"\n[... {self._dropped} bytes left out ...]\n".encode())
            for part in self._tail:
                file.write(part)
