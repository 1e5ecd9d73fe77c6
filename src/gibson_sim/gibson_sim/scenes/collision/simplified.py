"""Cached simplified collision shapes of a scan, for ``collision: simplified`` in a scene."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.description.shapes import Shape
from gibson_sim.scenes.collision.cache import default_folder, digest_of, get_or_create
from gibson_sim.scenes.collision.planes import THICKNESS
from gibson_sim.scenes.collision.scan import MAX_ERROR, simplify_scan
from gibson_sim.types import Pose

_log = logging.getLogger(__name__)
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


def scan_shapes(
    vertices: ArrayLike, triangles: ArrayLike, name: str, *, folder: Path | None = None, max_error: float = MAX_ERROR
) -> tuple[tuple[Shape, Pose], ...]:
    """Returns the simplified collision shapes of a scan, each with T_world_shape; computed once and cached.

    Args:
        vertices: (V, 3), world metres, z up.
        triangles: (F, 3), rows of ``vertices``.
        name: name of the scan for the log.
        folder: folder of the cache; None = ``default_folder()``.
        max_error: maximum distance between the scan and the shapes, metres.

    Raises:
        MeshError: the scan has no triangles.
        SceneError: the cache cannot be written.
    """
    points, corners = np.asarray(vertices, dtype=np.float64), np.asarray(triangles, dtype=np.int64)

    def make(place: Path) -> dict[str, object]:
        simplified = simplify_scan(points, corners, max_error)
        meshes = [(simplified.vertices, simplified.triangles)] if len(simplified.triangles) else []
        write_meshes(place, meshes)
        slabs = [[*slab.low, *slab.high, slab.top] for slab in simplified.slabs]
        return {"what": str(simplified), "meshes": len(meshes), "slabs": slabs}

    place, record = get_or_create(folder or default_folder(), digest_of(points, corners, "scan", max_error), make)
    _log.info("%s collides as %s", name, record["what"])
    shapes = [(_mesh(path), Pose()) for path in mesh_files(place, record)]
    slabs = record["slabs"]
    assert isinstance(slabs, list)
    for x, y, right, far, top in slabs:
        center = ((x + right) / 2, (y + far) / 2, top - THICKNESS / 2)
        shapes.append((Shape("box", (right - x, far - y, THICKNESS)), Pose(center)))
    return tuple(shapes)


def write_meshes(place: Path, meshes: Sequence[tuple[F64, I64]]) -> None:
    """Writes meshes, pairs of vertices (V, 3), metres, and triangles (F, 3), as OBJ files to a folder of the cache."""
    for number, (points, corners) in enumerate(meshes):
        with (place / f"part_{number}.obj").open("w", encoding="ascii") as file:
            np.savetxt(file, points, fmt="v %.6f %.6f %.6f")
            np.savetxt(file, corners + 1, fmt="f %d %d %d")


def mesh_files(place: Path, record: dict[str, object]) -> list[Path]:
    """Returns the OBJ files in a folder of the cache; ``record`` contains their number."""
    count = record["meshes"]
    assert isinstance(count, int)
    return [place / f"part_{number}.obj" for number in range(count)]


def _mesh(path: Path) -> Shape:
    return Shape("mesh", (1.0, 1.0, 1.0), str(path.resolve()))
