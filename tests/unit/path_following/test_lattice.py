"""Plans over the lattice: straight without obstacles, around an obstacle on its free side, up to an obstacle that blocks the path."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_path_following.errors import SettingError
from gibson_path_following.obstacles.lattice import LatticePlanner, LatticeSettings, LocalPlan

F64 = NDArray[np.float64]
STATIONS = np.arange(21, dtype=np.float64) * 0.1
MIN_CLEARANCE = LatticeSettings().min_clearance


def box(x0: float, x1: float, y0: float, y1: float) -> Callable[[F64], F64]:
    """Returns the clearance beside a box."""
    low, high = np.array([x0, y0]), np.array([x1, y1])
    return lambda points: np.asarray(np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=-1))


NOWHERE = box(50.0, 51.0, 0.0, 1.0)


def plan(clearance: Callable[[F64], F64], offset: float = 0.0, planner: LatticePlanner | None = None) -> LocalPlan:
    """Returns the plan along the x axis."""
    points = np.column_stack([STATIONS, np.zeros(21)])
    return (planner or LatticePlanner()).plan(STATIONS, points, np.tile([0.0, 1.0], (21, 1)), offset, clearance)


def test_plan_is_the_path_where_there_are_no_obstacles() -> None:
    found = plan(NOWHERE)
    np.testing.assert_array_equal(found.offsets, np.zeros(21))
    np.testing.assert_allclose(found.points[:, 0], STATIONS)
    assert found.is_free


def test_robot_beside_the_path_comes_back_to_it() -> None:
    found = plan(NOWHERE, offset=-0.3)
    assert found.offsets[0] == pytest.approx(-0.3)
    assert abs(found.offsets[6]) <= 0.05
    assert (np.diff(found.offsets) >= -1e-9).all()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_plan_leads_round_a_box_on_its_free_side(side: float) -> None:
    # 0.4 m wide, and 0.1 m to one side of the path: on the other side the robot needs 0.1 + 0.18 m, on this one 0.3 + 0.18 m.
    low, high = sorted((-0.1 * side, 0.3 * side))
    found = plan(box(0.9, 1.2, low, high))
    beside = found.offsets[9:13]
    assert (side * beside > -0.5).all()
    assert (side * beside <= -0.28 + 1e-9).all()
    assert found.is_free
    assert found.clearance.min() >= MIN_CLEARANCE
    assert abs(found.offsets[-1]) <= 0.05


def test_free_distance_ends_before_a_wall() -> None:
    found = plan(box(1.25, 1.5, -3.0, 3.0))
    # At 1.0 m there are 0.25 m left, at 1.1 m 0.15 m, which is less than the robot needs.
    assert not found.is_free
    assert found.free_distance == pytest.approx(1.1)


def test_robot_that_is_too_near_to_an_obstacle_gets_a_free_plan_away_from_it() -> None:
    found = plan(box(-0.5, 0.1, 0.1, 0.5))
    assert found.clearance[0] < MIN_CLEARANCE
    assert found.is_free
    assert (found.offsets <= 0.0).all()


def test_plan_stays_on_its_side_of_an_obstacle() -> None:
    planner = LatticePlanner()
    before = plan(box(0.9, 1.2, -0.16, 0.2), planner=planner).offsets[10]
    after = plan(box(0.9, 1.2, -0.2, 0.16), planner=planner).offsets[10]  # now the other side is nearer
    assert before < 0.0
    assert after < 0.0
    planner.reset()
    assert plan(box(0.9, 1.2, -0.2, 0.16), planner=planner).offsets[10] > 0.0


def test_settings_out_of_range_are_one_line() -> None:
    with pytest.raises(SettingError, match=r"step is 0, must be 0.02 to 1"):
        LatticeSettings(step=0.0)
