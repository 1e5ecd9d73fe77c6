"""``gibson-sim top`` with nodes that report, and alone."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from support.simulation import Listener, require

require("rclpy", "gibson_msgs")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402

pytestmark = pytest.mark.ros


@pytest.fixture
def reporting(listener: Listener) -> Iterator[None]:
    """A simulation as top sees it: a clock that goes at a fiftieth of wall time, and one status."""
    clock = listener.node.create_publisher(Clock, "/clock", 10)
    diagnostics = listener.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    status = DiagnosticStatus(level=DiagnosticStatus.WARN, name="test: a node", message="is tired")
    status.values = [KeyValue(key="late_ticks", value="17")]
    end = threading.Event()

    def publish() -> None:
        stamp = Clock()
        while not end.wait(0.02):
            stamp.clock.nanosec += 400_000
            clock.publish(stamp)
            diagnostics.publish(DiagnosticArray(status=[status]))

    thread = threading.Thread(target=publish)
    thread.start()
    yield
    end.set()
    thread.join()


def _top(*argv: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "gibson_sim.cli.main", "top", *argv]
    return subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)


def test_one_table_shows_what_every_node_reported_and_has_no_escapes_in_a_pipe(reporting: None) -> None:
    done = _top("--once")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert "simulation time 0." in lines[0]
    assert "real-time factor 0.0" in lines[0] and "factor 0.000" not in lines[0], (
        "measured from the first /clock, before which none was known"
    )
    assert lines[2:4] == ["test: a node  WARN  is tired", "  late_ticks 17"]
    assert "\x1b" not in done.stdout


def test_one_table_waits_for_every_node_that_reports(reporting: None, listener: Listener) -> None:
    late = Node("late", context=listener.node.context, use_global_arguments=False)
    publisher = late.create_publisher(DiagnosticArray, "/diagnostics", 10)
    end = threading.Event()

    def publish() -> None:
        while not end.wait(2.5):  # slower than top looks for others
            publisher.publish(DiagnosticArray(status=[DiagnosticStatus(name="late: a node", message="is slow")]))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        lines = _top("--once").stdout.splitlines()
    finally:
        end.set()
        thread.join()
        late.destroy_node()
    assert [line for line in lines if " a node" in line] == ["late: a node  OK  is slow", "test: a node  WARN  is tired"]


def test_topics_are_listed_with_their_types(reporting: None) -> None:
    rows = {line.split()[0]: line.split() for line in _top("--once", "--topics").stdout.splitlines() if line.startswith("/")}
    assert rows["/clock"][-1] == "rosgraph_msgs/msg/Clock"
    assert float(rows["/diagnostics"][1]) > 0.0


def test_top_without_a_simulation_reports_that_and_exits_with_three(ros_domain: int) -> None:
    done = _top("--once")
    assert done.returncode == 3
    assert done.stderr.count("\n") == 1
    assert f"no simulation runs in ROS domain {ros_domain}" in done.stderr
    assert done.stdout == ""
