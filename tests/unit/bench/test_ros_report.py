"""The bench of ROS: statistics, targets, text and JSON, from numbers made by hand."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from gibson_sim.errors import ConfigError
from gibson_sim.robots.load import load_robot
from gibson_sim_bench.cli import ros as cli
from gibson_sim_bench.protocol import write_changed_robot
from gibson_sim_bench.ros import (
    ClockCost,
    Pipeline,
    RosPlan,
    RosReport,
    RoundTrip,
    Size,
    Spread,
    Transport,
    pipeline_of,
    report_text,
    spread,
    targets,
)

MS = 1_000_000
VGA = Size(640, 480)
REPORT = RosReport(
    "2026-01-02T03:04:05+00:00",
    "0.1.0 (abc)",
    "x86_64, 2 x CPU",
    2,
    0.25,
    {"rclpy": "7.1.6"},
    (
        RoundTrip("standard", "message", 100, 500, Spread(500.0, 600.0, 1234.0)),
        RoundTrip("events", "bytes", 100, 500, Spread(200.0, 250.0, 300.0)),
    ),
    (
        Transport("events", VGA, 60.0, 600, 600, Spread(1.5, 2.0, 2.5)),
        Transport("standard", VGA, 60.0, 600, 599, Spread(1.0, 2, 3)),
    ),
    (ClockCost("standard", False, True, 20.0, 0.01, 0.0), ClockCost("events", True, True, 20.0, 2.5, 20.0)),
    (Pipeline(VGA, 30.0, 60, 57, 2.0, 0.99, Spread(10.0, 11.0, 12.0), Spread(12.0, 13.0, 14.0)),),
    ("clock, x: no output",),
)


def test_spread_is_median_p95_and_p99() -> None:
    assert spread([float(i) for i in range(101)]) == Spread(50.0, 95.0, 99.0)


def test_an_empty_measurement_has_no_number() -> None:
    assert all(math.isnan(value) for value in (spread([]).median, spread([]).p95, spread([]).p99))


def test_round_trips_a_second_are_those_of_the_median() -> None:
    assert [trip.per_s for trip in REPORT.round_trips] == [2000.0, 5000.0]


def test_the_best_row_counts_and_a_lost_image_misses_the_target() -> None:
    found = targets(REPORT)
    assert [(t.measured, t.how, t.met) for t in found] == [
        ("5,000/s", "events, bytes", True),
        ("1.50 ms, 0 lost", "events", True),
        ("2.50 %", "events", False),
    ]
    assert not targets(replace(REPORT, transports=REPORT.transports[1:]))[1].met


def test_unmeasured_parts_have_no_target() -> None:
    assert targets(replace(REPORT, round_trips=(), transports=(), clocks=())) == []


def test_image_is_lost_where_one_of_its_topics_misses_it_or_it_was_never_drawn() -> None:
    # Four states 10 ms apart in simulation, 20 ms apart in wall time; cameras are due at three of them.
    states = [(10 * MS, 1000 * MS, 1), (20 * MS, 1020 * MS, 0), (30 * MS, 1040 * MS, 1), (40 * MS, 1060 * MS, 1)]
    rgb = [(5 * MS, 980 * MS, 990 * MS), (10 * MS, 1004 * MS, 1006 * MS), (30 * MS, 1045 * MS, 1050 * MS)]
    depth = [(10 * MS, 1005 * MS, 1008 * MS), (40 * MS, 1065 * MS, 1070 * MS)]
    row = pipeline_of(VGA, 50.0, {"seconds": 0.5, "states": states, "images": {"rgb": rgb, "depth": depth}})
    assert (row.due, row.received, row.lost, row.per_s, row.real_time_factor) == (3, 1, 2, 2.0, 0.5)
    assert (row.to_published_ms.median, row.to_received_ms.median) == (4.0, 6.0)


def test_text_has_each_row_the_targets_and_what_was_left_out() -> None:
    lines = report_text(REPORT).splitlines()
    assert "events    bytes            5,000        200  250    300" in lines
    assert "640x480  30 Hz   60        57     3   28.5       0.99          10.0         12.0  13.0  14.0" in lines
    assert "Left out: clock, x: no output" in lines
    assert [line.split()[-1] for line in lines[-3:]] == ["met", "met", "MISSED"]
    assert "2 x CPU" in lines[0] and "2026-01-02" in lines[0]


def test_markdown_has_one_row_for_each_case() -> None:
    assert "| events | bytes | 5,000 | 200 | 250 | 300 |" in report_text(REPORT, markdown=True).splitlines()


def test_json_holds_rows_and_targets_and_no_nan() -> None:
    empty = replace(REPORT, pipelines=(replace(REPORT.pipelines[0], to_received_ms=spread([])),))
    read = json.loads(json.dumps(empty.as_json(), allow_nan=False))
    assert read["pipelines"][0]["to_received_ms"] == {"median": None, "p95": None, "p99": None}
    assert read["pipelines"][0]["size"] == {"width": 640, "height": 480}
    assert [target["met"] for target in read["targets"]] == [True, True, False]
    assert read["round_trips"][1]["us"]["median"] == 200.0


def _plan(*words: str) -> RosPlan:
    parser = argparse.ArgumentParser()
    cli.add_parser(parser.add_subparsers())
    return cli.plan_of(parser.parse_args(["ros", *words]))


def test_command_line_alone_is_the_plan_alone() -> None:
    assert _plan() == RosPlan()


def test_parts_and_scene_can_be_chosen() -> None:
    assert _plan("--quick", "--only", "clock,state", "--scene", "x") == replace(RosPlan.quick(("clock", "state")), scene="x")


def test_unknown_part_is_refused() -> None:
    with pytest.raises(ConfigError, match="must be of state, transport, clock, pipeline"):
        _plan("--only", "speed")


def test_robot_of_the_bench_has_one_camera_of_the_requested_size(tmp_path: Path) -> None:
    path = write_changed_robot(tmp_path, (1280, 720))
    assert len(yaml.safe_load(path.read_text())["cameras"]) == 1
    cameras = load_robot(path).cameras
    assert [(camera.name, camera.width, camera.height) for camera in cameras] == [(cli.CAMERA, 1280, 720)]
