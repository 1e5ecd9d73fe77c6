"""Plans of runs in a scene of two rooms with a doorway: what is drawn, what is repeatable, and what is refused."""

from __future__ import annotations

import itertools
import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.maps.placement import furnished_floor_map
from gibson_sim.robots.load import load_robot
from gibson_sim.scenes.load import load_scene
from gibson_sim.trials.json_values import json_text, json_values, restored
from gibson_sim.trials.planning.plan import plan_runs
from gibson_sim.trials.planning.seeds import seed_of, stream
from gibson_sim.trials.records import RunSpec
from gibson_sim.trials.scenario.load import ScenarioError, load_scenario
from gibson_sim.trials.scenario.spec import (
    InitialPose,
    Obstacles,
    PersonRule,
    Randomisation,
    Sampling,
    Scenario,
    SpawnRule,
    StackSpec,
)

# scenes/arena: x from 0 to 8.52 m, y from 0 to 4.40 m; a wall at x = 4.26 m, with a doorway from y = 1.75 to 2.65 m.
FIRST, SECOND = "1.5,2.2,0", "7.0,2.2,90"
DOOR = """bodies:
- {name: way, model: door_90_left, pose: {xyz: [4.26, 2.628, 0.0], rpy_deg: [0.0, 0.0, -90.0]}, joints: {hinge: 85.0}}
"""


def scenario(**changes: object) -> Scenario:
    """Returns a scenario in the arena with the example robot."""
    stack = StackSpec((sys.executable,))
    return replace(Scenario("trial", Path("/nowhere/trial.yaml"), ("arena",), stack, runs=3, seed=1), **changes)  # type: ignore[arg-type]


def refusal(**changes: object) -> str:
    """Returns why a scenario cannot be met, without the file."""
    with pytest.raises(ScenarioError) as caught:
        plan_runs(scenario(**changes))
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix("/nowhere/trial.yaml: ")


def house_with_a_door(folder: Path) -> str:
    """Writes the arena with an open door in its doorway; returns its folder."""
    text = (load_scene("arena").root / "scene.yaml").read_text()
    house = folder / "house"
    house.mkdir()
    (house / "scene.yaml").write_text(text + DOOR)
    return str(house)


def test_runs_are_planned_by_number_as_among_all() -> None:
    given = scenario(scenes=("arena", "flat"), robots=("gibson_bot", "skid_bot"), runs=2)
    told: list[tuple[int, int]] = []
    runs = plan_runs(given, [3, 1, 3], lambda done, total: told.append((done, total)))
    assert runs == tuple(plan_runs(replace(given, scenes=("arena",)))[k] for k in (1, 3))
    assert [(run.number, run.robot) for run in runs] == [(1, "gibson_bot"), (3, "skid_bot")]
    assert told == [(0, 2), (1, 2), (2, 2)]
    for number in (-1, 8):
        with pytest.raises(ConfigError, match=f"run {number} does not exist; the plan has runs 0 to 7"):
            plan_runs(given, [number])


def test_given_places_are_taken_in_turn() -> None:
    runs = plan_runs(scenario(starts=(FIRST, "second"), goals=(SECOND, "1.5,2.2,0"), runs=3))
    assert [run.number for run in runs] == [0, 1, 2]
    assert [run.start for run in runs] == [(1.5, 2.2, 0.0), (7.0, 2.2, round(math.pi, 6)), (1.5, 2.2, 0.0)]
    assert runs[0].goal == (7.0, 2.2, round(math.pi / 2, 6))
    # A straight line through the middle of the doorway.
    assert [run.shortest for run in runs] == pytest.approx([5.5] * 3, abs=1e-3)
    assert runs[0].radius == pytest.approx(0.175)
    assert (runs[0].scene, runs[0].robot, runs[0].physics) == ("arena", "gibson_bot", {})


def test_a_pose_may_have_the_name_that_the_simulation_gives_it() -> None:
    (run,) = plan_runs(scenario(starts=("floor_0/first",), goals=(SECOND,), runs=1))
    assert 0.0 < run.start[0] < 4.2


def test_sampled_places_are_free_and_as_far_apart_as_requested() -> None:
    runs = plan_runs(scenario(runs=12, sampling=Sampling((2.0, 4.0), 0.4)))
    floor = furnished_floor_map(load_scene("arena"), load_robot("gibson_bot"))
    ends = np.array([pose[:2] for run in runs for pose in (run.start, run.goal)])
    assert floor.clearance(ends).min() >= 0.4
    assert all(2.0 <= run.shortest <= 4.0 for run in runs)
    assert all(run.shortest >= math.dist(run.start[:2], run.goal[:2]) - 1e-3 for run in runs)
    assert len({run.start for run in runs}) == 12


