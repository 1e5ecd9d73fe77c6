"""Robots that vary from run to run: a ``robot.yaml`` and a URDF as text, with varied slip, noise, latency, friction and payload.

Both are files of the run, so that it can be executed on a machine without the original. Only paths of meshes that are not in an installed package
become absolute paths of this machine.
"""

from __future__ import annotations

import copy
import re
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gibson_sim.description.extents import link_points
from gibson_sim.description.mesh_files import PACKAGE_SCHEME, resolve_mesh
from gibson_sim.description.rigid_groups import DEFAULT_FRICTION
from gibson_sim.description.urdf import UrdfModel, parse_urdf
from gibson_sim.description.xacro import plain_description
from gibson_sim.errors import ConfigError, GibsonSimError, RobotError
from gibson_sim.formats.load_mesh import mesh_points
from gibson_sim.formats.yaml_map import read_yaml_map
from gibson_sim.reading import parse_xml, read_file, without_default_namespace
from gibson_sim.robots.load import derive_file, find_robot_file, load_robot
from gibson_sim.robots.loading.derive import DESCRIPTION_SUFFIXES
from gibson_sim.trials.scenario.spec import Randomisation, Range
from gibson_sim.writing import write_file

FOLDER = "robot"
"""Subfolder of a run's folder."""
SAMPLED_VALUES = ("slip", "noise", "latency", "friction", "payload")
"""Names of the values sampled for a robot."""
_RANGE_NOISE = {"range_noise": np.inf, "range_noise_ratio": 0.2, "range_scale": 0.2, "dropout": 1.0}
_NOISE_KEYS: Mapping[str, Mapping[str, float]] = {
    "lidar": _RANGE_NOISE,
    "lidar_3d": _RANGE_NOISE,
    "imu": dict.fromkeys(("gyro_noise", "accel_noise", "gyro_bias", "accel_bias", "gyro_bias_walk", "accel_bias_walk"), np.inf),
    "effects": {"shot_noise": 1.0, "read_noise": 1.0},
    "depth_noise": {"constant": np.inf, "linear": np.inf, "quadratic": np.inf, "hole_fraction": 1.0},
}
"""Section of a robot.yaml -> keys that scale with the noise, and the largest value of each."""
_VARIANCE_KEYS = ("alpha1", "alpha2", "alpha3", "alpha4")
_RATIO_KEYS = ("left_radius_factor", "right_radius_factor", "separation_factor")
"""Keys of wheel_odometry whose difference from 1 is the error."""
_RATIO_LIMITS = (0.5, 2.0)
_TRACTION = {"skid_steer": 0.8, "omni": 0.5, "planar": 0.5}
"""Drive type -> default of drive.traction."""
_MIN_TRACTION = 1e-3
_MIN_PAYLOAD = 1e-3
"""Mass below which no payload is added, kg."""
_ANYWHERE = Path("/robot.urdf")
"""A path without packages beside it."""
_MAX_PARENTS = 6
"""Number of parent folders of a mesh that may be its package."""
_PAYLOAD_SIZE = 0.1
"""Edge length of the payload, a cube, metres."""


