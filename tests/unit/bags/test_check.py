from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gibson_sim.bags.check import check_bag
from gibson_sim.bags.writer import BagWriter, TopicQos
from gibson_sim.errors import RecordError

NS = 1_000_000_000
TICK = 100_000_000
ODOMETRY = "nav_msgs/msg/Odometry"


@pytest.fixture
def write_odometry(messages: Any, tmp_path: Path) -> Callable[..., Path]:
    """Returns a function that writes wheel odometry and ground truth, each a list of (tick, x, y, yaw)."""

    def write(wheels: list[tuple[int, float, float, float]], truth: list[tuple[int, float, float, float]]) -> Path:
        with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
            for topic, poses in (("/odom", wheels), ("/ground_truth/odom", truth)):
                bag.add_topic(topic, ODOMETRY)
                for tick, x, y, yaw in poses:
                    bag.write(topic, messages.odometry(tick * TICK, x, y, yaw), 0, 0)
        return tmp_path / "bag"

    return write


def test_whole_drive_has_no_problems(write_drive: Callable[..., Path]) -> None:
    report = check_bag(write_drive())
    assert (report.ok, report.problems, report.notes) == (True, (), ())


def test_rate_comes_from_the_stamps(write_drive: Callable[..., Path]) -> None:
    topics = {t.info.name: t for t in check_bag(write_drive()).topics}
    image = topics["/camera/image_raw"]
    assert image.rate_hz == pytest.approx(10.0)
    assert (image.first_ns, image.last_ns, image.missing) == (NS, 2 * NS, 0)


def test_images_between_ticks_are_a_problem(write_drive: Callable[..., Path]) -> None:
    report = check_bag(write_drive(image_shift_ns=1))
    assert not report.ok
    # The last of the 11 is later than the last odometry message.
    assert "/camera/image_raw: 10 of 11 stamps are not in /odom, first 1.000000001 s" in report.problems


def test_image_whose_odometry_was_not_recorded_is_no_problem(messages: Any, tmp_path: Path) -> None:
    # As rosbag2 records on a busy machine: images at each second message of odometry, of which two are lost.
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/camera/image_raw", "sensor_msgs/msg/Image")
        bag.add_topic("/odom", "nav_msgs/msg/Odometry")
        for i in range(40):
            if i % 2 == 0:
                bag.write("/camera/image_raw", messages.image(i * TICK, np.zeros((2, 2, 3), np.uint8), "rgb8"), i, i)
            if i not in (20, 21):
                bag.write("/odom", messages.odometry(i * TICK, 0.01 * i, 0.0), i, i)
    report = check_bag(tmp_path / "bag")
    assert report.ok
    assert "/camera/image_raw: 1 of 20 stamps cannot be compared, since messages of /odom are missing there" in report.notes


