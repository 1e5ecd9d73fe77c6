"""The runs of a trial as units of work: which are made, what they leave, and what goes on after an interruption."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.jobs.units import Unit, UnitResult
from gibson_sim.trials import execution, judging, running
from gibson_sim.trials.records import Outcome, RunResult, RunSpec
from gibson_sim.trials.running import Overrides, check_output_folder, claimed, execute_run, execute_runs, finished, worker_failure
from gibson_sim.trials.scenario_spec import Scenario, StackSpec
from support.trial_results import failed, passed, spec


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

    monkeypatch.setattr(running, "load_scenario", lambda path: made)
    monkeypatch.setattr(execution, "execute", execute)
    monkeypatch.setattr(judging, "judge", judge)
    return made


def made(
    scenario: Scenario, runs: Sequence[RunSpec], folder: Path, backend: Any = None
) -> tuple[list[RunResult], list[tuple[int, str]]]:
    results: list[RunResult] = []
    told: list[tuple[int, str]] = []
    execute_runs(
        scenario, Overrides(), runs, backend or Here(), folder, results.append, lambda number, text: told.append((number, text))
    )
    return results, told


def test_each_run_leaves_its_plan_and_its_result(tmp_path: Path, scenario: Scenario) -> None:
    results, told = made(scenario, [spec(0), spec(1)], tmp_path / "out")
    assert results == [passed(0), failed(1)]
    assert told == [(0, "4.2 s"), (0, "judging"), (1, "4.2 s"), (1, "judging")]
    assert RunSpec.from_json(json.loads((tmp_path / "out/runs/0001/run.json").read_text())) == spec(1)
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


def test_all_bags_are_kept_where_that_is_wanted(tmp_path: Path, scenario: Scenario) -> None:
    execute_runs(scenario, Overrides(keep="all"), [spec(0)], Here(), tmp_path, lambda result: None, lambda number, text: None)
    assert (tmp_path / "runs/0000/bag").is_dir()


def test_a_run_whose_worker_fails_is_a_failed_run_and_the_others_go_on(tmp_path: Path, scenario: Scenario) -> None:
    results, _ = made(scenario, [spec(4), spec(6)], tmp_path)
    assert [result.passed for result in results] == [False, True]
    assert results[0] == worker_failure(scenario, spec(4), "no free ROS domain")
    assert results[0].cause is not None
    assert results[0].cause.kind == "simulation failed"
    assert finished(tmp_path, [spec(4)]) == {4: results[0]}


def test_after_an_interruption_only_the_rest_is_made(tmp_path: Path, scenario: Scenario) -> None:
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
    with pytest.raises(ConfigError, match="or add --resume to continue"):
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
    with pytest.raises(ConfigError, match="--runs is 0, must be at least 1"):
        Overrides(runs=0).applied(scenario)


def test_files_are_taken_from_where_they_are_on_the_machine_of_a_worker(
    tmp_path: Path, scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def execute(given: Scenario, run: RunSpec, folder: Path, **_: Any) -> Outcome:
        seen.append((given.stack.folder, run.scene, run.robot))
        return Outcome("reached", "", lockstep=True)

    monkeypatch.setattr(execution, "execute", execute)
    run = spec(0, scene="/data/my_flat", robot="gibson_bot")
    arguments = {
        "scenario": "/home/me/t.yaml",
        "folder": "/home/me",
        "overrides": {},
        "run": json.loads(json.dumps(run.to_json())),
        "followed": False,
    }
    execute_run(arguments, tmp_path, Context(root="/elsewhere"))
    assert seen == [(Path("/elsewhere/home/me"), "/elsewhere/data/my_flat", "gibson_bot")]
    assert finished_run(tmp_path) == run


def finished_run(folder: Path) -> RunSpec:
    """Returns the run that is written in a folder, of its plan and of its result."""
    planned = json.loads((folder / "run.json").read_text())
    assert json.loads((folder / "result.json").read_text())["run"] == planned
    return RunSpec.from_json(planned)


def test_folders_of_scenes_and_robots_in_files_travel_once(tmp_path: Path, scenario: Scenario) -> None:
    (tmp_path / "worlds").mkdir()
    (tmp_path / "worlds" / "hall.sdf").write_text("")
    given = replace(scenario, scenes=("flat", str(tmp_path / "worlds" / "hall.sdf")), robots=(str(tmp_path / "worlds"),))
    assert running._files(given) == (tmp_path / "trial", tmp_path / "worlds")
    assert running._files(replace(given, stack=replace(given.stack, folder=tmp_path))) == (tmp_path,)
