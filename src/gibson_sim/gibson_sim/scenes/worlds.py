"""Lists worlds, and loads one for a client with a code for every failure. Knows no ROS."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.errors import MeshError, SceneError, SceneNotFoundError, TextError
from gibson_sim.formats.load_mesh import MESH_SUFFIXES
from gibson_sim.formats.splats import load_splats
from gibson_sim.quoting import clipped, quoted
from gibson_sim.reading import MAX_TEXT_BYTES, exists, is_file, parse_xml, yaml_texts
from gibson_sim.resources import find_scene, known_scenes
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.load import DESCRIPTION, description_file, finish, is_sdf_world, read_scene, reader_and_root
from gibson_sim.scenes.sdf.world import place_world
from gibson_sim.scenes.sources import MAX_BYTES, TEXT_FOLDER, Search, check_file, path_of, walk, without_text_folder
from gibson_sim.scenes.spec import SceneSpec

_log = logging.getLogger(__name__)
_DIRECTIVES = (".dmd.yaml", ".dmd.yml")
_MODEL_FILES = ("model.config", "model.sdf", "robot.yaml", "package.xml")
"""A folder with one of these, or with a URDF, is a model or a package of models: its meshes are no worlds."""
_HEAD_BYTES = 8 * 1024
"""Bytes of a scene.yaml that are read for a list: name and description are at the beginning."""
_MAX_NAME, _MAX_DESCRIPTION = 200, 500
"""Characters of a listed name and description."""
_TEXT = TEXT_FOLDER / "resource_string"


class WorldFailure(Enum):
    """Reasons for which a world cannot be loaded; the names are those of ``simulation_interfaces/LoadWorld``."""

    UNSUPPORTED_FORMAT = auto()
    NO_RESOURCE = auto()
    RESOURCE_PARSE_ERROR = auto()
    MISSING_ASSETS = auto()
    UNSUPPORTED_ASSETS = auto()
    UNSUPPORTED_ELEMENTS = auto()


_PUBLIC = {
    WorldFailure.UNSUPPORTED_FORMAT: "is no world; give a scene.yaml, an SDF world, a .dmd.yaml or a mesh",
    WorldFailure.NO_RESOURCE: "is not there, may not be read, or holds not exactly one world",
    WorldFailure.RESOURCE_PARSE_ERROR: "holds a mistake",
    WorldFailure.MISSING_ASSETS: "names files that are not there",
    WorldFailure.UNSUPPORTED_ASSETS: "names meshes, textures or splats that cannot be used",
    WorldFailure.UNSUPPORTED_ELEMENTS: "has elements that are not simulated",
}
"""Message for clients that may not see the file, unless the error has a public text of its own."""


class WorldError(SceneError):
    """A world cannot be loaded, or worlds cannot be listed; one line."""

    def __init__(self, code: WorldFailure, message: str) -> None:
        super().__init__(without_text_folder(message))
        self.code = code
        self.public = _PUBLIC[code]


@dataclass(frozen=True, slots=True)
class WorldEntry:
    """A world that can be loaded."""

    name: str
    uri: str
    """Argument of ``load_world``: the name of a built-in scene, or ``file://``."""
    description: str = ""
    tags: tuple[str, ...] = ()
    """Its format: scene.yaml, sdf, drake or mesh."""


def find_worlds(sources: Sequence[str], *, continue_on_error: bool = False) -> tuple[WorldEntry, ...]:
    """Returns the built-in scenes by name, then the worlds below ``sources`` by path.

    A mesh is a world if neither its folder nor those above hold a description.

    Args:
        sources: folders, or single files: paths, ``file://``, ``package://`` or ``model://``.
        continue_on_error: whether a source that does not exist is left out, with a warning in the log.

    Raises:
        WorldError: one of the sources does not exist.
    """
    return (*own_worlds(), *worlds_below(sources, continue_on_error=continue_on_error))


def own_worlds() -> tuple[WorldEntry, ...]:
    """Returns the built-in scenes, by name."""
    return tuple(_world(path / DESCRIPTION, name) for name, path in sorted(known_scenes().items()))


