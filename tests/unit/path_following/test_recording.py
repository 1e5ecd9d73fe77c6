"""Recording a path: where its nodes are, and what stands in them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_path_following.path_folder import check_path
from gibson_path_following.recording import PathRecorder, RecorderSettings
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
