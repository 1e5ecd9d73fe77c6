"""Reads COLLADA 1.4 and 1.5 (.dae): the geometry of the visual scene, with colours, textures and vertex colours.

The file's unit and up axis are applied. Skins are drawn in their bind pose, morphs in their base shape; animations, lights, cameras and physics
are left out with a warning.

pycollada (0.9.3) is not used, though it reads 300,000 triangles in a third of the time: it stops at holes in polygons, at files without a
namespace or a scene and at accessors without names, ignores skews, accessor offsets and bound sets of texture coordinates, and cuts concave
polygons into fans.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from gibson_sim.errors import MeshError
from gibson_sim.formats.dae_document import DaeDocument, Element, reference
from gibson_sim.formats.dae_geometry import DaePrimitive, read_geometry
from gibson_sim.formats.dae_materials import Binding, DaeMaterials
from gibson_sim.formats.mesh import F64, TO_Z_UP, Material, MeshPart, UpAxis, build_part
from gibson_sim.formats.textures import TextureStore, Warn
from gibson_sim.quoting import quoted

_UP: dict[str, UpAxis] = {"X_UP": "x", "Y_UP": "y", "Z_UP": "z"}
_MAX_INSTANCES = 100_000
"""Maximum number of node instances in the scene."""
_LEFT_OUT = {
    "library_animations/animation": "its animations are left out; everything stays in the pose of the nodes",
    "library_animation_clips/animation_clip": "its animations are left out; everything stays in the pose of the nodes",
    "scene/instance_physics_scene": "its physics is left out; bodies and joints are those of the robot or the scene",
    "scene/instance_kinematics_scene": "its kinematics is left out; bodies and joints are those of the robot or the scene",
    "library_force_fields/force_field": "its force fields are left out",
}
"""Path of elements -> what is left out with them."""
_LEFT_OUT_OF_NODES = {
    "instance_light": "its lights are left out, so that only the lights of the scene shine",
    "instance_camera": "its cameras are left out; add cameras to the robot or the scene",
}


def load_dae(
    path: Path, data: bytes, textures: TextureStore, files: list[Path], warn: Warn
) -> tuple[list[MeshPart], UpAxis, float]:
    """Returns the parts of a COLLADA file, metres, z up, and the file's up axis and unit, metres.

    Args:
        path: the file.
        data: its content.
        textures: finds and decodes the images that it names.
        files: list to which the paths of further files that are read are appended.
        warn: called with one line for each element that is left out or replaced.

    Raises:
        MeshError: the file is not a COLLADA file, or is corrupt.
        TextError: the file is not XML, or too large.
    """
    document = DaeDocument(path, data, warn)
    unit_m, up_axis = _unit(document), _up_axis(document)
    _warn_of_local_assets(document, unit_m, up_axis)
    for place, text in _LEFT_OUT.items():
        if document.root.find(place) is not None:
            document.warn(text)
    to_scene = np.eye(4)
    to_scene[:3, :3] = unit_m * TO_Z_UP[up_axis]
    return _DaeReader(document, DaeMaterials(document, textures, files)).parts(to_scene), up_axis, unit_m


def _unit(document: DaeDocument) -> float:
    """Returns the unit of a file, metres."""
    unit = document.root.find("asset/unit")
    text = "1" if unit is None else unit.get("meter", "1")
    value = _positive(document, text)
    if value is None:
        document.warn(f"<unit meter={quoted(text)}> is not a length; 1 is used")
    return 1.0 if value is None else value


def _positive(document: DaeDocument, text: str) -> float | None:
    """Returns a number above 0; None for another text."""
    try:
        values = document.numbers(text).tolist()
    except MeshError:
        return None
    return values[0] if len(values) == 1 and math.isfinite(values[0]) and values[0] > 0 else None


def _up_axis(document: DaeDocument) -> UpAxis:
    text = (document.root.findtext("asset/up_axis") or "Y_UP").strip()
    if text not in _UP:
        document.warn(f"<up_axis>{quoted(text)} is not one of {', '.join(_UP)}; Y_UP is used")
    return _UP.get(text, "y")


def _warn_of_local_assets(document: DaeDocument, unit_m: float, up_axis: UpAxis) -> None:
    """Warns of an <asset> of a part of the file that has another unit or up axis than that of the file."""
    for parent in document.root.iter():
        asset = None if parent is document.root else parent.find("asset")
        if asset is None:
            continue
        unit, up = asset.find("unit"), (asset.findtext("up_axis") or "").strip()
        other_unit = unit is not None and _positive(document, unit.get("meter", "1")) not in (None, unit_m)
        if other_unit or _UP.get(up, up_axis) != up_axis:
            name = quoted(parent.get("id"))
            document.warn(
                f"<asset> of <{parent.tag}> {name} has another unit or up axis, which is left out; those of the file are used"
            )


class _DaeReader:
    """Reader of the scene of one document."""

    def __init__(self, document: DaeDocument, materials: DaeMaterials) -> None:
        self.document = document
        self.materials = materials
        self.geometries = document.by_id("library_geometries/geometry")
        self.controllers = document.by_id("library_controllers/controller")
        self.nodes = document.by_id(".//node")
        self._instances = 0
        self._primitives: dict[str, list[DaePrimitive]] = {}

    def parts(self, to_scene: F64) -> list[MeshPart]:
        """Returns all parts, transformed by ``to_scene``, T_scene_file, (4, 4)."""
        scene = self._scene()
        parts: list[MeshPart] = []
        if scene is None:
            self.document.warn("has no visual scene; every geometry is drawn at the origin")
            for name in self.geometries:
                parts += self._geometry(name, None, to_scene)
            return parts
        for child in scene.iterfind("node"):
            parts += self._node(child, to_scene, ())
        return parts

    def _scene(self) -> Element | None:
        """Returns the scene that <scene> names, else the first of the file; None if it has none."""
        scenes = self.document.by_id("library_visual_scenes/visual_scene")
        instance = self.document.root.find("scene/instance_visual_scene")
        if instance is not None and reference(instance) in scenes:
            return scenes[reference(instance)]
        first = next(iter(scenes.values()), None)
        if first is not None and instance is not None:
            name = quoted(first.get("id"))
            self.document.warn(f"visual scene {quoted(instance.get('url'))} is not in the file; {name}, its first, is used")
        elif first is not None and len(scenes) > 1:
            self.document.warn(
                f"has {len(scenes)} visual scenes and no <scene> that names one; {quoted(first.get('id'))} is used"
            )
        return first

    def _node(self, node: Element, parent: F64, path: tuple[int, ...]) -> Iterator[MeshPart]:
        self._instances += 1
        if id(node) in path or self._instances > _MAX_INSTANCES:
            raise self.document.error(f"node {quoted(node.get('id'))} contains itself, or there are too many; the file is broken")
        matrix = parent
        for child in node:
            if child.tag in _TRANSFORMS:
                matrix = matrix @ self._transform(child)
        node_path = (*path, id(node))
        for child in node:
            if child.tag == "instance_geometry":
                yield from self._geometry(reference(child), child, matrix)
            elif child.tag == "instance_controller":
                yield from self._controller(reference(child), child, matrix, ())
            elif child.tag == "node":
                yield from self._node(child, matrix, node_path)
            elif child.tag == "instance_node":
                target = self.nodes.get(reference(child))
                if target is None:
                    self.document.warn(f"instance of node {quoted(child.get('url'))}, which is not in the file; left out")
                else:
                    yield from self._node(target, matrix, node_path)
            elif child.tag in _LEFT_OUT_OF_NODES:
                self.document.warn(_LEFT_OUT_OF_NODES[child.tag])

    def _transform(self, element: Element) -> F64:
        """Returns the (4, 4) matrix of a transform of a node."""
        values = self.document.numbers(element.text)
        count = _TRANSFORMS[element.tag]
        if len(values) != count or not np.isfinite(values).all():
            raise self.document.error(
                f"<{element.tag}> has {len(values)} numbers, must have {count}, all finite; the file is broken"
            )
        return _MATRICES[element.tag](values)

    def _controller(self, name: str, instance: Element, matrix: F64, path: tuple[str, ...]) -> list[MeshPart]:
        """Returns the parts of a skin in its bind pose, or of a morph in its base shape; ``path``: controllers that lead to it."""
        controller = self.controllers.get(name)
        if controller is None or name in path:
            self.document.warn(
                f"controller {quoted(name)} {'leads to itself' if name in path else 'is not in the file'}; left out"
            )
            return []
        skin, morph = controller.find("skin"), controller.find("morph")
        if skin is not None:
            self.document.warn(f"skin {quoted(name)} is drawn in its bind pose, without the pose of its joints")
            bind = skin.find("bind_shape_matrix")
            if bind is not None and (bind.text or "").strip():
                values = self.document.numbers(bind.text)
                if len(values) != 16:
                    raise self.document.error(f"<bind_shape_matrix> has {len(values)} numbers, must have 16; the file is broken")
                matrix = matrix @ _matrix(values)
            source = reference(skin, "source")
        elif morph is not None:
            self.document.warn(f"morph {quoted(name)} is drawn in its base shape, without its targets")
            source = reference(morph, "source")
        else:
            self.document.warn(f"controller {quoted(name)} is neither a skin nor a morph; left out")
            return []
        if source in self.controllers:
            return self._controller(source, instance, matrix, (*path, name))
        return self._geometry(source, instance, matrix)

    def _geometry(self, name: str, instance: Element | None, matrix: F64) -> list[MeshPart]:
        if name not in self.geometries:
            self.document.warn(f"geometry {quoted(name)} is not in the file; left out")
            return []
        if name not in self._primitives:
            self._primitives[name] = read_geometry(self.document, self.geometries[name])
        bindings = self.materials.bindings(instance)
        parts = []
        for primitive in self._primitives[name]:
            binding = bindings.get(primitive.symbol, Binding(primitive.symbol, {}))
            material, texcoord = self.materials.get(binding.material) if primitive.symbol else (Material(), "")
            piece = primitive.read(self._uv_set(name, primitive, binding, material, texcoord))
            if piece.colors is not None:
                # Vertex colours multiply those of the material; a surface without a material has theirs alone.
                material = (
                    replace(material, colored=True) if primitive.symbol else Material("", (1.0, 1.0, 1.0, 1.0), colored=True)
                )
            part = build_part(
                str(self.document.path), piece.vertices, piece.triangles, piece.normals, piece.uvs, material, matrix, piece.colors
            )
            if part is not None:
                parts.append(part)
        return parts

    def _uv_set(self, name: str, primitive: DaePrimitive, binding: Binding, material: Material, texcoord: str) -> int | None:
        """Returns the set of texture coordinates that a material reads: that which is bound to it, else the lowest; None = there is none."""
        if len(primitive.sets) < 2:
            return primitive.sets[0] if primitive.sets else None
        bound = binding.uv_sets.get(texcoord)
        if bound in primitive.sets:
            return bound
        lowest = primitive.sets[0]
        if material.texture is not None or material.emissive_texture is not None:
            which = "no <bind_vertex_input> says which it reads" if bound is None else f"it is bound to set {bound}"
            self.document.warn(
                f"geometry {quoted(name)} has sets {', '.join(map(str, primitive.sets))} of texture coordinates; for material "
                f"{quoted(binding.material)}, {which}; set {lowest} is used"
            )
        return lowest


# Transforms, (4, 4)


def _matrix(values: F64) -> F64:
    return values.reshape(4, 4)


def _translate(values: F64) -> F64:
    matrix = np.eye(4)
    matrix[:3, 3] = values
    return matrix


def _scale(values: F64) -> F64:
    return np.diag([*values, 1.0])


def _rotate(values: F64) -> F64:
    """Returns the rotation about an axis by an angle in degrees (Rodrigues' formula); the identity for an axis without direction."""
    length = np.linalg.norm(values[:3])
    matrix = np.eye(4)
    if length == 0.0:
        return matrix
    x, y, z = values[:3] / length
    angle = math.radians(values[3])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return matrix


def _skew(values: F64) -> F64:
    """Returns the shear along the second axis that turns the first axis towards it by an angle in degrees, as RiSkew of RenderMan."""
    matrix = np.eye(4)
    turned, along = _direction(values[1:4]), _direction(values[4:7])
    across = _direction(turned - (turned @ along) * along)
    between = math.atan2(float(turned @ across), float(turned @ along))
    rest = between - math.radians(values[0])
    if not across.any() or not 0.0 < rest < math.pi:
        return matrix
    matrix[:3, :3] += (1 / math.tan(rest) - 1 / math.tan(between)) * np.outer(along, across)
    return matrix


def _look_at(values: F64) -> F64:
    """Returns the pose at an eye point whose -z axis points to a point of interest, and whose y axis is near an up axis."""
    eye, interest, up = values.reshape(3, 3)
    matrix = np.eye(4)
    matrix[:3, 3] = eye
    back = _direction(eye - interest)
    right = _direction(np.cross(up, back))
    if right.any():
        matrix[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
    return matrix


def _direction(vector: F64) -> F64:
    """Returns a vector of length 1; 0 for one without direction."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-12 else np.zeros(3)


_TRANSFORMS = {"matrix": 16, "translate": 3, "scale": 3, "rotate": 4, "skew": 7, "lookat": 9}
"""Number of values of each transform."""
_MATRICES = {"matrix": _matrix, "translate": _translate, "scale": _scale, "rotate": _rotate, "skew": _skew, "lookat": _look_at}
