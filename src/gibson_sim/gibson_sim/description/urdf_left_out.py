"""Names the elements of a URDF that have no effect here, in few lines: one must not have to read a file to know what is simulated. Pure."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping

from gibson_sim.description.unread import Grammar, Unread
from gibson_sim.quoting import clipped, enumerated, quoted

VERSIONS = ("1.0", "1.1", "1.2")
"""Versions of the format that are read: 1.1 adds ``quat_xyzw`` and capsules, 1.2 limits of acceleration, deceleration and jerk."""
_MOST_NAMED, _LONGEST_NAME = 8, 40
"""Maximum number of names in a line, and maximum length of each, characters."""
_CHILDREN: dict[str, frozenset[str]] = {
    "robot": frozenset({"link", "joint", "material", "gazebo"}),
    "link": frozenset({"inertial", "visual", "collision", "contact"}),
    "inertial": frozenset({"origin", "mass", "inertia"}),
    "visual": frozenset({"origin", "geometry", "material"}),
    "collision": frozenset({"origin", "geometry"}),
    "material": frozenset({"color", "texture"}),
    "joint": frozenset({"origin", "parent", "child", "axis", "limit", "dynamics", "mimic"}),
    "contact": frozenset({"lateral_friction", "rolling_friction", "spinning_friction", "stiffness", "damping"}),
}  # fmt: skip
"""Element -> its children that are read."""
_ATTRIBUTES: dict[str, tuple[str, ...]] = {
    "robot": ("name", "version"),
    "origin": ("xyz", "rpy", "quat_xyzw"),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "box": ("size",),
    "sphere": ("radius",),
    "mesh": ("filename", "scale"),
    "color": ("rgba",),
    "texture": ("filename",),
    "joint": ("name", "type"),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "effort", "velocity", "acceleration", "deceleration", "jerk"),
    "dynamics": ("damping", "friction"),
    "mimic": ("joint", "multiplier", "offset"),
    **dict.fromkeys(("link", "visual", "collision", "material"), ("name",)),
    **dict.fromkeys(("cylinder", "capsule"), ("radius", "length")),
    **dict.fromkeys(("parent", "child"), ("link",)),
    **dict.fromkeys(("inertial", "geometry", "contact"), ()),
    **dict.fromkeys(("mass", "lateral_friction", "rolling_friction", "spinning_friction", "stiffness", "damping"), ("value",)),
}
"""Element that is read -> its attributes."""
_SEVERAL = frozenset({"link", "joint", "material", "gazebo", "visual", "collision"})
"""Elements of which all count; of others, the first."""
_WHY = {
    "transmission": "motors turn the joints themselves, without gears",
    "ros2_control": "joints obey their own topics, without hardware interfaces",
    "safety_controller": "limits are those of <limit>",
    "calibration": "encoders know their zero",
    "sensor": "sensors are those of <gazebo> and of robot.yaml",
    "group": "it describes no motion",
    "verbose": "it is a comment",
}
"""Known element that is not read -> what holds instead."""
_LIMITS_NOT_READ = ("acceleration", "deceleration", "jerk")


def left_out(top: ET.Element, source: str) -> list[str]:
    """Returns one line for each kind of content of a ``<robot>`` that has no effect.

    Args:
        top: The ``<robot>``.
        source: Name of the file, for the lines.
    """
    found = Unread(_GRAMMAR)
    found.visit(top, "the robot")
    lines = []
    if found.omitted:
        parts = ", ".join(f"{one.tags.total()} <{', '.join(one.tags)}> ({why})" for why, one in found.omitted.items())
        lines.append(f"{source}: not simulated: {parts}")
    if found.unknown:
        unknown = {
            f"<{clipped(tag.rpartition('}')[2], _LONGEST_NAME)}> in <{parent}>": n for (parent, tag), n in found.unknown.items()
        }
        lines.append(f"{source}: elements that URDF does not have are left out: {_counted(unknown)}")
    if found.attributes:
        attributes = {f"{clipped(name, _LONGEST_NAME)} of <{tag}>": n for (name, tag), n in found.attributes.items()}
        lines.append(f"{source}: attributes that URDF does not have have no effect: {_counted(attributes)}")
    if found.repeated:
        lines.append(f"{source}: only the first of several counts: {listed(found.repeated)}")
    rates = [
        f"{key} of {quoted(joint.get('name', ''))}"
        for joint in top.findall("joint")
        if (limit := joint.find("limit")) is not None
        for key in _LIMITS_NOT_READ
        if key in limit.attrib
    ]
    if rates:
        lines.append(f"{source}: joints change their speed as fast as their effort allows; limits left out: {listed(rates)}")
    version = top.get("version")
    if version is not None and version not in VERSIONS:
        lines.append(
            f"{source}: version {quoted(version, _LONGEST_NAME)} is read as {VERSIONS[0]}; known: {', '.join(VERSIONS)} (ROS refuses others)"
        )
    return lines


def listed(names: Iterable[str]) -> str:
    """Returns names for a message: the first few, each of limited length, and how many more there are."""
    return enumerated([clipped(name, 2 * _LONGEST_NAME) for name in names], _MOST_NAMED)


def _owner(child: ET.Element, owner: str) -> str:
    """Returns the link, joint or material that a message names for what is in ``child``."""
    return f"{child.tag} {quoted(child.get('name', ''))}" if child.tag in ("link", "joint", "material") else owner


def _check_shapes(found: Unread, element: ET.Element, key: str, owner: str) -> None:
    geometry = element.find("geometry") if key in ("visual", "collision") else None
    if geometry is not None and len(geometry) > 1:
        found.repeated[f"{len(geometry)} shapes in a <geometry> of {owner}"] = None


def _counted(counts: Mapping[str, int]) -> str:
    return listed(f"{count} {what}" if count > 1 else what for what, count in counts.items())


_GRAMMAR = Grammar(
    {
        tag: {**{other: (why, ()) for other, why in _WHY.items()}, **dict.fromkeys(read, ("", ()))}
        for tag, read in _CHILDREN.items()
    },
    _ATTRIBUTES,
    _SEVERAL,
    foreign=True,
    place=_owner,
    check=_check_shapes,
)
