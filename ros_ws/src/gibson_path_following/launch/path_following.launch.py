"""Follows a recorded path: ros2 launch gibson_path_following path_following.launch.py path:=/data/kitchen

On a robot: sim_time:=false. With evaluator:=true the drive is judged by ground truth, in simulation.
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, NotEqualsSubstitution
from launch_ros.actions import Node, SetRemap
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description():
    share = get_package_share_directory("gibson_path_following")
    path, params, namespace = (LaunchConfiguration(name) for name in ("path", "params_file", "namespace"))
    sim_time = ParameterValue(LaunchConfiguration("sim_time"), value_type=bool)

    def node(name, settings, **options):
        return Node(
            package="gibson_path_following",
            executable=name,
            name=name,
            namespace=namespace,
            parameters=[params, {"use_sim_time": sim_time, "path": path, **settings}],
            output="screen",
            **options,
        )

    backend = ParameterValue(LaunchConfiguration("backend"), value_type=str)
    autostart = ParameterValue(LaunchConfiguration("autostart"), value_type=bool)
    mode = LaunchConfiguration("goggles")
    with_goggles = IfCondition(NotEqualsSubstitution(mode, "none"))
    goggles = Node(
        package="gibson_path_following",
        executable="goggles",
        name="goggles",
        namespace=namespace,
        parameters=[params, {"use_sim_time": sim_time, "mode": ParameterValue(mode, value_type=str)}],
        output="screen",
        condition=with_goggles,
    )
    results = ParameterValue(LaunchConfiguration("results"), value_type=str)
    return LaunchDescription(
        [
            DeclareLaunchArgument("path", description="folder of the path, as path_recorder wrote it"),
            DeclareLaunchArgument(
                "backend", default_value="learned", description="policy: learned, learned:FILE, teach_repeat, onnx:FILE"
            ),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of the robot"),
            DeclareLaunchArgument("sim_time", default_value="true", description="time of /clock; false on a robot"),
            DeclareLaunchArgument(
                "autostart", default_value="true", description="drive at once; false = wait for a lifecycle manager"
            ),
            DeclareLaunchArgument(
                "goggles",
                default_value="none",
                description="images in the simulator's look: learned, histogram, grey_world; or none",
            ),
            DeclareLaunchArgument("evaluator", default_value="false", description="judge the drive by ground_truth/odom"),
            DeclareLaunchArgument("results", default_value="path_following.json", description="file of the evaluator"),
            DeclareLaunchArgument(
                "params_file",
                default_value=os.path.join(share, "config", "path_following.yaml"),
                description="parameters of all nodes",
            ),
            goggles,
            # The nodes below get the images of Goggles.
            *(SetRemap(f"camera/{name}", f"goggles/{name}", condition=with_goggles) for name in ("image_raw", "camera_info")),
            node("path_policy", {"backend": backend, "autostart": autostart}),
            node("path_evaluator", {"file": results}, condition=IfCondition(LaunchConfiguration("evaluator"))),
        ]
    )
