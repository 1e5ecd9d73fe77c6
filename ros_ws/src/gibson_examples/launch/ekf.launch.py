"""Starts the filter of robot_localization for a running simulation: ros2 launch gibson_examples ekf.launch.py

It fuses ``odom`` and ``imu`` into ``odometry/filtered``; the simulator itself publishes odom -> base_footprint.
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    share = get_package_share_directory("gibson_examples")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=os.path.join(share, "config", "robot_localization.yaml"),
                description="parameters of the filter",
            ),
            Node(
                package="robot_localization",
                executable="ekf_node",
                name="ekf_filter_node",
                parameters=[LaunchConfiguration("params_file")],
                output="screen",
            ),
        ]
    )
