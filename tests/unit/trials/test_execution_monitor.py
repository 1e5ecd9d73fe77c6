"""When a run ends: decided by the stack's reports, the robot's pose and the limits."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from gibson_sim.trials.execution.monitor import Decision, RunMonitor
from gibson_sim.trials.execution.trial_node import TrialInput
from gibson_sim.trials.json_values import json_text, restored
from gibson_sim.trials.records import PlanarPose, RunSpec
from gibson_sim.trials.scenario.spec import GoalInterface, Limits, Reached, Scenario, StackSpec, Status, Verdicts

S = 10**9
TICK = S // 10
"""Period of these tests' ticks, ns."""
AT_GOAL, AWAY = (2.0, 1.0, 0.0), (0.0, 1.0, 0.0)
NEAR, LIMITS = Reached(0.3), Limits(time=20.0)
TELLS = StackSpec(("stack",), status=Status("status"), lockstep=("cmd_vel every 0.05",))


def monitor_of(stack: StackSpec, reached: Reached = NEAR, limits: Limits = LIMITS) -> RunMonitor:
    scenario = Scenario("t", Path("t.yaml"), ("flat",), stack, limits=limits, verdicts=Verdicts(reached=reached))
    return RunMonitor(TrialInput.of(scenario, RunSpec(1, "flat", "gibson_bot", 0, AWAY, AT_GOAL, 2.0, 0.2)))


def pass_time(monitor: RunMonitor, begin: float, end: float, pose: PlanarPose, speed: float) -> tuple[Decision | None, int]:
    """Feeds ticks of a time, seconds; returns the first decision and the stamp of the last tick that was fed."""
    for stamp in range(round(begin * S), round(end * S) + 1, TICK):
        decision = monitor.tick(stamp, pose, speed, 0.0)
        if decision is not None:
            return decision, stamp
    return None, round(end * S)


def test_run_ends_once_the_robot_has_stood_at_the_goal_for_a_second() -> None:
    monitor = monitor_of(StackSpec(("stack",)))
    monitor.give_goal(0)
    assert pass_time(monitor, 0.0, 3.0, AT_GOAL, 0.3) == (None, 3 * S), "it drives through the goal"
    decision, stamp = pass_time(monitor, 3.1, 9.0, AT_GOAL, 0.0)
    assert decision == Decision("reached", "the robot stands 0.000 m from the goal", 3 * S + TICK)
    assert stamp == 4 * S + TICK


def test_robot_that_turns_does_not_stand() -> None:
    monitor = monitor_of(StackSpec(("stack",)))
    monitor.give_goal(0)
    assert all(monitor.tick(k * TICK, AT_GOAL, 0.0, 0.03) is None for k in range(50))


def test_wrong_heading_is_not_the_goal_if_the_heading_counts() -> None:
    monitor = monitor_of(StackSpec(("stack",)), Reached(0.3, yaw_within_deg=10.0))
    monitor.give_goal(0)
    assert pass_time(monitor, 0.0, 5.0, (2.0, 1.0, math.radians(11.0)), 0.0)[0] is None
    assert pass_time(monitor, 5.1, 9.0, (2.0, 1.0, math.radians(-9.0)), 0.0)[0] is not None


def test_reported_state_of_the_stack_decides_and_not_the_pose() -> None:
    monitor = monitor_of(TELLS)
    monitor.give_goal(0)
    assert pass_time(monitor, 0.0, 5.0, AT_GOAL, 0.0)[0] is None
    monitor.receive_status("driving 2,1")
    assert pass_time(monitor, 5.1, 6.0, AT_GOAL, 0.0)[0] is None
    assert not monitor.end_was_reported


@pytest.mark.parametrize("arrives", [3.1, 3.2])
def test_run_ends_at_the_same_tick_whether_the_text_comes_at_one_tick_or_the_next(arrives: float) -> None:
    monitor = monitor_of(TELLS)
    monitor.give_goal(0)
    pass_time(monitor, 0.0, arrives, AWAY, 0.2)
    monitor.receive_status("reached 2,1")
    pass_time(monitor, arrives + 0.1, 3.6, AWAY, 0.2)
    decision, stamp = pass_time(monitor, 3.7, 9.0, AWAY, 0.0)
    assert decision == Decision("reached", "the stack reports 'reached 2,1'", round(arrives * S))
    assert stamp == 5 * S, "it stands from 3.7 s on, for a second at 4.7 s; the next half second is at 5 s"


