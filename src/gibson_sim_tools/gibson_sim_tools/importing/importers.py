"""Reads scenes of every kind into an ``ImportedScene``."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gibson_sim.description.omissions import Omission, OmissionKind, kind_of
from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.errors import SceneError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import TO_Z_UP, Mesh, UpAxis, fan
from gibson_sim.formats.ply import ply_part, read_ply
from gibson_sim.geometry.transforms import matrix_from_pose, quat_from_matrix
from gibson_sim.scenes.load import read_scene
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import CollisionSpec, LightSpec, SceneSpec
from gibson_sim.types import Pose, Vec3
from gibson_sim_tools.importing.checks.facts import UNTOLD_SUFFIXES
from gibson_sim_tools.importing.checks.gravity import ON_ITS_SIDE_DEG, direction_text, guess_up, rotation_to_z
from gibson_sim_tools.importing.document import BAKED_LIGHT, SIMPLIFIED, FloorPicture, ImportedObject, ImportedScene
from gibson_sim_tools.importing.floor_pictures import GIBSON_RESOLUTION
from gibson_sim_tools.importing.hm3d import labelled_faces_of_textures
from gibson_sim_tools.importing.labels import LabelledFaces, class_name, habitat_classes, replica_classes, take_apart, transfer
from gibson_sim_tools.importing.scans import is_scan
from gibson_sim_tools.importing.sources import MAX_BYTES, Source, SourceKind
from gibson_sim_tools.importing.usd import read_usd

_OBJECT_ID = ("object_id", "objectId", "segment")
_MOST_OBJECTS = 5000
_ALONG = 0.996
"""Cosine of the angle between up and an axis of the file, from which up counts as that axis; the check corrects the rest."""
UNSEEN = ""
"""Key for collision shapes without a visual."""
_LICENCES = ("LICENSE", "LICENCE", "LICENSE.txt", "LICENSE.md", "COPYING", "SOURCE.txt", "license.txt")


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """Options of an import; they override what the source says."""

    name: str = ""
    up_axis: UpAxis | None = None
    up: Vec3 | None = None
    """Up direction of a mesh file, unit vector in its axes, where it lies along none of them."""
    unit_m: float | None = None
    semantics: bool = True
    """Split labelled meshes into objects."""


def read_source(source: Source, choices: ImportOptions) -> ImportedScene:
    """Reads a source.

    Raises:
        SceneError: it cannot be read.
    """
    readers: dict[SourceKind, Callable[[Source, ImportOptions], ImportedScene]] = {
        SourceKind.GIBSON: _gibson, SourceKind.REPLICA: _replica, SourceKind.HABITAT: _habitat, SourceKind.WORLD: _world,
        SourceKind.USD: _usd, SourceKind.MESH: _mesh, SourceKind.OURS: _world,
    }  # fmt: skip
    reader = readers.get(source.kind)
    if reader is None:
        raise SceneError(f"{source.file}: is an archive; unpack it first")
    if choices.up is not None and reader is not _mesh:
        raise SceneError(
            f"{source.file}: is a {source.kind.value}; --up-axis must be x, y or z for it, other directions are for single meshes"
        )
    scene = reader(source, choices)
    scene.licences = [scene.root / name for name in _LICENCES if (scene.root / name).is_file()]
    return scene if not choices.name else replace(scene, name=choices.name)


def _scene(source: Source, name: str) -> ImportedScene:
    return ImportedScene(name, source.kind.value, Path(os.path.realpath(source.folder)))


def _loader(folder: Path, *, textures: bool = True) -> MeshLoader:
    return MeshLoader((folder,), textures=textures, max_bytes=MAX_BYTES)


def _with_warnings(scene: ImportedScene, mesh: Mesh) -> Mesh:
    scene.warnings += [Omission(w.replace(f"{scene.root}{os.sep}", ""), kind_of(w)) for w in mesh.warnings]
    return mesh


# Gibson and iGibson


def _gibson(source: Source, choices: ImportOptions) -> ImportedScene:
    scene = _scene(source, source.folder.resolve().name)
    scene.light = BAKED_LIGHT
    coarse = source.folder / "mesh_z_up_downsampled.obj"
    mesh = _with_warnings(scene, _loader(source.folder, textures=False).mesh(source.file))
    labels = _semantic_obj(source) if source.semantics and choices.semantics else None
    if labels is None:
        collision = SIMPLIFIED if is_scan(mesh) else coarse if coarse.is_file() else "same"
        scene.objects = [
            ImportedObject(scene.name, source.file, collision=collision, up_axis=choices.up_axis or "", unit_m=choices.unit_m)
        ]
    else:
        faces, classes = labels
        mesh = _loader(source.folder).mesh(source.file)
        scene.objects = take_apart(mesh, transfer(mesh, faces), classes)
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
    if not 1 < len(mesh.parts) <= _MOST_OBJECTS:
        return None
    centres = [part.vertices[part.triangles].mean(axis=1, dtype=np.float64) for part in mesh.parts]
    numbers = np.repeat(np.arange(len(mesh.parts)), [len(c) for c in centres])
    classes = {k: class_name(part.material.name.split("_")[0]) for k, part in enumerate(mesh.parts)}
    return LabelledFaces(np.concatenate(centres), numbers), classes


# Replica


def _replica(source: Source, choices: ImportOptions) -> ImportedScene:
    scene = _scene(source, source.folder.resolve().name)
    if not (source.semantics and choices.semantics):
        mesh = _with_warnings(scene, _loader(source.folder, textures=False).mesh(source.file))
        scene.objects = [_whole(scene.name, source, choices, mesh)]
        return scene
    labelled, classes = source.semantics
    ply = read_ply(labelled, _bytes(labelled))
    ids = next((ply.face[name] for name in _OBJECT_ID if name in ply.face), None)
    if ids is None or len(np.unique(ids)) > _MOST_OBJECTS:
        raise SceneError(f"{labelled}: its faces have no object_id; use --no-semantics to import mesh.ply alone")
    part = ply_part(str(labelled), ply, fan(ply.sizes))
    if part is None:
        raise SceneError(f"{labelled}: has no triangles")
    objects = np.asarray(ids, dtype=np.int64)[ply.polygon_of_triangle]
    scene.objects = take_apart(Mesh((part,)), [objects], replica_classes(classes))
    return scene


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as e:
        raise SceneError(f"{path}: cannot be read: {e.strerror or e}") from e


# Matterport, HM3D and Gibson as Habitat has them


def _habitat(source: Source, choices: ImportOptions) -> ImportedScene:
    scene = _scene(source, source.file.name.split(".")[0])
    scene.light = BAKED_LIGHT
    if not choices.semantics:
        return _single(scene, source, choices)
    mesh = _with_warnings(scene, _loader(source.folder).mesh(source.file))
    up = choices.up_axis or _up_of(scene, mesh)[0]
    mesh = mesh.transformed(_turn(up, mesh)) if up else mesh
    labelled, lists = source.semantics
    if labelled.suffix.lower() == ".glb":
        coloured = _loader(source.folder).mesh(labelled)
        faces, classes = labelled_faces_of_textures(coloured.transformed(_turn(up, coloured)) if up else coloured, lists)
    else:
        ply = read_ply(labelled, _bytes(labelled))
        ids = next((ply.face[name] for name in _OBJECT_ID if name in ply.face), None)
        if ids is None:
            raise SceneError(f"{labelled}: its faces have no object_id; use --no-semantics to import {source.file.name} alone")
        triangles = ply.corners[fan(ply.sizes)]
        objects = np.asarray(ids, dtype=np.int64)[ply.polygon_of_triangle]
        faces, classes = LabelledFaces(ply.positions[triangles].mean(axis=1), objects), habitat_classes(lists)
    scene.objects = take_apart(mesh, transfer(mesh, faces), classes)
    return scene


def _turn(up: UpAxis, mesh: Mesh) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Returns the transform, (4, 4), that replaces the loader's up-axis rotation by the one for another axis."""
    matrix = np.eye(4)
    matrix[:3, :3] = TO_Z_UP[up] @ TO_Z_UP[mesh.up_axis].T
    return matrix


