"""launch_testing starts the simulation by its launch file, and ends it after the test: `launch_test launch_testing_drive.py`."""

import os
import time
import unittest

import launch
import launch_testing.actions
import launch_testing.asserts
import pytest
import rclpy
from ament_index_python.packages import get_package_share_directory
from geometry_msgs.msg import Twist
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from nav_msgs.msg import Odometry


@pytest.mark.launch_test
def generate_test_description():
    file = os.path.join(get_package_share_directory("gibson_sim"), "launch", "sim.launch.py")
    arguments = {"scene": "flat", "start": "1.0,4.7,0", "render": "false"}
    simulation = IncludeLaunchDescription(PythonLaunchDescriptionSource(file), launch_arguments=arguments.items())
    return launch.LaunchDescription([simulation, launch_testing.actions.ReadyToTest()])


class TestDrive(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rclpy.init()

    @classmethod
    def tearDownClass(cls):
        rclpy.shutdown()

    def setUp(self):
        self.node = rclpy.create_node("test_drive")

    def tearDown(self):
        self.node.destroy_node()

    def test_robot_drives_ahead(self):
        poses = []
        self.node.create_subscription(Odometry, "ground_truth/odom", lambda msg: poses.append(msg.pose.pose.position), 10)
        publisher = self.node.create_publisher(Twist, "cmd_vel", 1)
        command = Twist()
        command.linear.x = 0.3
        deadline = time.monotonic() + 60.0
        while not (poses and poses[-1].x > 1.5):
            assert time.monotonic() < deadline, f"the robot is at {poses[-1] if poses else 'no pose'}"
            publisher.publish(command)
            rclpy.spin_once(self.node, timeout_sec=0.05)


@launch_testing.post_shutdown_test()
class TestAfterwards(unittest.TestCase):
    def test_all_processes_ended_well(self, proc_info):
        launch_testing.asserts.assertExitCodes(proc_info)
