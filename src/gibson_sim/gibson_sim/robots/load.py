"""Reads ``robot.yaml`` and its URDF into a ``RobotSpec``; ``docs/robots.md`` explains the keys. Pure: no physics, no ROS."""

from __future__ import annotations

import difflib
import logging
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import numpy as np
import yaml
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError, RobotError
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, Mat4, matrix_from_pose, pose_from_matrix, pose_from_xyz_rpy
from gibson_sim.resources import find_robot
from gibson_sim.robots.rigid import MOVING_TYPES
from gibson_sim.robots.spec import DriveSpec, LidarSpec, RobotSpec, Shape, VisualSpec
from gibson_sim.robots.urdf import UrdfModel, read_urdf
from gibson_sim.types import (
    DEFAULT_OUTPUTS,
    DISTORTIONS,
    OUTPUTS,
    CameraSpec,
    DepthNoise,
    ImageEffects,
    Pose,
    Projection,
    Vec3,
)

logger = logging.getLogger(__name__)

ROBOT_FILE = "robot.yaml"
_ROBOT_KEYS = ("urdf", "base_link", "radius", "height", "drive", "cameras", "lidar")
_LIMIT_KEYS = ("max_linear", "max_angular", "max_linear_acceleration", "max_angular_acceleration", "max_wheel_torque")
_DRIVE_KEYS = ("type", "left_joint", "right_joint", "wheel_radius", "wheel_separation", *_LIMIT_KEYS)
_OPTICS_KEYS = ("projection", "k", "fov_y_deg", "fov_deg", "distortion_model", "d")
_CAMERA_KEYS = (
    "name", "link", "pose", "width", "height", *_OPTICS_KEYS, "rate_hz", "near", "far", "outputs", "samples", "stereo_baseline",
    "effects", "depth_noise",
)  # fmt: skip
_MATRIX_KEYS = ("fx", "fy", "cx", "cy", "skew")
_POSE_KEYS = ("xyz", "rpy_deg")
_LIDAR_KEYS = ("link", "beams", "range_min", "range_max", "rate_hz")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def load_robot(
    path_or_name: Path | str, *, name: str = "robot", start: Pose | None = None, find: Callable[[str], Path] | None = None
) -> RobotSpec:
    """Returns the robot that a ``robot.yaml`` describes.

    Args:
        path_or_name: A ``robot.yaml``, a folder that holds one, or the name of a robot that ``find`` knows.
        name: Body name; its links become ``<name>/<link>``.
        start: T_world_base at load; None = the origin.
        find: Takes a name to the robot's folder or file; None = ``config/robots/<name>`` of a share folder (see ``resources``).

    Raises:
        RobotError: a file is missing or broken; one line.
    """
    if not _NAME.fullmatch(name):
        raise RobotError(f"robot name {name!r} is not usable in ROS; use letters, digits and _, a letter first")
    path = _robot_file(path_or_name, find)
    robot = _Settings(_read_yaml(path), str(path))
    robot.check_keys(_ROBOT_KEYS)
    model = read_urdf(path.parent / robot.text("urdf"))
    for warning in model.warnings:
        logger.warning("%s", warning)
    for joint in model.joints:
        if joint.kind not in (*MOVING_TYPES, "fixed"):
            raise RobotError(f"{model.path}: joint {joint.name!r} is {joint.kind}, which is not simulated")
    base = robot.text("base_link", model.root)
    if base != model.root:
        raise RobotError(f"{path}: base_link is {base!r}, must be the root link of {model.path.name}, {model.root!r}")
    radius, height = _size(model, robot)
    try:
        return RobotSpec(
            name=name,
            urdf=model.path,
            base_link=base,
            links=tuple(link.name for link in model.links),
            visuals=_visuals(model, name),
            fixed_transforms=tuple((j.parent, j.child, j.pose) for j in model.joints if j.kind == "fixed"),
            moving_joints=tuple((j.name, j.parent, j.child) for j in model.joints if j.kind != "fixed"),
            drive=_drive(robot, model),
            radius=radius,
            height=height,
            cameras=_cameras(robot, model, name),
            lidar=_lidar(robot, model, name),
            start=start or Pose(),
        )
    except ConfigError as error:
        raise RobotError(f"{path}: {error}") from error


def _robot_file(path_or_name: Path | str, find: Callable[[str], Path] | None) -> Path:
    path = Path(path_or_name)
    is_path = isinstance(path_or_name, Path) or path.suffix in (".yaml", ".yml") or len(path.parts) != 1
    if not is_path:
        path = Path((find or find_robot)(str(path_or_name)))
    if path.is_dir():
        path = path / ROBOT_FILE
    if not path.is_file():
        raise RobotError(f"no robot at {path}; give a {ROBOT_FILE}, a folder with one, or the name of a known robot")
    return path.absolute()