# Plain meshes


def _mesh(source: Source, choices: ImportOptions) -> ImportedScene:
    return _single(_scene(source, source.file.name.split(".")[0]), source, choices)


def _single(scene: ImportedScene, source: Source, choices: ImportOptions) -> ImportedScene:
    mesh = _with_warnings(scene, _loader(source.folder, textures=False).mesh(source.file))
    if not all(file.is_relative_to(scene.root) for file in mesh.files):
        # Gazebo's layout has meshes/ beside materials/textures/: the files that the mesh names lie in its package.
        scene.root = scene.home = Path(os.path.commonpath([scene.root, *(file.parent for file in mesh.files)]))
    axis, up = choices.up_axis, choices.up
    if axis is None and up is None:
        axis, up = _up_of(scene, mesh)
    pose = Pose()
    if up is not None:
        in_mesh = TO_Z_UP[axis or mesh.up_axis] @ np.asarray(up)
        pose = Pose(quat_xyzw=quat_from_matrix(rotation_to_z(in_mesh)))
    scene.objects = [replace(_whole(source.file.stem, source, choices, mesh), pose=pose, up_axis=axis or "")]
    return scene


def _whole(name: str, source: Source, choices: ImportOptions, mesh: Mesh) -> ImportedObject:
    """Returns the whole file as one object."""
    collision = SIMPLIFIED if is_scan(mesh) else "same"
    return ImportedObject(name, source.file, up_axis=choices.up_axis or "", unit_m=choices.unit_m, collision=collision)