def test_a_drawn_goal_is_as_far_from_a_given_start_and_the_other_way_round() -> None:
    for given in ({"starts": (FIRST,)}, {"goals": (FIRST,)}):
        for run in plan_runs(scenario(sampling=Sampling((4.0, 5.0)), **given)):
            assert 4.0 <= run.shortest <= 5.0
            assert (1.5, 2.2, 0.0) in (run.start, run.goal)


def test_equal_scenarios_give_equal_plans_in_another_process(tmp_path: Path) -> None:
    file = tmp_path / "trial.yaml"
    file.write_text(
        "scenes: arena\nruns: 2\nrobots: gibson_bot_real\nstack: {command: python}\n"
        "obstacles: {spawn: box_cardboard, people: [{}]}\nrandomise: {slip: [0, 0.1], noise: [1, 2], payload: 1}\n"
    )
    code = (
        "import json, sys; from gibson_sim.trials.planning.plan import plan_runs; "
        "from gibson_sim.trials.scenario.load import load_scenario; "
        "from gibson_sim.trials.json_values import json_values; "
        "print(json.dumps(json_values(plan_runs(load_scenario(sys.argv[1])))))"
    )
    here = json.dumps(json_values(plan_runs(load_scenario(file))))
    done = subprocess.run(
        [sys.executable, "-c", code, str(file)],
        env={**os.environ, "PYTHONHASHSEED": "7"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == here


def test_another_scene_or_robot_or_more_runs_change_no_other_run() -> None:
    def essence(runs: tuple[RunSpec, ...], scene: str, robot: str) -> list[RunSpec]:
        return [replace(run, number=0) for run in runs if (run.scene, run.robot) == (scene, robot)]

    few = plan_runs(scenario(runs=2))
    many = plan_runs(scenario(scenes=("flat", "arena"), robots=("skid_bot", "gibson_bot"), runs=3))
    assert [run.number for run in many] == list(range(12))
    assert essence(many, "arena", "gibson_bot")[:2] == essence(few, "arena", "gibson_bot")
    assert len({run.seed for run in many}) == 12


def test_the_folder_of_a_scenario_changes_no_run(tmp_path: Path) -> None:
    starts = []
    for name in ("one", "two"):
        folder = tmp_path / name
        folder.mkdir()
        house = house_with_a_door(folder)
        runs = plan_runs(scenario(path=folder / "trial.yaml", scenes=(house,), runs=1))
        starts.append((runs[0].start, runs[0].seed))
    assert starts[0] == starts[1]


def test_another_seed_gives_other_runs() -> None:
    one, other = plan_runs(scenario(runs=1)), plan_runs(scenario(runs=1, seed=2))
    assert (one[0].seed, one[0].start) != (other[0].seed, other[0].start)


def test_streams_depend_on_all_names_and_their_borders() -> None:
    assert seed_of(1, "a", "bc") != seed_of(1, "ab", "c") != seed_of(1, "abc")
    assert 0 <= seed_of(3, "x", 4) < 2**48
    assert stream(1, "slip").uniform() == stream(1, "slip").uniform() != stream(1, "noise").uniform()


def test_the_error_of_the_initial_pose_has_its_deviation_and_at_most_two_of_them() -> None:
    given = InitialPose(error_xy=0.1, error_yaw_deg=10.0)
    runs = plan_runs(scenario(runs=60, stack=StackSpec((sys.executable,), initial_pose=given), starts=(FIRST,), goals=(SECOND,)))
    errors = np.array([run.initial_error for run in runs])
    assert (np.abs(errors).max(axis=0) <= np.array([0.2, 0.2, math.radians(20.0)]) + 1e-6).all()
    assert errors.std(axis=0) == pytest.approx([0.09, 0.09, math.radians(9.0)], rel=0.35)


def test_looks_become_settings_of_physics_with_a_seed_of_the_run() -> None:
    runs = plan_runs(scenario(randomise=Randomisation(looks="example"), physics={"map": "off"}))
    assert {run.physics["randomise"] for run in runs} == {"example"}
    assert len({run.physics["randomise_seed"] for run in runs}) == 3
    assert runs[0].physics["map"] == "off"


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"goals": ("4.26,1.0,0",)}, "goals is '4.26,1.0,0', in a wall, furniture or another obstacle in scene 'arena'; the nearest free"),
        ({"starts": (FIRST, "99,0,0")}, "starts[1] is '99,0,0', outside the map of scene 'arena', must be from x -0."),
        ({"goals": ("0.1,2.2,0",)}, "goals is '0.1,2.2,0', 0.08 m from an obstacle, closer than the radius of the robot, 0.18 m,"),
        ({"starts": ("kitchen",)}, "starts is 'kitchen', must be sampled, x,y,yaw_deg in quotes, or a named pose of scene 'arena'; known: "),
        ({"starts": ("frist",)}, "starts is 'frist', must be sampled, x,y,yaw_deg in quotes, or a named pose of scene 'arena'; did you mean"),
        ({"starts": ("1,2",)}, "starts is '1,2', must be x,y,yaw_deg: three finite numbers"),
        ({"goals": ("nan,1,1",)}, "goals is 'nan,1,1', must be x,y,yaw_deg: three finite numbers"),
        ({"starts": (FIRST,), "goals": (FIRST,)}, "goals is at the start of the run"),
        ({"sampling": Sampling((50.0, 60.0))}, "sampling.path_length is 50 to 60 m, but scene 'arena' has no such path for robot 'gibson_bot'"),
        ({"sampling": Sampling(clearance=3.0)}, "sampling.clearance is such that scene 'arena' has no place with 3.00 m around"),
        ({"scenes": ("/nowhere",)}, "scenes is '/nowhere': "),
        ({"obstacles": Obstacles(closed_doors=("gate",))}, "obstacles.closed_doors is 'gate', which is not in scene 'arena'; known: none"),
        ({"obstacles": Obstacles((SpawnRule("mug", 2, "1,1,0"),))}, "obstacles.spawn[0].at is '1,1,0', one place for 2 objects"),
        ({"obstacles": Obstacles((SpawnRule("mug", at="0,0,0"),))}, "obstacles.spawn[0].at is '0,0,0', where 'mug' would overlap an obstacle"),
        ({"obstacles": Obstacles((SpawnRule("husky"),))}, "obstacles.spawn[0].object is 'husky', a robot; must be an object"),
        ({"obstacles": Obstacles(people=(PersonRule(((0.0, 0.0), (90.0, 0.0))),))}, "obstacles.people[0].path has (90, 0), outside the map"),
        ({"obstacles": Obstacles(people=(PersonRule(((1.0, 1.0), (1.0, 1.0))),))}, "obstacles.people[0].path is 0.00 m long"),
    ],
)  # fmt: skip
def test_impossible_requirements_are_refused_before_anything_starts(changes: dict[str, object], told: str) -> None:
    assert refusal(**changes).startswith(told)


