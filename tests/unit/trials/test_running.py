"""The runs of a trial as units of work: which are made, what they leave, and what goes on after an interruption."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.jobs.units import Unit, UnitResult
from gibson_sim.trials import execution, judging, running
from gibson_sim.trials.json_values import json_values, restored
from gibson_sim.trials.records import Outcome, PlacedObject, RunResult, RunSpec
from gibson_sim.trials.report import page
from gibson_sim.trials.report.results import read_results
from gibson_sim.trials.running import (
    Overrides,
    Progress,
    TrialInterrupted,
    check_output_folder,
    claimed,
    execute_run,
    execute_runs,
    finished,
    worker_failure,
)
from gibson_sim.trials.scenario.load import load_scenario
from gibson_sim.trials.scenario.spec import Limits, Obstacles, Randomisation, Scenario, SpawnRule, StackSpec
from support.trial_results import failed, passed, spec, trial


class Here:
    """Makes units in this process, one after the other; stops before the unit of a number."""

    def __init__(self, stop_before: int = -1) -> None:
        self.made: list[int] = []
        self._stop_before = stop_before

    def run(
        self,
        units: Sequence[Unit],
        output: Path,
        on_result: Callable[[UnitResult], None],
        on_progress: Callable[[str, str], None],
        stop: Callable[[], bool],
    ) -> None:
        for unit in units:
            if int(unit.id) == self._stop_before:
                raise KeyboardInterrupt
            self.made.append(int(unit.id))
            (output / unit.id).mkdir()
            try:
                value = execute_run(
                    json.loads(json.dumps(unit.arguments)),
                    output / unit.id,
                    Context(lambda text, u=unit: on_progress(u.id, text)),
                )
                on_result(UnitResult(unit.id, value))
            except GibsonSimError as error:
                on_result(UnitResult(unit.id, error=str(error)))


class Context:
    """That of a unit in this process, or on a machine that has its files in a folder."""

    def __init__(self, progress: Callable[[str], None] = lambda text: None, root: str = "") -> None:
        self.progress, self._root = progress, root

    def stop(self) -> bool:
        return False

    def path(self, path: str | Path) -> Path:
        return Path(f"{self._root}{path}")


@pytest.fixture
def scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Scenario:
    """A scenario whose runs with an odd number fail, and whose simulation breaks in run 4."""
    (tmp_path / "trial").mkdir()
    file = tmp_path / "trial" / "rooms.yaml"
    file.write_text("")
    made = Scenario("rooms", file, ("linden_flat",), StackSpec(("true",), folder=tmp_path / "trial"))

    def execute(
        given: Scenario,
        run: RunSpec,
        folder: Path,
        *,
        followed: bool,
        on_progress: Callable[[str], None],
        stop: Callable[[], bool],
    ) -> Outcome:
        if run.number == 4:
            raise GibsonSimError("no free ROS domain")
        on_progress("4.2 s")
        (folder / "bag").mkdir()
        return Outcome("reached", "", lockstep=bool(given.stack.lockstep))

    def judge(given: Scenario, run: RunSpec, outcome: Outcome, folder: Path) -> RunResult:
        return failed(run.number) if run.number % 2 else passed(run.number)

    monkeypatch.setattr(execution, "execute", execute)
    monkeypatch.setattr(judging, "judge", judge)
    return made


def made(
    scenario: Scenario, runs: Sequence[RunSpec], folder: Path, backend: Any = None
) -> tuple[list[RunResult], list[tuple[int, str]]]:
    results: list[RunResult] = []
    told: list[tuple[int, str]] = []
    execute_runs(scenario, runs, backend or Here(), folder, results.append, lambda number, text: told.append((number, text)))
    return results, told


def test_each_run_leaves_its_plan_and_its_result(tmp_path: Path, scenario: Scenario) -> None:
    results, told = made(scenario, [spec(0), spec(1)], tmp_path / "out")
    assert results == [passed(0), failed(1)]
    assert told == [(0, "4.2 s"), (0, "judging"), (1, "4.2 s"), (1, "judging")]
    assert restored(RunSpec, json.loads((tmp_path / "out/runs/0001/run.json").read_text())) == spec(1)
    assert json.loads((tmp_path / "out/runs/0001/result.json").read_text())["passed"] is False


def test_files_of_a_run_are_in_its_plan_and_not_in_its_result(tmp_path: Path, scenario: Scenario) -> None:
    run = spec(0, files={"robot/robot.yaml": "urdf: robot.urdf\n"})
    (result,), _ = made(scenario, [run], tmp_path)
    assert result.run == replace(run, files={})
    assert json.loads((tmp_path / "runs/0000/run.json").read_text())["files"] == run.files
    assert finished(tmp_path, [run]) == {0: result}


def test_bags_of_failed_runs_alone_are_kept(tmp_path: Path, scenario: Scenario) -> None:
    made(scenario, [spec(0), spec(1)], tmp_path)
    assert not (tmp_path / "runs/0000/bag").exists()
    assert (tmp_path / "runs/0001/bag").is_dir()


def test_all_bags_are_kept_on_request(tmp_path: Path, scenario: Scenario) -> None:
    made(Overrides(keep="all").applied(scenario), [spec(0)], tmp_path)
    assert (tmp_path / "runs/0000/bag").is_dir()


def test_a_run_whose_worker_fails_is_a_failed_run_and_the_others_go_on(tmp_path: Path, scenario: Scenario) -> None:
    results, _ = made(scenario, [spec(4), spec(6)], tmp_path)
    assert [result.passed for result in results] == [False, True]
    assert results[0] == worker_failure(scenario, spec(4), "no free ROS domain")
    assert results[0].cause is not None
    assert results[0].cause.kind == "simulation failed"
    assert finished(tmp_path, [spec(4)]) == {4: results[0]}


def test_only_the_missing_runs_are_made_after_an_interruption(tmp_path: Path, scenario: Scenario) -> None:
    plan = [spec(n) for n in range(4)]
    with pytest.raises(KeyboardInterrupt):
        made(scenario, plan, tmp_path, Here(stop_before=2))
    before = finished(tmp_path, plan)
    assert before == {0: passed(0), 1: failed(1)}
    backend = Here()
    made(scenario, [run for run in plan if run.number not in before], tmp_path, backend)
    assert backend.made == [2, 3]
    assert finished(tmp_path, plan) == {0: passed(0), 1: failed(1), 2: passed(2), 3: failed(3)}


def test_a_run_that_is_planned_otherwise_is_made_again(tmp_path: Path, scenario: Scenario) -> None:
    made(scenario, [spec(0)], tmp_path)
    assert finished(tmp_path, [spec(0, seed=9)]) == {}
    assert finished(tmp_path, [spec(1)]) == {}


@pytest.mark.parametrize("text", ["", "{}", "[]", "null", '{"run": 1}'])
def test_a_damaged_result_is_made_again(tmp_path: Path, scenario: Scenario, text: str) -> None:
    made(scenario, [spec(0)], tmp_path)
    (tmp_path / "runs/0000/result.json").write_text(text)
    assert finished(tmp_path, [spec(0)]) == {}
    results, _ = made(scenario, [spec(0)], tmp_path)
    assert results == [passed(0)]


def test_an_output_folder_is_new_or_empty(tmp_path: Path) -> None:
    check_output_folder(tmp_path / "new", resume=False)
    check_output_folder(tmp_path, resume=False)
    check_output_folder(tmp_path / "new", resume=True)


def test_a_folder_with_other_content_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(ConfigError, match=r"already contains 'thesis\.tex'; give a new one$"):
        check_output_folder(tmp_path, resume=False)
    with pytest.raises(ConfigError, match="no trial to resume"):
        check_output_folder(tmp_path, resume=True)


def test_a_folder_with_a_trial_goes_on_with_resume_alone(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    with pytest.raises(ConfigError, match="or continue the trial in it"):
        check_output_folder(tmp_path, resume=False)
    check_output_folder(tmp_path, resume=True)


def test_two_trials_do_not_share_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "out"
    used = pytest.raises(ConfigError, match="another trial is writing to the folder")
    with claimed(folder, resume=False), used, claimed(folder, resume=True):
        raise AssertionError("it is in use")
    with claimed(folder, resume=False):
        assert list(folder.iterdir()) == []


def test_output_that_cannot_be_a_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes").write_text("")
    with pytest.raises(ConfigError, match=r"notes' is a file, must be a folder$"):
        check_output_folder(tmp_path / "notes", resume=False)
    with pytest.raises(ConfigError, match=r"cannot be created: .*notes is a file$"):
        check_output_folder(tmp_path / "notes" / "out", resume=False)


def test_changes_of_the_command_line_count(scenario: Scenario) -> None:
    changed = Overrides(runs=3, restart="never", keep="all").applied(scenario)
    assert (changed.runs, changed.stack.restart, changed.record.keep) == (3, "never", "all")
    assert Overrides().applied(scenario) == scenario
    assert Overrides(runs=3, restart="never", keep="all").options() == ("--runs", "3", "--restart", "never")
    with pytest.raises(ConfigError, match="runs is 0, must be at least 1"):
        Overrides(runs=0).applied(scenario)


def test_files_are_taken_from_where_they_are_on_the_machine_of_a_worker(
    tmp_path: Path, scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def execute(given: Scenario, run: RunSpec, folder: Path, **_: Any) -> Outcome:
        seen.append((given.stack.folder, given.stack.command, run.scene, run.robot))
        assert [thing.object for thing in run.things] == ["mug", "/elsewhere/data/box.urdf"]
        assert run.physics == {"randomise": "/elsewhere/data/looks.yaml", "rate": 0.5}
        return Outcome("reached", "", lockstep=True)

    monkeypatch.setattr(execution, "execute", execute)
    things = (PlacedObject("a", "mug", (0.0, 0.0, 0.0)), PlacedObject("b", "/data/box.urdf", (1.0, 0.0, 0.0)))
    run = spec(
        0, scene="/data/my_flat", robot="gibson_bot", things=things, physics={"randomise": "/data/looks.yaml", "rate": 0.5}
    )
    stack = StackSpec(("/home/me/.venv/bin/python3", "stack.py"), folder=Path("/home/me"))
    given = replace(scenario, path=Path("/home/me/t.yaml"), stack=stack)
    arguments = {
        "scenario": json_values(given), "python": "/home/me/.venv/bin/python3", "run": json_values(run), "followed": False,
    }  # fmt: skip
    execute_run(arguments, tmp_path, Context(root="/elsewhere"))
    command = (sys.executable, "stack.py")  # its Python is that of the machine
    assert seen == [(Path("/elsewhere/home/me"), command, "/elsewhere/data/my_flat", "gibson_bot")]
    assert finished_run(tmp_path) == run


def finished_run(folder: Path) -> RunSpec:
    """Returns the run that is written in a folder, of its plan and of its result."""
    planned = json.loads((folder / "run.json").read_text())
    assert json.loads((folder / "result.json").read_text())["run"] == planned
    return restored(RunSpec, planned)


def test_folders_of_scenes_and_robots_in_files_travel_once(tmp_path: Path, scenario: Scenario) -> None:
    (tmp_path / "worlds").mkdir()
    (tmp_path / "worlds" / "hall.sdf").write_text("")
    given = replace(scenario, scenes=("flat", str(tmp_path / "worlds" / "hall.sdf")), robots=(str(tmp_path / "worlds"),))
    assert running._files(given) == (tmp_path / "trial", tmp_path / "worlds")
    assert running._files(replace(given, stack=replace(given.stack, folder=tmp_path))) == (tmp_path,)
    things = Obstacles(spawn=(SpawnRule("mug"), SpawnRule("/objects/box.urdf")))
    with_files = replace(scenario, obstacles=things, randomise=Randomisation(looks="/looks/looks.yaml"))
    assert running._files(with_files) == (tmp_path / "trial", Path("/objects/box.urdf"), Path("/looks/looks.yaml"))


FILE = """
scenes: linden_flat
stack: {{command: "true", folder: .}}
runs: 2
limits: {{time: {time}}}
"""


@pytest.fixture
def limits(tmp_path: Path, scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time limit of each run that was executed, of the trial of ``trial.yaml``, whose runs pass."""
    seen = []

    def execute(given: Scenario, run: RunSpec, folder: Path, **_: Any) -> Outcome:
        seen.append(given.limits.time)
        return Outcome("reached", "", lockstep=False)

    monkeypatch.setattr(execution, "execute", execute)
    monkeypatch.setattr(judging, "judge", lambda given, run, outcome, folder: passed(run.number))
    monkeypatch.setattr(running, "_plan", lambda given, numbers, progress: tuple(spec(n) for n in numbers or range(given.runs)))
    monkeypatch.setattr(running, "backend_for", lambda workers, on_interrupt: Here())
    monkeypatch.setattr(page, "scene_map", lambda scene: None)
    (tmp_path / "trial.yaml").write_text(FILE.format(time=50))
    return seen