def _up_of(scene: ImportedScene, mesh: Mesh) -> tuple[UpAxis | None, Vec3 | None]:
    """Returns the up axis of the file, None = as its format says; and the up direction in the axes of the file, if it is opposite to that
    axis or along none.

    Scans in the frame of their first camera have y down or an arbitrary orientation.
    """
    vertices, triangles = mesh.merged()
    guess = guess_up(vertices, triangles, told=mesh.files[0].suffix.lower() not in UNTOLD_SUFFIXES)
    to_file = TO_Z_UP[mesh.up_axis].T
    name = mesh.files[0].name
    if not guess.sure:
        listed = "; ".join(direction_text(to_file @ np.asarray(up)) for up in guess.others)
        first = direction_text(to_file @ np.asarray(guess.others[0]))
        text = (
            f"{name}: which way is up is not clear: it may be {listed} of the file; {mesh.up_axis} is taken, as the format says; "
            f"--up-axis={first} says otherwise"
        )
        scene.warnings.append(Omission(text, OmissionKind.UP_UNCLEAR))
        return None, None
    if guess.tilt_deg <= ON_ITS_SIDE_DEG:
        return None, None
    up = to_file @ np.asarray(guess.up)
    number = int(np.abs(up).argmax())
    axis: UpAxis = ("x", "y", "z")[number]
    if abs(up[number]) < _ALONG:
        scene.warnings.append(
            f"{name}: its floor lies along no axis of the file: {direction_text(up)} is taken as up; --up-axis says otherwise"
        )
        return None, (float(up[0]), float(up[1]), float(up[2]))
    down = bool(up[number] < 0)
    scene.warnings.append(
        f"{name}: its floor lies across the {axis} axis of the file: {'-' if down else ''}{axis} is taken as up; --up-axis says otherwise"
    )
    straight = np.zeros(3)
    straight[number] = -1.0
    return axis, (float(straight[0]), float(straight[1]), float(straight[2])) if down else None


def _usd(source: Source, choices: ImportOptions) -> ImportedScene:
    scene = _scene(source, source.file.stem)
    scene.objects, warnings = read_usd(source.file, choices.up_axis, choices.unit_m)
    scene.warnings += warnings
    return scene


# Worlds