def test_all_places_where_the_robot_cannot_stand_are_reported_at_once() -> None:
    with pytest.raises(ScenarioError) as caught:
        plan_runs(scenario(starts=(FIRST, "99,0,0", "98,0,0"), goals=("4.26,1.0,0",), runs=2))
    told = [line.removeprefix("/nowhere/trial.yaml: ").split(",")[0] for line in caught.value.mistakes]
    assert told == ["starts[1] is '99", "goals is '4.26"]  # no run takes the third start


def test_a_robot_that_cannot_drive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "post.urdf").write_text(
        '<robot name="post"><link name="base"><collision><geometry><box size="0.2 0.2 1"/></geometry></collision></link></robot>'
    )
    (tmp_path / "robot.yaml").write_text("urdf: post.urdf\n")
    assert "which has no drive" in refusal(robots=(str(tmp_path / "robot.yaml"),))


def test_a_robot_that_does_not_fit_through_has_no_path() -> None:
    # The Husky is 0.9 m wide and more, as a circle; the doorway is 0.9 m wide.
    told = refusal(robots=("husky",), starts=(FIRST,), goals=(SECOND,))
    assert told.startswith(
        "goals cannot be reached: no path leads from (1.50, 2.20) to (7.00, 2.20) in scene 'arena' for robot 'husky'"
    )


def test_a_closed_door_cuts_given_places_and_keeps_drawn_ones_in_a_room(tmp_path: Path) -> None:
    house = house_with_a_door(tmp_path)
    closed = Obstacles(closed_doors=("all",))
    (run,) = plan_runs(scenario(scenes=(house,), starts=(FIRST,), goals=(SECOND,), runs=1))
    assert run.closed_doors == ()
    told = refusal(scenes=(house,), starts=(FIRST,), goals=(SECOND,), obstacles=closed)
    assert told.startswith(
        f"obstacles.closed_doors leave no path from (1.50, 2.20) to (7.00, 2.20) in scene '{house}'; leave one open"
    )
    for run in plan_runs(scenario(scenes=(house,), obstacles=closed, runs=4, sampling=Sampling((1.0, 3.0)))):
        assert run.closed_doors == ("way",)
        assert (run.start[0] < 4.26) == (run.goal[0] < 4.26)
    either = scenario(scenes=(house,), obstacles=closed, runs=2, sampling=Sampling((1.0, 3.0)), starts=(FIRST, "7.0,2.2,0"))
    assert [run.goal[0] < 4.26 for run in plan_runs(either)] == [True, False]


