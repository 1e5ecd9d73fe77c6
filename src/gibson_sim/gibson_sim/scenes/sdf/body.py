"""Converts an SDF model to a tree of links for physics: masses, joints, shapes and friction; nested models are flattened.

``sdf.model`` reads static models of a scene, and the poses, frames and shapes for both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.description.rigid_groups import MOVING_TYPES
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfJoint, UrdfLink, UrdfModel, UrdfVisual
from gibson_sim.description.urdf_model import leaders
from gibson_sim.errors import RobotError, SceneError
from gibson_sim.geometry.transforms import invert, pose_from_matrix
from gibson_sim.quoting import quoted
from gibson_sim.scenes.mass_properties import solid_of, sum_of
from gibson_sim.scenes.sdf.elements import F64, Element, is_true, name_of, numbers, pose_matrix, text_of
from gibson_sim.scenes.sdf.geometry import PlacedShape
from gibson_sim.scenes.sdf.joints import JointAxis, read_axis
from gibson_sim.scenes.sdf.materials import is_visible, material_of
from gibson_sim.scenes.sdf.model import SdfModels, friction_of
from gibson_sim.scenes.sdf.scopes import MODEL, WORLD, Scope
from gibson_sim.types import Pose, Vec3

MAX_LINKS = 500
_SCOPE = "__"
"""Separator between the name of a nested model and that of its link, in place of SDF's ``::``."""
_MODEL_FRAME = "model_frame"
"""Name of the added root link if no link is at the model's frame."""
_WATER = 1000.0
"""Density of shapes without one, kg/m^3."""
_INERTIA = {"ixx": 1.0, "ixy": 0.0, "ixz": 0.0, "iyy": 1.0, "iyz": 0.0, "izz": 1.0}
"""Default inertia of SDF, kg m^2."""


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
        self._collect(flat, self.models.scope(model, name, base, version, self.path), np.eye(4), "")
        if not flat.links:
            raise SceneError(f"{self.path}: model {quoted(name)} has no <link>")
        is_static = is_true(model.findtext("static"))
        tree = _Tree(self, flat, f"model {name}")
        tree.add_joints()
        tree.join_roots(is_static)
        static = is_static or tree.fixed_to_world
        links = self._links(flat, tree, static)
        ordered = tuple(links[link] for link in tree.order())
        # All joints of a <static> model are fixed, even those of doors.
        joints = tuple(replace(joint, kind="fixed", mimic=None) if is_static else joint for joint in tree.with_leaders(is_static))
        return SdfBody(UrdfModel(name, self.path, ordered, joints, tuple(self.builder.warnings)), static)

    def _collect(self, flat: _FlatModel, scope: Scope, T_root_scope: F64, prefix: str) -> None:
        """Adds the links and joints of a model and its nested models to ``flat``.

        Args:
            flat: receives them.
            scope: that of the model.
            T_root_scope: pose of its frame in that of the outermost model, (4, 4).
            prefix: prefix of the unique names of its links and joints.
        """
        for child in scope.element:
            name = prefix + name_of(child)
            if child.tag == "link":
                if name in flat.links or name_of(child) in ("", WORLD):
                    raise SceneError(
                        f"{self.path}: {scope.where}: a link is named {quoted(name)}; names must be unique, and not {quoted(WORLD)}"
                    )
                if len(flat.links) >= MAX_LINKS:
                    raise SceneError(f"{self.path}: has more than {MAX_LINKS} links; split it")
                flat.links[name] = _FlatLink(child, scope, T_root_scope, T_root_scope @ scope.placed(child))
                flat.names[scope, child] = name
            elif child.tag == "joint":
                flat.joints.append((child, scope, T_root_scope, prefix))
            elif child in scope.nested:
                nested = scope.nested[child]
                inner = nested.inner
                if inner is not None:
                    if inner.is_static and not scope.is_static:
                        self.builder.warn(f"{inner.where}: is <static> within a model that moves; it moves with that one")
                    # The links of a merged model become links of this model.
                    inner_prefix = prefix if inner.model_frame else f"{prefix}{inner.name.rpartition('::')[2]}{_SCOPE}"
                    self._collect(flat, inner, T_root_scope @ scope.origin(nested), inner_prefix)

    def _links(self, flat: _FlatModel, tree: _Tree, static: bool) -> dict[str, UrdfLink]:
        """Returns every link by name; a model without collision shapes collides with its visuals, as in worlds."""
        has_collision = any(link.element.find("collision") is not None for link in flat.links.values())
        links = {name: UrdfLink(name) for name in tree.extra_links}
        for name, link in flat.links.items():
            where = f"link {name}"
            visuals, collisions = [], []
            for item in link.element.iterfind("visual"):
                visible = is_visible(item)
                for placed in self._shapes(link, item, name):
                    pose = pose_from_matrix(placed.matrix)
                    if visible:
                        material = material_of(item, self.builder.has_textures(placed.shape), where, self.builder.warn)
                        visuals.append(UrdfVisual(placed.shape, pose, material.color))
                        if material.appearance is not None:
                            self.builder.warn(f"{where}: metalness and roughness of a body's material are not drawn")
                    if not has_collision:
                        collisions.append(UrdfCollision(placed.shape, pose))
            for item in link.element.iterfind("collision"):
                for placed in self._shapes(link, item, name):
                    if placed.T_plane is not None and not static:
                        text = f"{where}: a plane collides in a <static> model only; left out"
                        self.builder.warn(text, OmissionKind.UNSUPPORTED_ELEMENT)
                        continue
                    if placed.T_plane is not None:
                        x, y = placed.shape.size[:2]
                        self.builder.warn(
                            f"{where}: a plane of a body collides as a plate of its <size>, {x:g} x {y:g} m, not as an infinite plane"
                        )
                    collisions.append(UrdfCollision(placed.shape, pose_from_matrix(placed.matrix)))
            for light in link.element.iterfind("light"):
                self.builder.warn(f"{where}: light {quoted(name_of(light))} of a body does not shine")
            inertial = self._inertial(link, name)
            links[name] = UrdfLink(name, tuple(visuals), tuple(collisions), inertial, self._friction(link.element, name))
        if not has_collision and any(link.visuals for link in links.values()):
            self.models.without_collision[self.path.stem] = None
        self.models.report()
        return links

    def _shapes(self, link: _FlatLink, item: Element, name: str) -> Iterator[PlacedShape]:
        """Yields the shapes of a <visual> or <collision> in the frame of its link."""
        T_link_scope = invert(link.T_root_link) @ link.T_root_scope
        return self.models.shapes.read(link.scope, item, T_link_scope, np.eye(4), f"{self.path.name}: link {name}")

    def _inertial(self, link: _FlatLink, name: str) -> Inertial | None:
        """Returns the mass and inertia of a link, None if it has no <inertial>; a missing <inertia> is SDF's default, 1 kg m^2 about each axis."""
        item = link.element.find("inertial")
        if item is None:
            return None
        where = f"link {name}: inertial"
        if is_true(item.get("auto")):
            return self._auto_inertial(link, item, name)
        mass = self._number(item, "mass", 1.0, where)
        inertia = item.find("inertia")
        source = item if inertia is None else inertia
        ixx, ixy, ixz, iyy, iyz, izz = (self._number(source, key, default, where) for key, default in _INERTIA.items())
        pose = pose_from_matrix(pose_matrix(item, where, self.builder.warn))
        return Inertial(mass, pose, (ixx, ixy, ixz, iyy, iyz, izz))

    def _auto_inertial(self, link: _FlatLink, item: Element, name: str) -> Inertial | None:
        """Returns the mass and inertia of a link that SDF computes from the volume and density of its collision shapes."""
        where = f"link {name}: inertial"
        unused = " and ".join(f"<{tag}>" for tag in ("inertia", "pose") if item.find(tag) is not None)
        if unused:
            self.builder.warn(f"{where}: auto is true; {unused} beside it has no effect, and the <collision> shapes decide")
        parts = []
        for collision in link.element.iterfind("collision"):
            density = self._density(collision, item, where)
            for placed in self._shapes(link, collision, name):
                part = None if placed.T_plane is not None else solid_of(placed.shape, self.builder.loader)
                if part is None:
                    self.builder.warn(f"{where}: a {placed.shape.kind} that encloses no volume adds no mass")
                else:
                    if part.is_hull:
                        self.builder.warn(
                            f"{where}: the surface of {Path(placed.shape.mesh).name} is not closed or not wound consistently; "
                            "mass and inertia are those of its convex hull"
                        )
                    parts.append(part.scaled(density).moved(placed.matrix))
        total = sum_of(parts)
        if total is None:
            text = f"{where}: auto is true, but no <collision> encloses a volume; give it one, or a <mass> and an <inertia>"
            self.builder.warn(text, OmissionKind.INVALID)
            return None
        if text_of(item, "mass"):
            total = total.scaled(self._number(item, "mass", total.mass, where) / total.mass)
        i = total.inertia
        center: Vec3 = (float(total.center[0]), float(total.center[1]), float(total.center[2]))
        values = tuple(float(v) for v in (i[0, 0], i[0, 1], i[0, 2], i[1, 1], i[1, 2], i[2, 2]))
        return Inertial(total.mass, Pose(center), values)  # type: ignore[arg-type]

    def _density(self, collision: Element, inertial: Element, where: str) -> float:
        """Returns the density of a collision shape, kg/m^3: its own, else that of the <inertial>, else that of water."""
        for element in (collision, inertial):
            if text_of(element, "density"):
                density = self._number(element, "density", _WATER, where)
                if density > 0.0:
                    return density
                self.builder.warn(f"{where}: <density> is {density:g} kg/m^3, must be above 0", OmissionKind.INVALID)
        if not text_of(inertial, "mass"):
            self.builder.warn(f"{where}: no <density> is given; that of water, {_WATER:g} kg/m^3, is used")
        return _WATER

    def _friction(self, element: Element, name: str) -> float | None:
        """Returns the friction coefficient of the link's first collision shape with one, else None."""
        found = (friction_of(item, f"link {name}", self.builder.warn) for item in element.iterfind("collision"))
        return next((friction for friction in found if friction is not None), None)

    def _number(self, element: Element, key: str, default: float, where: str) -> float:
        text = (element.findtext(key) or "").strip()
        if not text:
            return default
        values = numbers(text, (1,))
        if values is None:
            self.builder.warn(f"{where}: <{key}> is {quoted(text)}, must be a finite number", OmissionKind.INVALID)
            return default
        return values[0]


