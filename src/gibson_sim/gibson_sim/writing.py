"""Writes files atomically. All modules use it to write files for users.

The content is written to a draft beside the file, which is renamed once it is complete: a reader always sees either the old or the new file,
even if the disk fills up. Only bags are written in place, because an incomplete bag is useful.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from gibson_sim.errors import WriteError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Error numbers of a full disk, quota or file size limit."""
_DISK_ERRORS = (*FULL, errno.EROFS, errno.EIO)
_UNITS = ("bytes", "KB", "MB", "GB", "TB")


def write_file(path: str | Path, content: bytes | str, *, durable: bool = True) -> None:
    """Writes a file; creates its folder if necessary.

    Args:
        path: the file, which is replaced; a device or a pipe is written to.
        content: bytes, or text, which is written as UTF-8.
        durable: whether to sync the file to the disk, which takes time for thousands of files.

    Raises:
        WriteError: the file cannot be written; a previous file is unchanged.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    with replacing(path, durable=durable, needs=len(data)) as draft, draft.open("wb", buffering=0) as file:
        _write_all(file.fileno(), data)


def check_writable(path: str | Path) -> None:
    """Checks that a file can be written, before its content is made; creates its folder if necessary.

    Raises:
        WriteError: the file cannot be written.
    """

    class Cancelled(Exception):
        """Ends the block, so that the draft is deleted."""

    with suppress(Cancelled), replacing(path, durable=False):
        raise Cancelled


@contextmanager
def replacing(path: str | Path, *, durable: bool = True, needs: int = 0) -> Iterator[Path]:
    """Yields the path of a draft with the file's suffix, which replaces the file if the block ends without an exception.

    Args:
        path: the file; its folder is created if necessary. A device or a pipe is its own draft.
        durable: whether to sync the file to the disk.
        needs: number of bytes to be written, for the error message; 0 = unknown.

    Raises:
        WriteError: the file cannot be written, or the block raised an OSError; the draft is deleted.
    """
    target = Path(path)
    draft: Path | None = None
    try:
        if _is_special(target):
            yield target
            return
        target = Path(os.path.realpath(target))  # do not replace a symbolic link
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except FileExistsError as error:
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR)) from error
        mode = _mode_of(target)
        draft = target.with_name(f".{uuid4().hex[:12]}.part{target.suffix}")
        draft.touch(exist_ok=False)
        yield draft
        if mode is not None:
            draft.chmod(mode)
        if durable:
            _sync(draft)
        draft.replace(target)
        draft = None
    except (OSError, ValueError) as error:
        if isinstance(error, ValueError) and "\0" not in str(path):
            raise
        raise cannot_write(path, error, max(needs, _size(draft)), _size(draft)) from error
    finally:
        if draft is not None:
            draft.unlink(missing_ok=True)


def cannot_write(path: str | Path | None, error: OSError | ValueError, needs: int = 0, spare: int = 0) -> WriteError:
    """Returns the error for a file that cannot be written; on a full disk, with the needed and the free space.

    Args:
        path: the file; None = unknown, such as standard output.
        error: the error of the operating system.
        needs: minimum size of the file, bytes; 0 = unknown.
        spare: size of the draft, which will be deleted, bytes.
    """
    what = f"cannot write {'the output' if path is None else path}"
    reason = (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
    if not (isinstance(error, OSError) and error.errno in FULL):
        return WriteError(f"{what}: {reason}").with_public("a file cannot be written")
    known = [f"needs {size_text(needs)} or more"] if needs else []
    free = None if path is None or error.errno == errno.EFBIG else _free(Path(path))
    if free is not None:
        known.append(f"free {size_text(free + spare)}")
    numbers = f" ({', '.join(known)})" if known else ""
    return WriteError(f"{what}: {reason}{numbers}; free disk space, or choose another folder").with_public("the disk is full")


def is_disk_error(error: OSError) -> bool:
    """Returns whether an error is caused by a full, read-only or faulty disk."""
    return error.errno in _DISK_ERRORS


def size_text(size: int) -> str:
    """Returns a size in bytes as text with a suitable unit, such as 12.3 MB."""
    value, unit = float(size), 0
    while value >= 1000.0 and unit < len(_UNITS) - 1:
        value, unit = value / 1000.0, unit + 1
    return f"{value:.1f} {_UNITS[unit]}" if unit else f"{size} bytes"


def _write_all(descriptor: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]


def _is_special(path: Path) -> bool:
    """Returns whether a path is neither a regular file nor a folder, such as /dev/stdout."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _mode_of(path: Path) -> int | None:
    """Returns the mode bits of the file to replace, None if it does not exist.

    Raises:
        OSError: the file is not writable, or is a folder.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return None
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    return stat.S_IMODE(mode)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _size(path: Path | None) -> int:
    try:
        return path.stat().st_size if path is not None else 0
    except OSError:
        return 0


def _free(path: Path) -> int | None:
    """Returns the free space of the disk of a path, bytes, None if unknown."""
    for folder in path.absolute().parents:
        try:
            return shutil.disk_usage(folder).free
        except OSError:
            continue
    return None
