"""The rows of the paper's table: rates, limits, targets, text and JSON, from numbers made by hand."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.robots.load import load_robot
from gibson_sim_bench.cli import table1 as cli
from gibson_sim_bench.protocol import STEP_HZ, RandomCommands, Table1Plan, write_robot
from gibson_sim_bench.reports.paper import FILL, FILLED, MODES, SENSOR_ONLY
from gibson_sim_bench.reports.table1 import report_text
from gibson_sim_bench.rows import (
    BULLET,
    COPY,
    DDS,
    FREE,
    HOST,
    IN_PROCESS,
    LOCKSTEP,
    OPENGL,
    TENSOR,
    Table1,
    Table1Row,
    free_row,
    lockstep_row,
    paper_of,
    row_of,
    table_of,
    targets,
)
from gibson_sim_bench.timing import Facts

MS = 1_000_000
MESSAGE_MS = {"convert": 0.1, "encode": 0.2, "publish": 0.3, "transport": 0.7}
FACTS = Facts("2026-01-02T03:04:05+00:00", "0.1.0 (abc)", "x86_64, 2 x CPU", 2, 0.25, "3.11", "llvmpipe", "4.5")


def _row(mode: str, fps: float, way: str = IN_PROCESS, substeps: int = 1, **more: object) -> Table1Row:
    bounds = {BULLET: 1.0, **({OPENGL: 4.0, COPY: 0.0} if mode != SENSOR_ONLY else {})}
    row = Table1Row(
        way, HOST, mode, "flat", 1000, 256, 256, substeps, fps, fps / 2, 2 * fps, 100, {"step": 1.5, "convert": 0.5}, bounds
    )
    return replace(row, **more)  # type: ignore[arg-type]


RGBD = _row("RGB-D, pre-filled", 160.0)
REPORT = Table1(
    FACTS, "gibson_bot", "cpu", (_row(SENSOR_ONLY, 800.0), RGBD, _row("RGB-D, pre-filled", 120.0, LOCKSTEP)), ("x: y",)
)


def test_the_limit_is_one_second_by_the_sum_of_the_parts_and_the_largest_bounds() -> None:
    assert (RGBD.bound_fps, RGBD.share, RGBD.bound_by) == (200.0, 0.8, OPENGL)


def test_overheads_beyond_the_limit_are_named_the_largest_first() -> None:
    row = replace(RGBD, fps=100.0, stages={"step": 1.5, "convert": 0.5, "draw": 6.0, "read back": 0.25})
    assert row.overhead_ms == {
        "level of detail, culling": 2.0,
        "waiting, CPU contention": 1.75,
        "Python around the step": 0.5,
        "reading the state": 0.5,
        "readback": 0.25,
    }


def test_without_measured_parts_there_is_no_limit() -> None:
    row = replace(RGBD, bounds={})
    assert math.isnan(row.bound_fps)
    assert row.bound_by == ""


def test_rates_are_those_of_the_median_time() -> None:
    values = {"way": IN_PROCESS, "to": HOST, "mode": "RGB", "scene": "x", "triangles": 1, "width": 1, "height": 1, "substeps": 0}
    row = row_of([0.01, 0.02, 0.04], **values)
    assert (row.fps, row.frames) == (50.0, 3)


def test_lockstep_counts_from_tick_to_tick_and_is_bound_by_messages_too() -> None:
    row = lockstep_row([0.01, 0.01, 0.01], RGBD, MESSAGE_MS)
    assert (row.way, row.fps, row.bounds[DDS], row.stages["convert"]) == (LOCKSTEP, 100.0, 1.0, 0.6)
    assert row.bounds[BULLET] == 1.0


def test_a_subscriber_counts_received_images_not_rendered_ones() -> None:
    # 3 sets in the last 100 ms, in a burst; 10 ticks were made.
    row = free_row([0, 1 * MS, 100 * MS], 10, RGBD, MESSAGE_MS)
    assert (row.fps, row.lost) == (20.0, 0.7)
    assert BULLET not in row.bounds  # it has a process of its own
    assert set(free_row([0, MS, 2 * MS], 3, _row(SENSOR_ONLY, 800.0), MESSAGE_MS).bounds) == {BULLET}


def test_targets_are_those_of_two_cores() -> None:
    found = {target.what: (target.measured, target.met) for target in targets(REPORT.rows)}
    assert found == {
        "sensor only, 1 substep, in process": ("800/s", False),
        "RGB-D, pre-filled, 1 substep, in process": ("160/s", True),
        "RGB-D, pre-filled, lockstep relative to in process": ("75 %", False),
    }


def test_the_paper_stands_beside_its_own_rows_alone() -> None:
    assert paper_of(RGBD) == {"v2": 264.2, "v1": 58.5, "habitat": None}
    assert paper_of(_row("all outputs", 1.0))["v2"] is None
    scene = replace(RGBD, substeps=0, mode="RGB", width=640, height=480)
    assert paper_of(scene) == {"v2": 620.4, "v1": None, "habitat": 752.9}
    assert paper_of(replace(scene, mode="RGB-D"))["v2"] is None


def test_a_report_survives_json() -> None:
    read = json.loads(json.dumps(REPORT.as_json(), allow_nan=False))
    back = table_of(read)
    assert [row.key for row in back.rows] == [row.key for row in REPORT.rows]
    assert back.facts == FACTS
    assert read["filled_by"] == FILL
    assert read["figures"][0] == {"name": REPORT.rows[0].key, "value": 800.0, "unit": "frames/s", "better": "more"}
    assert (read["rows"][1]["share"], read["rows"][1]["paper"]["v2"]) == (0.8, 264.2)


def test_the_text_has_the_row_with_filled_holes_and_what_is_not_comparable() -> None:
    filled = replace(RGBD, mode=FILLED, fps=40.0, stages={**RGBD.stages, "fill": 12.5})
    text = report_text(replace(REPORT, rows=(*REPORT.rows, filled)))
    assert any(line.startswith("RGB-D, filled") and line.endswith("30.6") for line in text.splitlines())
    assert filled.overhead_ms["hole filling"] == 12.5
    for part in ("GTX 1080 Ti", "Tesla V100", "24,400 Bullet steps", "2 x CPU", "abc", "load 0.25", "Left out: x: y", "MISSED"):
        assert part in text


def test_tensors_have_a_column_of_their_own() -> None:
    rows = (RGBD, replace(RGBD, to=TENSOR, fps=7654.0, bounds={}))
    line = next(line for line in report_text(replace(REPORT, rows=rows)).splitlines() if line.startswith("RGB-D, pre-filled"))
    assert line.split()[2:5] == ["1", "160", "7,654"]


def test_commands_change_ten_times_a_second_whatever_a_frame_is_and_are_the_same_for_all() -> None:
    slow, quick = RandomCommands(24), RandomCommands(1)
    assert [slow.next() for _ in range(3)] == [quick.next() for _ in range(3 * 24)][::24]
    assert STEP_HZ // 24 == 10


def test_the_robot_of_the_table_has_one_camera_and_no_lidar(tmp_path: Path) -> None:
    robot = load_robot(write_robot(tmp_path, (256, 256)))
    assert [(c.width, c.height, round(math.degrees(c.fov_y))) for c in robot.cameras] == [(256, 256, 90)]
    assert robot.sensors.lidars == ()


def _plan(*words: str) -> Table1Plan:
    parser = argparse.ArgumentParser()
    cli.add_parser(parser.add_subparsers())
    return cli.plan_of(parser.parse_args(["table1", *words]))


def test_command_line_alone_is_the_plan_alone() -> None:
    assert _plan() == Table1Plan()


def test_scenes_of_the_user_replace_the_built_in_ones() -> None:
    plan = _plan("--quick", "--only", "houses", "--house", "a", "--house", "b", "--device", "1", "--scene", "flat")
    assert plan == replace(Table1Plan.quick(), parts=("houses",), scan_scenes=("a", "b"), device=1, scene="flat")


def test_an_unknown_part_is_refused() -> None:
    with pytest.raises(ConfigError, match="must be of in process, lockstep, free-running, houses"):
        _plan("--only", "speed")


def test_a_simulation_of_the_table_has_a_tick_for_each_frame() -> None:
    words = cli._command(LOCKSTEP, "flat", Path("r.yaml"), 24, [MODES[1]])
    assert "--camera-fill" not in words
    filled = cli._command(LOCKSTEP, "flat", Path("r.yaml"), 24, [MODES[2]])
    assert filled[filled.index("--camera-fill") + 1] == FILL
    assert [words[words.index(f"--{name}") + 1] for name in ("step-hz", "publish-hz", "camera-rate")] == ["240", "10", "10"]
    assert words[words.index("--camera-outputs") + 1] == "rgb,depth"
    assert "--no-render" in cli._command(FREE, "flat", Path("r.yaml"), 1, [MODES[0]])