def _world(source: Source, choices: ImportOptions) -> ImportedScene:
    builder = read_scene(source.file, source.file)
    spec = builder.finish()
    out = from_spec(spec, _scene(source, spec.name))
    out.root, out.loader = spec.root, builder.loader
    return out


def from_spec(spec: SceneSpec, out: ImportedScene) -> ImportedScene:
    """Fills ``out`` from a loaded scene, whose files stay where they are."""
    out.warnings += list(spec.warnings)
    out.floors, out.ground_z = spec.floors, spec.ground_z
    out.gravity = spec.gravity if spec.gravity != (0.0, 0.0, -9.81) else None
    out.light = light_document(spec.light)
    for start in spec.starts:
        x, y, z = start.pose.position
        yaw = np.degrees(np.arctan2(*matrix_from_pose(start.pose)[[1, 0], 0]))
        out.starts.append({"name": start.name, "xyz": [x, y, z], "yaw_deg": round(float(yaw), 6)})
    loader = MeshLoader(scene_roots(spec), textures=False)
    left = assigned(spec)
    for visual in spec.visuals:
        out.objects.append(_object(visual, left.get(visual.name, []), loader))
    for collision in left.get(UNSEEN, []):
        shape, scale = _shape(collision.shape)
        out.objects.append(ImportedObject(collision.name, shape, collision.pose, scale, visible=False))
    return out


def light_document(light: LightSpec) -> dict[str, object]:
    """Returns the settings of ``light`` in a scene.yaml that differ from the defaults, without lamps and surroundings."""
    usual = LightSpec()
    names = ("sun_direction", "sun", "sun_color", "ambient", "background", "shadows")
    changed = {name: getattr(light, name) for name in names if getattr(light, name) != getattr(usual, name)}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in changed.items()}


def assigned(spec: SceneSpec) -> dict[str, list[CollisionSpec]]:
    """Returns the collision shapes of each visual, matched by name (also with a number behind it); ``UNSEEN``: those without a visual."""
    known = {v.name for v in spec.visuals}
    out: dict[str, list[CollisionSpec]] = {}
    for collision in spec.collisions:
        # The second shape of an object is called <object>_2.
        stem, _, number = collision.name.rpartition("_")
        owner = collision.name if collision.name in known else stem if number.isdecimal() and stem in known else UNSEEN
        out.setdefault(owner, []).append(collision)
    return out


def _object(visual: VisualSpec, collisions: list[CollisionSpec], loader: MeshLoader) -> ImportedObject:
    shape, scale = _shape(visual.shape)
    item = ImportedObject(
        visual.name, shape, visual.pose, scale, semantic_class=visual.semantic_class, color=visual.color, collision="none"
    )
    if not collisions:
        return item
    if len(collisions) == 1 and collisions[0].pose == visual.pose:
        only = collisions[0].shape
        if only == visual.shape:
            return replace(item, collision="same")
        if only.kind == "mesh" and visual.shape.kind == "mesh" and only.size == visual.shape.size:
            return replace(item, collision=Path(only.mesh))
    # In the frame of the visual, whose pose and scale also apply to the collision mesh.
    factors = np.diag([*scale, 1.0])
    to_visual = np.linalg.inv(matrix_from_pose(visual.pose) @ factors)
    parts = [part for c in collisions for part in loader.shape(c.shape).transformed(to_visual @ matrix_from_pose(c.pose)).parts]
    return replace(item, collision=Mesh(tuple(replace(p, uvs=None, colors=None) for p in parts)))


def _shape(shape: Shape) -> tuple[Path | dict[str, object], Vec3]:
    if shape.kind == "mesh":
        return Path(shape.mesh), shape.size
    if shape.kind == "box":
        return {"box": list(shape.size)}, (1.0, 1.0, 1.0)
    if shape.kind == "sphere":
        return {"sphere": shape.size[0]}, (1.0, 1.0, 1.0)
    return {"cylinder": {"radius": shape.size[0], "length": shape.size[1]}}, (1.0, 1.0, 1.0)
