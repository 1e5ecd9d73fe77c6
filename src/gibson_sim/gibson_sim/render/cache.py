"""Caches the geometry of loaded scenes, so that the next start does not build it again.

Each scene has one file: a pickle of the ``SceneGeometry`` with out-of-band arrays, page-aligned, which are memory-mapped and never
copied. The file name is a hash of the visuals and of the code that builds geometry; meshes and textures are compared by size and
modification time. Unpickling can execute code from the file, so a file that another user owns or can write is not read.
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
"""Minimum number of triangles of a cached scene: smaller scenes load as fast without the cache."""
LIMIT_BYTES = 8 * 2**30
"""Maximum size of the folder, bytes; the least recently used files are deleted first."""


def default_folder() -> Path:
    """Returns the scene cache in the user's cache folder."""
    return cache_folder("scenes")


class SceneCache:
    """A folder of cached scene geometry. After a failure the scene is loaded from its own files.

    Args:
        folder: created when first needed.
        limit_bytes: maximum size of the folder, see ``LIMIT_BYTES``.
    """

    def __init__(self, folder: Path, limit_bytes: int = LIMIT_BYTES) -> None:
        self._folder, self._limit = folder, limit_bytes
        self._distrusted = False

    def path(
        self,
        visuals: Sequence[VisualSpec],
        links: Sequence[str],
        labels: Sequence[tuple[int, int]],
        levels_of_detail: bool,
        roots: Sequence[Path] = (),
    ) -> Path:
        """Returns the path of a scene's file; ``roots`` are the folders that its files may lie in, for the rest see ``build_geometry``."""
        digest = hashlib.sha256(_MAGIC)
        used = {visual.link for visual in visuals}
        # Links after the last drawn one, such as those of views, do not affect the geometry.
        count = max((number + 1 for number, link in enumerate(links) if link in used), default=0)
        for part in (
            __version__,
            _code_digest(),
            simplifier() is not None,
            levels_of_detail,
            sorted(map(str, roots)),
            tuple(links)[:count],
            tuple(labels),
            *visuals,
        ):
            digest.update(repr(part).encode() + b"\0")
        return self._folder / f"{digest.hexdigest()[:32]}.scene"

    def load(self, path: Path) -> SceneGeometry | None:
        """Returns the geometry in a file, with read-only arrays, or None if the file does not exist, is unsafe, damaged or outdated."""
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
            geometry, files = _unpack(memoryview(content))
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
            os.utime(path)  # marks it as recently used
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
            _log.warning("the loaded scene cannot be cached in %s (%s); the next start will load it again", path.parent, error)
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)

    def _distrust(self, reason: str) -> None:
        """Logs the reason why the cache is not used, once."""
        if not self._distrusted:
            self._distrusted = True
            _log.warning("%s: the scene cache is not used; remove it, or set XDG_CACHE_HOME to a folder of your own", reason)

    def _trim(self) -> None:
        """Deletes the least recently used files until the folder is below the limit."""
        files = sorted(self._folder.glob("*.scene"), key=lambda file: file.stat().st_mtime, reverse=True)
        total = 0
        for file in files:
            total += file.stat().st_size
            if total > self._limit and file != files[0]:
                file.unlink(missing_ok=True)


def _unsafe(folder: Path) -> str:
    """Returns the reason not to trust files in the cache, by owner and mode of its folder and the parent folder, or "" if they are safe."""
    for checked in (folder, folder.parent):
        try:
            status = checked.stat()
        except FileNotFoundError:
            continue
        # The sticky bit, as on /tmp, keeps other users from replacing the folder.
        if checked != folder and status.st_mode & stat.S_ISVTX:
            continue
        if reason := _others_may_write(status):
            return f"{checked} {reason}"
    return ""


def _others_may_write(status: os.stat_result) -> str:
    """Returns the reason why other users could have written a file or folder, or "" if they could not."""
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


def _unpack(content: memoryview) -> tuple[SceneGeometry, list[tuple[str, tuple[int, int] | None]]]:
    offset = len(_MAGIC)
    if bytes(content[:offset]) != _MAGIC:
        raise ValueError("its header is wrong")
    checksum, start = bytes(content[offset : offset + 32]), offset + 32
    size, count = struct.unpack_from("<2Q", content, start)
    offset = start + 16 + 8 * count + size
    # Unpickling damaged data could execute arbitrary code.
    if offset > len(content) or hashlib.sha256(content[start:offset]).digest() != checksum:
        raise ValueError("it is damaged")
    sizes, head = struct.unpack_from(f"<{count}Q", content, start + 16), content[offset - size : offset]
    buffers = []
    for length in sizes:
        offset += -offset % _PAGE
        if offset + length > len(content):
            raise ValueError("it is truncated")
        buffers.append(content[offset : offset + length])
        offset += length
    value: tuple[SceneGeometry, list[tuple[str, tuple[int, int] | None]]] = pickle.loads(head, buffers=buffers)
    return value


def _folders(files: Sequence[Path]) -> set[Path]:
    """Returns the folders in which missing files could appear; adding a file changes a folder's modification time."""
    parents = {file.parent.parent for file in files}
    folders = {file.parent for file in files} | parents
    for folder in parents:
        for pattern in ("*", "*/*"):
            folders.update(path for path in folder.glob(pattern) if path.is_dir())
    return folders


def _file_state(file: Path) -> tuple[int, int] | None:
    """Returns size in bytes and modification time in ns of a file, or None if it does not exist."""
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns


def _code_digest() -> str:
    """Returns a digest of the code that builds geometry: another version may build other geometry."""
    package = Path(__file__).parent.parent
    folders = ("geometry", "description", "formats", "scenes", "render/batching", "render/lod")
    files = [file for folder in folders for file in sorted((package / folder).glob("*.py"))]
    files.append(package / "render" / "culling" / "closed_surfaces.py")
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()
