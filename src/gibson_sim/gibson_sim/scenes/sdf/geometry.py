"""Reads the <geometry> of SDF: shapes, planes as thin boxes, and meshes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.description.shapes import Shape, ShapeKind
from gibson_sim.errors import MeshError
from gibson_sim.formats.mesh import UpAxis
from gibson_sim.formats.uris import UriResolver, fuel_model
from gibson_sim.quoting import quoted
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.sdf.elements import F64, Element, name_of, numbers, pose_matrix, text_of
from gibson_sim.scenes.sdf.scopes import Scope, reference_of
from gibson_sim.types import Vec3

_PRIMITIVES: dict[str, tuple[ShapeKind, tuple[str, ...], int]] = {
    "box": ("box", ("size",), 3),
    "sphere": ("sphere", ("radius",), 1),
    "cylinder": ("cylinder", ("radius", "length"), 2),
    "capsule": ("capsule", ("radius", "length"), 2),
    "cone": ("cone", ("radius", "length"), 2),
    "ellipsoid": ("ellipsoid", ("radii",), 3),
}
"""Tag of a primitive -> its kind, the tags of its sizes, and their count."""
_PLANE_THICKNESS = 0.01
"""Thickness of the box that represents a plane, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedShape:
    """A shape of a <visual> or <collision>."""

    shape: Shape
    matrix: F64
    """Pose of the shape, (4, 4)."""
    T_plane: F64 | None = None
    """Pose of the <plane> that the shape represents, whose z axis is the normal, (4, 4); None for other shapes."""


