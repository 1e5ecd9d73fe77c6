"""Which views of a drive are kept for training."""

from __future__ import annotations

import numpy as np

from gibson_sim_learn.path_following.dagger import keyframe_ticks


def test_views_of_a_robot_that_stands_are_kept_once() -> None:
    x = [0.0, 0.01, 0.02, 0.04, 0.04, 0.04]
    poses = np.column_stack([x, np.zeros(6), np.zeros(6)])
    assert keyframe_ticks(poses) == [0, 3]


def test_views_of_a_robot_that_turns_are_kept_also_across_the_back() -> None:
    yaw = np.array([np.pi - 0.03, -np.pi + 0.03, -np.pi + 0.04])
    assert keyframe_ticks(np.column_stack([np.zeros(3), np.zeros(3), yaw])) == [0, 1]
