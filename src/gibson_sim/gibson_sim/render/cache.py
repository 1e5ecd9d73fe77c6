"""Keeps what loading a scene has made, so that the next start does not make it again.

One file for each scene: a pickle of the ``Batches`` with its arrays outside it, page aligned, so that they are mapped into memory and
never copied. What decides the result is in the file's name: what is drawn, and the code that reads and cuts it; the meshes and
textures that were read are compared by size and time of change. To unpickle is to run what the file says: one that is not the user's
own, or that others may write, is not read.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import mmap
import os
import pickle
import stat
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gibson_sim import __version__
from gibson_sim.description.shapes import VisualSpec
from gibson_sim.render.batching.batches import Batches
from gibson_sim.render.lod.clusters import simplifier
from gibson_sim.resources import cache_folder

_log = logging.getLogger(__name__)
_MAGIC = b"gibson-sim scene 3\n"
_PAGE = 4096
SMALLEST = 20_000
"""Scenes with fewer triangles are loaded as fast without."""
LIMIT_BYTES = 8 * 2**30
"""The folder is kept below this: what was unused for longest goes first."""


def default_folder() -> Path:
    """Returns the folder of the user's own cache."""
    return cache_folder("scenes")


class SceneCache:
    """A folder of loaded scenes. Whatever goes wrong with it costs time, never the scene.

    Args:
        folder: where; made when first needed.
        limit_bytes: as ``LIMIT_BYTES``.
    """

    def __init__(self, folder: Path, limit_bytes: int = LIMIT_BYTES) -> None:
        self._folder, self._limit = folder, limit_bytes
        self._distrusted = False

    def path(
        self,
        visuals: Sequence[VisualSpec],
        links: Sequence[str],
        labels: Sequence[tuple[int, int]],
        coarser: bool,
        roots: Sequence[Path] = (),
    ) -> Path:
        """Returns the file for what is drawn; ``roots`` are the folders that its files may lie in, the others as in ``build_batches``."""
        digest = hashlib.sha256(_MAGIC)
        used = {visual.link for visual in visuals}
        # What comes behind the last link that is drawn, such as views, changes nothing.
        count = max((number + 1 for number, link in enumerate(links) if link in used), default=0)
        for part in (
            __version__,
            _code_digest(),
            simplifier() is not None,
            coarser,
            sorted(map(str, roots)),
            tuple(links)[:count],
            tuple(labels),
            *visuals,
        ):
            digest.update(repr(part).encode() + b"\0")
        return self._folder / f"{digest.hexdigest()[:32]}.scene"

    def load(self, path: Path) -> Batches | None:
        """Returns what a file holds, or None where there is none, or none that still holds. Its arrays cannot be written to."""
        try:
            reason = _unsafe(self._folder)
            descriptor = -1 if reason else os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
            if descriptor >= 0 and (reason := _others(os.fstat(descriptor))):
                os.close(descriptor)
                reason = f"{path} {reason}"
            if reason:
                self._distrust(reason)
                return None
            with open(descriptor, "rb") as file:
                content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            batches, files = _unpacked(memoryview(content))
        except FileNotFoundError:
            return None
        except (
            OSError,
            ValueError,
            pickle.UnpicklingError,
            AttributeError,
            ImportError,
            EOFError,
            TypeError,
            struct.error,
        ) as error:
            _log.warning("%s is not a scene that can be used (%s); the scene is loaded from its files", path, error)
            return None
        if [_mark(Path(name)) for name, _ in files] != [mark for _, mark in files]:
            return None
        try:
            os.utime(path)  # used just now: not the next one to go
        except OSError as error:
            _log.debug("%s: %s", path, error)
        return batches

    def store(self, path: Path, batches: Batches) -> None:
        """Keeps ``batches``, if they are worth it, for the next ``load``."""
        if batches.triangles < SMALLEST:
            return
        read = [*batches.files, *(_folders(batches.files) if batches.warnings else ())]
        files = [(str(file), _mark(file)) for file in read]
        temporary = path.with_suffix(f".{os.getpid()}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            if reason := _unsafe(self._folder):
                self._distrust(reason)
                return
            temporary.unlink(missing_ok=True)
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
            with open(os.open(temporary, flags, 0o600), "wb") as file:
                _pack(file, (batches, files))
            temporary.replace(path)
            self._trim()
        except OSError as error:
            _log.warning("the loaded scene cannot be kept in %s (%s); the next start will load it again", path.parent, error)
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)

    def _distrust(self, reason: str) -> None:
        """Says, once, why the cache is not used."""
        if not self._distrusted:
            self._distrusted = True
            _log.warning(
                "%s: what is kept of loaded scenes is not used; remove it, or set XDG_CACHE_HOME to a folder of your own", reason
            )

    def _trim(self) -> None:
        """Deletes the files unused for longest until the rest is below the limit."""
        files = sorted(self._folder.glob("*.scene"), key=lambda file: file.stat().st_mtime, reverse=True)
        total = 0
        for file in files:
            total += file.stat().st_size
            if total > self._limit and file != files[0]:
                file.unlink(missing_ok=True)


