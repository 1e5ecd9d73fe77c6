"""``bench table2``: plans, a folder that goes on, rates and differences by hand, the page."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gibson_path_following.types import Velocity
from gibson_sim.errors import ConfigError
from gibson_sim.jobs.units import Unit, UnitResult
from gibson_sim_bench.cli import table2
from gibson_sim_bench.path_following.plan import RunKey, Table2Plan, keys_of, seeds_of
from gibson_sim_bench.path_following.report import report_page, report_text
from gibson_sim_bench.path_following.runs import GogglesDriver, RunResult, kind_of, result_of, run_path
from gibson_sim_bench.path_following.store import Store
from gibson_sim_bench.path_following.strips import examples, write_strips
from gibson_sim_bench.path_following.table import Table2, cells_of, differences_of, paired_interval
from gibson_sim_learn.path_following.cases import PathCase
from gibson_sim_learn.path_following.drives import Observation, Tick, Trace
from support.scenes import write_room

WALL = "  - {name: middle, box: [2.6, 0.2, 2.0], pose: {xyz: [-0.6, 0.0, 1.0]}, semantic_class: wall}\n"


def result(method: str, path: int, kind: str = "success", *, domain: str = "trained", length: float = 6.6) -> RunResult:
    success = kind == "success"
    return RunResult(
        RunKey("room", length, path, 0, domain, method), kind, success, success, 1.0 if success else 0.5,
        0 if success else 1, 5.0, 0.1, 0.2, 0.0, 1.0 if success else 0.0, 20.0, "finished", "finished", seconds=2.0,
    )  # fmt: skip


class Here:
    """A backend that runs units in this process, and counts them."""

    def __init__(self) -> None:
        self.runs = 0

    def stop(self) -> bool:
        return False

    def progress(self, text: str) -> None:
        self.runs += 1
        self._on_progress("", text)

    def path(self, path: str | Path) -> Path:
        return Path(path)

    def run(
        self,
        units: Sequence[Unit],
        output: Path,
        on_result: Callable[[UnitResult], None],
        on_progress: Callable[[str, str], None],
        stop: Callable[[], bool],
    ) -> None:
        self._on_progress = on_progress
        for unit in units:
            on_result(UnitResult(unit.id, run_path(json.loads(json.dumps(unit.arguments)), output, self)))


def room_plan(folder: Path, **changes: Any) -> Table2Plan:
    scene = str(write_room(folder / "room", WALL))
    plan = Table2Plan(runs=1, lengths=(3.5,), domains=("trained",), methods=("oracle", "teach_repeat"), scenes=(scene,), paths=1)
    return replace(plan, **changes)


def test_a_call_goes_on_where_the_last_one_ended(tmp_path: Path) -> None:
    plan, folder = room_plan(tmp_path), tmp_path / "out"
    first = Here()
    assert Store(folder, plan).run(first) == []
    assert first.runs == 2
    (file,) = (folder / "runs").glob("*.jsonl")
    lines = file.read_text().splitlines()
    assert result_of(json.loads(lines[0])).kind == "success"

    file.write_text(lines[0] + "\n" + lines[1][:40])  # it broke off while a line was written
    again = Here()
    store = Store(folder, plan)
    assert store.run(again) == []
    assert again.runs == 1
    assert not store.missing()
    before, after = (result_of(json.loads(line)) for line in (lines[1], file.read_text().splitlines()[-1]))
    assert replace(before, seconds=0.0) == replace(after, seconds=0.0)  # from the same seeds, the same run

    strips = write_strips(store, store.results().values())
    assert any("teach_repeat" in caption for caption in strips)
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in strips.values())

    with pytest.raises(ConfigError, match=r"seed is 0 in this folder, and 1 is asked for; choose another folder"):
        Store(folder, replace(plan, seed=1))


def test_runs_are_shared_out_among_the_paths_of_a_case() -> None:
    cases = [PathCase("room", 6.6, k, ((0.0, 0.0), (1.0, 0.0))) for k in range(3)]
    plan = Table2Plan(runs=7, lengths=(6.6,), domains=("light",), methods=("oracle", "learned"))
    keys = keys_of(plan, cases, "abc")
    assert [len(keys[case]) for case in cases] == [6, 4, 4]  # 3, 2, 2 repeats of two methods
    assert {key.policy for key in keys[cases[0]] if key.method == "learned"} == {"abc"}
    assert {key.policy for key in keys[cases[0]] if key.method == "oracle"} == {""}


def test_other_goggles_are_another_method_and_plain_runs_stay_valid() -> None:
    case = PathCase("room", 6.6, 0, ((0.0, 0.0), (1.0, 0.0)))
    methods = ("learned", "learned+goggles", "learned+histogram", "teach_repeat+goggles", "teach_repeat+grey_world")
    plan = Table2Plan(runs=1, lengths=(6.6,), domains=("light",), methods=methods)
    policies = {key.method: key.policy for key in keys_of(plan, [case], "abc", "xyz")[case]}
    assert policies == {
        "learned": "abc", "learned+goggles": "abc+xyz", "learned+histogram": "abc", "teach_repeat+goggles": "xyz", "teach_repeat+grey_world": "",
    }  # fmt: skip


def test_a_driver_sees_through_goggles_what_the_camera_did_not_show() -> None:
    class Looks:
        needs_view, place, state = True, None, "following"

        def drive(self, sight: Observation) -> Velocity:
            return Velocity(float(sight.view[0][0, 0, 0]), sight.stamp_ns)

    driver = GogglesDriver(Looks(), lambda image: image + np.uint8(7))
    image = np.full((2, 2, 3), 3, np.uint8)
    assert driver.drive(Observation(5, (image,), (0.0, 0.0, 0.0))) == Velocity(10.0, 5)
    assert image.max() == 3


def test_runs_with_goggles_are_compared_with_those_without(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = room_plan(tmp_path).scenes[0]
    folder, parser = tmp_path / "out", argparse.ArgumentParser()
    table2.add_parser(parser.add_subparsers())
    (folder / "runs").mkdir(parents=True)
    keys = [RunKey(scene, 3.5, 0, 0, "light", method) for method in ("teach_repeat", "teach_repeat+histogram")]
    lines = [replace(result("blind", 0, kind), key=key).as_line() for key, kind in zip(keys, ("lost", "success"), strict=True)]
    (folder / "runs" / "room_3.5m_0.jsonl").write_text("\n".join(lines) + "\n")
    options = [
        "--methods",
        "teach_repeat,teach_repeat+histogram",
        "--domains",
        "light",
        "--cases",
        "3.5",
        "--runs",
        "1",
        "--paths",
        "1",
    ]
    args = parser.parse_args(["table2", "--scenes", scene, "--folder", str(folder), "--report-only", "--no-strips", *options])
    assert args.run(args) == 0
    assert "teach_repeat+histogram minus teach_repeat" in capsys.readouterr().out


def test_runs_that_differ_in_method_or_domain_alone_have_the_same_seeds() -> None:
    key = RunKey("scenes/room", 6.6, 1, 2, "light", "oracle")
    seeds = seeds_of(3, key)
    assert seeds == seeds_of(3, replace(key, method="blind", domain="moved", policy="x", scene="elsewhere/room"))
    others = [replace(key, repeat=3), replace(key, path=2), replace(key, length=8.4), replace(key, scene="hall")]
    assert all(seeds_of(3, other) != seeds for other in others)
    assert seeds_of(4, key) != seeds


def test_a_cell_has_rate_interval_means_and_kinds() -> None:
    found = [result("blind", 0), result("blind", 0), result("blind", 1, "hit the scene"), result("blind", 1, "lost")]
    (cell,) = cells_of(found)
    assert (cell.runs, cell.successes, cell.rate) == (4, 2, 0.5)
    # Wilson for 2 of 4: centre (0.5 + 3.8415 / 8) / (1 + 3.8415 / 4) = 0.5, half-width 0.35.
    assert (cell.low, cell.high) == (pytest.approx(0.15, abs=0.001), pytest.approx(0.85, abs=0.001))
    assert cell.coverage == 0.75
    assert cell.collisions_per_metre == pytest.approx(2 / 20.0)
    assert cell.kinds == {"hit the scene": 1, "lost": 1}
    assert cell.paths == ((2, 2), (0, 2))
    assert math.isnan(cell.near_places), "a blind driver estimates none"
    (cell,) = cells_of([replace(result("learned", k), places=10 * (k + 1), near_places=9) for k in range(2)])
    assert cell.near_places == pytest.approx(18 / 30)


def test_differences_are_of_pairs_with_the_same_seed() -> None:
    found = [
        *(result("learned", k) for k in range(4)),
        result("teach_repeat", 0),
        result("teach_repeat", 1, "lost"),
        result("teach_repeat", 2, "lost"),
        result("learned", 0, "lost", length=8.4),
        result("teach_repeat", 0, length=8.4),
    ]
    first, second, together = differences_of(found, "learned", "teach_repeat")
    assert (first.pairs, first.better, first.worse) == (3, 2, 0)  # path 3 has no partner
    assert (second.pairs, second.value) == (1, -1.0)
    assert (together.pairs, together.better, together.worse) == (4, 2, 1)
    assert together.value == pytest.approx(0.25)


def test_the_interval_of_a_difference_by_hand() -> None:
    # n = 102, (8 - 2) / 102 = 0.0588; spread 1.96 sqrt(11 - 36 / 102) / 102 = 0.0627.
    low, high = paired_interval(8, 2, 100)
    assert (low, high) == (pytest.approx(-0.0039, abs=2e-4), pytest.approx(0.1215, abs=2e-4))
    low, high = paired_interval(0, 0, 100)
    assert low == -high != 0.0  # no difference was seen, which does not mean that there is none


def test_kinds_of_failure_name_what_was_hit_first() -> None:
    def trace(state: str, ended: str, *touched: str) -> Trace:
        tick = Tick(0, (0.0, 0.0, 0.0), Velocity(), False, 0.0, state)
        return Trace((tick,), ended, touched)

    assert kind_of(trace("finished", "finished"), success=True, arrived=True, collisions=0) == "success"
    assert kind_of(trace("finished", "finished", "wall"), success=False, arrived=True, collisions=1) == "hit the scene"
    assert kind_of(trace("finished", "finished"), success=False, arrived=False, collisions=0) == "ended elsewhere"
    assert kind_of(trace("lost", "standing"), success=False, arrived=False, collisions=0) == "lost"
    assert kind_of(trace("following", "standing"), success=False, arrived=False, collisions=0) == "stood still"
    assert kind_of(trace("following", "time"), success=False, arrived=False, collisions=0) == "out of time"


def test_strips_are_of_a_success_and_of_each_kind_of_failure() -> None:
    found = [result("teach_repeat", 0), result("teach_repeat", 1), result("blind", 0, "lost"), result("teach_repeat", 2, "lost")]
    chosen = examples(found)
    assert sorted(chosen) == ["lost (teach_repeat, trained, 6.6 m)", "teach_repeat: success (teach_repeat, trained, 6.6 m)"]


def table() -> Table2:
    found = [result("oracle", 0), result("learned", 0), result("teach_repeat", 0, "lost")]
    plan = Table2Plan(methods=("oracle", "learned", "teach_repeat"), domains=("trained",)).as_json()
    return Table2(
        "2026-11-25", "1", "box", 2, plan, "abc", cells_of(found), differences_of(found, "learned", "teach_repeat"), 300
    )


def test_the_report_has_the_papers_figures_beside_and_says_what_it_is() -> None:
    text = report_text(table(), markdown=True)
    assert "| 6.6 m | real robot | the paper | 10 | 0.90 | - | 0.983 |" in text
    assert "3 of 300 runs" in text
    assert "| trained | all | learned minus teach_repeat | 1 | +1.00 |" in text
    assert "sim-to-sim" in text
    assert json.loads(json.dumps(table().as_json()))["differences"][-1]["length"] is None
    named = replace(table(), plan={**table().plan, "model": "/home/me/mine.onnx"})
    assert named.as_json()["plan"]["model"] == "mine.onnx"


def test_the_page_escapes_captions_and_links_to_strips(tmp_path: Path) -> None:
    page = report_page(table(), {"a < b": tmp_path / "strips" / "x.png"}, tmp_path)
    assert 'src="strips/x.png"' in page and "a &lt; b" in page and "a < b" not in page


def test_results_survive_their_line() -> None:
    one = replace(result("blind", 1, "lost"), touched=("wall", "door"))
    assert result_of(json.loads(one.as_line())) == one
    with pytest.raises(ConfigError, match="not as this version writes it"):
        result_of({**asdict(one), "colour": 1})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--runs", "0"], r"runs is 0, must be 1 or more"),
        (["--cases", "long"], r"--cases: 'long' must be numbers"),
        (["--cases", "0.1"], r"a case is 0\.1 m, must be 1 to 100 m"),
        (["--domains", "nigth"], r"no domain 'nigth'.*night"),
        (["--methods", "orakle"], r"no method 'orakle'.*oracle"),
        (["--methods", "learned+gogles"], r"no method 'learned\+gogles'.*learned\+goggles"),
        (["--methods", "blind+goggles"], r"no method 'blind\+goggles'"),
        (["--model", "none.onnx"], r"none\.onnx: .*name an ONNX file"),
        (["--methods", "teach_repeat+goggles", "--goggles", "none.onnx"], r"--goggles none\.onnx: .*name an ONNX file"),
    ],
)
def test_impossible_options_are_refused(options: list[str], message: str) -> None:
    parser = argparse.ArgumentParser()
    table2.add_parser(parser.add_subparsers())
    with pytest.raises(ConfigError, match=message):
        table2.plan_of(parser.parse_args(["table2", *options]))