def _read_yaml(path: Path) -> Any:
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise RobotError(f"{path}: is not YAML: {' '.join(str(error).split())}") from error
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from error


class _Settings:
    """One mapping of the file; every complaint names file and key."""

    def __init__(self, values: Any, where: str) -> None:
        if not isinstance(values, Mapping):
            raise RobotError(f"{where}: must be a list of 'key: value' lines, is {type(values).__name__}")
        self.values, self.where = values, where

    def check_keys(self, known: tuple[str, ...]) -> None:
        for key in self.values:
            if key not in known:
                near = difflib.get_close_matches(str(key), known, n=1, cutoff=0.5)
                hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}"
                raise RobotError(f"{self.where}: key {key!r} is unknown; {hint}")

    def section(self, key: str) -> _Settings | None:
        return _Settings(self.values[key], f"{self.where}: {key}") if self.values.get(key) is not None else None

    def text(self, key: str, default: str = "") -> str:
        value = self.values.get(key, default)
        if not isinstance(value, str) or not value:
            raise RobotError(
                f"{self.where}: {key} is {value!r}, must be a text" if key in self.values else f"{self.where}: {key} is missing"
            )
        return value

    def number(self, key: str) -> float:
        value = self.values[key]
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise RobotError(f"{self.where}: {key} is {value!r}, must be a finite number")
        return float(value)

    def numbers(self, keys: tuple[str, ...]) -> dict[str, float]:
        """Returns those of ``keys`` that are given."""
        return {key: self.number(key) for key in keys if key in self.values}

    def integers(self, keys: tuple[str, ...]) -> dict[str, int]:
        """Returns those of ``keys`` that are given."""
        out = {}
        for key in keys:
            if key in self.values:
                value = self.number(key)
                if value != int(value):
                    raise RobotError(f"{self.where}: {key} is {value:g}, must be a whole number")
                out[key] = int(value)
        return out

    def floats(self, key: str) -> tuple[float, ...]:
        """Returns a list of finite numbers, as many as there are."""
        value = self.values[key]
        if not isinstance(value, list):
            raise RobotError(f"{self.where}: {key} is {value!r}, must be a list of numbers")
        return tuple(_Settings({key: item}, self.where).number(key) for item in value)

    def vector(self, key: str) -> Vec3:
        value = self.values.get(key, [0.0, 0.0, 0.0])
        if not isinstance(value, list) or len(value) != 3:
            raise RobotError(f"{self.where}: {key} is {value!r}, must be three numbers")
        x, y, z = (_Settings({key: item}, self.where).number(key) for item in value)
        return (x, y, z)


def _visuals(model: UrdfModel, name: str) -> tuple[VisualSpec, ...]:
    return tuple(
        VisualSpec(f"{name}/{link.name}/{i}", f"{name}/{link.name}", visual.shape, visual.pose, visual.color)
        for link in model.links
        for i, visual in enumerate(link.visuals)
    )


def _drive(robot: _Settings, model: UrdfModel) -> DriveSpec | None:
    settings = robot.section("drive")
    if settings is None:
        return None
    settings.check_keys(_DRIVE_KEYS)
    kind = settings.text("type")
    if kind != "differential":
        raise RobotError(f"{settings.where}: type is {kind!r}, must be 'differential'")
    transforms = model.transforms()
    left, right = (model.joint(settings.text(key)) for key in ("left_joint", "right_joint"))
    signs, hubs = [], []
    for joint in (left, right):
        T_root_wheel = transforms[joint.child]
        across = float((T_root_wheel[:3, :3] @ np.array(joint.axis))[1])
        if joint.kind != "continuous" or abs(across) < 0.99:
            raise RobotError(
                f"{model.path}: joint {joint.name!r} cannot drive: it must be continuous, with its axis along y of {model.root}"
            )
        signs.append(1.0 if across > 0 else -1.0)
        hubs.append(T_root_wheel[:3, 3])
    given = settings.numbers(("wheel_radius", "wheel_separation", *_LIMIT_KEYS))
    given.setdefault("wheel_separation", float(hubs[0][1] - hubs[1][1]))
    if given["wheel_separation"] <= 0:
        raise RobotError(f"{settings.where}: {left.name!r} is not to the left (+y) of {right.name!r}; were they swapped?")
    if "wheel_radius" not in given:
        given["wheel_radius"] = _wheel_radius(model, left.child)
        other = _wheel_radius(model, right.child)
        if abs(other - given["wheel_radius"]) > 1e-6:
            raise RobotError(
                f"{model.path}: the wheels have radii {given['wheel_radius']:g} and {other:g} m; give drive.wheel_radius"
            )
    return DriveSpec(left.name, right.name, **given, left_sign=signs[0], right_sign=signs[1])


