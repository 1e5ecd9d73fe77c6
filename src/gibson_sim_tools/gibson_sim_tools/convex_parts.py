"""Splits an object's mesh into convex parts for the collision shapes of its URDF, cached for the user."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import MeshError
from gibson_sim.scenes.collision.cache import default_folder, digest_of, get_or_create
from gibson_sim.scenes.collision.scan import mesh_files, write_meshes

_log = logging.getLogger(__name__)
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Parts = list[tuple[F64, I64]]
Decompose = Callable[[F64, I64], Parts]

_FAITHFUL = 0.05
"""CoACD's threshold: largest concavity of a part, relative to the size of the mesh."""
_MOST_PARTS = 32


def convex_parts(
    vertices: ArrayLike, triangles: ArrayLike, name: str, *, folder: Path | None = None, otherwise: Decompose | None = None
) -> tuple[Path, ...]:
    """Returns OBJ files with the convex parts of a mesh, in its own frame; made once and kept in the user's cache.

    CoACD makes them: Wei et al., "Approximate convex decomposition for 3D meshes with collision-aware concavity and tree search",
    SIGGRAPH 2022. It is the optional extra "collision".

    Args:
        vertices: (V, 3).
        triangles: (F, 3).
        name: of the mesh, for messages.
        folder: of the cache; None = ``default_folder()``.
        otherwise: makes the parts where CoACD is not installed.

    Raises:
        MeshError: CoACD is not installed and there is no ``otherwise``, or the mesh has no triangles.
        SceneError: the cache cannot be written.
    """
    points, corners = np.asarray(vertices, dtype=np.float64), np.asarray(triangles, dtype=np.int64)
    if not len(corners):
        raise MeshError(f"{name}: has no triangles; there is nothing to cut into convex parts")
    decompose = _coacd() or otherwise
    if decompose is None:
        raise MeshError(f"{name}: convex parts are made by CoACD, which is not installed; pip install coacd")
    maker: Decompose = decompose

    def make(place: Path) -> dict[str, object]:
        parts = maker(points, corners)
        write_meshes(place, parts)
        return {"meshes": len(parts)}

    digest = digest_of(points, corners, "convex", _coacd() is not None, _FAITHFUL, _MOST_PARTS)
    place, record = get_or_create(folder or default_folder(), digest, make)
    _log.info("%s collides as %s convex parts", name, record["meshes"])
    return tuple(mesh_files(place, record))


def _coacd() -> Decompose | None:
    try:
        import coacd
    except ImportError:
        return None

    def decompose(vertices: F64, triangles: I64) -> Parts:
        coacd.set_log_level("error")
        mesh = coacd.Mesh(vertices, triangles)
        parts = coacd.run_coacd(mesh, threshold=_FAITHFUL, max_convex_hull=_MOST_PARTS, seed=0)
        return [(np.asarray(points, dtype=np.float64), np.asarray(corners, dtype=np.int64)) for points, corners in parts]

    return decompose
