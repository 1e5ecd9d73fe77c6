"""A file that outlives a full disk for as long as it takes to finish it."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from gibson_sim.writing import FULL


class Sink:
    """An unbuffered file that, when the disk is full, gives up the emergency file and goes on."""

    def __init__(self, path: Path, emergency: Path) -> None:
        """Makes the file.

        Raises:
            OSError: it is there already, or cannot be made.
        """
        self._emergency = emergency
        self._file: BinaryIO | None = path.open("xb", buffering=0)
        self.position = 0
        """Bytes written."""
        self.full = False
        """True once the disk was full: what is written since lives on the emergency space."""

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Writes all of ``data``.

        Raises:
            OSError: the disk is full, and the emergency space is gone too; or it fails in another way.
        """
        view = memoryview(data)
        while view:
            try:
                written = self._open_file().write(view)
            except OSError as error:
                if error.errno not in FULL or self.full:
                    raise
                self.full = True
                self._emergency.unlink(missing_ok=True)
                continue
            self.position += written
            view = view[written:]

    def close(self) -> None:
        """Closes the file; a second time does nothing."""
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _open_file(self) -> BinaryIO:
        assert self._file is not None, "the file is closed"
        return self._file