def _wheel_radius(model: UrdfModel, link_name: str) -> float:
    """Returns the radius of the largest sphere or cylinder of the link: collision shapes first, else what is drawn."""
    link = model.link(link_name)
    for shapes in ([c.shape for c in link.collisions], [v.shape for v in link.visuals]):
        radii = [shape.size[0] for shape in shapes if shape.kind in ("sphere", "cylinder")]
        if radii:
            return max(radii)
    raise RobotError(
        f"{model.path}: link {link_name!r} has no sphere or cylinder to read the wheel's radius from; give drive.wheel_radius"
    )


def _cameras(robot: _Settings, model: UrdfModel, name: str) -> tuple[CameraSpec, ...]:
    entries = robot.values.get("cameras") or []
    if not isinstance(entries, list):
        raise RobotError(f"{robot.where}: cameras must be a list, is {type(entries).__name__}")
    cameras = tuple(_camera(_Settings(entry, f"{robot.where}: cameras[{i}]"), model, name) for i, entry in enumerate(entries))
    names = [camera.name for camera in cameras]
    if len(set(names)) != len(names):
        raise RobotError(f"{robot.where}: cameras are named {', '.join(names)}; names must differ")
    return cameras


def _camera(settings: _Settings, model: UrdfModel, name: str) -> CameraSpec:
    settings.check_keys(_CAMERA_KEYS)
    camera_name = settings.text("name")
    if not _NAME.fullmatch(camera_name):
        raise RobotError(f"{settings.where}: name is {camera_name!r}; use letters, digits and _, a letter first")
    link = model.link(settings.text("link")).name
    values: dict[str, Any] = {
        **settings.integers(("width", "height", "samples")),
        **settings.numbers(("near", "far", "rate_hz", "stereo_baseline")),
        **_optics(settings),
    }
    for key, kind in (("effects", ImageEffects), ("depth_noise", DepthNoise)):
        if (section := settings.section(key)) is not None:
            values[key] = _plain(section, kind)
    outputs = settings.values.get("outputs", list(DEFAULT_OUTPUTS))
    if not isinstance(outputs, list) or not all(isinstance(item, str) for item in outputs):
        raise RobotError(f"{settings.where}: outputs is {outputs!r}, must be a list of {', '.join(OUTPUTS)}")
    pose = _camera_pose(settings, link)
    return CameraSpec(name=camera_name, link=f"{name}/{link}", pose=pose, outputs=tuple(outputs), **values)


def _optics(settings: _Settings) -> dict[str, Any]:
    """Returns the fields of ``CameraSpec`` that say where a direction is in the image."""
    projection = cast(Projection, settings.text("projection", "pinhole"))
    if projection not in DISTORTIONS:
        raise RobotError(f"{settings.where}: projection is {projection!r}, must be one of {', '.join(DISTORTIONS)}")
    out: dict[str, Any] = {"projection": projection}
    # Angles of another kind of camera would be ignored: say so instead.
    for key, field, owner in (("fov_y_deg", "fov_y", "pinhole"), ("fov_deg", "fov", "fisheye")):
        if key in settings.values:
            if projection != owner:
                other = {"pinhole": "a pinhole camera has fov_y_deg", "fisheye": "a fisheye has fov_deg"}.get(projection, "")
                raise RobotError(f"{settings.where}: {key} is for a {owner} camera; {other or 'an equirectangular one sees all'}")
            out[field] = math.radians(settings.number(key))
    if "k" in settings.values:
        if "fov_y_deg" in settings.values:
            raise RobotError(f"{settings.where}: k and fov_y_deg both say how wide the image is; leave one out")
        out["matrix"] = _matrix(settings)
    if ("d" in settings.values) != ("distortion_model" in settings.values):
        raise RobotError(f"{settings.where}: d and distortion_model belong together; give both, as in a camera_info")
    if "d" in settings.values:
        d, model, models = settings.floats("d"), settings.text("distortion_model"), DISTORTIONS[projection]
        if model not in models:
            known = " or ".join(models) or "none at all"
            raise RobotError(f"{settings.where}: distortion_model is {model!r}, that of a {projection} camera must be {known}")
        if len(d) not in models[model]:
            counts = " or ".join(map(str, models[model]))
            raise RobotError(f"{settings.where}: d has {len(d)} numbers, {model} has {counts}")
        out["distortion"] = d
    return out


