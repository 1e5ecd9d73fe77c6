"""Imports sources of all kinds: reads each into an ``ImportedScene``, writes it as a folder with a scene.yaml, and loads that."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gibson_sim.description.omissions import Omission, OmissionKind, kind_of
from gibson_sim.description.shapes import Appearance, Shape, VisualSpec
from gibson_sim.errors import SceneError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import TO_Z_UP, Mesh, UpAxis
from gibson_sim.formats.ply import ply_part, read_ply
from gibson_sim.geometry.transforms import matrix_from_pose, quat_from_matrix
from gibson_sim.scenes.load import load_scene, read_scene
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import CollisionSpec, LightSpec, SceneSpec
from gibson_sim.types import Pose, Vec3
from gibson_sim_tools.importing.checks.facts import SUFFIXES_WITHOUT_UP_AXIS
from gibson_sim_tools.importing.checks.gravity import ON_ITS_SIDE_DEG, direction_text, guess_up, rotation_to_z
from gibson_sim_tools.importing.document import (
    ASSETS,
    BAKED_LIGHT,
    GIBSON_RESOLUTION,
    SIMPLIFIED,
    FloorPicture,
    ImportedObject,
    ImportedScene,
    is_scan,
    write_in_place,
    write_scene,
)
from gibson_sim_tools.importing.fetching.archives import only_folder, unpack
from gibson_sim_tools.importing.labels import (
    LabelledFaces,
    class_name,
    habitat_classes,
    labelled_faces_of_textures,
    replica_classes,
    split_objects,
    transfer_labels,
)
from gibson_sim_tools.importing.sources import MAX_BYTES, Source, SourceKind, identify
from gibson_sim_tools.importing.usd import read_usd

_OBJECT_ID = ("object_id", "objectId", "segment")
_MAX_OBJECTS = 5000
_AXIS_COSINE = 0.996
"""Cosine of the largest angle between up and an axis of the file at which that axis is the up axis; ``check --fix`` removes the remaining tilt."""
WITHOUT_VISUAL = ""
"""Key for collision shapes without a visual."""
_LICENCES = ("LICENSE", "LICENCE", "LICENSE.txt", "LICENSE.md", "COPYING", "SOURCE.txt", "license.txt")


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """Options of an import; they override the source."""

    name: str = ""
    up_axis: UpAxis | None = None
    up: Vec3 | None = None
    """Up direction of a mesh file, unit vector in its axes; None = ``up_axis``."""
    unit_m: float | None = None
    """Metres per unit; None = as the source says."""
    semantics: bool = True
    """Split labelled meshes into objects."""


def read_source(source: Source, options: ImportOptions) -> ImportedScene:
    """Reads a source.

    Raises:
        SceneError: it cannot be read.
    """
    readers: dict[SourceKind, Callable[[Source, ImportOptions], ImportedScene]] = {
        SourceKind.GIBSON: _gibson, SourceKind.REPLICA: _replica, SourceKind.HABITAT: _habitat, SourceKind.WORLD: _world,
        SourceKind.USD: _usd, SourceKind.MESH: _mesh, SourceKind.GIBSON_SIM: _world,
    }  # fmt: skip
    reader = readers.get(source.kind)
    if reader is None:
        raise SceneError(f"{source.file}: is an archive; unpack it first")
    if options.up is not None and reader is not _mesh:
        raise SceneError(
            f"{source.file}: is a {source.kind.value}; --up-axis must be x, y or z for it, other directions are for single meshes"
        )
    scene = reader(source, options)
    scene.licences = [scene.root / name for name in _LICENCES if (scene.root / name).is_file()]
    return scene if not options.name else replace(scene, name=options.name)


def _scene(source: Source, name: str) -> ImportedScene:
    return ImportedScene(name, source.kind.value, Path(os.path.realpath(source.folder)))


def _loader(folder: Path, *, textures: bool = True) -> MeshLoader:
    return MeshLoader((folder,), textures=textures, max_bytes=MAX_BYTES)


def _with_warnings(scene: ImportedScene, mesh: Mesh) -> Mesh:
    scene.warnings += [Omission(w.replace(f"{scene.root}{os.sep}", ""), kind_of(w)) for w in mesh.warnings]
    return mesh


# Gibson and iGibson


def _gibson(source: Source, options: ImportOptions) -> ImportedScene:
    scene = _scene(source, source.folder.resolve().name)
    scene.light = BAKED_LIGHT
    coarse_mesh = source.folder / "mesh_z_up_downsampled.obj"
    mesh = _with_warnings(scene, _loader(source.folder, textures=False).mesh(source.file))
    labels = _semantic_obj(source) if source.semantics and options.semantics else None
    if labels is None:
        collision = SIMPLIFIED if is_scan(mesh) else coarse_mesh if coarse_mesh.is_file() else "same"
        scene.objects = [
            ImportedObject(scene.name, source.file, collision=collision, up_axis=options.up_axis or "", unit_m=options.unit_m)
        ]
    else:
        faces, classes = labels
        mesh = _loader(source.folder).mesh(source.file)
        scene.objects = split_objects(mesh, transfer_labels(mesh, faces), classes)
    scene.floors = _floor_heights(source.folder / "floors.txt")
    for number in range(max(len(scene.floors), 1)):
        picture = source.folder / f"floor_trav_{number}.png"
        if picture.is_file():
            scene.maps.append(FloorPicture(picture, GIBSON_RESOLUTION, number))
    return scene


def _floor_heights(path: Path) -> tuple[float, ...]:
    """Returns the heights in a ``floors.txt``, one per line, from the lowest; empty if the file is missing."""
    if not path.is_file():
        return ()
    try:
        heights = [float(word) for word in path.read_text(encoding="utf-8", errors="replace").split()]
    except ValueError as e:
        raise SceneError(
            f"{path}: must hold one height in metres on each line ({e}); correct it, or delete it to detect floors automatically"
        ) from e
    if not np.isfinite(heights).all():
        raise SceneError(
            f"{path}: holds {heights}, heights must be finite numbers; correct it, or delete it to detect floors automatically"
        )
    return tuple(sorted(heights))


def _semantic_obj(source: Source) -> tuple[LabelledFaces, dict[int, str]] | None:
    """Returns the labels of a ``semantic.obj``, whose materials are named after objects: ``chair_3_office_1``."""
    mesh = _loader(source.folder, textures=False).mesh(source.semantics[0])
    if not 1 < len(mesh.parts) <= _MAX_OBJECTS:
        return None
    centres = [part.vertices[part.triangles].mean(axis=1, dtype=np.float64) for part in mesh.parts]
    numbers = np.repeat(np.arange(len(mesh.parts)), [len(c) for c in centres])
    classes = {k: class_name(part.material.name.split("_")[0]) for k, part in enumerate(mesh.parts)}
    return LabelledFaces(np.concatenate(centres), numbers), classes


# Replica


def _replica(source: Source, options: ImportOptions) -> ImportedScene:
    scene = _scene(source, source.folder.resolve().name)
    if not (source.semantics and options.semantics):
        mesh = _with_warnings(scene, _loader(source.folder, textures=False).mesh(source.file))
        scene.objects = [_whole_file(scene.name, source, options, mesh)]
        return scene
    labelled, classes = source.semantics
    ply = read_ply(labelled, _bytes(labelled))
    ids = next((ply.face[name] for name in _OBJECT_ID if name in ply.face), None)
    if ids is None or len(np.unique(ids)) > _MAX_OBJECTS:
        raise SceneError(f"{labelled}: its faces have no object_id; use --no-semantics to import only mesh.ply")
    triangles, polygon = ply.triangulated()
    part = ply_part(str(labelled), ply, triangles)
    if part is None:
        raise SceneError(f"{labelled}: has no triangles")
    objects = np.asarray(ids, dtype=np.int64)[polygon]
    scene.objects = split_objects(Mesh((part,)), [objects], replica_classes(classes))
    return scene


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as e:
        raise SceneError(f"{path}: cannot be read: {e.strerror or e}") from e


# Matterport, HM3D and Gibson in Habitat's layout


def _habitat(source: Source, options: ImportOptions) -> ImportedScene:
    scene = _scene(source, source.file.name.split(".")[0])
    scene.light = BAKED_LIGHT
    if not options.semantics:
        return _single_mesh(scene, source, options)
    mesh = _with_warnings(scene, _loader(source.folder).mesh(source.file))
    up = options.up_axis or _detect_up(scene, mesh)[0]
    mesh = mesh.transformed(_up_axis_transform(up, mesh)) if up else mesh
    labelled, lists = source.semantics
    if labelled.suffix.lower() == ".glb":
        coloured = _loader(source.folder).mesh(labelled)
        faces, classes = labelled_faces_of_textures(
            coloured.transformed(_up_axis_transform(up, coloured)) if up else coloured, lists
        )
    else:
        ply = read_ply(labelled, _bytes(labelled))
        ids = next((ply.face[name] for name in _OBJECT_ID if name in ply.face), None)
        if ids is None:
            raise SceneError(f"{labelled}: its faces have no object_id; use --no-semantics to import only {source.file.name}")
        triangles, polygon = ply.triangulated()
        objects = np.asarray(ids, dtype=np.int64)[polygon]
        faces, classes = LabelledFaces(ply.positions[ply.corners[triangles]].mean(axis=1), objects), habitat_classes(lists)
    scene.objects = split_objects(mesh, transfer_labels(mesh, faces), classes)
    return scene


def _up_axis_transform(up: UpAxis, mesh: Mesh) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Returns the transform, (4, 4), that replaces the loader's up-axis rotation by that for ``up``."""
    matrix = np.eye(4)
    matrix[:3, :3] = TO_Z_UP[up] @ TO_Z_UP[mesh.up_axis].T
    return matrix


