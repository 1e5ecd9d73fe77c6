"""Loads robots and measures the meshes of their wheels and bodies; ``robots.load`` itself reads no meshes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.robots import load
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.types import Pose

_MAX_BYTES = 64_000_000
"""Maximum size of a mesh file that is measured, bytes."""


def load_robot(
    path_or_name: Path | str, *, name: str = "robot", start: Pose | None = None, find: Callable[[str], Path] | None = None
) -> RobotSpec:
    """Returns a robot; arguments and errors are those of ``robots.load.load_robot``."""
    return load.load_robot(path_or_name, name=name, start=start, find=find, points=mesh_points())


def mesh_points() -> Callable[[Path], NDArray[np.float64]]:
    """Returns a function that maps the path of a mesh file to its vertices (N, 3), metres, and reads each file once."""
    loader = MeshLoader(None, textures=False, max_bytes=_MAX_BYTES)
    return lambda path: loader.mesh(path).merged()[0]
