"""Locks the folder of a path while it is recorded, so that no second recorder writes to it.

The lock is a kernel lock (flock(2)) on a hidden file beside the folder: a folder is new, or replaced as a whole. The kernel releases it when
the process ends for any reason; a file that stays then is no lock.
"""

from __future__ import annotations

import fcntl
import logging
import os
from contextlib import suppress
from pathlib import Path
from types import TracebackType

_log = logging.getLogger(__name__)


class FolderLock:
    """Lock on a file, which it creates, and removes at the end."""

    def __init__(self, file: Path) -> None:
        """Locks the file, or does nothing if the file system does not support locks.

        Raises:
            BlockingIOError: another ``FolderLock`` holds the lock.
            OSError: the file cannot be created.
        """
        self._file = file
        self._descriptor: int | None = None
        while self._descriptor is None:
            descriptor = os.open(file, os.O_RDONLY | os.O_CREAT | os.O_NOFOLLOW, 0o644)
            try:
                _lock(descriptor, file)
                if _is_at(descriptor, file):  # else its holder has removed it after it was opened here
                    self._descriptor = descriptor
            finally:
                if self._descriptor is None:
                    os.close(descriptor)

    def close(self) -> None:
        """Releases the lock; a second call does nothing."""
        if self._descriptor is None:
            return
        if _is_at(self._descriptor, self._file):
            with suppress(OSError):  # a disk that is read-only by now
                self._file.unlink()
        os.close(self._descriptor)
        self._descriptor = None

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def _lock(descriptor: int, file: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError as error:
        _log.debug("no lock of %s: %s", file, error)


def _is_at(descriptor: int, file: Path) -> bool:
    """Returns whether an open file is the one at a path."""
    try:
        return os.path.samestat(os.fstat(descriptor), file.stat(follow_symlinks=False))
    except OSError:
        return False
