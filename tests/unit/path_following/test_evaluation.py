"""Drives are judged by numbers that can be checked by hand."""

from __future__ import annotations

import math

import pytest

from gibson_path_following.errors import SettingError
from gibson_path_following.paths.evaluation import EvaluationSettings, TracePoint, evaluate, node_positions, verdict
from support.path_views import straight_path

NODES = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0)]
S = 1_000_000_000


def test_a_drive_beside_the_path_succeeds() -> None:
    # 1 m to the left and back would be no success; 0.3 m is. The way: 0.3 m aside, 3 m along.
    found = evaluate(NODES, [TracePoint(0, 0.0, 0.0, 0.0), TracePoint(S, 0.0, 0.3, 0.0), TracePoint(7 * S, 3.0, 0.3, 0.0)])
    assert found.success and found.arrived and found.collisions == 0
    assert found.coverage == 1.0  # the line between the points counts, not the points alone
    assert found.travelled == pytest.approx(3.3)
    assert found.path_length == pytest.approx(3.0)
    assert found.spl == pytest.approx(3.0 / 3.3)
    assert found.end_distance == pytest.approx(0.3)
    assert found.deviation_max == pytest.approx(0.3)
    # Weights are half of the steps beside a point: (0.3 x 0 + 1.65 x 0.3 + 3 x 0.3) / 4.95
    assert found.deviation_mean == pytest.approx(0.3 * 4.65 / 4.95)
    assert found.duration == pytest.approx(7.0)


def test_overshooting_the_end_of_the_path_is_no_arrival() -> None:
    found = evaluate(NODES, [TracePoint(i * S, float(x), 0.0, 0.0) for i, x in enumerate((0, 1, 2, 3, 4))])
    assert found.coverage == 1.0
    assert not found.arrived and not found.success and found.spl == 0.0
    assert found.deviation_max == pytest.approx(1.0)


def test_contacts_close_in_time_are_one_collision() -> None:
    hits = {2, 3, 4, 9}  # at 0.2 s each: the last is 1 s after the others
    trace = [TracePoint(i * S // 5, 0.3 * i, 0.0, 0.0, i in hits) for i in range(11)]
    found = evaluate(NODES, trace)
    assert found.collisions == 2
    assert found.collisions_per_metre == pytest.approx(2 / 3.0)
    assert found.arrived and not found.success and found.spl == 0.0
    assert evaluate(NODES, trace, EvaluationSettings(collision_gap=2.0)).collisions == 1


@pytest.mark.parametrize(
    ("end", "hits", "line"),
    [
        (2.75, set(), "success: 0.25 m from the end of the path, no collision"),
        (2.75, {1}, "failure: 0.25 m from the end of the path, 1 collision (allowed: none)"),
        (2.0, set(), "failure: 1.00 m from the end of the path (allowed: 0.5 m), no collision"),
        (2.0, {1, 5}, "failure: 1.00 m from the end of the path (allowed: 0.5 m), 2 collisions (allowed: none)"),
    ],
)
def test_a_verdict_says_why(end: float, hits: set[int], line: str) -> None:
    trace = [TracePoint(i * S, i * end / 8, 0.0, 0.0, i in hits) for i in range(9)]
    assert verdict(evaluate(NODES, trace), 0.5) == line


def test_a_robot_that_stands_is_judged_too() -> None:
    found = evaluate(NODES, [TracePoint(0, 0.0, 0.2, 0.0, True), TracePoint(S, 0.0, 0.2, 0.0, True)])
    assert (found.travelled, found.collisions, found.collisions_per_metre) == (0.0, 1, 0.0)
    assert found.deviation_mean == pytest.approx(0.2)
    assert found.coverage == 0.25
    assert found.spl == 0.0


def test_recordings_that_cannot_be_judged_are_refused() -> None:
    with pytest.raises(SettingError, match=r"0 nodes and 1 points of a trace"):
        evaluate([], [TracePoint(0, 0.0, 0.0, 0.0)])
    with pytest.raises(SettingError, match=r"holds a NaN or an infinity"):
        evaluate(NODES, [TracePoint(0, math.nan, 0.0, 0.0)])
    with pytest.raises(SettingError, match=r"arrival_radius is 0 m, must be above 0"):
        EvaluationSettings(arrival_radius=0.0)


def test_positions_are_those_of_the_poses() -> None:
    assert node_positions(straight_path(3)) == ((0.0, 0.0), (0.2, 0.0), (0.4, 0.0))