@dataclass(frozen=True, slots=True, eq=False)
class _FlatLink:
    """A link of the model or of a nested model."""

    element: Element
    scope: Scope
    T_root_scope: F64
    """Pose of the frame of its model in that of the outermost model, (4, 4)."""
    T_root_link: F64


@dataclass(slots=True)
class _FlatModel:
    """The links and joints of a model and its nested models, under unique names."""

    links: dict[str, _FlatLink] = field(default_factory=dict)
    names: dict[tuple[Scope, Element], str] = field(default_factory=dict)
    """<link> of a scope -> its unique name."""
    joints: list[tuple[Element, Scope, F64, str]] = field(default_factory=list)
    """<joint>, its scope, T_root_scope (4, 4), and the prefix of its unique name."""


class _Tree:
    """Connects the links of a flat model to a tree."""

    def __init__(self, reader: SdfBodyReader, flat: _FlatModel, where: str) -> None:
        self.builder = reader.builder
        self.flat = flat
        self.where = where
        self.joints: list[UrdfJoint] = []
        self.extra_links: list[str] = []
        self.fixed_to_world = False
        self._world_link = ""
        self._parents: dict[str, str] = {}
        self._T_root: dict[str, F64] = {name: link.T_root_link for name, link in flat.links.items()}

    def add_joints(self) -> None:
        """Adds all joints except those that would close a loop; these are left out with a warning."""
        for element, scope, T_root_scope, prefix in self.flat.joints:
            name = prefix + name_of(element)
            parent, child = (self._resolve_end(element, scope, tag) for tag in ("parent", "child"))
            axis = read_axis(element, name, self.builder)
            if any(joint.name == name for joint in self.joints):
                self.builder.warn(
                    f"{self.where}: two joints are named {quoted(name)}; the second is left out", OmissionKind.INVALID
                )
                continue
            if axis.mimic is not None:
                axis = replace(axis, mimic=replace(axis.mimic, leader=prefix + axis.mimic.leader.replace("::", _SCOPE)))
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
                T_root_joint = T_root_scope @ scope.placed(element)
                direction = np.array(axis.xyz)
                if axis.expressed_in or axis.in_model_frame(scope.version):
                    frame = axis.expressed_in or MODEL
                    direction = (T_root_scope @ scope.pose(frame))[:3, :3] @ direction
                else:
                    direction = T_root_joint[:3, :3] @ direction
                self._join(name, parent, child, axis, T_root_joint, direction)

    def with_leaders(self, is_static: bool) -> tuple[UrdfJoint, ...]:
        """Returns the joints, those that mimic others with the last joint of their chain; joints without a valid leader move freely."""
        mimics = {joint.name: joint.mimic for joint in self.joints if joint.mimic is not None}
        if not mimics or is_static:
            return tuple(self.joints)
        try:
            moving = [joint.name for joint in self.joints if joint.kind in MOVING_TYPES]
            resolved = leaders({name: mimic for name, mimic in mimics.items() if name in moving}, moving, self.where)
        except RobotError as e:
            self.builder.warn(f"{e}; the joints move freely", OmissionKind.INVALID)
            resolved = {}
        return tuple(replace(joint, mimic=resolved.get(joint.name)) for joint in self.joints)

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

    def _join(self, name: str, parent: str, child: str, axis: JointAxis, T_root_joint: F64, direction: F64) -> None:
        """Adds a joint. In URDF the joint's frame is that of its child; if they differ in SDF, a massless link is added at the joint.

        Args:
            name: unique name.
            parent: parent link.
            child: child link.
            axis: its type, limits, dynamics and leader.
            T_root_joint: pose of the joint in the frame of the outermost model, (4, 4).
            direction: axis in that frame, (3,).
        """
        T_child_joint = invert(self._T_root[child]) @ T_root_joint
        if axis.kind in ("revolute", "continuous") and np.abs(T_child_joint[:3, 3]).max() > 1e-9:
            joint_link = self._add_link(f"{name}_axis")
            self._T_root[joint_link] = T_root_joint
            self._fix(f"{name}_offset", joint_link, child)
            child = joint_link
        x, y, z = (self._T_root[child][:3, :3].T @ direction).tolist()
        self._parents[child] = parent
        self.joints.append(
            UrdfJoint(
                name, axis.kind, parent, child, self._pose(parent, child), (x, y, z),
                axis.lower, axis.upper, axis.effort, axis.velocity, axis.damping, axis.mimic, axis.friction,
            )
        )  # fmt: skip

    def _resolve_end(self, element: Element, scope: Scope, tag: str) -> str:
        """Returns the parent or child link of a joint, WORLD, or "" if the link does not exist."""
        name = text_of(element, tag)
        if name == WORLD:
            return WORLD
        found = scope.link_of(name) if name else None
        return "" if found is None else self.flat.names.get(found, "")

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
