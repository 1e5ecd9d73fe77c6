"""Lists resources that can be spawned: built-in robots and objects, and models in other folders. Does not read meshes."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gibson_sim.errors import RobotError, SceneNotFoundError, TextError
from gibson_sim.formats.load_mesh import MESH_SUFFIXES
from gibson_sim.quoting import clipped, quoted
from gibson_sim.reading import exists, is_file, is_folder, parse_xml, read_head
from gibson_sim.resources import list_robots, share_folders
from gibson_sim.robots.load import ROBOT_FILE, load_robot
from gibson_sim.scenes.sources import Search, path_of, walk
from gibson_sim.types import Vec3

_log = logging.getLogger(__name__)
_ASSET_FOLDERS = ("mesh", "meshes", "materials", "textures")
_HEAD_BYTES = 65536
"""Maximum size of the beginning of an SDF file that is searched for a model, bytes."""
_MAX_CONFIG_BYTES = 65536
"""Maximum size of the beginning of a model.config that is read for its description, bytes."""
_MAX_DESCRIPTION = 500
"""Maximum length of a description, characters."""


@dataclass(frozen=True, slots=True)
class Spawnable:
    """A resource that can be spawned."""

    uri: str
    """A built-in name, or a ``file://`` URI."""
    description: str = ""
    bounds: tuple[Vec3, Vec3] | None = None
    """Lower and upper corner of the bounding box in the frame of its root, metres; None = unknown without reading its meshes."""


def built_in_spawnables(only: str = "") -> dict[str, Path]:
    """Returns the folder or file of each built-in robot and object, by name; ``only`` limits the result to one name."""
    entries: dict[str, Path] = {}
    for share in share_folders():
        for folder in (share / "config" / "robots", share / "robots", share / "scenes" / "objects", share / "objects"):
            for entry in sorted(folder.iterdir()) if is_folder(folder) else ():
                if only and only not in (entry.name, entry.stem):
                    continue
                if not entry.name.startswith((".", "_")) and _kind(entry):
                    entries.setdefault(entry.stem if is_file(entry) else entry.name, entry)
    return dict(sorted(entries.items())) if not only else {name: path for name, path in entries.items() if name == only}


def list_objects() -> list[str]:
    """Returns the names of the built-in objects for ``spawn``, in alphabetical order, without robots."""
    return sorted(set(built_in_spawnables()) - set(list_robots()))


def find_spawnables(sources: Sequence[str]) -> tuple[Spawnable, ...]:
    """Returns the built-in robots and objects, sorted by name, then those below ``sources``, sorted by path.

    Args:
        sources: folders, or single files: paths, ``file://``, ``package://`` or ``model://``.

    Raises:
        SceneNotFoundError: one of the sources does not exist.
    """
    built_in = tuple(Spawnable(name, _description(path), _robot_bounds(path)) for name, path in built_in_spawnables().items())
    return (*built_in, *spawnables_below(sources))


def spawnables_below(sources: Sequence[str], search: Search | None = None) -> tuple[Spawnable, ...]:
    """Returns the robots and models below ``sources``, sorted by path.

    Args:
        sources: as for ``find_spawnables``.
        search: budget of the search; None = a new one.

    Raises:
        SceneNotFoundError: one of the sources does not exist.
    """
    spawnables: dict[Path, Spawnable] = {}
    search = Search() if search is None else search
    for source in sources:
        path = path_of(source.strip()) or Path(source.strip()).absolute()
        if not source.strip() or not exists(path):
            raise SceneNotFoundError(f"source {quoted(source)}: {path} does not exist; give a folder")
        for entry in _below(path, search):
            spawnables[entry] = Spawnable(entry.absolute().as_uri(), _description(entry, search))
    return tuple(spawnables[path] for path in sorted(spawnables))


def _below(path: Path, search: Search) -> list[Path]:
    """Returns the spawnable resources below a path: folders of models and robots, and meshes that do not belong to a description."""
    if _kind(path):
        return [path]
    resources: list[Path] = []
    # Folders with a description: meshes in and below them belong to it.
    with_description: set[Path] = set()
    for folder, folders, files in walk(path, search):
        if folder != path and _kind(folder):
            resources.append(folder)
            folders.clear()
            continue
        folders[:] = [name for name in folders if name.lower() not in _ASSET_FOLDERS]
        entries = [folder / name for name in files if _kind(folder / name)]
        descriptions = [entry for entry in entries if entry.suffix.lower() not in MESH_SUFFIXES]
        if descriptions or folder.parent in with_description:
            with_description.add(folder)
            entries = descriptions
        resources += entries
    return resources


def _kind(path: Path) -> str:
    """Returns the kind of a file or a folder as text, "" if it cannot be spawned."""
    suffix = path.suffix.lower()
    if is_folder(path):
        if is_file(path / ROBOT_FILE):
            return "robot"
        if is_file(path / "model.config") or is_file(path / "model.sdf"):
            return "SDF model"
        # A folder named after the file in it: chair/chair.urdf.
        return next((f"{s[1:].upper()} file" for s in (".urdf", ".sdf", *MESH_SUFFIXES) if is_file(path / (path.name + s))), "")
    if path.name == ROBOT_FILE:
        return "robot"
    if suffix == ".sdf":
        return "SDF model" if _holds_model(path) else ""
    return f"{suffix[1:].upper()} file" if suffix in (".urdf", *MESH_SUFFIXES) and is_file(path) else ""


def _holds_model(path: Path) -> bool:
    """Returns whether an SDF file has a model and no world."""
    if not is_file(path):  # reading a pipe would block
        return False
    try:
        head = read_head(path, _HEAD_BYTES)
    except OSError:
        return False
    return b"<model" in head and b"<world" not in head


def _description(path: Path, search: Search | None = None) -> str:
    """Returns a one-line description of a file or folder: that in its model.config, else its kind."""
    search = Search() if search is None else search
    config = path / "model.config"
    if is_file(config):
        try:
            text = clipped(parse_xml(search.head(config, _MAX_CONFIG_BYTES)).findtext("description") or "", _MAX_DESCRIPTION)
        except (OSError, TextError):
            text = ""
        if text:
            return text
    return _kind(path)


def _robot_bounds(path: Path) -> tuple[Vec3, Vec3] | None:
    """Returns the bounding box of a robot from its radius and height, in its base frame, metres; None if the path is not a robot."""
    if not is_file(path / ROBOT_FILE):
        return None
    try:
        robot = load_robot(path / ROBOT_FILE, log=False)
    except RobotError as e:
        _log.warning("%s", e)
        return None
    return (-robot.radius, -robot.radius, 0.0), (robot.radius, robot.radius, robot.height)
