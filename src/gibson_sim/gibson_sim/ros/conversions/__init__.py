"""Converts values to messages and back; other packages do not access the fields of messages.

``x_to_msg`` creates a message, ``x_from_msg`` reads one. Stamps are copied from the data that a message describes, never read from a clock.
Large arrays are copied once, as bytes: assigning a list or an ndarray to a message field takes tens of milliseconds.
"""

from gibson_sim.bags.stamps import time_from_msg
from gibson_sim.ros.conversions.basics import (
    header_to_msg,
    pose_from_msg,
    pose_to_msg,
    time_to_msg,
    transform_to_msg,
    vector_from_msg,
    vector_to_msg,
)
from gibson_sim.ros.conversions.images import (
    ENCODINGS,
    array_from_image,
    camera_info_to_msg,
    compressed_to_msg,
    frame_to_image_msgs,
    image_to_msg,
    label_info_to_msg,
    label_info_type,
)
from gibson_sim.ros.conversions.robot import (
    collision_count_to_msg,
    contacts_to_msg,
    grasp_state_to_msg,
    joint_command_from_msg,
    joint_values,
    odometry_pose,
    planar_covariance,
    planar_from_odometry,
    scan_to_msg,
    tool_twist_from_msg,
    velocity_from_msg,
)
from gibson_sim.ros.conversions.scene import (
    floor_map_to_msg,
    scene_from_msg,
    scene_state_from_msg,
    scene_state_to_msg,
    scene_to_msg,
)
from gibson_sim.ros.conversions.sensors import battery_to_msg, bumper_to_msgs, cloud_to_msg, imu_to_msg, lidar_cloud_to_msg

__all__ = [
    "ENCODINGS",
    "array_from_image",
    "battery_to_msg",
    "bumper_to_msgs",
    "camera_info_to_msg",
    "cloud_to_msg",
    "collision_count_to_msg",
    "compressed_to_msg",
    "contacts_to_msg",
    "floor_map_to_msg",
    "frame_to_image_msgs",
    "grasp_state_to_msg",
    "header_to_msg",
    "image_to_msg",
    "imu_to_msg",
    "joint_command_from_msg",
    "joint_values",
    "label_info_to_msg",
    "label_info_type",
    "lidar_cloud_to_msg",
    "odometry_pose",
    "planar_covariance",
    "planar_from_odometry",
    "pose_from_msg",
    "pose_to_msg",
    "scan_to_msg",
    "scene_from_msg",
    "scene_state_from_msg",
    "scene_state_to_msg",
    "scene_to_msg",
    "time_from_msg",
    "time_to_msg",
    "tool_twist_from_msg",
    "transform_to_msg",
    "vector_from_msg",
    "vector_to_msg",
    "velocity_from_msg",
]
