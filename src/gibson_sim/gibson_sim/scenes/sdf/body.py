"""Converts an SDF model to a tree of links for physics: masses, joints, shapes and friction; nested models are flattened.

``sdf.model`` reads static models of a scene, and the poses, frames and shapes for both.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfJoint, UrdfLink, UrdfModel, UrdfVisual
from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import invert, pose_from_matrix
from gibson_sim.quoting import quoted
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.sdf.model import Element, SdfModels, name_of, numbers, unsupported_material, visual_color
from gibson_sim.types import Pose, Vec3

F64 = NDArray[np.float64]
MAX_LINKS = 500
WORLD = "world"
"""Name of the world as the parent or child of joints."""
_SCOPE = "__"
"""Separator between the name of a nested model and that of its link, in place of SDF's ``::``."""
_MODEL_FRAME = "model_frame"
"""Name of the added root link if no link is at the model's frame."""
_INERTIA = {"ixx": 1.0, "ixy": 0.0, "ixz": 0.0, "iyy": 1.0, "iyz": 0.0, "izz": 1.0}
"""Default inertia of SDF, kg m^2."""
_KINDS = {"revolute": "revolute", "continuous": "continuous", "prismatic": "prismatic", "fixed": "fixed"}
"""Type of an SDF joint -> kind of a ``UrdfJoint``."""
_MAX_LIMIT = 1e6
"""Joint limit, radians or metres, above which a joint counts as unlimited: files contain 1e16 and more."""


@dataclass(frozen=True, slots=True, eq=False)
class SdfBody:
    """A model that physics can load."""

    model: UrdfModel
    """Links and joints; the frame of the root link is that of the SDF model."""
    static: bool
    """Whether the model is fixed to the world."""


