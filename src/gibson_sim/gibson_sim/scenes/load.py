"""Loads scenes from a ``scene.yaml``, an SDF world, Drake model directives, or a single mesh."""

from __future__ import annotations

import dataclasses
import logging
import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from gibson_sim.description.omissions import OmissionKind, grouped, kind_of
from gibson_sim.errors import SceneError, SceneNotFoundError
from gibson_sim.formats.load_mesh import MESH_SUFFIXES
from gibson_sim.formats.uris import ancestors
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_file, is_folder, read_head
from gibson_sim.resources import find_scene
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.drake_directives import read_drake_directives
from gibson_sim.scenes.scene_yaml import DESCRIPTION, read_scene_yaml
from gibson_sim.scenes.sdf.world import read_sdf_world
from gibson_sim.scenes.spec import SceneSpec

_log = logging.getLogger(__name__)
_WORLD_TAG = re.compile(rb"<world[\s>]")
_HEAD_BYTES = 64 * 1024
"""Maximum size of the beginning of an SDF file that is searched for ``<world>``, bytes."""
_MAX_LISTED = 8
"""Maximum number of files that an error message names."""
_MAX_ENTRIES = 50_000
"""Maximum number of files of a folder that are searched for worlds."""


def load_scene(name_or_path: str | Path, *, sdf_lamps: bool = False) -> SceneSpec:
    """Returns a scene without robots; its ``warnings`` name all elements that could not be used.

    Args:
        name_or_path: name of an installed scene; a folder with a scene.yaml, or with exactly one world; or a file: scene.yaml,
            SDF world, Drake model directives, glTF, GLB, OBJ, DAE, STL or PLY.
        sdf_lamps: whether the point and spot lights of an SDF world are loaded; False = they count as ambient light.

    Raises:
        SceneNotFoundError: the file or folder does not exist, or holds no readable scene.
        SceneError: the description or a mesh is invalid.
    """
    given = find_scene(name_or_path)
    return finish(read_scene(given, description_file(given), sdf_lamps=sdf_lamps))


def read_scene(given: Path, file: Path, *, sdf_lamps: bool = False, max_bytes: int | None = None) -> SceneBuilder:
    """Returns a builder with all elements of a scene's description.

    Args:
        given: file or folder that the user named.
        file: its description (``description_file``).
        sdf_lamps: as for ``load_scene``.
        max_bytes: maximum size of a mesh file, bytes; None = unlimited.

    Raises:
        SceneNotFoundError: the format of the file is not supported.
        SceneError: the description or a mesh is invalid.
    """
    reader, root = reader_and_root(file, given)
    name = given.name if is_folder(given) else file.parent.name if file.name == DESCRIPTION else file.name.split(".")[0]
    builder = SceneBuilder(name, root, description=file, environment=reader is read_sdf_world, max_bytes=max_bytes)
    builder.sdf_lamps = sdf_lamps
    reader(builder, file)
    return builder


def finish(builder: SceneBuilder) -> SceneSpec:
    """Returns the scene of a builder, and logs its warnings.

    Raises:
        SceneError: the scene is empty.
    """
    scene = builder.finish()
    for warning in grouped(scene.warnings):
        _log.warning("scene %s: %s", scene.name, warning)
    missing = sum(kind_of(warning) is OmissionKind.MISSING_ASSET for warning in scene.warnings)
    if missing:
        rest = "; nothing but the ground is left" if scene.is_only_ground else ""
        _log.warning(
            "scene %s: %d models, meshes or textures are missing%s: the lines above say which", scene.name, missing, rest
        )
    _log.info("scene %s: %d visual, %d collision shapes", scene.name, len(scene.visuals), len(scene.collisions))
    return scene


def with_robots(scene: SceneSpec, robots: Iterable[RobotSpec]) -> SceneSpec:
    """Returns the scene with these robots added.

    Raises:
        SceneError: two robots have the same name.
    """
    all_robots = (*scene.robots, *robots)
    names = [robot.name for robot in all_robots]
    for name in names:
        if names.count(name) > 1:
            raise SceneError(f"scene {quoted(scene.name)}: robot name {quoted(name)} is used twice; names must be unique")
    return dataclasses.replace(scene, robots=all_robots)


