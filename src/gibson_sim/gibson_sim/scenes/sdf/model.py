"""Reads SDF models (1.4 to 1.9): frames, nested models and includes, visuals, collision shapes and materials.

Models become static shapes of the scene, without joints, masses and sensors; ``sdf.body`` reads models as bodies for physics.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.description.shapes import Shape, ShapeKind
from gibson_sim.errors import MeshError, SceneError, TextError
from gibson_sim.formats.mesh import UpAxis
from gibson_sim.formats.uris import UriResolver
from gibson_sim.geometry.transforms import invert, matrix_from_pose, matrix_from_quat, pose_from_xyz_rpy
from gibson_sim.quoting import clipped, quoted
from gibson_sim.reading import is_file, parse_xml, read_file
from gibson_sim.scenes.builder import FAR_AWAY, SceneBuilder, class_from_model
from gibson_sim.types import Rgba, Vec3

Element = ElementTree.Element
F64 = NDArray[np.float64]
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
_SCRIPT_COLORS: dict[str, Rgba] = {
    "White": (1.0, 1.0, 1.0, 1.0), "Grey": (0.7, 0.7, 0.7, 1.0), "DarkGrey": (0.18, 0.18, 0.18, 1.0),
    "Black": (0.0, 0.0, 0.0, 1.0), "Red": (1.0, 0.0, 0.0, 1.0), "Green": (0.0, 1.0, 0.0, 1.0), "Blue": (0.0, 0.0, 1.0, 1.0),
    "Yellow": (1.0, 1.0, 0.0, 1.0), "Orange": (1.0, 0.5, 0.0, 1.0), "Purple": (1.0, 0.0, 1.0, 1.0), "Wood": (0.6, 0.4, 0.2, 1.0),
    "FlatBlack": (0.1, 0.1, 0.1, 1.0),
}  # fmt: skip
"""Name of a Gazebo material script -> colour, sRGB and alpha, 0 to 1."""
_PLAIN_GREY: Rgba = (0.7, 0.7, 0.7, 1.0)
"""Colour of collision shapes that are drawn in place of missing visuals, sRGB and alpha."""
_MAX_NESTING = 16
"""Maximum nesting depth of models and frames."""
_MAX_MODELS = 10_000
"""Maximum number of models of a scene, including nested and included models."""


@dataclass(frozen=True, slots=True, eq=False)
class IncludedModel:
    """The model that an <include> names."""

    model: Element
    T_parent_model: F64
    """Pose in the frame of the parent, (4, 4)."""
    file: Path
    name: str
    """Name in the <include>, else that of the model, else that of its folder."""


class SdfModels:
    """Reads the models of one scene, and adds them to its builder."""

    def __init__(self, builder: SceneBuilder, uris: UriResolver) -> None:
        self.builder = builder
        self.uris = uris
        self._documents: dict[Path, Element] = {}
        self._versions: dict[Path, tuple[int, ...]] = {}
        self._placed = 0

    # Poses

    def pose(self, parent: Element, where: str) -> F64:
        """Returns the pose (4, 4) in an element's <pose>, in the frame that it is relative to; the identity if it is missing."""
        element = parent.find("pose")
        if element is None or not (element.text or "").strip():
            return np.eye(4)
        values = numbers(element.text, (3, 6, 7))
        if values is None:
            text = " ".join((element.text or "").split())
            self.builder.warn(f"{where}: <pose> {quoted(text)} is not six numbers; zero is used", OmissionKind.INVALID)
            return np.eye(4)
        xyz: Vec3 = (values[0], values[1], values[2])
        if len(values) == 7:
            matrix = np.eye(4)
            quat = np.array(values[3:])
            matrix[:3, :3] = matrix_from_quat(quat / np.linalg.norm(quat)) if quat.any() else np.eye(3)
            matrix[:3, 3] = xyz
            return matrix
        roll, pitch, yaw = values[3:] or (0.0, 0.0, 0.0)
        if element.get("degrees", "false").strip().lower() in ("true", "1"):
            roll, pitch, yaw = math.radians(roll), math.radians(pitch), math.radians(yaw)
        return matrix_from_pose(pose_from_xyz_rpy(xyz, (roll, pitch, yaw)))

    def frame(self, model: Element, name: str, where: str, depth: int = 0) -> F64:
        """Returns T_model_frame, (4, 4), of a link, joint, frame or nested model of ``model`` by name."""
        if name in ("", "__model__", model.get("name")):
            return np.eye(4)
        if depth > _MAX_NESTING:
            self.builder.warn(
                f"{where}: frame {quoted(name)} is relative to itself; that of the model is used", OmissionKind.INVALID
            )
            return np.eye(4)
        for child in model:
            if child.tag in ("link", "frame", "joint", "model", "include") and name_of(child) == name:
                return self.placed(model, child, where, depth)
        head, _, rest = name.partition("::")
        for child in model if rest else ():
            if child.tag == "model" and name_of(child) == head:
                return self.placed(model, child, where, depth) @ self.frame(child, rest, where, depth + 1)
        self.builder.warn(f"{where}: frame {quoted(name)} is unknown; that of the model is used", OmissionKind.INVALID)
        return np.eye(4)

    def placed(self, model: Element, child: Element, where: str, depth: int = 0) -> F64:
        """Returns T_model_child, (4, 4), of a child element, whose pose may be relative to another frame of the model (SDF 1.7 and later)."""
        pose = child.find("pose")
        reference = "" if pose is None else pose.get("relative_to", "")
        if not reference and child.tag == "frame":
            reference = child.get("attached_to", "")
        if not reference and child.tag == "joint":
            reference = (child.findtext("child") or "").strip()
        local = self.pose(child, where)
        return self.frame(model, reference, where, depth + 1) @ local if reference else local

    # Models

    def document(self, path: Path) -> Element | None:
        """Returns the <model> of an SDF file, or None after a warning; each file is parsed once."""
        if path not in self._documents:
            if not self.builder.admits(path):
                self.builder.warn(f"{path}: lies outside the scene's folder; left out", OmissionKind.UNSUPPORTED_ASSET)
                return None
            root = read_sdf(self.builder, path)
            model = root.find("model") if root.tag == "sdf" else root if root.tag == "model" else None
            if model is None:
                self.builder.warn(f"{path}: holds no <model>; left out", OmissionKind.UNSUPPORTED_ASSET)
                return None
            self._documents[path] = model
            self._versions[path] = sdf_version(root)
        return self._documents[path]

    def version(self, path: Path) -> tuple[int, ...]:
        """Returns the SDF version of a file that ``document`` has read."""
        return self._versions[path]

    def included(
        self, element: Element, base: Path, parent: Element | None = None, files: tuple[Path, ...] = ()
    ) -> IncludedModel | None:
        """Returns the model that an <include> names, or None after a warning.

        Args:
            element: the <include>.
            base: folder of the file with the <include>.
            parent: the <model> or <world> with the <include>; None = its pose is not relative to another frame.
            files: resolved paths of the chain of including files, the outermost first, for the detection of cycles.
        """
        uri = (element.findtext("uri") or "").strip()
        try:
            path = self.find_model(uri, base)
            model = None if path is None else self.document(path)
        except SceneError as e:
            self.builder.warn(f"{e}; left out", OmissionKind.UNSUPPORTED_ASSET)
            return None
        if path is None or model is None:
            return None
        name = (element.findtext("name") or "").strip() or model.get("name", "") or path.parent.name
        if Path(os.path.realpath(path)) in files:
            self.builder.warn(f"model {name}: {path} includes itself; the inner one is left out", OmissionKind.INVALID)
            return None
        if element.find("pose") is None:
            T_parent_model = self.pose(model, name)
        else:
            T_parent_model = self.pose(element, name) if parent is None else self.placed(parent, element, name)
        return IncludedModel(model, T_parent_model, path, name)

    def include(
        self,
        element: Element,
        T_world_parent: F64,
        top: str,
        base: Path,
        depth: int,
        parent: Element | None = None,
        files: tuple[Path, ...] = (),
    ) -> None:
        """Adds the model that an <include> names; the arguments are those of ``model`` and ``included``."""
        included = self.included(element, base, parent, files)
        if included is not None:
            kind = _model_name((element.findtext("uri") or "").strip(), included.model)
            T_world_model = T_world_parent @ included.T_parent_model
            inner = (*files, Path(os.path.realpath(included.file)))
            self.model(included.model, T_world_model, top or included.name, included.file.parent, depth + 1, kind, inner)

    def find_model(self, uri: str, base: Path) -> Path | None:
        """Returns the SDF file of the model at a URI, or None with a warning; ``base``: folder of relative URIs."""
        location = self.uris.find(uri, base) if uri else None
        if location is None:
            reason = "is on the network: download it and name the copy" if uri.startswith("http") else "does not exist"
            self.builder.warn(f"model {uri or '(without a uri)'} {reason}; left out", OmissionKind.MISSING_ASSET)
            return None
        if is_file(location):
            return location
        for candidate in sdf_files(location):
            if is_file(candidate):
                return candidate
        self.builder.warn(f"model {uri}: {location} holds no model.sdf; left out", OmissionKind.MISSING_ASSET)
        return None

    def model(
        self,
        model: Element,
        T_world_model: F64,
        top: str,
        base: Path,
        depth: int = 0,
        kind: str = "",
        files: tuple[Path, ...] = (),
    ) -> None:
        """Adds a model with all its elements.

        Args:
            model: the <model>.
            T_world_model: (4, 4), with the model's own <pose>.
            top: name of the outermost model, which becomes the name of the shapes.
            base: folder of the file with the model.
            depth: nesting depth of the model.
            kind: name from which the semantic class is derived, empty = the name of the model.
            files: resolved paths of the chain of including files, the outermost first, for the detection of cycles.
        """
        where = f"model {top}"
        self.check_nesting(where, depth)
        if not np.isfinite(T_world_model).all() or np.abs(T_world_model[:3, 3]).max() > FAR_AWAY:
            at = ", ".join(f"{c:g}" for c in T_world_model[:3, 3])
            self.builder.warn(
                f"{where}: is at ({at}) m, more than {FAR_AWAY:g} m from the origin; left out", OmissionKind.INVALID
            )
            return
        kind = kind or model.get("name", "")
        for child in model:
            if child.tag == "include":
                self.include(child, T_world_model, top, base, depth, model, files)
            elif child.tag == "model":
                self.model(child, T_world_model @ self.placed(model, child, where), top, base, depth + 1, files=files)
        links = [(link, T_world_model @ self.placed(model, link, where)) for link in model.iterfind("link")]
        has_collision = any(link.find("collision") is not None for link, _ in links)
        visual_count, collision_count = 0, 0
        for link, T_world_link in links:
            visuals = [
                self._visual(model, element, T_world_model, T_world_link, top, base, class_from_model(kind), not has_collision)
                for element in link.iterfind("visual")
            ]
            visual_count += sum(visuals)
            # If all visuals are missing, the collision shapes are drawn, so that the link is not an invisible obstacle.
            visuals_missing = bool(visuals) and not any(visuals)
            for element in link.iterfind("collision"):
                for shape, matrix, plane in self.shapes(model, element, T_world_model, T_world_link, top, base):
                    if plane:
                        self._ground(matrix, where)
                        continue
                    collision_count += 1
                    self.builder.add_collision(top, shape, matrix)
                    if visuals_missing:
                        visual_count += 1
                        self.builder.add_visual(top, shape, matrix, _PLAIN_GREY, class_from_model(kind))
                        self.builder.warn(
                            f"{where}: is drawn as its collision shapes, in plain grey: its visuals cannot be drawn"
                        )
        if collision_count and not visual_count:
            self.builder.warn(f"{where}: is invisible: it has collision shapes, but no visual")

    def _visual(
        self,
        model: Element,
        element: Element,
        T_world_model: F64,
        T_world_link: F64,
        top: str,
        base: Path,
        kind: str,
        collides: bool,
    ) -> bool:
        """Adds a <visual>; returns whether it is drawn, or invisible on purpose."""
        color, visible = visual_color(element)
        geometry = element.find("geometry")
        handled = not visible or geometry is None or geometry.find("empty") is not None
        for shape, matrix, _ in self.shapes(model, element, T_world_model, T_world_link, top, base):
            handled = True
            warning = unsupported_material(element, self.builder.has_textures(shape)) if visible else ""
            if warning:
                self.builder.warn(f"model {top}: {warning}", OmissionKind.UNSUPPORTED_ASSET)
            if visible:
                self.builder.add_visual(top, shape, matrix, color, kind)
            if collides:
                self.builder.add_collision(top, shape, matrix)
        return handled

    def _ground(self, matrix: F64, where: str) -> None:
        """Sets the ground of the scene to a level plane at T_world_box, (4, 4)."""
        if matrix[2, 2] < 0.999:
            text = f"{where}: a plane that is not level cannot be a collision shape; left out"
            self.builder.warn(text, OmissionKind.UNSUPPORTED_ELEMENT)
            return
        # The origin of the box is half its thickness below the plane.
        height = float(matrix[2, 3]) + _PLANE_THICKNESS / 2
        self.builder.ground_z = height if self.builder.ground_z is None else max(height, self.builder.ground_z)

    def check_nesting(self, where: str, depth: int) -> None:
        """Counts a model of the scene.

        Raises:
            SceneError: the model is nested too deeply, or the scene has too many models.
        """
        self._placed += 1
        if depth > _MAX_NESTING:
            raise SceneError(f"{where}: models are nested deeper than {_MAX_NESTING}; nest fewer")
        if self._placed > _MAX_MODELS:
            raise SceneError(f"{where}: the scene has more than {_MAX_MODELS} models; do models include each other?")

    def shapes(
        self, model: Element, element: Element, T_world_model: F64, T_world_link: F64, top: str, base: Path
    ) -> Iterator[tuple[Shape, F64, bool]]:
        """Yields the shapes of a <visual> or <collision>, each with T_world_shape and whether it is a plane; skips invalid ones with a warning.

        Args:
            model: the <model>.
            element: the <visual> or <collision>.
            T_world_model: pose of the model, (4, 4).
            T_world_link: pose of the link, (4, 4).
            top: name of the outermost model, for warnings.
            base: folder of relative file names.
        """
        where = f"model {top}"
        geometry = element.find("geometry")
        if geometry is None:
            return
        pose = element.find("pose")
        reference = "" if pose is None else pose.get("relative_to", "")
        parent = T_world_model @ self.frame(model, reference, where) if reference else T_world_link
        matrix = parent @ self.pose(element, where)
        for kind in geometry:
            size = _primitive(kind)
            if kind.tag == "mesh":
                yield from ((shape, at, False) for shape, at in self._mesh(kind, matrix, where, base))
            elif kind.tag == "plane":
                yield (*_plane_box(kind, matrix), True)
            elif size is not None:
                yield size, matrix, False
            elif kind.tag in _PRIMITIVES:
                sizes = " ".join((kind.findtext(tag) or "").strip() or "nothing" for tag in _PRIMITIVES[kind.tag][1])
                text = f"{where}: <{kind.tag}> has size {sizes}, must be finite numbers above 0; left out"
                self.builder.warn(text, OmissionKind.INVALID)
            elif kind.tag != "empty":
                text = f"{where}: geometry <{kind.tag}> is not supported; left out"
                self.builder.warn(text, OmissionKind.UNSUPPORTED_ELEMENT)

    def _mesh(self, element: Element, matrix: F64, where: str, base: Path) -> Iterator[tuple[Shape, F64]]:
        uri = (element.findtext("uri") or element.findtext("filename") or "").strip()
        path = self.uris.find(uri, base) if uri else None
        if path is None:
            text = f"{where}: mesh {uri or '(without a uri)'} does not exist; left out"
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
        try:
            # Gazebo ignores the up_axis of a DAE, and worlds rely on that.
            up_axis: UpAxis | None = "z" if path.suffix.lower() == ".dae" else None
            yield self.builder.mesh_shape(path, matrix, (scale[0], scale[1], scale[2]), up_axis)
        except MeshError as e:
            self.builder.warn(f"{where}: {e}; left out", OmissionKind.UNSUPPORTED_ASSET)

    def weld(self, model: Element, T_world_child: F64, child: str, where: str) -> F64:
        """Returns T_world_model, (4, 4), such that the model's frame ``child`` is at T_world_child (4, 4)."""
        return T_world_child @ invert(self.frame(model, child, where))


