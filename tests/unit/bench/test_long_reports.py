"""Texts and plots of the reports on scaling and on long runs, from numbers made by hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from gibson_sim_bench.reports import plots
from gibson_sim_bench.scaling import ScalingReport, ScalingRow, report_text as scaling_text
from gibson_sim_bench.soak import Samples, SoakReport, report_text as soak_text
from unit.bench.test_rows import FACTS

SCALING = ScalingReport(
    FACTS, (ScalingRow("robots", 1, 0.25, 4000.0, 301.0), ScalingRow("robots", 8, 2.0, 500.0, 350.0)), ("cameras, 64: x",)
)


def _lines(text: str) -> list[str]:
    return [" ".join(line.split()) for line in text.splitlines()]


def _soak(last: float) -> SoakReport:
    environment = Samples()
    for k in range(12):
        environment.add(10.0 * k, **{"environment_MB": 100.0 if k < 9 else last, "environment_steps_/s": 50.0})
    return SoakReport(FACTS, 1200, 3, environment, 0.0, 0, Samples())


def test_scaling_has_a_table_for_each_quantity_that_was_measured() -> None:
    lines = _lines(scaling_text(SCALING))
    assert "Left out: cameras, 64: x" in lines
    assert "Robots: a physics step with N driving robots, and all link poses." in lines
    assert "8 2 500 350" in lines
    assert not any(line.startswith("Bodies") for line in lines)
    assert "| 1 | 0.25 | 4,000 | 301 |" in scaling_text(SCALING, markdown=True).splitlines()


def test_long_runs_name_what_grew() -> None:
    # After a quarter of warm-up: 9 samples, the last third of which is 40 MB more.
    lines = _lines(soak_text(_soak(140.0)))
    assert "Above the limit: environment MB: +40.0." in lines
    assert "environment MB 100.0 140.0 +40.0" in lines
    assert "environment steps /s 50.0 50.0 +0.0 %" in lines
    assert "No value grew or drifted above its limit." in _lines(soak_text(_soak(110.0)))


def test_plots_are_png_files(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="SKIPPED: plots need matplotlib (the extra `analysis`)")
    plots.require_matplotlib()
    plots.plot_scaling(SCALING, tmp_path / "scaling.png")
    plots.plot_soak(_soak(100.0), tmp_path / "soak.png")
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in ("scaling.png", "soak.png"))
    assert [plots._short(value) for value in (512, 20_000, 1_000_000)] == ["512", "20 k", "1 M"]
    assert plots._minutes([0.0, 60.0, 120.0], 4) == [0.5, 1.0, 1.5, 2.0]
