"""The picture of a robot shows its front."""

from __future__ import annotations

import pytest

from gibson_sim_tools.robots.picture import _arrow


def test_the_arrow_lies_ahead_of_the_robot_and_points_away_from_it() -> None:
    """A robot of 1 m: from 1.05 m to 1.75 m along x; its head is as wide on both sides."""
    shaft, left, right = _arrow(1.0)
    length = shaft.shape.size[0]
    assert shaft.pose.position[0] - length / 2 == pytest.approx(1.05)
    assert shaft.pose.position[0] + length / 2 == pytest.approx(1.75 - 0.13 / 2)
    assert left.pose.position[1] == pytest.approx(-right.pose.position[1])
    assert left.pose.position[0] == right.pose.position[0] < 1.75