def test_edit_of_the_file_during_a_trial_changes_no_run(tmp_path: Path, limits: list[float]) -> None:
    class Editor(Progress):
        def begins(self, name: str, total: int, done: int, folder: Path) -> None:
            (tmp_path / "trial.yaml").write_text("a mistake: [")

        def add(self, result: RunResult) -> None:
            (tmp_path / "trial.yaml").write_text(FILE.format(time=99))

    results = running.run(tmp_path / "trial.yaml", output=tmp_path / "out", progress=Editor())
    assert limits == [50.0, 50.0]
    assert [result.passed for result in results.results] == [True, True]
    assert results.scenario["limits"]["time"] == 50.0


def test_trial_from_python_returns_what_it_wrote(tmp_path: Path, limits: list[float]) -> None:
    results = running.run(tmp_path / "trial.yaml", output=tmp_path / "out", runs=3)
    assert results.folder == tmp_path / "out"
    assert read_results(tmp_path / "out") == results
    assert (results.name, results.file, results.planned, results.workers) == ("trial", str(tmp_path / "trial.yaml"), 3, "1")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"index.html", "junit.xml", "results.json", "runs"}


def test_loaded_scenario_runs_like_its_file(tmp_path: Path, limits: list[float]) -> None:
    loaded = load_scenario(tmp_path / "trial.yaml")
    of_file = running.run(tmp_path / "trial.yaml", output=tmp_path / "a")
    loaded_runs = running.run(loaded, output=tmp_path / "b", numbers=[1])
    assert loaded_runs.results == of_file.results[1:]
    assert loaded_runs.scenario == of_file.scenario
    running.run(replace(loaded, limits=Limits(time=7.0)), output=tmp_path / "c", numbers=[1])
    assert limits == [50.0, 50.0, 50.0, 7.0]


