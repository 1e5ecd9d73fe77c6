"""Reads a ``robot.yaml``, its URDF and its meshes to a ``RobotSpec``; ``docs/robots.md`` describes the keys. Pure: no physics, no ROS."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from gibson_sim.description.body import model_visuals
from gibson_sim.description.extents import MeshPoints, radius_and_top
from gibson_sim.description.mesh_files import PACKAGE_SCHEME, resolve_mesh
from gibson_sim.description.packages import searched_places
from gibson_sim.description.rigid_groups import MOVING_TYPES
from gibson_sim.description.urdf import UrdfModel, read_urdf
from gibson_sim.description.xacro import plain_description
from gibson_sim.errors import ConfigError, RobotError
from gibson_sim.formats.load_mesh import mesh_points
from gibson_sim.formats.textured_shapes import with_textures
from gibson_sim.formats.yaml_map import ROS_NAME, YamlMap, read_yaml_map
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_file, is_folder
from gibson_sim.resources import find_robot
from gibson_sim.robots.loading.base_frame import with_base
from gibson_sim.robots.loading.cameras import read_cameras
from gibson_sim.robots.loading.derive import DESCRIPTION_SUFFIXES, DerivedRobot, derive_robot
from gibson_sim.robots.loading.drive import read_drive
from gibson_sim.robots.loading.manipulators import MANIPULATOR_KEYS, read_manipulators, read_poses
from gibson_sim.robots.loading.sensors import SENSOR_KEYS, read_sensors
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.types import Pose

logger = logging.getLogger(__name__)

ROBOT_FILE = "robot.yaml"
_ROBOT_KEYS = (
    "urdf",
    "xacro_args",
    "base_link",
    "base_height",
    "fixed_base",
    "wheel_drop",
    "round_wheels",
    "friction",
    "radius",
    "height",
    "drive",
    "cameras",
    *SENSOR_KEYS,
    *MANIPULATOR_KEYS,
)
_NO_ROBOTS = {
    ".sdf": "is an SDF model, which is spawned as a body",
    ".xml": "is not a URDF by its name",
    ".zip": "is an archive: unpack it",
}
"""Suffix of files that users give as robots by mistake -> error text."""


def load_robot(
    path_or_name: Path | str,
    *,
    name: str = "robot",
    start: Pose | None = None,
    find: Callable[[str], Path] | None = None,
    roots: Sequence[Path] | None = None,
    log: bool = True,
) -> RobotSpec:
    """Returns the robot of a ``robot.yaml``, or of a URDF or a xacro, whose other values are guessed (``robots.loading.derive``).

    Args:
        path_or_name: A ``robot.yaml``, a URDF, a xacro, a folder that has one, or the name of a robot that ``find`` knows.
        name: Body name; its links become ``<name>/<link>``.
        start: T_world_base at load; None = the origin.
        find: Returns a robot's folder or file by its name; None = ``config/robots/<name>`` of a share folder (see ``resources``).
        roots: Folders that meshes must lie in, which are measured for radius, height and wheels; None = anywhere.
        log: Whether guesses and warnings are logged; False for a list of robots, none of which is simulated.

    Raises:
        RobotError: a file is missing or invalid; one line.
    """
    if not ROS_NAME.fullmatch(name):
        raise RobotError(f"robot name {quoted(name)} is not usable in ROS; use letters, digits and _, a letter first")
    path = find_robot_file(path_or_name, find)
    if path.suffix.lower() in DESCRIPTION_SUFFIXES:
        derived = derive_file(path, roots=roots)
        for guess in derived.guesses if log else ():
            logger.info("%s: no robot.yaml; guessed %s", path.name, guess)
        robot = YamlMap({"urdf": path.name, **derived.values}, str(path), error=RobotError)
    else:
        robot = read_yaml_map(path, error=RobotError)
    robot.check_keys(_ROBOT_KEYS)
    model = with_textures(_model(robot, path))
    for warning in model.warnings if log else ():
        logger.warning("%s", warning)
    for joint in model.joints:
        if joint.kind not in (*MOVING_TYPES, "fixed"):
            raise RobotError(f"{model.path}: joint {quoted(joint.name)} is {joint.kind}, which is not simulated")
    try:
        drive = read_drive(robot, model)
        fixed_base = robot.flag("fixed_base", False)
        if fixed_base and drive is not None:
            raise RobotError(
                f"{robot.where}: fixed_base is true and there is a drive; a fixed base cannot drive: remove one of them"
            )
        poses, joints = read_poses(robot, model, drive)
        radius, height = _size(model, robot, dict(joints), mesh_points(roots))
        return RobotSpec(
            name=name,
            urdf=model.path,
            base_link=model.root,
            links=tuple(link.name for link in model.links),
            visuals=model_visuals(model, name),
            fixed_transforms=tuple((j.parent, j.child, j.pose) for j in model.joints if j.kind == "fixed"),
            moving_joints=tuple((j.name, j.parent, j.child) for j in model.joints if j.kind != "fixed"),
            drive=drive,
            fixed_base=fixed_base,
            radius=radius,
            height=height,
            cameras=read_cameras(robot, model, name, path.parent),
            sensors=read_sensors(robot, model, name),
            start=start or Pose(),
            joints=joints,
            named_poses=poses,
            manipulators=read_manipulators(robot, model, drive),
        )
    except ConfigError as error:
        raise RobotError(f"{path}: {error}") from error


def derive_file(
    path: Path, arguments: Mapping[str, str] | None = None, *, roots: Sequence[Path] | None = None, needs_drive: bool = True
) -> DerivedRobot:
    """Returns a guess of the ``robot.yaml`` for the URDF or xacro at ``path``; see ``derive_robot``, and ``load_robot`` for ``roots``."""
    # Errors must name the user's file, not its expansion.
    model = replace(read_urdf(plain_description(path, arguments or {})), path=path)
    return derive_robot(model, mesh_points(roots), needs_drive=needs_drive)


def find_robot_file(path_or_name: Path | str, find: Callable[[str], Path] | None = None) -> Path:
    """Returns the absolute path of a robot's ``robot.yaml``, or of the URDF or xacro of a robot without one.

    Raises:
        RobotError: the robot does not exist, or a folder holds several.
    """
    path = Path(path_or_name)
    suffixes = (".yaml", ".yml", *DESCRIPTION_SUFFIXES)
    is_path = isinstance(path_or_name, Path) or path.suffix.lower() in (*suffixes, *_NO_ROBOTS) or len(path.parts) != 1
    path = Path(os.path.expanduser(path)) if is_path else Path((find or find_robot)(str(path_or_name)))
    if is_folder(path):
        path = _in_folder(path)
    if not is_file(path):
        raise RobotError(f"no robot at {path}; give a {ROBOT_FILE}, a URDF, a folder with one, or the name of a known robot")
    if path.suffix.lower() not in suffixes:
        raise RobotError(
            f"{path}: {_NO_ROBOTS.get(path.suffix.lower(), 'describes no robot')}; give a {ROBOT_FILE}, a URDF or a xacro"
        )
    return path.absolute()


def _in_folder(folder: Path) -> Path:
    """Returns the file in a folder that describes a robot: the ``robot.yaml``, or the only URDF."""
    if is_file(folder / ROBOT_FILE):
        return folder / ROBOT_FILE
    try:
        inside = sorted(file for file in folder.iterdir() if file.name.lower().endswith((".urdf", ".urdf.xacro")))
    except OSError as error:
        raise RobotError(f"{folder}: cannot be read: {error.strerror}") from error
    if len(inside) > 1:
        names = ", ".join(file.name for file in inside[:8])
        raise RobotError(f"{folder}: holds no {ROBOT_FILE} and {len(inside)} descriptions, name one: {names}")
    return inside[0] if inside else folder / ROBOT_FILE


def _model(robot: YamlMap, path: Path) -> UrdfModel:
    """Returns the links of a robot, whose root is the frame of odometry."""
    model = read_urdf(_description(robot, path))
    height = robot.numbers(("base_height",)).get("base_height", 0.0)
    lowered, frictions, rounds = (_numbers_of(robot, key) for key in ("wheel_drop", "friction", "round_wheels"))
    try:
        file = with_base(model, robot.text("base_link", model.root), height, lowered, frictions, rounds)
    except RobotError as error:
        raise RobotError(f"{path}: {error}") from error
    return model if file == model.path else read_urdf(file)


def _numbers_of(robot: YamlMap, key: str) -> dict[str, float]:
    """Returns name -> number of a section."""
    section = robot.section(key)
    return {} if section is None else {str(name): section.number(name) for name in section.values}


def _description(robot: YamlMap, path: Path) -> Path:
    """Returns the plain URDF of a robot."""
    name, section = robot.text("urdf"), robot.section("xacro_args")
    arguments: dict[str, str] = {}
    for key, value in {} if section is None else section.values.items():
        if not isinstance(value, (str, int, float)):
            raise RobotError(f"{robot.where}: xacro_args: {key} is {quoted(value)}, must be a text, a number, true or false")
        arguments[str(key)] = str(value).lower() if isinstance(value, bool) else str(value)
    file = resolve_mesh(name, path) if name.startswith(PACKAGE_SCHEME) else path.parent / name
    if file is None:
        raise RobotError(f"{robot.where}: urdf {name} is not found: looked in {searched_places(path)}")
    return plain_description(file, arguments)


def _size(model: UrdfModel, robot: YamlMap, joints: Mapping[str, float], points: MeshPoints) -> tuple[float, float]:
    """Returns (radius about the base's z axis, height above the floor), metres, from the file or from the collision shapes.

    ``joints``: joint positions at load, radians or metres.
    """
    values = robot.numbers(("radius", "height"))
    radius, height, meshes = 0.0, 0.0, 0
    transforms = model.transforms(joints)
    for link in model.links if len(values) < 2 else ():
        for collision in link.collisions:
            extent = radius_and_top(collision.shape, transforms[link.name] @ matrix_from_pose(collision.pose), points)
            if extent is None:
                meshes += 1
            else:
                radius, height = max(radius, extent[0]), max(height, extent[1])
    if len(values) < 2:
        if radius == 0.0:
            mesh_warnings = [warning for warning in model.warnings if ": collision: " in warning]
            why = (
                f"{model.path.name} has no collision shapes to measure"
                if not mesh_warnings
                else f"nothing is left to measure: {mesh_warnings[0]}"
            )
            raise RobotError(f"{robot.where}: give radius and height (metres): {why}")
        if meshes:
            logger.warning("%s: radius and height leave out %d collision meshes; give them in the file", robot.where, meshes)
    radius, height = values.get("radius", radius), values.get("height", height)
    if min(radius, height) <= 0:
        raise RobotError(f"{robot.where}: radius is {radius:g} m and height {height:g} m, both must be above 0")
    return radius, height
