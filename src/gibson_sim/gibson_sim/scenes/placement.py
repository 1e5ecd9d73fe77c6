"""Puts a robot into a scene: from three names to one SceneSpec."""

from __future__ import annotations

import logging
import math
from dataclasses import replace

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.floor_map import FloorMap, scene_floor_map
from gibson_sim.scenes.load import load_scene, with_robots
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.scenes.tour import choose_start
from gibson_sim.types import Pose

logger = logging.getLogger(__name__)


def populate(scene_name: str, robot_name: str, start: str = "", *, sdf_lamps: bool = False) -> SceneSpec:
    """Returns the scene with one robot in it.

    Args:
        scene_name: what ``load_scene`` takes.
        robot_name: what ``load_robot`` takes.
        start: name of one of the scene's start poses, or ``x,y,yaw_deg``; empty = the first start pose, or the most open place.
        sdf_lamps: as ``load_scene`` takes it.

    Raises:
        SceneError: the scene cannot be loaded.
        RobotError: the robot cannot be loaded.
        ConfigError: ``start`` is neither a name nor three numbers.
    """
    scene = load_scene(scene_name, sdf_lamps=sdf_lamps)
    robot = load_robot(robot_name)
    return with_robots(scene, [replace(robot, start=start_pose(scene, robot, start))])


def start_pose(scene: SceneSpec, robot: RobotSpec, start: str) -> Pose:
    """Returns T_world_base for ``start`` (see ``populate``), on the scene's floor."""
    named = {s.name: s.pose for s in scene.starts}
    if start in named:
        return named[start]
    if start:
        numbers = _three_numbers(start)
        if numbers is None:
            known = ", ".join(named) or "none in this scene"
            raise ConfigError(
                f"start is {start!r}, must be x,y,yaw_deg in metres and degrees, or the name of a start pose: {known}"
            )
        x, y, yaw_deg = numbers
        return pose_from_xyz_rpy((x, y, scene.floor_z), (0.0, 0.0, math.radians(yaw_deg)))
    if scene.starts:
        return scene.starts[0].pose
    x, y, yaw = choose_start(robot_floor_map(scene, robot), robot.radius)
    logger.info("scene %s names no start pose: starting at %.2f,%.2f,%.0f", scene.name, x, y, math.degrees(yaw))
    return pose_from_xyz_rpy((x, y, scene.floor_z), (0.0, 0.0, yaw))


def robot_floor_map(scene: SceneSpec, robot: RobotSpec) -> FloorMap:
    """Returns where on the scene's floor ``robot`` would touch nothing static."""
    return scene_floor_map(scene, robot_height=robot.height)


def _three_numbers(text: str) -> tuple[float, float, float] | None:
    try:
        x, y, yaw = (float(part) for part in text.split(","))
    except ValueError:
        return None
    return (x, y, yaw) if all(map(math.isfinite, (x, y, yaw))) else None