class SdfBodyReader:
    """Reads one SDF model.

    Args:
        models: reader of models, poses and shapes, which collects the warnings.
        path: the file, for messages.
    """

    def __init__(self, models: SdfModels, path: Path) -> None:
        self.models = models
        self.builder = models.builder
        self.path = path

    def read(self, model: Element, base: Path, version: tuple[int, ...]) -> SdfBody:
        """Returns the model in its own frame; the caller applies its <pose>.

        Args:
            model: the <model>.
            base: folder of relative file names.
            version: version of SDF, such as (1, 7).

        Raises:
            SceneError: the model has no links, too many links, or two links of the same name.
        """
        name = model.get("name", "").strip() or self.path.stem
        flat = _FlatModel()
        self._collect(flat, _Scope(model, np.eye(4), "", base, version), (Path(os.path.realpath(self.path)),), 0)
        if not flat.links:
            raise SceneError(f"{self.path}: model {quoted(name)} has no <link>")
        is_static = (model.findtext("static") or "").strip().lower() in ("1", "true")
        tree = _Tree(self, flat, f"model {name}")
        tree.add_joints()
        tree.join_roots(is_static)
        static = is_static or tree.fixed_to_world
        links = self._links(flat, tree, static)
        ordered = tuple(links[link] for link in tree.order())
        # All joints of a <static> model are fixed, even those of doors.
        joints = tuple(replace(joint, kind="fixed") if is_static else joint for joint in tree.joints)
        return SdfBody(UrdfModel(name, self.path, ordered, joints, tuple(self.builder.warnings)), static)

    def _collect(self, flat: _FlatModel, scope: _Scope, files: tuple[Path, ...], depth: int) -> None:
        """Adds the links, joints and frames of a model and its nested models to ``flat``."""
        where = f"model {scope.prefix.removesuffix(_SCOPE) or scope.model.get('name', '')}"
        self.models.check_nesting(where, depth)
        for child in scope.model:
            if child.tag == "link":
                link = scope.prefix + name_of(child)
                if link in flat.links or name_of(child) in ("", WORLD):
                    raise SceneError(
                        f"{self.path}: {where}: a link is named {quoted(link)}; names must be unique, and not {quoted(WORLD)}"
                    )
                if len(flat.links) >= MAX_LINKS:
                    raise SceneError(f"{self.path}: has more than {MAX_LINKS} links; split it")
                flat.links[link] = (child, scope)
                flat.T_root_link[link] = scope.T_root_model @ self.models.placed(scope.model, child, where)
            elif child.tag == "joint":
                flat.joints.append((child, scope))
            elif child.tag == "model":
                T_root_model = scope.T_root_model @ self.models.placed(scope.model, child, where)
                inner = _Scope(child, T_root_model, f"{scope.prefix}{name_of(child)}{_SCOPE}", scope.base, scope.version)
                self._collect_nested(flat, inner, files, depth)
            elif child.tag == "include":
                included = self.models.included(child, scope.base, scope.model, files)
                if included is not None:
                    T_root_model = scope.T_root_model @ included.T_parent_model
                    # With merge="true" the links of the included model become links of this model.
                    merged = child.get("merge", "false").strip().lower() in ("1", "true")
                    prefix = scope.prefix if merged else f"{scope.prefix}{included.name}{_SCOPE}"
                    inner = _Scope(included.model, T_root_model, prefix, included.file.parent, self.models.version(included.file))
                    self._collect_nested(flat, inner, (*files, Path(os.path.realpath(included.file))), depth)
        for child in scope.model.iterfind("frame"):
            parent_frame = (child.get("attached_to") or "").strip().replace("::", _SCOPE)
            first = next((link for link in flat.links if link.startswith(scope.prefix)), "")
            flat.frames[scope.prefix + name_of(child)] = scope.prefix + parent_frame if parent_frame else first

    def _collect_nested(self, flat: _FlatModel, inner: _Scope, files: tuple[Path, ...], depth: int) -> None:
        link_count = len(flat.links)
        self._collect(flat, inner, files, depth + 1)
        if len(flat.links) > link_count:
            flat.frames.setdefault(inner.prefix.removesuffix(_SCOPE), list(flat.links)[link_count])

    def _links(self, flat: _FlatModel, tree: _Tree, static: bool) -> dict[str, UrdfLink]:
        """Returns every link by name; a model without collision shapes collides with its visuals, as in worlds."""
        has_collision = any(element.find("collision") is not None for element, _ in flat.links.values())
        links = {name: UrdfLink(name) for name in tree.extra_links}
        for name, (element, scope) in flat.links.items():
            visuals, collisions = [], []
            for item in element.iterfind("visual"):
                color, visible = visual_color(item)
                for shape, pose, _ in self._shapes(flat, name, item, scope):
                    warning = unsupported_material(item, self.builder.has_textures(shape)) if visible else ""
                    if warning:
                        self.builder.warn(f"link {name}: {warning}", OmissionKind.UNSUPPORTED_ASSET)
                    if visible:
                        visuals.append(UrdfVisual(shape, pose, color))
                    if not has_collision:
                        collisions.append(UrdfCollision(shape, pose))
            for item in element.iterfind("collision"):
                for shape, pose, plane in self._shapes(flat, name, item, scope):
                    if plane and not static:
                        text = f"link {name}: a plane collides in a <static> model only; left out"
                        self.builder.warn(text, OmissionKind.UNSUPPORTED_ELEMENT)
                        continue
                    collisions.append(UrdfCollision(shape, pose))
            links[name] = UrdfLink(
                name, tuple(visuals), tuple(collisions), self._inertial(element, name), self._friction(element, name)
            )
        return links

    def _shapes(self, flat: _FlatModel, name: str, item: Element, scope: _Scope) -> list[tuple[Shape, Pose, bool]]:
        """Returns the shapes of a <visual> or <collision>, each with T_link_shape and whether it is a plane."""
        T_link_model = invert(flat.T_root_link[name]) @ scope.T_root_model
        shapes = self.models.shapes(scope.model, item, T_link_model, np.eye(4), f"{self.path.name}: link {name}", scope.base)
        return [(shape, pose_from_matrix(matrix), plane) for shape, matrix, plane in shapes]

    def _inertial(self, element: Element, name: str) -> Inertial | None:
        """Returns the mass and inertia of a link, None if it has no <inertial>; a missing <inertia> is SDF's default, 1 kg m^2 about each axis."""
        item = element.find("inertial")
        if item is None:
            return None
        where = f"link {name}: inertial"
        mass = self._number(item, "mass", 1.0, where)
        inertia = item.find("inertia")
        source = item if inertia is None else inertia
        ixx, ixy, ixz, iyy, iyz, izz = (self._number(source, key, default, where) for key, default in _INERTIA.items())
        return Inertial(mass, pose_from_matrix(self.models.pose(item, where)), (ixx, ixy, ixz, iyy, iyz, izz))

    def _friction(self, element: Element, name: str) -> float | None:
        """Returns the friction coefficient of the link's first collision shape with one, else None."""
        for path in ("surface/friction/ode", "surface/friction/bullet"):
            for item in element.iterfind(f"collision/{path}"):
                for key in ("mu", "friction"):
                    if (item.findtext(key) or "").strip():
                        return self._number(item, key, 0.5, f"link {name}: friction")
        return None

    def _number(self, element: Element, key: str, default: float, where: str) -> float:
        text = (element.findtext(key) or "").strip()
        if not text:
            return default
        values = numbers(text, (1,))
        if values is None:
            self.builder.warn(f"{where}: <{key}> is {quoted(text)}, must be a finite number", OmissionKind.INVALID)
            return default
        return values[0]


