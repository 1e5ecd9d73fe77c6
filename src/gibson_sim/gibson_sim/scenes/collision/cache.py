"""A cache of simplified collision geometry on disk, with one folder for each mesh.

The name of a folder is a digest of its inputs: the triangles, the parameters and the code.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import gibson_sim
from gibson_sim import __version__
from gibson_sim.errors import SceneError
from gibson_sim.resources import cache_folder

_log = logging.getLogger(__name__)
LIMIT_BYTES = 2 * 2**30
"""Maximum size of the cache, bytes; the least recently used folders are deleted first."""
RECORD = "made.json"
"""File in each folder of the cache with a JSON object about its meshes."""


def default_folder() -> Path:
    """Returns the folder of the user's cache."""
    return cache_folder("collision")


def digest_of(vertices: NDArray[np.float64], triangles: NDArray[np.int64], *parameters: object) -> str:
    """Returns the name of a folder of the cache.

    Args:
        vertices: (V, 3), metres.
        triangles: (F, 3), rows of ``vertices``.
        parameters: parameters of the geometry, hashed by their ``repr``.
    """
    total = hashlib.sha256(repr((__version__, *parameters)).encode())
    package = Path(gibson_sim.__file__).parent
    for source in (*sorted((package / "scenes" / "collision").glob("*.py")), package / "geometry" / "triangle_meshes.py"):
        total.update(source.read_bytes())
    for array in (np.asarray(vertices, dtype=np.float64), np.asarray(triangles, dtype=np.int64)):
        total.update(repr(array.shape).encode())
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()[:32]


def get_or_create(folder: Path, digest: str, make: Callable[[Path], dict[str, object]]) -> tuple[Path, dict[str, object]]:
    """Returns a folder of the cache and its record; calls ``make`` on a cache miss.

    Args:
        folder: folder of the cache; created if necessary.
        digest: ``digest_of`` the geometry.
        make: writes files into an empty folder and returns the record.

    Raises:
        SceneError: the cache cannot be written.
    """
    place = folder / digest
    cached = _read(place)
    if cached is not None:
        return place, cached
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        draft = Path(tempfile.mkdtemp(dir=folder))
        try:
            record = make(draft)
            (draft / RECORD).write_text(json.dumps(record), encoding="utf-8")
            # Renaming is atomic, so that a folder of this name is always complete.
            if place.exists() and _read(place) is None:
                shutil.rmtree(place)
            draft.rename(place)
        except OSError:
            if _read(place) is None:  # else another process has created it
                raise
        finally:
            shutil.rmtree(draft, ignore_errors=True)
    except OSError as error:
        raise SceneError(
            f"simplified collision geometry cannot be cached in {folder} ({error}); free disk space, or set XDG_CACHE_HOME"
        ) from error
    _trim(folder, place)
    return place, record


def _read(place: Path) -> dict[str, object] | None:
    """Returns the record of a folder and marks the folder as recently used; None if it does not exist or is invalid."""
    try:
        record = json.loads((place / RECORD).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        _log.warning("%s cannot be used (%s); it is computed again", place, error)
        return None
    try:
        os.utime(place)
    except OSError as error:
        _log.debug("%s: %s", place, error)
    return record if isinstance(record, dict) else None


def _trim(folder: Path, used: Path) -> None:
    """Deletes the least recently used folders except ``used`` until the cache is within the limit."""
    total = 0
    for place in sorted((p for p in folder.iterdir() if p.is_dir()), key=lambda p: p.stat().st_mtime, reverse=True):
        total += sum(file.stat().st_size for file in place.iterdir())
        if total > LIMIT_BYTES and place != used:
            shutil.rmtree(place, ignore_errors=True)
