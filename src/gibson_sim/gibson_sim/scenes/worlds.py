"""Which worlds there are, and loading one for a client who must be told exactly what is wrong with it. Knows no ROS."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.errors import MeshError, SceneError, SceneNotFoundError, TextError
from gibson_sim.formats.load_mesh import MESH_SUFFIXES
from gibson_sim.quoting import clipped, quoted
from gibson_sim.reading import MAX_TEXT_BYTES, exists, is_file, parse_xml, yaml_texts
from gibson_sim.resources import find_scene, known_scenes
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.load import DESCRIPTION, description_file, finish, is_sdf_world, read_scene, reader_and_root
from gibson_sim.scenes.sdf.world import place_world
from gibson_sim.scenes.sources import MAX_BYTES, NOWHERE, Search, check_file, path_of, said, walk
from gibson_sim.scenes.spec import SceneSpec

_log = logging.getLogger(__name__)
_DIRECTIVES = (".dmd.yaml", ".dmd.yml")
_MODEL_FILES = ("model.config", "model.sdf", "robot.yaml", "package.xml")
"""A folder with one of these, or with a URDF, is a model or a package of them: its meshes are no worlds."""
_HEAD_BYTES = 8 * 1024
"""Of a scene.yaml that is only listed: name and description stand at the beginning."""
_LONGEST_NAME, _LONGEST_DESCRIPTION = 200, 500
_TEXT = NOWHERE / "resource_string"


class WorldFailure(Enum):
    """Why no world can be loaded; the names are those of ``simulation_interfaces/LoadWorld``."""

    UNSUPPORTED_FORMAT = auto()
    NO_RESOURCE = auto()
    RESOURCE_PARSE_ERROR = auto()
    MISSING_ASSETS = auto()
    UNSUPPORTED_ASSETS = auto()
    UNSUPPORTED_ELEMENTS = auto()


_TOLD = {
    WorldFailure.UNSUPPORTED_FORMAT: "is no world; give a scene.yaml, an SDF world, a .dmd.yaml or a mesh",
    WorldFailure.NO_RESOURCE: "is not there, may not be read, or holds not exactly one world",
    WorldFailure.RESOURCE_PARSE_ERROR: "holds a mistake",
    WorldFailure.MISSING_ASSETS: "names files that are not there",
    WorldFailure.UNSUPPORTED_ASSETS: "names meshes or textures that cannot be used",
    WorldFailure.UNSUPPORTED_ELEMENTS: "has elements that are not simulated",
}
"""What a client is told who may not see the file, unless the error itself says more."""


class WorldError(SceneError):
    """A world cannot be loaded, or worlds cannot be listed; one line."""

    def __init__(self, code: WorldFailure, message: str) -> None:
        super().__init__(said(message))
        self.code = code
        self.public = _TOLD[code]


@dataclass(frozen=True, slots=True)
class World:
    """A world that can be loaded."""

    name: str
    uri: str
    """What ``load_world`` takes: a name of ours, or ``file://``."""
    description: str = ""
    tags: tuple[str, ...] = ()
    """What it is written in: scene.yaml, sdf, drake or mesh."""


def find_worlds(sources: Sequence[str], *, continue_on_error: bool = False) -> tuple[World, ...]:
    """Returns our scenes by name, then the worlds in ``sources`` by path. Meshes count where a folder and those above hold nothing else.

    Args:
        sources: folders, or single files: paths, ``file://``, ``package://`` or ``model://``.
        continue_on_error: leave out, with a warning in the log, a source that cannot be read.

    Raises:
        WorldError: one of the sources is not there.
    """
    return (*own_worlds(), *worlds_below(sources, continue_on_error=continue_on_error))


def own_worlds() -> tuple[World, ...]:
    """Returns our scenes, by name."""
    return tuple(_world(path / DESCRIPTION, name) for name, path in sorted(known_scenes().items()))


def world_of(uri: str) -> World | None:
    """Returns what is known of the world that a URI means, without loading it or looking at others; None where it means several, or none.

    Raises:
        SceneNotFoundError: there is nothing.
    """
    ours = known_scenes().get(uri)
    if ours is not None:
        return _world(ours / DESCRIPTION, uri)
    files = _below(uri.strip())
    return _world(files[0]) if len(files) == 1 else None


def worlds_below(sources: Sequence[str], *, continue_on_error: bool = False, search: Search | None = None) -> tuple[World, ...]:
    """Returns the worlds in ``sources`` alone, by path; for arguments and errors see ``find_worlds``; ``search``: as of ``walk``."""
    theirs: dict[Path, World] = {}
    search = Search() if search is None else search
    for source in sources:
        try:
            theirs.update((path, _world(path, search=search)) for path in _below(source.strip(), search))
        except SceneNotFoundError as e:
            if not continue_on_error:
                raise WorldError(WorldFailure.NO_RESOURCE, str(e)).telling(str(e)) from e
            _log.warning("%s; left out", e)
    return tuple(theirs[path] for path in sorted(theirs))