def test_rows_have_plan_verdict_and_measures() -> None:
    ok, bad = trial([passed(0, drawn={"slip": 0.1}), failed(1)]).to_rows()
    assert (ok["run"], ok["passed"], ok["cause"], ok["reason"], ok["slip"], ok["time"]) == (0, True, "", "", 0.1, 31.2)
    assert (bad["run"], bad["passed"], bad["cause"], bad["end"]) == (1, False, "collision", "time limit")
    assert bad["reason"].startswith("collision with chair_2")
    assert (bad["start_x"], bad["start_y"], bad["goal_x"]) == (4.2, 2.8, 7.4)


def test_interrupted_trial_keeps_its_report_and_goes_on(
    tmp_path: Path, limits: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running, "backend_for", lambda workers, on_interrupt: Here(stop_before=1))
    with pytest.raises(TrialInterrupted) as interruption:
        running.run(tmp_path / "trial.yaml", output=tmp_path / "out")
    assert interruption.value.results.results == (passed(0),)
    assert read_results(tmp_path / "out").results == (passed(0),)
    monkeypatch.setattr(running, "backend_for", lambda workers, on_interrupt: Here())
    assert running.run(tmp_path / "trial.yaml", output=tmp_path / "out", resume=True).results == (passed(0), passed(1))
    assert len(limits) == 2
    with pytest.raises(ConfigError, match="resume needs output"):
        running.run(tmp_path / "trial.yaml", resume=True)


@pytest.mark.parametrize("name", ["flat", "hundred"])
def test_scenario_survives_the_way_to_a_worker(name: str) -> None:
    loaded = load_scenario(name)
    assert restored(Scenario, json.loads(json.dumps(json_values(loaded)))) == loaded


def test_importing_trials_loads_neither_maps_nor_processes() -> None:
    command = "import sys, gibson_sim.trials; print([name for name in sys.modules if name.startswith('gibson_sim.')])"
    loaded = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True).stdout
    assert "gibson_sim.trials" in loaded
    assert not {"gibson_sim.jobs", "gibson_sim.maps", "gibson_sim.scenes"} & set(re.findall(r"[\w.]+", loaded))
