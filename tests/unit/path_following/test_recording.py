"""Recording a path: the positions and contents of its nodes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gibson_path_following.paths import recording
from gibson_path_following.paths.path_folder import check_path, save_path
from gibson_path_following.paths.recording import PathRecorder, RecorderSettings
from gibson_path_following.paths.stamp_filter import StampFilter
from gibson_path_following.types import STOP, RecordedPath, Velocity

NS = 1_000_000_000
TICK = NS // 10
VIEW = (np.zeros((16, 24, 3), np.uint8),)
FORWARD = Velocity(0.5, 0.0)


def _drive(
    recorder: PathRecorder, seconds: float, velocity: Velocity, start: tuple[float, float] = (0.0, 0.0), odometry: bool = True
) -> None:
    """Drives straight ahead, or turns in place, from time 1 s on: a view and an odometry every 0.1 s."""
    recorder.add_command(NS, velocity)
    for k in range(round(seconds * 10) + 1):
        now = NS + k * TICK
        if odometry:
            recorder.add_odometry(now, (start[0] + 0.1 * k * velocity.linear, start[1], 0.1 * k * velocity.angular))
        recorder.add_view(now, VIEW)


def _distances(path: RecordedPath) -> list[float]:
    return [round(node.distance, 6) for node in path.nodes]


@pytest.mark.parametrize("odometry", [True, False])
def test_a_node_stands_every_spacing(odometry: bool) -> None:
    recorder = PathRecorder("pinhole", 1.5, RecorderSettings(spacing=0.2, uses_odometry=odometry))
    _drive(recorder, 2.0, FORWARD, odometry=odometry)
    path = recorder.finish()
    # 0.05 m a view: nodes at 0, 0.2, ... 1.0.
    assert _distances(path) == [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]
    assert path.length == pytest.approx(1.0) and recorder.length == pytest.approx(1.0)
    assert [node.stamp_ns for node in path.nodes] == [NS + 4 * k * TICK for k in range(6)]
    assert (path.nodes[5].pose is None) == (not odometry)
    assert not odometry or path.nodes[5].pose == pytest.approx((1.0, 0.0, 0.0))
    check_path(path)


@pytest.mark.parametrize("odometry", [True, False])
def test_the_same_messages_make_the_same_path_to_the_bit(tmp_path: Path, odometry: bool) -> None:
    written = []
    for folder in (tmp_path / "one", tmp_path / "two"):
        recorder = PathRecorder("pinhole", 1.5, RecorderSettings(uses_odometry=odometry))
        rng = np.random.default_rng(0)
        for k in range(60):
            recorder.add_command(NS + k * TICK, Velocity(*rng.uniform(0.0, 0.5, 2)))
            if odometry:
                recorder.add_odometry(NS + k * TICK, (0.03 * k, *rng.uniform(0.0, 0.01, 2)))
            recorder.add_view(NS + k * TICK, (rng.integers(0, 256, (16, 24, 3), np.uint8),))
        save_path(recorder.finish(), folder)
        written.append({str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*.*")})
    assert written[0] == written[1] and len(written[0]) > 5


def test_a_turn_in_place_makes_nodes_too() -> None:
    recorder = PathRecorder("pinhole", 1.5, RecorderSettings(turn=0.4))
    _drive(recorder, 1.0, Velocity(0.0, 1.0))
    assert [node.pose[2] for node in recorder.finish().nodes if node.pose] == pytest.approx([0.0, 0.4, 0.8])


def test_the_first_node_is_where_the_robot_stood_last() -> None:
    recorder = PathRecorder("pinhole", 1.5, RecorderSettings(uses_odometry=False))
    for k in range(5):
        recorder.add_view(k * TICK, VIEW)
    _drive(recorder, 0.4, FORWARD, odometry=False)
    assert [node.stamp_ns for node in recorder.finish().nodes] == [NS, NS + 4 * TICK]


def test_velocities_stand_from_their_node_on() -> None:
    recorder = PathRecorder("pinhole", 1.5, RecorderSettings(uses_odometry=False))
    recorder.add_command(NS // 2, Velocity(0.0, 0.1))
    recorder.add_view(NS, VIEW)
    _drive(recorder, 0.0, FORWARD, odometry=False)
    recorder.add_command(NS + 5 * TICK, Velocity(0.25, 0.0))
    recorder.add_command(NS + 5 * TICK, Velocity(0.3, 0.0))  # of the same time: it replaces the one before
    recorder.add_command(NS + 4 * TICK, STOP)  # late: left out
    for k in range(1, 9):
        recorder.add_view(NS + k * TICK, VIEW)
    nodes = recorder.finish().nodes
    # 0.2 m at 1.4 s; until 1.8 s another 0.05 m + 3 x 0.03 m.
    assert [node.stamp_ns for node in nodes] == [NS, NS + 4 * TICK, NS + 8 * TICK]
    slow = Velocity(0.3, 0.0)
    assert [node.velocities for node in nodes] == [((0, FORWARD),), ((0, FORWARD), (TICK, slow)), ((0, slow),)]


def test_a_view_waits_for_the_odometry_of_its_time() -> None:
    recorder = PathRecorder("pinhole", 1.5)
    recorder.add_odometry(NS, (0.0, 0.0, 3.1))
    recorder.add_view(NS, VIEW)
    recorder.add_view(NS + TICK, VIEW)
    assert recorder.nodes == 1
    # Between odometry at 1.0 s and 1.2 s: half of 0.4 m, and of a turn across 180 degrees.
    recorder.add_odometry(NS + 2 * TICK, (0.4, 0.0, -3.1))
    assert recorder.nodes == 2
    pose = recorder.finish().nodes[1].pose
    assert pose is not None and pose[:2] == pytest.approx((0.2, 0.0)) and abs(pose[2]) == pytest.approx(math.pi)


def test_images_alone_make_a_node_every_interval() -> None:
    recorder = PathRecorder("pinhole", 1.5, RecorderSettings(interval=0.3, uses_odometry=False))
    for k in range(8):
        recorder.add_view(NS + k * TICK, VIEW)
    path = recorder.finish()
    assert [node.stamp_ns for node in path.nodes] == [NS, NS + 3 * TICK, NS + 6 * TICK]
    assert _distances(path) == [0.0, 0.0, 0.0] and path.nodes[0].velocities == ()


def test_without_odometry_the_commands_count_after_a_while() -> None:
    recorder = PathRecorder("pinhole", 1.5, RecorderSettings(odometry_timeout=0.3))
    _drive(recorder, 1.0, FORWARD, odometry=False)
    path = recorder.finish()
    assert _distances(path) == [0.0, 0.2, 0.4, 0.5]
    assert all(node.pose is None for node in path.nodes)


def _passed(stamps: list[float]) -> tuple[list[float], list[bool], list[float]]:
    """Returns what a filter passes on of images with these stamps, s, whether time jumped at each, and the outliers."""
    stamp_filter = StampFilter[None]()
    passed = [stamp_filter.add(round(stamp * NS), None) for stamp in stamps]
    outliers = [each.outlier_ns / NS for each in passed if each.outlier_ns is not None]
    return [stamp_ns / NS for each in passed for stamp_ns, _ in each.items], [each.is_jump for each in passed], outliers


@pytest.mark.parametrize(("wrong", "ahead"), [(10.3, 10.0), (3600.0, 3599.7), (0.0, -5.3)])
def test_a_single_stamp_far_from_its_neighbours_is_left_out(wrong: float, ahead: float) -> None:
    first = 0.0 if wrong else 5.0
    stamps, jumps, outliers = _passed([first + 0.1, first + 0.2, wrong, first + 0.3, first + 0.4])
    assert stamps == [first + 0.1, first + 0.2, first + 0.3, first + 0.4]
    assert not any(jumps) and outliers == pytest.approx([ahead])


def test_stamps_that_go_back_for_good_are_a_jump_with_the_second_of_them() -> None:
    assert _passed([5.0, 5.1, 1.0, 1.1, 1.2]) == ([5.0, 5.1, 1.0, 1.1, 1.2], [False, False, False, True, False], [])


def test_a_pause_and_a_slow_camera_lose_no_image() -> None:
    assert _passed([1.0, 1.1, 60.0, 60.1]) == ([1.0, 1.1, 60.0, 60.1], [False] * 4, [])
    slow = [0.0, 2.0, 4.0, 6.0, 9.0]
    assert _passed(slow)[0] == slow
    assert _passed([1.0, 1.1, 1.05, 1.1, 1.2])[0] == [1.0, 1.1, 1.2], "late ones are left out"


def test_one_odometry_from_the_future_does_not_stop_the_odometry() -> None:
    lines: list[str] = []
    recorder = PathRecorder("pinhole", 1.5, warn=lines.append)
    _drive(recorder, 0.4, FORWARD)
    recorder.add_odometry(3600 * NS, (0.2, 0.0, 0.0))
    for k in range(5, 11):
        recorder.add_odometry(NS + k * TICK, (0.05 * k, 0.0, 0.0))
        recorder.add_view(NS + k * TICK, VIEW)
    path = recorder.finish()
    assert _distances(path) == [0.0, 0.2, 0.4, 0.5] and all(node.pose for node in path.nodes)
    assert lines == ["odom: one stamp was 3598.5 s ahead of the next one and is left out; correct the driver"]


def test_jumping_odometry_is_replaced_by_commands_and_reported_once() -> None:
    lines: list[str] = []
    recorder = PathRecorder("pinhole", 1.5, warn=lines.append)
    recorder.add_command(NS, FORWARD)
    for k, x in enumerate([0.0, 0.05, 0.1, 50.15, 50.2, 0.25, 0.3]):
        recorder.add_odometry(NS + k * TICK, (x, 0.0, 0.0))
        recorder.add_view(NS + k * TICK, VIEW)
    assert recorder.finish().length == pytest.approx(0.3)
    assert len(lines) == 1 and lines[0].startswith("odometry has jumped by 50.05 m within 0.10 s: the distance there is that of")


def test_odometry_that_catches_up_has_not_jumped() -> None:
    recorder = PathRecorder("pinhole", 1.5)
    for stamp_ns, x in ((NS, 0.0), (NS + TICK // 10, 0.4)):
        recorder.add_odometry(stamp_ns, (x, 0.0, 0.0))
        recorder.add_view(stamp_ns, VIEW)
    assert recorder.finish().length == pytest.approx(0.4)


def test_poses_and_commands_that_cannot_be_read_again_are_left_out_with_a_line_each() -> None:
    lines: list[str] = []
    recorder = PathRecorder("pinhole", 1.5, warn=lines.append)
    for pose in (None, (1e308, 0.0, 0.0), (0.0, -1e9, 0.0)):
        recorder.add_odometry(NS // 2, pose)
    for velocity in (None, Velocity(1e308, 0.0), Velocity(0.0, -101.0)):
        recorder.add_command(NS // 2, velocity)
    _drive(recorder, 0.4, FORWARD)
    path = recorder.finish()
    check_path(path)
    assert _distances(path) == [0.0, 0.2]
    assert lines == [
        "a message of odom has no rotation, or no position within 1e+08 m: it is left out; correct its driver",
        "a command is not finite, or above 100 m/s or rad/s: it is left out",
    ]


def test_a_path_takes_no_more_nodes_and_commands_than_can_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = PathRecorder("pinhole", 1.5, max_nodes=3)
    _drive(recorder, 2.0, FORWARD)
    assert recorder.is_full and _distances(recorder.finish()) == [0.0, 0.2, 0.4]
    monkeypatch.setattr(recording, "MAX_VELOCITIES", 20)
    recorder = PathRecorder("pinhole", 1.5)
    for k in range(50):  # commands of a robot that stands do not count
        recorder.add_command(k * NS // 50, Velocity(0.001 * (k % 2)))
        recorder.add_odometry(k * NS // 50, (0.0, 0.0, 0.0))
        recorder.add_view(k * NS // 50, VIEW)
    assert not recorder.is_full
    _drive(recorder, 1.0, FORWARD)
    for k in range(50):
        recorder.add_command(3 * NS + k, Velocity(0.01 * k))
    assert recorder.is_full and sum(len(node.velocities) for node in recorder.finish().nodes) <= 20


def test_a_recording_says_what_is_missing() -> None:
    def recorded(odometry_ns: int | None, command_ns: int | None, uses_odometry: bool = True) -> PathRecorder:
        recorder = PathRecorder("pinhole", 1.5, RecorderSettings(uses_odometry=uses_odometry), warn=lines.append)
        for k in range(8):
            if odometry_ns is not None:
                recorder.add_odometry(odometry_ns + k * NS, (0.0, 0.0, 0.0))
            if command_ns is not None:
                recorder.add_command(command_ns + k * NS, FORWARD)
            recorder.add_view((1 + k) * NS, VIEW)
        recorder.finish()
        return recorder

    lines: list[str] = []
    check = "so that no distance is known; check the topics, or set interval for images alone"
    assert recorded(None, None).missing() == f"neither odom nor cmd_vel has come, {check}"
    assert lines == [f"neither odom nor cmd_vel has come, {check}"], "already while it records"
    assert recorded(None, None, uses_odometry=False).missing() == f"no cmd_vel has come, {check}"
    assert recorded(NS, None).missing() == "the robot has not driven 0.2 m by odom; drive on while it records"
    lines.clear()
    assert recorded(1000 * NS, None).missing().startswith("the stamps of odom are not those of the images; set use_sim_time")
    assert len(lines) == 1 and lines[0].startswith("no node is recorded: the stamps of odom are not those of the images")
    assert recorded(None, 1000 * NS).missing().startswith("cmd_vel came at other times than the images; set use_sim_time")
    assert PathRecorder("pinhole", 1.5).missing() == "the number of images is 0; record for longer"


def test_a_path_says_what_it_lacks() -> None:
    recorder = PathRecorder("pinhole", 1.5)
    _drive(recorder, 1.0, FORWARD)
    assert recorder.remarks(recorder.finish()) == ()
    recorder = PathRecorder("pinhole", 1.5, RecorderSettings(odometry_timeout=0.3))
    _drive(recorder, 1.0, FORWARD, odometry=False)
    assert recorder.remarks(recorder.finish()) == ("no odom has come",)
    recorder = PathRecorder("pinhole", 1.5)
    recorder.add_command(1000 * NS, FORWARD)
    _drive(recorder, 1.0, FORWARD)  # its command is older: left out
    assert recorder.remarks(recorder.finish())[0].startswith("all its velocities are 0: cmd_vel came at other times than")