@dataclass(slots=True)
class _Scope:
    """One <model>, the outermost or a nested one."""

    model: Element
    T_root_model: F64
    """Pose in the frame of the outermost model, (4, 4)."""
    prefix: str
    """Prefix of the unique names of its links and joints."""
    base: Path
    """Folder of relative file names."""
    version: tuple[int, ...]
    """Version of SDF, such as (1, 7)."""


@dataclass(slots=True)
class _FlatModel:
    """The links, frames and joints of a model and its nested models, under unique names."""

    links: dict[str, tuple[Element, _Scope]] = field(default_factory=dict)
    T_root_link: dict[str, F64] = field(default_factory=dict)
    """Link name -> pose in the frame of the outermost model, (4, 4)."""
    frames: dict[str, str] = field(default_factory=dict)
    """Name of a frame or nested model -> name of the link that it is attached to."""
    joints: list[tuple[Element, _Scope]] = field(default_factory=list)


class _Tree:
    """Connects the links of a flat model to a tree."""

    def __init__(self, reader: SdfBodyReader, flat: _FlatModel, where: str) -> None:
        self.models, self.builder = reader.models, reader.builder
        self.flat = flat
        self.where = where
        self.joints: list[UrdfJoint] = []
        self.extra_links: list[str] = []
        self.fixed_to_world = False
        self._world_link = ""
        self._parents: dict[str, str] = {}
        self._T_root: dict[str, F64] = dict(flat.T_root_link)

    def add_joints(self) -> None:
        """Adds all joints except those that would close a loop; these are left out with a warning."""
        for element, scope in self.flat.joints:
            name = scope.prefix + name_of(element)
            parent, child = (self._resolve_end(element, scope, tag) for tag in ("parent", "child"))
            axis = _joint_axis(element, name, self.builder)
            if not parent or not child:
                text = f"{self.where}: joint {quoted(name)} names a <parent> or <child> that does not exist; left out"
                self.builder.warn(text, OmissionKind.INVALID)
            elif parent == WORLD and axis.kind == "fixed":
                self.fixed_to_world = True
            elif child == WORLD or parent == child or child in self._parents or self._is_ancestor(child, parent):
                self.builder.warn(
                    f"{self.where}: joint {quoted(name)} gives {quoted(child)} a second parent or closes a loop; left out"
                )
            else:
                if parent == WORLD and not self._world_link:
                    self.fixed_to_world = True
                    self._world_link = self._add_link(WORLD)
                self._join(element, scope, name, parent, child, axis)

    def join_roots(self, is_static: bool) -> None:
        """Fixes links without a parent to the first one, and ensures that the frame of the root is that of the model."""
        roots = [name for name in [*self.extra_links, *self.flat.links] if name not in self._parents]
        if len(roots) > 1 and not is_static:
            rest = ", ".join(roots[1:])
            self.builder.warn(
                f"{self.where}: no joint connects {rest}; fixed to {roots[0]}, spawn them one by one to move them independently"
            )
        root = roots[0]
        if not np.allclose(self._T_root[root], np.eye(4), atol=1e-9):
            root = self._add_link(_MODEL_FRAME)
        for name in roots:
            if name != root:
                self._fix(f"{name}_fixed", root, name)

    def order(self) -> list[str]:
        """Returns the names of all links in depth-first order, parents first."""
        names = [*self.extra_links, *self.flat.links]
        children: dict[str, list[str]] = {name: [] for name in names}
        for name in names:
            if name in self._parents:
                children[self._parents[name]].append(name)
        ordered, stack = [], [name for name in names if name not in self._parents]
        while stack:
            ordered.append(stack.pop())
            stack.extend(reversed(children[ordered[-1]]))
        return ordered

    def _join(self, element: Element, scope: _Scope, name: str, parent: str, child: str, axis: _JointAxis) -> None:
        """Adds a joint. In URDF the joint's frame is that of its child; if they differ in SDF, a massless link is added at the joint."""
        T_root_joint = self._T_root_joint(element, scope, child)
        T_child_joint = invert(self._T_root[child]) @ T_root_joint
        if axis.kind in ("revolute", "continuous") and np.abs(T_child_joint[:3, 3]).max() > 1e-9:
            joint_link = self._add_link(f"{name}_axis")
            self._T_root[joint_link] = T_root_joint
            self._fix(f"{name}_offset", joint_link, child)
            child = joint_link
        direction = np.array(axis.xyz)
        if axis.expressed_in or axis.in_model_frame(scope.version):
            T_root_frame = scope.T_root_model
            if axis.expressed_in:
                T_root_frame = T_root_frame @ self.models.frame(scope.model, axis.expressed_in, self.where)
            direction = T_root_frame[:3, :3] @ direction
        else:
            direction = T_root_joint[:3, :3] @ direction
        x, y, z = (self._T_root[child][:3, :3].T @ direction).tolist()
        self._parents[child] = parent
        self.joints.append(
            UrdfJoint(
                name, axis.kind, parent, child, self._pose(parent, child), (x, y, z),
                axis.lower, axis.upper, axis.effort, axis.velocity, axis.damping, friction=axis.friction,
            )
        )  # fmt: skip

    def _T_root_joint(self, element: Element, scope: _Scope, child: str) -> F64:
        """Returns the pose (4, 4) of a joint in the frame of the outermost model; it is relative to the child by default."""
        pose = element.find("pose")
        reference = "" if pose is None else pose.get("relative_to", "")
        if reference:
            parent = scope.T_root_model @ self.models.frame(scope.model, reference, self.where)
        else:
            parent = self._T_root[child]
            child_name = (element.findtext("child") or "").strip()
            if scope.prefix + child_name.replace("::", _SCOPE) != child:
                parent = scope.T_root_model @ self.models.frame(scope.model, child_name, self.where)
        return parent @ self.models.pose(element, self.where)

    def _resolve_end(self, element: Element, scope: _Scope, tag: str) -> str:
        """Returns the parent or child link of a joint, WORLD, or "" if the link does not exist."""
        link_name = (element.findtext(tag) or "").strip()
        if link_name == WORLD:
            return WORLD
        name = scope.prefix + link_name.replace("::", _SCOPE)
        for _ in range(len(self.flat.frames) + 1):
            if name in self.flat.links:
                return name
            name = self.flat.frames.get(name, "")
        return ""

    def _is_ancestor(self, ancestor: str, name: str) -> bool:
        """Returns whether link ``ancestor`` is an ancestor of link ``name``."""
        while name in self._parents:
            name = self._parents[name]
            if name == ancestor:
                return True
        return False

    def _add_link(self, name: str) -> str:
        """Adds a massless link at the model's frame and returns its name."""
        unique = name
        while unique in self._T_root:
            unique += "_"
        self.extra_links.append(unique)
        self._T_root[unique] = np.eye(4)
        return unique

    def _fix(self, name: str, parent: str, child: str) -> None:
        """Adds a fixed joint."""
        self._parents[child] = parent
        used = {joint.name for joint in self.joints}
        while name in used:
            name += "_"
        self.joints.append(UrdfJoint(name, "fixed", parent, child, self._pose(parent, child), (1.0, 0.0, 0.0)))

    def _pose(self, parent: str, child: str) -> Pose:
        """Returns T_parent_child."""
        return pose_from_matrix(invert(self._T_root[parent]) @ self._T_root[child])