class VariedRobot:
    """A robot with variants."""

    def __init__(self, name: str) -> None:
        """Reads the robot.

        Args:
            name: name or file, as in the scenario.

        Raises:
            RobotError: the robot cannot be read.
        """
        path = find_robot_file(name)
        stem = path.parent.name if path.stem == "robot" else path.name.split(".")[0]
        self.file = f"{FOLDER}/{re.sub(r'[^A-Za-z0-9_-]', '_', stem) or 'robot'}.yaml"
        """Path of the robot's file in the folder of a run."""
        if path.suffix.lower() in DESCRIPTION_SUFFIXES:
            self._values: dict[str, Any] = derive_file(path).values
            file, arguments = path, {}
        else:
            document = read_yaml_map(path, error=RobotError)
            self._values = dict(document.values)
            urdf = document.text("urdf")
            resolved = resolve_mesh(urdf, path) if urdf.startswith(PACKAGE_SCHEME) else path.parent / urdf
            file = path.parent / urdf if resolved is None else resolved
            arguments = {
                str(key): str(value).lower() if isinstance(value, bool) else str(value)
                for key, value in (self._values.pop("xacro_args", None) or {}).items()
            }
        self._source = plain_description(file, arguments)
        self._urdf = _with_portable_meshes(without_default_namespace(parse_xml(read_file(self._source))), self._source)
        self._model = parse_urdf(ET.tostring(self._urdf), self._source)
        self._payload_link, self._payload_centre = _payload_position(self._model)

    @property
    def has_noise(self) -> bool:
        """Whether any sensor or the odometry has noise that a factor can scale."""
        return _scaled(self._values, 2.0) != self._values

    def files(self, drawn: Mapping[str, float]) -> dict[str, str]:
        """Returns a variant: the texts of its files by path in the folder of a run.

        Args:
            drawn: sampled values by name, see ``SAMPLED_VALUES``; missing values are left unchanged.
        """
        values, urdf = copy.deepcopy(self._values), copy.deepcopy(self._urdf)
        values["urdf"] = Path(self.file).with_suffix(".urdf").name
        if "noise" in drawn:
            values = _scaled(values, drawn["noise"])
        drive = values["drive"] = dict(values["drive"])
        if "slip" in drawn:
            drive["slip"] = drawn["slip"]
            if drive["type"] != "ackermann":
                drive["turn_slip"] = drawn["slip"]
        if "latency" in drawn:
            drive["command_delay"] = drawn["latency"]
        if "friction" in drawn:
            self._set_friction(values, urdf, drawn["friction"])
        if drawn.get("payload", 0.0) >= _MIN_PAYLOAD:
            _add_payload(urdf, self._model, drawn["payload"], self._payload_link, self._payload_centre)
        ET.indent(urdf, " ")
        text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=200)
        return {self.file: text, str(Path(self.file).with_suffix(".urdf")): ET.tostring(urdf, encoding="unicode") + "\n"}

    def _set_friction(self, values: dict[str, Any], urdf: ET.Element, factor: float) -> None:
        """Multiplies the friction of all links with collision shapes, and the traction of wheels that slide by design."""
        given = values.get("friction") or {}
        elements = {element.get("name"): element for element in urdf.findall("link")}
        for link in self._model.links:
            if link.collisions and link.name not in given:
                friction = DEFAULT_FRICTION if link.friction is None else link.friction
                contact = _child(elements[link.name], "contact")
                _child(contact, "lateral_friction").set("value", f"{friction * factor:.9g}")
        if given:
            values["friction"] = {name: float(f"{value * factor:.9g}") for name, value in given.items()}
        drive = values["drive"]
        if drive["type"] in _TRACTION:
            traction = drive.get("traction", _TRACTION[drive["type"]])
            drive["traction"] = float(f"{max(traction * factor, _MIN_TRACTION):.9g}")


def ranges_of(rules: Randomisation) -> dict[str, Range]:
    """Returns the ranges of the values sampled for a robot, by name; empty = the robot does not vary."""
    return {name: limits for name in SAMPLED_VALUES if (limits := getattr(rules, name)) is not None}


def check_variants(robot: VariedRobot, ranges: Mapping[str, Range]) -> None:
    """Checks that a robot can be loaded with the smallest and with the largest of all sampled values.

    Raises:
        ConfigError: it cannot be loaded, or has no noise to scale; the message begins with the key.
    """
    if "noise" in ranges and not robot.has_noise:
        raise ConfigError("randomise.noise is a factor, and the robot has no noise to scale; use one such as gibson_bot_real")
    for end in (0, 1):
        drawn = {name: limits[end] for name, limits in ranges.items()}
        try:
            with tempfile.TemporaryDirectory(prefix="gibson-sim-") as folder:
                for name, text in robot.files(drawn).items():
                    file = Path(folder, name)
                    file.parent.mkdir(exist_ok=True)
                    write_file(file, text, durable=False)
                load_robot(Path(folder, robot.file))
        except GibsonSimError as error:
            values = ", ".join(f"{name} {value:g}" for name, value in drawn.items())
            raise ConfigError(f"randomise yields an invalid robot with {values}: {error}") from error


