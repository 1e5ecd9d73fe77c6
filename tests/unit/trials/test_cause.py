"""The first thing that went wrong in made-up runs, and what must not be blamed. The usual run drives 5 m in 10 s and is good."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gibson_sim.trials.judging import judge
from gibson_sim.trials.records import Cause, Person, PlacedObject
from support.run_bags import DRIVES_THERE, GOAL, START, Run, along, commands, messages, planned, scenario, until

FOREVER = commands((0.0, 12.0, 0.5))
UP = commands((0.0, 4.0, 0.5))


def stands(_: float) -> tuple[float, float, float]:
    return START


def shifted(metres: float, at: float = 5.0, back: float = 0.0) -> list[tuple[float, float, float, float]]:
    """Returns corrections that are right until a time, then off by some metres, and right again from ``back`` on."""
    right = [(-1.0, 1.0, 2.0, 0.0), *((round(0.1 * k, 1), 1.0, 2.0, 0.0) for k in range(round(10 * at)))]
    wrong = [(at, 1.0, 2.0 + metres, 0.0)]
    return right + wrong + ([(back, 1.0, 2.0, 0.0)] if back else [])


def blamed(
    folder: Path, run: Run, end: str = "time limit", *, spec: Any = None, limits: Any = None, **outcome: Any
) -> Cause | None:
    """Returns the cause of a run."""
    return judge(limits or scenario(), spec or planned(), run.outcome(end, **outcome), run.write(folder)).cause


def sure(cause: Cause | None) -> Cause:
    assert cause is not None
    return cause


@pytest.mark.parametrize(
    "run",
    [
        Run(),
        Run(corrections=shifted(0.1)),
        Run(commands=[*DRIVES_THERE, *commands((12.0, 30.0, 0.0))], duration=30.0),
        Run(touches=[(-0.5, 0.0, "wall")], truth=lambda t: along(t)),
        Run(plans=[(0.2, ((1.0, 2.0), (5.0, 0.1), (6.0, 2.0))), (1.0, (START[:2], GOAL[:2]))]),
        Run(corrections=shifted(0.9, 3.0, 6.0)),
    ],
    ids=["straight", "small jump", "stands at the goal", "touch from before", "bad plan that was replaced", "jump and back"],
)
def test_nothing_is_blamed_in_a_run_that_passed(tmp_path: Path, run: Run) -> None:
    limits = scenario(collisions=1) if run.touches else scenario()
    assert blamed(tmp_path, run, "reached", limits=limits) is None


def test_jump_of_the_localisation_is_blamed_for_the_collision_after_it(tmp_path: Path) -> None:
    run = Run(truth=until(7.5, 4.75), corrections=shifted(0.8), touches=[(7.5, 12.0, "wall_11")], commands=FOREVER)
    cause = sure(blamed(tmp_path, run))
    assert (cause.kind, cause.time) == ("localisation jumped", 5.0)
    assert cause.text == (
        "after 5.0 s, at (3.50, 2.00): the localisation jumped by 0.80 m, from 0.00 m off the truth to 0.80 m; "
        "2.5 s later the robot hit wall_11 at 0.50 m/s; 2.5 s later the robot was blocked by wall_11 for 4.5 s"
    )


def test_jump_of_the_yaw_counts(tmp_path: Path) -> None:
    """By 40 degrees about the robot, at odometry (2.5, 0): map -> odom turns, and moves so that the robot stays."""
    a = math.radians(40.0)
    turn = (5.0, 3.5 - 2.5 * math.cos(a), 2.0 - 2.5 * math.sin(a), a)
    run = Run(truth=until(7.5, 4.75), corrections=[(-1.0, 1.0, 2.0, 0.0), turn], touches=[(7.5, 8.0, "wall")])
    cause = sure(blamed(tmp_path, run))
    assert cause.kind == "localisation jumped"
    assert "jumped by 0.00 m and 40 deg" in cause.text


def test_jump_back_to_the_truth_is_not_blamed(tmp_path: Path) -> None:
    """The initial pose was 0.45 m off, which is not off yet, to the left; the first scans correct it by more than that."""
    run = Run(truth=until(4.0, 3.0), corrections=[(-1.0, 1.0, 2.45, 0.0), (1.0, 1.0, 1.9, 0.0)], touches=[(4.0, 4.5, "box")])
    assert sure(blamed(tmp_path, run)).kind == "collision"


def test_localisation_that_drifts_off_is_blamed_from_where_it_left_the_truth(tmp_path: Path) -> None:
    """By 0.1 m each second: 0.5 m are passed with the correction of 6 s, to 0.6 m."""
    drift = [(float(k), 1.0, 2.0 + 0.1 * max(k, 0), 0.0) for k in range(-1, 12)]
    cause = sure(blamed(tmp_path, Run(truth=until(9.0, 5.5), corrections=drift, touches=[(9.0, 9.5, "shelf")])))
    assert (cause.kind, cause.time) == ("localisation off", 6.0)
    assert "off for 6.0 s, by up to 1.10 m and 0 deg; 3.0 s later the robot hit shelf" in cause.text


def test_localisation_that_recovered_long_before_a_collision_is_not_blamed(tmp_path: Path) -> None:
    run = Run(corrections=shifted(0.8, 1.0, 3.0), touches=[(8.5, 8.6, "chair")])
    cause = sure(blamed(tmp_path, run, "reached"))
    assert (cause.kind, cause.time) == ("collision", 8.5)
    assert cause.text == "after 8.5 s, at (5.25, 2.00): the robot hit chair at 0.50 m/s"


def test_localisation_from_a_pose_topic(tmp_path: Path) -> None:
    """Without map -> odom: the pose is right, and 0.9 m beside the truth from 5 s on."""
    poses = []
    for k in range(13):
        x, y, yaw = along(k)
        poses.append((float(k), "/pose", messages().estimate(k, (x, y + 0.9 * (k >= 5), yaw))))
    run = Run(truth=until(7.5, 4.75), corrections=[], extra=poses, touches=[(7.5, 8.0, "wall")])
    cause = sure(blamed(tmp_path, run))
    assert (cause.kind, cause.time) == ("localisation jumped", 5.0)


def test_goal_reported_at_the_wrong_place_is_the_localisation_s_fault(tmp_path: Path) -> None:
    """0.4 m off at the end, less than what is off elsewhere; the stack believes itself at the goal."""
    run = Run(truth=until(9.2, 5.6), odometry=lambda t: (along(t)[0] - 1.0, 0.0, 0.0))
    cause = sure(blamed(tmp_path, run, "reached"))
    assert cause.kind == "localisation off"
    assert "by 0.40 m at the end, so that the stack mistook a place 0.40 m away for the goal" in cause.text


def test_localisation_is_not_blamed_for_the_last_centimetres_of_a_goal_that_was_reached(tmp_path: Path) -> None:
    run = Run(truth=until(9.2, 5.9), odometry=lambda t: (along(t)[0] - 1.0, 0.0, 0.0), touches=[(9.9, 9.95, "chair")])
    assert sure(blamed(tmp_path, run, "reached")).kind == "collision"


def test_no_plan(tmp_path: Path) -> None:
    run = Run(truth=stands, plans=[], commands=[])
    cause = sure(blamed(tmp_path, run, "gave up", status="failed: the goal is in a wall"))
    assert cause.kind == "no plan"
    assert cause.text == (
        "after 0.0 s, at (1.00, 2.00): the stack had its goal, but published no plan and sent no command; "
        "12.0 s later the stack gave up 5.00 m from the goal: failed: the goal is in a wall"
    )


def test_goal_that_the_stack_refused_is_not_one_without_a_plan(tmp_path: Path) -> None:
    run = Run(truth=stands, plans=[], commands=[])
    cause = sure(blamed(tmp_path, run, "gave up", detail="the action did not accept the goal"))
    assert cause.kind == "gave up"
    assert cause.text.endswith("the stack gave up 5.00 m from the goal: the action did not accept the goal")


def test_plan_without_commands(tmp_path: Path) -> None:
    assert sure(blamed(tmp_path, Run(truth=stands, commands=commands((0.0, 12.0, 0.0))))).kind == "no command"


def test_commands_that_stop(tmp_path: Path) -> None:
    """The last one is of 3.9 s, and holds for half a second."""
    cause = sure(blamed(tmp_path, Run(truth=until(4.0, 3.0), commands=UP)))
    assert (cause.kind, cause.time) == ("no command", pytest.approx(4.4, abs=0.11))


def test_a_stack_without_plans_that_drives_is_not_blamed_for_it(tmp_path: Path) -> None:
    run = Run(truth=lambda t: along(t, 0.2), plans=[], commands=commands((0.0, 12.0, 0.2)))
    cause = sure(blamed(tmp_path, run))
    assert cause.kind == "too slow"
    assert (
        cause.text == "after 12.0 s, at (3.40, 2.00): the robot was still driving at the time limit of 12 s, 2.60 m from the goal"
    )


def test_plan_through_the_map(tmp_path: Path) -> None:
    """To a point 0.10 m from the lower wall, whose edge is at y = 0.05; from 6 s on it touches the wall."""
    run = Run(
        truth=lambda t: (along(t)[0], max(0.2, 2.0 - 0.3 * max(t, 0.0)), 0.0),
        plans=[(0.2, ((1.0, 2.0), (4.0, 0.15), (6.0, 2.0)))],
        touches=[(6.0, 7.0, "wall_2")],
    )
    cause = sure(blamed(tmp_path, run, spec=planned(goal=(6.0, 0.2, 0.0))))
    assert (cause.kind, cause.time) == ("plan through obstacle", 0.2)
    assert (
        "the plan led through the map at (4.00, 0.15): 0.10 m from it, with a robot radius of 0.20 m; 5.8 s later the robot hit wall_2"
        in cause.text
    )


def test_plan_through_the_map_elsewhere_is_not_blamed(tmp_path: Path) -> None:
    """The robot hits a box three metres before the place where its plan touches the wall."""
    run = Run(truth=until(2.0, 2.0), plans=[(0.2, ((1.0, 2.0), (5.0, 0.1), (6.0, 2.0)))], touches=[(2.0, 2.1, "box")])
    assert sure(blamed(tmp_path, run)).kind == "collision"


def test_the_failed_place_on_the_plan_is_reported(tmp_path: Path) -> None:
    """The plan touches the wall at x = 2, where the robot passes without a contact, and at x = 5, where it has one."""
    plan = ((1.0, 2.0), (2.0, 0.15), (3.5, 2.0), (5.0, 0.15), (6.0, 2.0))
    run = Run(
        truth=lambda t: (along(t)[0], float(np.interp(along(t)[0], *zip(*plan, strict=True))), 0.0), plans=[(0.2, plan)],
        touches=[(8.0, 8.1, "wall_2")],
    )  # fmt: skip
    cause = sure(blamed(tmp_path, run, "reached"))
    assert cause.kind == "plan through obstacle"
    assert "the plan led through the map at (5.00, 0.15)" in cause.text


def test_plan_that_is_as_near_as_the_robot_is_wide_is_not_blamed(tmp_path: Path) -> None:
    """0.19 m from the wall with a robot of 0.20 m: less than half a cell too near."""
    run = Run(
        truth=lambda t: (along(t)[0], max(0.24, 2.0 - 0.3 * max(t, 0.0)), 0.0), plans=[(0.2, ((1.0, 2.0), (4.0, 0.24), (6.0, 0.24)))],
        touches=[(6.0, 7.0, "wall_2")],
    )  # fmt: skip
    assert sure(blamed(tmp_path, run, spec=planned(goal=(6.0, 0.24, 0.0)))).kind == "collision"


def test_plan_through_a_spawned_object(tmp_path: Path) -> None:
    """In a scene of ours, so that its rooms are named: the box is on the straight path, in the living room of the flat."""
    box = PlacedObject("box_1", "box_cardboard", (2.0, 2.0, 0.0), 0.1)
    run = Run(truth=until(1.4, 1.7), touches=[(1.4, 12.0, "box_1")], commands=FOREVER)
    cause = sure(blamed(tmp_path, run, spec=planned(scene="flat", things=(box,))))
    assert cause.kind == "plan through obstacle"
    assert cause.text.startswith("after 0.2 s, at (1.10, 2.00) in living: the plan led through box_1 at ")
    assert "1.2 s later the robot hit box_1" in cause.text


def test_ignored_commands(tmp_path: Path) -> None:
    cause = sure(blamed(tmp_path, Run(truth=stands, commands=FOREVER)))
    assert cause.kind == "command ignored"
    assert cause.text == (
        "after 0.0 s, at (1.00, 2.00): the robot stood for 12.0 s although it was commanded to drive, and touched nothing"
    )


def test_commands_that_never_arrived(tmp_path: Path) -> None:
    cause = sure(blamed(tmp_path, Run(truth=stands, commands=FOREVER, applied=[])))
    assert cause.text.endswith(
        "and touched nothing: the simulation received none of the commands; their type or QoS does not match"
    )


def test_commands_of_a_type_that_no_robot_takes(tmp_path: Path) -> None:
    vector = messages().vector(0.5)
    run = Run(truth=stands, commands=[], types={"/cmd_vel": "geometry_msgs/msg/Vector3"}, extra=[(1.0, "/cmd_vel", vector)])
    cause = sure(blamed(tmp_path, run))
    assert cause.kind == "command ignored"
    assert "/cmd_vel of type geometry_msgs/msg/Vector3, must be Twist or TwistStamped on cmd_vel" in cause.text


def test_commands_on_another_topic(tmp_path: Path) -> None:
    sent = [(t, "/cmd_vel_nav", messages().twist(v)) for t, v, _ in FOREVER]
    run = Run(truth=stands, commands=[], types={"/cmd_vel_nav": "geometry_msgs/msg/Twist"}, extra=sent)
    cause = sure(blamed(tmp_path, run))
    assert cause.kind == "command ignored"
    assert "/cmd_vel_nav of type geometry_msgs/msg/Twist, must be Twist or TwistStamped on cmd_vel" in cause.text


def test_pause_in_commands_that_are_ignored_does_not_end_them(tmp_path: Path) -> None:
    """A second without commands."""
    run = Run(truth=stands, commands=commands((0.0, 3.0, 0.5), (4.0, 12.0, 0.5)))
    assert "the robot stood for 12.0 s" in sure(blamed(tmp_path, run)).text


def test_commands_to_turn_that_are_followed_are_not_ignored(tmp_path: Path) -> None:
    """It turns on the spot all the time: it does not drive, and is not commanded to."""
    turning = [(t, 0.0, 0.5) for t, _, _ in FOREVER]
    cause = sure(blamed(tmp_path, Run(truth=lambda t: (1.0, 2.0, 0.5 * t), commands=turning)))
    assert cause.kind == "unknown"
    assert "5.00 m from the goal, and had moved 0.00 m in the last 10 s" in cause.text


def test_blocked_where_collisions_are_allowed(tmp_path: Path) -> None:
    run = Run(truth=until(4.0, 3.0), touches=[(4.0, 12.0, "box_1")], commands=FOREVER)
    cause = sure(blamed(tmp_path, run, limits=scenario(collisions=None)))
    assert (cause.kind, cause.text) == ("blocked", "after 4.0 s, at (3.00, 2.00): the robot was blocked by box_1 for 8.0 s")


def test_closed_door_is_named_as_one(tmp_path: Path) -> None:
    run = Run(truth=until(4.0, 3.0), touches=[(4.0, 12.0, "hall_door")], commands=FOREVER)
    cause = sure(blamed(tmp_path, run, limits=scenario(collisions=None), spec=planned(closed_doors=("hall_door",))))
    assert "the robot was blocked by the closed door hall_door" in cause.text


def test_wheels_that_turn_on_the_spot(tmp_path: Path) -> None:
    run = Run(truth=stands, odometry=lambda t: (0.5 * max(t, 0.0), 0.0, 0.0), commands=FOREVER)
    cause = sure(blamed(tmp_path, run))
    assert cause.kind == "slipped"
    assert "the robot stood for 12.0 s although it was commanded to drive, and its wheels turned on the spot" in cause.text


def test_slip(tmp_path: Path) -> None:
    """The wheels drive at 0.5 m/s, the robot at 0.2: 2.5 m and 1.0 m in 5 s."""
    run = Run(truth=lambda t: along(t, 0.2), odometry=lambda t: (0.5 * max(t, 0.0), 0.0, 0.0), commands=FOREVER)
    cause = sure(blamed(tmp_path, run))
    assert cause.kind == "slipped"
    assert "the wheels slipped: odometry measured 2.50 m in 5 s, the robot moved 1.00 m" in cause.text


def test_usual_slip_is_not_blamed(tmp_path: Path) -> None:
    """A tenth of the motion is lost, and the localisation makes up for it."""
    fixes = [(0.5 * k, 1.0 - 0.05 * 0.5 * k, 2.0, 0.0) for k in range(25)]
    run = Run(
        truth=lambda t: along(t, 0.2),
        odometry=lambda t: (0.22 * max(t, 0.0), 0.0, 0.0),
        corrections=fixes,
        commands=commands((0.0, 12.0, 0.2)),
    )
    assert sure(blamed(tmp_path, run)).kind == "too slow"


def test_spinning_wheels_against_a_wall_are_blocked_not_slip(tmp_path: Path) -> None:
    run = Run(
        truth=until(4.0, 3.0), odometry=lambda t: (0.5 * max(t, 0.0), 0.0, 0.0), touches=[(4.0, 12.0, "wall")], commands=FOREVER,
    )  # fmt: skip
    assert sure(blamed(tmp_path, run, limits=scenario(collisions=None))).kind == "blocked"


def test_collision_with_a_person(tmp_path: Path) -> None:
    spec = planned(people=(Person("person_1", ((3.0, 1.0), (3.0, 3.0)), 0.8, 0.25, 1.75),))
    cause = sure(blamed(tmp_path, Run(touches=[(4.0, 4.2, "person_1")]), "reached", spec=spec))
    assert (cause.kind, cause.text) == (
        "collision",
        "after 4.0 s, at (3.00, 2.00): the robot hit the person person_1 at 0.50 m/s",
    )


def test_person_who_walks_into_a_standing_robot(tmp_path: Path) -> None:
    spec = planned(people=(Person("person_1", ((3.0, 1.0), (3.0, 3.0)), 0.8, 0.25, 1.75),))
    cause = sure(blamed(tmp_path, Run(touches=[(11.0, 11.2, "person_1")]), "reached", spec=spec))
    assert "the person person_1 walked into the standing robot" in cause.text


def test_the_first_collision_beyond_the_limit_is_blamed(tmp_path: Path) -> None:
    touches = [(2.0, 2.1, "a"), (4.0, 4.1, "b"), (6.0, 6.1, "c")]
    cause = sure(blamed(tmp_path, Run(touches=touches), "reached", limits=scenario(collisions=1)))
    assert (cause.kind, cause.time) == ("collision", 4.0)


def test_commands_that_are_not_finite(tmp_path: Path) -> None:
    """Every second one up to 5.0 s, which are 25, and the other 69."""
    bad = [(t, math.nan if k % 2 or t > 5.0 else 0.5, 0.0) for k, (t, _, _) in enumerate(FOREVER)]
    cause = sure(blamed(tmp_path, Run(truth=until(5.0, 3.5), commands=bad)))
    assert (cause.kind, cause.time) == ("bad command", 0.1)
    assert "not finite (94 of 120 on /cmd_vel)" in cause.text


def test_one_command_that_is_not_finite_is_not_blamed(tmp_path: Path) -> None:
    one = [(t, math.nan if t == 3.0 else 0.2, 0.0) for t, _, _ in FOREVER]
    assert sure(blamed(tmp_path, Run(truth=lambda t: along(t, 0.2), commands=one))).kind == "too slow"


def test_refused_commands_that_are_not_in_the_bag(tmp_path: Path) -> None:
    cause = sure(blamed(tmp_path, Run(truth=stands, without=["/cmd_vel"]), refused_commands=40))
    assert cause.kind == "bad command"
    assert "rejected 40 commands" in cause.text


@pytest.mark.parametrize(
    ("end", "kind"),
    [
        ("simulation failed", "simulation failed"),
        ("stack silent", "stack silent"),
        ("stack died", "stack died"),
        ("interrupted", "unknown"),
    ],
)
def test_ends_that_are_their_own_cause(tmp_path: Path, end: str, kind: str) -> None:
    """The localisation is lost meanwhile, which has nothing to do with it."""
    cause = sure(blamed(tmp_path, Run(corrections=shifted(0.8)), end, detail="what happened"))
    assert (cause.kind, cause.text, cause.time) == (kind, f"after 12.0 s: {end}: what happened", 12.0)


def test_collision_before_the_stack_died_comes_first(tmp_path: Path) -> None:
    cause = sure(
        blamed(tmp_path, Run(touches=[(4.0, 4.1, "box")]), "stack died", detail="the stack ended with code 0", exit_code=0)
    )
    assert cause.text == (
        "after 4.0 s, at (3.00, 2.00): the robot hit box at 0.50 m/s; 8.0 s later the stack, 0.00 m from the goal, ended with code 0"
    )


def test_wall_time_limit(tmp_path: Path) -> None:
    cause = sure(
        blamed(
            tmp_path, Run(truth=lambda t: along(t, 0.2), commands=commands((0.0, 12.0, 0.2))), "wall time limit", detail="600 s"
        )
    )
    assert (cause.kind, cause.text) == ("too slow", "after 12.0 s: wall time limit: 600 s")


def test_stack_that_gave_up(tmp_path: Path) -> None:
    run = Run(duration=5.0, truth=until(4.0, 3.0), commands=UP)
    cause = sure(blamed(tmp_path, run, "gave up", status="failed: no way"))
    assert cause.text == "after 5.0 s, at (3.00, 2.00): the stack gave up 3.00 m from the goal: failed: no way"
    assert cause.kind == "gave up"


def test_only_a_limit_of_quality_was_missed(tmp_path: Path) -> None:
    """The wheels slip meanwhile, which does not make commands rough."""
    run = Run(odometry=lambda t: (1.0 * max(t, 0.0), 0.0, 0.0), corrections=[], commands=DRIVES_THERE)
    cause = sure(blamed(tmp_path, run, "reached", limits=scenario(max_acceleration=0.1)))
    assert cause.kind == "verdict"
    assert cause.text == "max_acceleration: the RMS commanded acceleration was 0.46 m/s^2, more than 0.1 m/s^2"


def test_robot_that_stands_at_the_goal_is_not_blamed_for_standing(tmp_path: Path) -> None:
    """The stack does not tell that it is there, and sends nothing for 8 s."""
    cause = sure(blamed(tmp_path, Run(duration=18.0, commands=commands((0.0, 10.0, 0.5)))))
    assert cause.kind == "verdict"
    assert "at the end, but the stack did not report that it had arrived" in cause.text


def test_missed_time_limit_is_explained_by_an_earlier_blockage(tmp_path: Path) -> None:
    """Too slow for its limit of time, since it was blocked for a while."""
    late = lambda t: along(t) if t < 4.0 else (3.0, 2.0, 0.0) if t < 9.0 else along(t - 5.0)  # noqa: E731
    run = Run(duration=16.0, truth=late, touches=[(4.0, 9.0, "person")], commands=commands((0.0, 15.0, 0.5), (15.0, 16.0, 0.0)))
    cause = sure(blamed(tmp_path, run, "reached", limits=scenario(collisions=None, time=12.0)))
    assert (cause.kind, cause.time) == ("blocked", 4.0)


def test_the_tight_place_of_the_first_failure_is_reported(tmp_path: Path) -> None:
    """It has contact near x = 2, where the plan leaves 0.10 m, and gives up at x = 5, where it leaves 0.05 m."""
    plan = ((1.0, 2.0), (2.0, 0.15), (3.5, 2.0), (5.0, 0.10), (6.0, 2.0))
    run = Run(
        truth=lambda t: (min(5.0, along(t)[0]), float(np.interp(min(5.0, along(t)[0]), *zip(*plan, strict=True))), 0.0),
        plans=[(0.2, plan)], touches=[(2.0, 2.1, "wall_2")],
    )  # fmt: skip
    cause = sure(blamed(tmp_path, run, "gave up"))
    assert "the plan led through the map at (2.00, 0.1" in cause.text