def load_world(uri: str, text: str, *, fail_on_unsupported: bool = False, ignore_missing: bool = False) -> SceneSpec:
    """Returns a world as a scene without robots.

    Args:
        uri: name of a scene, path, ``file://``, ``package://`` or ``model://``; wins over ``text``.
        text: an SDF world; used where ``uri`` is empty. Its models and meshes come from ``$GIBSON_SIM_PATH`` and the model paths of
            Gazebo: nothing lies beside a string.
        fail_on_unsupported: something in it that is not simulated is an error; otherwise it is left out.
        ignore_missing: models, meshes and textures that are missing or cannot be read are left out; otherwise they are an error. A
            ``scene.yaml`` is ours to get right: what it names must be there.

    Raises:
        WorldError: it cannot be loaded.
    """
    try:
        builder = _read_text(text) if not uri.strip() else _read_uri(uri.strip())
    except WorldError:
        raise
    except SceneError as e:
        code = _code_of(e)
        raise WorldError(code, str(e)).telling(f"{_TOLD[code]}: {e.public}" if e.public else _TOLD[code]) from e
    wanted: dict[WorldFailure, OmissionKind] = {}
    if not ignore_missing:
        wanted[WorldFailure.MISSING_ASSETS] = OmissionKind.MISSING_ASSET
        wanted[WorldFailure.UNSUPPORTED_ASSETS] = OmissionKind.UNSUPPORTED_ASSET
    if fail_on_unsupported:
        wanted[WorldFailure.UNSUPPORTED_ELEMENTS] = OmissionKind.UNSUPPORTED_ELEMENT
    for code, kind in wanted.items():
        found = [line.removesuffix("; left out") for line in builder.warnings if line.kind is kind]
        if found:
            raise WorldError(code, f"{builder.name}: {'; '.join(found)}")
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
    builder = SceneBuilder(world.get("name", "").strip() or "world", NOWHERE, environment=True)
    builder.add_text(text)
    place_world(builder, root, _TEXT)
    return builder


def _code_of(error: BaseException) -> WorldFailure:
    """Returns what an error of a reader means: a file that is missing, a mesh that is broken, else a mistake in the description."""
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
    """Returns the files of the worlds in a folder."""
    path = path_of(source) or Path(source).absolute()
    if not source or not exists(path):
        raise SceneNotFoundError(f"source {quoted(source)}: there is nothing at {path}; give a folder")
    if is_file(path):
        return [path] if _tag(path) else []
    found: list[Path] = []
    # Folders whose meshes, and those below, are parts of something else.
    taken: set[Path] = set()
    for folder, folders, files in walk(path, search):
        if DESCRIPTION in files:
            found.append(folder / DESCRIPTION)
            folders.clear()
            continue
        worlds = [folder / name for name in files if _tag(folder / name) in ("sdf", "drake")]
        found += worlds
        described = "urdf" in folders or any(name in _MODEL_FILES or name.endswith((".urdf", ".xacro")) for name in files)
        if worlds or described or folder.parent in taken:
            taken.add(folder)
        else:
            found += [folder / name for name in files if _tag(folder / name) == "mesh"]
    return found


def _tag(path: Path) -> str:
    """Returns what a file is written in, "" if it is no world."""
    name = path.name.lower()
    if name == DESCRIPTION:
        return DESCRIPTION
    if name.endswith(_DIRECTIVES):
        return "drake"
    if name.endswith(MESH_SUFFIXES):
        return "mesh"
    return "sdf" if name.endswith((".sdf", ".world")) and is_file(path) and is_sdf_world(path) else ""


def _world(file: Path, name: str = "", *, search: Search | None = None) -> World:
    """Returns what is known of a world without loading it; ``name``: of a scene of ours."""
    search = Search() if search is None else search
    tag = _tag(file)
    uri = name or file.absolute().as_uri()
    if tag != DESCRIPTION:
        return World(file.name.split(".")[0], uri, f"{tag} file", (tag,))
    try:
        texts = yaml_texts(search.head(file, _HEAD_BYTES), ("name", "description"), cut=True)
    except (OSError, TextError):
        # Whoever loads it is told what is wrong with it.
        texts = {}
    description = clipped(texts.get("description", ""), _LONGEST_DESCRIPTION)
    return World(name or clipped(texts.get("name", ""), _LONGEST_NAME) or file.parent.name, uri, description, (tag,))
