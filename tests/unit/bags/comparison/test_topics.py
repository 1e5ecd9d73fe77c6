"""Assignment of topics to roles."""

from __future__ import annotations

import pytest

from gibson_sim.bags.comparison.topics import find_topics, topic_options
from gibson_sim.bags.reader import TopicInfo
from gibson_sim.errors import ConfigError


def infos(**topics: str) -> dict[str, TopicInfo]:
    """Returns topics by name, ``__`` stands for a slash."""
    names = {"/" + name.replace("__", "/"): type_name for name, type_name in topics.items()}
    return {name: TopicInfo(name, type_name, 10, False, True) for name, type_name in names.items()}


ODOMETRY, SCAN = "nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan"


def test_usual_names_are_found() -> None:
    found = find_topics(infos(odom=ODOMETRY, ground_truth__odom=ODOMETRY, cmd_vel="geometry_msgs/msg/TwistStamped"), {}, "bag")
    assert found == {"cmd_vel": "/cmd_vel", "odom": "/odom", "truth": "/ground_truth/odom"}


def test_applied_commands_replace_commands_that_were_not_recorded() -> None:
    stamped = "geometry_msgs/msg/TwistStamped"
    topics = infos(cmd_vel_applied=stamped, arm_servo__delta_twist_cmds=stamped)
    assert find_topics(topics, {}, "bag") == {"cmd_vel": "/cmd_vel_applied"}
    assert find_topics({**topics, **infos(cmd_vel=stamped)}, {}, "bag") == {"cmd_vel": "/cmd_vel"}


def test_names_in_a_namespace_are_found() -> None:
    assert find_topics(infos(robot1__odom=ODOMETRY), {}, "bag") == {"odom": "/robot1/odom"}


def test_the_only_topic_of_a_type_is_used() -> None:
    assert find_topics(infos(front__laser=SCAN), {}, "bag") == {"scan": "/front/laser"}


def test_two_unusual_topics_are_not_guessed() -> None:
    assert find_topics(infos(left=SCAN, right=SCAN), {}, "bag") == {}


def test_an_option_overrides_the_usual_name() -> None:
    assert find_topics(infos(odom=ODOMETRY, ekf=ODOMETRY), {"odom": "/ekf"}, "bag")["odom"] == "/ekf"


def test_a_requested_topic_that_is_missing_lists_the_topics() -> None:
    with pytest.raises(ConfigError, match=r"odom=/ekf: bag has no such topic; it has /odom"):
        find_topics(infos(odom=ODOMETRY), {"odom": "/ekf"}, "bag")


def test_a_requested_topic_of_another_type_is_an_error() -> None:
    with pytest.raises(ConfigError, match=r"it is sensor_msgs/msg/LaserScan, must be nav_msgs/msg/Odometry"):
        find_topics(infos(scan=SCAN), {"odom": "/scan"}, "bag")


def test_options_apply_to_one_bag_or_both() -> None:
    found = topic_options(["odom=/a", "real:imu=b", "sim:imu=/c"])
    assert found == {"real": {"odom": "/a", "imu": "/b"}, "sim": {"odom": "/a", "imu": "/c"}}


@pytest.mark.parametrize("option", ["odom", "odom=", "speed=/a", "left:odom=/a"])
def test_a_wrong_option_names_the_roles(option: str) -> None:
    with pytest.raises(ConfigError, match="roles: cmd_vel, odom"):
        topic_options([option])