class SdfShapes:
    """Reads the shapes of one scene.

    Args:
        builder: reads the meshes, and collects the warnings.
        uris: finds the meshes.
    """

    def __init__(self, builder: SceneBuilder, uris: UriResolver) -> None:
        self.builder = builder
        self.uris = uris

    def read(self, scope: Scope, element: Element, T_scope: F64, T_link: F64, where: str) -> Iterator[PlacedShape]:
        """Yields the shapes of a <visual> or <collision>; skips invalid ones with a warning.

        Args:
            scope: that of its link.
            element: the <visual> or <collision>.
            T_scope: pose of the scope, (4, 4).
            T_link: pose of the link, (4, 4).
            where: link or model, for warnings.
        """
        geometry = element.find("geometry")
        shapes = [] if geometry is None else [kind for kind in geometry if ":" not in kind.tag and "{" not in kind.tag]
        if not shapes:
            what = f"<{element.tag}> {quoted(name_of(element))}"
            missing = "has no <geometry>" if geometry is None else "has a <geometry> without a shape"
            self.builder.warn(f"{where}: {what} {missing}; left out", OmissionKind.INVALID)
            return
        if len(shapes) > 1:
            tags = ", ".join(f"<{kind.tag}>" for kind in shapes)
            what = f"<{element.tag}> {quoted(name_of(element))}"
            self.builder.warn(f"{where}: the <geometry> of {what} has several shapes, {tags}, must have one; the first is used")
        reference = reference_of(element)
        parent = T_scope @ scope.pose(reference) if reference else T_link
        matrix = parent @ pose_matrix(element, where, self.builder.warn)
        for kind in shapes[:1]:
            if kind.tag == "mesh":
                yield from self._mesh(kind, matrix, where, scope)
            elif kind.tag == "plane":
                yield self._plane(kind, matrix, where)
            elif kind.tag in _PRIMITIVES:
                shape = _primitive(kind)
                if shape is None:
                    sizes = " ".join(text_of(kind, tag) or "nothing" for tag in _PRIMITIVES[kind.tag][1])
                    text = f"{where}: {kind.tag} is {sizes} large, must be finite and above 0; left out"
                    self.builder.warn(text, OmissionKind.INVALID)
                else:
                    yield PlacedShape(shape, matrix)
            elif kind.tag != "empty":
                text = f"{where}: geometry <{kind.tag}> is not supported; left out"
                self.builder.warn(text, OmissionKind.UNSUPPORTED_ELEMENT)

    def _mesh(self, element: Element, matrix: F64, where: str, scope: Scope) -> Iterator[PlacedShape]:
        uri = text_of(element, "uri") or text_of(element, "filename")
        path = self.uris.find(uri, scope.base) if uri else None
        if path is None:
            reason = self.uris.reason_missing(uri) if uri else "does not exist"
            model = fuel_model(uri)
            # One line for all meshes of a model, wherever they stand.
            text = (
                f"model {model} {reason}; its meshes are left out"
                if model
                else f"{where}: mesh {uri or '(without a uri)'} {reason}; left out"
            )
            self.builder.warn(text, OmissionKind.MISSING_ASSET)
            return
        text_of_scale = element.findtext("scale") or "1 1 1"
        scale = numbers(text_of_scale, (3,)) or [0.0]
        if not all(scale):
            text = f"{where}: scale of {path.name} is {text_of_scale.strip()}, must be three finite numbers, none of them 0; left out"
            self.builder.warn(text, OmissionKind.INVALID)
            return
        if element.find("submesh") is not None:
            text = f"{where}: <submesh> of {path.name} is not supported; the whole mesh is used"
            self.builder.warn(text, OmissionKind.UNSUPPORTED_ELEMENT)
        if element.get("optimization", "").strip():
            self.builder.warn(
                f"{where}: optimization {quoted(element.get('optimization'))} of {path.name} has no effect: meshes that are fixed collide "
                "with all their triangles, others as their convex hulls"
            )
        try:
            # Gazebo ignores the up_axis of a DAE, and worlds rely on that.
            up_axis: UpAxis | None = "z" if path.suffix.lower() == ".dae" else None
            yield PlacedShape(*self.builder.mesh_shape(path, matrix, (scale[0], scale[1], scale[2]), up_axis))
        except MeshError as e:
            self.builder.warn(f"{where}: {e}; left out", OmissionKind.UNSUPPORTED_ASSET)

    def _plane(self, element: Element, matrix: F64, where: str) -> PlacedShape:
        """Returns a thin box whose upper face is the <plane>."""
        sizes = []
        for tag, default, count in (("size", [1.0, 1.0], 2), ("normal", [0.0, 0.0, 1.0], 3)):
            text = text_of(element, tag)
            values = numbers(text, (count,)) if text else default
            if values is None or not any(values) or (tag == "size" and min(values) <= 0.0):
                low = "above 0" if tag == "size" else "not all 0"
                self.builder.warn(
                    f"{where}: <{tag}> of a plane is {quoted(text)}, must be {count} numbers {low}; {default} is used",
                    OmissionKind.INVALID,
                )
                values = default
            sizes.append(values)
        (x, y), normal = sizes
        T_plane = matrix @ _rotation_from_z(np.array(normal))
        T_face_box = np.eye(4)
        T_face_box[2, 3] = -_PLANE_THICKNESS / 2
        return PlacedShape(Shape("box", (max(x, 1e-3), max(y, 1e-3), _PLANE_THICKNESS)), T_plane @ T_face_box, T_plane)


def _primitive(element: Element) -> Shape | None:
    """Returns the shape of a primitive; None for invalid sizes."""
    kind, tags, count = _PRIMITIVES[element.tag]
    values = numbers(" ".join(element.findtext(tag) or "" for tag in tags), (count,))
    if values is None or min(values) <= 0:
        return None
    padded = [*values, 0.0, 0.0][:3]
    size: Vec3 = (padded[0], padded[1], padded[2])
    return Shape(kind, size)


def _rotation_from_z(normal: F64) -> F64:
    """Returns a rotation (4, 4) that maps the z axis to ``normal`` (3,), which must not be 0."""
    matrix = np.eye(4)
    z = normal / np.linalg.norm(normal)
    if z[2] < 1 - 1e-9:
        x = np.cross([0.0, 1.0, 0.0], z) if abs(z[1]) < 0.9 else np.cross([1.0, 0.0, 0.0], z)
        x /= np.linalg.norm(x)
        matrix[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return matrix
