"""Imports PyBullet without output; no other module imports it.

PyBullet writes its build date, and every warning of its file readers, directly to the file descriptors.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import sys
import tempfile
from collections.abc import Iterator

__all__ = ["pybullet", "quiet"]

logger = logging.getLogger(__name__)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Redirects output of C code on stdout and stderr to the log, at DEBUG."""
    libc = ctypes.CDLL(None)
    with contextlib.ExitStack() as stack:
        sink = stack.enter_context(tempfile.TemporaryFile())
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError, AttributeError):  # a closed or replaced stream has nothing to flush
                stream.flush()
        libc.fflush(None)
        try:
            saved = [(fd, os.dup(fd)) for fd in (1, 2)]
        except OSError:  # a process without stdout or stderr (a daemon) has nothing to redirect
            saved = []
        for fd, _ in saved:
            os.dup2(sink.fileno(), fd)
        try:
            yield
        finally:
            libc.fflush(None)
            for fd, copy in saved:
                os.dup2(copy, fd)
                os.close(copy)
            sink.seek(0)
            for line in sink.read().decode(errors="replace").splitlines():
                if line.strip():
                    logger.debug("bullet: %s", line.strip())


with quiet():
    import pybullet
