"""Matching of nearby poses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.bags.comparison.compare import from_start, matches


def test_nearest_poses_match_once() -> None:
    a = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [1.0, 0.0, 0.0]])
    b = np.array([[1.05, 0.0, 0.0], [0.0, 0.01, 0.0]])
    assert matches(a, b).tolist() == [[0, 1], [2, 0]]


def test_another_heading_does_not_match_but_a_whole_turn_does() -> None:
    assert len(matches(np.zeros((1, 3)), np.array([[0.0, 0.0, math.radians(20.0)]]))) == 0
    assert len(matches(np.zeros((1, 3)), np.array([[0.0, 0.0, 2 * math.pi]]))) == 1


def test_unknown_poses_match_nothing() -> None:
    assert matches(np.full((2, 3), np.nan), np.zeros((1, 3))).shape == (0, 2)


def test_a_pose_is_relative_to_the_start() -> None:
    # From (1, 2), facing along y: a point 3 m further along y is 3 m ahead.
    found = from_start(np.array([[1.0, 5.0, math.pi]]), np.array([1.0, 2.0, math.pi / 2]))
    assert found[0] == pytest.approx([3.0, 0.0, math.pi / 2])
