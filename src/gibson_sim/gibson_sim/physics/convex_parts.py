"""Convex decomposition of a concave mesh with V-HACD, which is part of PyBullet and uses OBJ files."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import PhysicsError
from gibson_sim.physics.engine import pybullet, quiet
from gibson_sim.physics.engine_files import objects_of_obj, to_obj

_VOXELS = 50_000
"""Resolution of V-HACD, voxels per mesh."""


def convex_parts(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64]
) -> list[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Returns an approximate convex decomposition of a mesh by V-HACD, each part as vertices (V, 3) and triangles (F, 3).

    Args:
        vertices: (V, 3).
        triangles: (F, 3).

    Raises:
        PhysicsError: V-HACD returns no parts.
    """
    with tempfile.TemporaryDirectory(prefix="gibson_sim_parts_") as folder:
        whole, parts = Path(folder, "whole.obj"), Path(folder, "parts.obj")
        whole.write_text(to_obj(vertices, triangles), encoding="ascii")
        with quiet():
            pybullet.vhacd(str(whole), str(parts), str(Path(folder, "log.txt")), resolution=_VOXELS)
        out = objects_of_obj(parts.read_bytes()) if parts.is_file() else []
    if not out:
        raise PhysicsError(f"V-HACD returns no convex parts of a mesh with {len(triangles)} triangles; is it flat or empty?")
    return out
