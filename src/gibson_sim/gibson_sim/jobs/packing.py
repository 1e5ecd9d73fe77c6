"""Files and folders as values that travel: a list of entries, and the contents of the files by their BLAKE2b digests. Without Ray.

What a unit reads goes into a ``FileCache`` on each machine, where each content is stored once; what it wrote comes back with its contents.
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
"""Limit of files and folders in one folder."""
Contents = dict[str, bytes]
"""Digest -> content of a file."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A file, a folder, or a symbolic link."""

    path: str
    """Below the folder; empty = the file itself."""
    kind: Literal["file", "folder", "link"]
    text: str = ""
    """Digest of a file, target of a link."""
    executable: bool = False


def digest_of(content: bytes) -> str:
    """Returns the BLAKE2b digest of a content: 64 hexadecimal digits."""
    return hashlib.blake2b(content, digest_size=32).hexdigest()


def entries_of(
    root: Path, keep: Callable[[str, bytes], None], *, limit_bytes: int, links_may_leave: bool = False
) -> tuple[Entry, ...]:
    """Reads a file or a folder, and returns its entries, sorted by path.

    Args:
        root: the file or folder.
        keep: receives digest and content of every file.
        limit_bytes: limit of all contents.
        links_may_leave: whether links are kept that lead out of the folder; else they are refused. Pipes and sockets are left out or refused.

    Raises:
        ConfigError: there is too much, or a link leaves the folder.
    """
    found: list[Entry] = []
    size = 0
    for path, name in _walk(root):
        if len(found) >= MAX_ENTRIES:
            raise ConfigError(f"{root} has more than {MAX_ENTRIES} files and folders; name a smaller folder")
        if path.is_symlink() and name:
            target = os.readlink(path)
            if not links_may_leave and not _is_within(root, path, target):
                raise ConfigError(
                    f"{path} is a link to {quoted(target)}, outside of {root}: put a copy there instead of the link"
                )
            found.append(Entry(name, "link", target))
        elif path.is_dir():
            found.append(Entry(name, "folder"))
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
            found.append(Entry(name, "file", digest, os.access(path, os.X_OK)))
        elif not links_may_leave:
            raise ConfigError(f"{path} is neither a file nor a folder")
    return tuple(sorted(found, key=lambda entry: entry.path))


def unpack(root: Path, entries: Collection[Entry], contents: Mapping[str, bytes]) -> None:
    """Writes entries into a folder that exists. Links come last: nothing is written through one.

    Raises:
        GibsonSimError: an entry has an impossible path, or a content has another digest.
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
                    raise GibsonSimError(f"{entry.path} arrived with another content than it was sent with")
                write_file(path, content, durable=False)
                path.chmod(0o755 if entry.executable else 0o644)
        except OSError as error:
            raise cannot_write(path, error) from error


class FileCache:
    """Files and folders of other machines, by their digests. Its folder may be removed whenever nothing runs.

    ::

        FOLDER/contents/<digest>      read-only; <digest>.x is executable
        FOLDER/trees/<digest>/<name>  a file or a folder, of hard links to the contents
    """

    def __init__(self, folder: Path) -> None:
        """``folder``: made when it is needed."""
        self._contents, self._trees = folder / "contents", folder / "trees"

    def place(self, name: str, entries: Collection[Entry], fetch: Callable[[list[str]], Contents]) -> Path:
        """Returns where a file or folder is, and puts it there first if it is not.

        Args:
            name: last part of its path.
            entries: what it is.
            fetch: returns the contents that are missing here.

        Raises:
            GibsonSimError: an entry has an impossible path, or a content has another digest.
            WriteError: the folder cannot be written.
        """
        text = json.dumps([name, [asdict(entry) for entry in entries]])
        tree = self._trees / digest_of(text.encode())
        place = tree / _checked(name)
        if tree.exists():
            return place
        try:
            self._contents.mkdir(parents=True, exist_ok=True)
            self._trees.mkdir(parents=True, exist_ok=True)
            files = [entry for entry in entries if entry.kind == "file"]
            missing = [entry.text for entry in files if not self._has(entry)]
            fetched = fetch(list(dict.fromkeys(missing))) if missing else {}
            half = Path(tempfile.mkdtemp(dir=self._trees, prefix=".half-"))
            try:
                self._build(half / name, entries, fetched)
                half.chmod(0o755)
                half.rename(tree)
            except BaseException as error:
                shutil.rmtree(half, ignore_errors=True)
                if not (isinstance(error, OSError) and tree.exists()):  # another process has made it meanwhile
                    raise
        except OSError as error:
            raise cannot_write(tree, error) from error
        return place

    def _content(self, entry: Entry) -> Path:
        return self._contents / (f"{entry.text}.x" if entry.executable else entry.text)

    def _has(self, entry: Entry) -> bool:
        """Returns whether a content is here; removes one that a crash of the machine left damaged."""
        stored = self._content(entry)
        if stored.exists() and digest_of(stored.read_bytes()) == entry.text:
            return True
        stored.unlink(missing_ok=True)
        return False

    def _build(self, place: Path, entries: Collection[Entry], fetched: Contents) -> None:
        for entry in sorted(entries, key=lambda entry: (entry.kind == "link", entry.path)):
            path = place / _checked(entry.path) if entry.path else place
            path.parent.mkdir(parents=True, exist_ok=True)
            if entry.kind == "folder":
                path.mkdir(exist_ok=True)
            elif entry.kind == "link":
                path.symlink_to(entry.text)
            else:
                stored = self._stored(entry, fetched)
                try:
                    os.link(stored, path)
                except OSError:  # a file system without hard links, or with the most that it allows
                    shutil.copy2(stored, path)

    def _stored(self, entry: Entry, fetched: Contents) -> Path:
        """Returns the stored content of a file."""
        stored = self._content(entry)
        if not stored.exists():
            if digest_of(fetched[entry.text]) != entry.text:
                raise GibsonSimError(f"{entry.path} arrived with another content than it was sent with")
            write_file(stored, fetched[entry.text], durable=False)
            stored.chmod(0o555 if entry.executable else 0o444)
        return stored


def _walk(root: Path) -> Iterator[tuple[Path, str]]:
    """Yields all paths of a file or folder, with their names below it; links are not followed."""
    yield root, ""
    for place, folders, names in os.walk(root):
        below = os.path.relpath(place, root)
        for name in sorted([*folders, *names]):
            yield Path(place, name), name if below == "." else f"{below}/{name}"


def _is_within(root: Path, link: Path, target: str) -> bool:
    """Returns whether a link leads to a place in a folder, also where the folder is copied elsewhere."""
    return not os.path.isabs(target) and Path(os.path.realpath(link)).is_relative_to(os.path.realpath(root))


def _checked(path: str) -> str:
    """Returns the path of an entry, which leads to no place above.

    Raises:
        GibsonSimError: it does.
    """
    if path.startswith("/") or ".." in PurePosixPath(path).parts or "\0" in path:
        raise GibsonSimError(f"an entry has the path {quoted(path)}, which leads out of its folder")
    return path
