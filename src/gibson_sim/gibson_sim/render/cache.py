"""Caches the geometry of loaded scenes, so that the next start does not build it again.

One file for each scene: a pickle of the ``SceneGeometry`` with its arrays outside it, page-aligned, so that they are mapped into memory and
never copied. The file's name is a hash of what is drawn and of the code that reads and cuts it; the meshes and textures that were
read are compared by size and time of change. Unpickling can run code from the file: a file that another user owns or may write is not
read.
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
from gibson_sim.render.batching.scene_geometry import SceneGeometry
from gibson_sim.render.lod.clusters import simplifier
from gibson_sim.resources import cache_folder

_log = logging.getLogger(__name__)
_MAGIC = b"gibson-sim scene 3\n"
_PAGE = 4096
SMALLEST = 20_000
"""Least number of triangles of a cached scene: smaller scenes load as fast without the cache."""
LIMIT_BYTES = 8 * 2**30
"""Largest size of the folder: the least recently used files are deleted first."""


def default_folder() -> Path:
    """Returns the folder in the user's cache."""
    return cache_folder("scenes")


class SceneCache:
    """A folder of loaded scenes. A failure costs time, never the scene.

    Args:
        folder: made when first needed.
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
        """Returns the file of a scene; ``roots`` are the folders that its files may lie in, the other arguments those of ``build_geometry``."""
        digest = hashlib.sha256(_MAGIC)
        used = {visual.link for visual in visuals}
        # Links after the last one that is drawn, such as those of views, change nothing.
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

    def load(self, path: Path) -> SceneGeometry | None:
        """Returns the geometry in a file, or None if there is none or it is outdated. Its arrays cannot be written to."""
        try:
            reason = _unsafe(self._folder)
            descriptor = -1 if reason else os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
            if descriptor >= 0 and (reason := _others_may_write(os.fstat(descriptor))):
                os.close(descriptor)
                reason = f"{path} {reason}"
            if reason:
                self._distrust(reason)
                return None
            with open(descriptor, "rb") as file:
                content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            geometry, files = _unpacked(memoryview(content))
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
            _log.warning("%s is not a usable cached scene (%s); the scene is loaded from its files", path, error)
            return None
        if [_file_state(Path(name)) for name, _ in files] != [state for _, state in files]:
            return None
        try:
            os.utime(path)  # recently used
        except OSError as error:
            _log.debug("%s: %s", path, error)
        return geometry

    def store(self, path: Path, geometry: SceneGeometry) -> None:
        """Writes a geometry to a file for ``load``, unless it is small."""
        if geometry.triangles < SMALLEST:
            return
        read = [*geometry.files, *(_folders(geometry.files) if geometry.warnings else ())]
        files = [(str(file), _file_state(file)) for file in read]
        temporary = path.with_suffix(f".{os.getpid()}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            if reason := _unsafe(self._folder):
                self._distrust(reason)
                return
            temporary.unlink(missing_ok=True)
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
            with open(os.open(temporary, flags, 0o600), "wb") as file:
                _pack(file, (geometry, files))
            temporary.replace(path)
            self._trim()
        except OSError as error:
            _log.warning("the loaded scene cannot be kept in %s (%s); the next start will load it again", path.parent, error)
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)

    def _distrust(self, reason: str) -> None:
        """Warns, once, why the cache is not used."""
        if not self._distrusted:
            self._distrusted = True
            _log.warning(
                "%s: the cache of loaded scenes is not used; remove it, or set XDG_CACHE_HOME to a folder of your own", reason
            )

    def _trim(self) -> None:
        """Deletes the least recently used files until the rest is below the limit."""
        files = sorted(self._folder.glob("*.scene"), key=lambda file: file.stat().st_mtime, reverse=True)
        total = 0
        for file in files:
            total += file.stat().st_size
            if total > self._limit and file != files[0]:
                file.unlink(missing_ok=True)


def _unsafe(folder: Path) -> str:
    """Returns why files in the cache cannot be trusted, by the owner and mode of its folder and the one above, or "" if they can."""
    for place in (folder, folder.parent):
        try:
            status = place.stat()
        except FileNotFoundError:
            continue
        # The sticky bit, as on /tmp, keeps other users from replacing the folder.
        if place != folder and status.st_mode & stat.S_ISVTX:
            continue
        if reason := _others_may_write(status):
            return f"{place} {reason}"
    return ""


def _others_may_write(status: os.stat_result) -> str:
    """Returns why other users could have written a file or folder, or "" if they could not."""
    if status.st_uid not in (0, os.geteuid()):  # root is trusted
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


def _unpacked(content: memoryview) -> tuple[SceneGeometry, list[tuple[str, tuple[int, int] | None]]]:
    at = len(_MAGIC)
    if bytes(content[:at]) != _MAGIC:
        raise ValueError("its header is wrong")
    known, start = bytes(content[at : at + 32]), at + 32
    size, count = struct.unpack_from("<2Q", content, start)
    at = start + 16 + 8 * count + size
    # Unpickling damaged data could do anything.
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
    value: tuple[SceneGeometry, list[tuple[str, tuple[int, int] | None]]] = pickle.loads(head, buffers=buffers)
    return value


def _folders(files: Sequence[Path]) -> set[Path]:
    """Returns the folders in which missing files could appear: a folder's time of change is updated when a file is added."""
    above = {file.parent.parent for file in files}
    found = {file.parent for file in files} | above
    for folder in above:
        for pattern in ("*", "*/*"):
            found.update(path for path in folder.glob(pattern) if path.is_dir())
    return found


def _file_state(file: Path) -> tuple[int, int] | None:
    """Returns size and time of change of a file, or None if it is gone."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_size, found.st_mtime_ns


def _code_digest() -> str:
    """Returns a digest of the code that builds geometry: another version may build it differently."""
    package = Path(__file__).parent.parent
    folders = ("geometry", "description", "formats", "scenes", "render/batching", "render/lod")
    files = [file for folder in folders for file in sorted((package / folder).glob("*.py"))]
    files.append(package / "render" / "culling" / "closed_surfaces.py")
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()
