"""Resolves the mesh files that a robot's description names. Pure."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from gibson_sim.description.packages import package_folders
from gibson_sim.description.shapes import Shape
from gibson_sim.geometry.transforms import TO_Z_UP, UpAxis, matrix_from_pose, pose_from_matrix
from gibson_sim.reading import is_file
from gibson_sim.types import Pose

PACKAGE_SCHEME = "package://"
_FILE_SCHEME = "file://"
_UP_AXIS = re.compile(rb"<up_axis>\s*([XYZ])_UP")
_HEAD_BYTES = 65536
"""Size of the begin of a COLLADA file, which has its ``<asset>``, bytes."""
_LEVELS_UP = 3
"""Maximum number of folders above that of a URDF in which relative names are looked up."""


def without_up_axis(shape: Shape, pose: Pose) -> tuple[Shape, Pose]:
    """Returns a shape of a URDF and its pose in the link such that the ``<up_axis>`` of a COLLADA file has no effect.

    RViz, Gazebo and MoveIt ignore it, and descriptions rely on that; loaders turn such a mesh so that z is up.
    """
    if not shape.mesh.lower().endswith(".dae"):
        return shape, pose
    try:
        up_axis = _up_axis(shape.mesh, os.stat(shape.mesh).st_mtime_ns)
    except OSError:  # whoever reads the mesh reports it
        return shape, pose
    if up_axis == "z":
        return shape, pose
    rotation = TO_Z_UP[up_axis]
    matrix = matrix_from_pose(pose)
    matrix[:3, :3] = matrix[:3, :3] @ rotation.T
    x, y, z = np.diag(rotation @ np.diag(shape.size) @ rotation.T).tolist()
    return replace(shape, size=(x, y, z)), pose_from_matrix(matrix)


@lru_cache(maxsize=1024)
def _up_axis(path: str, changed_ns: int) -> UpAxis:
    """Returns the up axis of a COLLADA file, y if it names none; ``changed_ns``: time of its change, a key of the cache only."""
    with open(path, "rb") as file:
        match = _UP_AXIS.search(file.read(_HEAD_BYTES))
    axes: dict[bytes, UpAxis] = {b"X": "x", b"Z": "z"}
    return "y" if match is None else axes.get(match[1], "y")


def resolve_mesh(name: str, urdf: Path) -> Path | None:
    """Returns the absolute path of the mesh that a URDF names, or None if the file does not exist.

    ``package://<package>/<rest>`` is looked up in the folders of ``package_folders``; other names are relative to the URDF's
    folder, or to one of the three above it.
    """
    if name.startswith(_FILE_SCHEME):
        name = unquote(name[len(_FILE_SCHEME) :])
    if not name.startswith(PACKAGE_SCHEME):
        above = [folder for folder in urdf.parents[1 : _LEVELS_UP + 1] if folder != folder.parent]
        paths = (Path(os.path.normpath(folder / name)) for folder in (urdf.parent, *above))
        return next((path for path in paths if is_file(path)), None)
    package, _, rest = name[len(PACKAGE_SCHEME) :].partition("/")
    return next((folder / rest for folder in package_folders(package, urdf) if is_file(folder / rest)), None)