def test_image_without_its_camera_info_is_a_problem(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/camera/image_raw", "sensor_msgs/msg/Image")
        bag.add_topic("/camera/camera_info", "sensor_msgs/msg/CameraInfo")
        for i in range(4):
            bag.write("/camera/image_raw", messages.image(i * TICK, np.zeros((2, 2, 3), np.uint8), "rgb8"), i, i)
            if i != 2:
                bag.write("/camera/camera_info", messages.camera_info(i * TICK), i, i)
    assert check_bag(tmp_path / "bag").problems == (
        "/camera/image_raw: 1 of 4 stamps are not in /camera/camera_info, first 0.200000000 s",
    )


def test_image_type_that_the_bag_defines_without_a_header_is_a_problem(messages: Any, tmp_path: Path) -> None:
    definitions = {"sensor_msgs/msg/Image": "uint32 height\nuint32 width\n"}
    with BagWriter(tmp_path / "bag", reserve_bytes=0, message_definitions=definitions) as bag:
        bag.add_topic("/camera/image_raw", "sensor_msgs/msg/Image")
        bag.add_topic("/camera/camera_info", "sensor_msgs/msg/CameraInfo")
        bag.write("/camera/image_raw", messages.image(TICK, np.zeros((2, 2, 3), np.uint8), "rgb8"), 1, 1)
        bag.write("/camera/camera_info", messages.camera_info(TICK), 1, 1)
    problem = "/camera/image_raw: the bag defines sensor_msgs/msg/Image without a header, so that its images have no stamps"
    assert problem in check_bag(tmp_path / "bag").problems


def test_missing_images_are_counted_and_noted(write_drive: Callable[..., Path]) -> None:
    report = check_bag(write_drive(skip_images=(3, 4, 7)))
    assert report.ok
    (note,) = report.notes
    assert note.startswith(
        "3 of 11 messages are missing on /camera/depth/image_raw, /camera/image_raw, at the rate of the received ones: the renderer skips"
    )


def test_images_are_missing_by_the_recorded_rate_of_their_camera(write_drive: Callable[..., Path]) -> None:
    three_of_four = [frame for frame in range(41) if frame % 4]
    report = check_bag(write_drive("known", frames=41, skip_images=three_of_four, camera_rate_hz=10.0))
    (note,) = report.notes
    assert note.startswith(
        "30 of 41 messages are missing on /camera/depth/image_raw, /camera/image_raw, at 10 Hz: the renderer skips"
    )
    rates = {topic.info.name: (topic.rate_hz, topic.missing) for topic in report.topics}
    assert rates["/camera/image_raw"] == rates["/camera/depth/camera_info"] == (pytest.approx(10.0), 30)
    # Without the rate, those that arrived look complete; a camera that is faster than the recorded states is drawn at each of these.
    unknown = check_bag(write_drive("unknown", frames=41, skip_images=three_of_four))
    faster = check_bag(write_drive("faster", frames=41, skip_images=three_of_four, camera_rate_hz=30.0))
    assert unknown.notes == faster.notes == ()


def test_a_bag_that_defines_cameras_without_a_rate_is_checked(messages: Any, tmp_path: Path) -> None:
    definitions = {"gibson_msgs/msg/Scene": "std_msgs/Header header\nstring[] cameras\n"}
    with BagWriter(tmp_path / "bag", reserve_bytes=0, message_definitions=definitions) as bag:
        bag.add_topic("/scene", "gibson_msgs/msg/Scene", TopicQos.latched())
        bag.add_topic("/scene_state", "gibson_msgs/msg/SceneState")
        header = messages.cdr(messages.header(0))
        bag.write("/scene", header + bytes(-len(header) % 4) + b"\1\0\0\0" + b"\2\0\0\0a\0", 0, 0)
        for i in range(3):
            bag.write("/scene_state", messages.scene_state(i * TICK, i), i * TICK, i * TICK)
    assert check_bag(tmp_path / "bag").ok


def test_stamps_on_ticks_that_no_rate_divides_are_complete(write_drive: Callable[..., Path]) -> None:
    """8 Hz at 10 ticks a second: images at all ticks but two of ten, 0.1 s or 0.2 s apart."""
    due = [tick for tick in range(11) if (tick + 10) * 8 // 10 > (tick + 9) * 8 // 10]
    report = check_bag(write_drive(skip_images=set(range(11)) - set(due), camera_rate_hz=8.0))
    assert {topic.info.name: topic.missing for topic in report.topics}["/camera/image_raw"] == 0


def test_stamp_that_does_not_rise_is_a_problem(write_odometry: Callable[..., Path]) -> None:
    report = check_bag(write_odometry([(1, 0, 0, 0), (2, 0, 0, 0), (2, 0, 0, 0), (3, 0, 0, 0)], []))
    assert report.problems == ("/odom: 1 stamps do not rise, first 0.200000000 s is followed by 0.200000000 s",)


def test_transforms_of_two_publishers_on_one_topic_are_no_problem(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/tf", "tf2_msgs/msg/TFMessage")
        for i in range(3):
            bag.write("/tf", messages.transform((i + 5) * TICK, "odom"), i, i)  # dated ahead, as AMCL does
            bag.write("/tf", messages.transform(i * TICK, "base_footprint"), i, i)
    assert check_bag(tmp_path / "bag").ok


def test_transform_that_repeats_its_stamp_is_a_problem(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/tf", "tf2_msgs/msg/TFMessage")
        for i in (1, 2, 2):
            bag.write("/tf", messages.transform(i * TICK, "base_footprint"), i, i)
    (problem,) = check_bag(tmp_path / "bag").problems
    assert problem.startswith("/tf to base_footprint: 1 stamps")


def test_latched_topic_may_repeat_its_stamp(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/odom", ODOMETRY, TopicQos.latched())
        for i in range(2):
            bag.write("/odom", messages.odometry(0, 0.0, 0.0), i, i)
    assert check_bag(tmp_path / "bag").ok


def test_images_before_the_first_odometry_are_a_note(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/camera/image_raw", "sensor_msgs/msg/Image")
        bag.add_topic("/odom", ODOMETRY)
        for i in range(4):
            if i:
                bag.write("/odom", messages.odometry(i * TICK, 0.0, 0.0), i, i)
            bag.write("/camera/image_raw", messages.image(i * TICK, np.zeros((2, 2, 3), np.uint8), "rgb8"), i, i)
    report = check_bag(tmp_path / "bag")
    assert report.ok
    assert "/camera/image_raw: 1 image lies before the first or after the last message of /odom" in report.notes


def test_a_recording_that_ended_before_its_topics_met_is_a_note(messages: Any, tmp_path: Path) -> None:
    """The page subscribes to one topic after the other: a recording of a moment has images of before the first odometry alone."""
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/camera/image_raw", "sensor_msgs/msg/Image")
        bag.add_topic("/odom", ODOMETRY)
        for i in range(4):
            bag.write("/camera/image_raw", messages.image(i * TICK, np.zeros((2, 2, 3), np.uint8), "rgb8"), i * TICK, i * TICK)
        bag.write("/odom", messages.odometry(4 * TICK, 0.0, 0.0), 4 * TICK, 4 * TICK)
    report = check_bag(tmp_path / "bag")
    assert report.ok
    assert (
        "/camera/image_raw: all of its 4 images lie before the first or after the last message of /odom, so that their stamps cannot be "
        "compared" in report.notes
    )
    assert report.findings()[-1] == "stamps agree: none goes back in time", "nothing is said of images that were not compared"


def test_images_of_another_clock_are_a_problem(messages: Any, tmp_path: Path) -> None:
    wall_ns = 1_795_580_456 * NS
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/camera/image_raw", "sensor_msgs/msg/Image")
        bag.add_topic("/odom", ODOMETRY)
        for i in range(3):
            image = messages.image(wall_ns + i * TICK, np.zeros((2, 2, 3), np.uint8), "rgb8")
            bag.write("/camera/image_raw", image, i * TICK, i * TICK)
            bag.write("/odom", messages.odometry(i * TICK, 0.0, 0.0), i * TICK, i * TICK)
    (problem,) = check_bag(tmp_path / "bag").problems
    assert problem.startswith(
        "/camera/image_raw: its stamps (1795580456.000 s to 1795580456.200 s) and those of /odom (0.000 s to 0.200 s)"
    )
    assert "use_sim_time" in problem


def test_camera_info_without_its_images_misses_nothing(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/camera/camera_info", "sensor_msgs/msg/CameraInfo")
        for i in (*range(10), *range(20, 30)):
            bag.write("/camera/camera_info", messages.camera_info(i * TICK), i * TICK, i * TICK)
    report = check_bag(tmp_path / "bag")
    assert (report.ok, report.notes, report.topics[0].missing) == (True, (), None)
    assert "nor for camera_info without its images" in report.text()


def test_the_last_line_names_the_failure(write_drive: Callable[..., Path]) -> None:
    last = check_bag(write_drive(image_shift_ns=1)).findings()[-1]
    assert last.startswith("FAILED: stamps do not agree: /camera/") and last.endswith("(and 1 more problem above)")


def test_odometry_of_another_robot_is_not_compared(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/one/camera/image_raw", "sensor_msgs/msg/Image")
        for robot, shift in (("one", 0), ("two", 1)):
            bag.add_topic(f"/{robot}/odom", ODOMETRY)
            for i in range(3):
                bag.write(f"/{robot}/odom", messages.odometry(i * TICK + shift, 0.0, 0.0), 0, 0)
        for i in range(3):
            bag.write("/one/camera/image_raw", messages.image(i * TICK, np.zeros((2, 2, 3), np.uint8), "rgb8"), 0, 0)
    assert check_bag(tmp_path / "bag").ok


def test_odometry_is_compared_from_the_start_of_each_frame(write_odometry: Callable[..., Path]) -> None:
    """Truth: 2 m north from (5, 5), heading north. Odometry: 2.1 m along its own x, and 0.2 m to the left at the end."""
    north = np.pi / 2
    folder = write_odometry(
        [(0, 0, 0, 0), (1, 1.0, 0, 0), (2, 2.1, 0.2, 0.1)],
        [(0, 5, 5, north), (1, 5, 6, north), (2, 5, 7, north)],
    )
    odometry = check_bag(folder).odometry
    assert odometry is not None
    assert odometry.distance_m == pytest.approx(2.0)
    assert odometry.odometry_distance_m == pytest.approx(1.0 + np.hypot(1.1, 0.2))
    assert odometry.end_error_m == pytest.approx(np.hypot(0.1, 0.2))
    assert odometry.end_error_percent == pytest.approx(50 * np.hypot(0.1, 0.2))
    assert odometry.end_error_deg == pytest.approx(np.degrees(0.1))


def test_odometry_is_compared_at_common_stamps_only(write_odometry: Callable[..., Path]) -> None:
    """Odometry starts one tick before the truth and ends one tick after it."""
    folder = write_odometry([(i, float(i), 0, 0) for i in range(6)], [(i, i - 1.0, 0, 0) for i in range(1, 5)])
    odometry = check_bag(folder).odometry
    assert odometry is not None
    assert (odometry.distance_m, odometry.end_error_m) == (pytest.approx(3.0), pytest.approx(0.0))


def test_heading_error_does_not_jump_at_half_a_turn(write_odometry: Callable[..., Path]) -> None:
    folder = write_odometry([(0, 0, 0, 0), (1, 1, 0, 3.13)], [(0, 0, 0, 0), (1, 1, 0, -3.13)])
    odometry = check_bag(folder).odometry
    assert odometry is not None
    assert odometry.end_error_deg == pytest.approx(np.degrees(2 * np.pi - 6.26))


def test_robot_that_stands_still_has_no_per_cent(write_odometry: Callable[..., Path]) -> None:
    """A robot settles on its wheels by micrometres, of which an error of the odometry would be many per cent."""
    odometry = check_bag(write_odometry([(0, 0, 0, 0), (1, 0, 0, 0)], [(0, 0, 0, 0), (1, 1e-5, 0, 0)])).odometry
    assert odometry is not None
    assert odometry.end_error_percent == 0.0
    assert "%" not in odometry.text()


def test_text_names_problem_and_odometry(write_drive: Callable[..., Path]) -> None:
    text = check_bag(write_drive(image_shift_ns=1)).text()
    assert "PROBLEM: /camera/image_raw" in text
    assert "odometry: 1.000 m driven" in text


def test_markdown_has_one_row_a_topic(write_drive: Callable[..., Path]) -> None:
    report = check_bag(write_drive())
    rows = [line for line in report.markdown().splitlines() if line.startswith("| /")]
    assert len(rows) == len(report.topics)
    assert "| /camera/image_raw | 11 | 10.00 | 0 | 1.000 | 2.000 |" in rows


def test_topics_without_a_rate_are_not_judged(messages: Any, tmp_path: Path) -> None:
    """Parameters and log lines have stamps of wall time, and come when something happens; commands pause; a latched topic repeats itself."""
    wall_s = 1_795_580_456
    t = messages.types
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/parameter_events", "rcl_interfaces/msg/ParameterEvent")
        bag.add_topic("/cmd_vel_applied", "geometry_msgs/msg/TwistStamped")
        bag.add_topic("/map_like", ODOMETRY, TopicQos.latched())
        bag.add_topic("/text", "std_msgs/msg/String")
        bag.add_topic("/odom", ODOMETRY)
        for i in range(20):
            now = i * TICK
            event = t["rcl_interfaces/msg/ParameterEvent"](
                stamp=messages.time((wall_s + i * i) * NS),
                node="/a",
                new_parameters=[],
                changed_parameters=[],
                deleted_parameters=[],
            )
            bag.write("/parameter_events", messages.cdr(event), now, now)
            bag.write("/map_like", messages.odometry(now, 0, 0), now, now)
            bag.write("/text", messages.text("hello"), now, now)
            if i != 7:
                bag.write("/odom", messages.odometry(now, 0.0, 0.0), now, now)
                bag.write("/cmd_vel_applied", messages.twist_stamped(now, 0.1), now, now)
    found = {t.info.name: (t.rate_hz, t.missing) for t in check_bag(tmp_path / "bag").topics}
    assert found["/parameter_events"] == found["/map_like"] == (0.0, None)
    assert found["/cmd_vel_applied"] == found["/text"] == (pytest.approx(10.0), None), "a rate is told, nothing is missing"
    assert found["/odom"] == (pytest.approx(10.0), 1)
    times = {t.info.name: t.last_ns for t in check_bag(tmp_path / "bag").topics}
    assert times["/parameter_events"] == 19 * TICK, "not in wall time beside simulation time"


def test_wheels_that_slip_are_named(write_odometry: Callable[..., Path]) -> None:
    report = check_bag(write_odometry([(i, float(i), 0, 0) for i in range(3)], [(i, 0.5 * i, 0, 0) for i in range(3)]))
    assert "1.000 m driven, 2.000 m by odometry (wheel slip); final error 1.000 m" in report.findings()[0]


def test_empty_bag_is_an_error(tmp_path: Path) -> None:
    BagWriter(tmp_path / "bag", reserve_bytes=0).close()
    with pytest.raises(RecordError, match="no messages"):
        check_bag(tmp_path / "bag")
