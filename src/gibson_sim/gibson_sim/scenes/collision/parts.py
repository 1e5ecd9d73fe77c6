"""From meshes to the shapes that stand for them in physics: what ``collision: simplified`` means, and the convex parts of objects."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import MeshError
from gibson_sim.robots.spec import Shape
from gibson_sim.scenes.collision.cache import default_folder, digest_of, kept_or_made
from gibson_sim.scenes.collision.planes import THICKNESS
from gibson_sim.scenes.collision.scan import MAX_ERROR, simplify_scan
from gibson_sim.types import Pose

_log = logging.getLogger(__name__)
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Parts = list[tuple[F64, I64]]
Decompose = Callable[[F64, I64], Parts]

_FAITHFUL = 0.05
"""CoACD's threshold: how concave a part may remain, as a part of the size of the whole."""
_MOST_PARTS = 32


def scan_shapes(
    vertices: ArrayLike, triangles: ArrayLike, name: str, *, folder: Path | None = None, max_error: float = MAX_ERROR
) -> tuple[tuple[Shape, Pose], ...]:
    """Returns the shapes, with T_world_shape, that stand for a scan in physics; made once and kept in the user's cache.

    Args:
        vertices: (V, 3), world frame, metres, z up.
        triangles: (F, 3).
        name: of the scan, for the log.
        folder: of the cache; None = ``default_folder()``.
        max_error: metres between the scan and what stands for it.

    Raises:
        MeshError: there is nothing to simplify.
        SceneError: the cache cannot be written.
    """
    points, corners = np.asarray(vertices, dtype=np.float64), np.asarray(triangles, dtype=np.int64)

    def make(place: Path) -> dict[str, object]:
        made = simplify_scan(points, corners, max_error)
        meshes = [(made.vertices, made.triangles)] if len(made.triangles) else []
        _write(place, meshes)
        slabs = [[*slab.low, *slab.high, slab.top] for slab in made.slabs]
        return {"what": str(made), "meshes": len(meshes), "slabs": slabs}

    place, record = kept_or_made(folder or default_folder(), digest_of(points, corners, "scan", max_error), make)
    _log.info("%s collides as %s", name, record["what"])
    shapes = [(_mesh(path), Pose()) for path in _files(place, record)]
    slabs = record["slabs"]
    assert isinstance(slabs, list)
    for x, y, right, far, top in slabs:
        middle = ((x + right) / 2, (y + far) / 2, top - THICKNESS / 2)
        shapes.append((Shape("box", (right - x, far - y, THICKNESS)), Pose(middle)))
    return tuple(shapes)


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
        _write(place, parts)
        return {"meshes": len(parts)}

    digest = digest_of(points, corners, "convex", _coacd() is not None, _FAITHFUL, _MOST_PARTS)
    place, record = kept_or_made(folder or default_folder(), digest, make)
    _log.info("%s collides as %s convex parts", name, record["meshes"])
    return tuple(_files(place, record))


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


def _write(place: Path, meshes: Sequence[tuple[F64, I64]]) -> None:
    for number, (points, corners) in enumerate(meshes):
        with (place / f"part_{number}.obj").open("w", encoding="ascii") as file:
            np.savetxt(file, points, fmt="v %.6f %.6f %.6f")
            np.savetxt(file, corners + 1, fmt="f %d %d %d")


def _files(place: Path, record: dict[str, object]) -> list[Path]:
    count = record["meshes"]
    assert isinstance(count, int)
    return [place / f"part_{number}.obj" for number in range(count)]


def _mesh(path: Path) -> Shape:
    return Shape("mesh", (1.0, 1.0, 1.0), str(path.resolve()))
