"""The parameter files for Nav2, slam_toolbox and robot_localization: they agree with the robot, and every room of every scene can be reached."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from gibson_sim.maps.floor_map import scene_floor_map
from gibson_sim.robots.drive_spec import DifferentialSpec
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.load import load_scene
from support.simulation import require

EXAMPLES = Path(__file__).resolve().parents[3] / "ros_ws" / "src" / "gibson_examples"
SCENES = sorted(path.parent.name for path in (EXAMPLES.parents[2] / "scenes").glob("*/scene.yaml"))
FILES = ("nav2", "slam_toolbox", "robot_localization")


def read(name: str) -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load((EXAMPLES / "config" / f"{name}.yaml").read_text())
    return document


@pytest.fixture(scope="module")
def nav2() -> dict[str, Any]:
    """The parameters of each node, by name."""
    return {name: _of_node(part) for name, part in read("nav2").items()}


def _of_node(part: dict[str, Any]) -> dict[str, Any]:
    values: dict[str, Any] = part["ros__parameters"] if "ros__parameters" in part else _of_node(next(iter(part.values())))
    return values


@pytest.fixture(scope="module", params=["gibson_bot", "gibson_bot_real"])
def robot(request: pytest.FixtureRequest, root: Path) -> RobotSpec:
    return load_robot(root / "config/robots" / request.param)


def costmaps(nav2: dict[str, Any]) -> list[dict[str, Any]]:
    return [nav2["local_costmap"], nav2["global_costmap"]]


def test_footprint_is_the_robots(nav2: dict[str, Any], robot: RobotSpec) -> None:
    for costmap in costmaps(nav2):
        assert robot.radius <= costmap["robot_radius"] <= robot.radius + 0.02


def test_speeds_are_within_the_robots_limits(nav2: dict[str, Any], robot: RobotSpec) -> None:
    drive, follow, behaviors = robot.drive, nav2["controller_server"]["FollowPath"], nav2["behavior_server"]
    assert isinstance(drive, DifferentialSpec)
    assert 0.0 < follow["desired_linear_vel"] <= drive.max_linear
    assert follow["regulated_linear_scaling_min_speed"] <= follow["desired_linear_vel"]
    for speed in (follow["rotate_to_heading_angular_vel"], behaviors["max_rotational_vel"]):
        assert behaviors["min_rotational_vel"] <= speed <= drive.max_angular
    for acceleration in (follow["max_angular_accel"], behaviors["rotational_acc_lim"]):
        assert acceleration <= drive.max_angular_acceleration


def test_robot_stops_before_what_the_controller_looks_at(nav2: dict[str, Any], robot: RobotSpec) -> None:
    follow = nav2["controller_server"]["FollowPath"]
    assert isinstance(robot.drive, DifferentialSpec)
    assert follow["use_collision_detection"] is True
    stopping_s = follow["desired_linear_vel"] / robot.drive.max_linear_acceleration
    looks_ahead_s = min(
        follow["max_allowed_time_to_collision_up_to_carrot"], follow["max_lookahead_dist"] / follow["desired_linear_vel"]
    )
    # At constant deceleration it goes half as far as at full speed in that time; one period of the controller passes before.
    assert stopping_s / 2 + 1.0 / nav2["controller_server"]["controller_frequency"] < looks_ahead_s


def test_cost_regulation_reads_an_existing_costmap(nav2: dict[str, Any]) -> None:
    """The controller turns costs back to distances: with another factor than the costmap's they would be wrong."""
    follow = nav2["controller_server"]["FollowPath"]
    inflation = nav2["local_costmap"]["inflation_layer"]
    assert follow["inflation_cost_scaling_factor"] == inflation["cost_scaling_factor"]
    assert nav2["local_costmap"]["robot_radius"] < follow["cost_scaling_dist"] <= inflation["inflation_radius"]
    assert inflation == nav2["global_costmap"]["inflation_layer"]


def test_frames_and_topics_are_the_simulators(nav2: dict[str, Any], robot: RobotSpec) -> None:
    frames = {"map", "odom", robot.base_link}
    for name, values in nav2.items():
        for key, value in values.items():
            if key.endswith(("frame", "frame_id")):
                assert value in frames, (name, key)
    (lidar,) = robot.sensors.lidars
    assert nav2["amcl"]["scan_topic"] == lidar.name
    assert nav2["amcl"]["laser_max_range"] == lidar.range_max
    for costmap in costmaps(nav2):
        scan = costmap["obstacle_layer"]["scan"]
        assert scan["topic"] == f"/{lidar.name}"
        assert scan["obstacle_min_range"] >= lidar.range_min
        assert scan["obstacle_max_range"] < scan["raytrace_max_range"] < lidar.range_max
    assert nav2["/**"]["use_sim_time"] is True


