"""Resolves URIs from clients to files on this machine, checks that they may be read, and walks folders within limits."""

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
from gibson_sim.formats.uris import cached_models, environment_folders, installed_paths, missing_from_cache
from gibson_sim.reading import exists, read_head

MAX_BYTES = 512 * 1024 * 1024
"""Maximum size of a mesh file, bytes."""
TEXT_FOLDER = Path("/nonexistent")
"""Placeholder for the folder of descriptions that were received as text; contains no files."""
SCHEMES = ("file", "package", "model")
_MAX_ENTRIES = 20_000
"""Maximum number of files and folders that one search visits."""
_MAX_SEARCHED_BYTES = 4 * 2**20
"""Maximum total size of the descriptions that one search reads, bytes."""
_MAX_LEVELS = 12
"""Maximum depth of the folders that a search visits."""
_MAX_PATH, _MAX_NAME = 4096, 255
"""Maximum length of a path and of a file name in Linux, bytes."""


def path_of(uri: str) -> Path | None:
    """Returns the path of a URI or a path, or None for a plain name.

    Args:
        uri: ``file:///...``, ``package://<package>/...``, ``model://<model>/...``, the URL of a model on Gazebo Fuel, or a path that
            starts with ``/``, ``./``, ``../`` or ``~``.

    Raises:
        SceneNotFoundError: the URI does not resolve to a file on this machine.
    """
    try:
        os.fsencode(uri)
    except UnicodeEncodeError as e:
        raise SceneNotFoundError(f"{uri!a}: is not a file name; it holds invalid characters") from e
    if "\0" in uri or "%00" in uri or len(uri) > _MAX_PATH or any(len(os.fsencode(part)) > _MAX_NAME for part in uri.split("/")):
        raise SceneNotFoundError(f"{uri[:80]!a}: is not a file name; it is too long or holds a NUL")
    scheme, separator, path = uri.partition("://")
    if not separator:
        is_path = uri.startswith(("/", "./", "../", "~")) or uri in (".", "..")
        return Path(os.path.expanduser(uri)) if is_path else None
    path = unquote(path)
    if scheme.lower() == "file" and path.startswith("/"):
        return Path(path)
    if scheme.lower() in ("package", "model"):
        folders = environment_folders() if scheme.lower() == "model" else ()
        candidates = [*(folder / path for folder in folders), *installed_paths(path), *cached_models(unquote(uri))]
        existing = next((candidate for candidate in candidates if exists(candidate)), None)
        if existing is None:
            searched = "$AMENT_PREFIX_PATH, $GIBSON_SIM_PATH and $GZ_SIM_RESOURCE_PATH" if folders else "$AMENT_PREFIX_PATH"
            raise SceneNotFoundError(f"{uri}: does not exist (searched {searched})")
        return existing
    cached = next((candidate for candidate in cached_models(unquote(uri)) if exists(candidate)), None)
    if cached is not None:
        return cached
    missing = missing_from_cache(uri)
    if missing:
        raise SceneNotFoundError(f"{uri}: {missing}")
    if scheme.lower() in SCHEMES:
        raise SceneNotFoundError(f"{uri}: is not an absolute path; write file:///folder/name")
    raise SceneNotFoundError(
        f"{uri}: cannot be fetched; download it and give the copy: {', '.join(s + '://' for s in SCHEMES)} or a path"
    )


def without_text_folder(message: str) -> str:
    """Returns a message with the placeholder ``TEXT_FOLDER`` removed."""
    return message.replace(f"{TEXT_FOLDER}/", "").replace(str(TEXT_FOLDER), "any folder of models")


def check_inside(path: Path, roots: Sequence[Path], uri: str) -> None:
    """Checks that a file lies in one of the folders ``roots`` after following symbolic links; empty ``roots`` = no check.

    Raises:
        SceneNotFoundError: the file lies elsewhere; the message names the allowed folders.
    """
    if roots and not is_inside(path, roots):
        raise SceneNotFoundError(f"{uri}: lies outside the allowed folders: {', '.join(map(str, roots))}")


def check_file(path: Path, max_bytes: int) -> None:
    """Checks that a path is a readable regular file of at most ``max_bytes``, without opening it.

    Raises:
        SceneNotFoundError: the file does not exist, or this process may not read it.
        SceneError: the path is a folder, a pipe or a device, or the file is too large.
    """
    try:
        status = path.stat()
    except OSError as e:
        raise SceneNotFoundError(f"{path}: cannot be read: {e.strerror or e}") from e
    if not stat.S_ISREG(status.st_mode):
        raise SceneError(f"{path}: is not a regular file")
    if status.st_size > max_bytes:
        mega = 1024 * 1024
        raise SceneError(f"{path}: has {status.st_size // mega} MB, must be at most {max_bytes // mega} MB")
    if not os.access(path, os.R_OK):
        raise SceneNotFoundError(f"{path}: cannot be read: Permission denied")


@dataclass(slots=True)
class Search:
    """Remaining budget of one search, so that a request for many folders or large files does not block for long."""

    entries: int = field(default_factory=lambda: _MAX_ENTRIES)
    """Number of files and folders that may still be visited."""
    read_bytes: int = field(default_factory=lambda: _MAX_SEARCHED_BYTES)
    """Number of bytes that may still be read."""

    def head(self, path: Path, most: int) -> bytes:
        """Returns at most the first ``most`` bytes of a file, and deducts them from the budget.

        Raises:
            OSError: the file cannot be read, or the budget is exhausted.
        """
        data = read_head(path, most)
        self.read_bytes -= len(data)
        if self.read_bytes < 0:
            raise OSError(errno.EFBIG, "the size limit of one search is exceeded")
        return data


def walk(folder: Path, search: Search | None = None) -> Iterator[tuple[Path, list[str], list[str]]]:
    """Yields (folder, folder names, file names), sorted, without hidden ones, as ``os.walk``; does not follow symbolic links.

    Folders that the caller removes from the second list are skipped.

    Args:
        folder: the topmost folder.
        search: budget; None = a new one.

    Raises:
        SceneNotFoundError: the folder holds too many files.
    """
    budget = Search() if search is None else search
    if budget.entries <= 0:
        raise SceneNotFoundError(
            f"{folder}: is left out: {_MAX_ENTRIES} files and folders were searched; name fewer folders at once"
        )
    top = len(folder.parts)
    for path, folders, files in os.walk(folder):
        budget.entries -= len(files) + len(folders) + 1
        if budget.entries < 0:
            raise SceneNotFoundError(f"{folder}: holds more than {_MAX_ENTRIES} files and folders; name a folder further down")
        if len(Path(path).parts) - top >= _MAX_LEVELS:
            folders.clear()
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        yield Path(path), folders, sorted(name for name in files if not name.startswith("."))
