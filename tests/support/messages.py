"""Messages made field by field: what the quick ones, which are bytes, must be equal to."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry as RosOdometry
from sensor_msgs.msg import JointState

from gibson_sim.robots.drives.odometry_errors import OdometryCovariance
from gibson_sim.ros.conversions import header_to_msg, odometry_pose, planar_covariance, pose_to_msg, vector_to_msg
from gibson_sim.types import WORLD_FRAME, JointStates, Odometry, Pose


def odometry_to_msg(
    odometry: Odometry, stamp_ns: int, parent: str, child: str, covariance: OdometryCovariance | None = None
) -> RosOdometry:
    """Returns wheel odometry: pose in ``parent``, twist in ``child``; covariances are zero unless given."""
    msg = RosOdometry(header=header_to_msg(stamp_ns, parent), child_frame_id=child)
    msg.pose.pose = pose_to_msg(odometry_pose(odometry))
    msg.twist.twist.linear.x = odometry.linear
    msg.twist.twist.linear.y = odometry.lateral
    msg.twist.twist.angular.z = odometry.angular
    if covariance is not None:
        msg.pose.covariance = np.array(planar_covariance(covariance.pose))
        msg.twist.covariance = np.array(planar_covariance(covariance.twist))
    return msg


def ground_truth_to_msg(pose: Pose, linear: Any, angular: Any, stamp_ns: int, child: str) -> RosOdometry:
    """Returns the true pose in the world frame and the true twist in the ``child`` frame; covariances are zero."""
    msg = RosOdometry(header=header_to_msg(stamp_ns, WORLD_FRAME), child_frame_id=child)
    msg.pose.pose = pose_to_msg(pose)
    msg.twist.twist.linear = vector_to_msg(linear)
    msg.twist.twist.angular = vector_to_msg(angular)
    return msg


def joint_states_to_msg(joints: JointStates, stamp_ns: int) -> JointState:
    """Returns joint states; names are those of the URDF."""
    return JointState(
        header=header_to_msg(stamp_ns, ""),
        name=list(joints.names),
        position=array("d", joints.positions.tobytes()),
        velocity=array("d", joints.velocities.tobytes()),
        effort=array("d", joints.efforts.tobytes()),
    )
