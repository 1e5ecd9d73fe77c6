"""Converts stamps, vectors, poses and transforms."""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose as RosPose, TransformStamped, Vector3
from std_msgs.msg import Header

from gibson_sim.types import NS_PER_S, Pose, Vec3


def time_to_msg(stamp_ns: int) -> Time:
    """Returns a time in ns as a message."""
    return Time(sec=stamp_ns // NS_PER_S, nanosec=stamp_ns % NS_PER_S)


def header_to_msg(stamp_ns: int, frame_id: str) -> Header:
    """Returns a header with the stamp and the frame of the data."""
    return Header(stamp=time_to_msg(stamp_ns), frame_id=frame_id)


def vector_to_msg(v: Any) -> Vector3:
    """Returns a vector of three numbers as a message."""
    return Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def vector_from_msg(msg: Vector3) -> Vec3:
    """Returns the components of a message."""
    return (msg.x, msg.y, msg.z)


def pose_to_msg(pose: Pose) -> RosPose:
    """Returns the pose as a message."""
    msg = RosPose()
    msg.position.x, msg.position.y, msg.position.z = pose.position
    msg.orientation.x, msg.orientation.y, msg.orientation.z, msg.orientation.w = pose.quat_xyzw
    return msg


def pose_from_msg(msg: RosPose) -> Pose:
    """Returns the pose in a message, whose quaternion must have norm 1."""
    p, q = msg.position, msg.orientation
    return Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def transform_to_msg(stamp_ns: int, parent: str, child: str, pose: Pose) -> TransformStamped:
    """Returns T_parent_child for tf."""
    msg = TransformStamped(header=header_to_msg(stamp_ns, parent), child_frame_id=child)
    t, r = msg.transform.translation, msg.transform.rotation
    t.x, t.y, t.z = pose.position
    r.x, r.y, r.z, r.w = pose.quat_xyzw
    return msg
