"""Results of a trial: the file, the lines, JUnit XML."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.trials.records import Cause, Verdict
from gibson_sim.trials.report.junit import junit_xml
from gibson_sim.trials.report.log_tail import log_tail
from gibson_sim.trials.report.results import Rate, read_results, write_results
from gibson_sim.trials.report.words import plan_table, replay_command, rerun_command, run_line
from support.trial_results import failed, passed, spec, trial


def test_rate_is_reported_with_the_wilson_interval() -> None:
    # 8 of 10 with z = 1.96: middle (0.8 + 0.19207) / 1.38415 = 0.71674, spread 0.22659.
    low, high = Rate(8, 10).interval
    assert (low, high) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert Rate(8, 10).text() == "8 of 10 passed (80 %; 95 % interval 49 to 94 %)"


def test_totals_count_runs_verdicts_and_causes() -> None:
    totals = trial([passed(0), failed(1), failed(2), failed(3, "it stood", "blocked")], planned=5).totals()
    assert (totals["planned"], totals["runs"], totals["passed"], totals["failed"]) == (5, 4, 1, 3)
    assert totals["verdicts"] == {"reached": {"passed": 4, "count": 4}, "collisions": {"passed": 1, "count": 4}}
    assert totals["causes"] == {"collision": [1, 2], "blocked": [3]}
    assert totals["simulated_s"] == pytest.approx(32.2 + 3 * 121.0)


def test_results_are_read_as_they_were_written(tmp_path: Path) -> None:
    before = trial([passed(0, digest="ab"), failed(1)], scenario={"path": Path("a.yaml")}, workers="2")
    after = read_results(write_results(before, tmp_path))
    assert after == replace(before, scenario={"path": "a.yaml"})
    assert read_results(tmp_path) == after


def test_numbers_that_json_lacks_are_left_out(tmp_path: Path) -> None:
    result = replace(passed(0), measures={"time": 1.0, "clearance": math.inf}, verdicts=(Verdict("x", True, "", math.nan),))
    text = write_results(trial([result]), tmp_path).read_text()
    json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} in the file"))
    (again,) = read_results(tmp_path).results
    assert again.measures == {"time": 1.0}
    assert again.verdicts[0].value is None


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"results": [1]}', '{"results": [{"run": {}}]}', "\0", "[" * 100_000, "\udcff"]
)
def test_a_file_of_another_kind_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    file = tmp_path / "results.json"
    file.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(ConfigError, match=r"is not the results\.json of a trial") as caught:
        read_results(file)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"before\.json: cannot be read: No such file"):
        read_results(tmp_path / "before.json")


def test_the_line_of_a_run_reports_its_result() -> None:
    assert run_line(passed(12)) == "ok    12 linden_flat 4.2,2.8 -> 7.4,6.6  reached in 31.2 s, 12.1 m (ratio 1.08)"
    assert run_line(failed(13)) == "FAIL  13 linden_flat 4.2,2.8 -> 7.4,6.6  collision with chair_2 at 3.2,4.1 after 12.3 s"


def test_the_line_of_a_run_is_one_line_whatever_the_cause_quotes() -> None:
    line = run_line(replace(failed(1), cause=Cause("stack died", "it said \x1b[31m\n" + "y" * 5000)))
    assert line.isprintable()
    assert len(line) < 550


def test_the_line_names_a_scene_by_its_folder_or_file() -> None:
    assert "FAIL   1 my_flat 4.2" in run_line(failed(1, scene="/data/my_flat/scene.yaml"))
    assert "FAIL   1 hall 4.2" in run_line(failed(1, scene="worlds/hall.sdf"))


def test_commands_are_quoted_for_a_shell() -> None:
    assert replay_command(Path("out/my trial"), 13) == "gibson-sim replay 'out/my trial/runs/0013/bag' --verify"
    assert rerun_command("a b.yaml", 13, ["--runs", "20"]) == "gibson-sim trial 'a b.yaml' --runs 20 --run 13"


def test_the_plan_is_a_line_a_run() -> None:
    heading, line = plan_table(
        [spec(7, start=(1.0, -0.0, math.pi / 2), drawn={"slip": 0.1234}, closed_doors=("d",))]
    ).splitlines()
    assert heading.split(maxsplit=7) == ["run", "scene", "robot", "start", "goal", "shortest", "seed", "obstacles, random values"]
    assert line.split(maxsplit=8) == [
        "7",
        "linden_flat",
        "gibson_bot",
        "1.00,0.00,90",
        "7.40,6.60,0",
        "11.2",
        "m",
        "107",
        "1 doors closed, slip 0.123",
    ]


def test_the_plan_has_no_empty_column() -> None:
    heading, *_ = plan_table([spec(0), spec(1)]).splitlines()
    assert heading.split() == ["run", "scene", "robot", "start", "goal", "shortest", "seed"]


def test_junit_has_a_case_for_each_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("out/a/runs/0001/bag").mkdir(parents=True)
    broken = failed(2, "the render node was killed", "simulation failed")
    top = ElementTree.fromstring(junit_xml(trial([passed(0), failed(1), broken]), Path("out/a"), ["--runs", "3"]))
    (suite,) = top
    assert (top.tag, suite.tag) == ("testsuites", "testsuite")
    assert {k: suite.get(k) for k in ("name", "tests", "failures", "errors", "skipped", "time", "timestamp", "hostname")} == {
        "name": "rooms", "tests": "3", "failures": "1", "errors": "1", "skipped": "0", "time": "271.200", "timestamp": "2026-11-25T10:00:00",
        "hostname": "here",
    }  # fmt: skip
    good, bad, error = suite
    assert good.attrib == {"classname": "linden_flat.gibson_bot", "name": "0000 4.2,2.8 -> 7.4,6.6", "time": "31.200"}
    assert [child.tag for child in good] == ["system-out"]
    problem = bad.find("failure")
    assert problem is not None
    assert problem.attrib == {"message": "collision with chair_2 at 3.2,4.1 after 12.3 s", "type": "collision"}
    assert problem.text == "collisions: 1 collision, at most 0"
    assert error.findtext("system-out") == "run again: gibson-sim trial rooms.yaml --runs 3 --run 2"
    assert bad.findtext("system-out") == (
        "replay bit for bit: gibson-sim replay out/a/runs/0001/bag --verify\nrun again: gibson-sim trial rooms.yaml --runs 3 --run 1"
    )
    assert [child.tag for child in error] == ["error", "system-out"]


def test_junit_survives_characters_that_xml_does_not_allow() -> None:
    bad = replace(failed(1, "\0\x1b\ud800 </testcase> ]]> &"), verdicts=(Verdict("x\0", False, "\x08 <b>"),))
    top = ElementTree.fromstring(junit_xml(trial([bad], name="a\x01b"), Path("out")))
    problem = top.find(".//failure")
    assert problem is not None
    assert problem.get("message", "").endswith("</testcase> ]]> &")
    assert problem.text == "x�: � <b>"
    assert top.get("name") == "a�b"


def test_log_tail_is_clean(tmp_path: Path) -> None:
    log = tmp_path / "stack.log"
    log.write_bytes(b"\x1b[31mred\x1b[0m\r\nold\rnew\nNUL \0 and \xff\n\n")
    assert log_tail(log) == "red\nnew\nNUL � and �"


def test_log_tail_is_short_whatever_was_printed(tmp_path: Path) -> None:
    log = tmp_path / "stack.log"
    log.write_bytes(b"a" * 3_000_000 + b"\n" + b"b\n" * 1000)
    assert log_tail(log).splitlines() == ["b"] * 40
    log.write_bytes(b"c" * 3_000_000)
    assert len(log_tail(log)) < 300


def test_log_tail_is_the_last_ten_seconds_of_lines_with_stamps(tmp_path: Path) -> None:
    log = tmp_path / "stack.log"
    log.write_text("".join(f"[INFO] [{1000 + t}.000000000] [planner]: {t}\nmore of {t}\n" for t in range(30)))
    lines = log_tail(log).splitlines()
    assert lines[0] == "[INFO] [1019.000000000] [planner]: 19"
    assert lines[-1] == "more of 29"
    assert len(lines) == 22


def test_log_tail_of_no_file_is_empty(tmp_path: Path) -> None:
    assert log_tail(tmp_path / "stack.log") == ""
