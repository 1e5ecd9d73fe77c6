"""Changes the root link of a URDF to the frame of odometry, which is on the floor. Pure."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gibson_sim.description.extents import rigid_links
from gibson_sim.description.rigid_groups import rpy_from_matrix
from gibson_sim.description.urdf import UrdfModel
from gibson_sim.description.xacro import cache_description
from gibson_sim.errors import RobotError
from gibson_sim.geometry.transforms import Mat4, invert, matrix_from_pose
from gibson_sim.quoting import quoted
from gibson_sim.reading import parse_xml, read_file, without_default_namespace

FOOTPRINT = "base_footprint"
"""Name of the added link on the floor."""


def with_base(
    model: UrdfModel,
    base: str,
    height: float,
    drops: Mapping[str, float],
    frictions: Mapping[str, float],
    rounds: Mapping[str, float],
) -> Path:
    """Returns the path of a URDF whose root is the frame of odometry: the file itself if it is unchanged, else a file in the cache.

    Args:
        model: The description.
        base: A link that is connected to the root by fixed joints only.
        height: Height of the root above the floor, metres; if not 0, a link below it, named ``base_footprint``, becomes the root.
        drops: Joint -> distance by which its child is lowered, metres.
        frictions: Link -> Coulomb friction that replaces that of the file.
        rounds: Link -> radius, metres, of the sphere about its origin that replaces its collision shapes, and those of links fixed to it.

    Raises:
        RobotError: ``base`` cannot be the root, or the joint does not exist.
    """
    if base == model.root and height == 0.0 and not any(drops.values()) and not frictions and not rounds:
        return model.path
    if base not in model.fixed_to_root():
        known = ", ".join(model.fixed_to_root())
        raise RobotError(
            f"base_link is {quoted(base)}, must be the root link of {model.path.name}, {quoted(model.root)}, or a link fixed "
            f"to it: {known}"
        )
    top = without_default_namespace(parse_xml(read_file(model.path)))
    _lower_joints(top, model, drops)
    _set_frictions(top, model, frictions)
    _set_spheres(top, model, rounds)
    if base != model.root:
        _reverse_joints(top, model, base)
    if height != 0.0:
        names = {link.name for link in model.links}
        name = (
            FOOTPRINT
            if FOOTPRINT not in names
            else next(f"floor_{i}" for i in range(len(names) + 1) if f"floor_{i}" not in names)
        )
        ET.SubElement(top, "link", name=name)
        under = np.eye(4)
        under[2, 3] = height
        _add_fixed_joint(top, f"{name}_to_{base}".replace("/", "_"), name, base, under)
    return cache_description(ET.tostring(top, encoding="utf-8", xml_declaration=True), model.path)


def _lower_joints(top: ET.Element, model: UrdfModel, drops: Mapping[str, float]) -> None:
    """Lowers the origins of joints along the z axis of the root."""
    transforms = model.transforms()
    elements = {element.get("name"): element for element in top.findall("joint")}
    for name, drop in drops.items():
        joint = model.joint(name)
        down = transforms[joint.parent][:3, :3].T @ np.array([0.0, 0.0, -drop])
        origin = elements[name].find("origin")
        if origin is None:
            origin = ET.SubElement(elements[name], "origin")
        origin.set("xyz", " ".join(f"{c:.9g}" for c in np.array(joint.pose.position) + down))


def _set_frictions(top: ET.Element, model: UrdfModel, frictions: Mapping[str, float]) -> None:
    """Sets the friction of links."""
    elements = {element.get("name"): element for element in top.findall("link")}
    for name, value in frictions.items():
        if value < 0.0:
            raise RobotError(f"friction of {quoted(name)} is {value:g}, must not be negative")
        link = elements[model.link(name).name]
        contact = link.find("contact")
        if contact is None:
            contact = ET.SubElement(link, "contact")
        friction = contact.find("lateral_friction")
        if friction is None:
            friction = ET.SubElement(contact, "lateral_friction")
        friction.set("value", f"{value:.9g}")


def _set_spheres(top: ET.Element, model: UrdfModel, rounds: Mapping[str, float]) -> None:
    """Replaces the collision shapes of wheels by spheres."""
    elements = {element.get("name"): element for element in top.findall("link")}
    for name, radius in rounds.items():
        if radius <= 0.0:
            raise RobotError(f"round_wheels: the radius of {quoted(name)} is {radius:g} m, must be above 0")
        for link in rigid_links(model, model.link(name).name):
            for collision in elements[link].findall("collision"):
                elements[link].remove(collision)
        geometry = ET.SubElement(ET.SubElement(elements[name], "collision"), "geometry")
        ET.SubElement(geometry, "sphere", radius=f"{radius:.9g}")


def _reverse_joints(top: ET.Element, model: UrdfModel, base: str) -> None:
    """Reverses the fixed joints between the root and ``base``, so that each child becomes the parent."""
    by_child = {joint.child: joint for joint in model.joints}
    elements = {element.get("name"): element for element in top.findall("joint")}
    name = base
    while name != model.root:
        joint = by_child[name]
        top.remove(elements[joint.name])
        _add_fixed_joint(top, joint.name, joint.child, joint.parent, invert(matrix_from_pose(joint.pose)))
        name = joint.parent


def _add_fixed_joint(top: ET.Element, name: str, parent: str, child: str, T_parent_child: Mat4) -> None:
    joint = ET.SubElement(top, "joint", name=name, type="fixed")
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    xyz, rpy = T_parent_child[:3, 3], rpy_from_matrix(T_parent_child[:3, :3])
    ET.SubElement(joint, "origin", xyz=" ".join(f"{c:.9g}" for c in xyz), rpy=" ".join(f"{angle:.9g}" for angle in rpy))
