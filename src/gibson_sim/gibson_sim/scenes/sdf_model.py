"""Reads SDF models (1.4 to 1.9): links, frames, nested models and includes, visuals and collisions.

Every model is placed where it starts and stays there: joints, masses and sensors are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import MeshError, SceneError
from gibson_sim.geometry.transforms import invert, matrix_from_pose, matrix_from_quat, pose_from_xyz_rpy
from gibson_sim.robots.spec import Shape, ShapeKind
from gibson_sim.scenes.builder import FAR_AWAY, SceneBuilder, class_from_model
from gibson_sim.scenes.mesh_types import UpAxis
from gibson_sim.scenes.textures import is_inside
from gibson_sim.scenes.uris import UriResolver
from gibson_sim.types import Rgba, Vec3

Element = ElementTree.Element
F64 = NDArray[np.float64]
_MAX_NESTING = 16
_PLANE_THICKNESS = 0.01
_SCRIPT_COLORS: dict[str, Rgba] = {
    "White": (1.0, 1.0, 1.0, 1.0), "Grey": (0.7, 0.7, 0.7, 1.0), "DarkGrey": (0.18, 0.18, 0.18, 1.0),
    "Black": (0.0, 0.0, 0.0, 1.0), "Red": (1.0, 0.0, 0.0, 1.0), "Green": (0.0, 1.0, 0.0, 1.0), "Blue": (0.0, 0.0, 1.0, 1.0),
    "Yellow": (1.0, 1.0, 0.0, 1.0), "Orange": (1.0, 0.5, 0.0, 1.0), "Purple": (1.0, 0.0, 1.0, 1.0), "Wood": (0.6, 0.4, 0.2, 1.0),
}  # fmt: skip


def parse_xml(builder: SceneBuilder, path: Path) -> Element:
    """Returns the root of an SDF file.

    Raises:
        SceneError: it is not there or no XML.
    """
    try:
        return ElementTree.fromstring(builder.read_bytes(path))
    except ElementTree.ParseError as e:
        raise SceneError(f"{path}: is no well-formed XML: {e}") from e


def numbers(text: str | None, counts: tuple[int, ...]) -> list[float] | None:
    """Returns the numbers in an element's text, or None if they are not finite or not as many as one of ``counts``."""
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        return None
    return values if len(values) in counts and all(map(math.isfinite, values)) else None


