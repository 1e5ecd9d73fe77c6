"""From the velocity of a tool to joint velocities."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.errors import CommandError, ConfigError
from gibson_sim.robots.joints.servo import F64, ServoSettings, ToolTwist, limited_twist, servo_speeds

SETTINGS = ServoSettings()
NO_LIMIT = np.full(3, np.inf)
SLIDES: F64 = np.zeros((6, 3))
"""Three prismatic joints: along x, along y, and along x again."""
SLIDES[0, 0] = SLIDES[1, 1] = SLIDES[0, 2] = 1.0


def speeds(twist: F64, **changes: F64) -> F64:
    row = {"positions": np.zeros(3), "home": np.full(3, np.nan), "lower": -NO_LIMIT, "upper": NO_LIMIT, "fastest": NO_LIMIT}
    row |= changes
    return servo_speeds(SLIDES, twist, **row, dt=0.01, settings=SETTINGS)


def along(x: float, y: float = 0.0) -> F64:
    return np.array([x, y, 0.0, 0.0, 0.0, 0.0])


def test_joints_share_the_motion_and_impossible_directions_are_left_out() -> None:
    twist = along(0.2, 0.1)
    twist[2] = 5.0
    assert speeds(twist) == pytest.approx([0.1, 0.1, 0.1], abs=1e-6)


def test_joint_at_its_limit_leaves_the_way_to_the_others() -> None:
    upper = np.array([0.0, np.inf, np.inf])
    assert speeds(along(0.2), upper=upper) == pytest.approx([0.0, 0.0, 0.2], abs=1e-6)
    assert speeds(along(-0.2), upper=upper) == pytest.approx([-0.1, 0.0, -0.1], abs=1e-6)
    assert speeds(along(0.2), upper=np.zeros(3)) == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


def test_all_slow_down_together() -> None:
    fastest = np.array([np.inf, 0.05, np.inf])
    assert speeds(along(0.2, 0.1), fastest=fastest) == pytest.approx([0.05, 0.05, 0.05], abs=1e-6)


def test_free_joints_go_home_without_moving_the_tool() -> None:
    moved = speeds(along(0.0), positions=np.array([1.0, 0.0, -1.0]), home=np.zeros(3))
    assert moved == pytest.approx([-0.5, 0.0, 0.5], abs=1e-6)
    assert SLIDES @ moved == pytest.approx(np.zeros(6), abs=1e-9)


def test_speeds_stay_small_at_a_singularity() -> None:
    for size in (1e-1, 1e-2, 1e-3, 1e-5, 0.0):
        jacobian = np.zeros((6, 3))
        jacobian[0, 0], jacobian[1, 1] = 1.0, size
        out = servo_speeds(
            jacobian, along(0.1, 0.1), np.zeros(3), np.full(3, np.nan), -NO_LIMIT, NO_LIMIT, NO_LIMIT, 0.01, SETTINGS
        )  # fmt: skip
        assert out[0] == pytest.approx(0.1, rel=0.01)
        assert abs(out[1]) <= 0.1 / (2 * SETTINGS.damping) * 1.3


def test_twist_is_slowed_down_in_its_direction() -> None:
    twist = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert limited_twist(twist, SETTINGS) == pytest.approx([0.5, 0.0, 0.0, 0.0, 0.0, 0.5])
    assert limited_twist(twist / 4, SETTINGS) == pytest.approx(twist / 4)


def test_impossible_numbers_are_refused() -> None:
    with pytest.raises(CommandError, match=r"tool velocity linear=\(nan, 0.0, 0.0\)"):
        ToolTwist((math.nan, 0.0, 0.0), (0.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match=r"servo timeout is 0\.0"):
        ServoSettings(timeout=0.0)
