"""Merges links that are connected by fixed joints into rigid groups, and writes the reduced URDF for a physics engine. Pure.

Bullet gives links without an ``<inertial>`` a mass of 1 kg, and fixes a massless root. A group has the sum of the masses of its links, so that
massless links (``base_footprint``, ``camera_link``) have no effect and take no time.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.extents import shape_points
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import UrdfJoint, UrdfLink, UrdfModel
from gibson_sim.description.urdf_left_out import listed
from gibson_sim.errors import RobotError
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose
from gibson_sim.quoting import quoted

MOVING_TYPES = ("continuous", "revolute", "prismatic")
DEFAULT_FRICTION = 0.5
"""Default Coulomb friction of links; the engine multiplies it with that of the other body (static shapes: 1)."""
MAX_MOVING_JOINTS = 121
"""Maximum number of moving joints of a body: the engine has 128 coordinates, seven of which are the pose of the root."""
MAX_JOINTS = 127
"""Maximum number of joints of a body in the engine, including fixed joints to links with their own friction."""
_DEFAULT_ROOT_KG = 1.0
"""Default mass of a root group, kg."""
_DEFAULT_LINK_KG = 0.05
"""Default mass of other groups, kg."""
_DEFAULT_GYRATION = 0.05
"""Radius of gyration of a group whose inertia is invalid, or that has neither mass nor shape, metres."""
_INERTIA_ROUNDING = 0.01
"""Violation of the triangle inequality that counts as rounding, as a fraction of the largest moment."""
_LEAST_SIDE = 0.02
"""Minimum side of the box from which the inertia of a massless group is computed, metres; smaller values make an engine unstable."""


@dataclass(slots=True)
class RigidGroup:
    """Links that are rigidly connected. All matrices and vectors are in the frame of the first link."""

    name: str
    """Name of the first link, whose frame is that of the group."""
    joint: UrdfJoint | None
    """Joint to the parent group; None for the root."""
    parent: str = ""
    """Name of the parent group."""
    T_parent_group: Mat4 = field(default_factory=lambda: np.eye(4))
    """Pose in the parent group at joint position 0, (4, 4)."""
    members: dict[str, Mat4] = field(default_factory=dict)
    """Link name -> T_group_link, (4, 4)."""
    collisions: list[tuple[Shape, Mat4]] = field(default_factory=list)
    """Collision shapes, each with T_group_shape, (4, 4)."""
    friction: float | None = None
    rolling_friction: float = 0.0
    spinning_friction: float = 0.0
    stiffness: float = 0.0
    contact_damping: float = 0.0
    mass: float = 0.0
    """Mass, kg."""
    center: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    """Centre of mass, (3,), metres."""
    inertia: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))
    """Inertia about the centre of mass, (3, 3), kg m^2."""
    mass_is_assumed: bool = False
    """Whether the mass is a default, since the description gives none."""


def rigid_groups(model: UrdfModel, *, fixed_root: bool = False) -> tuple[tuple[RigidGroup, ...], tuple[str, ...]]:
    """Returns (groups, warnings): the group of the root first, parents before children.

    A fixed link with its own friction or stiffness remains a separate group, because in the engine these are properties of a link.

    Args:
        model: The links.
        fixed_root: Whether the root never moves, so that it needs no mass.
    """
    by_child = {joint.child: joint for joint in model.joints}
    groups: dict[str, RigidGroup] = {}
    group_of_link: dict[str, str] = {}
    for link in model.links:
        joint = by_child.get(link.name)
        parent = None if joint is None else groups[group_of_link[joint.parent]]
        if joint is None or parent is None:
            group = _group(link, None)
            T_group_link: Mat4 = np.eye(4)
        else:
            T_group_link = parent.members[joint.parent] @ matrix_from_pose(joint.pose)
            if joint.kind == "fixed" and _same_contact(parent, link):
                group = parent
            elif joint.kind in (*MOVING_TYPES, "fixed"):
                group = _group(link, joint, parent.name, T_group_link)
                T_group_link = np.eye(4)
            else:
                raise RobotError(
                    f"{model.path}: joint {quoted(joint.name)} is {joint.kind}, which is not simulated; use one of {MOVING_TYPES}"
                )
        groups[group.name] = group
        group_of_link[link.name] = group.name
        group.members[link.name] = T_group_link
        _add_link(group, link, T_group_link)
    _check_count(model, [group.joint for group in groups.values() if group.joint is not None])
    warnings: list[str] = []
    kept: set[str] = set()
    for group in groups.values():
        replaced = _check_mass(model, group)
        if group.joint or not fixed_root:
            warnings += replaced
            kept.update(() if replaced else group.members)
    return tuple(groups.values()), (*warnings, *_impossible_inertias(model, kept))


def _check_count(model: UrdfModel, joints: list[UrdfJoint]) -> None:
    moving = sum(joint.kind in MOVING_TYPES for joint in joints)
    if moving > MAX_MOVING_JOINTS or len(joints) > MAX_JOINTS:
        raise RobotError(
            f"{model.path}: has {moving} moving joints and {len(joints) - moving} fixed links with their own friction, must have at most "
            f"{MAX_MOVING_JOINTS} moving joints, and {MAX_JOINTS} of both; make the joints fixed that you do not need"
        )


def _group(link: UrdfLink, joint: UrdfJoint | None, parent: str = "", T_parent_group: Mat4 | None = None) -> RigidGroup:
    """Returns a group with a link as its first."""
    at = np.eye(4) if T_parent_group is None else T_parent_group
    group = RigidGroup(link.name, joint, parent, at)
    _set_contact(group, link)
    return group


def _set_contact(group: RigidGroup, link: UrdfLink) -> None:
    """Sets the contact properties of a group to those of a link."""
    group.friction = link.friction
    group.rolling_friction, group.spinning_friction = link.rolling_friction, link.spinning_friction
    group.stiffness, group.contact_damping = link.stiffness, link.contact_damping


def physics_urdf(model: UrdfModel, groups: tuple[RigidGroup, ...], *, concave: bool = False) -> str:
    """Returns a URDF with one link per group: masses, collision shapes with absolute paths, and joints, without visuals.

    Args:
        model: The links.
        groups: Their groups; their shapes are meshes, boxes, spheres, cylinders and capsules.
        concave: Whether meshes collide as triangle meshes, which is only for bodies that never move; else the engine uses convex hulls.
    """
    robot = ET.Element("robot", name=model.name)
    for group in groups:
        link = ET.SubElement(robot, "link", name=group.name)
        contact = ET.SubElement(link, "contact")
        ET.SubElement(contact, "lateral_friction", value=_text(DEFAULT_FRICTION if group.friction is None else group.friction))
        for key, value in (("rolling_friction", group.rolling_friction), ("spinning_friction", group.spinning_friction)):
            if value:
                ET.SubElement(contact, key, value=_text(value))
        if group.stiffness:  # the engine needs both or neither
            ET.SubElement(contact, "stiffness", value=_text(group.stiffness))
            ET.SubElement(contact, "damping", value=_text(group.contact_damping))
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "origin", xyz=_text(*group.center), rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=_text(group.mass))
        i = group.inertia
        parts = {"ixx": i[0, 0], "ixy": i[0, 1], "ixz": i[0, 2], "iyy": i[1, 1], "iyz": i[1, 2], "izz": i[2, 2]}
        ET.SubElement(inertial, "inertia", {key: _text(value) for key, value in parts.items()})
        for shape, T_group_shape in group.collisions:
            collision = ET.SubElement(link, "collision", {"concave": "yes"} if concave else {})
            _origin(collision, T_group_shape)
            _geometry(collision, shape)
        if group.joint is not None:
            _joint(robot, group, group.joint)
    ET.indent(robot)  # Bullet splits lines of more than 8 KB, even within a file name.
    return ET.tostring(robot, encoding="unicode")


def _same_contact(group: RigidGroup, link: UrdfLink) -> bool:
    """Returns whether a link can be merged into the group: the first collision shapes of a group determine its friction and stiffness."""
    if not link.collisions:
        return True
    if not group.collisions:
        _set_contact(group, link)
    rolling, compliance = (link.rolling_friction, link.spinning_friction), (link.stiffness, link.contact_damping)
    same_rolling = rolling in ((0.0, 0.0), (group.rolling_friction, group.spinning_friction))
    same_compliance = compliance[0] == 0.0 or compliance == (group.stiffness, group.contact_damping)
    return (link.friction is None or link.friction == group.friction) and same_rolling and same_compliance


def _add_link(group: RigidGroup, link: UrdfLink, T_group_link: Mat4) -> None:
    """Adds the collision shapes and the mass of a link (parallel axis theorem)."""
    for item in link.collisions:
        group.collisions.append((item.shape, T_group_link @ matrix_from_pose(item.pose)))
    if link.inertial is None or link.inertial.mass == 0:
        return
    T_group_inertial = T_group_link @ matrix_from_pose(link.inertial.pose)
    ixx, ixy, ixz, iyy, iyz, izz = link.inertial.inertia
    inertia = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    rotation = T_group_inertial[:3, :3]
    mass = group.mass + link.inertial.mass
    center = (group.mass * group.center + link.inertial.mass * T_group_inertial[:3, 3]) / mass
    group.inertia = (
        group.inertia
        + _point_inertia(group.mass, group.center - center)
        + rotation @ inertia @ rotation.T
        + _point_inertia(link.inertial.mass, T_group_inertial[:3, 3] - center)
    )
    group.mass, group.center = mass, center


def _point_inertia(mass: float, offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the inertia, (3, 3), kg m^2, of a point mass at ``offset``, (3,)."""
    return mass * (float(offset @ offset) * np.eye(3) - np.outer(offset, offset))