class SdfModels:
    """Places models of one scene."""

    def __init__(self, builder: SceneBuilder, uris: UriResolver) -> None:
        self.builder = builder
        self.uris = uris
        self._documents: dict[Path, Element] = {}

    # Poses

    def pose(self, parent: Element, where: str) -> F64:
        """Returns the (4, 4) pose that an element's <pose> says, whatever it is relative to; identity if it has none."""
        element = parent.find("pose")
        if element is None or not (element.text or "").strip():
            return np.eye(4)
        values = numbers(element.text, (3, 6, 7))
        if values is None:
            self.builder.warn(f"{where}: <pose> {' '.join((element.text or '').split())!r} is no six numbers; taken as zero")
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
        """Returns T_model_frame of a link, joint, frame or nested model of ``model`` by name."""
        if name in ("", "__model__", model.get("name")) or depth > _MAX_NESTING:
            return np.eye(4)
        for child in model:
            if child.tag in ("link", "frame", "joint", "model", "include") and _name_of(child) == name:
                return self.placed(model, child, where, depth)
        head, _, rest = name.partition("::")
        for child in model if rest else ():
            if child.tag == "model" and _name_of(child) == head:
                return self.placed(model, child, where, depth) @ self.frame(child, rest, where, depth + 1)
        self.builder.warn(f"{where}: frame {name!r} is unknown; the model's own is used")
        return np.eye(4)

    def placed(self, model: Element, child: Element, where: str, depth: int = 0) -> F64:
        """Returns T_model_child of a child element: its pose in the frame that it is relative to (SDF 1.7 and later)."""
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
        """Returns the <model> of an SDF file, or None after a warning; the file is parsed once."""
        if path not in self._documents:
            if not is_inside(path, self.builder.roots):
                self.builder.warn(f"{path}: lies outside the scene's folder; left out")
                return None
            root = parse_xml(self.builder, path)
            model = root.find("model") if root.tag == "sdf" else root if root.tag == "model" else None
            if model is None:
                self.builder.warn(f"{path}: holds no <model>; left out")
                return None
            self._documents[path] = model
        return self._documents[path]

    def include(
        self, element: Element, T_world_parent: F64, top: str, base: Path, depth: int, parent: Element | None = None
    ) -> None:
        """Places the model that an <include> names."""
        uri = (element.findtext("uri") or "").strip()
        name = (element.findtext("name") or "").strip()
        try:
            path = self.find_model(uri, base)
            model = None if path is None else self.document(path)
        except SceneError as e:
            self.builder.warn(f"{e}; left out")
            return
        if path is None or model is None:
            return
        label = top or name or model.get("name", "") or path.parent.name
        own = self.pose(model, label) if element.find("pose") is None else None
        if own is None:
            own = self.pose(element, label) if parent is None else self.placed(parent, element, label)
        self.model(model, T_world_parent @ own, label, path.parent, depth + 1, _model_name(uri, model))

    def find_model(self, uri: str, base: Path) -> Path | None:
        """Returns the SDF file of a model, or None after a warning."""
        found = self.uris.find(uri, base) if uri else None
        if found is None:
            reason = "is on the network: download it and name the copy" if uri.startswith("http") else "is not there"
            self.builder.warn(f"model {uri or '(without a uri)'} {reason}; left out")
            return None
        if found.is_file():
            return found
        for candidate in _sdf_files(found):
            if candidate.is_file():
                return candidate
        self.builder.warn(f"model {uri}: {found} holds no model.sdf; left out")
        return None

    def model(self, model: Element, T_world_model: F64, top: str, base: Path, depth: int = 0, kind: str = "") -> None:
        """Places a model with everything in it.

        Args:
            model: the <model>.
            T_world_model: (4, 4); the model's own <pose> is part of it already.
            top: name of the outermost model, which names its shapes.
            base: folder of the file that it stands in.
            depth: how many models it is nested in.
            kind: name that its semantic class is made of, empty = the model's own.
        """
        where = f"model {top}"
        if depth > _MAX_NESTING:
            raise SceneError(f"{where}: includes itself, or is nested deeper than {_MAX_NESTING}")
        if not np.isfinite(T_world_model).all() or np.abs(T_world_model[:3, 3]).max() > FAR_AWAY:
            at = ", ".join(f"{c:g}" for c in T_world_model[:3, 3])
            self.builder.warn(f"{where}: stands at ({at}) m, more than {FAR_AWAY:g} m off; left out")
            return
        kind = kind or model.get("name", "")
        for child in model:
            if child.tag == "include":
                self.include(child, T_world_model, top, base, depth, model)
            elif child.tag == "model":
                self.model(child, T_world_model @ self.placed(model, child, where), top, base, depth + 1)
        links = [(link, T_world_model @ self.placed(model, link, where)) for link in model.iterfind("link")]
        has_collision = any(link.find("collision") is not None for link, _ in links)
        for link, T_world_link in links:
            for element in link.iterfind("visual"):
                self._visual(model, element, T_world_model, T_world_link, top, base, class_from_model(kind), not has_collision)
            for element in link.iterfind("collision"):
                for shape, matrix, plane in self._shapes(model, element, T_world_model, T_world_link, top, base):
                    if plane:
                        self._ground(matrix, where)
                    else:
                        self.builder.add_collision(top, shape, matrix)

    def _visual(
        self,
        model: Element,
        element: Element,
        T_world_model: F64,
        T_world_link: F64,
        top: str,
        base: Path,
        kind: str,
        solid: bool,
    ) -> None:
        color, visible = _color(element)
        for shape, matrix, _ in self._shapes(model, element, T_world_model, T_world_link, top, base):
            if visible:
                self.builder.add_visual(top, shape, matrix, color, kind)
            if solid:
                self.builder.add_collision(top, shape, matrix)

    def _ground(self, matrix: F64, where: str) -> None:
        if matrix[2, 2] < 0.999:
            self.builder.warn(f"{where}: a plane that is not level cannot be bumped into; left out")
            return
        # The origin of the box lies half its thickness below the plane.
        height = float(matrix[2, 3]) + _PLANE_THICKNESS / 2
        self.builder.ground_z = height if self.builder.ground_z is None else max(height, self.builder.ground_z)

    def _shapes(
        self, model: Element, element: Element, T_world_model: F64, T_world_link: F64, top: str, base: Path
    ) -> Iterator[tuple[Shape, F64, bool]]:
        """Yields the shape of a <visual> or <collision>, T_world_shape, and whether it is a plane; nothing after a warning."""
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
                yield (*_plane(kind, matrix), True)
            elif size is not None:
                yield size, matrix, False
            elif kind.tag != "empty":
                self.builder.warn(f"{where}: geometry <{kind.tag}> is not supported or has no size; left out")

    def _mesh(self, element: Element, matrix: F64, where: str, base: Path) -> Iterator[tuple[Shape, F64]]:
        uri = (element.findtext("uri") or element.findtext("filename") or "").strip()
        path = self.uris.find(uri, base) if uri else None
        if path is None:
            self.builder.warn(f"{where}: mesh {uri or '(without a uri)'} is not there; left out")
            return
        scale = numbers(element.findtext("scale"), (3,)) or [1.0, 1.0, 1.0]
        if element.find("submesh") is not None:
            self.builder.warn(f"{where}: <submesh> of {path.name} is not supported; the whole mesh is used")
        try:
            # Gazebo takes the axes of a DAE as they are, whatever its up_axis says, and worlds are built that way.
            up_axis: UpAxis | None = "z" if path.suffix.lower() == ".dae" else None
            yield self.builder.mesh_shape(path, matrix, (scale[0], scale[1], scale[2]), up_axis)
        except MeshError as e:
            self.builder.warn(f"{where}: {e}; left out")

    def weld(self, model: Element, T_world_child: F64, child: str, where: str) -> F64:
        """Returns T_world_model such that the frame ``child`` of the model comes to lie at T_world_child."""
        return T_world_child @ invert(self.frame(model, child, where))


