"""Converts commands of a robot and its arms, odometry, planar scans, grasp states, contacts and collision counts."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Twist, TwistStamped
from nav_msgs.msg import Odometry as RosOdometry
from sensor_msgs.msg import JointState, LaserScan
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMsg

from gibson_msgs.msg import CollisionCount as RosCollisionCount, Contact as RosContact, Contacts, GraspState as RosGraspState
from gibson_sim.bags.stamps import time_from_msg
from gibson_sim.geometry.transforms import quat_from_rpy
from gibson_sim.robots.collision_count import CollisionCount
from gibson_sim.robots.joints.commands import JointCommand, JointPositions, JointTrajectory, JointVelocities, TrajectoryPoint
from gibson_sim.robots.joints.grasping import GraspState
from gibson_sim.robots.joints.servo import ToolTwist
from gibson_sim.ros.conversions.basics import header_to_msg, vector_from_msg, vector_to_msg
from gibson_sim.sensors.lidar import Scan
from gibson_sim.types import NS_PER_S, WORLD_FRAME, Contact, Odometry, Pose, VelocityCommand

_UNKNOWN = 1e6
"""Variance of quantities that are not measured: m^2, rad^2, (m/s)^2, (rad/s)^2."""


def velocity_from_msg(msg: Twist, stamp_ns: int) -> VelocityCommand:
    """Returns the velocity command in a Twist that arrived at ``stamp_ns``.

    Raises:
        CommandError: a number is NaN or infinite.
    """
    return VelocityCommand(vector_from_msg(msg.linear), vector_from_msg(msg.angular), stamp_ns)


def odometry_pose(odometry: Odometry) -> Pose:
    """Returns T_odom_base of planar odometry."""
    return Pose((odometry.x, odometry.y, 0.0), quat_from_rpy(0.0, 0.0, odometry.yaw))


def scan_to_msg(scan: Scan, frame_id: str, scan_time: float) -> LaserScan:
    """Returns a scan whose rays were all cast at its stamp (``time_increment`` 0); ``scan_time`` is the period, s."""
    msg = LaserScan(header=header_to_msg(scan.stamp_ns, frame_id))
    msg.angle_min = scan.angle_min
    msg.angle_increment = scan.angle_increment
    msg.angle_max = scan.angle_max
    msg.time_increment = 0.0
    msg.scan_time = scan_time
    msg.range_min = scan.range_min
    msg.range_max = scan.range_max
    msg.ranges = array("f", scan.ranges.astype(np.float32).tobytes())
    return msg


def planar_from_odometry(msg: RosOdometry) -> tuple[float, float, float, int]:
    """Returns x, y (m), yaw (rad) and the stamp (ns) of an odometry message."""
    q = msg.pose.pose.orientation
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
    return msg.pose.pose.position.x, msg.pose.pose.position.y, yaw, time_from_msg(msg.header.stamp)


def planar_covariance(matrix: Sequence[float]) -> tuple[float, ...]:
    """Returns the (6, 6) covariance of a message from the (3, 3) covariance of (x, y, yaw), both row-major.

    A planar base measures no z, roll and pitch: their variances are large, so that a filter neither trusts them nor divides by zero.
    """
    xx, xy, xt, yx, yy, yt, tx, ty, tt = matrix
    o, u = 0.0, _UNKNOWN
    return (
        xx, xy, o, o, o, xt,
        yx, yy, o, o, o, yt,
        o, o, u, o, o, o,
        o, o, o, u, o, o,
        o, o, o, o, u, o,
        tx, ty, o, o, o, tt,
    )  # fmt: skip


def joint_command_from_msg(msg: JointTrajectoryMsg | JointState) -> JointCommand:
    """Returns the joint command in a JointTrajectory or a JointState.

    A JointState with positions sets the position targets of its joints; its efforts, if any, are the effort limits of their motors (0 = the
    limit of the joint). A JointState with velocities alone sets velocity targets.

    Raises:
        CommandError: the command is invalid.
    """
    if isinstance(msg, JointState):
        names = tuple(msg.name)
        if not msg.position and msg.velocity:
            return JointVelocities(tuple(msg.velocity), names)
        return JointPositions(tuple(msg.position), names, tuple(msg.effort))
    points = tuple(
        TrajectoryPoint(
            point.time_from_start.sec * NS_PER_S + point.time_from_start.nanosec,
            tuple(point.positions),
            tuple(point.velocities),
            tuple(point.accelerations),
        )
        for point in msg.points
    )
    return JointTrajectory(tuple(msg.joint_names), points, time_from_msg(msg.header.stamp))


def joint_values(msg: Any) -> Iterator[tuple[str, dict[str, float]]]:
    """Yields name, ``<body>/<joint>``, and interface -> value of each joint of a control_msgs/DynamicJointState."""
    for name, row in zip(msg.joint_names, msg.interface_values, strict=False):
        yield str(name), dict(zip(row.interface_names, row.values, strict=False))


def tool_twist_from_msg(msg: TwistStamped, frame_prefix: str = "") -> ToolTwist:
    """Returns the commanded velocity of a tool.

    Args:
        msg: message whose frame is a link of the robot; empty = the base.
        frame_prefix: prefix of the robot's frame names.

    Raises:
        CommandError: a number is NaN or infinite.
    """
    frame = msg.header.frame_id.removeprefix(frame_prefix)
    return ToolTwist(vector_from_msg(msg.twist.linear), vector_from_msg(msg.twist.angular), frame)


def grasp_state_to_msg(state: GraspState, stamp_ns: int) -> RosGraspState:
    """Returns the grasp state of a gripper as a message."""
    msg = RosGraspState(header=header_to_msg(stamp_ns, ""), arm=state.arm, mode=state.mode, holding=state.holding)
    msg.body, msg.link, msg.reason = state.body, state.link, state.reason
    msg.force, msg.torque = state.force, state.torque
    return msg


def contacts_to_msg(contacts: Iterable[Contact], stamp_ns: int) -> Contacts:
    """Returns contact points as a message."""
    return Contacts(header=header_to_msg(stamp_ns, WORLD_FRAME), contacts=[_contact_to_msg(contact) for contact in contacts])


def _contact_to_msg(contact: Contact) -> RosContact:
    x, y, z = contact.position
    return RosContact(
        body_a=contact.body_a,
        link_a=contact.link_a,
        body_b=contact.body_b,
        link_b=contact.link_b,
        position=Point(x=x, y=y, z=z),
        normal=vector_to_msg(contact.normal),
        force=contact.force,
        distance=contact.distance,
    )


def collision_count_to_msg(count: CollisionCount, stamp_ns: int) -> RosCollisionCount:
    """Returns the collision count of a robot as a message."""
    msg = RosCollisionCount(header=header_to_msg(stamp_ns, ""), count=count.count, ongoing=count.ongoing)
    msg.duration, msg.greatest_force = count.duration, count.greatest_force
    msg.last_link, msg.last_body = count.last_link, count.last_body
    return msg