def _impossible_inertias(model: UrdfModel, names: Collection[str]) -> list[str]:
    """Returns one warning, or none, about links whose inertia no body has: it violates the triangle inequality of principal moments.

    Args:
        model: The links.
        names: Links to check.
    """
    links = [link for link in model.links if link.name in names and link.inertial is not None and link.inertial.mass > 0]
    if not links:
        return []
    rows = np.array([link.inertial.inertia for link in links if link.inertial is not None])
    moments = np.linalg.eigvalsh(rows[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3))
    # Inertias of 0 are missing ones, which ``_check_mass`` replaces if no other link of the group has one.
    violated = (moments[:, 2] > 0) & (moments[:, 2] * (1 - _INERTIA_ROUNDING) > moments[:, 0] + moments[:, 1])
    found = [f"{quoted(links[i].name)} ({', '.join(f'{m:.3g}' for m in moments[i])} kg m^2)" for i in np.flatnonzero(violated)]
    if not found:
        return []
    why = "links move with inertias that no body has, a principal moment is above the sum of the others; check their <inertia>"
    return [f"{model.path.name}: {why}: {listed(found)}"]


def _check_mass(model: UrdfModel, group: RigidGroup) -> list[str]:
    """Replaces a mass or an inertia that an engine cannot use; returns warnings about the changes."""
    warnings = []
    if group.mass <= 0:
        group.mass = _DEFAULT_ROOT_KG if group.joint is None else _DEFAULT_LINK_KG
        group.mass_is_assumed = True
        group.center, group.inertia = _assumed_inertia(model, group)
        warnings.append(f"{model.path.name}: link {quoted(group.name)} has no mass; {group.mass:g} kg is used")
    low, mid, high = np.linalg.eigvalsh(group.inertia)
    # Engines tolerate inertias that violate the triangle inequality slightly, as files often do.
    if low <= 0 or high > 1.5 * (low + mid):
        group.inertia = np.eye(3) * group.mass * _DEFAULT_GYRATION**2
        if not warnings:
            warnings.append(
                f"{model.path.name}: link {quoted(group.name)} has an invalid inertia (principal moments {low:.3g}, {mid:.3g}, {high:.3g} "
                "kg m^2: each must be above 0 and below the sum of the others); that of a small sphere is used"
            )
    return warnings