def description_file(path: Path) -> Path:
    """Returns the file that describes a scene: the path itself, or the only world of the folder.

    Raises:
        SceneNotFoundError: the folder holds no world, or several.
    """
    if is_file(path):
        return path
    if is_file(path / DESCRIPTION):
        return path / DESCRIPTION
    files = [Path(folder) / name for folder, name in _walk(path)]
    worlds = [f for f in files if is_sdf_world(f) or f.name.endswith((".dmd.yaml", ".dmd.yml"))]
    meshes = [f for f in files if f.suffix.lower() in MESH_SUFFIXES]
    candidates = sorted(worlds) or sorted(meshes)
    if len(candidates) == 1:
        return candidates[0]
    if not candidates:
        raise SceneNotFoundError(
            f"{path}: holds no scene: no {DESCRIPTION}, SDF world, .dmd.yaml or mesh ({', '.join(MESH_SUFFIXES)})"
        )
    names = ", ".join(str(f.relative_to(path)) for f in candidates[:_MAX_LISTED])
    more = f" and {len(candidates) - _MAX_LISTED} more" if len(candidates) > _MAX_LISTED else ""
    raise SceneNotFoundError(
        f"{path}: holds {len(candidates)} {'worlds' if worlds else 'meshes'}, name one of them: {names}{more}"
    )


def _walk(path: Path) -> Iterable[tuple[str, str]]:
    """Yields (folder, name) of all files below a folder that are not hidden."""
    count = 0
    for folder, folders, names in os.walk(path):
        folders[:] = sorted(f for f in folders if not f.startswith("."))
        for name in names:
            count += 1
            if count > _MAX_ENTRIES:
                raise SceneNotFoundError(f"{path}: holds more than {_MAX_ENTRIES} files; name the world file itself")
            yield folder, name


def is_sdf_world(path: Path) -> bool:
    """Returns whether the file is an SDF world."""
    if path.suffix.lower() == ".world":
        return True
    if not is_file(path):
        return False
    try:
        return path.suffix.lower() == ".sdf" and _WORLD_TAG.search(read_head(path, _HEAD_BYTES)) is not None
    except OSError:
        return False


def reader_and_root(file: Path, given: Path) -> tuple[Callable[[SceneBuilder, Path], None], Path]:
    """Returns the reader of a description file, and the folder that all its files must lie in.

    Raises:
        SceneNotFoundError: the file is not a description of a scene.
    """
    suffix = file.suffix.lower()
    if file.name == DESCRIPTION:
        return read_scene_yaml, file.parent
    if suffix in (".world", ".sdf"):
        return read_sdf_world, _root(file, given)
    if file.name.lower().endswith((".dmd.yaml", ".dmd.yml")):
        return read_drake_directives, _root(file, given)
    if suffix in MESH_SUFFIXES:
        mesh_folder = given if is_folder(given) else file.parent
        return _read_mesh, mesh_folder.parent if mesh_folder.name.lower() in ("mesh", "meshes") else mesh_folder
    if suffix in (".yaml", ".yml"):
        return read_scene_yaml, file.parent
    raise SceneNotFoundError(
        f"{file}: is not a scene; give {DESCRIPTION}, an SDF world, a .dmd.yaml or a mesh ({', '.join(MESH_SUFFIXES)})"
    )


def _root(file: Path, given: Path) -> Path:
    """Returns the nearest folder at or above a path that contains a folder ``models``, since worlds are often beside it; else the path's folder."""
    start = given if is_folder(given) else file.parent
    return next((folder for folder in ancestors(start) if is_folder(folder / "models")), start)


def _read_mesh(builder: SceneBuilder, path: Path) -> None:
    """Adds a single mesh to the builder as visual and collision shape."""
    shape, matrix = builder.mesh_shape(path, np.eye(4), (1.0, 1.0, 1.0))
    builder.add_visual(path.stem, shape, matrix)
    builder.add_collision(path.stem, shape, matrix)