def read_sdf(builder: SceneBuilder, path: Path) -> Element:
    """Returns the root element of an SDF file, and adds the file to the scene's digest.

    Raises:
        SceneError: the file cannot be read, or is not XML.
    """
    try:
        return parse_xml(builder.read_bytes(path))
    except TextError as e:
        raise SceneError(f"{path}: {e}").with_public(e.public) from e


def sdf_files(folder: Path) -> list[Path]:
    """Returns the candidate SDF files of a model folder: those in its model.config, the newest version first, then model.sdf."""
    named: list[tuple[tuple[float, ...], Path]] = []
    config = folder / "model.config"
    try:
        for element in parse_xml(read_file(config)).iterfind("sdf") if is_file(config) else ():
            version = tuple(float(v) for v in element.get("version", "0").split(".") if v.isdigit())
            named.append((version, folder / (element.text or "").strip()))
    except (OSError, TextError):
        # Without a readable model.config only the default name remains.
        named = []
    return [path for _, path in sorted(named, reverse=True)] + [folder / "model.sdf"]


def sdf_version(root: Element) -> tuple[int, ...]:
    """Returns the version of an <sdf> element, such as (1, 7)."""
    return tuple(int(part) for part in root.get("version", "").split(".") if part.isdecimal())


def name_of(element: Element) -> str:
    """Returns the name of an element: its attribute ``name``, or the <name> of an <include>."""
    return element.get("name", "") or (element.findtext("name") or "").strip()


