"""Interpolation of scene states."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.errors import SceneMismatchError
from gibson_sim.geometry.interpolation import interpolate_states, slerp
from gibson_sim.geometry.transforms import quat_from_rpy, yaw_from_quat
from gibson_sim.types import SceneState


def state(stamp_ns: int, positions: list[list[float]], yaws: list[float], revision: int = 1) -> SceneState:
    n = len(positions)
    quats = np.array([quat_from_rpy(0.0, 0.0, yaw) for yaw in yaws]).reshape(n, 4)
    links = tuple(f"b/{i}" for i in range(n))
    return SceneState(
        stamp_ns, stamp_ns // 1000, revision, links, np.reshape(positions, (n, 3)), quats, np.full((n, 6), float(stamp_ns))
    )


EARLY = state(1000, [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]], [0.0, 0.2])
LATE = state(5000, [[4.0, -8.0, 0.0], [1.0, 2.0, 3.0]], [1.0, 0.2])


def test_quarter_of_the_way() -> None:
    got = interpolate_states(EARLY, LATE, 0.25)
    assert (got.stamp_ns, got.step, got.revision, got.links) == (2000, 2, 1, EARLY.links)
    np.testing.assert_allclose(got.positions, [[1.0, -2.0, 0.0], [1.0, 2.0, 3.0]])
    assert [yaw_from_quat(q) for q in got.quats_xyzw] == pytest.approx([0.25, 0.2])
    np.testing.assert_allclose(got.twists, 2000.0)


def test_both_ends_are_exact_to_the_bit() -> None:
    assert interpolate_states(EARLY, LATE, 0.0) is EARLY
    assert interpolate_states(EARLY, LATE, 1.0) is LATE


def test_motion_goes_on_outside() -> None:
    got = interpolate_states(EARLY, LATE, -0.25)
    assert got.stamp_ns == 0
    np.testing.assert_allclose(got.positions[0], [-1.0, 2.0, 0.0])
    assert yaw_from_quat(got.quats_xyzw[0]) == pytest.approx(-0.25)


def test_turn_takes_the_short_way_whatever_the_signs_of_the_quaternions() -> None:
    a, b = np.array(quat_from_rpy(0.0, 0.0, math.radians(170))), np.array(quat_from_rpy(0.0, 0.0, math.radians(-170)))
    for sign in (1.0, -1.0):
        assert abs(yaw_from_quat(slerp(a, sign * b, 0.5))) == pytest.approx(math.pi)


def test_turn_about_a_slanted_axis_has_a_constant_rate() -> None:
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    angles = np.array([0.3, 0.3 + 0.75 * 1.6, 0.3 + 1.6]) / 2.0
    a, middle, b = (np.array([*(axis * math.sin(h)), math.cos(h)]) for h in angles)
    np.testing.assert_allclose(slerp(a, b, 0.75), middle, atol=1e-12)


def test_tiny_turns_are_neither_lost_nor_not_a_number() -> None:
    b = np.array(quat_from_rpy(0.0, 0.0, 1e-7))
    got = slerp([[0.0, 0.0, 0.0, 1.0]] * 2, [b, [0.0, 0.0, 0.0, 1.0]], 0.5)
    assert got[0, 2] == pytest.approx(0.25e-7, rel=1e-6)
    np.testing.assert_array_equal(got[1], [0.0, 0.0, 0.0, 1.0])


def test_scene_without_links() -> None:
    assert interpolate_states(state(0, [], []), state(10, [], []), 0.5).stamp_ns == 5


@pytest.mark.parametrize("other", [state(5000, [[0.0, 0.0, 0.0]], [0.0]), state(5000, [[0.0] * 3] * 2, [0.0, 0.0], revision=2)])
def test_states_of_different_scenes_are_refused(other: SceneState) -> None:
    with pytest.raises(SceneMismatchError, match="cannot be interpolated"):
        interpolate_states(EARLY, other, 0.5)