def test_run_of_a_robot_that_never_stops_ends_five_seconds_after_the_reported_end() -> None:
    monitor = monitor_of(TELLS)
    monitor.give_goal(0)
    pass_time(monitor, 0.0, 1.0, AWAY, 0.2)
    monitor.receive_status("failed: no path")
    decision, stamp = pass_time(monitor, 1.1, 19.0, AWAY, 0.2)
    assert decision is not None and decision.end == "gave up"
    assert stamp == 6 * S


def test_the_last_text_that_matches_counts() -> None:
    monitor = monitor_of(TELLS)
    monitor.give_goal(0)
    monitor.receive_status("failed: blocked")
    monitor.receive_status("recovering")
    monitor.receive_status("reached")
    monitor.receive_status("idle")
    decision, _ = pass_time(monitor, 0.0, 9.0, AT_GOAL, 0.0)
    assert decision is not None and decision.end == "reached"
    assert monitor.status == "idle"


def test_status_text_before_the_goal_does_not_count() -> None:
    monitor = monitor_of(TELLS)
    monitor.receive_status("reached the dock")
    monitor.give_goal(0)
    assert pass_time(monitor, 0.0, 5.0, AT_GOAL, 0.0)[0] is None


def test_long_status_text_is_cut_with_a_mark_and_still_matches_at_its_end() -> None:
    monitor = monitor_of(TELLS)
    monitor.give_goal(0)
    monitor.receive_status("x" * 7_000_000 + " reached")
    assert monitor.status == "x" * 2000 + " [... 6998008 characters cut ...]"
    assert monitor.end_was_reported
    monitor.receive_status("y" * 2000)
    assert monitor.status == "y" * 2000


def test_result_of_an_action_decides() -> None:
    monitor = monitor_of(StackSpec(("stack",), goal=GoalInterface("action", "navigate", "a_msgs/action/Go")))
    monitor.give_goal(0)
    monitor.receive_result(False, "was aborted")
    decision, _ = pass_time(monitor, 0.0, 9.0, AT_GOAL, 0.0)
    assert decision == Decision("gave up", "the action was aborted", 0)


def test_time_limit_counts_from_the_goal() -> None:
    monitor = monitor_of(TELLS, limits=Limits(time=2.0))
    pass_time(monitor, 0.0, 1.0, AWAY, 0.2)
    monitor.give_goal(S)
    decision, stamp = pass_time(monitor, 1.1, 9.0, AWAY, 0.2)
    assert decision == Decision("time limit", "2 s after the goal was sent, 2.00 m from it; the limit is 2 s", 3 * S)
    assert stamp == 3 * S


def test_silence_of_a_stack_ends_the_run_after_the_limit() -> None:
    monitor = monitor_of(TELLS, limits=Limits(silence=4.0))
    monitor.give_goal(0)
    pass_time(monitor, 0.0, 3.0, AWAY, 0.2)
    assert monitor.silence(3.9) is None
    expected = "no message on cmd_vel within 4 s of wall time, at 3.000 s"
    assert monitor.silence(4.0) == Decision("stack silent", expected, 3 * S)


def test_silence_of_a_stack_that_has_reported_its_end_is_that_end() -> None:
    monitor = monitor_of(TELLS)
    monitor.give_goal(0)
    pass_time(monitor, 0.0, 3.0, AT_GOAL, 0.2)
    monitor.receive_status("reached")
    assert monitor.silence(0.1) == Decision("reached", "the stack reports 'reached'", 3 * S)


def test_input_of_the_trial_node_survives_its_file() -> None:
    stack = StackSpec(("stack",), lockstep=("nav=cmd_vel every 0.05 from goal_pose", "pose after scan"))
    scenario = Scenario("t", Path("t.yaml"), ("flat",), stack, verdicts=Verdicts(reached=None))
    given = TrialInput.of(scenario, RunSpec(1, "flat", "gibson_bot", 0, AWAY, AT_GOAL, 2.0, 0.2), "mark")
    assert restored(TrialInput, json.loads(json_text(given))) == given
    assert (given.answers, given.lockstep, given.goal_topic) == (("cmd_vel", "pose"), True, "goal_pose")
