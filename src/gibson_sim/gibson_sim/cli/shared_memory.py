"""Shared-memory files that a killed node left behind.

Fast DDS keeps each segment ``/dev/shm/fastrtps_<id>`` with a lock file ``fastrtps_<id>_el`` that its owner holds by flock for as
long as it lives: a lock that we can take belongs to a dead segment.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

FOLDER = Path("/dev/shm")


def remove_dead_segments(folder: Path = FOLDER) -> list[Path]:
    """Removes the files of dead segments that we may remove; returns their paths. Living segments are left alone."""
    removed = []
    for lock in sorted(folder.glob("fastrtps_*_el")):
        if _is_dead(lock):
            for path in (lock.with_name(lock.name.removesuffix("_el")), lock):
                try:
                    path.unlink()
                    removed.append(path)
                except (FileNotFoundError, PermissionError):
                    continue
    return removed


def _is_dead(lock: Path) -> bool:
    """Returns whether nobody holds the lock file; someone else's file that we may not open counts as living."""
    try:
        descriptor = os.open(lock, os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    except OSError:
        return False
    finally:
        os.close(descriptor)
