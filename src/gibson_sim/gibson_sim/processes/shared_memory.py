"""Removes shared-memory files that killed nodes left behind.

For each segment or port ``x``, Fast DDS creates in ``/dev/shm`` the file ``fastrtps_x``, a lock file ``fastrtps_x_el`` on which its owner
holds an flock while it runs, and for ports ``sem.fastrtps_x_mutex``. A process that ends after its peer was killed leaves a port
without a lock file, which is also dead unless it is just being created.

A starting participant fails if we hold its lock even for an instant, and a participant without its lock file counts as dead for all others.
Therefore we read the kernel's list of locks first, try a lock only if no process holds it and it is not new, hold it while removing
the files that it guards, and keep the lock file of a port, which is reused.

A port of a dead reader may be open for writing in running processes, which would write into it for ever, and the last of which would remove
it *by name*: this would then be the new port of a process with the same number. Before it is removed, such a port is therefore marked as
unusable in its segment, as Fast DDS itself does after ``healthy_check_timeout_ms`` without a sign of its reader: the others then open the new
port at their next message, and remove nothing. A port in which the mark is not found is kept, and is replaced after this time.

Several processes that open ports while another one ends can still remove a port that has just been made: its reader would receive nothing any
more, and would not know. ``reopen_replaced_ports`` finds such ports of its own process and marks them: their reader then opens them anew.
"""

from __future__ import annotations

import contextlib
import fcntl
import mmap
import os
import struct
import time
from pathlib import Path

FOLDER = Path("/dev/shm")
SETTLED_S = 1.0
"""Age below which a port without a lock file may still get one, seconds."""
_NODE = struct.Struct("<7I")
"""Consecutive fields of the node of a port: number of the port, number of listeners, timeout of the health check and period of its signs (a
third of it), ms, capacity, number of waiting listeners, flags."""
_IS_OK, _ALL_FLAGS = 1, 7
"""Flags of a port: usable; all that are known."""
_SEARCHED_BYTES = 1 << 16
"""Size of the beginning of a port's segment in which its node is searched, bytes."""


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
        is_open = is_port and _file_of(base) in mapped
        if not any(path.exists() for path in guarded) or (is_open and not lock.exists()):
            continue
        if max(_changed_s(base), _changed_s(lock)) > time.time() - SETTLED_S:
            young = True
        else:
            removed += _remove(guarded, lock, base if is_open else None)
    return removed, young


def _remove(guarded: list[Path], lock: Path, open_port: Path | None) -> list[Path]:
    """Removes files while holding the lock that guards them, if any; returns the removed files, none if the lock is held.

    Args:
        guarded: files to remove.
        lock: file of the lock.
        open_port: port that others have open, which must be marked as unusable first; None = there is none.
    """
    try:
        descriptor = os.open(lock, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
    except FileNotFoundError:
        return [path for path in guarded if _unlink(path)]
    except OSError:  # another user's
        return []
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if open_port is not None and not mark_unusable(open_port):
            return []
        return [path for path in guarded if _unlink(path)]
    except OSError:
        return []
    finally:
        os.close(descriptor)


def mark_unusable(port: Path) -> bool:
    """Marks a port of a dead reader as unusable for all processes that have it open; returns whether its mark was found.

    The place of the mark depends on the version of Fast DDS: it is found by the values beside it, and is left alone if it is not unique.
    """
    number = port.name.rpartition("_port")[2]
    if not number.isdigit():
        return False
    try:
        with port.open("r+b") as file, mmap.mmap(file.fileno(), 0) as segment:
            at = _flags_place(segment[:_SEARCHED_BYTES], int(number))
            if at is None:
                return False
            (flags,) = struct.unpack_from("<I", segment, at)
            struct.pack_into("<I", segment, at, flags & ~_IS_OK)
            return True
    except (OSError, ValueError):  # another user's, or empty
        return False


def reopen_replaced_ports() -> list[str]:
    """Lets Fast DDS open anew the ports of this process whose files another process has removed or replaced; returns their names.

    Readers of such a port receive nothing. They look for the mark whenever they wait, at least every third of ``healthy_check_timeout_ms``.
    """
    maps = Path("/proc/self/maps").read_text(errors="replace").splitlines()
    reopened, held = [], set()
    for descriptor in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):  # closed meanwhile
            held.add(os.readlink(f"/proc/self/fd/{descriptor}"))
    for fields in (line.split() for line in maps if "/fastrtps_port" in line and line.endswith("(deleted)")):
        path, number = fields[5], fields[5].rpartition("_port")[2]
        if f"{path}_el" in held and number.isdigit() and _mark_in_memory(int(fields[0].partition("-")[0], 16), int(number)):
            reopened.append(Path(path).name)
    return reopened


def _mark_in_memory(address: int, number: int) -> bool:
    """Marks a port that is mapped at an address of this process as unusable; returns False if it is marked, or is not found there."""
    try:
        # Unlike a pointer, this file gives an error if Fast DDS has closed the port meanwhile.
        with open("/proc/self/mem", "r+b", buffering=0) as memory:
            segment = os.pread(memory.fileno(), _SEARCHED_BYTES, address)
            at = _flags_place(segment, number)
            if at is None or not (flags := struct.unpack_from("<I", segment, at)[0]) & _IS_OK:
                return False
            os.pwrite(memory.fileno(), struct.pack("<I", flags & ~_IS_OK), address + at)
            return True
    except OSError:
        return False


def _flags_place(segment: bytes, number: int) -> int | None:
    """Returns the offset of the flags in a port's segment, bytes; None if its node is not found, or not unique."""
    places = [at for at in range(0, len(segment) - _NODE.size + 1, 4) if _is_node(_NODE.unpack_from(segment, at), number)]
    return places[0] + _NODE.size - 4 if len(places) == 1 else None


def _is_node(values: tuple[int, ...], number: int) -> bool:
    port, listeners, timeout_ms, period_ms, capacity, waiting, flags = values
    return (
        port == number
        and period_ms == timeout_ms // 3
        and timeout_ms > 0
        and capacity > 0
        and max(listeners, waiting) <= _SEARCHED_BYTES
        and flags <= _ALL_FLAGS
    )


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