def _name_of(element: Element) -> str:
    return element.get("name", "") or (element.findtext("name") or "").strip()


def _model_name(uri: str, model: Element) -> str:
    parts = [p for p in uri.partition("://")[2].split("/") if p and p != "models"]
    return parts[0] if parts and uri.startswith(("model://", "file://")) else model.get("name", "")


def _sdf_files(folder: Path) -> list[Path]:
    """Returns the SDF files that a model folder may mean, the newest version first (model.config), then model.sdf."""
    named: list[tuple[tuple[float, ...], Path]] = []
    try:
        for element in ElementTree.parse(folder / "model.config").getroot().iterfind("sdf"):
            version = tuple(float(v) for v in element.get("version", "0").split(".") if v.isdigit())
            named.append((version, folder / (element.text or "").strip()))
    except (OSError, ElementTree.ParseError):
        # Without a readable model.config the usual name is tried.
        named = []
    return [path for _, path in sorted(named, reverse=True)] + [folder / "model.sdf"]


def _primitive(element: Element) -> Shape | None:
    """Returns a box, sphere or cylinder, or None if the element is none or has no sizes above 0."""
    tags = {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "length")}.get(element.tag)
    if tags is None:
        return None
    values = numbers(" ".join(element.findtext(tag) or "" for tag in tags), (3,) if element.tag == "box" else (len(tags),))
    if values is None or min(values) <= 0:
        return None
    padded = [*values, 0.0, 0.0][:3]
    size: Vec3 = (padded[0], padded[1], padded[2])
    kinds: dict[str, ShapeKind] = {"box": "box", "sphere": "sphere", "cylinder": "cylinder"}
    return Shape(kinds[element.tag], size)


def _plane(element: Element, matrix: F64) -> tuple[Shape, F64]:
    """Returns a thin box whose upper face is the plane, and T_world_box."""
    x, y = (numbers(element.findtext("size"), (2,)) or [1.0, 1.0])[:2]
    normal = np.array(numbers(element.findtext("normal"), (3,)) or [0.0, 0.0, 1.0])
    turned = matrix @ _turn_z_to(normal)
    down = np.eye(4)
    down[2, 3] = -_PLANE_THICKNESS / 2
    return Shape("box", (max(x, 1e-3), max(y, 1e-3), _PLANE_THICKNESS)), turned @ down


def _turn_z_to(normal: F64) -> F64:
    """Returns a (4, 4) rotation that takes z to ``normal``."""
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


def _color(element: Element) -> tuple[Rgba | None, bool]:
    """Returns the colour that a <visual> gives its shape, None = the mesh's own, and whether it can be seen at all."""
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
