"""The paper's table over ROS, with few frames: the figures have sane content, whatever they are."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

from gibson_sim.bench.paper import MODES  # noqa: E402
from gibson_sim.bench.protocol import Plan, write_robot  # noqa: E402
from gibson_sim.bench.rows import DDS, FREE, HOST, IN_PROCESS, LOCKSTEP, OPENGL, Row  # noqa: E402
from gibson_sim.cli.bench_table1 import _exchanged, _over_ros  # noqa: E402
from gibson_sim.cli.environment import node_environment  # noqa: E402

pytestmark = pytest.mark.ros
EXCHANGED = {mode.name: {"convert": 0.1, "encode": 0.1, "publish": 0.1, "transport": 0.1} for mode in MODES}
ALONE = {
    (mode.name, 24): Row(IN_PROCESS, HOST, mode.name, "arena", 10, 256, 256, 24, 9.0, 9.0, 9.0, 3, {}, {OPENGL: 1.0})
    for mode in MODES
}


def test_messages_alone_are_timed_for_every_row(ros_domain: int) -> None:
    found = _exchanged(node_environment(here_alone=True))
    assert set(found) == {mode.name for mode in MODES}
    assert all(ms > 0.0 for row in found.values() for ms in row.values())


@pytest.mark.parametrize(("way", "drawn"), [(LOCKSTEP, True), (FREE, False)])
def test_one_simulation_gives_all_its_rows(ros_domain: int, tmp_path: Path, way: str, drawn: bool) -> None:
    environment = node_environment(here_alone=True)
    plan = Plan(scene="arena", frames=2, sensor_frames=2, seconds=0.3)
    robot = write_robot(tmp_path, (256, 256))
    rows = list(_over_ros(way, plan, environment, robot, 24, drawn, ALONE, EXCHANGED))
    assert [row.mode for row in rows] == [mode.name for mode in MODES if bool(mode.outputs) == drawn]
    assert all(row.way == way and row.fps > 0.0 and (DDS in row.bounds) == drawn for row in rows)
