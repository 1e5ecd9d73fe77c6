"""The follower drives an ideal unicycle; scripted drives are integrated."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.errors import CommandError, ConfigError
from gibson_sim.robots.path_tracking import PathFollower, ScriptedDrive, parse_script, scripted_drive

RATE = 60.0
L_SHAPE = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.5)]
U_TURN = [(0.0, 0.0), (2.0, 0.0), (2.0, 0.5), (0.0, 0.5)]
BACK = [(0.0, 0.0), (2.0, 0.0), (0.0, 0.0)]
ARC = [(2 * math.sin(a), 2 - 2 * math.cos(a)) for a in np.linspace(0, math.pi, 40)]


def _step(x: float, y: float, yaw: float, linear: float, angular: float) -> tuple[float, float, float]:
    """Moves an ideal unicycle by one step, along its exact arc by the heading in the middle."""
    middle = yaw + angular / RATE / 2
    return x + linear * math.cos(middle) / RATE, y + linear * math.sin(middle) / RATE, yaw + angular / RATE


def _drive(follower: PathFollower, pose: tuple[float, float, float]) -> NDArray[np.float64]:
    """Returns the poses (N, 3) until the follower is done, at most 2 minutes."""
    poses = [pose]
    for _ in range(int(120 * RATE)):
        linear, angular = follower.command(*pose)
        if follower.done:
            break
        pose = _step(*pose, linear, angular)
        poses.append(pose)
    return np.array(poses)


def _cross_track(points: NDArray[np.float64], path: list[tuple[float, float]]) -> float:
    """Returns the largest distance of points (N, 2) from a polyline."""
    best = np.full(len(points), np.inf)
    for a, b in zip(np.array(path[:-1]), np.array(path[1:]), strict=True):
        t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        best = np.minimum(best, np.linalg.norm(a + t[:, None] * (b - a) - points, axis=1))
    return float(best.max())


@pytest.mark.parametrize("path", [L_SHAPE, U_TURN, BACK, ARC])
@pytest.mark.parametrize("yaw", [0.0, 2.5, -math.pi])
def test_follower_stays_on_the_path_to_its_end(path: list[tuple[float, float]], yaw: float) -> None:
    follower = PathFollower(path)
    poses = _drive(follower, (0.0, 0.0, yaw))
    assert follower.done
    assert _cross_track(poses[:, :2], path) < 0.1
    assert math.dist(poses[-1, :2], path[-1]) < 0.1


@pytest.mark.parametrize("path", [L_SHAPE, U_TURN, BACK])
def test_follower_reaches_sharp_corners_before_it_turns(path: list[tuple[float, float]]) -> None:
    poses = _drive(PathFollower(path), (0.0, 0.0, 0.0))
    for corner in path:
        # 5 cm and less than one step.
        assert np.linalg.norm(poses[:, :2] - corner, axis=1).min() < 0.06


def test_follower_comes_back_to_the_path_from_beside_it() -> None:
    follower = PathFollower([(0.0, 0.0), (4.0, 0.0)])
    poses = _drive(follower, (0.0, 0.3, 0.0))
    assert follower.done
    assert np.abs(poses[poses[:, 0] > 1.5, 1]).max() < 0.05


def test_follower_does_not_exceed_its_limits() -> None:
    follower = PathFollower(U_TURN, max_linear=0.3, max_angular=0.8)
    pose = (0.0, 0.0, 2.0)
    commands = []
    while not follower.done:
        commands.append(follower.command(*pose))
        pose = _step(*pose, *commands[-1])
    linear, angular = np.array(commands).T
    assert 0.29 < linear.max() <= 0.3
    assert 0.79 < np.abs(angular).max() <= 0.8
    assert linear.min() >= 0.0


def test_left_turn_has_a_positive_yaw_rate() -> None:
    linear, angular = PathFollower([(0.0, 0.0), (0.0, 2.0)]).command(0.0, 0.0, 0.0)
    assert linear == 0.0
    assert angular > 0.5


def test_follower_stands_still_once_it_is_done() -> None:
    follower = PathFollower([(0.0, 0.0), (1.0, 0.0)])
    poses = _drive(follower, (0.0, 0.0, 0.0))
    assert follower.command(*poses[-1]) == (0.0, 0.0)
    assert follower.progress == 1.0
    assert follower.length == 1.0


def test_progress_is_the_share_of_the_length() -> None:
    follower = PathFollower([(0.0, 0.0), (4.0, 0.0)])
    for x in (0.0, 0.5, 1.0):
        follower.command(x, 0.0, 0.0)
    assert follower.progress == pytest.approx(0.25)


@pytest.mark.parametrize("path", [[], [(0, 0)], [(1, 1), (1, 1)], [(0, 0, 0), (1, 1, 1)], [(0, 0), (math.nan, 1)]])
def test_path_without_two_points_is_refused(path: list[tuple[float, ...]]) -> None:
    with pytest.raises(ConfigError, match="path follower"):
        PathFollower(path)


def test_limit_of_0_is_refused() -> None:
    with pytest.raises(ConfigError, match="max_linear"):
        PathFollower(L_SHAPE, max_linear=0.0)


def test_pose_that_is_no_number_is_refused() -> None:
    with pytest.raises(CommandError, match="NaN"):
        PathFollower(L_SHAPE).command(math.nan, 0.0, 0.0)


def _integrate(drive: ScriptedDrive) -> NDArray[np.float64]:
    """Returns the poses (N, 3) of an ideal unicycle at the rate until the drive ends."""
    poses = [(0.0, 0.0, 0.0)]
    for k in range(math.ceil(drive.duration * RATE)):
        poses.append(_step(*poses[-1], *drive.command((k + 0.5) / RATE)))
    return np.array(poses)


def test_forward_goes_straight_on_for_its_length() -> None:
    drive = scripted_drive("forward", linear=0.5, length=2.0)
    assert drive.duration == 4.0
    np.testing.assert_allclose(_integrate(drive)[-1], [2, 0, 0], atol=0.02)


def test_square_has_sides_of_1_m_to_the_left_and_ends_as_it_began() -> None:
    poses = _integrate(scripted_drive("square"))
    np.testing.assert_allclose(poses[-1], [0, 0, 2 * math.pi], atol=0.08)
    np.testing.assert_allclose([poses[:, :2].min(axis=0), poses[:, :2].max(axis=0)], [[0, 0], [1, 1]], atol=0.05)


def test_spin_is_one_turn_to_the_left_on_the_spot() -> None:
    np.testing.assert_allclose(_integrate(scripted_drive("spin"))[-1], [0, 0, 2 * math.pi], atol=0.03)


def test_drive_is_still_before_it_begins_and_after_it_ends() -> None:
    drive = scripted_drive("forward", linear=0.5, length=2.0)
    assert [drive.command(t) for t in (-0.1, 0.0, 3.99, 4.0)] == [(0, 0), (0.5, 0), (0.5, 0), (0, 0)]


def test_drive_is_read_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "drive.txt").write_text("# linear angular seconds\n0.5 0 2  # on\n\n0, -1.5, 1\n")
    drive = scripted_drive(str(tmp_path / "drive.txt"))
    assert drive.steps == ((0.5, 0.0, 2.0), (0.0, -1.5, 1.0))
    assert drive.duration == 3.0
    assert drive.command(2.5) == (0.0, -1.5)


def test_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="neither forward, square nor spin"):
        scripted_drive("zigzag")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0.5 0\n", "line 1"),
        ("0 0 1\n0.5 fast 1\n", "line 2"),
        ("", "no steps"),
        ("0.5 0 -1\n", "above 0"),
        ("nan 0 1\n", "finite"),
    ],
)
def test_broken_script_is_refused(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        parse_script(text)
