"""Removes shared-memory files that killed nodes left behind.

For each segment or port ``x``, Fast DDS creates in ``/dev/shm`` the file ``fastrtps_x``, a lock file ``fastrtps_x_el`` on which its owner
holds an flock while it runs, and for ports ``sem.fastrtps_x_mutex``. A process that ends after its peer was killed leaves a port
without a lock file, which is also dead unless it is just being created.

A starting participant fails if we hold its lock even for an instant, and a participant without its lock file counts as dead for all others.
Therefore we read the kernel's list of locks first, try a lock only if no process holds it and it is not new, hold it while removing
the files that it guards, and keep the lock file of a port, which is reused.

A port without a reader is kept while a running process has it open for writing. The last process to close a port removes it *by name*: had we
removed it earlier, this would be the new port of a process with the same number, which would receive no more messages.
"""

from __future__ import annotations

import fcntl
import os
import time
from pathlib import Path

FOLDER = Path("/dev/shm")
SETTLED_S = 1.0
"""Age below which a port without a lock file may still get one, seconds."""


def remove_dead_segments(folder: Path = FOLDER, *, wait: bool = True) -> list[Path]:
    """Removes the files of dead segments and ports, as far as permissions allow; returns their paths.

    If ports without a lock are too young to judge and ``wait`` is set, it waits for ``SETTLED_S`` and tries again.
    """
    removed, young = _sweep(folder)
    if young and wait:
        time.sleep(SETTLED_S)
        removed += _sweep(folder)[0]
    return removed


def _sweep(folder: Path) -> tuple[list[Path], bool]:
    """Removes dead files once; returns them, and whether a file looks dead but is too young to judge."""
    removed, young, held, mapped = [], False, _locked_files(), _mapped_files()
    for base in sorted({p.with_name(p.name.removesuffix("_el")) for p in folder.glob("fastrtps_*")}):
        lock, mutex, is_port = base.with_name(f"{base.name}_el"), base.with_name(f"sem.{base.name}_mutex"), "_port" in base.name
        if not lock.exists():
            guarded = [base, mutex] if is_port else []
        elif _file_of(lock) in held:
            continue
        else:
            guarded = [base, mutex] if is_port else [base, lock]
        if not any(path.exists() for path in guarded) or (is_port and _file_of(base) in mapped):
            continue
        if max(_changed_s(base), _changed_s(lock)) > time.time() - SETTLED_S:
            young = True
        else:
            removed += _remove(guarded, lock)
    return removed, young


def _remove(guarded: list[Path], lock: Path) -> list[Path]:
    """Removes files while holding the lock that guards them, if any; returns the removed files, none if the lock is held."""
    try:
        descriptor = os.open(lock, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
    except FileNotFoundError:
        return [path for path in guarded if _unlink(path)]
    except OSError:  # another user's
        return []
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return [path for path in guarded if _unlink(path)]
    except OSError:
        return []
    finally:
        os.close(descriptor)


def _unlink(path: Path) -> bool:
    try:
        path.unlink()
    except OSError:  # removed meanwhile, another user's, or not a file
        return False
    return True


def _locked_files() -> frozenset[tuple[int, int]]:
    """Returns (device, inode) of the files locked by visible processes."""
    try:
        lines = Path("/proc/locks").read_text().splitlines()
    except OSError:
        return frozenset()
    identifiers = [field.split(":") for line in lines for field in line.split() if field.count(":") == 2]
    return frozenset((os.makedev(int(major, 16), int(minor, 16)), int(inode)) for major, minor, inode in identifiers)


def _mapped_files() -> frozenset[tuple[int, int]]:
    """Returns (device, inode) of the shared-memory files of Fast DDS mapped by processes whose maps are readable."""
    mapped = set()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        try:
            lines = maps.read_text(errors="replace").splitlines()
        except OSError:  # ended, or another user's, whose files we may not remove either
            continue
        for fields in (line.split() for line in lines if "/fastrtps_" in line):
            major, minor = fields[3].split(":")
            mapped.add((os.makedev(int(major, 16), int(minor, 16)), int(fields[4])))
    return frozenset(mapped)


def _file_of(path: Path) -> tuple[int, int]:
    try:
        status = path.lstat()
    except OSError:
        return -1, -1
    return status.st_dev, status.st_ino


def _changed_s(path: Path) -> float:
    try:
        return path.lstat().st_ctime
    except OSError:
        return 0.0