@dataclass(frozen=True, slots=True)
class _JointAxis:
    """Type, axis, limits and dynamics of a joint, in the units of ``UrdfJoint``."""

    kind: str
    xyz: Vec3 = (0.0, 0.0, 1.0)
    """Unit vector in the frame of the joint, unless ``expressed_in`` or ``parent_model_frame`` names another frame."""
    expressed_in: str = ""
    """Frame of the axis (SDF 1.7 and later); empty = not given."""
    parent_model_frame: bool | None = None
    """Value of <use_parent_model_frame>; None = not given."""
    lower: float = 0.0
    upper: float = -1.0
    effort: float = 0.0
    velocity: float = 0.0
    damping: float = 0.0
    friction: float = 0.0

    def in_model_frame(self, version: tuple[int, ...]) -> bool:
        """Returns whether the axis is in the frame of the model: by <use_parent_model_frame> if given, else in SDF 1.4 and older."""
        if self.parent_model_frame is not None:
            return self.parent_model_frame
        return bool(version) and version <= (1, 4)


def _joint_axis(element: Element, name: str, builder: SceneBuilder) -> _JointAxis:
    """Returns the axis of a <joint>; a fixed axis, with a warning, if the joint type is not simulated."""
    kind = _KINDS.get(element.get("type", ""))
    where = f"joint {name}"
    if kind is None:
        builder.warn(f"{where}: type {quoted(element.get('type', ''))} is not simulated; the joint is fixed")
        return _JointAxis("fixed")
    axis = element.find("axis")
    if kind == "fixed" or axis is None:
        if kind != "fixed":
            builder.warn(f"{where}: has no <axis>; the z axis of the joint is used")
        return _JointAxis("continuous" if kind == "revolute" else kind)
    xyz = axis.find("xyz")
    text = "0 0 1" if xyz is None else (xyz.text or "").strip()
    values = numbers(text, (3,)) or [0.0, 0.0, 0.0]
    length = math.sqrt(sum(c * c for c in values))
    if length < 1e-9:
        builder.warn(f"{where}: axis {quoted(text)} is not a direction; z is used", OmissionKind.INVALID)
        values, length = [0.0, 0.0, 1.0], 1.0
    in_model_frame = (axis.findtext("use_parent_model_frame") or "").strip().lower()
    lower = _limit(axis, "limit/lower", -math.inf, where, builder)
    upper = _limit(axis, "limit/upper", math.inf, where, builder)
    if lower > upper:
        builder.warn(f"{where}: limits are {lower:g} to {upper:g}, must be lower to upper", OmissionKind.INVALID)
    unlimited = lower < -_MAX_LIMIT and upper > _MAX_LIMIT
    if unlimited or kind == "continuous":
        kind = "continuous" if kind == "revolute" else kind
        lower, upper = 0.0, -1.0
    lower, upper = max(lower, -_MAX_LIMIT), min(upper, _MAX_LIMIT)
    effort, velocity = (_limit(axis, f"limit/{key}", 0.0, where, builder) for key in ("effort", "velocity"))
    damping, friction = (_limit(axis, f"dynamics/{key}", 0.0, where, builder) for key in ("damping", "friction"))
    return _JointAxis(
        kind,
        (values[0] / length, values[1] / length, values[2] / length),
        "" if xyz is None else xyz.get("expressed_in", "").strip(),
        in_model_frame in ("1", "true") if in_model_frame else None,
        lower,
        upper,
        # A negative or infinite limit means no limit.
        effort if 0.0 < effort < _MAX_LIMIT else 0.0,
        velocity if 0.0 < velocity < _MAX_LIMIT else 0.0,
        damping if math.isfinite(damping) else 0.0,
        friction if math.isfinite(friction) else 0.0,
    )


def _limit(axis: Element, path: str, default: float, where: str, builder: SceneBuilder) -> float:
    """Returns the number in an element, which may be infinite; the default if it is missing or, with a warning, not a number."""
    text = (axis.findtext(path) or "").strip()
    if not text:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        builder.warn(f"{where}: <{path.rpartition('/')[2]}> is {quoted(text)}, must be a number", OmissionKind.INVALID)
        return default
    return value
