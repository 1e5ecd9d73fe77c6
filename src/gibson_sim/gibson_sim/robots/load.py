"""Reads ``robot.yaml`` and its URDF into a ``RobotSpec``; ``docs/robots.md`` explains the keys. Pure: no physics, no ROS."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError, RobotError
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose
from gibson_sim.resources import find_robot
from gibson_sim.robots.body import model_visuals
from gibson_sim.robots.load_cameras import read_cameras
from gibson_sim.robots.load_drive import read_drive
from gibson_sim.robots.load_manipulators import MANIPULATOR_KEYS, read_manipulators, read_poses
from gibson_sim.robots.load_sensors import SENSOR_KEYS, read_sensors
from gibson_sim.robots.mesh_files import PACKAGE_SCHEME, resolve_mesh
from gibson_sim.robots.rigid import MOVING_TYPES
from gibson_sim.robots.settings import NAME, Settings, read_yaml
from gibson_sim.robots.spec import RobotSpec, Shape
from gibson_sim.robots.urdf import UrdfModel, read_urdf
from gibson_sim.robots.xacro import plain_description
from gibson_sim.types import (
    Pose,
)

logger = logging.getLogger(__name__)

ROBOT_FILE = "robot.yaml"
_ROBOT_KEYS = ("urdf", "xacro_args", "base_link", "radius", "height", "drive", "cameras", *SENSOR_KEYS, *MANIPULATOR_KEYS)


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
    if not NAME.fullmatch(name):
        raise RobotError(f"robot name {name!r} is not usable in ROS; use letters, digits and _, a letter first")
    path = _robot_file(path_or_name, find)
    robot = Settings(read_yaml(path), str(path))
    robot.check_keys(_ROBOT_KEYS)
    model = read_urdf(_description(robot, path))
    for warning in model.warnings:
        logger.warning("%s", warning)
    for joint in model.joints:
        if joint.kind not in (*MOVING_TYPES, "fixed"):
            raise RobotError(f"{model.path}: joint {joint.name!r} is {joint.kind}, which is not simulated")
    base = robot.text("base_link", model.root)
    if base != model.root:
        raise RobotError(f"{path}: base_link is {base!r}, must be the root link of {model.path.name}, {model.root!r}")
    try:
        drive = read_drive(robot, model)
        poses, joints = read_poses(robot, model, drive)
        radius, height = _size(model, robot, dict(joints))
        return RobotSpec(
            name=name,
            urdf=model.path,
            base_link=base,
            links=tuple(link.name for link in model.links),
            visuals=model_visuals(model, name),
            fixed_transforms=tuple((j.parent, j.child, j.pose) for j in model.joints if j.kind == "fixed"),
            moving_joints=tuple((j.name, j.parent, j.child) for j in model.joints if j.kind != "fixed"),
            drive=drive,
            radius=radius,
            height=height,
            cameras=read_cameras(robot, model, name),
            sensors=read_sensors(robot, model, name),
            start=start or Pose(),
            joints=joints,
            named_poses=poses,
            manipulators=read_manipulators(robot, model, drive),
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


def _description(robot: Settings, path: Path) -> Path:
    """Returns the plain URDF of a robot."""
    name, section = robot.text("urdf"), robot.section("xacro_args")
    arguments: dict[str, str] = {}
    for key, value in {} if section is None else section.values.items():
        if not isinstance(value, (str, int, float)):
            raise RobotError(f"{robot.where}: xacro_args: {key} is {value!r}, must be a text, a number, true or false")
        arguments[str(key)] = str(value).lower() if isinstance(value, bool) else str(value)
    file = resolve_mesh(name, path) if name.startswith(PACKAGE_SCHEME) else path.parent / name
    if file is None:
        raise RobotError(
            f"{robot.where}: urdf {name} is not found: no such package above {path.parent}, in $AMENT_PREFIX_PATH or installed "
            "in Python, or no such file in it"
        )
    return plain_description(file, arguments)


def _size(model: UrdfModel, robot: Settings, joints: Mapping[str, float]) -> tuple[float, float]:
    """Returns (radius about the base's z axis, height above the floor) of the collision shapes, or what the file gives.

    ``joints``: where they are at load, radians or metres.
    """
    given = robot.numbers(("radius", "height"))
    radius, height, meshes = 0.0, 0.0, 0
    transforms = model.transforms(joints)
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
