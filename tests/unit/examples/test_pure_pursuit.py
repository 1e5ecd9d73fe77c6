"""Following a path."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_examples.errors import SettingError
from gibson_examples.geometry import F64, Pose2D
from gibson_examples.planner import resample
from gibson_examples.pure_pursuit import PurePursuit, PursuitSettings, Velocity, arc

FAR = 10.0
"""Clearance without obstacles, metres."""


def line(*corners: tuple[float, float]) -> F64:
    return resample(np.array(corners), 0.05)


def settled(follower: PurePursuit, pose: Pose2D, clearance: float = FAR) -> Velocity:
    """Returns the command once the speed has come up."""
    for _ in range(50):
        command = follower.command(pose, clearance, dt=0.1)
    return command


def drive(path: F64, pose: Pose2D, seconds: float) -> list[Pose2D]:
    """Returns where a robot without inertia goes, every 0.05 s."""
    follower, poses = PurePursuit(path), [pose]
    for _ in range(round(seconds / 0.05)):
        c = follower.command(poses[-1], FAR, dt=0.05)
        poses.append(poses[-1] @ Pose2D(c.linear * 0.05, 0.0, c.angular * 0.05))
    return poses


def test_robot_on_a_straight_line_drives_straight_at_full_speed() -> None:
    command = settled(PurePursuit(line((0, 0), (5, 0))), Pose2D(0.0, 0.0, 0.0))
    assert command == Velocity(pytest.approx(0.45), pytest.approx(0.0, abs=1e-9))


def test_speed_rises_no_faster_than_the_acceleration() -> None:
    follower = PurePursuit(line((0, 0), (5, 0)))
    speeds = [follower.command(Pose2D(0.0, 0.0, 0.0), FAR, dt=0.1).linear for _ in range(3)]
    assert speeds == pytest.approx([0.06, 0.12, 0.18])


def test_robot_left_of_the_line_turns_right() -> None:
    follower = PurePursuit(line((0, 0), (5, 0)), speed=0.3)
    assert follower.command(Pose2D(0.0, 0.1, 0.0), FAR, dt=0.05).angular < 0.0


def test_yaw_rate_is_that_of_the_arc_through_the_point_ahead() -> None:
    # At 0.3 m/s the point is 0.27 m ahead, in steps of 0.05: (0.25, 0); the robot is at (0, 0.1).
    command = PurePursuit(line((0, 0), (5, 0)), speed=0.3).command(Pose2D(0.0, 0.1, 0.0), FAR, dt=0.0)
    assert command.angular / command.linear == pytest.approx(2 * -0.1 / (0.25**2 + 0.1**2))


def test_path_behind_the_robot_makes_it_turn_in_place() -> None:
    command = PurePursuit(line((0, 0), (-5, 0))).command(Pose2D(0.0, 0.0, 0.5), FAR, dt=0.1)
    assert command == Velocity(0.0, 1.2)


def test_turn_goes_on_until_the_heading_is_right() -> None:
    follower = PurePursuit(line((0, 0), (5, 0)))
    assert follower.command(Pose2D(0.0, 0.0, math.radians(61.0)), FAR, 0.1).linear == 0.0
    assert follower.command(Pose2D(0.0, 0.0, math.radians(20.0)), FAR, 0.1).linear == 0.0
    assert follower.command(Pose2D(0.0, 0.0, math.radians(9.0)), FAR, 0.1).linear > 0.0


def test_robot_is_slower_near_an_obstacle() -> None:
    # Half of 0.3 m from the rim: half way between 35 % and all of the speed.
    command = settled(PurePursuit(line((0, 0), (5, 0))), Pose2D(0.0, 0.0, 0.0), clearance=0.15)
    assert command.linear == pytest.approx(0.45 * 0.675)


def test_robot_brakes_for_the_end_of_the_path() -> None:
    path = line((0, 0), (1, 0))
    near = PurePursuit(path, speed=0.45).command(Pose2D(0.84, 0.0, 0.0), FAR, 0.1)
    assert near.linear == pytest.approx(0.16 / 0.8)
    at_it = PurePursuit(path, speed=0.45).command(Pose2D(0.99, 0.0, 0.0), FAR, 0.1)
    assert at_it.linear == pytest.approx(0.06)  # its slowest


def test_robot_follows_a_corner_within_a_fifth_of_a_metre() -> None:
    poses = drive(line((0, 0), (2, 0), (2, 2)), Pose2D(0.0, 0.0, 0.0), seconds=14.0)
    off = [min(abs(p.y) if p.x < 2 else FAR, abs(p.x - 2)) for p in poses]
    assert max(off) < 0.2
    assert math.hypot(poses[-1].x - 2, poses[-1].y - 2) < 0.05


def test_crossing_of_the_path_with_itself_does_not_lead_astray() -> None:
    path = line((0, 0), (4, 0), (4, 2), (2, 2), (2, -2))
    poses = drive(path, Pose2D(0.0, 0.0, 0.0), seconds=40.0)
    assert max(p.x for p in poses) > 3.8
    assert math.hypot(poses[-1].x - 2, poses[-1].y + 2) < 0.05


def test_arc_of_a_turn_is_a_circle() -> None:
    points = arc(Pose2D(0.0, 0.0, 0.0), Velocity(1.0, 1.0), math.pi, 2)
    assert points == pytest.approx(np.array([[1.0, 1.0], [0.0, 2.0]]))


def test_speed_of_nothing_is_refused() -> None:
    with pytest.raises(SettingError, match="max_linear is 0, must be a finite number above 0"):
        PursuitSettings(max_linear=0.0)
