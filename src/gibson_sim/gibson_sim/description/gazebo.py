"""Reads the ``<gazebo>`` elements of a URDF: friction of links, sensors, drive plugin. Pure.

These elements are optional, and written for other programs: malformed ones are skipped.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from typing import Literal

from gibson_sim.description.urdf_left_out import listed
from gibson_sim.quoting import clipped, quoted
from gibson_sim.types import Vec3

SensorKind = Literal["camera", "depth_camera", "lidar", "imu"]
DriveHint = Literal["differential", "omni", "planar"]

_SENSORS: dict[str, SensorKind] = {
    "camera": "camera", "wideanglecamera": "camera", "multicamera": "camera",
    "depth": "depth_camera", "depth_camera": "depth_camera", "rgbd": "depth_camera", "rgbd_camera": "depth_camera",
    "ray": "lidar", "gpu_ray": "lidar", "lidar": "lidar", "gpu_lidar": "lidar", "imu": "imu",
}  # fmt: skip
"""Value of ``<sensor type="...">`` of Gazebo Classic or Gazebo -> kind."""
MECANUM = re.compile(r"mecanum|mechanum", re.IGNORECASE)
"""Pattern of names of parts of robots with mecanum wheels."""
_OBLIQUE = 0.5
"""Minimum ratio of the components x and y of a diagonal."""
_MOST_FRICTION = 1.5
"""Maximum friction; larger values are clamped: wheels often have 100 or more."""
_FRICTIONS = ("mu1", "mu2")
_DRIVE_PLUGINS: dict[str, DriveHint] = {
    "diff_drive": "differential", "skid_steer": "differential", "mecanum": "omni",
    "planar_move": "planar", "sim_velocity_control": "planar", "gazebo_velocity_control": "planar", "::velocitycontrol": "planar",
}  # fmt: skip
"""Part of the file name or name of a drive plugin, with ``_`` for ``-`` -> drive."""


@dataclass(frozen=True, slots=True)
class GazeboSensor:
    """A ``<sensor>`` on a link. Numbers that are missing in the file are 0."""

    name: str
    link: str
    kind: SensorKind
    rate_hz: float = 0.0
    xyz: Vec3 = (0.0, 0.0, 0.0)
    """Position in the link frame, metres; the sensor looks along x, z is up."""
    rpy: Vec3 = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw in the link frame, radians."""
    width: int = 0
    """Image width, pixels."""
    height: int = 0
    fov_x: float = 0.0
    """Horizontal field of view of a camera, radians."""
    samples: int = 0
    """Number of rays per channel."""
    channels: int = 0
    """Number of channels (rings) of a lidar."""
    angles: tuple[float, float] = (0.0, 0.0)
    """First and last azimuth of a channel, radians."""
    elevations: tuple[float, float] = (0.0, 0.0)
    """Elevation of the lowest and the highest channel, radians."""
    range_min: float = 0.0
    """Minimum range, metres."""
    range_max: float = 0.0


@dataclass(frozen=True, slots=True)
class GazeboDrive:
    """A drive plugin, which turns wheels, or (planar) moves the base itself."""

    kind: DriveHint
    plugin: str
    """File name of the plugin."""
    joints: tuple[str, ...]
    """Names of the wheel joints; planar: may be none."""
    wheel_radius: float = 0.0
    """Wheel radius, metres; 0 = not given."""


@dataclass(frozen=True, slots=True)
class GazeboTags:
    """Content of the ``<gazebo>`` elements of a description."""

    frictions: dict[str, float] = field(default_factory=dict, hash=False)
    """Link -> Coulomb friction: the minimum of both directions, at most 1.5."""
    sensors: tuple[GazeboSensor, ...] = ()
    """Sensors in the order of the file, without kinds that are not simulated."""
    drive: GazeboDrive | None = None
    mecanum: str = ""
    """What says that the robot has mecanum wheels: a word in a plugin or controller; empty = nothing."""
    oblique: bool = False
    """Whether any friction is along a diagonal (``<fdir1>``), as of mecanum wheels and of some that are none."""


def read_gazebo(top: ET.Element) -> GazeboTags:
    """Returns the content of the ``<gazebo>`` elements of a ``<robot>``."""
    links = [element.get("name", "") for element in top.findall("link")]
    joints = {element.get("name", "") for element in top.findall("joint")}
    frictions: dict[str, float] = {}
    sensors: list[GazeboSensor] = []
    drive: GazeboDrive | None = None
    for element in top.findall("gazebo"):
        link = _resolve_link(element.get("reference", ""), links)
        friction = _friction(element)
        if link and friction is not None:
            frictions[link] = friction
        if link:
            sensors += [sensor for item in element.iter("sensor") if (sensor := _sensor(item, link)) is not None]
        for plugin in element.iter("plugin"):
            drive = drive or _drive(plugin, joints)
    return GazeboTags(frictions, tuple(sensors), drive, _mecanum(top), _is_oblique(top))


