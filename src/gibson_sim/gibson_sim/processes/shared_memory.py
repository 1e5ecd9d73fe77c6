"""Removes shared-memory files that killed nodes left behind.

For each segment or port ``x``, Fast DDS creates in ``/dev/shm`` the file ``fastrtps_x``, a lock file ``fastrtps_x_el`` on which its owner
holds an flock while it lives, and for ports ``sem.fastrtps_x_mutex``. A process that ends after its peer was killed leaves a port
without a lock file: dead as well, unless it is just being created.

A starting participant fails if we hold its lock even for an instant, and one whose lock file was removed counts as dead for all others.
Therefore we read the kernel's list of locks first, try a lock only if no process holds it and it is not new, hold it while we remove
what it guards, and keep the lock file of a port, which is reused.

A port without a reader stays while a living process has it open for writing. The last process to close a port removes it *by name*: if we
had removed it before, that would be the new port of a process that got the same number meanwhile, which would receive nothing from then on.
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

    If ports without a lock are too young to judge, it waits for ``SETTLED_S`` and tries again, unless it shall not ``wait``.
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
    """Removes files while holding the lock that guards them, if there is one; returns those removed, none if the lock is held."""
    try:
        descriptor = os.open(lock, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
    except FileNotFoundError:
        return [path for path in guarded if _unlink(path)]
    except OSError:  # someone else's
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
    except OSError:  # gone, someone else's, or no file
        return False
    return True


def _locked_files() -> frozenset[tuple[int, int]]:
    """Returns (device, inode) of the files that visible processes hold a lock on."""
    try:
        lines = Path("/proc/locks").read_text().splitlines()
    except OSError:
        return frozenset()
    places = [field.split(":") for line in lines for field in line.split() if field.count(":") == 2]
    return frozenset((os.makedev(int(major, 16), int(minor, 16)), int(inode)) for major, minor, inode in places)


def _mapped_files() -> frozenset[tuple[int, int]]:
    """Returns (device, inode) of the shared-memory files of Fast DDS mapped by processes whose maps are readable."""
    found = set()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        try:
            lines = maps.read_text(errors="replace").splitlines()
        except OSError:  # gone, or someone else's, whose files we may not remove either
            continue
        for fields in (line.split() for line in lines if "/fastrtps_" in line):
            major, minor = fields[3].split(":")
            found.add((os.makedev(int(major, 16), int(minor, 16)), int(fields[4])))
    return frozenset(found)


def _file_of(path: Path) -> tuple[int, int]:
    try:
        found = path.lstat()
    except OSError:
        return -1, -1
    return found.st_dev, found.st_ino


def _changed_s(path: Path) -> float:
    try:
        return path.lstat().st_ctime
    except OSError:
        return 0.0
