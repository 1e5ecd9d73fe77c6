"""Reads a URDF file into plain values: links, shapes, joints, the tree. Pure: no physics engine, no ROS.

Bad structure (no root, two roots, a cycle, a number that is none) is a ``RobotError``. What can be done without (a mesh that is
missing, a shape of unknown kind) is left out, with one line in ``UrdfModel.warnings``.
"""

from __future__ import annotations

import math
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from gibson_sim.errors import RobotError
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.robots.omissions import Omission, OmissionKind
from gibson_sim.robots.spec import Shape
from gibson_sim.types import Pose, Rgba, Vec3

JOINT_TYPES = ("fixed", "continuous", "revolute", "prismatic", "floating", "planar")
FindMesh = Callable[[str, Path], Path | None]
"""Takes what a URDF names and the URDF's path to the absolute path of a file, or None when there is none."""
_PACKAGE = "package://"
_FILE = "file://"
_LEVELS_UP = 3
_XACRO = b"<xacro:"
_NO_ELEMENTS = re.compile(rb"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>", re.DOTALL)


@dataclass(frozen=True, slots=True)
class UrdfVisual:
    """A shape to be drawn."""

    shape: Shape
    pose: Pose
    """T_link_visual."""
    color: Rgba | None
    """sRGB and alpha of its material; None = the material names none."""


@dataclass(frozen=True, slots=True)
class UrdfCollision:
    """A shape that is bumped into."""

    shape: Shape
    pose: Pose
    """T_link_shape."""


@dataclass(frozen=True, slots=True)
class Inertial:
    """Mass of one link."""

    mass: float
    """kg."""
    pose: Pose
    """T_link_inertial: its position is the centre of mass."""
    inertia: tuple[float, float, float, float, float, float]
    """ixx, ixy, ixz, iyy, iyz, izz in the inertial frame, kg m^2."""


@dataclass(frozen=True, slots=True)
class UrdfLink:
    """One rigid link."""

    name: str
    visuals: tuple[UrdfVisual, ...] = ()
    collisions: tuple[UrdfCollision, ...] = ()
    inertial: Inertial | None = None
    friction: float | None = None
    """Coulomb friction from ``<contact><lateral_friction value=""/></contact>`` (an extension of Bullet); None = not given."""
    rolling_friction: float = 0.0
    """Metres: what holds a round link back, from ``<rolling_friction value=""/>`` beside it."""
    spinning_friction: float = 0.0
    """Metres: the same about the normal of a contact, from ``<spinning_friction value=""/>``."""


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """One joint, at zero its child frame is at ``pose`` in the parent's."""

    name: str
    kind: str
    """One of ``JOINT_TYPES``."""
    parent: str
    child: str
    pose: Pose
    """T_parent_child at joint position 0."""
    axis: Vec3
    """Unit vector, child frame."""
    lower: float = 0.0
    """Radians or metres; lower > upper = no limit."""
    upper: float = -1.0
    effort: float = 0.0
    """N m or N; 0 = not given."""
    velocity: float = 0.0
    """rad/s or m/s; 0 = not given."""
    damping: float = 0.0


@dataclass(frozen=True, slots=True)
class UrdfModel:
    """A checked tree of links."""

    name: str
    path: Path
    links: tuple[UrdfLink, ...]
    """The root first, each parent before its children."""
    joints: tuple[UrdfJoint, ...]
    """In the order of the file."""
    warnings: tuple[str, ...] = field(default=())

    @property
    def root(self) -> str:
        """Name of the link without a parent."""
        return self.links[0].name

    def link(self, name: str) -> UrdfLink:
        """Returns the link of this name, or raises RobotError that lists the known ones."""
        for link in self.links:
            if link.name == name:
                return link
        raise RobotError(f"{self.path}: no link {name!r}; known: {', '.join(link.name for link in self.links)}")

    def joint(self, name: str) -> UrdfJoint:
        """Returns the joint of this name, or raises RobotError that lists the known ones."""
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise RobotError(f"{self.path}: no joint {name!r}; known: {', '.join(joint.name for joint in self.joints)}")

    def transforms(self) -> dict[str, Mat4]:
        """Returns T_root_link, (4, 4), of every link with all joints at 0."""
        by_child = {joint.child: joint for joint in self.joints}
        out = {self.root: matrix_from_pose(Pose())}
        for link in self.links[1:]:
            joint = by_child[link.name]
            out[link.name] = out[joint.parent] @ matrix_from_pose(joint.pose)
        return out


