"""``gibson-sim trial``: exit codes, what it prints, and what it refuses."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from gibson_sim.cli import command_line
from gibson_sim.cli.console import Console
from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.trial_progress import TrialProgress
from gibson_sim.jobs.units import Unit, UnitResult
from gibson_sim.trials import running
from gibson_sim.trials.records import RunResult
from gibson_sim.trials.report import page
from gibson_sim.trials.report.results import write_results
from gibson_sim.trials.scenario.spec import Scenario, StackSpec
from support.trial_results import failed, passed, spec, trial


class Made:
    """A backend whose runs have these results; Ctrl-C comes after a number of them."""

    def __init__(self) -> None:
        self.results: dict[int, RunResult] = {}
        self.interrupted_after = 1000
        self.made: list[int] = []

    def run(
        self,
        units: Sequence[Unit],
        output: Path,
        on_result: Callable[[UnitResult], None],
        on_progress: Callable[[str, str], None],
        stop: Callable[[], bool],
    ) -> None:
        for unit in units:
            if len(self.made) == self.interrupted_after:
                raise KeyboardInterrupt
            number = int(unit.id)
            self.made.append(number)
            values = self.results[number].to_json()
            own = output / unit.id
            own.mkdir()
            (own / "run.json").write_text(json.dumps(unit.arguments["run"]))
            (own / "result.json").write_text(json.dumps(values))
            on_result(UnitResult(unit.id, json.loads(json.dumps(values))))


@pytest.fixture
def backend(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Made:
    """Four planned runs, which pass."""
    (tmp_path / "rooms.yaml").write_text("")
    scenario = Scenario("rooms", tmp_path / "rooms.yaml", ("linden_flat",), StackSpec(("true",), folder=tmp_path))
    made = Made()
    made.results = {number: passed(number) for number in range(4)}
    monkeypatch.setattr(running, "load_scenario", lambda path: scenario)
    monkeypatch.setattr(
        "gibson_sim.trials.planning.plan.plan_runs",
        lambda scenario, numbers, on_progress: tuple(spec(number) for number in numbers or range(4)),
    )
    monkeypatch.setattr(running, "backend_for", lambda workers, on_interrupt: made)
    monkeypatch.setattr(page, "scene_map", lambda scene: None)
    monkeypatch.chdir(tmp_path)
    return made


def run(*words: str) -> int:
    return command_line.run(["trial", *words])


def results_in(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "results.json").read_text())
    return found


def test_a_trial_whose_runs_pass_ends_with_0(backend: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("rooms.yaml", "--output", "out") == ExitCode.OK
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "ok     0 linden_flat 4.2,2.8 -> 7.4,6.6  reached in 31.2 s, 12.1 m (ratio 1.08)"
    assert lines[4] == "4 of 4 passed (100 %; 95 % interval 51 to 100 %)"
    assert lines[-1] == "page: out/index.html"
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["index.html", "junit.xml", "results.json", "runs"]
    assert results_in(tmp_path / "out")["totals"]["passed"] == 4
    assert ElementTree.parse(tmp_path / "out" / "junit.xml").getroot().get("tests") == "4"


def test_a_trial_with_a_failed_run_ends_with_1(backend: Made, capsys: pytest.CaptureFixture[str]) -> None:
    backend.results[2] = failed(2)
    assert run("rooms.yaml", "--output", "out") == ExitCode.ERROR
    out = capsys.readouterr().out
    assert "FAIL   2 linden_flat 4.2,2.8 -> 7.4,6.6  collision with chair_2" in out
    assert "  collision: 1 (run 2)\n" in out
    assert "run 2, with the stack: gibson-sim trial rooms.yaml --run 2\n" in out


def test_results_go_into_a_new_folder_by_default(backend: Made, tmp_path: Path) -> None:
    run("rooms.yaml")
    (folder,) = (tmp_path / "out" / "trials").iterdir()
    assert folder.name.startswith("rooms_20")


def test_only_the_named_runs_are_made(backend: Made, tmp_path: Path) -> None:
    assert run("rooms.yaml", "--output", "out", "--run", "1", "3") == ExitCode.OK
    assert backend.made == [1, 3]
    assert results_in(tmp_path / "out")["complete"] is True


def test_ctrl_c_keeps_the_results_and_says_how_to_go_on(
    backend: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    backend.interrupted_after = 2
    assert run("rooms.yaml", "--output", "out", "--runs", "4", "--workers", "2", "--keep", "all") == ExitCode.INTERRUPTED
    assert capsys.readouterr().err.splitlines()[-1] == (
        "interrupted: 2 of 4 runs are kept; to continue: "
        "gibson-sim trial rooms.yaml --runs 4 --workers 2 --keep all --output out --resume"
    )
    found = results_in(tmp_path / "out")
    assert (found["complete"], found["totals"]["runs"]) == (False, 2)
    (tmp_path / "out" / "results.json").write_text(json.dumps({**found, "wall_time": 1000.0}))
    backend.interrupted_after = 1000
    assert run("rooms.yaml", "--runs", "4", "--output", "out", "--resume") == ExitCode.OK
    assert backend.made == [0, 1, 2, 3]
    found = results_in(tmp_path / "out")
    assert found["totals"]["runs"] == 4
    assert found["wall_time"] >= 1000.0  # of both parts


def test_the_plan_is_printed_and_nothing_is_made(backend: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("rooms.yaml", "--plan") == ExitCode.OK
    assert len(capsys.readouterr().out.splitlines()) == 5
    assert backend.made == []
    assert not (tmp_path / "out").exists()


def test_a_trial_is_compared_with_an_earlier_one(backend: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = write_results(trial([passed(n) if n else failed(n) for n in range(4)]), tmp_path / "before")
    assert run("rooms.yaml", "--output", "out", "--compare", str(before)) == ExitCode.OK
    out = capsys.readouterr().out
    assert "got better ok     0 linden_flat" in out
    assert "0 runs got worse, 1 got better" in out
    assert results_in(tmp_path / "out")["comparison"]["better"] == [0]
    assert "0 runs got worse, 1 got better" in (tmp_path / "out" / "index.html").read_text()


def two_trials(tmp_path: Path, worse: int) -> tuple[str, str]:
    before = write_results(trial([passed(n) for n in range(20)]), tmp_path / "a")
    after = write_results(trial([failed(n) if n < worse else passed(n) for n in range(20)]), tmp_path / "b")
    return str(before), str(after.parent)


def test_two_trials_are_compared_without_a_scenario(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--compare", *two_trials(tmp_path, 8)) == ExitCode.OK
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "before: 20 of 20 passed (100 %; 95 % interval 84 to 100 %)"
    assert lines[2].startswith("got worse  FAIL   0 linden_flat")
    assert lines[10].startswith("8 runs got worse, 0 got better; by chance alone")


@pytest.mark.parametrize(("worse", "code"), [(5, ExitCode.OK), (6, ExitCode.ERROR)])
def test_a_significant_decline_ends_with_1_on_request(tmp_path: Path, worse: int, code: ExitCode) -> None:
    assert run("--compare", *two_trials(tmp_path, worse), "--fail-if-worse") == code


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ((), "give the scenario FILE of a trial"),
        (("--compare", "a.json"), "give the scenario FILE of a trial"),
        (("rooms.yaml", "--compare", "a.json", "b.json"), "--compare has 2 files"),
        (("rooms.yaml", "--fail-if-worse"), "--fail-if-worse is for --compare"),
        (("rooms.yaml", "--resume"), "--resume needs --output DIR"),
        (("rooms.yaml", "--compare", "none.json"), "none.json: cannot be read: No such file"),
        (("rooms.yaml", "--runs", "0"), "runs is 0, must be at least 1"),
        (("rooms.yaml", "--output", "."), "the folder already contains 'rooms.yaml'"),
    ],
)
def test_wrong_input_is_one_line_before_anything_starts(
    backend: Made, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], text: str
) -> None:
    assert run(*words) == ExitCode.ERROR
    err = capsys.readouterr().err
    assert err.startswith("gibson-sim: error: ")
    assert err.count("\n") == 1
    assert text in err
    assert backend.made == []


def test_all_mistakes_of_a_scenario_file_are_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.yaml").write_text("scenes: flat\nruns: 0\nstack: {command: python, restart: nevr}\n")
    assert run(str(tmp_path / "bad.yaml")) == ExitCode.ERROR
    assert capsys.readouterr().err.splitlines() == [
        f"gibson-sim: error: {tmp_path}/bad.yaml: runs is 0, must be a whole number from 1 to 10000",
        f"gibson-sim: error: {tmp_path}/bad.yaml: stack.restart is 'nevr', must be one of each, never; did you mean 'never'?",
    ]


def test_long_planning_reports_its_progress() -> None:
    now, shown = [0.0], io.StringIO()
    progress = TrialProgress(console=Console(shown), clock=lambda: now[0])
    for at, done in ((0.0, 0), (1.9, 99), (4.0, 200), (13.9, 600), (14.0, 700), (20.0, 1000)):
        now[0] = at
        progress.planned(done, 1000)
    progress.close()
    # A line after a moment, and one every ten seconds: 4 s for 200 runs, 14 s for 700.
    assert shown.getvalue() == "planning: 200 of 1000 runs, 16 s left\nplanning: 700 of 1000 runs, 6 s left\n"


def test_the_bar_reports_finished_and_current_runs() -> None:
    now = [0.0]
    progress = TrialProgress(console=Console(io.StringIO()), clock=lambda: now[0])
    progress.begins("rooms", 10, 2, Path("out"))
    assert progress.line() == "[####----------------] 2/10"
    now[0] = 20.0
    progress.report(3, "4.2 s")
    progress.report(4, "")
    progress.add(passed(2))
    progress.add(failed(3))
    # 10 s a run, and six to go.
    assert progress.line() == "[########------------] 4/10; 1 passed, 1 failed; 60 s left; run 4"


def test_a_terminal_shows_the_bar_and_other_outputs_the_lines(capsys: pytest.CaptureFixture[str]) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    shown = Terminal()
    progress = TrialProgress(console=Console(shown))
    progress.begins("rooms", 1, 0, Path("out"))
    progress.add(passed(0))
    progress.close()
    assert "[####################] 1/1; 1 passed, 0 failed" in shown.getvalue()
    assert capsys.readouterr().out.startswith("ok     0")
