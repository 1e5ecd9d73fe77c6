"""Serialises files and folders for transfer: a list of entries, and file contents by BLAKE2b digest. Must not import Ray.

The files that a unit reads are stored in a ``FileCache`` on each machine, each content once; its output is sent back with its contents.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.quoting import quoted
from gibson_sim.reading import read_file
from gibson_sim.writing import cannot_write, size_text, write_file

MAX_ENTRIES = 200_000
"""Largest number of files and folders in one folder."""
Contents = dict[str, bytes]
"""Digest -> file content."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A file, a folder, or a symbolic link."""

    path: str
    """Path relative to the folder; empty = the root itself."""
    kind: Literal["file", "folder", "link"]
    text: str = ""
    """Digest of a file, or target of a link."""
    executable: bool = False


def digest_of(content: bytes) -> str:
    """Returns the BLAKE2b digest of a content, 64 hexadecimal digits."""
    return hashlib.blake2b(content, digest_size=32).hexdigest()


def entries_of(
    root: Path, keep: Callable[[str, bytes], None], *, limit_bytes: int, links_may_leave: bool = False
) -> tuple[Entry, ...]:
    """Reads a file or a folder; returns its entries, sorted by path.

    Args:
        root: the file or folder.
        keep: called with digest and content of every file.
        limit_bytes: largest total size of all contents.
        links_may_leave: whether links that lead out of the folder are kept, and pipes and sockets ignored; otherwise both are refused.

    Raises:
        ConfigError: a limit is exceeded, an entry cannot be read, or a link leaves the folder.
    """
    entries: list[Entry] = []
    size = 0
    for path, name in _walk(root):
        if len(entries) >= MAX_ENTRIES:
            raise ConfigError(f"{root} has more than {MAX_ENTRIES} files and folders; name a smaller folder")
        if path.is_symlink() and name:
            target = os.readlink(path)
            if not links_may_leave and not _is_within(root, path, target):
                raise ConfigError(
                    f"{path} is a link to {quoted(target)}, outside of {root}: put a copy there instead of the link"
                )
            entries.append(Entry(name, "link", target))
        elif path.is_dir():
            entries.append(Entry(name, "folder"))
        elif path.is_file():
            try:
                size += path.stat().st_size
                if size > limit_bytes:
                    raise ConfigError(f"{root} has more than {size_text(limit_bytes)}; name a smaller folder, or allow more")
                content = read_file(path, limit_bytes)
            except OSError as error:
                raise ConfigError(f"{path} cannot be read: {error.strerror}") from error
            digest = digest_of(content)
            keep(digest, content)
            entries.append(Entry(name, "file", digest, os.access(path, os.X_OK)))
        elif not links_may_leave:
            raise ConfigError(f"{path} is neither a file nor a folder")
    return tuple(sorted(entries, key=lambda entry: entry.path))


def unpack(root: Path, entries: Collection[Entry], contents: Mapping[str, bytes]) -> None:
    """Writes entries into an existing folder. Links come last, so that no file is written through a link.

    Raises:
        GibsonSimError: an entry's path leads out of the folder, or a content does not match its digest.
        WriteError: a file cannot be written.
    """
    for entry in sorted(entries, key=lambda entry: (entry.kind == "link", entry.path)):
        path = root / _checked(entry.path)
        try:
            if entry.kind == "folder":
                path.mkdir(parents=True, exist_ok=True)
            elif entry.kind == "link":
                path.parent.mkdir(parents=True, exist_ok=True)
                path.symlink_to(entry.text)
            else:
                content = contents[entry.text]
                if digest_of(content) != entry.text:
                    raise GibsonSimError(f"{entry.path} was damaged in transfer: its content does not match its digest")
                write_file(path, content, durable=False)
                path.chmod(0o755 if entry.executable else 0o644)
        except OSError as error:
            raise cannot_write(path, error) from error