# Plain meshes


def _mesh(source: Source, options: ImportOptions) -> ImportedScene:
    return _single_mesh(_scene(source, source.file.name.split(".")[0]), source, options)


def _single_mesh(scene: ImportedScene, source: Source, options: ImportOptions) -> ImportedScene:
    mesh = _with_warnings(scene, _loader(source.folder, textures=False).mesh(source.file))
    if not all(file.is_relative_to(scene.root) for file in mesh.files):
        # In Gazebo's layout, meshes/ is beside materials/textures/: the mesh refers to files of its package outside its own folder.
        scene.root = scene.in_place_folder = Path(os.path.commonpath([scene.root, *(file.parent for file in mesh.files)]))
    axis, up = options.up_axis, options.up
    if axis is None and up is None:
        axis, up = _detect_up(scene, mesh)
    pose = Pose()
    if up is not None:
        in_mesh = TO_Z_UP[axis or mesh.up_axis] @ np.asarray(up)
        pose = Pose(quat_xyzw=quat_from_matrix(rotation_to_z(in_mesh)))
    scene.objects = [replace(_whole_file(source.file.stem, source, options, mesh), pose=pose, up_axis=axis or "")]
    return scene


def _whole_file(name: str, source: Source, options: ImportOptions, mesh: Mesh) -> ImportedObject:
    """Returns the whole file as one object."""
    collision = SIMPLIFIED if is_scan(mesh) else "same"
    return ImportedObject(name, source.file, up_axis=options.up_axis or "", unit_m=options.unit_m, collision=collision)


