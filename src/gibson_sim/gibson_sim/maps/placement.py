"""Places robots in a scene: loads them by name, assigns namespaces and start poses, and returns one SceneSpec."""

from __future__ import annotations

import logging
import math
from dataclasses import replace

import numpy as np

from gibson_sim.config import robots_of
from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.maps.bodies import body_triangles
from gibson_sim.maps.floor_map import FloorMap, scene_floor_map, with_floor_at
from gibson_sim.maps.tour import choose_start
from gibson_sim.quoting import quoted
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.load import load_scene, with_robots
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.settings import nearest
from gibson_sim.types import FARTHEST_M, Pose

logger = logging.getLogger(__name__)


def populate(
    scene_name: str, robots: str, start: str = "", *, sdf_lamps: bool = False, robot_tf: str = "namespaced"
) -> SceneSpec:
    """Returns the scene with its robots; its ``floor_z`` is the floor on which the first robot starts.

    Args:
        scene_name: argument of ``load_scene``.
        robots: argument of ``load_robot``, or several as ``name=robot``, separated by commas; each name is the robot's namespace.
        start: name of a start pose of the scene, or ``x,y,yaw_deg`` in world metres and degrees; for several robots in their order,
            separated by ``;``. Empty = the first start pose that is free, or the most open place.
        sdf_lamps: argument of ``load_scene``.
        robot_tf: for several robots: ``namespaced`` or ``prefixed``, see ``gibson_sim.config.PhysicsConfig``.

    Raises:
        SceneError: the scene cannot be loaded.
        RobotError: a robot cannot be loaded.
        ConfigError: ``robots`` or ``start`` is invalid.
    """
    return place_robots(load_scene(scene_name, sdf_lamps=sdf_lamps), robots, start, robot_tf=robot_tf)


def place_robots(scene: SceneSpec, robots: str, start: str = "", *, robot_tf: str = "namespaced") -> SceneSpec:
    """Returns the scene with its robots; the arguments are those of ``populate``."""
    entries = robots_of(robots)
    if not entries[0][0]:
        return place_robot(scene, load_robot(entries[0][1]), start)
    placed: list[RobotSpec] = []
    starts = [part.strip() for part in start.split(";")] if start else []
    if len(starts) > len(entries):
        raise ConfigError(f"start has {len(starts)} places for {len(entries)} robots: {quoted(start)}")
    for i, (name, kind) in enumerate(entries):
        robot = in_namespace(load_robot(kind, name=name), name, robot_tf)
        start_text = starts[i] if i < len(starts) else ""
        pose = start_pose(scene, robot, start_text) if start_text else free_start(scene, robot, [other.start for other in placed])
        placed.append(replace(robot, start=pose))
    return with_robots(with_floor_at(scene, placed[0].start.position[2]), placed)


def place_robot(scene: SceneSpec, robot: RobotSpec, start: str = "") -> SceneSpec:
    """Returns the scene with a robot, whose floor is that of the scene; ``start`` as for ``populate``, for one robot."""
    pose = start_pose(scene, robot, start)
    return with_robots(with_floor_at(scene, pose.position[2]), [replace(robot, start=pose)])


def in_namespace(robot: RobotSpec, namespace: str, robot_tf: str = "namespaced") -> RobotSpec:
    """Returns the robot with all its topics, including those of its cameras, in ``namespace``, and its frames according to ``robot_tf``."""
    prefix = f"{namespace}/" if robot_tf == "prefixed" else ""
    cameras = tuple(replace(c, name=f"{namespace}/{c.name}", frame_id=f"{prefix}{c.optical_frame}") for c in robot.cameras)
    return replace(robot, namespace=namespace, frame_prefix=prefix, own_tf=not prefix, cameras=cameras)


def free_start(scene: SceneSpec, robot: RobotSpec, others: list[Pose]) -> Pose:
    """Returns a start pose (T_world_base) clear of obstacles and of robots at ``others``: one of the scene, or the nearest free floor."""
    distance = 4.0 * robot.radius + 0.5

    def is_clear(x: float, y: float) -> bool:
        return all(math.hypot(x - other.position[0], y - other.position[1]) >= distance for other in others)

    for named in scene.starts:
        if is_clear(*named.pose.position[:2]):
            return named.pose
    if not others:
        return start_pose(scene, robot, "")
    floor = robot_floor_map(scene, robot)
    region = floor.largest_free_region(robot.radius)
    centers = floor.centers(np.argwhere(region))
    order = np.argsort(np.sum((centers - np.array(others[0].position[:2])) ** 2, axis=1), kind="stable")
    for x, y in centers[order]:
        if is_clear(float(x), float(y)):
            return pose_from_xyz_rpy((float(x), float(y), scene.floor_z), (0.0, 0.0, 0.0))
    raise ConfigError(f"scene {quoted(scene.name)} has no room for robot {quoted(robot.name)}: give its start as x,y,yaw_deg")


def start_pose(scene: SceneSpec, robot: RobotSpec, start: str) -> Pose:
    """Returns T_world_base for ``start`` (see ``populate``), on the scene's floor."""
    named = {s.name: s.pose for s in scene.starts}
    if start in named:
        return named[start]
    if start:
        numbers = _three_numbers(start)
        if numbers is None:
            known, hint = ", ".join(named) or "none in this scene", nearest(start, tuple(named))
            raise ConfigError(
                f"start is {quoted(start)}, must be x,y,yaw_deg in metres and degrees, or the name of a start pose: {known}"
                f"{f'; {hint}' if hint else ''}"
            )
        x, y, yaw_deg = numbers
        if max(abs(x), abs(y)) > FARTHEST_M:
            raise ConfigError(f"start is {quoted(start)}, x and y must be -{FARTHEST_M:g} to {FARTHEST_M:g} m")
        return pose_from_xyz_rpy((x, y, scene.floor_z), (0.0, 0.0, math.radians(yaw_deg)))
    if scene.starts:
        return scene.starts[0].pose
    x, y, yaw = choose_start(robot_floor_map(scene, robot), robot.radius)
    logger.info("scene %s has no start pose: starting at %.2f,%.2f,%.0f (x, y, yaw_deg)", scene.name, x, y, math.degrees(yaw))
    return pose_from_xyz_rpy((x, y, scene.floor_z), (0.0, 0.0, yaw))


def robot_floor_map(scene: SceneSpec, robot: RobotSpec) -> FloorMap:
    """Returns the map of the scene's floor for the height of a robot, with static obstacles only."""
    return scene_floor_map(scene, robot_height=robot.height)


def furnished_floor_map(scene: SceneSpec, robot: RobotSpec) -> FloorMap:
    """Returns the map of the scene's floor for the height of a robot, with static obstacles and bodies at their start poses."""
    return robot_floor_map(scene, robot).furnished(*body_triangles(scene), robot.height)


def _three_numbers(text: str) -> tuple[float, float, float] | None:
    """Returns three finite numbers separated by commas; None for other texts."""
    try:
        x, y, yaw = (float(part) for part in text.split(","))
    except ValueError:
        return None
    return (x, y, yaw) if all(map(math.isfinite, (x, y, yaw))) else None
