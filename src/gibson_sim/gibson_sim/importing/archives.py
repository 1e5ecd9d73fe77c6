"""Unpacks archives that strangers made: bounded in size, number and depth, and never outside the folder."""

from __future__ import annotations

import shutil
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO

from gibson_sim.errors import SceneError
from gibson_sim.quoting import quoted

_BLOCK = 1 << 20
_ERRORS = (zipfile.BadZipFile, tarfile.TarError, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError, ValueError)


@dataclass(frozen=True, slots=True)
class ArchiveLimits:
    """What may come out of an archive."""

    bytes: int = 20 * 2**30
    """Of all files together."""
    files: int = 100_000
    ratio: int = 200
    """Times its packed size, once more than ``free`` bytes have come out."""
    free: int = 64 * 2**20


@dataclass(frozen=True, slots=True)
class _Entry:
    name: str
    size: int
    """As the archive says."""
    special: str
    """What it is, if it is neither file nor folder."""
    is_folder: bool


def unpack(archive: Path, folder: Path, limits: ArchiveLimits | None = None) -> None:
    """Unpacks a ZIP or TAR into a folder, which is made.

    Args:
        archive: the file.
        folder: where its content goes; what was written stays there when it fails.
        limits: None = the usual ones.

    Raises:
        SceneError: it is broken, too large, or holds names that leave the folder, links or devices; nothing of these is written.
    """
    bounds = limits or ArchiveLimits()
    try:
        packed = archive.stat().st_size
        with _open(archive) as source:
            entries = list(_checked(archive, _entries(archive, source, bounds), packed, bounds))
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
                        # What the archive says of its sizes may be a lie.
                        _check_total(archive, total, packed, bounds)
                        out.write(block)
    except SceneError:
        raise
    except _ERRORS as e:
        raise SceneError(
            f"{archive}: cannot be unpacked: {' '.join(str(e).split()) or type(e).__name__}; download it again"
        ) from e


def _open(archive: Path) -> zipfile.ZipFile | tarfile.TarFile:
    if zipfile.is_zipfile(archive):
        return zipfile.ZipFile(archive)
    return tarfile.open(archive)


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


def _checked(archive: Path, entries: Iterable[_Entry], packed: int, limits: ArchiveLimits) -> Iterator[_Entry]:
    names: set[str] = set()
    total = 0
    for entry in entries:
        # Of a compressed TAR the next header lies behind this content, which so is never read where it is too long.
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
                f"{archive}: holds {quoted(entry.name)}, which would leave the folder; nothing was unpacked. Do not use this archive"
            )
        if entry.special:
            raise SceneError(
                f"{archive}: {quoted(entry.name)} is {entry.special}, only files and folders are unpacked; nothing was"
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
    """Returns the folder itself, or the one that alone lies in it."""
    entries = [entry for entry in folder.iterdir() if not entry.name.startswith((".", "__MACOSX"))]
    return only_folder(entries[0]) if len(entries) == 1 and entries[0].is_dir() else folder


def needs_space(folder: Path, bytes_: int) -> None:
    """Checks that a disk has room.

    Raises:
        SceneError: it has not.
    """
    there = next(p for p in (folder, *folder.parents) if p.exists())
    free = shutil.disk_usage(there).free
    if free < bytes_:
        raise SceneError(
            f"{folder}: needs {bytes_ / 2**20:.0f} MB, the disk has {free / 2**20:.0f} MB left; make room or give another folder"
        )
