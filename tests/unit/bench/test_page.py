"""Reports side by side, and on a page."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from gibson_sim.cli.main import main
from gibson_sim.errors import ConfigError
from gibson_sim_bench.reports.compare import changes, compare_text
from gibson_sim_bench.reports.page import BEGIN, END, write_page
from gibson_sim_bench.scaling import KINDS, ScalingReport, ScalingRow, kinds_of
from gibson_sim_bench.soak import Samples, SoakReport
from unit.bench.test_render import REPORT as PEERS
from unit.bench.test_rows import FACTS, REPORT as TABLE

SCALING = ScalingReport(
    FACTS, tuple(ScalingRow(kind.name, k + 1, 2.0 * (k + 1), 500.0, 300.0) for kind in KINDS for k in range(3))
)


def _soak() -> SoakReport:
    environment, running = Samples(), Samples()
    for k in range(12):
        environment.add(10.0 * k, **{"environment_MB": 100.0 + 10.0 * k, "open_files": 6.0, "environment_steps_/s": 50.0})
        running.add(10.0 * k, **{"render_node_MB": 200.0, "images_received_/s": 30.0 if k < 8 else 20.0})
    return SoakReport(FACTS, 1200, 3, environment, 120.0, 3000, running)


def _write(folder: Path, **reports: object) -> None:
    folder.mkdir(exist_ok=True)
    for name, report in reports.items():
        (folder / f"{name}.json").write_text(json.dumps(report))


def test_slower_figures_are_flagged_whether_more_or_less_is_better() -> None:
    old = {"figures": [_figure("a", 100.0), _figure("b", 10.0, "less"), _figure("c", 5.0), _figure("gone", 1.0)]}
    new = {"figures": [_figure("a", 50.0), _figure("b", 20.0, "less"), _figure("c", 5.2), _figure("new", 1.0)]}
    assert [(c.name, c.gain, c.verdict(0.15)) for c in changes(old, new)] == [
        ("a", 0.5, "SLOWER"), ("b", 0.5, "SLOWER"), ("c", 1.04, ""),
    ]  # fmt: skip
    assert changes({"figures": [_figure("a", 1.0)]}, {"figures": [_figure("a", 2.0)]})[0].verdict(0.15) == "faster"
    text = compare_text(old, new)
    assert "3 figures in both, 2 slower by more than 15 %" in text
    assert "Only before: gone" in text and "Only after: new" in text


def _figure(name: str, value: float, better: str = "more") -> dict[str, object]:
    return {"name": name, "value": value, "unit": "1/s", "better": better}


def test_comparison_names_different_machines() -> None:
    other = replace(TABLE, facts=replace(FACTS, machine="another"))
    assert "different machines" in compare_text(TABLE.as_json(), other.as_json())


def test_comparing_is_information_and_never_a_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    slow = replace(TABLE, rows=tuple(replace(row, fps=row.fps / 3) for row in TABLE.rows))
    _write(tmp_path, a=TABLE.as_json(), b=slow.as_json())
    with pytest.raises(SystemExit) as end:
        main(["bench", "compare", str(tmp_path / "a.json"), str(tmp_path / "b.json")])
    assert end.value.code == 0
    assert capsys.readouterr().out.count("SLOWER") == len(TABLE.rows)


def test_a_file_without_figures_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _write(tmp_path, a={"kind": "none"})
    with pytest.raises(SystemExit) as end:
        main(["bench", "compare", str(tmp_path / "a.json"), str(tmp_path / "a.json")])
    assert end.value.code != 0
    assert "holds no figures" in capsys.readouterr().err


def test_growth_and_drift_are_problems() -> None:
    assert _soak().problems == ["environment MB: +60.0", "images received /s: -33 %"]


def test_the_page_has_every_report_with_its_plots_and_keeps_what_people_wrote(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="SKIPPED: plots need matplotlib (the extra `analysis`)")
    reports = {"table1_cpu": TABLE.as_json(), "scaling_cpu": SCALING.as_json(), "long_cpu": _soak().as_json()}
    _write(tmp_path / "data", **reports, peers_cpu={**PEERS.as_json(), "kind": "peers"}, other={"x": 1})
    page = tmp_path / "benchmarks.md"
    page.write_text(f"# Mine\n\n{BEGIN}\nold\n{END}\n\nAfter.\n")
    messages = write_page(tmp_path / "data", page, tmp_path / "images")
    text = page.read_text()
    assert text.startswith("# Mine\n")
    assert text.endswith("After.\n")
    assert "old" not in text
    for part in (
        "## The paper's table",
        "## Third-party renderers",
        "## Scaling",
        "## Long runs",
        "(data/table1_cpu.json)",
        "RGB-D, pre-filled",
    ):
        assert part in text
    assert sorted(p.name for p in (tmp_path / "images").iterdir()) == [
        "bench_long_cpu.png", "bench_scaling_cpu.png", "bench_table1_cpu.png",
    ]  # fmt: skip
    assert "other.json: has no figures, left out" in messages


def test_the_page_of_a_summary_names_bottlenecks_and_missed_targets(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="SKIPPED: plots need matplotlib (the extra `analysis`)")
    _write(tmp_path / "data", table1_cpu=TABLE.as_json())
    write_page(tmp_path / "data", tmp_path / "b.md", tmp_path)
    text = (tmp_path / "b.md").read_text()
    assert "2 of 3 rows reach 70 % or more" in text
    assert "In process: from 160 frames/s (RGB-D, pre-filled, 1 substep) to 800 (sensor only, 1)" in text


def test_a_page_without_a_place_for_figures_is_not_touched(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="SKIPPED: plots need matplotlib (the extra `analysis`)")
    _write(tmp_path / "data", table1_cpu=TABLE.as_json())
    (tmp_path / "b.md").write_text("mine")
    with pytest.raises(ConfigError, match="has no lines"):
        write_page(tmp_path / "data", tmp_path / "b.md", tmp_path)
    assert (tmp_path / "b.md").read_text() == "mine"


def test_an_unknown_kind_of_growth_is_refused() -> None:
    assert [kind.name for kind in kinds_of("robots,bodies")] == ["robots", "bodies"]
    with pytest.raises(ConfigError, match="must be of triangles"):
        kinds_of("money")
