"""Conversions between ROS messages and the types of this package."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped, Twist, TwistStamped
from nav_msgs.msg import Path

from gibson_examples.errors import MapError, SettingError
from gibson_examples.geometry import F64, Pose2D, matrix_from, planar
from gibson_examples.grid import Grid
from gibson_examples.pure_pursuit import Velocity
from gibson_examples.transforms import NS_PER_S


def stamp_ns(stamp: Any) -> int:
    """Returns a stamp as nanoseconds."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def time_msg(ns: int) -> Any:
    """Returns nanoseconds as a stamp."""
    return Time(sec=ns // NS_PER_S, nanosec=ns % NS_PER_S)


def translation_and_quat(transform: Any) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """Returns the translation, metres, and the quaternion (x, y, z, w) of a Transform."""
    t, r = transform.translation, transform.rotation
    return (t.x, t.y, t.z), (r.x, r.y, r.z, r.w)


def pose_from(pose: Any) -> Pose2D:
    """Returns the planar part of a Pose.

    Raises:
        SettingError: a value is not finite, or the quaternion is 0.
    """
    p, q = pose.position, pose.orientation
    if not all(map(math.isfinite, (p.x, p.y, q.x, q.y, q.z, q.w))):
        raise SettingError(f"pose {p.x},{p.y} holds a NaN or an infinity; it is ignored")
    length = math.hypot(q.x, q.y, q.z, q.w)
    if length < 1e-6:
        raise SettingError("the quaternion of a pose is 0,0,0,0; it is ignored, send w = 1 for no rotation")
    return planar(matrix_from((p.x, p.y, p.z), np.array([q.x, q.y, q.z, q.w]) / length))


def grid_from(msg: Any) -> Grid:
    """Returns the map in an OccupancyGrid.

    Raises:
        MapError: the map is empty, or its axes are not those of the map frame.
    """
    info = msg.info
    yaw = pose_from(info.origin).yaw
    if abs(yaw) > 1e-3:
        raise MapError(
            f"map: its origin is turned by {math.degrees(yaw):.1f} degrees, must be 0; publish it along the axes of its frame"
        )
    cells = np.asarray(msg.data, dtype=np.int8)
    if len(cells) != info.width * info.height:
        raise MapError(f"map: {len(cells)} cells, but it says {info.width} x {info.height}")
    return Grid(float(info.resolution), (info.origin.position.x, info.origin.position.y), cells.reshape(info.height, info.width))


def twist_msg(velocity: Velocity, ns: int, frame: str, *, stamped: bool) -> Any:
    """Returns a Twist, or a TwistStamped in ``frame``."""
    twist = Twist()
    twist.linear.x, twist.angular.z = float(velocity.linear), float(velocity.angular)
    if not stamped:
        return twist
    msg = TwistStamped(twist=twist)
    msg.header.stamp, msg.header.frame_id = time_msg(ns), frame
    return msg


def path_msg(path: F64, ns: int, frame: str) -> Any:
    """Returns a Path of every fourth of the points (N, 2), and the last, each facing along the path."""
    msg = Path()
    msg.header.stamp, msg.header.frame_id = time_msg(ns), frame
    kept = [*range(0, len(path) - 1, 4), len(path) - 1] if len(path) else []
    for i in kept:
        pose = PoseStamped(header=msg.header)
        along = path[min(i + 1, len(path) - 1)] - path[max(i - 1, 0)]
        _fill(pose.pose, Pose2D(float(path[i, 0]), float(path[i, 1]), math.atan2(along[1], along[0])))
        msg.poses.append(pose)
    return msg


def pose_with_covariance_msg(pose: Pose2D, covariance: F64, ns: int, frame: str) -> Any:
    """Returns a PoseWithCovarianceStamped; covariance (3, 3) of x, y, yaw."""
    msg = PoseWithCovarianceStamped()
    msg.header.stamp, msg.header.frame_id = time_msg(ns), frame
    _fill(msg.pose.pose, pose)
    six = np.zeros((6, 6))
    six[np.ix_([0, 1, 5], [0, 1, 5])] = covariance
    msg.pose.covariance = six.ravel()
    return msg


def goal_msg(pose: Pose2D, ns: int, frame: str) -> Any:
    """Returns a PoseStamped."""
    msg = PoseStamped()
    msg.header.stamp, msg.header.frame_id = time_msg(ns), frame
    _fill(msg.pose, pose)
    return msg


def transform_msg(pose: Pose2D, ns: int, parent: str, child: str) -> Any:
    """Returns T_parent_child as a TransformStamped."""
    msg = TransformStamped(child_frame_id=child)
    msg.header.stamp, msg.header.frame_id = time_msg(ns), parent
    msg.transform.translation.x, msg.transform.translation.y = pose.x, pose.y
    msg.transform.rotation.z, msg.transform.rotation.w = math.sin(pose.yaw / 2), math.cos(pose.yaw / 2)
    return msg


def _fill(msg: Any, pose: Pose2D) -> None:
    msg.position.x, msg.position.y = pose.x, pose.y
    msg.orientation.z, msg.orientation.w = math.sin(pose.yaw / 2), math.cos(pose.yaw / 2)
