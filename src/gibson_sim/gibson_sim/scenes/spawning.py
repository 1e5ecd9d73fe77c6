"""Converts a resource, a URI or the text of a URDF or SDF model, to a BodySpec or a RobotSpec that physics can load.

Resources come from clients and are not trusted: every number is checked, every file must lie in an allowed folder, and a missing file is an
error that names it. A mesh becomes a rigid body with the mass and inertia of its convex hull at uniform density. Must import neither ROS nor a
physics engine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum, auto
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from gibson_sim.description.body import BodySpec
from gibson_sim.description.mesh_files import resolve_mesh
from gibson_sim.description.omissions import Omission, OmissionKind, kind_of
from gibson_sim.description.rigid_groups import MOVING_TYPES, rigid_groups
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfJoint, UrdfLink, UrdfModel, UrdfVisual, parse_urdf, read_urdf
from gibson_sim.description.xacro import is_xacro
from gibson_sim.errors import GibsonSimError, MeshError, RobotError, SceneError, SceneNotFoundError, TextError
from gibson_sim.formats.file_roots import description_roots, is_inside
from gibson_sim.formats.load_mesh import MESH_SUFFIXES, MeshLoader
from gibson_sim.formats.textured_shapes import with_textures
from gibson_sim.formats.uris import UriResolver, ancestors
from gibson_sim.quoting import quoted
from gibson_sim.reading import MAX_TEXT_BYTES, exists, is_file, is_folder, read_file
from gibson_sim.robots.load import ROBOT_FILE, load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.builder import FAR_AWAY, SceneBuilder, class_from_model
from gibson_sim.scenes.mass_properties import hull_solid
from gibson_sim.scenes.sdf.body import MAX_LINKS, SdfBodyReader
from gibson_sim.scenes.sdf.elements import parse_sdf, sdf_files, sdf_version
from gibson_sim.scenes.sdf.model import SdfModels
from gibson_sim.scenes.sdf.scopes import WORLD
from gibson_sim.scenes.sources import MAX_BYTES, TEXT_FOLDER, check_file, check_inside, path_of, without_text_folder
from gibson_sim.scenes.spawnables import Spawnable, built_in_spawnables, find_spawnables
from gibson_sim.settings import nearest
from gibson_sim.types import Pose

__all__ = [
    "SPAWN_FORMATS", "SpawnError", "SpawnFailure", "Spawnable", "built_in_spawnables", "find_spawnables", "load_spawnable", "spawn_name",
]  # fmt: skip
SPAWN_FORMATS: tuple[str, ...] = ("urdf", "sdf", "robot.yaml", *(suffix[1:] for suffix in MESH_SUFFIXES))
"""Formats that can be spawned, as in SimulatorFeatures.spawn_formats."""
MAX_PARTS = 2000
"""Maximum number of meshes in the nodes of a spawned glTF: each of them takes time."""
MAX_TRIANGLES, MAX_STATIC_TRIANGLES = 400_000, 150_000
"""Maximum number of triangles of all visuals of a body, which delay rendering, and of the collision shapes of a static body, which delay
physics."""
MAX_MASS = 1e6
"""Maximum mass of a link, kg."""
MAX_INERTIA = 1e9
"""Maximum moment of inertia of a link, kg m^2."""
_TEXT = TEXT_FOLDER / "resource_string"
_NO_RESOURCE = "neither a uri nor a resource_string is given; give one of them"
_ALLOWED = f"give a {ROBOT_FILE}, a URDF, an SDF model, a folder with one of these, or a mesh ({', '.join(MESH_SUFFIXES)})"
_HULL_DENSITY = 300.0
"""Density of the hull, kg/m^3; a typical value for furniture and vessels, which are hollow."""
_HULL_MASS_RANGE = (0.01, 100.0)
"""Minimum and maximum mass, kg."""
_HULL_FRICTION = 0.5
"""Coulomb friction coefficient."""
_HULL_LINK = "body"
"""Name of the only link."""


class SpawnFailure(Enum):
    """Reasons why a resource cannot be spawned; the names are those of ``simulation_interfaces/SpawnResult``."""

    UNSUPPORTED_FORMAT = auto()
    NO_RESOURCE = auto()
    RESOURCE_PARSE_ERROR = auto()
    MISSING_ASSETS = auto()
    UNSUPPORTED_ASSETS = auto()


_PUBLIC = {
    SpawnFailure.UNSUPPORTED_FORMAT: f"cannot be spawned; {_ALLOWED}",
    SpawnFailure.NO_RESOURCE: "does not exist, or may not be read",
    SpawnFailure.RESOURCE_PARSE_ERROR: "is invalid",
    SpawnFailure.MISSING_ASSETS: "names files that do not exist",
    SpawnFailure.UNSUPPORTED_ASSETS: "names meshes, textures or elements that cannot be used",
}
"""Message for clients that may not see the file, unless the error has a public message."""


class SpawnError(SceneError):
    """A resource cannot be spawned; one line."""

    def __init__(self, code: SpawnFailure, message: str) -> None:
        super().__init__(without_text_folder(message))
        self.code = code
        self.public = _PUBLIC[code]


def load_spawnable(uri: str, text: str, *, name: str, pose: Pose, roots: tuple[Path, ...] = ()) -> BodySpec | RobotSpec:
    """Returns the body or robot that a resource describes.

    Args:
        uri: a path, ``file://``, ``package://``, ``model://``, or the name of a built-in robot or object; takes precedence over ``text``.
        text: a URDF or an SDF model, used if ``uri`` is empty.
        name: name of the body; its links become ``<name>/<link>``.
        pose: T_world_root at load.
        roots: folders that all its files must lie in after following symbolic links; empty = anywhere. Built-in files are always allowed.

    Raises:
        SpawnError: the resource cannot be spawned.
    """
    if not uri.strip():
        return _text_body(text, name, pose, roots)
    path, roots = _resolve(uri.strip(), roots)
    file = _description(path)
    try:
        check_inside(file, roots, uri)
        check_file(file, MAX_BYTES if file.suffix.lower() in MESH_SUFFIXES else MAX_TEXT_BYTES)
    except SceneNotFoundError as e:
        raise SpawnError(SpawnFailure.NO_RESOURCE, str(e)).with_public("is not a file that may be read") from e
    except SceneError as e:
        raise SpawnError(SpawnFailure.UNSUPPORTED_FORMAT, f"{e}; {_ALLOWED}").with_public(
            f"is not a regular file, or is too large; {_ALLOWED}"
        ) from e
    suffix = file.suffix.lower()
    if suffix in (".yaml", ".yml"):
        return _robot(file, name, pose, roots)
    if suffix in MESH_SUFFIXES:
        return _mesh_body(file, name, pose, roots)
    return _body_from_xml(_read(file), file, name, pose, roots, from_file=True)


def spawn_name(uri: str, text: str) -> str:
    """Returns the name in a resource, for a robot.yaml that in its URDF; "" if it has no name or cannot be read."""
    try:
        if not uri.strip():
            return _first_name(text.strip().encode("utf-8", errors="replace"))
        file = _description(_resolve(uri.strip(), ())[0])
        if file.suffix.lower() in MESH_SUFFIXES:
            return ""
        check_file(file, MAX_TEXT_BYTES)
        if file.suffix.lower() in (".yaml", ".yml"):
            return read_urdf(load_robot(file).urdf).name
        return _first_name(_read(file))
    except GibsonSimError:
        return ""


def _resolve(uri: str, roots: tuple[Path, ...]) -> tuple[Path, tuple[Path, ...]]:
    """Returns the file or folder at a URI, and the folders that its files may lie in."""
    try:
        path = path_of(uri)
        if path is None:
            built_in = built_in_spawnables(uri).get(uri) if uri else None
            if built_in is not None:
                return built_in, (*roots, *description_roots(built_in.parent, _description(built_in))) if roots else ()
            path = Path(uri).absolute()
            # A misspelled name gets another message than a missing file.
            if not exists(path) and "/" not in uri:
                raise _no_model(uri)
        check_inside(path, roots, uri)
        if not exists(path):
            raise SceneNotFoundError(f"{uri}: {path} does not exist")
    except SceneNotFoundError as e:
        # No file has been read yet, so the message contains only the client's own text.
        # The caller puts the name of the resource in front of the public message.
        raise SpawnError(SpawnFailure.NO_RESOURCE, str(e)).with_public(str(e).removeprefix(f"{uri}: ")) from e
    return path, roots


def _no_model(name: str) -> SceneNotFoundError:
    """Returns the error for a name that is not a built-in model; it names the nearest one and the command that lists all of them."""
    near = nearest(name, list(built_in_spawnables()))
    hint = f"{near} " if near else ""
    return SceneNotFoundError(
        f"{name}: is neither a file nor a built-in model; {hint}`gibson-sim spawn --list` lists all of them"
    )


def _description(path: Path) -> Path:
    """Returns the file that describes the resource at a path: the path itself, or the description in a folder.

    Raises:
        SpawnError: the format of the file is not supported, or the folder holds no description, or several.
    """
    if not is_folder(path):
        if path.name == "model.config":
            return _description(path.parent)
        if path.suffix.lower() == ".xacro":
            raise _xacro_error(path)
        if path.suffix.lower() not in (".urdf", ".sdf", ".yaml", ".yml", *MESH_SUFFIXES):
            raise SpawnError(SpawnFailure.UNSUPPORTED_FORMAT, f"{path}: cannot be spawned; {_ALLOWED}")
        return path
    for file in (path / ROBOT_FILE, *sdf_files(path)):
        if is_file(file):
            return file
    try:
        entries = sorted(path.iterdir())
    except OSError as e:
        raise SpawnError(SpawnFailure.NO_RESOURCE, f"{path}: cannot be read: {e.strerror or e}") from e
    for suffixes in ((".urdf",), (".sdf",), MESH_SUFFIXES):
        files = [file for file in entries if file.suffix.lower() in suffixes]
        namesakes = [file for file in files if file.stem == path.name]
        if len(namesakes or files) == 1:
            return (namesakes or files)[0]
        if files:
            names = ", ".join(file.name for file in files[:8])
            raise SpawnError(
                SpawnFailure.UNSUPPORTED_FORMAT, f"{path}: holds {len(files)} descriptions, name one of them: {names}"
            )
    raise SpawnError(SpawnFailure.UNSUPPORTED_FORMAT, f"{path}: holds nothing that can be spawned; {_ALLOWED}")


def _text_body(text: str, name: str, pose: Pose, roots: tuple[Path, ...]) -> BodySpec:
    if not text.strip():
        raise SpawnError(SpawnFailure.NO_RESOURCE, _NO_RESOURCE).with_public(_NO_RESOURCE)
    # XML must not begin with a blank line, as strings in code often do.
    data = text.strip().encode("utf-8", errors="replace")
    if len(data) > MAX_TEXT_BYTES:
        raise SpawnError(
            SpawnFailure.UNSUPPORTED_FORMAT, f"resource_string has {len(data)} bytes, must be at most {MAX_TEXT_BYTES}"
        )
    return _body_from_xml(data, _TEXT, name, pose, roots, from_file=False)


def _body_from_xml(data: bytes, path: Path, name: str, pose: Pose, roots: tuple[Path, ...], *, from_file: bool) -> BodySpec:
    """Returns the body of a URDF or an SDF model, by its outermost element."""
    if not data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        raise SpawnError(SpawnFailure.UNSUPPORTED_FORMAT, f"{path}: is not XML; give a URDF (<robot>) or an SDF model (<sdf>)")
    try:
        top = parse_sdf(data)
    except TextError as e:
        if is_xacro(data):
            raise _xacro_error(path) from e
        raise SpawnError(SpawnFailure.RESOURCE_PARSE_ERROR, f"{path}: {e}").with_public(e.public if from_file else str(e)) from e
    if is_xacro(data, top):
        raise _xacro_error(path)
    # The files of a model lie in its folder, or in one of the three above.
    folder = path.parent
    root = ancestors(folder)[-1] if from_file and ancestors(folder) else folder
    uris = UriResolver(root, folder)
    if top.tag == "robot":
        # Checked before parsing, which creates many values for each link.
        links = len(top.findall("link"))
        if links > MAX_LINKS:
            reason = f"has {links} links, must be at most {MAX_LINKS}; split it"
            raise SpawnError(SpawnFailure.RESOURCE_PARSE_ERROR, f"{path}: {reason}").with_public(
                f"{_PUBLIC[SpawnFailure.RESOURCE_PARSE_ERROR]}: {reason}"
            )
        return _urdf_body(data, path, name, pose, roots, uris, from_file=from_file)
    if top.tag in ("sdf", "gazebo"):
        return _sdf_body(top, path, name, pose, roots, uris)
    raise SpawnError(
        SpawnFailure.UNSUPPORTED_FORMAT, f"{path}: the outermost element is <{top.tag}>, must be <robot> (URDF) or <sdf>"
    )


def _urdf_body(
    data: bytes, path: Path, name: str, pose: Pose, roots: tuple[Path, ...], uris: UriResolver, *, from_file: bool
) -> BodySpec:
    def find(mesh: str, urdf: Path) -> Path | None:
        try:
            path_found = resolve_mesh(mesh, urdf) if from_file else None
        except (OSError, ValueError):
            path_found = None
        path_found = path_found or uris.find(mesh, urdf.parent)
        return path_found if path_found is not None and is_file(path_found) else None

    try:
        model = parse_urdf(data, path, find)
    except RobotError as e:
        raise SpawnError(SpawnFailure.RESOURCE_PARSE_ERROR, str(e)).with_public(
            _public_text(SpawnFailure.RESOURCE_PARSE_ERROR, e)
        ) from e
    root = model.links[0]
    # Gazebo marks a static model by an empty root link `world`.
    static = root.name == WORLD and not (root.visuals or root.collisions or root.inertial)
    _check(model, _loader(roots), read=True, static=static)
    model = with_textures(model)
    _raise_for(model.warnings)
    return BodySpec(name, model, pose, static, class_from_model(model.name))


def _sdf_body(
    top: ElementTree.Element, path: Path, name: str, pose: Pose, roots: tuple[Path, ...], uris: UriResolver
) -> BodySpec:
    model = top.find("model")
    if model is None:
        hint = "it holds a <world>: load it as a world" if top.find("world") is not None else "give an SDF file with a model"
        raise SpawnError(SpawnFailure.UNSUPPORTED_FORMAT, f"{path}: holds no <model>; {hint}")
    builder = SceneBuilder(name, path.parent, roots or None, description=path, max_bytes=MAX_BYTES)
    try:
        if len(top.findall("model")) > 1:
            builder.warn(f"{path}: holds several models; the first is used")
        body = SdfBodyReader(SdfModels(builder, uris), path).read(model, path.parent, sdf_version(top))
    except SceneError as e:
        # Report missing files first: they may be the cause.
        _raise_for(builder.warnings)
        raise SpawnError(SpawnFailure.RESOURCE_PARSE_ERROR, str(e)).with_public(
            _public_text(SpawnFailure.RESOURCE_PARSE_ERROR, e)
        ) from e
    _check(body.model, builder.loader, read=False, static=body.static)
    return BodySpec(name, body.model, pose, body.static, class_from_model(body.model.name))


def _robot(file: Path, name: str, pose: Pose, roots: tuple[Path, ...]) -> RobotSpec:
    try:
        robot = load_robot(file, name=name, start=pose, roots=roots or None)
        check_inside(robot.urdf, roots, str(robot.urdf))
        model = read_urdf(robot.urdf)
    except RobotError as e:
        missing = isinstance(e.__cause__, FileNotFoundError)
        code = SpawnFailure.MISSING_ASSETS if missing else SpawnFailure.RESOURCE_PARSE_ERROR
        raise SpawnError(code, str(e)).with_public(_public_text(code, e)) from e
    except SceneNotFoundError as e:
        raise SpawnError(SpawnFailure.NO_RESOURCE, str(e)) from e
    _check(model, _loader(roots), read=True)
    return robot


def _mesh_body(file: Path, name: str, pose: Pose, roots: tuple[Path, ...]) -> BodySpec:
    loader = _loader(roots)
    try:
        model = mesh_body(file, loader)
    except MeshError as e:
        raise SpawnError(SpawnFailure.RESOURCE_PARSE_ERROR, str(e)).with_public(
            _public_text(SpawnFailure.RESOURCE_PARSE_ERROR, e)
        ) from e
    _check(model, loader, read=False)
    return BodySpec(name, model, pose, False, class_from_model(file.stem))


def _loader(roots: tuple[Path, ...]) -> MeshLoader:
    return MeshLoader(roots or None, textures=False, max_bytes=MAX_BYTES, max_parts=MAX_PARTS)


def _check(model: UrdfModel, loader: MeshLoader, *, read: bool, static: bool = False) -> None:
    """Checks the numbers of a model, that no file is missing, and that it is not too large for a running simulation.

    Args:
        model: the model.
        loader: reads its meshes.
        read: whether its meshes have yet to be read.
        static: whether it is static, so that its meshes collide as they are, not as their convex hulls.
    """
    lines = list(model.warnings)
    if read:
        shapes = [v.shape for link in model.links for v in link.visuals]
        shapes += [c.shape for link in model.links for c in link.collisions]
        for mesh in dict.fromkeys(shape.mesh for shape in shapes if shape.kind == "mesh"):
            try:
                lines += loader.mesh(Path(mesh)).warnings
            except MeshError as e:
                lines.append(Omission(str(e), OmissionKind.UNSUPPORTED_ASSET))
    for texture in dict.fromkeys(visual.texture for link in model.links for visual in link.visuals if visual.texture):
        if loader.roots is not None and not is_inside(Path(texture), loader.roots):
            text = f"{texture}: lies outside {', '.join(map(str, loader.roots))}; move it into one of these folders"
            lines.append(Omission(text, OmissionKind.UNSUPPORTED_ASSET))
    _raise_for([line for line in lines if kind_of(line) is OmissionKind.INVALID])
    try:
        _check_plausible(model, loader)
        rigid_groups(model)  # raises for too many joints
    except (SceneError, RobotError) as e:
        raise SpawnError(SpawnFailure.RESOURCE_PARSE_ERROR, str(e)).with_public(
            _public_text(SpawnFailure.RESOURCE_PARSE_ERROR, e)
        ) from e
    _raise_for(lines)
    _check_size(model, loader, static=static)


def _check_size(model: UrdfModel, loader: MeshLoader, *, static: bool) -> None:
    drawn = [visual.shape for link in model.links for visual in link.visuals]
    colliding = [collision.shape for link in model.links for collision in link.collisions] if static else []
    for shapes, most, what in (
        (drawn, MAX_TRIANGLES, "in its visuals"),
        (colliding, MAX_STATIC_TRIANGLES, "in its collision shapes"),
    ):
        count = sum(loader.mesh(Path(shape.mesh)).triangle_count for shape in shapes if shape.kind == "mesh")
        if count > most:
            reason = (
                f"has {count:,} triangles {what}, at most {most:,} may be spawned while a simulation runs; simplify its meshes, or "
                "start with it: as --robot, or among the bodies of a scene"
            )
            raise SpawnError(SpawnFailure.UNSUPPORTED_ASSETS, f"{model.path}: {reason}").with_public(reason)


def _check_plausible(model: UrdfModel, loader: MeshLoader) -> None:
    """Checks every number of a model.

    Args:
        model: the model.
        loader: measures its meshes; a mesh that it cannot read is not checked here.

    Raises:
        SceneError: a value is not plausible; the message names the link or joint, the value and the limits.
    """
    if len(model.links) > MAX_LINKS:
        raise SceneError(f"{model.path}: has {len(model.links)} links, must be at most {MAX_LINKS}; split it")
    for link in model.links:
        where = f"{model.path}: link {quoted(link.name)}"
        shapes = [(v.shape, v.pose) for v in link.visuals] + [(c.shape, c.pose) for c in link.collisions]
        for shape, pose in shapes:
            _check_position(where, pose)
            _check_shape(where, shape, loader)
        if link.inertial is not None:
            _check_inertial(where, link.inertial)
        if link.friction is not None and not 0.0 <= link.friction < math.inf:
            raise SceneError(f"{where}: friction is {link.friction:g}, must be a finite number, 0 or more")
    for joint in model.joints:
        _check_joint(f"{model.path}: joint {quoted(joint.name)}", joint)


def _check_inertial(where: str, inertial: Inertial) -> None:
    if not 0.0 <= inertial.mass <= MAX_MASS:
        raise SceneError(f"{where}: mass is {inertial.mass:g} kg, must be 0 to {MAX_MASS:g}; is it in grams?")
    for name, value in zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), inertial.inertia, strict=True):
        low = 0.0 if name in ("ixx", "iyy", "izz") else -MAX_INERTIA
        if not low <= value <= MAX_INERTIA:
            raise SceneError(f"{where}: {name} is {value:g} kg m^2, must be {low:g} to {MAX_INERTIA:g}")
    _check_position(where, inertial.pose)


def _check_position(where: str, pose: Pose) -> None:
    if not all(abs(c) <= FAR_AWAY for c in pose.position):
        at = ", ".join(f"{c:g}" for c in pose.position)
        raise SceneError(f"{where}: something in it is at ({at}) m, must be within {FAR_AWAY:g} m")


def _check_shape(where: str, shape: Shape, loader: MeshLoader) -> None:
    size, what = shape.size, str(shape.kind)
    if shape.kind == "mesh":
        if not all(map(math.isfinite, size)) or not all(size):
            raise SceneError(f"{where}: scale of a mesh is {size}, the three factors must be finite and not 0")
        try:
            bounds = loader.mesh(Path(shape.mesh)).bounds
        except MeshError:
            return
        x, y, z = (np.abs(bounds).max(axis=0) * np.abs(size)).tolist()
        size, what = (x, y, z), f"mesh {shape.mesh}"
    if not all(0.0 <= s <= FAR_AWAY for s in size):
        raise SceneError(f"{where}: {what} is {max(size):g} m large, must be at most {FAR_AWAY:g} m; is the unit right?")


def _check_joint(where: str, joint: UrdfJoint) -> None:
    if joint.kind not in (*MOVING_TYPES, "fixed"):
        raise SceneError(f"{where}: type {joint.kind} is not simulated; use {', '.join(MOVING_TYPES)} or fixed")
    _check_position(where, joint.pose)
    for name in ("lower", "upper", "effort", "velocity", "damping", "friction"):
        value = getattr(joint, name)
        is_resistance = name in ("damping", "friction")
        if not math.isfinite(value) or (is_resistance and value < 0.0):
            raise SceneError(f"{where}: {name} is {value:g}, must be a finite number{', 0 or more' if is_resistance else ''}")


def _raise_for(lines: Sequence[str]) -> None:
    """Raises a SpawnError that names all omissions of the gravest kind, if there are any."""
    codes = {
        SpawnFailure.RESOURCE_PARSE_ERROR: (OmissionKind.INVALID,),
        SpawnFailure.MISSING_ASSETS: (OmissionKind.MISSING_ASSET,),
        SpawnFailure.UNSUPPORTED_ASSETS: (OmissionKind.UNSUPPORTED_ASSET, OmissionKind.UNSUPPORTED_ELEMENT),
    }
    for code, kinds in codes.items():
        omissions = [line.removesuffix("; left out") for line in lines if kind_of(line) in kinds]
        if omissions:
            raise SpawnError(code, "; ".join(dict.fromkeys(omissions)))


def _read(file: Path) -> bytes:
    try:
        return read_file(file)
    except OSError as e:
        raise SpawnError(SpawnFailure.NO_RESOURCE, f"{file}: cannot be read: {e.strerror or e}") from e


def _xacro_error(path: Path) -> SpawnError:
    kind = "sdf" if ".sdf" in path.suffixes else "urdf"
    text = f"{path}: is a xacro, not a finished description; expand it first: xacro {path.name} > model.{kind}"
    return SpawnError(SpawnFailure.UNSUPPORTED_FORMAT, text)


def _first_name(data: bytes) -> str:
    """Returns the name of a URDF or of the first model of an SDF, "" if there is none."""
    try:
        top = parse_sdf(data)
    except TextError:
        return ""
    element = top if top.tag == "robot" else top.find("model")
    return "" if element is None else element.get("name", "").strip()


def _public_text(code: SpawnFailure, error: GibsonSimError) -> str:
    """Returns the message for clients that may not see the file."""
    return f"{_PUBLIC[code]}: {error.public}" if error.public else _PUBLIC[code]


def mesh_body(path: Path, loader: MeshLoader) -> UrdfModel:
    """Returns a model with one link whose visual and collision shape is the mesh; physics uses its convex hull.

    Args:
        path: the mesh file.
        loader: reads the file.

    Raises:
        MeshError: the mesh cannot be used.
    """
    mesh = loader.mesh(path)
    solid = hull_solid(mesh.merged()[0])
    mass = float(np.clip(_HULL_DENSITY * solid.mass, *_HULL_MASS_RANGE))
    i = solid.inertia * (mass / solid.mass)
    x, y, z = (float(c) for c in solid.center)
    moments = (i[0, 0], i[0, 1], i[0, 2], i[1, 1], i[1, 2], i[2, 2])
    ixx, ixy, ixz, iyy, iyz, izz = (float(moment) for moment in moments)
    shape = Shape("mesh", (1.0, 1.0, 1.0), str(mesh.files[0]))
    link = UrdfLink(
        _HULL_LINK,
        (UrdfVisual(shape, Pose(), None),),
        (UrdfCollision(shape, Pose()),),
        Inertial(mass, Pose((x, y, z)), (ixx, ixy, ixz, iyy, iyz, izz)),
        _HULL_FRICTION,
    )
    return UrdfModel(path.stem, path, (link,), (), mesh.warnings)
