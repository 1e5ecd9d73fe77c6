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
    """Removes the files of dead segments and ports that we may remove; returns their paths. The living are left alone.

    Where ports without a lock are too young to judge, it waits for ``SETTLED_S`` and looks again.
    """
    removed, young = _sweep(folder)
    if young:
        time.sleep(SETTLED_S)
        removed += _sweep(folder)[0]
    return removed


def _sweep(folder: Path) -> tuple[list[Path], bool]:
    """Removes what is dead now; returns what was removed, and whether there are ports too young to judge."""
    removed, young = [], False
    for base in sorted({p.with_name(p.name.removesuffix("_el")) for p in folder.glob("fastrtps_*")}):
        lock = base.with_name(f"{base.name}_el")
        if lock.exists():
            dead = _is_free(lock)
        else:
            is_port = "_port" in base.name
            dead = is_port and _age_s(base) >= SETTLED_S
            young = young or (is_port and not dead)
        for path in (base, base.with_name(f"sem.{base.name}_mutex"), lock) if dead else ():
            try:
                path.unlink()
                removed.append(path)
            except (FileNotFoundError, PermissionError):
                continue
    return removed, young


def _is_free(lock: Path) -> bool:
    """Returns whether nobody holds the lock file; someone else's file that we may not open counts as held."""
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


def _age_s(path: Path) -> float:
    try:
        return time.time() - path.stat().st_ctime
    except FileNotFoundError:
        return 0.0
