"""Trajectory files, and the association of stamps."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_xyz_rpy
from gibson_sim_tools.scanning.posed_images import ScanError
from gibson_sim_tools.scanning.trajectories import (
    associate,
    pose_at,
    read_stamped_poses,
    read_trajectory_log,
    write_stamped_poses,
    write_trajectory_log,
)

POSES = np.stack([matrix_from_pose(pose_from_xyz_rpy((k, 2.0, -k), (0.1 * k, -0.2, 2.0 * k))) for k in range(4)])


def test_a_log_is_read_as_it_was_written(tmp_path):
    write_trajectory_log(tmp_path / "a.log", POSES)
    assert np.allclose(read_trajectory_log(tmp_path / "a.log"), POSES, atol=1e-9)


def test_stamped_poses_are_read_as_they_were_written_and_sorted(tmp_path):
    write_stamped_poses(tmp_path / "a.txt", [3.0, 1.0, 2.0, 4.0], POSES)
    stamps, poses = read_stamped_poses(tmp_path / "a.txt")
    assert stamps.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert np.allclose(poses[[2, 0, 1, 3]], POSES, atol=1e-8)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n", "has 4 lines"),
        ("0 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", ":1: '0 0'"),
        ("0 0 1\n1 0 0 0\n0 1 0\n0 0 1 0\n0 0 0 1\n", ":3: "),
        ("0 0 1\n1 0 0 0\n0 2 0 0\n0 0 1 0\n0 0 0 1\n", "not a rigid transform"),
    ],
)
def test_a_broken_log_names_the_line(text, why, tmp_path):
    (tmp_path / "a.log").write_text(text)
    with pytest.raises(ScanError, match=why):
        read_trajectory_log(tmp_path / "a.log")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "two poses have the stamp 1"),
        ("1 0 0 0 0 0 0 3\n", "has length 3"),
        ("1 0 0 nan 0 0 0 1\n", "NaN"),
        ("1 0 0 0 0 0 1\n", "8 numbers"),
    ],
)
def test_broken_stamped_poses_are_refused(text, why, tmp_path):
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(ScanError, match=why):
        read_stamped_poses(tmp_path / "a.txt")


def test_each_stamp_is_used_once_and_the_nearest_pairs_win():
    assert associate([0.0, 0.010, 1.0], [0.012, 0.5], 0.02).tolist() == [[1, 0]]


def test_a_pose_between_two_is_half_way_and_half_turned():
    a, b = (matrix_from_pose(pose_from_xyz_rpy((x, 0, 0), (0, 0, yaw))) for x, yaw in ((0, 0), (1, math.pi / 2)))
    found = pose_at(np.array([0.0, 0.02]), np.stack([a, b]), 0.01, 0.02)
    assert np.allclose(found, matrix_from_pose(pose_from_xyz_rpy((0.5, 0, 0), (0, 0, math.pi / 4))))


def test_no_pose_is_made_up_in_a_gap():
    stamps = np.array([0.0, 1.0])
    assert pose_at(stamps, POSES[:2], 0.5, 0.02) is None
    assert np.allclose(pose_at(stamps, POSES[:2], 0.99, 0.02), POSES[1])
    assert pose_at(stamps, POSES[:2], -1.0, 0.02) is None