def read_urdf(path: Path | str, find: FindMesh | None = None) -> UrdfModel:
    """Reads the URDF at ``path``.

    Args:
        path: the file.
        find: finds its meshes; None = ``resolve_mesh``.

    Raises:
        RobotError: the file is not there, is no URDF, or its tree is broken; one line.
    """
    path = Path(path)
    try:
        text = path.read_bytes()
    except FileNotFoundError as error:
        raise RobotError(f"no URDF at {path}") from error
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from error
    return parse_urdf(text, path, find)


def parse_urdf(text: str | bytes, source: Path, find: FindMesh | None = None) -> UrdfModel:
    """Reads a URDF that is at hand as text.

    Args:
        text: the XML.
        source: where it comes from, for messages and for names relative to it; need not exist.
        find: finds its meshes; None = ``resolve_mesh``.

    Raises:
        RobotError: it is no URDF, or its tree is broken; one line.
    """
    xacro = f"{source.absolute()}: is a xacro, not a URDF; expand it first: xacro {source.name} > robot.urdf"
    try:
        top = ET.fromstring(text)
    # A text that says it is UTF-16 is no such thing.
    except (ET.ParseError, ValueError, LookupError) as error:
        raise RobotError(xacro if is_xacro(text) else f"{source}: is not XML: {error}") from error
    if is_xacro(text, top):
        raise RobotError(xacro)
    return _Reader(source, find or resolve_mesh).model(top)


def is_xacro(text: str | bytes, top: ET.Element | None = None) -> bool:
    """Returns whether a description has elements that only xacro understands: includes, properties, calls of macros.

    Their prefix tells: the namespace that it stands for is not the same everywhere, and a part of a file often names none.

    Args:
        text: the XML.
        top: of it; None = it is not well-formed.
    """
    data = text.encode("utf-8", errors="replace") if isinstance(text, str) else text
    if top is None or _XACRO not in data:
        return _XACRO in data
    return _XACRO in _NO_ELEMENTS.sub(b"", data)


