"""Starts the physics node and the render node: ros2 launch gibson_sim sim.launch.py scene:=linden_flat rate:=1.0"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler, SetEnvironmentVariable
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = (
    ("scene", "linden_flat", str, "scene: a name, a folder, a world file or a mesh file"),
    ("robot", "gibson_bot", str, "robot: a name, a folder or a robot.yaml; several: left=gibson_bot,right=gibson_bot"),
    ("start", "", str, "where the robot starts: a name or x,y,yaw_deg; several: separated by ;"),
    ("robot_tf", "namespaced", str, "several robots: namespaced or prefixed transforms"),
    ("rate", "1.0", float, "speed of simulation time; 0.0 = as fast as possible"),
    ("start_paused", "false", bool, "time stands still until the simulation is set to playing"),
    ("reset_time", "rewind", str, "what a reset does to /clock: rewind or monotonic"),
    ("map", "auto", str, "publish the floor's occupancy grid: auto, on or off"),
    ("publish_map_tf", "false", bool, "publish map -> odom from ground truth"),
    ("views", "", str, "cameras on no robot: follow, orbit, top, or a YAML file of them; several: separated by commas"),
    ("view_size", "640x480", str, "width and height of views"),
    ("view_rate", "30.0", float, "images a second of views"),
)


def generate_launch_description():
    share = get_package_share_directory("gibson_sim")
    config = os.path.join(share, "config")
    overrides = {name: ParameterValue(LaunchConfiguration(name), value_type=kind) for name, _, kind, _ in ARGUMENTS}
    physics = Node(
        package="gibson_sim",
        executable="physics_node",
        parameters=[os.path.join(config, "physics.param.yaml"), overrides],
        output="screen",
    )
    render = Node(
        package="gibson_sim",
        executable="render_node",
        parameters=[os.path.join(config, "render.param.yaml")],
        output="screen",
    )
    return LaunchDescription(
        [
            *[DeclareLaunchArgument(name, default_value=default, description=text) for name, default, _, text in ARGUMENTS],
            SetEnvironmentVariable(
                "FASTRTPS_DEFAULT_PROFILES_FILE",
                os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE", os.path.join(config, "fastdds.xml")),
            ),
            physics,
            render,
            # Time ends with the physics node: what is left would wait for a clock that stands still.
            RegisterEventHandler(OnProcessExit(target_action=physics, on_exit=[EmitEvent(event=Shutdown())])),
        ]
    )
