"""Guesses lidars, cameras and an IMU of a robot from the Gazebo sensors of its description, else from the names of its links. Pure."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from gibson_sim.description.gazebo import GazeboSensor
from gibson_sim.description.urdf import UrdfModel
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.quoting import quoted
from gibson_sim.robots.loading.guess import Guess

_LIDAR = re.compile(r"scan|laser|lidar|hokuyo|velodyne|ouster", re.IGNORECASE)
_LIDAR_3D = re.compile(r"velodyne|ouster|vlp|hdl|livox|3d", re.IGNORECASE)
_CAMERA = re.compile(r"camera\d*(_(rgb|color|front|link|frame))*$", re.IGNORECASE)
_IMU = re.compile(r"(^|[_/])imu\d*($|_)", re.IGNORECASE)
_MOUNT = re.compile(r"mount|bracket|tower|plate|support|screw|holder", re.IGNORECASE)
_NO_COLOR = re.compile(r"depth|infra|ir_|_ir\b|right|fisheye|gyro|accel|imu|pose", re.IGNORECASE)
_CAMERA_PARTS = re.compile(r"(_(optical|rgb|color|colour|front|link|frame|sensor))+$", re.IGNORECASE)
"""Pattern of the end of a link name that is not part of the name of its camera."""
_SENSOR_PARTS = re.compile(r"(_(link|frame|sensor|laser|scan))+$", re.IGNORECASE)
"""Pattern of the end of a link name that is not part of the name of its lidar."""
_NOT_ROS = re.compile(r"[^A-Za-z0-9_]+")
_MAX_GUESSED = 4
"""Maximum number of guessed cameras, and of guessed lidars."""
_MIN_BEAMS, _MIN_FOV, _MIN_RANGE = 32, math.radians(45.0), 1.5
"""Minimum number of rays, field of view (radians) and range (metres) of a Gazebo ray sensor that is a lidar, not an infrared or cliff sensor."""
_TURN = 2.0 * math.pi


def guess_sensors(model: UrdfModel, values: dict[str, Any], guesses: list[Guess]) -> None:
    """Adds the sections ``lidar``, ``lidar_3d``, ``cameras`` and ``imu`` to ``values``, and a line for each sensor to ``guesses``."""
    _guess_lidars(model, values, guesses)
    _guess_cameras(model, values, guesses)
    _guess_imu(model, values, guesses)


def _guess_lidars(model: UrdfModel, values: dict[str, Any], guesses: list[Guess]) -> None:
    tagged = [sensor for sensor in model.gazebo.sensors if sensor.kind == "lidar" and _is_lidar(sensor)][:_MAX_GUESSED]
    transforms = model.transforms()
    sections: dict[str, list[dict[str, Any]]] = {"lidar": [], "lidar_3d": []}
    if tagged:
        for sensor in tagged:
            key = "lidar_3d" if sensor.channels > 1 else "lidar"
            entry = _tagged_lidar_3d(sensor) if sensor.channels > 1 else _tagged_lidar(sensor)
            sections[key].append({"link": sensor.link, **entry})
            text = ", ".join(f"{name} {value:g}" for name, value in entry.items())
            guesses.append(Guess(key, f"at {sensor.link}, {text} (from the Gazebo sensor {quoted(sensor.name)})"))
    else:
        names = _links_named(model, _LIDAR, lambda name: abs(float(transforms[name][2, 2])) > 0.99)[:_MAX_GUESSED]
        for name in names:
            spinning = _LIDAR_3D.search(name) is not None
            sections["lidar_3d" if spinning else "lidar"].append({"link": name})
            what = "16 rings from -15 to 15 degrees, 0.3 to 100 m" if spinning else "360 degrees, 0.12 to 12 m"
            key = "lidar_3d" if spinning else "lidar"
            keys = "channels, samples, elevations" if spinning else "beams, fov_deg, angle_min_deg"
            hand = f"{key} at {name}: {keys}, range_min, range_max, rate_hz, from its data sheet"
            guesses.append(Guess(key, f"at {name}, {what} (there is a link of that name)", by_hand=hand))
    for key, topic in (("lidar", "scan"), ("lidar_3d", "points")):
        if len(sections[key]) == 1:
            values[key] = sections[key][0]
        elif sections[key]:
            taken: set[str] = set()
            values[key] = [{"name": f"{_name(e['link'], _SENSOR_PARTS, 'lidar', taken)}/{topic}", **e} for e in sections[key]]


def _is_lidar(sensor: GazeboSensor) -> bool:
    wide = sensor.angles[1] - sensor.angles[0] >= _MIN_FOV
    return sensor.samples >= _MIN_BEAMS and wide and (sensor.range_max >= _MIN_RANGE or sensor.range_max == 0.0)


def _tagged_lidar(sensor: GazeboSensor) -> dict[str, Any]:
    first, last = sensor.angles
    fov = min(last - first, _TURN)
    if fov >= _TURN - math.radians(1.0):
        angles = {"fov_deg": 360.0, "angle_min_deg": _degrees(max(first, -_TURN))}
    elif abs(first + last) < 1e-4:  # symmetric about the x axis, as without angle_min_deg
        angles = {"fov_deg": _degrees(fov)}
    else:
        angles = {"fov_deg": _degrees(fov), "angle_min_deg": _degrees(max(first, -_TURN))}
    return {"beams": sensor.samples, **angles, **_ranging(sensor)}


def _tagged_lidar_3d(sensor: GazeboSensor) -> dict[str, Any]:
    low, high = sorted(sensor.elevations)
    angles = {"elevation_min_deg": _degrees(low), "elevation_max_deg": _degrees(high)}
    return {"channels": sensor.channels, "samples": sensor.samples, **angles, **_ranging(sensor)}


def _ranging(sensor: GazeboSensor) -> dict[str, Any]:
    given = {"range_min": sensor.range_min, "range_max": sensor.range_max, "rate_hz": sensor.rate_hz}
    return {key: round(value, 4) for key, value in given.items() if value > 0.0 and value < 1e6}


def _guess_cameras(model: UrdfModel, values: dict[str, Any], guesses: list[Guess]) -> None:
    tagged = [sensor for sensor in model.gazebo.sensors if sensor.kind in ("camera", "depth_camera")]
    # A colour and a depth sensor at the same pose are merged to one camera, which renders both.
    at_places = list({(sensor.link, sensor.xyz): sensor for sensor in reversed(tagged)}.values())[::-1][:_MAX_GUESSED]
    entries: list[dict[str, Any]] = []
    taken: set[str] = set()
    for sensor in at_places:
        link = _optical_link(model, sensor) or sensor.link
        name = "camera" if len(at_places) == 1 else _name(link, _CAMERA_PARTS, "camera", taken)
        entry = {"name": name, "link": link, **_tagged_camera(sensor, optical="_optical" in link)}
        entries.append(entry)
        optics = f"{entry.get('width', 640)} x {entry.get('height', 480)}, {entry.get('fov_y_deg', 60):g} degrees high"
        how = f"(from the Gazebo sensor {quoted(sensor.name)})"
        guesses.append(Guess("cameras", f"at {link}, {optics} {how}", _camera_part(name)))
    links = [] if entries else _camera_links(model)
    for link in links:
        name = "camera" if len(links) == 1 else _name(link, _CAMERA_PARTS, "camera", taken)
        entries.append({"name": name, "link": link})
        text = f"at {link}, 640 x 480, 60 degrees high (there is a link of that name)"
        hand = f"cameras: width, height, fov_y_deg (or k, d) and rate_hz of {name}, from its data sheet"
        guesses.append(Guess("cameras", text, _camera_part(name), hand))
    if entries:
        values["cameras"] = entries


def _camera_part(name: str) -> str:
    """Returns the prefix of a line about a camera."""
    return "camera" if name == "camera" else f"camera {name}"


def _camera_links(model: UrdfModel) -> list[str]:
    """Returns links that are named optical frames of colour cameras; else the first link that is named a camera and faces forward."""
    optical = [
        link.name
        for link in model.links
        if "optical" in link.name and not _LIDAR.search(link.name) and not _NO_COLOR.search(link.name)
    ]
    transforms = model.transforms()
    return optical[:_MAX_GUESSED] or _links_named(model, _CAMERA, lambda name: float(transforms[name][0, 0]) > 0.5)[:1]


def _optical_link(model: UrdfModel, sensor: GazeboSensor) -> str:
    """Returns the optical frame of a camera: a descendant of the link with the sensor, at its position, with z along its x axis; empty = none."""
    below = [sensor.link]
    for name in below:
        below += [joint.child for joint in model.joints if joint.kind == "fixed" and joint.parent == name]
    transforms = model.transforms()
    place: Mat4 = transforms[sensor.link]
    for name in below:
        frame = transforms[name]
        alignment = float(frame[:3, 2] @ place[:3, 0])
        if "_optical" in name and alignment > 0.99 and np.linalg.norm(frame[:3, 3] - place[:3, 3]) < 0.1 and not any(sensor.rpy):
            return name
    return ""


def _tagged_camera(sensor: GazeboSensor, *, optical: bool) -> dict[str, Any]:
    entry: dict[str, Any] = {}
    if sensor.width > 0 and sensor.height > 0:
        entry |= {"width": sensor.width, "height": sensor.height}
        if 0.0 < sensor.fov_x < math.radians(170.0):
            entry["fov_y_deg"] = _degrees(2 * math.atan(math.tan(sensor.fov_x / 2) * sensor.height / sensor.width))
    if 0.0 < sensor.rate_hz <= 1000.0:
        entry["rate_hz"] = sensor.rate_hz
    if not optical and any((*sensor.xyz, *sensor.rpy)):
        entry["pose"] = {"xyz": list(sensor.xyz), "rpy_deg": [_degrees(angle) for angle in sensor.rpy]}
    return entry


def _guess_imu(model: UrdfModel, values: dict[str, Any], guesses: list[Guess]) -> None:
    tagged = [sensor for sensor in model.gazebo.sensors if sensor.kind == "imu"]
    if tagged:
        sensor = tagged[0]
        rate = {"rate_hz": sensor.rate_hz} if 0.0 < sensor.rate_hz <= 1000.0 else {}
        values["imu"] = {"link": sensor.link, **rate}
        how = f"(from the Gazebo sensor {quoted(sensor.name)})"
        guesses.append(Guess("imu", f"at {sensor.link}, {rate.get('rate_hz', 100):g} Hz {how}"))
        return
    imu_links = [link.name for link in model.links if _IMU.search(link.name) and not _MOUNT.search(link.name)]
    # Prefer the IMU of the robot to that of a camera.
    imu_links.sort(key=lambda name: bool(re.search(r"camera|realsense|oak|zed", name, re.IGNORECASE)))
    if imu_links:
        values["imu"] = {"link": imu_links[0]}
        guesses.append(Guess("imu", f"at {imu_links[0]}, 100 Hz (there is a link of that name)"))


def _links_named(model: UrdfModel, pattern: re.Pattern[str], fits: Callable[[str], bool]) -> list[str]:
    """Returns links with a matching name; for a chain of fixed joints, only the last one."""
    parents: Mapping[str, str] = {joint.child: joint.parent for joint in model.joints if joint.kind == "fixed"}
    names = [link.name for link in model.links if pattern.search(link.name) and not _MOUNT.search(link.name) and fits(link.name)]
    links: list[str] = []
    for name in names:
        if links and parents.get(name) in links:
            links[links.index(parents[name])] = name
        else:
            links.append(name)
    return links


def _name(link: str, parts: re.Pattern[str], fallback: str, taken: set[str]) -> str:
    """Returns the name of a sensor, derived from that of its link: valid in ROS and unique."""
    plain = _NOT_ROS.sub("_", parts.sub("", link)).strip("_")
    base = plain if plain and plain[0].isalpha() else fallback
    name = next(text for text in _numbered(base) if text not in taken)
    taken.add(name)
    return name


def _numbered(base: str) -> Iterable[str]:
    yield base
    number = 2
    while True:
        yield f"{base}_{number}"
        number += 1


def _degrees(angle: float) -> float:
    return round(math.degrees(angle), 3)
