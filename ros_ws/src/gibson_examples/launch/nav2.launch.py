"""Starts Nav2 for a running simulation: ros2 launch gibson_examples nav2.launch.py localisation:=amcl

The simulator publishes the map, so there is no map server. ``localisation``: ``amcl``; ``none`` if the simulator (``--publish-map-tf``) or
slam_toolbox publishes map -> odom.
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import EqualsSubstitution, LaunchConfiguration
from launch_ros.actions import Node

SERVERS = (
    ("nav2_controller", "controller_server"),
    ("nav2_smoother", "smoother_server"),
    ("nav2_planner", "planner_server"),
    ("nav2_behaviors", "behavior_server"),
    ("nav2_bt_navigator", "bt_navigator"),
)


def generate_launch_description():
    share = get_package_share_directory("gibson_examples")
    params = LaunchConfiguration("params_file")

    def server(package, name, **options):
        return Node(package=package, executable=name, name=name, parameters=[params], output="screen", **options)

    def lifecycle_manager(name, nodes, **options):
        settings = {"use_sim_time": True, "autostart": True, "node_names": nodes}
        return Node(
            package="nav2_lifecycle_manager",
            executable="lifecycle_manager",
            name=name,
            parameters=[settings],
            output="screen",
            **options,
        )

    with_amcl = IfCondition(EqualsSubstitution(LaunchConfiguration("localisation"), "amcl"))
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=os.path.join(share, "config", "nav2.yaml"),
                description="parameters of all nodes",
            ),
            DeclareLaunchArgument(
                "localisation", default_value="amcl", choices=["amcl", "none"], description="node that publishes map -> odom"
            ),
            server("nav2_amcl", "amcl", condition=with_amcl),
            lifecycle_manager("lifecycle_manager_localization", ["amcl"], condition=with_amcl),
            *[server(package, name) for package, name in SERVERS],
            lifecycle_manager("lifecycle_manager_navigation", [name for _, name in SERVERS]),
        ]
    )
