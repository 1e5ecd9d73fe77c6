"""What a URI from outside means on this machine, whether it may be read, and what lies in a folder."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

from gibson_sim.errors import SceneError, SceneNotFoundError
from gibson_sim.formats.file_roots import is_inside
from gibson_sim.formats.uris import environment_folders, installed_paths
from gibson_sim.reading import exists, read_head

MAX_BYTES = 512 * 1024 * 1024
"""Of a mesh."""
NOWHERE = Path("/nonexistent")
"""Folder of what came as a string: nothing lies beside it."""
SCHEMES = ("file", "package", "model")
_MAX_ENTRIES = 20_000
"""Files and folders that one search looks at."""
_MAX_SEARCHED_BYTES = 4 * 2**20
"""Of the descriptions that one search reads."""
_MAX_LEVELS = 12
"""Folders below a folder that is searched."""
_MAX_PATH, _MAX_NAME = 4096, 255
"""Bytes; of Linux."""


def path_of(uri: str) -> Path | None:
    """Returns the path that a URI or a path means, or None if it is a mere name.

    Args:
        uri: ``file:///...``, ``package://<package>/...``, ``model://<model>/...``, or a path that starts with ``/``, ``./``, ``../``
            or ``~``.

    Raises:
        SceneNotFoundError: it can mean nothing on this machine.
    """
    try:
        os.fsencode(uri)
    except UnicodeEncodeError as e:
        raise SceneNotFoundError(f"{uri!a}: is no name of a file; it holds characters that no text has") from e
    if "\0" in uri or "%00" in uri or len(uri) > _MAX_PATH or any(len(os.fsencode(part)) > _MAX_NAME for part in uri.split("/")):
        raise SceneNotFoundError(f"{uri[:80]!a}: is no name of a file; it is too long or holds a NUL")
    scheme, separator, rest = uri.partition("://")
    if not separator:
        is_path = uri.startswith(("/", "./", "../", "~")) or uri in (".", "..")
        return Path(os.path.expanduser(uri)) if is_path else None
    rest = unquote(rest)
    if scheme.lower() == "file" and rest.startswith("/"):
        return Path(rest)
    if scheme.lower() in ("package", "model"):
        folders = environment_folders() if scheme.lower() == "model" else ()
        candidates = [*(folder / rest for folder in folders), *installed_paths(rest)]
        found = next((path for path in candidates if exists(path)), None)
        if found is None:
            looked = "$AMENT_PREFIX_PATH, $GIBSON_SIM_PATH and $GZ_SIM_RESOURCE_PATH" if folders else "$AMENT_PREFIX_PATH"
            raise SceneNotFoundError(f"{uri}: is not there (looked in {looked})")
        return found
    if scheme.lower() in SCHEMES:
        raise SceneNotFoundError(f"{uri}: is no absolute path; write file:///folder/name")
    raise SceneNotFoundError(
        f"{uri}: cannot be fetched; download it and give the copy: {', '.join(s + '://' for s in SCHEMES)} or a path"
    )


def said(message: str) -> str:
    """Returns a message without the folder of what came as a string."""
    return message.replace(f"{NOWHERE}/", "").replace(str(NOWHERE), "any folder of models")


def check_inside(path: Path, roots: Sequence[Path], uri: str) -> None:
    """Checks that a file, symbolic links followed, lies in one of ``roots``; none = it may lie anywhere.

    Raises:
        SceneNotFoundError: it does not; says which folders are allowed.
    """
    if roots and not is_inside(path, roots):
        raise SceneNotFoundError(f"{uri}: lies outside the folders that are allowed: {', '.join(map(str, roots))}")


def check_file(path: Path, max_bytes: int) -> None:
    """Checks that a file can be read without surprises, before it is opened.

    Raises:
        SceneNotFoundError: it is not there, or this process may not see it.
        SceneError: it is a folder, a pipe or a device, or too large.
    """
    try:
        status = path.stat()
    except OSError as e:
        raise SceneNotFoundError(f"{path}: cannot be read: {e.strerror or e}") from e
    if not stat.S_ISREG(status.st_mode):
        raise SceneError(f"{path}: is no regular file")
    if status.st_size > max_bytes:
        mega = 1024 * 1024
        raise SceneError(f"{path}: has {status.st_size // mega} MB, must be at most {max_bytes // mega} MB")
    if not os.access(path, os.R_OK):
        raise SceneNotFoundError(f"{path}: cannot be read: Permission denied")


@dataclass(slots=True)
class Search:
    """What one search may still look at; a request of many folders, or of folders full of large files, would never be answered."""

    entries: int = field(default_factory=lambda: _MAX_ENTRIES)
    read_bytes: int = field(default_factory=lambda: _MAX_SEARCHED_BYTES)

    def head(self, path: Path, most: int) -> bytes:
        """Returns the first bytes of a file.

        Raises:
            OSError: it cannot be read, or this search has read enough.
        """
        data = read_head(path, most)
        self.read_bytes -= len(data)
        if self.read_bytes < 0:
            raise OSError(errno.EFBIG, "too much was read")
        return data


def walk(folder: Path, search: Search | None = None) -> Iterator[tuple[Path, list[str], list[str]]]:
    """Yields (folder, names of folders, names of files), sorted, nothing hidden, symbolic links not followed.

    Whoever removes names from the second does not get these folders.

    Args:
        folder: where it begins.
        search: what it counts against; None = a search of its own.

    Raises:
        SceneNotFoundError: there are too many files.
    """
    left = Search() if search is None else search
    if left.entries <= 0:
        raise SceneNotFoundError(
            f"{folder}: is left out: {_MAX_ENTRIES} files and folders were looked at; name fewer folders at once"
        )
    top = len(folder.parts)
    for where, folders, files in os.walk(folder):
        left.entries -= len(files) + len(folders) + 1
        if left.entries < 0:
            raise SceneNotFoundError(f"{folder}: holds more than {_MAX_ENTRIES} files and folders; name a folder further down")
        if len(Path(where).parts) - top >= _MAX_LEVELS:
            folders.clear()
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        yield Path(where), folders, sorted(name for name in files if not name.startswith("."))