def numbers(text: str | None, counts: tuple[int, ...]) -> list[float] | None:
    """Returns the numbers in an element's text; None if one is not finite, or their count is not in ``counts``."""
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        return None
    return values if len(values) in counts and all(map(math.isfinite, values)) else None


def visual_color(element: Element) -> tuple[Rgba | None, bool]:
    """Returns the colour of a <visual>, sRGB and alpha, None = that of the mesh, and whether it is visible."""
    transparency = numbers(element.findtext("transparency"), (1,)) or [0.0]
    alpha = 1.0 - min(max(transparency[0], 0.0), 1.0)
    if alpha < 0.01:
        return None, False
    material = element.find("material")
    if material is None:
        return None, True
    script = (material.findtext("script/name") or "").strip().removeprefix("Gazebo/")
    base = _SCRIPT_COLORS.get(script)
    values = numbers(material.findtext("diffuse"), (3, 4))
    if values is not None and material.find("pbr") is None:
        r, g, b, a = (min(max(v, 0.0), 1.0) for v in ([*values, 1.0][:4]))
        base = (r, g, b, a or 1.0)
    if base is None or (base[:3] == (1.0, 1.0, 1.0) and element.find("geometry/mesh") is not None and not script):
        return None, True
    return (*base[:3], base[3] * alpha), True