def _detect_up(scene: ImportedScene, mesh: Mesh) -> tuple[UpAxis | None, Vec3 | None]:
    """Returns the up axis of the file, None = as its format says; and the up direction in the axes of the file, if it is opposite to
    that axis or along no axis. Warns unless the format agrees.

    Scans in the frame of their first camera have y down or an arbitrary orientation.
    """
    vertices, triangles = mesh.merged()
    guess = guess_up(vertices, triangles, declared=mesh.files[0].suffix.lower() not in SUFFIXES_WITHOUT_UP_AXIS)
    to_file = TO_Z_UP[mesh.up_axis].T
    name = mesh.files[0].name
    if not guess.sure:
        listed = "; ".join(direction_text(to_file @ np.asarray(up)) for up in guess.others)
        first = direction_text(to_file @ np.asarray(guess.others[0]))
        text = (
            f"{name}: which way is up is not clear: it may be {listed} of the file; assumed {mesh.up_axis}, as the format says; "
            f"--up-axis={first} overrides it"
        )
        scene.warnings.append(Omission(text, OmissionKind.UP_UNCLEAR))
        return None, None
    if guess.tilt_deg <= ON_ITS_SIDE_DEG:
        return None, None
    up = to_file @ np.asarray(guess.up)
    index = int(np.abs(up).argmax())
    axis: UpAxis = ("x", "y", "z")[index]
    if abs(up[index]) < _AXIS_COSINE:
        scene.warnings.append(
            f"{name}: its floor is not perpendicular to any axis of the file: {direction_text(up)} is taken as up; --up-axis overrides it"
        )
        return None, (float(up[0]), float(up[1]), float(up[2]))
    down = bool(up[index] < 0)
    scene.warnings.append(
        f"{name}: its floor is perpendicular to the {axis} axis of the file: {'-' if down else ''}{axis} is taken as up; --up-axis overrides it"
    )
    opposite = np.zeros(3)
    opposite[index] = -1.0
    return axis, (float(opposite[0]), float(opposite[1]), float(opposite[2])) if down else None