def world_of(uri: str) -> WorldEntry | None:
    """Returns the entry of the world that a URI stands for, without loading it; None if it stands for several worlds, or none.

    Raises:
        SceneNotFoundError: the URI stands for no file.
    """
    built_in = known_scenes().get(uri)
    if built_in is not None:
        return _world(built_in / DESCRIPTION, uri)
    files = _below(uri.strip())
    return _world(files[0]) if len(files) == 1 else None


def worlds_below(
    sources: Sequence[str], *, continue_on_error: bool = False, search: Search | None = None
) -> tuple[WorldEntry, ...]:
    """Returns the worlds below ``sources``, by path.

    Args:
        sources: as for ``find_worlds``.
        continue_on_error: as for ``find_worlds``.
        search: limits of the search; None = limits of its own.

    Raises:
        WorldError: one of the sources does not exist.
    """
    found: dict[Path, WorldEntry] = {}
    search = Search() if search is None else search
    for source in sources:
        try:
            found.update((path, _world(path, search=search)) for path in _below(source.strip(), search))
        except SceneNotFoundError as e:
            if not continue_on_error:
                raise WorldError(WorldFailure.NO_RESOURCE, str(e)).telling(str(e)) from e
            _log.warning("%s; left out", e)
    return tuple(found[path] for path in sorted(found))


def load_world(uri: str, text: str, *, fail_on_unsupported: bool = False, ignore_missing: bool = False) -> SceneSpec:
    """Returns a world as a scene without robots.

    Args:
        uri: name of a scene, path, ``file://``, ``package://`` or ``model://``; takes precedence over ``text``.
        text: an SDF world, for an empty ``uri``. Its models and meshes come from ``$GIBSON_SIM_PATH`` and the model paths of Gazebo.
        fail_on_unsupported: whether an element that is not simulated is an error; otherwise it is left out.
        ignore_missing: whether models, meshes and textures that are missing or cannot be read are left out; otherwise they are an error.
            Files that a ``scene.yaml`` names must always exist.

    Raises:
        WorldError: the world cannot be loaded.
    """
    try:
        builder = _read_text(text) if not uri.strip() else _read_uri(uri.strip())
    except WorldError:
        raise
    except SceneError as e:
        code = _code_of(e)
        raise WorldError(code, str(e)).telling(f"{_PUBLIC[code]}: {e.public}" if e.public else _PUBLIC[code]) from e
    fatal: dict[WorldFailure, OmissionKind] = {}
    if not ignore_missing:
        fatal[WorldFailure.MISSING_ASSETS] = OmissionKind.MISSING_ASSET
        fatal[WorldFailure.UNSUPPORTED_ASSETS] = OmissionKind.UNSUPPORTED_ASSET
    if fail_on_unsupported:
        fatal[WorldFailure.UNSUPPORTED_ELEMENTS] = OmissionKind.UNSUPPORTED_ELEMENT
    for code, kind in fatal.items():
        found = [line.removesuffix("; left out") for line in builder.warnings if line.kind is kind]
        if found:
            raise WorldError(code, f"{builder.name}: {'; '.join(found)}")
    if builder.splats is not None:
        # Physics does not need them, but whoever draws the world would fail after the client was told that it is loaded.
        try:
            load_splats(Path(builder.splats.file))
        except MeshError as e:
            raise WorldError(WorldFailure.UNSUPPORTED_ASSETS, str(e)) from e
    try:
        return finish(builder)
    except SceneError as e:
        raise WorldError(WorldFailure.RESOURCE_PARSE_ERROR, str(e)) from e


def _read_uri(uri: str) -> SceneBuilder:
    try:
        given = path_of(uri)
        if given is None or exists(given):
            given = find_scene(uri if given is None else given)
        else:
            raise SceneNotFoundError(f"{uri}: there is nothing at {given}")
        file = description_file(given)
    except SceneNotFoundError as e:
        raise WorldError(WorldFailure.NO_RESOURCE, str(e)) from e
    try:
        reader_and_root(file, given)
        check_file(file, MAX_BYTES if file.suffix.lower() in MESH_SUFFIXES else MAX_TEXT_BYTES)
    except SceneError as e:
        raise WorldError(WorldFailure.UNSUPPORTED_FORMAT, str(e)) from e
    return read_scene(given, file)


