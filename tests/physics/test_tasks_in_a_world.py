"""Tasks with physics: episodes in this process, the command, and Gymnasium's environments."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gibson_sim.cli.main import main
from gibson_sim.errors import ConfigError
from gibson_sim.tasks.episode import Action, Observation
from gibson_sim.tasks.registry import task_of
from gibson_sim.tasks.run import TaskRun
from gibson_sim_bench.tasks import LooseRow, TaskPlan, TaskReport, TaskRow, measure, report_text


@pytest.fixture(scope="module")
def push() -> Iterator[TaskRun]:
    with TaskRun(task_of("push-through"), scene="arena") as run:
        yield run


def _drive(run: TaskRun, seed: int, steps: int = 5) -> list[Observation]:
    observations = [run.reset(seed)]
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        linear, angular = rng.uniform(-1.0, 1.0, 2)
        observations.append(run.step(Action(float(linear), float(angular))))
    return observations


def test_an_episode_is_the_same_to_the_bit_whatever_was_before_it(push: TaskRun) -> None:
    first = _drive(push, 3)
    _drive(push, 4, 3)
    again = _drive(push, 3)
    with TaskRun(task_of("push-through"), scene="arena") as fresh:
        new = _drive(fresh, 3)
    assert first == again == new


def test_driving_into_a_wall_is_one_collision(push: TaskRun) -> None:
    push.reset(0)
    for _ in range(120):
        push.step(Action(linear=0.5))
        if push.metrics.collisions:
            break
    for _ in range(5):
        push.step(Action(linear=0.5))
    assert push.metrics.collisions >= 1
    assert push.metrics.collisions <= 2  # two walls in a corner


def test_the_command_pushes_boxes_through_a_doorway_and_reports_success(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["task", "push-through", "--scene", "arena", "--in-process", "--baseline", "scripted", "--seed", "2"]
    with pytest.raises(SystemExit) as end:
        main([*words, "--json", str(tmp_path / "found.json")])
    assert end.value.code == 0
    said = capsys.readouterr().out
    assert "seed 2: success after" in said
    assert "push-through, scripted: 1 of 1 succeeded (100 %, 95 % interval 21 to 100 %)" in said
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["successes"] == 1 and found["all"][0]["pushed"] >= 1


def test_the_command_lists_all_tasks_and_refuses_unknown_ones(capsys: pytest.CaptureFixture[str]) -> None:
    for words, code, text in (
        (["--list"], 0, "push-through"),
        ([], 1, "gibson-sim task --list"),
        (["fly", "--in-process"], 1, "must be one of point-goal, push-through"),
        (["point-goal", "--in-process", "--baseline", "careful"], 1, "known: scripted, random, none"),
    ):
        with pytest.raises(SystemExit) as end:
            main(["task", *words])
        assert end.value.code == code
        assert text in "".join(capsys.readouterr())


def test_control_must_divide_steps() -> None:
    with pytest.raises(ConfigError, match="must divide step_hz"):
        TaskRun(task_of("point-goal"), scene="arena", step_hz=240, control_hz=7)


@pytest.fixture
def environments() -> Any:
    """The module, if Gymnasium is installed."""
    try:
        from gibson_sim.tasks import environments
    except ImportError:
        message = "SKIPPED: Gymnasium is not installed: pip install 'gibson_sim[gym]'"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)
    return environments


def test_an_environment_passes_the_check_of_gymnasium(environments: Any) -> None:
    import gymnasium
    from gymnasium.utils.env_checker import check_env

    environment = gymnasium.make("GibsonSim/PointGoal-v0", scene="arena").unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(environment, skip_render_check=True)
    environment.close()
    environment.close()


def test_every_task_is_registered(environments: Any) -> None:
    import gymnasium

    assert {"PointGoal", "PushThrough", "ObjectSearch", "OpenDoor"} <= {
        spec.name for spec in gymnasium.registry.values() if spec.namespace == "GibsonSim"
    }
    environments.register()


def test_environments_in_processes_see_what_one_in_this_process_sees(environments: Any) -> None:
    alone = environments.TaskEnvironment("point-goal", scene="arena")
    expected = [alone.reset(seed=5)[0], *(alone.step(np.array([1.0, 0.2], dtype=np.float32))[0] for _ in range(3))]
    alone.close()
    together = environments.in_processes(2, "point-goal", scene="arena")
    try:
        seen = [together.reset(seed=[5, 6])[0]]
        seen += [together.step(np.array([[1.0, 0.2], [1.0, 0.2]], dtype=np.float32))[0] for _ in range(3)]
    finally:
        together.close()
    assert np.array_equal(expected, [rows[0] for rows in seen])
    assert not np.array_equal(seen[0][0], seen[0][1])


def test_impossible_environments_are_refused(environments: Any) -> None:
    for arguments, words in (({"observation": "smell"}, "state, rgbd"), ({"render_mode": "human"}, "rgb_array")):
        with pytest.raises(ConfigError, match=words):
            environments.TaskEnvironment("point-goal", **arguments)
    environment = environments.TaskEnvironment("point-goal", scene="arena")
    with pytest.raises(ConfigError, match="call reset"):
        environment.step(np.zeros(2, dtype=np.float32))


def test_a_measurement_has_its_stages_and_its_report_the_targets() -> None:
    plan = TaskPlan(("point-goal",), ("state",), (1,), scene="arena", steps=3, loose_scene="")
    (row,) = measure(plan).rows
    assert row.steps_per_s > 0.0 and row.physics_ms > row.judge_ms > 0.0 and row.observe_ms > 0.0 and row.reset_ms > 0.0
    rows = (
        TaskRow("point-goal", "flat", "state", 1, 120.0, 5.0, 1.0, 2.0, 90.0),
        TaskRow("point-goal", "flat", "rgbd", 1, 20.0, 5.0, 1.0, 2.0, 9.0),
    )
    loose = (LooseRow("flat", 50, "at rest", 25.0),)
    text = report_text(TaskReport("2000-01-01", "1", "m", 2, 0.0, rows=rows, loose=loose))
    lines = [" ".join(line.split()) for line in text.splitlines()]
    assert "real-time factor without images >= 10 12.0 (fastest task 12.0) met" in lines
    assert "real-time factor with 256x256 RGB-D >= 3 2.0 (fastest task 2.0) MISSED" in lines
    assert "flat 50 at rest 25.0" in lines
    assert measure(TaskPlan(tasks=(), loose_scene="")).as_json()["rows"] == []
