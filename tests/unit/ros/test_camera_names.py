"""Names of the topics of cameras."""

from __future__ import annotations

from gibson_sim.ros.topics import names


def test_topics_stand_below_the_cameras_name() -> None:
    topics = names.camera_topics("left/camera")
    assert (topics["rgb"], topics["depth_info"]) == ("left/camera/image_raw", "left/camera/depth/camera_info")
    assert names.compressed_topic(topics["rgb"]) == "left/camera/image_raw/compressed"
    assert names.compressed_depth_topic(topics["depth"]) == "left/camera/depth/image_raw/compressedDepth"


def test_topics_that_repeat_another_topic_are_derived_and_images_are_not() -> None:
    rgb, depth = (names.camera_topics("camera")[output] for output in ("rgb", "depth"))
    repeated = [names.compressed_topic(rgb), names.compressed_depth_topic(depth), names.points_topic("camera")]
    assert all(map(names.is_derived, [*repeated, *names.registered_depth_topics("camera")]))
    assert not any(map(names.is_derived, [rgb, depth, *names.camera_topics("camera").values(), "scan", "lidar/points"]))


def test_topics_of_an_action_are_hidden_and_others_are_not() -> None:
    assert names.is_hidden("/simulate_steps/_action/feedback")
    assert not names.is_hidden("/left_robot/odom")
