"""Lists worlds, and loads one for a client, with a code for each kind of failure. Must not import ROS."""

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
from gibson_sim.reading import MAX_TEXT_BYTES, exists, is_file, yaml_texts
from gibson_sim.resources import find_scene, known_scenes
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.load import description_file, finish, is_sdf_world, read_scene, reader_and_root
from gibson_sim.scenes.scene_yaml import DESCRIPTION
from gibson_sim.scenes.sdf.elements import parse_sdf
from gibson_sim.scenes.sdf.world import place_world
from gibson_sim.scenes.sources import MAX_BYTES, TEXT_FOLDER, Search, check_file, path_of, walk, without_text_folder
from gibson_sim.scenes.spec import SceneSpec

_log = logging.getLogger(__name__)
_DIRECTIVES = (".dmd.yaml", ".dmd.yml")
_MODEL_FILES = ("model.config", "model.sdf", "robot.yaml", "package.xml")
"""Files of a model or a package of models: as in a folder with a URDF, the meshes beside them are not worlds."""
_HEAD_BYTES = 8 * 1024
"""Maximum size of the beginning of a scene.yaml that is read for its name and description, bytes."""
_MAX_NAME, _MAX_DESCRIPTION = 200, 500
"""Maximum length of a listed name and description, characters."""
_TEXT = TEXT_FOLDER / "resource_string"


class WorldFailure(Enum):
    """Reasons why a world cannot be loaded; the names are those of ``simulation_interfaces/LoadWorld``."""

    UNSUPPORTED_FORMAT = auto()
    NO_RESOURCE = auto()
    RESOURCE_PARSE_ERROR = auto()
    MISSING_ASSETS = auto()
    UNSUPPORTED_ASSETS = auto()
    UNSUPPORTED_ELEMENTS = auto()


_PUBLIC = {
    WorldFailure.UNSUPPORTED_FORMAT: "is not a world; give a scene.yaml, an SDF world, a .dmd.yaml or a mesh",
    WorldFailure.NO_RESOURCE: "does not exist, may not be read, or does not hold exactly one world",
    WorldFailure.RESOURCE_PARSE_ERROR: "is invalid",
    WorldFailure.MISSING_ASSETS: "names files that do not exist",
    WorldFailure.UNSUPPORTED_ASSETS: "names meshes, textures or splats that cannot be used",
    WorldFailure.UNSUPPORTED_ELEMENTS: "has elements that are not simulated",
}
"""Message for clients that may not see the file, unless the error has a public message."""


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
    """Argument of ``load_world``: the name of a built-in scene, or a ``file://`` URI."""
    description: str = ""
    tags: tuple[str, ...] = ()
    """Format: scene.yaml, sdf, drake or mesh."""


def find_worlds(sources: Sequence[str], *, continue_on_error: bool = False) -> tuple[WorldEntry, ...]:
    """Returns the built-in scenes, sorted by name, then the worlds below ``sources``, sorted by path.

    A mesh is a world if neither its folder nor the parents of that folder contain a description.

    Args:
        sources: folders, or single files: paths, ``file://``, ``package://`` or ``model://``.
        continue_on_error: whether a source that does not exist is left out, with a warning in the log.

    Raises:
        WorldError: one of the sources does not exist.
    """
    return (*built_in_worlds(), *worlds_below(sources, continue_on_error=continue_on_error))


def built_in_worlds() -> tuple[WorldEntry, ...]:
    """Returns the built-in scenes, sorted by name."""
    return tuple(_world(path / DESCRIPTION, name) for name, path in sorted(known_scenes().items()))


def find_world(uri: str) -> WorldEntry | None:
    """Returns the entry of the world at a URI, without loading it; None if the URI resolves to several worlds, or none.

    Raises:
        SceneNotFoundError: the URI does not resolve to a file.
    """
    built_in = known_scenes().get(uri)
    if built_in is not None:
        return _world(built_in / DESCRIPTION, uri)
    files = _below(uri.strip())
    return _world(files[0]) if len(files) == 1 else None


def absolute_uri(name_or_path: str) -> str:
    """Returns the name of a built-in scene unchanged, and the absolute path of any other: a client has another current folder."""
    path = Path(name_or_path).expanduser()
    return name_or_path if name_or_path in known_scenes() or not exists(path) else str(path.absolute())


def worlds_below(
    sources: Sequence[str], *, continue_on_error: bool = False, search: Search | None = None
) -> tuple[WorldEntry, ...]:
    """Returns the worlds below ``sources``, sorted by path.

    Args:
        sources: as for ``find_worlds``.
        continue_on_error: as for ``find_worlds``.
        search: budget of the search; None = a new one.

    Raises:
        WorldError: one of the sources does not exist.
    """
    entries: dict[Path, WorldEntry] = {}
    search = Search() if search is None else search
    for source in sources:
        try:
            entries.update((path, _world(path, search=search)) for path in _below(source.strip(), search))
        except SceneNotFoundError as e:
            if not continue_on_error:
                raise WorldError(WorldFailure.NO_RESOURCE, str(e)).with_public(str(e)) from e
            _log.warning("%s; left out", e)
    return tuple(entries[path] for path in sorted(entries))


