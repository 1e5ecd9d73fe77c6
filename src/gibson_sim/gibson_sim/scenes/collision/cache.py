"""A cache of simplified collision geometry on disk, with one folder for each mesh.

The name of a folder is a digest of everything that decides its content: the triangles, the parameters and the code.
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
"""Size of the cache, from which the least recently used folders are deleted first."""
RECORD = "made.json"
"""File in every folder of the cache with a JSON object about its meshes."""


def default_folder() -> Path:
    """Returns the folder of the user's cache."""
    return cache_folder("collision")


def digest_of(vertices: NDArray[np.float64], triangles: NDArray[np.int64], *what: object) -> str:
    """Returns the name of a folder of the cache.

    Args:
        vertices: (V, 3), metres.
        triangles: (F, 3), rows of ``vertices``.
        what: parameters of the geometry; their ``repr`` counts.
    """
    total = hashlib.sha256(repr((__version__, *what)).encode())
    package = Path(gibson_sim.__file__).parent
    for source in (*sorted((package / "scenes" / "collision").glob("*.py")), package / "geometry" / "triangle_meshes.py"):
        total.update(source.read_bytes())
    for array in (np.asarray(vertices, dtype=np.float64), np.asarray(triangles, dtype=np.int64)):
        total.update(repr(array.shape).encode())
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()[:32]


def kept_or_made(folder: Path, digest: str, make: Callable[[Path], dict[str, object]]) -> tuple[Path, dict[str, object]]:
    """Returns a folder of the cache and its record; calls ``make`` if the cache does not have it.

    Args:
        folder: folder of the cache; created if necessary.
        digest: ``digest_of`` the geometry.
        make: writes files into an empty folder and returns the record.

    Raises:
        SceneError: the cache cannot be written.
    """
    place = folder / digest
    known = _read(place)
    if known is not None:
        return place, known
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        half = Path(tempfile.mkdtemp(dir=folder))
        try:
            record = make(half)
            (half / RECORD).write_text(json.dumps(record), encoding="utf-8")
            # Renaming is atomic, so that a folder of this name is always complete.
            if place.exists() and _read(place) is None:
                shutil.rmtree(place)
            half.rename(place)
        except OSError:
            if _read(place) is None:  # else another process was faster
                raise
        finally:
            shutil.rmtree(half, ignore_errors=True)
    except OSError as error:
        raise SceneError(
            f"simplified collision geometry cannot be kept in {folder} ({error}); make room there, or set XDG_CACHE_HOME"
        ) from error
    _trim(folder, place)
    return place, record


def _read(place: Path) -> dict[str, object] | None:
    """Returns the record of a folder and marks the folder as used; None if it does not exist or cannot be used."""
    try:
        record = json.loads((place / RECORD).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        _log.warning("%s cannot be used (%s); it is made again", place, error)
        return None
    try:
        os.utime(place)
    except OSError as error:
        _log.debug("%s: %s", place, error)
    return record if isinstance(record, dict) else None


def _trim(folder: Path, used: Path) -> None:
    """Deletes the least recently used folders but ``used`` until the rest is below the limit."""
    total = 0
    for place in sorted((p for p in folder.iterdir() if p.is_dir()), key=lambda p: p.stat().st_mtime, reverse=True):
        total += sum(file.stat().st_size for file in place.iterdir())
        if total > LIMIT_BYTES and place != used:
            shutil.rmtree(place, ignore_errors=True)
