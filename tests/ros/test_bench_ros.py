"""``gibson-sim bench ros`` with tiny sizes: the figures have sane content, whatever they are."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

from gibson_sim.cli.main import main  # noqa: E402
from gibson_sim.processes.domain_lock import DomainLock  # noqa: E402
from gibson_sim_bench.cli import ros as bench_ros  # noqa: E402
from gibson_sim_bench.cli.ros import measure  # noqa: E402
from gibson_sim_bench.ros import IdleNode, RosPlan, RoundTripMethod, Size, report_text  # noqa: E402

pytestmark = pytest.mark.ros
TINY = RosPlan(
    bodies=3,
    round_trips=10,
    transport_size=Size(64, 48),
    transport_images=6,
    clock_s=0.5,
    idle_nodes=(IdleNode("events", True), IdleNode("polled", True), IdleNode("standard", False)),
    pipeline_sizes=(Size(64, 48),),
    pipeline_hz=(10.0,),
    pipeline_s=0.5,
)


def test_every_round_trip_is_counted_whichever_way_it_goes(ros_domain: int) -> None:
    ways = (("standard", "message"), ("events", "bytes"), ("wait set", "message"), ("wait set", "bytes"))
    plan = RosPlan(("state",), bodies=3, round_trips=10, methods=tuple(RoundTripMethod(*way) for way in ways))
    report = measure(plan)
    assert report.left_out == ()
    assert [(trip.executor, trip.form) for trip in report.round_trips] == list(ways)
    for trip in report.round_trips:
        assert (trip.bodies, trip.count) == (3, 10)
        assert 0.0 < trip.us.median <= trip.us.p95 <= trip.us.p99


def test_images_are_counted_once_and_have_an_age(ros_domain: int) -> None:
    report = measure(RosPlan(("transport",), transport_size=TINY.transport_size, transport_images=6))
    assert report.left_out == ()
    assert [row.executor for row in report.transports] == ["standard", "events", "wait set"]
    assert all(0 < row.received <= row.sent == 6 and row.ms.median > 0.0 for row in report.transports)


def test_clock_reaches_the_node_that_uses_it_and_no_other(ros_domain: int) -> None:
    report = measure(RosPlan(("clock",), clock_s=TINY.clock_s, idle_nodes=TINY.idle_nodes))
    assert report.left_out == ()
    *listening, idle = report.clocks
    assert all(row.clock_s > 0.0 and row.cpu_percent > 0.0 for row in listening)
    assert idle.clock_s == 0.0


def test_running_simulation_is_measured_from_its_own_images(ros_domain: int) -> None:
    report = measure(RosPlan(("pipeline",), **{k: getattr(TINY, k) for k in ("pipeline_sizes", "pipeline_hz", "pipeline_s")}))
    assert report.left_out == ()
    (row,) = report.pipelines
    assert 0 < row.received <= row.due
    assert row.to_received_ms.median >= row.to_published_ms.median > 0.0
    assert "64x48" in report_text(report)


def test_a_scenario_beside_a_running_simulation_is_refused(ros_domain: int) -> None:
    lock = DomainLock(ros_domain)
    done = subprocess.run(
        [sys.executable, "-m", "gibson_sim.cli.main", "bench", "ros", "--only", "clock"], capture_output=True, text=True
    )
    lock.close()
    assert done.returncode == 3
    assert "a simulation runs in ROS domain" in done.stderr


def test_report_goes_to_the_file_that_is_named(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny = RosPlan(("state",), bodies=3, round_trips=10, methods=(RoundTripMethod("events", "bytes"),))
    monkeypatch.setattr(bench_ros, "plan_of", lambda args: tiny)
    path = tmp_path / "new" / "ros.json"
    with pytest.raises(SystemExit) as end:
        main(["bench", "ros", "--json", str(path)])
    assert end.value.code == 0
    assert [row["count"] for row in json.loads(path.read_text())["round_trips"]] == [10]
    assert "Targets for two cores" in capsys.readouterr().out