def _assumed_inertia(model: UrdfModel, group: RigidGroup) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns (centre of mass (3,), inertia (3, 3)) of a massless group: that of the bounding boxes of its collision shapes, else visuals.

    Ignores meshes, since it does not read files; without other shapes the result is that of a small sphere at the origin.
    """
    for kind in ("collisions", "visuals"):
        boxes = [
            (T_group_link @ matrix_from_pose(item.pose), np.maximum(np.ptp(points, axis=0), _LEAST_SIDE))
            for name, T_group_link in group.members.items()
            for item in getattr(model.link(name), kind)
            if (points := shape_points(item.shape)) is not None
        ]
        if not boxes:
            continue
        volumes = np.array([sides.prod() for _, sides in boxes])
        masses = group.mass * volumes / volumes.sum()
        center = masses @ np.array([T[:3, 3] for T, _ in boxes]) / group.mass
        inertia = np.zeros((3, 3))
        for mass, (T, sides) in zip(masses, boxes, strict=True):
            box_inertia = np.diag(mass / 12 * ((sides**2).sum() - sides**2))
            inertia += T[:3, :3] @ box_inertia @ T[:3, :3].T + _point_inertia(float(mass), T[:3, 3] - center)
        return center, inertia
    return np.zeros(3), np.eye(3) * group.mass * _DEFAULT_GYRATION**2


def _joint(robot: ET.Element, group: RigidGroup, joint: UrdfJoint) -> None:
    element = ET.SubElement(robot, "joint", name=joint.name, type=joint.kind)
    ET.SubElement(element, "parent", link=group.parent)
    ET.SubElement(element, "child", link=group.name)
    _origin(element, group.T_parent_group)
    ET.SubElement(element, "axis", xyz=_text(*joint.axis))
    if joint.kind in ("revolute", "prismatic"):
        limits = {"lower": joint.lower, "upper": joint.upper, "effort": joint.effort, "velocity": joint.velocity}
        ET.SubElement(element, "limit", {key: _text(value) for key, value in limits.items()})


def _geometry(collision: ET.Element, shape: Shape) -> None:
    geometry = ET.SubElement(collision, "geometry")
    if shape.kind == "mesh":
        ET.SubElement(geometry, "mesh", filename=shape.mesh, scale=_text(*shape.size))
    elif shape.kind == "box":
        ET.SubElement(geometry, "box", size=_text(*shape.size))
    elif shape.kind == "sphere":
        ET.SubElement(geometry, "sphere", radius=_text(shape.size[0]))
    else:  # a cylinder or a capsule; the caller has replaced shapes that URDF has not by meshes
        ET.SubElement(geometry, shape.kind, radius=_text(shape.size[0]), length=_text(shape.size[1]))


def _origin(element: ET.Element, transform: Mat4) -> None:
    ET.SubElement(element, "origin", xyz=_text(*transform[:3, 3]), rpy=_text(*rpy_from_matrix(transform[:3, :3])))


def rpy_from_matrix(rotation: NDArray[np.float64]) -> tuple[float, float, float]:
    """Returns roll, pitch, yaw (radians) such that ``rotation``, (3, 3), = Rz(yaw) Ry(pitch) Rx(roll)."""
    pitch = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    if math.hypot(rotation[0, 0], rotation[1, 0]) < 1e-9:  # gimbal lock: only roll -+ yaw is defined, so set yaw to 0
        return math.atan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0
    return math.atan2(rotation[2, 1], rotation[2, 2]), pitch, math.atan2(rotation[1, 0], rotation[0, 0])


def _text(*values: float) -> str:
    return " ".join(f"{float(value):.17g}" for value in values)