class FileCache:
    """Cache of files and folders of other machines, by digest. Its folder may be removed while no unit runs.

    ::

        FOLDER/contents/<digest>      read-only; <digest>.x is executable
        FOLDER/trees/<digest>/<name>  a file or a folder, of hard links to the contents
    """

    def __init__(self, folder: Path) -> None:
        """``folder``: created when needed."""
        self._contents, self._trees = folder / "contents", folder / "trees"

    def store(self, name: str, entries: Collection[Entry], fetch: Callable[[list[str]], Contents]) -> Path:
        """Stores a file or folder unless it is in the cache; returns its path.

        Args:
            name: last part of its path.
            entries: entries of the file or folder.
            fetch: returns the missing contents by their digests.

        Raises:
            GibsonSimError: an entry's path leads out of the folder, or a content does not match its digest.
            WriteError: the folder cannot be written.
        """
        text = json.dumps([name, [asdict(entry) for entry in entries]])
        tree = self._trees / digest_of(text.encode())
        path = tree / _checked(name)
        if tree.exists():
            return path
        try:
            self._contents.mkdir(parents=True, exist_ok=True)
            self._trees.mkdir(parents=True, exist_ok=True)
            files = [entry for entry in entries if entry.kind == "file"]
            missing = [entry.text for entry in files if not self._has(entry)]
            fetched = fetch(list(dict.fromkeys(missing))) if missing else {}
            partial = Path(tempfile.mkdtemp(dir=self._trees, prefix=".half-"))
            try:
                self._build(partial / name, entries, fetched)
                partial.chmod(0o755)
                partial.rename(tree)
            except BaseException as error:
                shutil.rmtree(partial, ignore_errors=True)
                if not (isinstance(error, OSError) and tree.exists()):  # another process has created it meanwhile
                    raise
        except OSError as error:
            raise cannot_write(tree, error) from error
        return path

    def _content(self, entry: Entry) -> Path:
        return self._contents / (f"{entry.text}.x" if entry.executable else entry.text)

    def _has(self, entry: Entry) -> bool:
        """Returns whether a content is stored; removes a damaged one, left by a crash of the machine."""
        stored = self._content(entry)
        if stored.exists() and digest_of(stored.read_bytes()) == entry.text:
            return True
        stored.unlink(missing_ok=True)
        return False

    def _build(self, root: Path, entries: Collection[Entry], fetched: Contents) -> None:
        for entry in sorted(entries, key=lambda entry: (entry.kind == "link", entry.path)):
            path = root / _checked(entry.path) if entry.path else root
            path.parent.mkdir(parents=True, exist_ok=True)
            if entry.kind == "folder":
                path.mkdir(exist_ok=True)
            elif entry.kind == "link":
                path.symlink_to(entry.text)
            else:
                stored = self._stored(entry, fetched)
                try:
                    os.link(stored, path)
                except OSError:  # no hard links on this file system, or too many
                    shutil.copy2(stored, path)

    def _stored(self, entry: Entry, fetched: Contents) -> Path:
        """Stores the content of a file unless it is stored; returns its path."""
        stored = self._content(entry)
        if not stored.exists():
            if digest_of(fetched[entry.text]) != entry.text:
                raise GibsonSimError(f"{entry.path} was damaged in transfer: its content does not match its digest")
            write_file(stored, fetched[entry.text], durable=False)
            stored.chmod(0o555 if entry.executable else 0o444)
        return stored


def _walk(root: Path) -> Iterator[tuple[Path, str]]:
    """Yields all paths of a file or folder with their names relative to it; links are not followed."""
    yield root, ""
    for parent, folders, names in os.walk(root):
        relative = os.path.relpath(parent, root)
        for name in sorted([*folders, *names]):
            yield Path(parent, name), name if relative == "." else f"{relative}/{name}"


def _is_within(root: Path, link: Path, target: str) -> bool:
    """Returns whether a link leads to a path inside a folder, also after the folder is copied elsewhere."""
    return not os.path.isabs(target) and Path(os.path.realpath(link)).is_relative_to(os.path.realpath(root))


def _checked(path: str) -> str:
    """Returns the path of an entry if it does not lead out of the folder.

    Raises:
        GibsonSimError: the path leads out of the folder.
    """
    if path.startswith("/") or ".." in PurePosixPath(path).parts or "\0" in path:
        raise GibsonSimError(f"an entry has the path {quoted(path)}, which leads out of its folder")
    return path
