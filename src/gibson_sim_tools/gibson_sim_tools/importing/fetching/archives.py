"""Unpacks untrusted archives: bounded in size, number of files and depth, and never outside the destination."""

from __future__ import annotations

import bz2
import gzip
import lzma
import shutil
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any, cast

from gibson_sim.errors import SceneError
from gibson_sim.quoting import quoted

_BLOCK = 1 << 20
_DECOMPRESSORS: dict[bytes, Callable[[IO[bytes]], Any]] = {
    b"\x1f\x8b": lambda file: gzip.GzipFile(fileobj=file),
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ\0": lzma.LZMAFile,
}
"""Decompressor by the magic bytes of a compressed file."""
_ERRORS = (
    zipfile.BadZipFile,
    tarfile.TarError,
    zlib.error,
    lzma.LZMAError,
    EOFError,
    OSError,
    NotImplementedError,
    RuntimeError,
    ValueError,
)


@dataclass(frozen=True, slots=True)
class ArchiveLimits:
    """Limits on the content of an archive."""

    bytes: int = 20 * 2**30
    """Maximum total size of all files, bytes."""
    files: int = 100_000
    """Maximum number of files."""
    ratio: int = 200
    """Maximum ratio of unpacked to packed size, beyond the first ``free`` bytes."""
    free: int = 64 * 2**20
    """Unpacked size up to which ``ratio`` does not apply, bytes."""


@dataclass(frozen=True, slots=True)
class _Entry:
    name: str
    size: int
    """Size according to the archive, bytes."""
    special: str
    """Type of an entry that is neither file nor folder, with its article; else empty."""
    is_folder: bool


def unpack(archive: Path, folder: Path, limits: ArchiveLimits | None = None) -> None:
    """Unpacks a ZIP or TAR archive into a folder.

    Args:
        archive: the file.
        folder: destination, created if missing; after a failure, it keeps the files written so far.
        limits: None = the defaults.

    Raises:
        SceneError: the archive is damaged or too large, or contains links, devices, or paths outside the folder; none of these is written.
    """
    bounds = limits or ArchiveLimits()
    try:
        packed = archive.stat().st_size
        with _open(archive, packed, bounds) as source:
            entries = list(_validated_entries(archive, _entries(archive, source, bounds), packed, bounds))
            folder.mkdir(parents=True, exist_ok=True)
            total = 0
            for entry in entries:
                target = folder / entry.name
                if entry.is_folder:
                    target.mkdir(parents=True, exist_ok=True)
                    continue
                target.parent.mkdir(parents=True, exist_ok=True)
                with _content(source, entry.name) as content, target.open("xb") as out:
                    while block := content.read(_BLOCK):
                        total += len(block)
                        # The sizes in the archive are not trusted.
                        _check_total(archive, total, packed, bounds)
                        out.write(block)
    except SceneError:
        raise
    except _ERRORS as e:
        raise SceneError(
            f"{archive}: cannot be unpacked: {' '.join(str(e).split()) or type(e).__name__}; download it again"
        ) from e


class _BoundedStream:
    """A stream that rejects reads larger than a TAR header may be, and seeks beyond the size limits.

    tarfile reads a whole header of names and comments, and all data between two files, before it yields an entry.
    """

    def __init__(self, archive: Path, stream: IO[bytes], packed: int, limits: ArchiveLimits) -> None:
        self._archive, self._stream, self._packed, self._limits = archive, stream, packed, limits

    def read(self, size: int = -1) -> bytes:
        if not 0 <= size <= _BLOCK:
            raise SceneError(
                f"{self._archive}: a header has {size / 2**20:.0f} MB, must be at most {_BLOCK >> 20} MB; nothing was unpacked"
            )
        return self._stream.read(size)

    def seek(self, position: int) -> int:
        _check_total(self._archive, position, self._packed, self._limits)
        return self._stream.seek(position)

    def tell(self) -> int:
        return self._stream.tell()


