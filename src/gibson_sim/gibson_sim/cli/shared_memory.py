"""Shared-memory files that a killed node left behind.

Fast DDS makes, for each segment or port ``x`` in ``/dev/shm``, the files ``fastrtps_x``, a lock file ``fastrtps_x_el`` that its owner
holds by flock for as long as it lives, and for ports ``sem.fastrtps_x_mutex``. A lock that we can take belongs to the dead. A process
that ends after its peer was killed leaves a port without its lock file: dead as well, unless it is being made at this very moment.
"""

from __future__ import annotations

import fcntl
import os
import time
from pathlib import Path

FOLDER = Path("/dev/shm")
SETTLED_S = 1.0
"""A port without a lock file that is younger than this may still get one."""


def remove_dead_segments(folder: Path = FOLDER) -> list[Path]:
    """Removes the files of dead segments and ports that we may remove; returns their paths. The living are left alone."""
    removed = []
    for base in sorted({p.with_name(p.name.removesuffix("_el")) for p in folder.glob("fastrtps_*")}):
        lock = base.with_name(f"{base.name}_el")
        if _is_dead(base, lock):
            for path in (base, base.with_name(f"sem.{base.name}_mutex"), lock):
                try:
                    path.unlink()
                    removed.append(path)
                except (FileNotFoundError, PermissionError):
                    continue
    return removed


def _is_dead(base: Path, lock: Path) -> bool:
    """Returns whether nobody holds the lock file; someone else's file that we may not open counts as living."""
    try:
        descriptor = os.open(lock, os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        return "_port" in base.name and _age_s(base) > SETTLED_S
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    except OSError:
        return False
    finally:
        os.close(descriptor)


def _age_s(path: Path) -> float:
    try:
        return time.time() - path.stat().st_ctime
    except FileNotFoundError:
        return 0.0