class _Reader:
    """Turns the XML of one file into values; gathers warnings on the way."""

    def __init__(self, path: Path, find: FindMesh) -> None:
        self.path = path.absolute()
        self.find = find
        self.warnings: list[str] = []
        self.colors: dict[str, Rgba] = {}

    def model(self, top: ET.Element) -> UrdfModel:
        if top.tag != "robot":
            raise RobotError(f"{self.path}: the outermost element is <{top.tag}>, a URDF has <robot>")
        for material in top.iter("material"):
            color = material.find("color")
            if color is not None:
                self.colors.setdefault(material.get("name", ""), self.rgba(color))
        links = [self.link(element) for element in top.findall("link")]
        joints = [self.joint(element) for element in top.findall("joint")]
        ordered = self.tree(links, joints)
        return UrdfModel(top.get("name", self.path.stem), self.path, ordered, tuple(joints), tuple(self.warnings))

    def tree(self, links: list[UrdfLink], joints: list[UrdfJoint]) -> tuple[UrdfLink, ...]:
        """Returns the links, parents first; raises where they do not form one tree."""
        self.unique("link", [link.name for link in links])
        self.unique("joint", [joint.name for joint in joints])
        by_name = {link.name: link for link in links}
        children: dict[str, list[str]] = {link.name: [] for link in links}
        parents: dict[str, UrdfJoint] = {}
        for joint in joints:
            for end in (joint.parent, joint.child):
                if end not in by_name:
                    raise RobotError(f"{self.path}: joint {joint.name!r} names link {end!r}, which is not there")
            if joint.child in parents:
                other = parents[joint.child].name
                raise RobotError(
                    f"{self.path}: link {joint.child!r} has two parents, through joints {other!r} and {joint.name!r}"
                )
            parents[joint.child] = joint
            children[joint.parent].append(joint.child)
        roots = [name for name in by_name if name not in parents]
        if not by_name:
            raise RobotError(f"{self.path}: has no <link>")
        if not roots:
            raise RobotError(f"{self.path}: has no root link: the joints form a cycle; one link must be no joint's child")
        if len(roots) > 1:
            raise RobotError(f"{self.path}: has {len(roots)} root links ({', '.join(roots)}); join them so that one is left")
        order: list[str] = []
        stack = [roots[0]]
        while stack:
            name = stack.pop()
            order.append(name)
            stack.extend(reversed(children[name]))
        if len(order) != len(by_name):
            lost = [name for name in by_name if name not in set(order)]
            raise RobotError(f"{self.path}: links {', '.join(lost)} form a cycle that the root {roots[0]!r} does not reach")
        return tuple(by_name[name] for name in order)

    def unique(self, what: str, names: Iterable[str]) -> None:
        seen: set[str] = set()
        for name in names:
            if name in seen:
                raise RobotError(f"{self.path}: two {what}s are named {name!r}; names must differ")
            seen.add(name)

    def link(self, element: ET.Element) -> UrdfLink:
        name = self.text(element, "name")
        where = f"link {name!r}"
        visuals = []
        for item in element.findall("visual"):
            shape = self.shape(item, f"{where}: visual")
            if shape is not None:
                visuals.append(UrdfVisual(shape, self.origin(item, where), self.color(item.find("material"), where)))
        collisions = []
        for item in element.findall("collision"):
            shape = self.shape(item, f"{where}: collision")
            if shape is not None:
                collisions.append(UrdfCollision(shape, self.origin(item, where)))
        friction = element.find("contact/lateral_friction")
        return UrdfLink(
            name, tuple(visuals), tuple(collisions), self.inertial(element.find("inertial"), where),
            None if friction is None else self.numbers(friction, "value", 1, where)[0],
            self.contact(element, "rolling_friction", where), self.contact(element, "spinning_friction", where),
        )  # fmt: skip

    def contact(self, element: ET.Element, key: str, where: str) -> float:
        found = element.find(f"contact/{key}")
        value = 0.0 if found is None else self.numbers(found, "value", 1, where)[0]
        if value < 0:
            raise RobotError(f"{self.path}: {where}: {key} is {value:g}, must not be negative")
        return value

    def joint(self, element: ET.Element) -> UrdfJoint:
        name = self.text(element, "name")
        where = f"joint {name!r}"
        kind = element.get("type", "")
        if kind not in JOINT_TYPES:
            raise RobotError(f"{self.path}: {where} has type {kind!r}, must be one of {', '.join(JOINT_TYPES)}")
        ends = []
        for tag in ("parent", "child"):
            end = element.find(tag)
            if end is None or not end.get("link"):
                raise RobotError(f'{self.path}: {where} has no <{tag} link="..."/>')
            ends.append(end.get("link", ""))
        axis_element = element.find("axis")
        axis = (1.0, 0.0, 0.0) if axis_element is None else self.vector(axis_element, "xyz", where)
        length = math.sqrt(sum(c * c for c in axis))
        if kind != "fixed" and length < 1e-9:
            raise RobotError(f"{self.path}: {where} has axis (0, 0, 0), which is no direction")
        unit = (axis[0] / length, axis[1] / length, axis[2] / length) if length > 1e-9 else (1.0, 0.0, 0.0)
        if element.find("mimic") is not None:
            self.warnings.append(f"{self.path.name}: {where}: <mimic> is not followed, the joint moves by itself")
        limit, damping = element.find("limit"), element.find("dynamics")
        lower, upper, effort, velocity = 0.0, -1.0, 0.0, 0.0
        if limit is not None:
            effort = self.optional(limit, "effort", where)
            velocity = self.optional(limit, "velocity", where)
            if kind in ("revolute", "prismatic"):
                lower, upper = self.optional(limit, "lower", where), self.optional(limit, "upper", where)
        return UrdfJoint(
            name, kind, ends[0], ends[1], self.origin(element, where), unit, lower, upper, effort, velocity,
            0.0 if damping is None else self.optional(damping, "damping", where),
        )  # fmt: skip

    def inertial(self, element: ET.Element | None, where: str) -> Inertial | None:
        if element is None:
            return None
        mass, inertia = element.find("mass"), element.find("inertia")
        if mass is None:
            raise RobotError(f"{self.path}: {where}: <inertial> has no <mass>")
        kg = self.numbers(mass, "value", 1, where)[0]
        if kg < 0:
            raise RobotError(f"{self.path}: {where}: mass is {kg:g} kg, must not be negative")
        ixx, ixy, ixz, iyy, iyz, izz = (
            0.0 if inertia is None else self.optional(inertia, key, where) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        return Inertial(kg, self.origin(element, where), (ixx, ixy, ixz, iyy, iyz, izz))

    def shape(self, element: ET.Element, where: str) -> Shape | None:
        """Returns the shape, or None (with a warning) when it cannot be used."""
        geometry = element.find("geometry")
        kinds = [] if geometry is None else list(geometry)
        if not kinds:
            self.warnings.append(f"{self.path.name}: {where} has no geometry; left out")
            return None
        item = kinds[0]
        if item.tag == "box":
            x, y, z = self.positive(self.vector(item, "size", where), where)
            return Shape("box", (x, y, z))
        if item.tag == "sphere":
            (radius,) = self.positive(self.numbers(item, "radius", 1, where), where)
            return Shape("sphere", (radius, 0.0, 0.0))
        if item.tag == "cylinder":
            sizes = (*self.numbers(item, "radius", 1, where), *self.numbers(item, "length", 1, where))
            radius, length = self.positive(sizes, where)
            return Shape("cylinder", (radius, length, 0.0))
        if item.tag == "mesh":
            scale = self.vector(item, "scale", where) if item.get("scale") else (1.0, 1.0, 1.0)
            name = self.text(item, "filename")
            found = self.find(name, self.path)
            if found is not None:
                return Shape("mesh", scale, str(found))
            text = f"{self.path.name}: {where}: mesh {name} is not there; left out"
            self.warnings.append(Omission(text, OmissionKind.MISSING_ASSET))
            return None
        text = f"{self.path.name}: {where}: shape <{item.tag}> is not known; left out"
        self.warnings.append(Omission(text, OmissionKind.UNSUPPORTED_ELEMENT))
        return None

    def color(self, material: ET.Element | None, where: str) -> Rgba | None:
        if material is None:
            return None
        own = material.find("color")
        if own is not None:
            return self.rgba(own)
        name = material.get("name", "")
        if name not in self.colors and material.find("texture") is None:
            self.warnings.append(f"{self.path.name}: {where}: material {name!r} is not defined; drawn without a colour")
        return self.colors.get(name)

    def rgba(self, element: ET.Element) -> Rgba:
        r, g, b, a = (min(max(c, 0.0), 1.0) for c in self.numbers(element, "rgba", 4, "material"))
        return (r, g, b, a)

    def origin(self, element: ET.Element, where: str) -> Pose:
        item = element.find("origin")
        if item is None:
            return Pose()
        zero = (0.0, 0.0, 0.0)
        xyz = self.vector(item, "xyz", where) if item.get("xyz") else zero
        rpy = self.vector(item, "rpy", where) if item.get("rpy") else zero
        return pose_from_xyz_rpy(xyz, rpy)

    def positive(self, values: tuple[float, ...], where: str) -> tuple[float, ...]:
        if min(values) <= 0:
            raise RobotError(f"{self.path}: {where}: size {values} must be above 0 in every direction")
        return values

    def text(self, element: ET.Element, key: str) -> str:
        value = element.get(key, "").strip()
        if not value:
            raise RobotError(f"{self.path}: a <{element.tag}> has no {key}")
        return value

    def vector(self, element: ET.Element, key: str, where: str) -> Vec3:
        x, y, z = self.numbers(element, key, 3, where)
        return (x, y, z)

    def optional(self, element: ET.Element, key: str, where: str) -> float:
        return self.numbers(element, key, 1, where)[0] if element.get(key) else 0.0

    def numbers(self, element: ET.Element, key: str, count: int, where: str) -> tuple[float, ...]:
        raw = element.get(key, "")
        try:
            values = tuple(float(part) for part in raw.split())
        except ValueError:
            values = ()
        if len(values) != count or not all(map(math.isfinite, values)):
            wanted = "a finite number" if count == 1 else f"{count} finite numbers"
            raise RobotError(f'{self.path}: {where}: <{element.tag} {key}="{raw}">, must be {wanted}')
        return values


def resolve_mesh(name: str, urdf: Path) -> Path | None:
    """Returns the absolute path of the mesh that a URDF names, or None when there is no such file.

    ``package://<package>/<rest>`` is looked for beside the URDF, in its parent folders, and in ``$AMENT_PREFIX_PATH``; other
    names are relative to the URDF's folder, or to one of the three above it.
    """
    if name.startswith(_FILE):
        name = name[len(_FILE) :]
    if not name.startswith(_PACKAGE):
        above = [folder for folder in urdf.parents[1 : _LEVELS_UP + 1] if folder != folder.parent]
        paths = (Path(os.path.normpath(folder / name)) for folder in (urdf.parent, *above))
        return next((path for path in paths if path.is_file()), None)
    package, _, rest = name[len(_PACKAGE) :].partition("/")
    candidates: list[Path] = []
    for folder in urdf.parents:
        if folder.name == package:
            candidates.append(folder / rest)
        candidates.append(folder / package / rest)
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    candidates += [Path(prefix) / "share" / package / rest for prefix in prefixes if prefix]
    return next((path for path in candidates if path.is_file()), None)
