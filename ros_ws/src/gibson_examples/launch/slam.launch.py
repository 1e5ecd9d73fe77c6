"""Starts slam_toolbox for a running simulation: ros2 launch gibson_examples slam.launch.py nav2:=true

slam_toolbox publishes map and map -> odom; the simulator withdraws its own map (map:=auto). With ``nav2:=true`` Nav2 drives on the map that grows.
"""

import os

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration


def generate_launch_description():
    share = get_package_share_directory("gibson_examples")
    try:
        slam_toolbox = get_package_share_directory("slam_toolbox")
    except PackageNotFoundError:
        raise RuntimeError("slam_toolbox is not installed: `sudo apt install ros-jazzy-slam-toolbox`") from None

    def include(folder, name, **options):
        return IncludeLaunchDescription(PythonLaunchDescriptionSource(os.path.join(folder, "launch", name)), **options)

    return LaunchDescription(
        [
            # Not "params_file": an included launch file takes an argument of that name, given or not, from here.
            DeclareLaunchArgument(
                "slam_params_file",
                default_value=os.path.join(share, "config", "slam_toolbox.yaml"),
                description="parameters of slam_toolbox",
            ),
            DeclareLaunchArgument("nav2", default_value="false", choices=["true", "false"], description="start Nav2, too"),
            # slam_toolbox is a lifecycle node: its own launch file configures and activates it.
            include(
                slam_toolbox,
                "online_async_launch.py",
                launch_arguments={"use_sim_time": "true", "slam_params_file": LaunchConfiguration("slam_params_file")}.items(),
            ),
            include(
                share,
                "nav2.launch.py",
                launch_arguments={"localisation": "none"}.items(),
                condition=IfCondition(LaunchConfiguration("nav2")),
            ),
        ]
    )
