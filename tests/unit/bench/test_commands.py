"""The sub-commands of ``gibson-sim bench``: their defaults, and what they refuse."""

from __future__ import annotations

import argparse
from pathlib import Path
from types import ModuleType

import pytest

from gibson_sim.cli.main import main
from gibson_sim.errors import ConfigError
from gibson_sim_bench.cli import compare, report, scaling, soak, tasks, tensors


def _parsed(module: ModuleType, *words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    module.add_parser(parser.add_subparsers(dest="kind"))
    args = parser.parse_args([module.__name__.rpartition(".")[2], *words])
    assert args.run is module.run
    return args


def test_defaults_are_those_that_the_help_names() -> None:
    assert (_parsed(soak).steps, _parsed(soak).seconds, _parsed(soak).scene) == (100_000, 3600.0, "linden_flat")
    assert (_parsed(tasks).observations, _parsed(tasks).processes, _parsed(tasks).size) == (["state", "rgbd"], [1, 2], 256)
    assert (_parsed(tensors).triangles, _parsed(tensors).blocks, _parsed(tensors).calls) == (1_000_000, 20, 50)
    assert (_parsed(report).data, _parsed(report).output) == (Path("docs/benchmarks"), Path("docs/benchmarks.md"))
    assert (_parsed(scaling).only, _parsed(scaling, "--quick").quick) == ("", True)
    assert _parsed(compare, "a.json", "b.json").tolerance == 0.15


def test_a_tolerance_of_everything_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"--tolerance is 1\.0, must be 0 or more and below 1"):
        compare.run(_parsed(compare, "a.json", "b.json", "--tolerance", "1"))


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["scaling", "--only", "money"], "--only: money must be of triangles"),
        (["tasks", "--tasks", "fly"], "task 'fly' is unknown"),
        (["tasks", "--observations", "smell"], "observations are ['smell']"),
    ],
)
def test_an_impossible_measurement_is_refused_in_one_line(
    words: list[str], error: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["bench", *words])
    assert end.value.code == 1
    assert error in capsys.readouterr().err


def test_a_folder_without_reports_makes_no_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib", reason="SKIPPED: plots need matplotlib (the extra `analysis`)")
    page = tmp_path / "page.md"
    with pytest.raises(SystemExit):
        main(["bench", "report", "--data", str(tmp_path), "--output", str(page), "--images", str(tmp_path)])
    assert "holds no report of table1, peers, scaling, soak" in capsys.readouterr().err
    assert not page.exists()