def unsupported_material(element: Element, textured: bool) -> str:
    """Returns a warning about a part of a <visual>'s material that is not drawn; empty = none.

    Args:
        element: the <visual>.
        textured: whether its mesh has textures, which usually are those of the <pbr>.
    """
    material = element.find("material")
    if material is None:
        return ""
    name = (material.findtext("script/name") or "").strip()
    if name and name.removeprefix("Gazebo/") not in _SCRIPT_COLORS and material.find("diffuse") is None:
        return f"material script {clipped(name, 80)} is not read: its texture and colours are not drawn"
    image = (material.findtext(".//albedo_map") or "").strip()
    return f"texture {clipped(image, 120)} of its <pbr> material is not drawn" if image and not textured else ""


def _model_name(uri: str, model: Element) -> str:
    """Returns the name from which the semantic class of an included model is derived: that of its folder, else that of the model."""
    parts = [p for p in uri.partition("://")[2].split("/") if p and p != "models"]
    return parts[0] if parts and uri.startswith(("model://", "file://")) else model.get("name", "")


def _primitive(element: Element) -> Shape | None:
    """Returns the shape of a primitive; None for other elements, and for invalid sizes."""
    if element.tag not in _PRIMITIVES:
        return None
    kind, tags, count = _PRIMITIVES[element.tag]
    values = numbers(" ".join(element.findtext(tag) or "" for tag in tags), (count,))
    if values is None or min(values) <= 0:
        return None
    padded = [*values, 0.0, 0.0][:3]
    size: Vec3 = (padded[0], padded[1], padded[2])
    return Shape(kind, size)


