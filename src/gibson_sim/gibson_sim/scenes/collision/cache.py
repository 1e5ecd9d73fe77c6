"""Keeps simplified collision geometry on disk, so that the next start does not make it again. One folder for each mesh.

What decides the result is in the folder's name: the triangles, what was asked for, and the code that made it.
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
"""The cache is kept below this: what was unused for longest goes first."""
RECORD = "made.json"
"""What every folder of the cache holds beside its meshes: a JSON object."""


def default_folder() -> Path:
    """Returns the folder of the user's own cache."""
    return cache_folder("collision")


def digest_of(vertices: NDArray[np.float64], triangles: NDArray[np.int64], *what: object) -> str:
    """Returns the name of the folder for a mesh (V, 3), (F, 3), and what is to be made of it."""
    total = hashlib.sha256(repr((__version__, *what)).encode())
    package = Path(gibson_sim.__file__).parent
    for source in (*sorted((package / "scenes" / "collision").glob("*.py")), package / "geometry" / "triangle_meshes.py"):
        total.update(source.read_bytes())
    for array in (np.asarray(vertices, dtype=np.float64), np.asarray(triangles, dtype=np.int64)):
        total.update(repr(array.shape).encode())
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()[:32]


def kept_or_made(folder: Path, digest: str, make: Callable[[Path], dict[str, object]]) -> tuple[Path, dict[str, object]]:
    """Returns a folder of the cache and its record, which ``make`` has written into it, now or earlier.

    Args:
        folder: of the cache; made when first needed.
        digest: ``digest_of`` what is made.
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
            # Last, and at once: where this folder is, all of it is whole.
            if place.exists() and _read(place) is None:
                shutil.rmtree(place)
            half.rename(place)
        except OSError:
            if _read(place) is None:  # else another process was quicker
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
    """Returns the record of a folder that can be used, which is now the one used last; else None."""
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
    """Deletes what was unused for longest until the rest is below the limit."""
    total = 0
    for place in sorted((p for p in folder.iterdir() if p.is_dir()), key=lambda p: p.stat().st_mtime, reverse=True):
        total += sum(file.stat().st_size for file in place.iterdir())
        if total > LIMIT_BYTES and place != used:
            shutil.rmtree(place, ignore_errors=True)
