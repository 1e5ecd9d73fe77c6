"""Resolves URIs from clients to files on this machine, checks that these may be read, and lists folders within limits."""

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
"""Largest size of a mesh file."""
TEXT_FOLDER = Path("/nonexistent")
"""Folder of descriptions that came as text: no file lies beside them."""
SCHEMES = ("file", "package", "model")
_MAX_ENTRIES = 20_000
"""Files and folders that one search visits."""
_MAX_SEARCHED_BYTES = 4 * 2**20
"""Bytes of descriptions that one search reads."""
_MAX_LEVELS = 12
"""Depth of the folders that a search visits."""
_MAX_PATH, _MAX_NAME = 4096, 255
"""Longest path and file name of Linux, bytes."""


def path_of(uri: str) -> Path | None:
    """Returns the path that a URI or a path stands for, or None if it is a plain name.

    Args:
        uri: ``file:///...``, ``package://<package>/...``, ``model://<model>/...``, or a path that starts with ``/``, ``./``, ``../``
            or ``~``.

    Raises:
        SceneNotFoundError: it stands for no file on this machine.
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


def without_text_folder(message: str) -> str:
    """Returns a message without the placeholder ``TEXT_FOLDER``."""
    return message.replace(f"{TEXT_FOLDER}/", "").replace(str(TEXT_FOLDER), "any folder of models")


def check_inside(path: Path, roots: Sequence[Path], uri: str) -> None:
    """Checks that a file lies in one of the folders ``roots`` after following symbolic links; no roots = it may lie anywhere.

    Raises:
        SceneNotFoundError: it lies elsewhere; the message names the allowed folders.
    """
    if roots and not is_inside(path, roots):
        raise SceneNotFoundError(f"{uri}: lies outside the folders that are allowed: {', '.join(map(str, roots))}")


def check_file(path: Path, max_bytes: int) -> None:
    """Checks that a path is a readable regular file of at most ``max_bytes``, without opening it.

    Raises:
        SceneNotFoundError: it does not exist, or this process may not read it.
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
    """Remaining budget of one search; without one, a request for many folders or large files would block for very long."""

    entries: int = field(default_factory=lambda: _MAX_ENTRIES)
    """Files and folders."""
    read_bytes: int = field(default_factory=lambda: _MAX_SEARCHED_BYTES)

    def head(self, path: Path, most: int) -> bytes:
        """Returns at most the first ``most`` bytes of a file.

        Raises:
            OSError: it cannot be read, or the budget is spent.
        """
        data = read_head(path, most)
        self.read_bytes -= len(data)
        if self.read_bytes < 0:
            raise OSError(errno.EFBIG, "too much was read")
        return data


def walk(folder: Path, search: Search | None = None) -> Iterator[tuple[Path, list[str], list[str]]]:
    """Yields (folder, names of folders, names of files), sorted, without hidden ones; does not follow symbolic links.

    Folders whose names the caller removes from the second list are skipped.

    Args:
        folder: the topmost folder.
        search: budget to spend; None = one of its own.

    Raises:
        SceneNotFoundError: there are too many files.
    """
    budget = Search() if search is None else search
    if budget.entries <= 0:
        raise SceneNotFoundError(
            f"{folder}: is left out: {_MAX_ENTRIES} files and folders were looked at; name fewer folders at once"
        )
    top = len(folder.parts)
    for where, folders, files in os.walk(folder):
        budget.entries -= len(files) + len(folders) + 1
        if budget.entries < 0:
            raise SceneNotFoundError(f"{folder}: holds more than {_MAX_ENTRIES} files and folders; name a folder further down")
        if len(Path(where).parts) - top >= _MAX_LEVELS:
            folders.clear()
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        yield Path(where), folders, sorted(name for name in files if not name.startswith("."))