def _is_oblique(top: ET.Element) -> bool:
    """Returns whether the first direction of friction is a diagonal, in any link."""
    for element in (item for parent in top.iter("gazebo") for item in parent.iter("fdir1")):
        direction = [abs(_value(part) or 0.0) for part in (element.text or "").split()]
        if len(direction) == 3 and min(direction[:2]) > _OBLIQUE * max(direction):
            return True
    return False


def _mecanum(top: ET.Element) -> str:
    """Returns what says that wheels are mecanum wheels; empty = nothing."""
    for element in (
        item for tag in ("gazebo", "ros2_control", "transmission") for parent in top.iter(tag) for item in parent.iter()
    ):
        tag = element.tag.rpartition("}")[2]
        for text in (element.text or "", *element.attrib.values()):
            if MECANUM.search(text):
                return f"{clipped(text.strip(), 60)} in <{clipped(tag, 40)}>"
    return ""


def gazebo_left_out(top: ET.Element, source: str) -> list[str]:
    """Returns one line, or none, about the content of ``<gazebo>`` elements that has no effect here.

    Args:
        top: The ``<robot>``.
        source: Name of the file, for the line.
    """
    joints = {element.get("name", "") for element in top.findall("joint")}
    found: dict[str, None] = {}
    for element in top.findall("gazebo"):
        for item in element:
            if item.tag == "sensor":
                if (kind := item.get("type", "")) not in _SENSORS:
                    found[f"sensor {quoted(item.get('name', ''), 40)} of type {quoted(kind, 40)}"] = None
                elif item.find(".//noise") is not None:
                    found["noise of sensors"] = None
            elif item.tag == "plugin":
                if _drive(item, joints) is None:
                    found[f"plugin {clipped(item.get('filename', '') or item.get('name', ''), 60)}"] = None
            elif item.tag not in _FRICTIONS and all(item.find(f".//{key}") is None for key in _FRICTIONS):
                found[f"<{clipped(item.tag.rpartition('}')[2], 40)}>"] = None
    return [f"{source}: left out of <gazebo>, for Gazebo alone: {listed(found)}"] if found else []


def _resolve_link(reference: str, links: list[str]) -> str:
    """Returns the link that a reference names, whose prefix may be omitted; empty = no link, or several."""
    matches = [name for name in links if name == reference] or [name for name in links if name.endswith(f"/{reference}")]
    return matches[0] if reference and len(matches) == 1 else ""


def _friction(element: ET.Element) -> float | None:
    values = [_value(item.text) for key in _FRICTIONS for item in element.iter(key)]
    if not values or any(value is None or value < 0.0 for value in values):
        return None
    return min(*(value for value in values if value is not None), _MOST_FRICTION)


def _sensor(element: ET.Element, link: str) -> GazeboSensor | None:
    kind = _SENSORS.get(element.get("type", ""))
    if kind is None:
        return None
    pose = [value or 0.0 for value in map(_value, (element.findtext("pose") or "").split())]
    x, y, z, roll, pitch, yaw = pose if len(pose) == 6 else (0.0,) * 6
    # The rays are in <ray> in Gazebo Classic, in <lidar> in Gazebo; they have the first <horizontal> and <vertical>.
    horizontal, vertical = element.find(".//scan/horizontal"), element.find(".//scan/vertical")
    range_element, image = element.find(".//range"), element.find(".//image")
    return GazeboSensor(
        element.get("name", "") or link, link, kind, _number(element, "update_rate"), (x, y, z), (roll, pitch, yaw),
        width=round(_number(image, "width")), height=round(_number(image, "height")),
        fov_x=_number(element.find(".//camera"), "horizontal_fov"),
        samples=round(_number(horizontal, "samples")), channels=round(_number(vertical, "samples")),
        angles=(_number(horizontal, "min_angle"), _number(horizontal, "max_angle")),
        elevations=(_number(vertical, "min_angle"), _number(vertical, "max_angle")),
        range_min=_number(range_element, "min"), range_max=_number(range_element, "max"),
    )  # fmt: skip


def _drive(plugin: ET.Element, joints: set[str]) -> GazeboDrive | None:
    names = [plugin.get(key, "") for key in ("filename", "name")]
    found = ((kind, name) for name in names for part, kind in _DRIVE_PLUGINS.items() if part in name.lower().replace("-", "_"))
    kind, name = next(found, (None, ""))
    if kind is None:
        return None
    values = {item.tag.lower().replace("_", ""): (item.text or "").strip() for item in plugin}
    joint_names = [(item.text or "").strip() for item in plugin if item.tag.lower().replace("_", "").endswith("joint")]
    wheels = tuple(dict.fromkeys(joint for joint in joint_names if joint in joints))
    if len(wheels) < 2 and kind != "planar":
        return None
    diameter, radius = _value(values.get("wheeldiameter")), _value(values.get("wheelradius"))
    return GazeboDrive(kind, name, wheels, max(radius or (diameter or 0.0) / 2, 0.0))


def _number(element: ET.Element | None, key: str) -> float:
    """Returns a number inside an element; 0 = it is missing or malformed."""
    return 0.0 if element is None else _value(element.findtext(key)) or 0.0


def _value(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None
