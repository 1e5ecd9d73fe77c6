"""Prevents two processes from writing to the same output folder at the same time.

The lock is a kernel lock on the folder itself (flock(2)): it leaves no file and is released when the process ends for any reason.
"""

from __future__ import annotations

import errno
import fcntl
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gibson_sim.errors import GibsonSimError
from gibson_sim.writing import cannot_write

_log = logging.getLogger(__name__)


@contextmanager
def locked_folder(folder: Path, in_use: GibsonSimError) -> Iterator[None]:
    """Creates a folder if it is missing, and locks it against other callers within a block.

    Args:
        folder: folder to lock; not locked if the file system does not support locks.
        in_use: raised if another process holds the lock.

    Raises:
        GibsonSimError: ``in_use``.
        WriteError: the folder cannot be created.
    """
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except FileExistsError as error:
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR)) from error
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise cannot_write(folder, error) from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise in_use from error
        except OSError as error:
            _log.debug("no lock of %s: %s", folder, error)
        yield
    finally:
        os.close(descriptor)
