"""Parses a URDF file to plain values: links, shapes, joints. Pure: imports neither a physics engine nor ROS.

An invalid structure (no root, two roots, a cycle, text in place of a number) is a ``RobotError``. Dispensable elements (a missing mesh, a shape
of unknown type) are left out, with one line in ``UrdfModel.warnings``.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from gibson_sim.description.gazebo import gazebo_left_out, read_gazebo
from gibson_sim.description.mesh_files import resolve_mesh, without_up_axis
from gibson_sim.description.omissions import Omission, OmissionKind
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf_left_out import left_out, listed
from gibson_sim.description.urdf_model import (
    JOINT_TYPES,
    Inertial,
    Mimic,
    UrdfCollision,
    UrdfJoint,
    UrdfLink,
    UrdfModel,
    UrdfVisual,
    leaders,
)
from gibson_sim.description.xacro import is_xacro, with_defaults
from gibson_sim.errors import RobotError, TextError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.quoting import quoted
from gibson_sim.reading import parse_xml, read_file, without_default_namespace
from gibson_sim.types import Pose, Quat, Rgba, Vec3

__all__ = [
    "JOINT_TYPES", "FindMesh", "Inertial", "UrdfCollision", "UrdfJoint", "UrdfLink", "UrdfModel", "UrdfVisual", "parse_urdf", "read_urdf",
]  # fmt: skip

_ENDLESS = 1000.0
"""Limit of a joint beyond which it turns without end, rad: wheels are often described as revolute joints with limits of 1e16."""
FindMesh = Callable[[str, Path], Path | None]
"""Function that returns the absolute path of a mesh, given its name and the path of the URDF, or None if it does not exist."""


def read_urdf(path: Path | str, find: FindMesh | None = None) -> UrdfModel:
    """Returns the model in the URDF at ``path``.

    Args:
        path: The file.
        find: Finds its meshes; None = ``resolve_mesh``.

    Raises:
        RobotError: the file is missing, is not a URDF, or its tree is invalid; one line.
    """
    path = Path(path)
    try:
        text = read_file(path)
    except FileNotFoundError as error:
        raise RobotError(f"no URDF at {path}") from error
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from error
    return parse_urdf(text, path, find)


def parse_urdf(text: str | bytes, source: Path, find: FindMesh | None = None) -> UrdfModel:
    """Returns the model in the text of a URDF.

    Args:
        text: The XML.
        source: Path of its file, for messages and relative names; need not exist.
        find: Finds its meshes; None = ``resolve_mesh``.

    Raises:
        RobotError: the text is not a URDF, or its tree is invalid; one line.
    """
    xacro = f"{source.absolute()}: is a xacro, not a URDF; expand it first: xacro {source.name} > robot.urdf"
    try:
        top = without_default_namespace(
            parse_xml(with_defaults(text.encode("utf-8", errors="replace") if isinstance(text, str) else text))
        )
    except TextError as error:
        raise RobotError(xacro if is_xacro(text) else f"{source}: {error}").with_public(error.public) from error
    if is_xacro(text, top):
        raise RobotError(xacro)
    return _Reader(source, find or resolve_mesh).model(top)


class _Material(NamedTuple):
    """Colour and texture of a material; neither = the material is not defined."""

    color: Rgba | None = None
    """sRGB and alpha, 0 to 1."""
    texture: str = ""
    """Name of the image, as in the file."""


class _Reader:
    """Converts the XML of one file to values, and collects warnings."""

    def __init__(self, path: Path, find: FindMesh) -> None:
        self.path, self.find = path.absolute(), find
        self.warnings: list[str] = []
        self.materials: dict[str, _Material] = {}
        """Named materials."""
        self.remarks: dict[str, list[str]] = {}
        """What is odd -> names of the elements: one warning each."""
        self.frictions: dict[str, float] = {}
        """Link -> Coulomb friction from ``<gazebo>`` elements."""

    def model(self, top: ET.Element) -> UrdfModel:
        """Returns the model of a ``<robot>``."""
        if top.tag != "robot":
            hint = "; MJCF (MuJoCo) is not read, convert it to URDF or SDF" if top.tag == "mujoco" else ""
            raise RobotError(f"{self.path}: the outermost element is <{top.tag}>, must be <robot>{hint}")
        self.collect_materials(top)
        gazebo = read_gazebo(top)
        self.frictions = gazebo.frictions
        links = [self.link(element) for element in top.findall("link")]
        joints = [self.joint(element) for element in top.findall("joint")]
        ordered = self.sorted_links(links, joints)
        joints = self.with_final_leaders(joints)
        if not top.get("name"):
            self.remark(f"the <robot> has no name, which ROS refuses: it is called {quoted(self.path.stem)}")
        lines = [f"{what}: {listed(dict.fromkeys(names))}" if names else what for what, names in self.remarks.items()]
        self.warnings += [f"{self.path.name}: {line}" for line in lines]
        self.warnings += [*left_out(top, self.path.name), *gazebo_left_out(top, self.path.name)]
        return UrdfModel(top.get("name") or self.path.stem, self.path, ordered, tuple(joints), tuple(self.warnings), gazebo)

    def remark(self, what: str, name: str = "") -> None:
        """Notes something odd, for one warning that lists all names."""
        names = self.remarks.setdefault(what, [])
        if name:
            names.append(name)

    def collect_materials(self, top: ET.Element) -> None:
        """Reads the named materials: those of the robot, then those within visuals, the first of each name, as ROS does."""
        for material in (*top.findall("material"), *top.findall("link/visual/material")):
            name, defined = material.get("name", ""), self.defined_material(material)
            if name and defined != _Material() and self.materials.setdefault(name, defined) != defined:
                self.remark("materials are defined again with another colour; the first counts, as in ROS", quoted(name))

    def defined_material(self, material: ET.Element) -> _Material:
        """Returns what a <material> itself defines, not what one of its name does."""
        color, texture = material.find("color"), material.find("texture")
        return _Material(
            None if color is None else self.rgba(color), "" if texture is None else texture.get("filename", "").strip()
        )

    def sorted_links(self, links: list[UrdfLink], joints: list[UrdfJoint]) -> tuple[UrdfLink, ...]:
        """Returns the links, parents first; raises RobotError if they do not form one tree."""
        self.check_unique("link", [link.name for link in links])
        self.check_unique("joint", [joint.name for joint in joints])
        by_name = {link.name: link for link in links}
        children: dict[str, list[str]] = {link.name: [] for link in links}
        parents: dict[str, UrdfJoint] = {}
        for joint in joints:
            for end in (joint.parent, joint.child):
                if end not in by_name:
                    raise RobotError(f"{self.path}: joint {quoted(joint.name)} names link {quoted(end)}, which does not exist")
            if joint.child in parents:
                other = parents[joint.child].name
                raise RobotError(
                    f"{self.path}: link {quoted(joint.child)} has two parents, by joints {quoted(other)} and {quoted(joint.name)}"
                )
            parents[joint.child] = joint
            children[joint.parent].append(joint.child)
        roots = [name for name in by_name if name not in parents]
        if not by_name:
            raise RobotError(f"{self.path}: has no <link>")
        if not roots:
            raise RobotError(f"{self.path}: has no root link: the joints form a cycle; one link must have no parent")
        if len(roots) > 1:
            raise RobotError(f"{self.path}: has {len(roots)} root links ({listed(roots)}); connect them so that only one remains")
        order: list[str] = []
        stack = [roots[0]]
        while stack:
            name = stack.pop()
            order.append(name)
            stack.extend(reversed(children[name]))
        if len(order) != len(by_name):
            reached = set(order)
            unreachable = [name for name in by_name if name not in reached]
            raise RobotError(
                f"{self.path}: links {listed(unreachable)} form a cycle that the root {quoted(roots[0])} does not reach"
            )
        return tuple(by_name[name] for name in order)

    def with_final_leaders(self, joints: list[UrdfJoint]) -> list[UrdfJoint]:
        """Returns the joints, with the last joint of its chain as the leader of each mimic joint."""
        moving = [joint.name for joint in joints if joint.kind != "fixed"]
        mimics = leaders({joint.name: joint.mimic for joint in joints if joint.mimic is not None}, moving, str(self.path))
        return [replace(joint, mimic=mimics.get(joint.name)) for joint in joints]

    def check_unique(self, what: str, names: Iterable[str]) -> None:
        """Raises RobotError if two names are equal."""
        seen: set[str] = set()
        for name in names:
            if name in seen:
                raise RobotError(f"{self.path}: two {what}s are named {quoted(name)}; names must be unique")
            seen.add(name)

    def link(self, element: ET.Element) -> UrdfLink:
        name = self.text(element, "name")
        where = f"link {quoted(name)}"
        visuals, missing = [], False
        for item in element.findall("visual"):
            shape = self.shape(item, f"{where}: visual")
            missing = missing or shape is None
            if shape is not None:
                material = self.material(item.find("material"), where)
                visuals.append(UrdfVisual(*without_up_axis(shape, self.origin(item, where)), material.color, material.texture))
        collisions = []
        for item in element.findall("collision"):
            shape = self.shape(item, f"{where}: collision")
            if shape is not None:
                collisions.append(UrdfCollision(*without_up_axis(shape, self.origin(item, where))))
        if missing and not visuals and collisions:
            visuals = [UrdfVisual(collision.shape, collision.pose, None) for collision in collisions]
            self.warnings.append(f"{self.path.name}: {where}: its collision shapes are drawn, since it has no usable visual")
        friction = element.find("contact/lateral_friction")
        return UrdfLink(
            name, tuple(visuals), tuple(collisions), self.inertial(element.find("inertial"), where),
            self.frictions.get(name) if friction is None else self.numbers(friction, "value", 1, where)[0],
            self.contact(element, "rolling_friction", where), self.contact(element, "spinning_friction", where),
            self.contact(element, "stiffness", where), self.contact(element, "damping", where),
        )  # fmt: skip

    def contact(self, element: ET.Element, key: str, where: str) -> float:
        """Returns a non-negative number in the ``<contact>`` of a link; 0 if it is missing."""
        item = element.find(f"contact/{key}")
        value = 0.0 if item is None else self.numbers(item, "value", 1, where)[0]
        if value < 0:
            raise RobotError(f"{self.path}: {where}: {key} is {value:g}, must not be negative")
        return value

    def joint(self, element: ET.Element) -> UrdfJoint:
        name = self.text(element, "name")
        where = f"joint {quoted(name)}"
        kind = element.get("type", "")
        if kind not in JOINT_TYPES:
            raise RobotError(f"{self.path}: {where} has type {quoted(kind)}, must be one of {', '.join(JOINT_TYPES)}")
        ends = []
        for tag in ("parent", "child"):
            end = element.find(tag)
            if end is None or not end.get("link"):
                raise RobotError(f'{self.path}: {where} has no <{tag} link="..."/>')
            ends.append(end.get("link", ""))
        axis_element = None if kind in ("fixed", "floating") else element.find("axis")
        axis = (1.0, 0.0, 0.0) if axis_element is None else self.vector(axis_element, "xyz", where)
        length = math.sqrt(sum(c * c for c in axis))
        if length < 1e-9:
            raise RobotError(f"{self.path}: {where} has axis (0, 0, 0), which is not a direction")
        unit = (axis[0] / length, axis[1] / length, axis[2] / length)
        limit, dynamics = element.find("limit"), element.find("dynamics")
        damping, friction = (0.0 if dynamics is None else self.optional(dynamics, key, where) for key in ("damping", "friction"))
        lower, upper, effort, velocity = 0.0, -1.0, 0.0, 0.0
        if limit is not None:
            effort = self.optional(limit, "effort", where)
            velocity = self.optional(limit, "velocity", where)
            if min(effort, velocity) < 0:
                raise RobotError(f"{self.path}: {where}: effort is {effort:g} and velocity {velocity:g}, neither may be negative")
            if kind in ("revolute", "prismatic"):
                lower, upper = self.optional(limit, "lower", where), self.optional(limit, "upper", where)
                if lower > upper:
                    self.remark(
                        "joints whose lower limit is above the upper one move without limits, from 0; are they swapped?",
                        f"{quoted(name)} ({lower:g} to {upper:g})",
                    )
                elif kind == "revolute" and lower <= -_ENDLESS and upper >= _ENDLESS:
                    self.remark(f"revolute joints with limits beyond {_ENDLESS:g} rad are continuous", quoted(name))
                    kind, lower, upper = "continuous", 0.0, -1.0
            elif {"lower", "upper"} & limit.attrib.keys() and kind == "continuous":
                self.remark("continuous joints have no position limits; lower and upper are left out", quoted(name))
            if kind != "fixed" and 0.0 in (effort, velocity):
                self.remark("joints whose effort or velocity is missing or 0 in <limit> get the default of motors", quoted(name))
        elif kind in ("revolute", "prismatic"):
            self.remark(
                "revolute and prismatic joints without <limit>, which ROS refuses, move without limits, from 0", quoted(name)
            )
        return UrdfJoint(
            name, kind, ends[0], ends[1], self.origin(element, where), unit, lower, upper, effort, velocity,
            damping, self.mimic(element.find("mimic"), kind, where), friction,
        )  # fmt: skip

    def mimic(self, element: ET.Element | None, kind: str, where: str) -> Mimic | None:
        if element is None or kind == "fixed":
            return None
        if not element.get("joint"):
            raise RobotError(f"{self.path}: {where}: <mimic> names no joint")
        multiplier = self.optional(element, "multiplier", where, 1.0)
        return Mimic(element.get("joint", ""), multiplier, self.optional(element, "offset", where))

    def inertial(self, element: ET.Element | None, where: str) -> Inertial | None:
        if element is None:
            return None
        mass, inertia = element.find("mass"), element.find("inertia")
        if mass is None:
            raise RobotError(f"{self.path}: {where}: <inertial> has no <mass>")
        kg = self.numbers(mass, "value", 1, where)[0]
        if kg < 0:
            raise RobotError(f"{self.path}: {where}: mass is {kg:g} kg, must not be negative")
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        ixx, ixy, ixz, iyy, iyz, izz = (0.0 if inertia is None else self.optional(inertia, key, where) for key in keys)
        for key, value in (("ixx", ixx), ("iyy", iyy), ("izz", izz)):
            if value < 0:
                raise RobotError(f"{self.path}: {where}: {key} is {value:g} kg m^2, must not be negative; is its sign wrong?")
        return Inertial(kg, self.origin(element, where), (ixx, ixy, ixz, iyy, iyz, izz))

    def shape(self, element: ET.Element, where: str) -> Shape | None:
        """Returns the shape of a visual or collision shape, or None with a warning if it cannot be used."""
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
        if item.tag in ("cylinder", "capsule"):
            sizes = (*self.numbers(item, "radius", 1, where), *self.numbers(item, "length", 1, where))
            radius, length = self.positive(sizes, where)
            return Shape("cylinder" if item.tag == "cylinder" else "capsule", (radius, length, 0.0))
        if item.tag == "mesh":
            scale = self.vector(item, "scale", where) if "scale" in item.attrib else (1.0, 1.0, 1.0)
            if 0.0 in scale:
                raise RobotError(f"{self.path}: {where}: scale {scale} makes the mesh flat; no factor may be 0")
            name = self.text(item, "filename")
            path = self.find(name, self.path)
            if path is not None:
                return Shape("mesh", scale, str(path))
            text = f"{self.path.name}: {where}: mesh {name} does not exist; left out"
            self.warnings.append(Omission(text, OmissionKind.MISSING_ASSET))
            return None
        text = f"{self.path.name}: {where}: shape <{item.tag}> is not known; left out"
        self.warnings.append(Omission(text, OmissionKind.UNSUPPORTED_ELEMENT))
        return None

    def material(self, element: ET.Element | None, where: str) -> _Material:
        """Returns the material of a visual, whose texture is the absolute path of an image that exists."""
        if element is None:
            return _Material()
        name = element.get("name", "")
        material = self.defined_material(element)
        if name:
            material = self.materials.get(name, material)
        if material == _Material():
            self.warnings.append(f"{self.path.name}: {where}: material {quoted(name)} is not defined; drawn without a colour")
        if not material.texture:
            return material
        path = self.find(material.texture, self.path)
        if path is None:
            text = f"{self.path.name}: texture {material.texture} does not exist; left out"
            if text not in self.warnings:
                self.warnings.append(Omission(text, OmissionKind.MISSING_ASSET))
        return _Material(material.color, "" if path is None else str(path))

    def rgba(self, element: ET.Element) -> Rgba:
        values = self.numbers(element, "rgba", 4, "material")
        r, g, b, a = (min(max(c, 0.0), 1.0) for c in values)
        if (r, g, b, a) != values:
            self.remark("colours outside of 0 to 1 are clipped", quoted(element.get("rgba", "")))
        return (r, g, b, a)

    # Values

    def origin(self, element: ET.Element, where: str) -> Pose:
        """Returns the pose in the ``<origin>`` of an element; the identity if it is missing."""
        item = element.find("origin")
        if item is None:
            return Pose()
        zero = (0.0, 0.0, 0.0)
        xyz = self.vector(item, "xyz", where) if "xyz" in item.attrib else zero
        if "quat_xyzw" in item.attrib:
            return Pose(xyz, self.quaternion(item, where))
        return pose_from_xyz_rpy(xyz, self.vector(item, "rpy", where) if "rpy" in item.attrib else zero)

    def quaternion(self, element: ET.Element, where: str) -> Quat:
        """Returns the unit quaternion in ``quat_xyzw``."""
        if "rpy" in element.attrib:
            raise RobotError(f"{self.path}: {where}: <{element.tag}> has both rpy and quat_xyzw; give one of them")
        values = self.numbers(element, "quat_xyzw", 4, where)
        length = math.sqrt(sum(c * c for c in values))
        if length < 1e-9:
            raise RobotError(f"{self.path}: {where}: quat_xyzw is {values}, which is not a rotation")
        x, y, z, w = (c / length for c in values)
        return (x, y, z, w)

    def positive(self, values: tuple[float, ...], where: str) -> tuple[float, ...]:
        """Returns the values; raises RobotError unless all are above 0."""
        if min(values) <= 0:
            raise RobotError(f"{self.path}: {where}: size {values} must be above 0 in every direction")
        return values

    def text(self, element: ET.Element, key: str) -> str:
        """Returns the value of an attribute; raises RobotError if it is missing or empty."""
        value = element.get(key, "").strip()
        if not value:
            raise RobotError(f"{self.path}: a <{element.tag}> has no {key}")
        return value

    def vector(self, element: ET.Element, key: str, where: str) -> Vec3:
        """Returns three finite numbers in an attribute."""
        x, y, z = self.numbers(element, key, 3, where)
        return (x, y, z)

    def optional(self, element: ET.Element, key: str, where: str, default: float = 0.0) -> float:
        """Returns a finite number in an attribute, or the default if it is missing."""
        return self.numbers(element, key, 1, where)[0] if key in element.attrib else default

    def numbers(self, element: ET.Element, key: str, count: int, where: str) -> tuple[float, ...]:
        """Returns ``count`` finite numbers in an attribute; raises RobotError for other values."""
        raw = element.get(key, "")
        try:
            values = () if "_" in raw else tuple(float(part) for part in raw.split())  # Python reads 1_0 as 10
        except ValueError:
            values = ()
        if len(values) != count or not all(map(math.isfinite, values)):
            expected = "a finite number" if count == 1 else f"{count} finite numbers"
            raise RobotError(f'{self.path}: {where}: <{element.tag} {key}="{raw}">, must be {expected}')
        return values