def _read_text(text: str) -> SceneBuilder:
    if not text.strip():
        raise WorldError(WorldFailure.NO_RESOURCE, "neither a uri nor a resource_string is given; give one of them")
    if not text.lstrip().startswith("<"):
        raise WorldError(WorldFailure.UNSUPPORTED_FORMAT, f"{_TEXT}: is no XML; give an SDF world, or a file by its uri")
    data = text.strip().encode("utf-8", errors="replace")
    if len(data) > MAX_TEXT_BYTES:
        reason = f"has {len(data)} bytes, must be at most {MAX_TEXT_BYTES}"
        raise WorldError(WorldFailure.UNSUPPORTED_FORMAT, f"{_TEXT}: {reason}")
    try:
        root = parse_xml(data)
    except TextError as e:
        raise WorldError(WorldFailure.RESOURCE_PARSE_ERROR, f"{_TEXT}: {e}").telling(str(e)) from e
    world = root.find("world") if root.tag in ("sdf", "gazebo") else None
    if world is None:
        raise WorldError(WorldFailure.UNSUPPORTED_FORMAT, f"{_TEXT}: holds no <world>; give <sdf> with a <world> in it")
    builder = SceneBuilder(world.get("name", "").strip() or "world", TEXT_FOLDER, environment=True)
    builder.add_text(text)
    place_world(builder, root, _TEXT)
    return builder


def _code_of(error: BaseException) -> WorldFailure:
    """Returns the failure for an error of a reader: a missing file, a broken mesh, else an invalid description."""
    chain: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None:
        chain.append(cause)
        cause = cause.__cause__
    if any(isinstance(e, FileNotFoundError) for e in chain):
        return WorldFailure.MISSING_ASSETS
    if any(isinstance(e, MeshError) for e in chain[1:]):
        return WorldFailure.UNSUPPORTED_ASSETS
    return WorldFailure.RESOURCE_PARSE_ERROR


def _below(source: str, search: Search | None = None) -> list[Path]:
    """Returns the files of the worlds below a source."""
    path = path_of(source) or Path(source).absolute()
    if not source or not exists(path):
        raise SceneNotFoundError(f"source {quoted(source)}: there is nothing at {path}; give a folder")
    if is_file(path):
        return [path] if _tag(path) else []
    found: list[Path] = []
    # Folders with a description, to which their meshes, and those below, belong.
    with_description: set[Path] = set()
    for folder, folders, files in walk(path, search):
        if DESCRIPTION in files:
            found.append(folder / DESCRIPTION)
            folders.clear()
            continue
        worlds = [folder / name for name in files if _tag(folder / name) in ("sdf", "drake")]
        found += worlds
        described = "urdf" in folders or any(name in _MODEL_FILES or name.endswith((".urdf", ".xacro")) for name in files)
        if worlds or described or folder.parent in with_description:
            with_description.add(folder)
        else:
            found += [folder / name for name in files if _tag(folder / name) == "mesh"]
    return found


def _tag(path: Path) -> str:
    """Returns the format of a world's file, "" if it is no world."""
    name = path.name.lower()
    if name == DESCRIPTION:
        return DESCRIPTION
    if name.endswith(_DIRECTIVES):
        return "drake"
    if name.endswith(MESH_SUFFIXES):
        return "mesh"
    return "sdf" if name.endswith((".sdf", ".world")) and is_file(path) and is_sdf_world(path) else ""


def _world(file: Path, name: str = "", *, search: Search | None = None) -> WorldEntry:
    """Returns the entry of a world without loading it; ``name``: the name of a built-in scene, "" = another world."""
    search = Search() if search is None else search
    tag = _tag(file)
    uri = name or file.absolute().as_uri()
    if tag != DESCRIPTION:
        return WorldEntry(file.name.split(".")[0], uri, f"{tag} file", (tag,))
    try:
        texts = yaml_texts(search.head(file, _HEAD_BYTES), ("name", "description"), cut=True)
    except (OSError, TextError):
        # Loading the world reports the error.
        texts = {}
    description = clipped(texts.get("description", ""), _MAX_DESCRIPTION)
    return WorldEntry(name or clipped(texts.get("name", ""), _MAX_NAME) or file.parent.name, uri, description, (tag,))