def test_no_run_begins_where_a_door_that_closes_stands_or_swings(tmp_path: Path) -> None:
    # The hinge is at (4.26, 2.63); the leaf of 0.9 m is at x from 4.3 to 5.1 m, and swings over the square below it.
    given: dict[str, object] = {
        "scenes": (house_with_a_door(tmp_path),),
        "obstacles": Obstacles(closed_doors=("way",)),
        "runs": 1,
    }
    for place in ("4.7,2.65,0", "4.6,2.2,0"):
        told = refusal(**given, starts=(place,), goals=(SECOND,))
        assert told.startswith(f"starts is '{place}', where a door of obstacles.closed_doors stands or swings until it is closed")
    (run,) = plan_runs(scenario(**given, starts=(SECOND,), goals=("4.6,2.2,0",)))
    assert run.goal[:2] == (4.6, 2.2)
    box = Obstacles((SpawnRule("box_cardboard", at="4.9,2.3,0"),), closed_doors=("way",))
    told = refusal(**{**given, "obstacles": box}, starts=(SECOND,), goals=("6.5,1.0,0",))
    assert "'box_cardboard' would block a door that closes" in told


def test_obstacles_stand_beside_the_path_and_leave_a_way_around() -> None:
    rules = Obstacles((SpawnRule("box_cardboard", 3), SpawnRule("chair_wooden", at="sampled")))
    scene = load_scene("arena")
    floor = furnished_floor_map(scene, load_robot("gibson_bot"))
    for run in plan_runs(scenario(obstacles=rules, starts=(FIRST,), goals=(SECOND,), runs=6)):
        assert [thing.object for thing in run.things] == ["box_cardboard"] * 3 + ["chair_wooden"]
        assert len({thing.name for thing in run.things}) == 4
        for thing in run.things:
            assert floor.clearance(thing.pose[:2]) > 0.0
            assert min(math.dist(thing.pose[:2], end[:2]) for end in (run.start, run.goal)) > 0.175 + 0.3
        for a, b in itertools.combinations(run.things, 2):
            assert math.dist(a.pose[:2], b.pose[:2]) > 0.15
        # Boxes are at most 0.3 m beside the robot on the straight line; the chair may be anywhere.
        assert all(abs(thing.pose[1] - 2.2) <= 0.476 for thing in run.things[:3])
        assert run.shortest >= 5.5 - 1e-3


def test_an_obstacle_that_would_block_the_path_is_refused() -> None:
    told = refusal(obstacles=Obstacles((SpawnRule("chair_wooden", at="4.26,2.2,0"),)), starts=(FIRST,), goals=(SECOND,))
    assert told.startswith("obstacles.spawn[0].at is '4.26,2.2,0', where 'chair_wooden' would leave no path from (1.50, 2.20)")


def test_an_obstacle_stands_on_the_floor_whatever_its_origin() -> None:
    (run,) = plan_runs(
        scenario(obstacles=Obstacles((SpawnRule("ball", at="3.0,1.0,0"),)), runs=1, goals=(SECOND,), starts=(FIRST,))
    )
    body = load_scene("arena")
    assert body.floor_z == 0.0
    (ball,) = run.things
    assert ball.pose == (3.0, 1.0, 0.0)
    assert ball.z >= 0.0


def test_a_person_walks_across_the_path_and_not_over_the_start() -> None:
    for run in plan_runs(
        scenario(obstacles=Obstacles(people=(PersonRule(speed=0.5),)), starts=(FIRST,), goals=(SECOND,), runs=5)
    ):
        (person,) = run.people
        (_, ay), (_, by) = person.path
        # The robot's path is the line y = 2.2 m.
        assert (ay - 2.2) * (by - 2.2) < 0.0
        assert (person.name, person.speed) == ("person_1", 0.5)
        assert min(math.dist(point, run.start[:2]) for point in person.path) > 0.175 + 0.25 + 0.3


def test_a_given_path_over_a_given_start_is_refused_and_drawn_starts_avoid_it() -> None:
    across = Obstacles(people=(PersonRule(((1.5, 0.5), (1.5, 3.9))),))
    assert refusal(obstacles=across, starts=(FIRST,), goals=(SECOND,)).startswith(
        "obstacles.people[0].path leads over the start (1.50, 2.20)"
    )
    for run in plan_runs(scenario(obstacles=across, runs=4, sampling=Sampling((1.0, 9.0)))):
        assert abs(run.start[0] - 1.5) >= 0.725 or not 0.0 < run.start[1] < 4.4


def test_runs_survive_json() -> None:
    rules = Obstacles((SpawnRule("mug"),), people=(PersonRule(),))
    for run in plan_runs(
        scenario(obstacles=rules, randomise=Randomisation(slip=(0.0, 0.1)), starts=(FIRST,), goals=(SECOND,), runs=2)
    ):
        assert restored(RunSpec, json.loads(json_text(run))) == run
