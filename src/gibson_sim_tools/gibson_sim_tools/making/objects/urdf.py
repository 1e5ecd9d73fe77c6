"""Generates the URDF of an object. Pure functions."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from gibson_sim_tools.making.objects.model import ObjectJoint, ObjectLink, ObjectModel, Primitive, mass_properties

_EFFORT, _SPEED = "100", "10"
"""Effort and velocity limits of joints, required by URDF; no joint has a motor."""


def object_urdf(model: ObjectModel) -> str:
    """Returns the text of the URDF; it refers to one mesh per link in the same folder (see ``mesh_name``)."""
    # The name of the model is its semantic class in images.
    robot = ET.Element("robot", name=model.semantic_class)
    for link in model.links:
        _link(robot, model, link)
    for joint in model.joints:
        _joint(robot, joint)
    ET.indent(robot)
    return f'<?xml version="1.0"?>\n{ET.tostring(robot, encoding="unicode")}\n'


def mesh_name(model: ObjectModel, link: ObjectLink) -> str:
    """Returns the file name of the mesh of a link."""
    return f"{model.name}.glb" if len(model.links) == 1 else f"{model.name}_{link.mesh or link.name}.glb"


def _link(robot: ET.Element, model: ObjectModel, link: ObjectLink) -> None:
    element = ET.SubElement(robot, "link", name=link.name)
    if not link.primitives:
        return
    contact = ET.SubElement(element, "contact")
    ET.SubElement(contact, "lateral_friction", value=_text(link.friction))
    if link.rolling_friction:
        ET.SubElement(contact, "rolling_friction", value=_text(link.rolling_friction))
        ET.SubElement(contact, "spinning_friction", value=_text(link.rolling_friction))
    mass = mass_properties(link)
    inertial = ET.SubElement(element, "inertial")
    ET.SubElement(inertial, "origin", xyz=_text(*mass.center), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=_text(mass.mass))
    i = mass.inertia
    moments = {"ixx": i[0, 0], "ixy": i[0, 1], "ixz": i[0, 2], "iyy": i[1, 1], "iyz": i[1, 2], "izz": i[2, 2]}
    ET.SubElement(inertial, "inertia", {key: f"{value:.5g}" for key, value in moments.items()})
    if link.visual:
        geometry = ET.SubElement(ET.SubElement(element, "visual"), "geometry")
        ET.SubElement(geometry, "mesh", filename=mesh_name(model, link))
    for primitive in link.primitives:
        _collision(element, primitive)


def _collision(element: ET.Element, primitive: Primitive) -> None:
    collision = ET.SubElement(element, "collision")
    ET.SubElement(collision, "origin", xyz=_text(*primitive.middle), rpy=_text(*primitive.rpy))
    geometry = ET.SubElement(collision, "geometry")
    if primitive.kind == "box":
        ET.SubElement(geometry, "box", size=_text(*primitive.size))
    elif primitive.kind == "sphere":
        ET.SubElement(geometry, "sphere", radius=_text(primitive.size[0]))
    else:
        ET.SubElement(geometry, "cylinder", radius=_text(primitive.size[0]), length=_text(primitive.size[1]))


def _joint(robot: ET.Element, joint: ObjectJoint) -> None:
    element = ET.SubElement(robot, "joint", name=joint.name, type=joint.kind)
    ET.SubElement(element, "parent", link=joint.parent)
    ET.SubElement(element, "child", link=joint.child)
    ET.SubElement(element, "origin", xyz=_text(*joint.origin), rpy="0 0 0")
    if joint.kind == "fixed":
        return
    ET.SubElement(element, "axis", xyz=_text(*joint.axis))
    ET.SubElement(element, "limit", lower=_text(joint.lower), upper=_text(joint.upper), effort=_EFFORT, velocity=_SPEED)
    ET.SubElement(element, "dynamics", damping=_text(joint.damping))


def _text(*values: float) -> str:
    return " ".join(f"{float(value) + 0.0:.6g}" for value in values)
