"""Commands whose work is spread over workers."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.cli.command_line import run
from gibson_sim.cli.commands import task as task_command
from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.workers import add_workers, backend_of, files_of
from gibson_sim.errors import ConfigError
from gibson_sim.jobs.local import LocalWorkers
from gibson_sim.jobs.units import Unit, UnitResult

TASK = ["task", "push-through", "--in-process", "--baseline", "scripted", "--seed", "0", "--episodes", "2"]


@pytest.mark.egl
def test_episodes_over_workers_are_those_of_one_process(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed = []
    for name, options in (("one", []), ("two", ["--workers", "2"])):
        folder = tmp_path / name
        assert run([*TASK, "--json", str(folder / "all.json"), "--pictures", str(folder), *options]) == 0
        printed.append(capsys.readouterr().out)
    assert printed[0] == printed[1]
    assert [line.split(":")[0] for line in printed[0].splitlines()] == ["seed 0", "seed 1", "push-through, scripted"]
    names = ["all.json", "push-through_0.png", "push-through_1.png"]
    assert sorted(path.name for path in (tmp_path / "two").iterdir()) == names
    for name in names:
        assert (tmp_path / "two" / name).read_bytes() == (tmp_path / "one" / name).read_bytes()


class _Failing:
    """A backend whose second unit comes first, and whose first one fails."""

    def run(self, units: Sequence[Unit], output: Path, on_result: Callable[[UnitResult], None], *_: Any) -> None:
        on_result(UnitResult(units[1].id, ANY_METRICS))
        on_result(UnitResult(units[0].id, error="the scene has no room for the task"))


ANY_METRICS = {
    "success": True,
    "time": 1.0,
    "path_length": 1.0,
    "spl": 1.0,
    "collisions": 0,
    "pushed": 0,
    "pushed_distance": 0.0,
    "goal_distance": 0.1,
}


def test_an_episode_that_fails_ends_the_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(task_command, "backend_of", lambda args: _Failing())
    assert run(TASK) == 1
    assert capsys.readouterr() == ("", "gibson-sim: error: episode seed-0: the scene has no room for the task\n")


class _Interrupted:
    """A backend that Ctrl-C ends after the first unit."""

    def run(self, units: Sequence[Unit], output: Path, on_result: Callable[[UnitResult], None], *_: Any) -> None:
        on_result(UnitResult(units[0].id, ANY_METRICS))
        on_result(UnitResult(units[1].id, error="stopped before it began", stopped=True))
        raise KeyboardInterrupt


def test_ctrl_c_shows_the_episodes_that_were_done(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(task_command, "backend_of", lambda args: _Interrupted())
    assert run(TASK) == ExitCode.INTERRUPTED
    out, err = capsys.readouterr()
    assert [line.split(",")[0] for line in out.splitlines()] == ["seed 0: success after 1.0 s"]
    assert err == ""


def test_workers_need_a_task_in_this_process(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["task", "push-through", "--workers", "2"]) == 1
    assert "--workers and --ray are for --in-process" in capsys.readouterr().err


def test_bags_of_one_name_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bags = [tmp_path / "a" / "run 1", tmp_path / "b" / "run_1"]
    for bag in bags:
        bag.mkdir(parents=True)
        (bag / "metadata.yaml").touch()
        (bag / "bag_0.mcap").touch()
    assert run(["render", *map(str, bags), "--output", str(tmp_path / "new")]) == 1
    assert f"would both become {tmp_path}/new/run_1; rename one" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_the_options_choose_the_backend() -> None:
    parser = argparse.ArgumentParser()
    add_workers(parser, "things")
    assert backend_of(parser.parse_args([])) is None
    assert isinstance(backend_of(parser.parse_args(["--workers", "2"])), LocalWorkers)
    with pytest.raises(ConfigError, match="--workers and --ray exclude each other"):
        backend_of(parser.parse_args(["--workers", "2", "--ray", "auto"]))
    with pytest.raises(ConfigError, match="the number of workers is 0, must be from 1 to 256"):
        backend_of(parser.parse_args(["--workers", "0"]))


def test_settings_that_are_files_become_absolute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "eye.yaml").touch()
    values = {"cameras": "eye.yaml", "lights": "", "randomise": "strong", "rate": 5.0}
    assert files_of(values, ("cameras", "lights", "randomise")) == (tmp_path / "eye.yaml",)
    assert values == {"cameras": str(tmp_path / "eye.yaml"), "lights": "", "randomise": "strong", "rate": 5.0}