def _unsafe(folder: Path) -> str:
    """Returns why files of the cache cannot be trusted, "" if they can: whose the folder is, and the one that it lies in."""
    for place in (folder, folder.parent):
        try:
            status = place.stat()
        except FileNotFoundError:
            continue
        # In /tmp the sticky bit keeps others from putting another folder in the place of this one.
        if place != folder and status.st_mode & stat.S_ISVTX:
            continue
        if reason := _others(status):
            return f"{place} {reason}"
    return ""


def _others(status: os.stat_result) -> str:
    """Returns how others than this user could have written a file or folder, "" if they could not."""
    if status.st_uid not in (0, os.geteuid()):  # what root says is run anyway
        return f"belongs to user {status.st_uid}"
    return "may be written by others" if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH) else ""


def _pack(file: Any, value: object) -> None:
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
    raw = [buffer.raw() for buffer in buffers]
    sizes = struct.pack(f"<{2 + len(raw)}Q", len(head), len(raw), *(part.nbytes for part in raw))
    file.write(_MAGIC + hashlib.sha256(sizes + head).digest() + sizes + head)
    for part in raw:
        file.write(bytes(-file.tell() % _PAGE))
        file.write(part)


def _unpacked(content: memoryview) -> tuple[Batches, list[tuple[str, tuple[int, int] | None]]]:
    at = len(_MAGIC)
    if bytes(content[:at]) != _MAGIC:
        raise ValueError("it does not begin as one")
    known, start = bytes(content[at : at + 32]), at + 32
    size, count = struct.unpack_from("<2Q", content, start)
    at = start + 16 + 8 * count + size
    # Unpickling what is damaged may end anywhere.
    if at > len(content) or hashlib.sha256(content[start:at]).digest() != known:
        raise ValueError("it is damaged")
    sizes, head = struct.unpack_from(f"<{count}Q", content, start + 16), content[at - size : at]
    buffers = []
    for length in sizes:
        at += -at % _PAGE
        if at + length > len(content):
            raise ValueError("its end is missing")
        buffers.append(content[at : at + length])
        at += length
    value: tuple[Batches, list[tuple[str, tuple[int, int] | None]]] = pickle.loads(head, buffers=buffers)
    return value


def _folders(files: Sequence[Path]) -> set[Path]:
    """Returns the folders beside the files, where what was missing would turn up: a folder changes when a file is put into it."""
    above = {file.parent.parent for file in files}
    found = {file.parent for file in files} | above
    for folder in above:
        for pattern in ("*", "*/*"):
            found.update(path for path in folder.glob(pattern) if path.is_dir())
    return found


def _mark(file: Path) -> tuple[int, int] | None:
    """Returns size and time of change of a file, or None where it is gone."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_size, found.st_mtime_ns


def _code_digest() -> str:
    """Returns a digest of the code that reads meshes and cuts them: another version of it may make something else of them."""
    package = Path(__file__).parent.parent
    folders = ("geometry", "description", "formats", "scenes", "render/batching", "render/lod")
    files = [file for folder in folders for file in sorted((package / folder).glob("*.py"))]
    files.append(package / "render" / "culling" / "closed_solids.py")
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()