def load_world(uri: str, text: str, *, fail_on_unsupported: bool = False, ignore_missing: bool = False) -> SceneSpec:
    """Returns a world as a scene without robots.

    Args:
        uri: name of a scene, a path, ``file://``, ``package://`` or ``model://``; takes precedence over ``text``.
        text: an SDF world, used if ``uri`` is empty. Its models and meshes come from ``$GIBSON_SIM_PATH`` and the model paths of Gazebo.
        fail_on_unsupported: whether an element that is not simulated is an error; else it is left out.
        ignore_missing: whether models, meshes and textures that are missing or cannot be read are left out; else they are errors.
            Files that a ``scene.yaml`` names must exist in any case.

    Raises:
        WorldError: the world cannot be loaded.
    """
    try:
        builder = _read_text(text) if not uri.strip() else _read_uri(uri.strip())
    except WorldError:
        raise
    except SceneError as e:
        code = _code_of(e)
        raise WorldError(code, str(e)).with_public(f"{_PUBLIC[code]}: {e.public}" if e.public else _PUBLIC[code]) from e
    errors: dict[WorldFailure, OmissionKind] = {}
    if not ignore_missing:
        errors[WorldFailure.MISSING_ASSETS] = OmissionKind.MISSING_ASSET
        errors[WorldFailure.UNSUPPORTED_ASSETS] = OmissionKind.UNSUPPORTED_ASSET
    if fail_on_unsupported:
        errors[WorldFailure.UNSUPPORTED_ELEMENTS] = OmissionKind.UNSUPPORTED_ELEMENT
    for code, kind in errors.items():
        lines = [line.removesuffix("; left out") for line in builder.warnings if line.kind is kind]
        if lines:
            raise WorldError(code, f"{builder.name}: {'; '.join(lines)}")
    if builder.splats is not None:
        # Physics does not need the splats, but the renderer would fail after the service has reported success.
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
        path = path_of(uri)
        if path is None or exists(path):
            path = find_scene(uri if path is None else path)
        else:
            raise SceneNotFoundError(f"{uri}: {path} does not exist")
        file = description_file(path)
    except SceneNotFoundError as e:
        raise WorldError(WorldFailure.NO_RESOURCE, str(e)) from e
    try:
        reader_and_root(file, path)
        check_file(file, MAX_BYTES if file.suffix.lower() in MESH_SUFFIXES else MAX_TEXT_BYTES)
    except SceneError as e:
        raise WorldError(WorldFailure.UNSUPPORTED_FORMAT, str(e)) from e
    return read_scene(path, file, max_bytes=MAX_BYTES)


def _read_text(text: str) -> SceneBuilder:
    if not text.strip():
        raise WorldError(WorldFailure.NO_RESOURCE, "neither a uri nor a resource_string is given; give one of them")
    if not text.lstrip().startswith("<"):
        raise WorldError(WorldFailure.UNSUPPORTED_FORMAT, f"{_TEXT}: is not XML; give an SDF world, or a file by its uri")
    data = text.strip().encode("utf-8", errors="replace")
    if len(data) > MAX_TEXT_BYTES:
        reason = f"has {len(data)} bytes, must be at most {MAX_TEXT_BYTES}"
        raise WorldError(WorldFailure.UNSUPPORTED_FORMAT, f"{_TEXT}: {reason}")
    try:
        root = parse_sdf(data)
    except TextError as e:
        raise WorldError(WorldFailure.RESOURCE_PARSE_ERROR, f"{_TEXT}: {e}").with_public(str(e)) from e
    world = root.find("world") if root.tag in ("sdf", "gazebo") else None
    if world is None:
        raise WorldError(WorldFailure.UNSUPPORTED_FORMAT, f"{_TEXT}: holds no <world>; give an <sdf> with a <world>")
    builder = SceneBuilder(world.get("name", "").strip() or "world", TEXT_FOLDER, environment=True, max_bytes=MAX_BYTES)
    builder.add_text(text)
    place_world(builder, root, _TEXT)
    return builder


def _code_of(error: BaseException) -> WorldFailure:
    """Returns the failure code for an error of a reader: a missing file, an invalid mesh, else an invalid description."""
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
        raise SceneNotFoundError(f"source {quoted(source)}: {path} does not exist; give a folder")
    if is_file(path):
        return [path] if _tag(path) else []
    worlds_found: list[Path] = []
    # Folders with a description: meshes in and below them belong to it.
    with_description: set[Path] = set()
    for folder, folders, files in walk(path, search):
        if DESCRIPTION in files:
            worlds_found.append(folder / DESCRIPTION)
            folders.clear()
            continue
        worlds = [folder / name for name in files if _tag(folder / name) in ("sdf", "drake")]
        worlds_found += worlds
        is_model = "urdf" in folders or any(name in _MODEL_FILES or name.endswith((".urdf", ".xacro")) for name in files)
        if worlds or is_model or folder.parent in with_description:
            with_description.add(folder)
        else:
            worlds_found += [folder / name for name in files if _tag(folder / name) == "mesh"]
    return worlds_found


def _tag(path: Path) -> str:
    """Returns the format of a world file, "" if it is not a world."""
    name = path.name.lower()
    if name == DESCRIPTION:
        return DESCRIPTION
    if name.endswith(_DIRECTIVES):
        return "drake"
    if name.endswith(MESH_SUFFIXES):
        return "mesh"
    return "sdf" if name.endswith((".sdf", ".world")) and is_file(path) and is_sdf_world(path) else ""


def _world(file: Path, name: str = "", *, search: Search | None = None) -> WorldEntry:
    """Returns the entry of a world without loading it; ``name``: name of a built-in scene, "" for other worlds."""
    search = Search() if search is None else search
    tag = _tag(file)
    uri = name or file.absolute().as_uri()
    if tag != DESCRIPTION:
        return WorldEntry(file.name.split(".")[0], uri, f"{tag} file", (tag,))
    try:
        texts = yaml_texts(search.head(file, _HEAD_BYTES), ("name", "description"), cut=True)
    except (OSError, TextError):
        # Loading the world will report the error.
        texts = {}
    description = clipped(texts.get("description", ""), _MAX_DESCRIPTION)
    return WorldEntry(name or clipped(texts.get("name", ""), _MAX_NAME) or file.parent.name, uri, description, (tag,))