def _usd(source: Source, options: ImportOptions) -> ImportedScene:
    scene = _scene(source, source.file.stem)
    scene.objects, warnings = read_usd(source.file, options.up_axis, options.unit_m)
    scene.warnings += warnings
    return scene


# Worlds


def _world(source: Source, options: ImportOptions) -> ImportedScene:
    builder = read_scene(source.file, source.file)
    spec = builder.finish()
    out = from_spec(spec, _scene(source, spec.name))
    out.root, out.loader = spec.root, builder.loader
    return out


def from_spec(spec: SceneSpec, out: ImportedScene) -> ImportedScene:
    """Fills ``out`` from a loaded scene and returns it; the files of the scene stay in place."""
    out.warnings += list(spec.warnings)
    out.floors, out.ground_z, out.ground_friction = spec.floors, spec.ground_z, spec.ground_friction
    out.gravity = spec.gravity if spec.gravity != (0.0, 0.0, -9.81) else None
    out.light = light_document(spec.light)
    for start in spec.starts:
        x, y, z = start.pose.position
        yaw = np.degrees(np.arctan2(*matrix_from_pose(start.pose)[[1, 0], 0]))
        out.starts.append({"name": start.name, "xyz": [x, y, z], "yaw_deg": round(float(yaw), 6)})
    loader = MeshLoader(scene_roots(spec), textures=False)
    collisions = collisions_by_visual(spec)
    for visual in spec.visuals:
        shapes = collisions.get(visual.name, [])
        if len({shape.friction for shape in shapes}) > 1:
            out.warnings.append(f"{visual.name}: its collision shapes differ in friction; {shapes[0].friction:g} is used for all")
        out.objects.append(_object(visual, shapes, loader))
    for collision in collisions.get(WITHOUT_VISUAL, []):
        shape, scale = _shape(collision.shape)
        out.objects.append(
            ImportedObject(collision.name, shape, collision.pose, scale, visible=False, friction=collision.friction)
        )
    return out


def light_document(light: LightSpec) -> dict[str, object]:
    """Returns the settings of ``light`` in a scene.yaml that differ from the defaults, without lamps and surroundings."""
    defaults = LightSpec()
    names = ("sun_direction", "sun", "sun_color", "ambient", "background", "shadows")
    changed = {name: getattr(light, name) for name in names if getattr(light, name) != getattr(defaults, name)}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in changed.items()}


def collisions_by_visual(spec: SceneSpec) -> dict[str, list[CollisionSpec]]:
    """Returns the collision shapes of each visual, matched by name, with or without a numeric suffix; ``WITHOUT_VISUAL``: the others."""
    names = {v.name for v in spec.visuals}
    out: dict[str, list[CollisionSpec]] = {}
    for collision in spec.collisions:
        # The second shape of an object is called <object>_2.
        stem, _, number = collision.name.rpartition("_")
        owner = collision.name if collision.name in names else stem if number.isdecimal() and stem in names else WITHOUT_VISUAL
        out.setdefault(owner, []).append(collision)
    return out