def test_commands_are_of_a_type_that_the_simulator_takes(nav2: dict[str, Any]) -> None:
    assert {nav2[name]["enable_stamped_cmd_vel"] for name in ("controller_server", "behavior_server")} == {False}


def test_slam_and_filter_are_for_this_robot(robot: RobotSpec) -> None:
    slam, ekf = (_of_node(next(iter(read(name).values()))) for name in ("slam_toolbox", "robot_localization"))
    (lidar,), (imu,) = robot.sensors.lidars, robot.sensors.imus
    assert (slam["base_frame"], slam["odom_frame"], slam["map_frame"]) == (robot.base_link, "odom", "map")
    assert (slam["scan_topic"], slam["max_laser_range"]) == (f"/{lidar.name}", lidar.range_max)
    assert slam["min_laser_range"] >= lidar.range_min
    assert (ekf["base_link_frame"], ekf["odom0"], ekf["imu0"]) == (robot.base_link, "odom", imu.name)
    # Speeds forward and to the left and the yaw rate of the wheels; the yaw rate of the gyroscope. Neither pose nor orientation.
    assert np.flatnonzero(ekf["odom0_config"]).tolist() == [6, 7, 11]
    assert np.flatnonzero(ekf["imu0_config"]).tolist() == [11]
    assert ekf["publish_tf"] is False, "the simulator publishes odom -> base_footprint"


@pytest.mark.ros
@pytest.mark.parametrize("name", FILES)
def test_ros_reads_the_file(name: str) -> None:
    """ROS's own parser knows less YAML than others: no anchors, no lists of mixed types."""
    require("rclpy")
    import rclpy
    from rclpy.context import Context

    context = Context()
    rclpy.init(args=["--ros-args", "--params-file", str(EXAMPLES / "config" / f"{name}.yaml")], context=context)
    rclpy.shutdown(context=context)


def test_launch_file_starts_nodes_that_have_parameters(nav2: dict[str, Any]) -> None:
    tree = ast.parse((EXAMPLES / "launch" / "nav2.launch.py").read_text())
    servers = next(ast.literal_eval(node.value) for node in tree.body if isinstance(node, ast.Assign))
    assert {name for _, name in servers} | {"amcl"} <= set(nav2)
    own = {"/**", "amcl", "local_costmap", "global_costmap"}
    assert {name for _, name in servers} == set(nav2) - own


def test_goals_are_the_named_poses_with_the_tag_in_turn() -> None:
    require("rclpy")
    from gibson_examples.errors import NavigationError
    from gibson_examples.named_goals import goals_of

    poses = [SimpleNamespace(name=f"floor_{i}/{kind}_0", tags=[kind, f"floor_{i}"]) for i in (1, 0) for kind in ("room", "door")]
    poses.append(SimpleNamespace(name="floor_0/room_1", tags=["room", "floor_0", "kitchen"]))
    names = [pose.name for pose in goals_of(poses, "room", "floor_0", 3)]
    assert names == ["floor_0/room_0", "floor_0/room_1", "floor_0/room_0"]
    with pytest.raises(NavigationError, match=r"'attic'.*there are: door, floor_0, floor_1, kitchen, room"):
        goals_of(poses, "attic", "floor_0", 3)


def test_missing_packages_are_reported_in_one_line() -> None:
    require("rclpy")
    from gibson_examples.errors import NavigationError
    from gibson_examples.named_goals import interface

    with pytest.raises(NavigationError, match=r"^the package no_such_msgs is not installed; install it$"):
        interface("no_such_msgs", "srv", "Any", "install it")


@pytest.mark.parametrize("name", SCENES)
def test_every_room_of_a_scene_is_reached_through_its_doors(name: str, nav2: dict[str, Any], root: Path) -> None:
    """A way of free cells at the costmap's radius, and one cell more, joins all rooms of a floor."""
    robot = load_robot(root / "config/robots/gibson_bot")
    costmap = nav2["global_costmap"]
    radius = costmap["robot_radius"] + costmap["resolution"]
    scene = load_scene(name)
    assert scene.rooms
    for number, floor_z in enumerate(scene.floors):
        floor = scene_floor_map(replace(scene, floor_z=floor_z), robot_height=robot.height, resolution=costmap["resolution"])
        joined = floor.centers(np.argwhere(floor.largest_free_region(radius)))
        for room in scene.rooms:
            if room.floor == number:
                assert room.contains(joined).any(), (
                    f"{room.name} of floor {number} cannot be reached by a robot of {radius:.2f} m"
                )
