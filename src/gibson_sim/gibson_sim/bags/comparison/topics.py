"""Assigns roles to the topics of a bag: by the user's choice, else by usual names, else the only topic of the type."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gibson_sim.bags.reader import TopicInfo
from gibson_sim.config import absolute_name
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted

ODOMETRY, TWIST, TWIST_STAMPED = "nav_msgs/msg/Odometry", "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
POSE, POSE_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
TF, IMU, SCAN, MAP = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/Imu", "sensor_msgs/msg/LaserScan", "nav_msgs/msg/OccupancyGrid"
IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


@dataclass(frozen=True, slots=True)
class Role:
    """Use of a topic in the comparison."""

    name: str
    types: tuple[str, ...]
    usual: tuple[str, ...]
    """Usual topic names in order of preference; a namespace may precede them."""
    any_of_type: bool = True
    """Whether the only topic of these types is used, whatever its name."""
    lacks: str = ""
    """Comparisons that are omitted without the topic."""


ROLES: tuple[Role, ...] = (
    Role(
        "cmd_vel", (TWIST, TWIST_STAMPED),
        ("/cmd_vel", "/cmd_vel_applied", "/cmd_vel_out", "/cmd_vel_smoothed", "/cmd_vel_nav"),
        lacks="the response to commands",
    ),
    Role(
        "odom",
        (ODOMETRY,),
        ("/odom", "/wheel/odometry", "/wheel_odom", "/diff_drive_controller/odom", "/odometry/wheel", "/odometry/filtered"),
        lacks="the response to commands, and the drift of odometry",
    ),
    Role(
        "truth", (ODOMETRY, POSE, POSE_COVARIANCE), ("/ground_truth/odom", "/ground_truth/pose", "/amcl_pose", "/pose"), False,
        lacks="wheel slip and the drift of odometry; what is at matched poses uses odometry",
    ),
    Role("imu", (IMU,), ("/imu/data_raw", "/imu/raw", "/imu", "/imu/data"), lacks="the noise of the IMU"),
    Role("scan", (SCAN,), ("/scan", "/base_scan", "/laser_scan"), lacks="the lidar"),
    Role("map", (MAP,), ("/map",), lacks="the lidar against a map"),
    Role(
        "image", (IMAGE, COMPRESSED_IMAGE),
        ("/camera/image_raw", "/camera/color/image_raw", "/camera/rgb/image_raw", "/color/image_raw", "/image_raw",
         "/camera/image_raw/compressed", "/camera/color/image_raw/compressed", "/color/image_raw/compressed", "/image_raw/compressed"),
        False, lacks="images",
    ),
)  # fmt: skip
"""All roles; ``tf`` and ``tf_static`` are read by their names."""
SIDES = ("real", "sim")


def topic_options(options: Sequence[str]) -> dict[str, dict[str, str]]:
    """Returns side -> role -> topic for options ``odom=/robot/odom`` (both bags) and ``real:odom=/robot/odom`` (one).

    Raises:
        ConfigError: an option is malformed or names an unknown role.
    """
    chosen: dict[str, dict[str, str]] = {side: {} for side in SIDES}
    known = [role.name for role in ROLES]
    for option in options:
        left, equals, topic = option.partition("=")
        side, colon, role = left.rpartition(":")
        if not equals or not topic or role not in known or (colon and side not in SIDES):
            raise ConfigError(
                f"--topic {quoted(option)}: must be ROLE=/topic or real:ROLE=/topic or sim:ROLE=/topic; roles: {', '.join(known)}"
            )
        for one in (side,) if colon else SIDES:
            chosen[one][role] = absolute_name(topic)
    return chosen


def find_topics(infos: Mapping[str, TopicInfo], given: Mapping[str, str], where: str) -> dict[str, str]:
    """Returns role -> topic for the topics of the bag that have messages.

    Args:
        infos: The topics of the bag.
        given: Role -> topic chosen by the user.
        where: Name of the bag in errors.

    Raises:
        ConfigError: a chosen topic does not exist or has another type.
    """
    topic_of_role: dict[str, str] = {}
    for role in ROLES:
        topic = given.get(role.name)
        if topic is None:
            topic = _usual(role, infos, set(topic_of_role.values()))
        else:
            _check(role, topic, infos, where)
        if topic is not None:
            topic_of_role[role.name] = topic
    return topic_of_role


def _check(role: Role, topic: str, infos: Mapping[str, TopicInfo], where: str) -> None:
    if topic not in infos:
        raise ConfigError(f"--topic {role.name}={topic}: {where} has no such topic; it has {', '.join(infos) or 'none'}")
    if infos[topic].type_name not in role.types:
        raise ConfigError(f"--topic {role.name}={topic}: it is {infos[topic].type_name}, must be {' or '.join(role.types)}")


def _usual(role: Role, infos: Mapping[str, TopicInfo], taken: set[str]) -> str | None:
    fit = [name for name, info in infos.items() if info.type_name in role.types and info.count and name not in taken]
    for usual in role.usual:
        if usual in fit:
            return usual
    for usual in role.usual:
        ending = [name for name in fit if name.endswith(usual)]
        if len(ending) == 1:
            return ending[0]
    return fit[0] if role.any_of_type and len(fit) == 1 else None
