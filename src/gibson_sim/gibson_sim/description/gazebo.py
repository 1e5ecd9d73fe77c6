"""Reads what a URDF tells Gazebo in its ``<gazebo>`` elements: friction of links, sensors, the plugin that drives. Pure.

Nothing in these elements is required, and they are written for other programs: what is malformed is skipped.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from typing import Literal

from gibson_sim.types import Vec3

SensorKind = Literal["camera", "depth_camera", "lidar", "imu"]
DriveHint = Literal["differential", "omni"]

_SENSORS: dict[str, SensorKind] = {
    "camera": "camera", "wideanglecamera": "camera", "multicamera": "camera",
    "depth": "depth_camera", "depth_camera": "depth_camera", "rgbd": "depth_camera", "rgbd_camera": "depth_camera",
    "ray": "lidar", "gpu_ray": "lidar", "lidar": "lidar", "gpu_lidar": "lidar", "imu": "imu",
}  # fmt: skip
"""Values of ``<sensor type="...">`` of Gazebo Classic and of Gazebo, and what they are."""
_MOST_FRICTION = 1.5
"""Greatest friction that is read: wheels often have 100 or more."""
_DRIVE_PLUGINS: dict[str, DriveHint] = {"diff_drive": "differential", "skid_steer": "differential", "mecanum": "omni"}
"""Parts of the names of plugins that drive by wheels, without ``-`` and ``_``."""


@dataclass(frozen=True, slots=True)
class GazeboSensor:
    """A ``<sensor>`` on a link. Numbers that the file does not give are 0."""

    name: str
    link: str
    kind: SensorKind
    rate_hz: float = 0.0
    xyz: Vec3 = (0.0, 0.0, 0.0)
    """Position in the link, metres; the sensor looks along x, z is up."""
    rpy: Vec3 = (0.0, 0.0, 0.0)
    """Orientation in the link, radians."""
    width: int = 0
    """Pixels."""
    height: int = 0
    fov_x: float = 0.0
    """Horizontal field of view of a camera, radians."""
    samples: int = 0
    """Rays of a ring."""
    channels: int = 0
    """Rings."""
    angles: tuple[float, float] = (0.0, 0.0)
    """First and last direction of a ring, radians."""
    elevations: tuple[float, float] = (0.0, 0.0)
    """Lowest and highest ring, radians."""
    range_min: float = 0.0
    """Metres."""
    range_max: float = 0.0


@dataclass(frozen=True, slots=True)
class GazeboDrive:
    """A plugin that drives the robot by its wheels."""

    kind: DriveHint
    plugin: str
    """File of the plugin."""
    joints: tuple[str, ...]
    """Joints of the wheels."""
    wheel_radius: float = 0.0
    """Metres; 0 = not given."""


@dataclass(frozen=True, slots=True)
class GazeboTags:
    """What a description tells Gazebo."""

    frictions: dict[str, float] = field(default_factory=dict, hash=False)
    """Link -> Coulomb friction: the smaller one of both directions, at most 1.5."""
    sensors: tuple[GazeboSensor, ...] = ()
    """In the order of the file, without kinds that are not simulated."""
    drive: GazeboDrive | None = None


def read_gazebo(top: ET.Element) -> GazeboTags:
    """Returns what the ``<gazebo>`` elements of a ``<robot>`` say."""
    links = [element.get("name", "") for element in top.findall("link")]
    joints = {element.get("name", "") for element in top.findall("joint")}
    frictions: dict[str, float] = {}
    sensors: list[GazeboSensor] = []
    drive: GazeboDrive | None = None
    for element in top.findall("gazebo"):
        link = _meant(element.get("reference", ""), links)
        friction = _friction(element)
        if link and friction is not None:
            frictions[link] = friction
        if link:
            sensors += [found for item in element.iter("sensor") if (found := _sensor(item, link)) is not None]
        for plugin in element.iter("plugin"):
            drive = drive or _drive(plugin, joints)
    return GazeboTags(frictions, tuple(sensors), drive)


def _meant(reference: str, links: list[str]) -> str:
    """Returns the link that a reference names: descriptions with a prefix often omit it here. Empty = none, or several."""
    found = [name for name in links if name == reference] or [name for name in links if name.endswith(f"/{reference}")]
    return found[0] if reference and len(found) == 1 else ""


def _friction(element: ET.Element) -> float | None:
    values = [_value(item.text) for key in ("mu1", "mu2") for item in element.iter(key)]
    if not values or any(value is None or value < 0.0 for value in values):
        return None
    return min(*(value for value in values if value is not None), _MOST_FRICTION)


def _sensor(element: ET.Element, link: str) -> GazeboSensor | None:
    kind = _SENSORS.get(element.get("type", ""))
    if kind is None:
        return None
    pose = [value or 0.0 for value in map(_value, (element.findtext("pose") or "").split())]
    x, y, z, roll, pitch, yaw = pose if len(pose) == 6 else (0.0,) * 6
    # Classic calls the rays <ray>, Gazebo <lidar>; the first <horizontal> and <vertical> are theirs.
    horizontal, vertical = element.find(".//scan/horizontal"), element.find(".//scan/vertical")
    reach, image = element.find(".//range"), element.find(".//image")
    return GazeboSensor(
        element.get("name", "") or link, link, kind, _number(element, "update_rate"), (x, y, z), (roll, pitch, yaw),
        width=round(_number(image, "width")), height=round(_number(image, "height")),
        fov_x=_number(element.find(".//camera"), "horizontal_fov"),
        samples=round(_number(horizontal, "samples")), channels=round(_number(vertical, "samples")),
        angles=(_number(horizontal, "min_angle"), _number(horizontal, "max_angle")),
        elevations=(_number(vertical, "min_angle"), _number(vertical, "max_angle")),
        range_min=_number(reach, "min"), range_max=_number(reach, "max"),
    )  # fmt: skip


def _drive(plugin: ET.Element, joints: set[str]) -> GazeboDrive | None:
    name = plugin.get("filename", "") or plugin.get("name", "")
    plain = name.lower().replace("-", "_")
    kind = next((kind for part, kind in _DRIVE_PLUGINS.items() if part in plain), None)
    if kind is None:
        return None
    values = {item.tag.lower().replace("_", ""): (item.text or "").strip() for item in plugin}
    named = [(item.text or "").strip() for item in plugin if item.tag.lower().replace("_", "").endswith("joint")]
    wheels = tuple(dict.fromkeys(joint for joint in named if joint in joints))
    if len(wheels) < 2:
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