def _object(visual: VisualSpec, collisions: list[CollisionSpec], loader: MeshLoader) -> ImportedObject:
    shape, scale = _shape(visual.shape)
    appearance = Appearance() if visual.appearance is None else visual.appearance
    item = ImportedObject(
        visual.name, shape, visual.pose, scale, semantic_class=visual.semantic_class, color=visual.color, collision="none",
        metallic=appearance.metallic, roughness=appearance.roughness, friction=collisions[0].friction if collisions else 1.0,
    )  # fmt: skip
    if not collisions:
        return item
    if len(collisions) == 1 and collisions[0].pose == visual.pose:
        collision_shape = collisions[0].shape
        if collision_shape == visual.shape:
            return replace(item, collision="same")
        if collision_shape.kind == "mesh" and visual.shape.kind == "mesh" and collision_shape.size == visual.shape.size:
            return replace(item, collision=Path(collision_shape.mesh))
    # In the frame of the visual, whose pose and scale also apply to the collision mesh.
    factors = np.diag([*scale, 1.0])
    to_visual = np.linalg.inv(matrix_from_pose(visual.pose) @ factors)
    parts = [part for c in collisions for part in loader.shape(c.shape).transformed(to_visual @ matrix_from_pose(c.pose)).parts]
    return replace(item, collision=Mesh(tuple(replace(p, uvs=None, colors=None) for p in parts)))


def _shape(shape: Shape) -> tuple[Path | dict[str, object], Vec3]:
    if shape.kind == "mesh":
        return Path(shape.mesh), shape.size
    if shape.kind in ("box", "ellipsoid"):
        return {shape.kind: list(shape.size)}, (1.0, 1.0, 1.0)
    if shape.kind == "sphere":
        return {"sphere": shape.size[0]}, (1.0, 1.0, 1.0)
    return {shape.kind: {"radius": shape.size[0], "length": shape.size[1]}}, (1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class ImportResult:
    """Result of an import."""

    file: Path
    """Path of the scene.yaml."""
    kind: str
    """Kind of the source in words, such as ``Gibson folder``."""
    scene: SceneSpec
    """The written scene, loaded."""
    warnings: tuple[str, ...]
    """Warnings, one line each."""


def import_scene(source: Path, output: Path | None, options: ImportOptions | None = None) -> ImportResult:
    """Imports a scene of any kind, and loads the result.

    Args:
        source: file, folder or archive.
        output: new folder for the scene.yaml and a copy of all files; None = the scene.yaml is written beside the source, whose files
            stay in place.
        options: None = the defaults.

    Raises:
        SceneError: the source cannot be read, or the scene cannot be written.
    """
    identified = identify(source)
    if identified.kind is SourceKind.GIBSON_SIM:
        raise SceneError(f"{source}: is a Gibson Sim scene already; use it as it is")
    if identified.kind is not SourceKind.ARCHIVE:
        return _import_source(identified, output, options or ImportOptions())
    if output is None:
        raise SceneError(f"{source}: is an archive; give a folder for the scene with --output")
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{output.name}.", dir=output.parent) as temporary:
        unpack(source, Path(temporary) / "archive")
        content = only_folder(Path(temporary) / "archive")
        archive_options = options or ImportOptions()
        return _import_source(
            identify(content), output, replace(archive_options, name=archive_options.name or source.name.split(".")[0])
        )


def _import_source(source: Source, output: Path | None, options: ImportOptions) -> ImportResult:
    scene = read_source(source, options)
    file = write_scene(scene, output) if output is not None else write_in_place(scene, scene.in_place_folder or source.folder)
    spec = load_scene(file)
    # Loading the copy repeats the warnings about the source.
    known = {_warning_key(warning) for warning in scene.warnings}
    new_warnings = [warning for warning in spec.warnings if _warning_key(warning) not in known]
    return ImportResult(file, scene.kind, spec, (*dict.fromkeys(scene.warnings), *new_warnings))


def _warning_key(warning: str) -> str:
    return warning.replace(f"{ASSETS}/", "")
