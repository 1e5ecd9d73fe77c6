"""Reading a scenario file: short forms, and one line with the path of the key for each mistake."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.resources import list_scenes
from gibson_sim.trials.scenario.load import ScenarioError, load_scenario
from gibson_sim.trials.scenario.spec import (
    GoalInterface,
    InitialPose,
    PersonRule,
    RateLimit,
    Reached,
    Region,
    Scenario,
    SpawnRule,
    Verdicts,
)  # fmt: skip

LEAST = "scenes: flat\nstack: {command: python -m stack}\n"


def load(folder: Path, text: str) -> Scenario:
    file = folder / "trial.yaml"
    file.write_text(text, encoding="utf-8")
    return load_scenario(file)


def mistakes(folder: Path, text: str) -> list[str]:
    """Returns all mistakes that are found in a file, without its path."""
    with pytest.raises(ScenarioError) as caught:
        load(folder, text)
    assert all("\n" not in line for line in caught.value.mistakes)
    assert str(caught.value).startswith(caught.value.mistakes[0])
    return [line.removeprefix(f"{folder / 'trial.yaml'}: ") for line in caught.value.mistakes]


def test_two_lines_are_a_scenario(tmp_path: Path) -> None:
    scenario = load(tmp_path, LEAST)
    assert (scenario.name, scenario.scenes, scenario.robots) == ("trial", ("flat",), ("gibson_bot",))
    assert scenario.stack.command == (sys.executable, "-m", "stack")
    assert scenario.stack.folder == tmp_path
    assert scenario.verdicts == Verdicts()


def test_shipped_scenarios_can_be_loaded_by_name() -> None:
    assert load_scenario("flat").stack.ready.topic == "navigation/status"
    hundred = load_scenario("hundred")
    assert len(hundred.scenes) * hundred.runs == 100


def test_all_scenes_are_those_that_are_found_by_name(tmp_path: Path) -> None:
    assert load(tmp_path, "scenes: all\nstack: {command: python}\n").scenes == tuple(list_scenes())


def test_a_list_as_command_is_taken_as_it_is(tmp_path: Path) -> None:
    command = load(tmp_path, "scenes: flat\nstack: {command: [sh, -c, 'a  b']}\n").stack.command
    assert command == ("sh", "-c", "a  b")


def test_short_forms(tmp_path: Path) -> None:
    scenario = load(
        tmp_path,
        LEAST
        + "obstacles: {spawn: [mug, {object: vase, count: 2, at: sampled}], closed_doors: all, people: [{path: [[0, 1], [2, 3]]}]}\n"
        + "randomise: {slip: 0.1, noise: [0.5, 2]}\n"
        + "verdicts: {reached: 0.4, collisions: null, alive: null, rates: {topic: scan, least: 9}}\n",
    )
    assert scenario.obstacles.spawn == (SpawnRule("mug"), SpawnRule("vase", 2, "sampled"))
    assert scenario.obstacles.closed_doors == ("all",)
    assert scenario.obstacles.people == (PersonRule(((0.0, 1.0), (2.0, 3.0))),)
    assert (scenario.randomise.slip, scenario.randomise.noise) == ((0.1, 0.1), (0.5, 2.0))
    assert scenario.verdicts == Verdicts(Reached(0.4), None, alive=False, rates=(RateLimit("scan", 9.0),))


def test_verdicts_that_are_given_leave_the_others_at_their_defaults(tmp_path: Path) -> None:
    corners = "[[0, 0], [1, 0], [0, 1]]"
    text = f"verdicts: {{stay_out_of: [{{name: stairs, corners: {corners}}}], reached: {{yaw_within_deg: 20}}}}\n"
    verdicts = load(tmp_path, LEAST + text).verdicts
    assert verdicts.stay_out_of == (Region("stairs", ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))),)
    assert verdicts.reached == Reached(0.3, 20.0)
    assert verdicts.collisions == 0


@pytest.mark.parametrize(
    ("text", "goal"),
    [
        ("{topic: /goal}", GoalInterface("topic", "/goal")),
        (
            "{action: navigate_to_pose, type: nav2_msgs/action/NavigateToPose}",
            GoalInterface("action", "navigate_to_pose", "nav2_msgs/action/NavigateToPose"),
        ),
        ("{service: go, type: my_msgs/srv/Go, field: target}", GoalInterface("service", "go", "my_msgs/srv/Go", "target")),
        ("task", GoalInterface("task", "task/goal")),
    ],
)
def test_ways_to_give_a_goal(tmp_path: Path, text: str, goal: GoalInterface) -> None:
    assert load(tmp_path, f"scenes: flat\nstack: {{command: python, goal: {text}}}\n").stack.goal == goal


def test_no_initial_pose(tmp_path: Path) -> None:
    stack = load(tmp_path, "scenes: flat\nstack: {command: python, initial_pose: null}\n").stack
    assert stack.initial_pose == InitialPose(topic="")


def test_settings_of_physics_are_passed_on(tmp_path: Path) -> None:
    # YAML reads on as true.
    assert load(tmp_path, LEAST + "physics: {map: on, rate: 2, step_hz: 480}\n").physics == {
        "map": "on",
        "rate": 2.0,
        "step_hz": 480,
    }


def test_files_are_found_from_the_scenario(tmp_path: Path) -> None:
    (tmp_path / "house").mkdir()
    (tmp_path / "house" / "scene.yaml").write_text("name: house\n")
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "mine.urdf").write_text("<robot/>")
    (tmp_path / "rules.yaml").write_text("light: {sun: [0.1, 0.5]}\n")
    (tmp_path / "run.sh").write_text("#!/bin/sh\n")
    (tmp_path / "run.sh").chmod(0o755)
    scenario = load(
        tmp_path,
        "scenes: house\nrobots: robots/mine.urdf\nrandomise: {looks: rules.yaml}\nstack: {command: ./run.sh, folder: .}\n",
    )
    assert scenario.scenes == (str(tmp_path / "house"),)
    assert scenario.robots == (str(tmp_path / "robots" / "mine.urdf"),)
    assert scenario.randomise.looks == str(tmp_path / "rules.yaml")


def test_all_mistakes_of_a_file_are_reported_at_once(tmp_path: Path) -> None:
    found = mistakes(
        tmp_path, "scens: flat\nruns: 0\nstack: {comand: x}\nobstacles: {people: [{speed: 1}, {path: [[a, 1], [2, 3]]}]}\n"
    )
    assert [line.split(" ", 1)[0] for line in found] == [
        "scens", "runs", "stack.comand", "stack.command", "obstacles.people[1].path[0]", "scenes",
    ]  # fmt: skip
    assert found[0].startswith("scens is not a key; did you mean 'scenes'? known: scenes, stack,")
    assert found[1] == "runs is 0, must be a whole number from 1 to 10000"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[1, 2]", "is [1, 2], must be a mapping with scenes, stack,"),
        ("", "is empty, must be a mapping with scenes, stack,"),
        ("scenes: flat\n", "stack is missing: a mapping with command,"),
        ("scenes: flot\nstack: {command: python}\n", "scenes is 'flot': scene 'flot' is not found; did you mean 'flat'?"),
        ("scenes: [flat, flat]\nstack: {command: python}\n", "scenes[1] is 'flat', which is a duplicate"),
        ("scenes: [arena, all]\nstack: {command: python}\n", "scenes[1] is 'all': scene 'all' is not found"),
        (LEAST + "robots: gibson_bt\n", "robots is 'gibson_bt': robot 'gibson_bt' is not found; did you mean 'gibson_bot'?"),
        (LEAST + "robots: a=gibson_bot\n", "robots is 'a=gibson_bot', must be one robot, which drives alone"),
        (LEAST + "runs: 6000\nrobots: [gibson_bot, husky]\n", "runs is 6000, which yields 12000 runs of 1 scenes and 2 robots"),
        (LEAST + "runs: .nan\n", "runs is nan, must be a whole number from 1 to 10000"),
        (LEAST + "limits: {time: .inf}\n", "limits.time is inf, must be a number from 0.1 to 86400"),
        (LEAST + "seed: -1\n", "seed is -1, must be a whole number from 0 to"),
        (LEAST + "obstacles:\n", "obstacles has no value, must be a mapping with spawn,"),
        (LEAST + "obstacles: {spawn: {object: mugg}}\n", "obstacles.spawn.object is 'mugg', must be a file, or an object of the catalogue"),
        (LEAST + "obstacles: {closed_doors: [all, x]}\n", "obstacles.closed_doors has both all and names of doors"),
        (LEAST + "obstacles: {people: [{path: [[0, 0]]}]}\n", "obstacles.people[0].path has 1 values, must have 2 to 200"),
        (LEAST + "randomise: {slip: [0.2, 0.1]}\n", "randomise.slip is [0.2, 0.1], must be a number from -0.5 to 0.9, or [smallest, largest]"),
        (LEAST + "randomise: {looks: exmple}\n", "randomise.looks is 'exmple': configuration of kind 'randomisation' 'exmple' is not found"),
        (LEAST + "physics: {ratee: 1}\n", "physics.ratee is not a setting that a trial accepts; did you mean 'rate'?"),
        (LEAST + "physics: {seed: 1}\n", "physics.seed is set by the trial; leave it out"),
        (LEAST + "physics: {publish_hz: 7}\n", "physics is not allowed: setting 'publish_hz' is 7 Hz, must divide"),
        (LEAST + "verdicts: {collisions: 0.5}\n", "verdicts.collisions is 0.5, must be a whole number"),
        (LEAST + "verdicts: {rates: [{topic: 1x, least: 1}]}\n", "verdicts.rates[0].topic is '1x', must be the name of a topic"),
        (LEAST + "verdicts: {rates: [{topic: a__b, least: 1}]}\n", "verdicts.rates[0].topic is 'a__b', must be the name of a topic"),
        (LEAST + "verdicts: {predicates: no_such_module_here:f}\n", "verdicts.predicates is 'no_such_module_here:f': there is no module"),
        (LEAST + "verdicts: {predicates: 'json:lods'}\n", "verdicts.predicates is 'json:lods': "),
        (LEAST + "verdicts: {predicates: json.loads}\n", "verdicts.predicates is 'json.loads', must be module:function"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_reported_with_the_path_of_its_key(tmp_path: Path, text: str, told: str) -> None:
    (found,) = mistakes(tmp_path, text)
    assert found.startswith(told)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("command: no_such_program_here --x", "command is 'no_such_program_here --x': the program 'no_such_program_here' is not found"),
        ("command: ./missing", "command is './missing': "),
        ("command: 'a \"b'", "command is 'a \"b': no closing quotation"),
        ("command: []", "command is [], must be a command line"),
        ("command: [python, 3]", "command is ['python', 3], must be a command line"),
        ("command: python\n  folder: nowhere", "folder is 'nowhere', must be a folder; "),
        ("command: python\n  environment: {ROS_DOMAIN_ID: 3}", "environment.ROS_DOMAIN_ID is set by the trial"),
        ("command: python\n  environment: {A: true}", "environment.A is True, must be text or a number"),
        ("command: python\n  environment: {'A=B': x}", "environment.A=B is not a variable name"),
        ("command: python\n  restart: nevr", "restart is 'nevr', must be one of each, never; did you mean 'never'?"),
        ("command: python\n  ready: {topc: x}", "ready.topc is not a key; did you mean 'topic'? known: topic, service, node, within"),
        ("command: python\n  ready: {topic: 'a b'}", "ready.topic is 'a b', must be the name of a topic"),
        ("command: python\n  status: {reached: '('}", "status.reached is '(': is not a regular expression"),
        ("command: python\n  lockstep: cmd_vel sometimes", "lockstep is 'cmd_vel sometimes', must be a rule of lockstep"),
        ("command: python\n  lockstep: [cmd_vel after odom, cmd_vel after scan]", "lockstep[1] is 'cmd_vel after scan', a second rule"),
        (
            "command: python\n  allowed_calls: [set_entity_stat]",
            "allowed_calls[0] is 'set_entity_stat', must be one of set_simulation_state, reset_simulation,",
        ),
        ("command: python\n  allowed_calls: [spawn_entity, jump]", "allowed_calls[1] is 'jump', must be one of set_simulation_state, "),
        ("command: python\n  goal: {}", "goal has none of topic, action and service, must have one"),
        ("command: python\n  goal: {topic: a, action: b}", "goal has topic and action, must have one"),
        ("command: python\n  goal: {action: go}", "goal.type is missing, must be an action type"),
        ("command: python\n  goal: {action: go, type: a/srv/B}", "goal.type is 'a/srv/B', must be an action type"),
        ("command: python\n  goal: {topic: go, type: a/srv/B}", "goal.type is not a key here; known: topic"),
        ("command: python\n  goal: tusk", "goal is 'tusk', must be task, {topic: ..}"),
    ],
)  # fmt: skip
def test_a_stack_that_cannot_be_started_is_refused(tmp_path: Path, text: str, told: str) -> None:
    (found,) = mistakes(tmp_path, f"scenes: flat\nstack:\n  {text}\n")
    assert found.startswith(f"stack.{told}")


@pytest.mark.parametrize(
    "text",
    [
        "scenes: [",
        "scenes: flat\nscenes: arena\n",
        "a: &a [x, x, x, x, x, x, x, x, x, x]\n"
        + "".join(f"{new}: &{new} [{', '.join(['*' + old] * 10)}]\n" for old, new in zip("abcde", "bcdef", strict=True)),
        "[" * 1000,
    ],
)
def test_invalid_and_oversized_yaml_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 'trial.yaml'}: ")
    assert "\n" not in str(caught.value)


def test_a_large_file_is_not_read(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is too large"):
        load(tmp_path, LEAST + "#" * 1_000_001)


def test_a_missing_file_is_reported_with_the_built_in_names(tmp_path: Path) -> None:
    with pytest.raises(GibsonSimError, match="'flatt' is not found; did you mean 'flat'"):
        load_scenario("flatt")


def test_a_predicate_beside_the_file_is_found_without_running_it(tmp_path: Path) -> None:
    package = tmp_path / "checks"
    package.mkdir()
    (package / "__init__.py").write_text("raise SystemExit('was run')\n")
    (package / "mine.py").write_text("raise SystemExit('was run')\n\ndef good(bag, run):\n    return True\n")
    assert load(tmp_path, LEAST + "verdicts: {predicates: 'checks.mine:good'}\n").verdicts.predicates == ("checks.mine:good",)
    (found,) = mistakes(tmp_path, LEAST + "verdicts: {predicates: ['checks.mine:god']}\n")
    assert found.endswith("mine.py has no 'god'; did you mean 'good'?")
    (found,) = mistakes(tmp_path, LEAST + "verdicts: {predicates: 'checks.yours:good'}\n")
    assert found.endswith("there is no module 'checks.yours' in that package")


def test_a_message_names_further_mistakes(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"runs is 0, .* \(2 more: seed, limits\.time\)$"):
        load(tmp_path, LEAST + "runs: 0\nseed: x\nlimits: {time: 0}\n")


def test_the_number_of_very_many_mistakes_is_limited(tmp_path: Path) -> None:
    found = mistakes(tmp_path, LEAST + "".join(f"x{k}: 1\n" for k in range(30)))
    assert len(found) == 21
    assert found[-1] == "has more than 20 mistakes: fix these first"


def test_wrong_names_are_reported_with_the_other_mistakes(tmp_path: Path) -> None:
    found = mistakes(
        tmp_path,
        "scenes: [flat, nowhere]\nrobots: gibson_bott\nruns: 0\n"
        "stack: {command: no-such-program, ready: {topc: a}}\n"
        "obstacles: {spawn: mugg, people: 3}\n"
        "physics: {rate: 1}\n"
        "verdicts: {colisions: 0, predicates: nowhere:function}\n",
    )
    begins = ("runs is 0", "stack.ready.topc is not a key", "obstacles.people is", "verdicts.colisions is not a key",
              "scenes[1] is 'nowhere'", "robots is 'gibson_bott'", "stack.command is 'no-such-program'", "obstacles.spawn.object is 'mugg'",
              "verdicts.predicates is 'nowhere:function'")  # fmt: skip
    assert [line.startswith(begin) for line, begin in zip(found, begins, strict=True)] == [True] * len(begins), found


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("scenes: flat\nstack: {command: ./run.sh, folder: 3}\n", 1),  # where the program should be is unknown
        ("scenes: 3\nruns: 10000\nrobots: [gibson_bot, omni_bot]\nstack: {command: python}\n", 1),
        ("scenes: flat\nstack: {folder: nowhere}\n", 1),  # without a command there is no stack to check
        ("scenes: flat\nrandomise: 3\nstack: 4\nphysics: {rate: 1}\n", 2),
    ],
)
def test_mistakes_do_not_cause_others(tmp_path: Path, text: str, count: int) -> None:
    assert len(mistakes(tmp_path, text)) == count
