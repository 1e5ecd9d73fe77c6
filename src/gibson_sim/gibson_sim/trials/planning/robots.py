"""Robots that differ from run to run: a ``robot.yaml`` and a URDF as text, with other slip, noise, latency, friction and payload.

Both are files of the run, so that it can be made on a machine that does not have the original. Only meshes that are in no installed package become
absolute paths of this machine.
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
from gibson_sim.formats.yaml_map import read_yaml_map
from gibson_sim.reading import parse_xml, read_file
from gibson_sim.robots.load import derive_file, find_robot_file, load_robot
from gibson_sim.robots.loading.derive import DESCRIPTION_SUFFIXES
from gibson_sim.scenes.robot_files import mesh_points
from gibson_sim.trials.scenario_spec import Randomisation, Range
from gibson_sim.writing import write_file

FOLDER = "robot"
"""Folder in that of a run."""
DRAWN = ("slip", "noise", "latency", "friction", "payload")
"""What is drawn for a robot."""
_RANGING = {"range_noise": np.inf, "range_noise_ratio": 0.2, "range_scale": 0.2, "dropout": 1.0}
_NOISES: Mapping[str, Mapping[str, float]] = {
    "lidar": _RANGING,
    "lidar_3d": _RANGING,
    "imu": dict.fromkeys(("gyro_noise", "accel_noise", "gyro_bias", "accel_bias", "gyro_bias_walk", "accel_bias_walk"), np.inf),
    "effects": {"shot_noise": 1.0, "read_noise": 1.0},
    "depth_noise": {"constant": np.inf, "linear": np.inf, "quadratic": np.inf, "hole_fraction": 1.0},
}
"""Section of a robot.yaml -> its keys that are proportional to the noise, and the largest value of each."""
_VARIANCES = ("alpha1", "alpha2", "alpha3", "alpha4")
_RATIOS = ("left_radius_factor", "right_radius_factor", "separation_factor")
"""Of wheel_odometry: ratios whose difference from 1 is the error."""
_RATIO_LIMITS = (0.5, 2.0)
_TRACTION = {"skid_steer": 0.8, "omni": 0.5}
"""Default of drive.traction."""
_LEAST_TRACTION = 1e-3
_LEAST_PAYLOAD = 1e-3
"""Mass below which there is no payload, kg."""
_ANYWHERE = Path("/robot.urdf")
"""A place with no packages beside it."""
_MOST_PARENTS = 6
"""Folders above a mesh that may be its package."""
_PAYLOAD_SIZE = 0.1
"""Edge of the cube that a payload is, metres."""


class VariedRobot:
    """A robot, of which variants are made."""

    def __init__(self, name: str) -> None:
        """Reads the robot.

        Args:
            name: as in the scenario.

        Raises:
            RobotError: it cannot be read.
        """
        path = find_robot_file(name)
        own = path.parent.name if path.stem == "robot" else path.name.split(".")[0]
        self.file = f"{FOLDER}/{re.sub(r'[^A-Za-z0-9_-]', '_', own) or 'robot'}.yaml"
        """The robot of a run, in its folder."""
        if path.suffix.lower() in DESCRIPTION_SUFFIXES:
            self._values: dict[str, Any] = derive_file(path, mesh_points()).values
            file, arguments = path, {}
        else:
            document = read_yaml_map(path, error=RobotError)
            self._values = dict(document.values)
            urdf = document.text("urdf")
            found = resolve_mesh(urdf, path) if urdf.startswith(PACKAGE_SCHEME) else path.parent / urdf
            file = path.parent / urdf if found is None else found
            arguments = {
                str(key): str(value).lower() if isinstance(value, bool) else str(value)
                for key, value in (self._values.pop("xacro_args", None) or {}).items()
            }
        self._source = plain_description(file, arguments)
        self._top = _with_lasting_meshes(parse_xml(read_file(self._source)), self._source)
        self._model = parse_urdf(ET.tostring(self._top), self._source)
        self._payload_at = _place_of_payload(self._model)

    @property
    def has_noise(self) -> bool:
        """Whether any of its sensors or its odometry has noise, which a factor can change."""
        return _scaled(self._values, 2.0) != self._values

    def files(self, drawn: Mapping[str, float]) -> dict[str, str]:
        """Returns a variant: the text of its files by their path in the folder of a run.

        Args:
            drawn: values by name, see ``DRAWN``; what is missing stays as it is.
        """
        values, top = copy.deepcopy(self._values), copy.deepcopy(self._top)
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
            self._set_friction(values, top, drawn["friction"])
        if drawn.get("payload", 0.0) >= _LEAST_PAYLOAD:
            _add_payload(top, self._model, drawn["payload"], *self._payload_at)
        ET.indent(top, " ")
        text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=200)
        return {self.file: text, str(Path(self.file).with_suffix(".urdf")): ET.tostring(top, encoding="unicode") + "\n"}

    def _set_friction(self, values: dict[str, Any], top: ET.Element, factor: float) -> None:
        """Multiplies the friction of all links that touch something, and that of wheels which slide by design."""
        given = values.get("friction") or {}
        elements = {element.get("name"): element for element in top.findall("link")}
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
            drive["traction"] = float(f"{max(traction * factor, _LEAST_TRACTION):.9g}")


def ranges_of(rules: Randomisation) -> dict[str, Range]:
    """Returns the ranges of what is drawn for a robot, by name; empty = it stays as it is."""
    return {name: limits for name in DRAWN if (limits := getattr(rules, name)) is not None}


def check_variants(robot: VariedRobot, ranges: Mapping[str, Range]) -> None:
    """Checks that a robot can be loaded with the smallest and with the largest of all values.

    Raises:
        ConfigError: it cannot, or has no noise to change; the message begins with the key.
    """
    if "noise" in ranges and not robot.has_noise:
        raise ConfigError(
            "randomise.noise is a factor, and the robot has no noise that it could change; take one as gibson_bot_real"
        )
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
            raise ConfigError(f"randomise makes an impossible robot with {values}: {error}") from error


def _scaled(values: dict[str, Any], factor: float) -> dict[str, Any]:
    """Returns the content of a robot.yaml with the noise of all sensors and of the odometry multiplied."""
    out = dict(values)
    for section in ("lidar", "lidar_3d", "imu"):
        content = out.get(section)
        if isinstance(content, list):
            out[section] = [_multiplied(item, section, factor) for item in content]
        elif content is not None:
            out[section] = _multiplied(content, section, factor)
    if out.get("cameras"):
        out["cameras"] = [
            {
                **camera,
                **{
                    key: _multiplied(camera[key], key, factor)
                    for key in ("effects", "depth_noise")
                    if camera.get(key) is not None
                },
            }
            for camera in out["cameras"]
        ]
    wheels = out.get("wheel_odometry")
    if wheels is not None:
        scaled = dict(wheels)
        scaled.update({key: _plain(wheels[key] * factor**2) for key in _VARIANCES if key in wheels})
        scaled.update(
            {key: _plain(float(np.clip(1.0 + (wheels[key] - 1.0) * factor, *_RATIO_LIMITS))) for key in _RATIOS if key in wheels}
        )
        out["wheel_odometry"] = scaled
    return out


def _multiplied(content: Mapping[str, Any], section: str, factor: float) -> dict[str, Any]:
    limits = _NOISES[section]
    return {**content, **{key: _plain(min(content[key] * factor, most)) for key, most in limits.items() if key in content}}


def _plain(value: float) -> float:
    """Returns a number with nine digits, which is the same on every machine."""
    return float(f"{value:.9g}")


def _with_lasting_meshes(top: ET.Element, source: Path) -> ET.Element:
    """Changes names of meshes and textures that are found only from the place of their file to ones that are found from any."""
    for element in (*top.iter("mesh"), *top.iter("texture")):
        name = element.get("filename", "")
        found = resolve_mesh(name, source.absolute()) if name else None
        if found is not None:
            element.set("filename", _lasting_name(name, found))
    return top


def _lasting_name(name: str, found: Path) -> str:
    """Returns a name of a file: in a package that is found from anywhere, which another machine may have elsewhere; else its path."""
    packages = (folder for folder in list(found.parents)[:_MOST_PARENTS] if folder.name.isidentifier())
    in_packages = (f"{PACKAGE_SCHEME}{folder.name}/{found.relative_to(folder).as_posix()}" for folder in packages)
    known = (name, *in_packages) if name.startswith(PACKAGE_SCHEME) else in_packages
    return next((text for text in known if resolve_mesh(text, _ANYWHERE) == found), found.as_uri())


def _place_of_payload(model: UrdfModel) -> tuple[str, tuple[float, float, float]]:
    """Returns the link that a payload lies on, and the place of its centre in the frame of that link, metres.

    It is the heaviest link that does not move against the root; the payload is above its centre of mass.
    """
    links = [model.link(name) for name in model.fixed_to_root()]
    base = max(links, key=lambda link: 0.0 if link.inertial is None else link.inertial.mass)
    x, y, z = (0.0, 0.0, 0.0) if base.inertial is None else base.inertial.pose.position
    points = link_points(base.collisions, np.eye(4), mesh_points())
    top = float(points[:, 2].max()) if len(points) else z
    return base.name, (x, y, top + _PAYLOAD_SIZE / 2)


def _add_payload(top: ET.Element, model: UrdfModel, mass: float, base: str, centre: tuple[float, float, float]) -> None:
    """Adds a cube with mass, and without a shape, to a link."""
    taken = {link.name for link in model.links}
    name = next(text for k in range(len(taken) + 1) if (text := f"payload_{k}" if k else "payload") not in taken)
    moment = mass * _PAYLOAD_SIZE**2 / 6.0
    inertial = ET.SubElement(ET.SubElement(top, "link", name=name), "inertial")
    ET.SubElement(inertial, "mass", value=f"{mass:.9g}")
    ET.SubElement(inertial, "inertia", ixx=f"{moment:.9g}", ixy="0", ixz="0", iyy=f"{moment:.9g}", iyz="0", izz=f"{moment:.9g}")
    joint = ET.SubElement(top, "joint", name=f"{name}_joint", type="fixed")
    ET.SubElement(joint, "parent", link=base)
    ET.SubElement(joint, "child", link=name)
    ET.SubElement(joint, "origin", xyz=" ".join(f"{c:.6g}" for c in centre))


def _child(element: ET.Element, tag: str) -> ET.Element:
    found = element.find(tag)
    return ET.SubElement(element, tag) if found is None else found