def _scaled(values: dict[str, Any], factor: float) -> dict[str, Any]:
    """Returns the content of a robot.yaml with the noise of all sensors and of the odometry multiplied by a factor."""
    scaled = dict(values)
    for section in ("lidar", "lidar_3d", "imu"):
        content = scaled.get(section)
        if isinstance(content, list):
            scaled[section] = [_multiplied(item, section, factor) for item in content]
        elif content is not None:
            scaled[section] = _multiplied(content, section, factor)
    if scaled.get("cameras"):
        scaled["cameras"] = [
            {
                **camera,
                **{
                    key: _multiplied(camera[key], key, factor)
                    for key in ("effects", "depth_noise")
                    if camera.get(key) is not None
                },
            }
            for camera in scaled["cameras"]
        ]
    wheels = scaled.get("wheel_odometry")
    if wheels is not None:
        odometry = dict(wheels)
        odometry.update({key: _rounded(wheels[key] * factor**2) for key in _VARIANCE_KEYS if key in wheels})
        odometry.update(
            {
                key: _rounded(float(np.clip(1.0 + (wheels[key] - 1.0) * factor, *_RATIO_LIMITS)))
                for key in _RATIO_KEYS
                if key in wheels
            }
        )
        scaled["wheel_odometry"] = odometry
    return scaled


def _multiplied(content: Mapping[str, Any], section: str, factor: float) -> dict[str, Any]:
    limits = _NOISE_KEYS[section]
    return {**content, **{key: _rounded(min(content[key] * factor, most)) for key, most in limits.items() if key in content}}


def _rounded(value: float) -> float:
    """Returns a number rounded to nine significant digits, the same on every machine."""
    return float(f"{value:.9g}")


def _with_portable_meshes(urdf: ET.Element, source: Path) -> ET.Element:
    """Replaces mesh and texture file names that are relative to their file by names that can be resolved from any folder."""
    for element in (*urdf.iter("mesh"), *urdf.iter("texture")):
        name = element.get("filename", "")
        file = resolve_mesh(name, source.absolute()) if name else None
        if file is not None:
            element.set("filename", _portable_name(name, file))
    return urdf


def _portable_name(name: str, file: Path) -> str:
    """Returns a portable name of a file: its ``package://`` name if the package is installed, else its absolute path as a URI."""
    packages = (folder for folder in list(file.parents)[:_MAX_PARENTS] if folder.name.isidentifier())
    in_packages = (f"{PACKAGE_SCHEME}{folder.name}/{file.relative_to(folder).as_posix()}" for folder in packages)
    candidates = (name, *in_packages) if name.startswith(PACKAGE_SCHEME) else in_packages
    return next((text for text in candidates if resolve_mesh(text, _ANYWHERE) == file), file.as_uri())


def _payload_position(model: UrdfModel) -> tuple[str, tuple[float, float, float]]:
    """Returns the link that carries a payload, and the payload's centre in the frame of that link, metres.

    It is the heaviest link that is fixed to the root; the payload is above the link's centre of mass.
    """
    links = [model.link(name) for name in model.fixed_to_root()]
    base = max(links, key=lambda link: 0.0 if link.inertial is None else link.inertial.mass)
    x, y, z = (0.0, 0.0, 0.0) if base.inertial is None else base.inertial.pose.position
    points = link_points(base.collisions, np.eye(4), mesh_points())
    top = float(points[:, 2].max()) if len(points) else z
    return base.name, (x, y, top + _PAYLOAD_SIZE / 2)


def _add_payload(urdf: ET.Element, model: UrdfModel, mass: float, base: str, centre: tuple[float, float, float]) -> None:
    """Adds a cube with mass but without shapes to a link; ``centre`` in the frame of the link, metres."""
    names = {link.name for link in model.links}
    name = next(text for k in range(len(names) + 1) if (text := f"payload_{k}" if k else "payload") not in names)
    moment = mass * _PAYLOAD_SIZE**2 / 6.0
    inertial = ET.SubElement(ET.SubElement(urdf, "link", name=name), "inertial")
    ET.SubElement(inertial, "mass", value=f"{mass:.9g}")
    ET.SubElement(inertial, "inertia", ixx=f"{moment:.9g}", ixy="0", ixz="0", iyy=f"{moment:.9g}", iyz="0", izz=f"{moment:.9g}")
    joint = ET.SubElement(urdf, "joint", name=f"{name}_joint", type="fixed")
    ET.SubElement(joint, "parent", link=base)
    ET.SubElement(joint, "child", link=name)
    ET.SubElement(joint, "origin", xyz=" ".join(f"{c:.6g}" for c in centre))


def _child(element: ET.Element, tag: str) -> ET.Element:
    child = element.find(tag)
    return ET.SubElement(element, tag) if child is None else child