@contextmanager
def _open(archive: Path, packed: int, limits: ArchiveLimits) -> Iterator[zipfile.ZipFile | tarfile.TarFile]:
    if zipfile.is_zipfile(archive):
        with zipfile.ZipFile(archive) as source:
            yield source
        return
    with archive.open("rb") as file:
        magic_bytes = file.read(6)
        file.seek(0)
        decompressor = next(
            (decompressor for magic, decompressor in _DECOMPRESSORS.items() if magic_bytes.startswith(magic)), None
        )
        stream: Any = file if decompressor is None else decompressor(file)
        with tarfile.open(fileobj=cast(Any, _BoundedStream(archive, stream, packed, limits)), mode="r:") as tar:
            yield tar


def _entries(archive: Path, source: zipfile.ZipFile | tarfile.TarFile, limits: ArchiveLimits) -> Iterator[_Entry]:
    members: Iterable[zipfile.ZipInfo | tarfile.TarInfo] = source.infolist() if isinstance(source, zipfile.ZipFile) else source
    for count, member in enumerate(members):
        if count >= limits.files:
            raise SceneError(f"{archive}: holds more than {limits.files} files; unpack it yourself if you trust it")
        if isinstance(member, zipfile.ZipInfo):
            kind = stat.S_IFMT(member.external_attr >> 16)
            special = "" if kind in (0, stat.S_IFREG, stat.S_IFDIR) else "a link" if stat.S_ISLNK(kind) else "a device"
            yield _Entry(member.filename, member.file_size, special, member.is_dir())
        else:
            special = "" if member.isfile() or member.isdir() else "a link" if member.issym() or member.islnk() else "a device"
            yield _Entry(member.name, member.size, special, member.isdir())


def _validated_entries(archive: Path, entries: Iterable[_Entry], packed: int, limits: ArchiveLimits) -> Iterator[_Entry]:
    names: set[str] = set()
    total = 0
    for entry in entries:
        # In a compressed TAR the next header follows this content; the check comes first, so that too much content is never read.
        total += entry.size
        _check_total(archive, total, packed, limits)
        path = PurePosixPath(entry.name)
        if (
            path.is_absolute()
            or ".." in path.parts
            or "\\" in entry.name
            or "\0" in entry.name
            or ":" in entry.name.partition("/")[0]
        ):
            raise SceneError(
                f"{archive}: holds {quoted(entry.name)}, a path outside the folder; nothing was unpacked. Do not use this archive"
            )
        if entry.special:
            raise SceneError(
                f"{archive}: {quoted(entry.name)} is {entry.special}; only files and folders are allowed; nothing was unpacked"
            )
        if not entry.is_folder and str(path) in names:
            raise SceneError(f"{archive}: holds {quoted(entry.name)} twice; nothing was unpacked")
        names.add(str(path))
        yield entry


def _check_total(archive: Path, total: int, packed: int, limits: ArchiveLimits) -> None:
    if total > limits.bytes:
        raise SceneError(f"{archive}: unpacks to more than {limits.bytes / 2**20:.0f} MB; unpack it yourself if you trust it")
    if total > limits.free and total > limits.ratio * packed:
        raise SceneError(
            f"{archive}: has {packed / 1e6:.2f} MB and unpacks to more than {total / 1e6:.0f} MB, over {limits.ratio} times as much: "
            "it looks like a zip bomb; unpack it yourself if you trust it"
        )


def _content(source: zipfile.ZipFile | tarfile.TarFile, name: str) -> IO[bytes]:
    if isinstance(source, zipfile.ZipFile):
        return source.open(name)
    content = source.extractfile(name)
    if content is None:
        raise SceneError(f"{name}: cannot be unpacked; download the archive again")
    return content


def only_folder(folder: Path) -> Path:
    """Returns the innermost folder, below folders that contain only one folder each; else the folder itself."""
    entries = [entry for entry in folder.iterdir() if not entry.name.startswith((".", "__MACOSX"))]
    return only_folder(entries[0]) if len(entries) == 1 and entries[0].is_dir() else folder


def check_disk_space(folder: Path, bytes_: int) -> None:
    """Checks that the disk of a folder has enough free space. ``bytes_``: space needed.

    Raises:
        SceneError: the space is insufficient.
    """
    existing = next(p for p in (folder, *folder.parents) if p.exists())
    free = shutil.disk_usage(existing).free
    if free < bytes_:
        raise SceneError(
            f"{folder}: needs {bytes_ / 2**20:.0f} MB, the disk has {free / 2**20:.0f} MB left; free some space, or give another folder"
        )
