"""When a trajectory or a gripper reaches its goal, and when it fails."""

from __future__ import annotations

import math

import pytest

from gibson_sim.errors import CommandError
from gibson_sim.robots.joints.goals import GripperGoal, Tolerance, TrajectoryCode, TrajectoryGoal

S = 1_000_000_000
STILL = {"a": 0.0, "b": 0.0}


def outcome(goal: TrajectoryGoal, seconds: float, a: float, b: float, *, desired: float = 1.0, speed: float = 0.0) -> object:
    found = goal.outcome(round(seconds * S), {"a": desired, "b": 2.0}, {"a": a, "b": b}, {"a": speed, "b": 0.0})
    return None if found is None else found.code


def test_goal_is_reached_when_time_is_over_and_all_joints_are_there() -> None:
    goal = TrajectoryGoal(("a", "b"), (1.0, 2.0), 3 * S)
    assert outcome(goal, 2.9, 1.0, 2.0) is None
    assert outcome(goal, 3.0, 1.009, 1.991) is TrajectoryCode.SUCCESSFUL
    assert outcome(goal, 3.0, 1.011, 2.0) is None
    assert outcome(goal, 5.0, 1.011, 2.0) is None
    assert outcome(goal, 5.1, 1.011, 2.0) is TrajectoryCode.GOAL_TOLERANCE_VIOLATED


def test_tolerances_of_the_goal_replace_the_defaults() -> None:
    rules = {"a": Tolerance(0.5, 0.1), "b": Tolerance(-1.0)}
    goal = TrajectoryGoal(("a", "b"), (1.0, 2.0), 3 * S, goal=rules, goal_time=0.5)
    assert outcome(goal, 3.0, 1.4, 99.0) is TrajectoryCode.SUCCESSFUL
    assert outcome(goal, 3.0, 1.4, 99.0, speed=0.2) is None
    assert outcome(goal, 3.6, 1.4, 99.0, speed=0.2) is TrajectoryCode.GOAL_TOLERANCE_VIOLATED


def test_path_counts_only_where_the_goal_says_so() -> None:
    assert outcome(TrajectoryGoal(("a", "b"), (1.0, 2.0), 3 * S), 1.0, -9.0, 2.0) is None
    goal = TrajectoryGoal(("a", "b"), (1.0, 2.0), 3 * S, path={"a": Tolerance(0.1)})
    assert outcome(goal, 1.0, 0.95, 2.0) is None
    assert outcome(goal, 1.0, 0.89, 2.0) is TrajectoryCode.PATH_TOLERANCE_VIOLATED


def test_reasons_name_the_joint_and_the_number() -> None:
    goal = TrajectoryGoal(("a", "b"), (1.0, 2.0), 3 * S)
    found = goal.outcome(6 * S, {}, {"a": 1.5, "b": 2.0}, STILL)
    assert found is not None
    assert found.reason == "joint 'a' is 0.5 off its goal, allowed are 0.01, 3.00 s after the end of the trajectory"


def test_strange_joints_and_tolerances_are_refused() -> None:
    with pytest.raises(CommandError, match="joint 'b' does not belong to this controller: a, c"):
        TrajectoryGoal(("a", "b"), (1.0, 2.0), 3 * S).check(("a", "c"))
    with pytest.raises(CommandError, match="tolerance is given for joint 'c', which the trajectory does not move: a"):
        TrajectoryGoal(("a",), (1.0,), 3 * S, path={"c": Tolerance(0.1)}).check(("a", "c"))
    with pytest.raises(CommandError, match="tolerance of a joint is nan"):
        Tolerance(math.nan)


def test_gripper_is_there_or_stalls_after_a_fifth_of_a_second() -> None:
    goal = GripperGoal(("a", "b"), 0.0, 0)
    moving = goal.outcome(S, {"a": 0.02, "b": 0.02}, {"a": -0.1, "b": 0.0}, {"a": -3.0, "b": 5.0})
    assert (moving.position, moving.effort, moving.is_over) == (0.02, 5.0, False)
    at = {"a": 0.01, "b": 0.03}
    assert not goal.outcome(S + S // 10, at, STILL, STILL).is_over
    held = goal.outcome(S + S // 5, at, STILL, STILL)
    assert (held.position, held.stalled, held.reached_goal) == (0.02, True, False)
    there = goal.outcome(2 * S, {"a": 0.001, "b": 0.002}, STILL, STILL)
    assert (there.stalled, there.reached_goal) == (False, True)