def _plane_box(element: Element, matrix: F64) -> tuple[Shape, F64]:
    """Returns a thin box whose upper face is the <plane>, and T_world_box, (4, 4); ``matrix``: T_world_plane, (4, 4)."""
    x, y = (numbers(element.findtext("size"), (2,)) or [1.0, 1.0])[:2]
    normal = np.array(numbers(element.findtext("normal"), (3,)) or [0.0, 0.0, 1.0])
    T_world_face = matrix @ _rotation_from_z(normal)
    T_face_box = np.eye(4)
    T_face_box[2, 3] = -_PLANE_THICKNESS / 2
    return Shape("box", (max(x, 1e-3), max(y, 1e-3), _PLANE_THICKNESS)), T_world_face @ T_face_box


def _rotation_from_z(normal: F64) -> F64:
    """Returns a rotation (4, 4) that maps the z axis to ``normal`` (3,)."""
    matrix = np.eye(4)
    length = np.linalg.norm(normal)
    if length == 0:
        return matrix
    z = normal / length
    if z[2] < 1 - 1e-9:
        x = np.cross([0.0, 1.0, 0.0], z) if abs(z[1]) < 0.9 else np.cross([1.0, 0.0, 0.0], z)
        x /= np.linalg.norm(x)
        matrix[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return matrix