def _matrix(settings: _Settings) -> tuple[float, ...]:
    """Returns K from nine numbers by rows, or from a mapping of focal lengths and principal point."""
    if isinstance(settings.values["k"], list):
        return settings.floats("k")
    section = settings.section("k")
    if section is None:
        raise RobotError(f"{settings.where}: k is empty, must be nine numbers, or fx, fy, cx, cy and, if any, skew")
    section.check_keys(_MATRIX_KEYS)
    given = section.numbers(_MATRIX_KEYS)
    missing = [key for key in _MATRIX_KEYS[:4] if key not in given]
    if missing:
        raise RobotError(f"{section.where}: {', '.join(missing)} is missing; give fx, fy, cx and cy, pixels")
    return (given["fx"], given.get("skew", 0.0), given["cx"], 0.0, given["fy"], given["cy"], 0.0, 0.0, 1.0)


def _plain(section: _Settings, kind: type[ImageEffects] | type[DepthNoise]) -> ImageEffects | DepthNoise:
    """Returns a value all of whose fields are numbers, those named in the file."""
    whole = tuple(f.name for f in fields(kind) if isinstance(f.default, int))
    names = tuple(f.name for f in fields(kind))
    section.check_keys(names)
    return kind(**section.integers(whole), **section.numbers(tuple(n for n in names if n not in whole)))  # type: ignore[arg-type]


def _camera_pose(settings: _Settings, link: str) -> Pose:
    """Returns T_link_optical. REP 103: a link whose name holds ``_optical`` has optical axes already."""
    place = settings.section("pose")
    if "_optical" in link:
        if place is not None:
            raise RobotError(
                f"{settings.where}: link {link!r} is optical and takes no pose; name the link it is fixed to instead"
            )
        return Pose()
    T_link_camera: Mat4 = np.eye(4)
    if place is not None:
        place.check_keys(_POSE_KEYS)
        roll, pitch, yaw = (math.radians(angle) for angle in place.vector("rpy_deg"))
        T_link_camera = matrix_from_pose(pose_from_xyz_rpy(place.vector("xyz"), (roll, pitch, yaw)))
    T_link_camera[:3, :3] = T_link_camera[:3, :3] @ R_LINK_OPTICAL
    return pose_from_matrix(T_link_camera)


def _lidar(robot: _Settings, model: UrdfModel, name: str) -> LidarSpec | None:
    settings = robot.section("lidar")
    if settings is None:
        return None
    settings.check_keys(_LIDAR_KEYS)
    link = model.link(settings.text("link")).name
    numbers = settings.numbers(("range_min", "range_max", "rate_hz"))
    return LidarSpec(link=f"{name}/{link}", **settings.integers(("beams",)), **numbers)  # type: ignore[arg-type]


def _size(model: UrdfModel, robot: _Settings) -> tuple[float, float]:
    """Returns (radius about the base's z axis, height above the floor) of the collision shapes, or what the file gives."""
    given = robot.numbers(("radius", "height"))
    radius, height, meshes = 0.0, 0.0, 0
    transforms = model.transforms()
    for link in model.links:
        for collision in link.collisions:
            if collision.shape.kind == "mesh":
                meshes += 1
                continue
            reach, top = _extent(collision.shape, transforms[link.name] @ matrix_from_pose(collision.pose))
            radius, height = max(radius, reach), max(height, top)
    if len(given) < 2:
        if radius == 0.0:
            raise RobotError(
                f"{robot.where}: give radius and height (metres): {model.path.name} has no boxes, spheres or cylinders to collide"
            )
        if meshes:
            logger.warning("%s: radius and height leave out %d collision meshes; give them in the file", robot.where, meshes)
    radius, height = given.get("radius", radius), given.get("height", height)
    if min(radius, height) <= 0:
        raise RobotError(f"{robot.where}: radius is {radius:g} m and height {height:g} m, both must be above 0")
    return radius, height


def _extent(shape: Shape, T_root_shape: Mat4) -> tuple[float, float]:
    """Returns (farthest distance from the z axis, highest z) of a primitive, metres; exact but for tilted cylinders' radius."""
    center, rotation = T_root_shape[:3, 3], T_root_shape[:3, :3]
    if shape.kind == "sphere":
        return float(np.hypot(center[0], center[1])) + shape.size[0], float(center[2]) + shape.size[0]
    points: NDArray[np.float64]
    if shape.kind == "box":
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        points = signs * np.array(shape.size) / 2
    else:
        angles = np.linspace(0.0, 2 * np.pi, 73)[:-1]
        # A cylinder that stands off the axis is farthest in the direction of its own centre.
        angles = np.append(angles, math.atan2(*(rotation.T @ center)[1::-1]))
        ring = shape.size[0] * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1)
        points = np.concatenate([ring + np.array([0.0, 0.0, h * shape.size[1] / 2]) for h in (-1, 1)])
    world = points @ rotation.T + center
    return float(np.hypot(world[:, 0], world[:, 1]).max()), float(world[:, 2].max())
