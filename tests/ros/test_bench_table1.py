"""The paper's table over ROS, with few frames: the figures have sane content, whatever they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

from gibson_sim.cli.environment import node_environment  # noqa: E402
from gibson_sim_bench.cli.table1 import _free, _lockstep, _message_ms  # noqa: E402
from gibson_sim_bench.protocol import Table1Plan, write_robot  # noqa: E402
from gibson_sim_bench.reports.paper import MODE_GROUPS, MODES  # noqa: E402
from gibson_sim_bench.rows import DDS, FREE, HOST, IN_PROCESS, OPENGL, Table1Row  # noqa: E402

pytestmark = pytest.mark.ros
MESSAGE_MS = {mode.name: {"convert": 0.1, "encode": 0.1, "publish": 0.1, "transport": 0.1} for mode in MODES}
IN_PROCESS_ROWS = {
    (mode.name, 24): Table1Row(IN_PROCESS, HOST, mode.name, "arena", 10, 256, 256, 24, 9.0, 9.0, 9.0, 3, {}, {OPENGL: 1.0})
    for mode in MODES
}


def test_messages_alone_are_timed_for_every_row(ros_domain: int) -> None:
    found = _message_ms(node_environment())
    assert set(found) == {mode.name for mode in MODES}
    assert all(ms > 0.0 for row in found.values() for ms in row.values())


def test_one_simulation_in_lockstep_makes_ticks_of_each_row_in_turn(ros_domain: int, tmp_path: Path) -> None:
    modes, left_out = [mode for mode in MODES if mode.outputs and not mode.fill], list[str]()
    robot = write_robot(tmp_path, (256, 256))
    with _lockstep(Table1Plan(scene="arena"), node_environment(), robot, left_out, 24, modes) as make:
        for which in (0, 1, 0, len(modes) - 1):
            seconds = make(which, 3)
            assert len(seconds) == 3 and min(seconds) > 0.0
    assert not left_out


def test_a_simulation_that_does_not_start_is_left_out_with_the_reason(ros_domain: int, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("gibson_sim_bench.cli.table1.START_S", -110.0)  # the timeout of a process is longer
    left_out: list[str] = []
    plan, sensor_only = Table1Plan(scene="no_such_scene"), [mode for mode in MODES if not mode.outputs]
    with _lockstep(plan, node_environment(), tmp_path, left_out, 24, sensor_only) as make:
        assert make(0, 3) == [] and make(0, 3) == []
    assert len(left_out) == 1 and "lockstep, sensor only with 24 substeps" in left_out[0]
    assert "no_such_scene" in left_out[0]


def test_a_free_simulation_gives_all_its_rows(ros_domain: int, tmp_path: Path) -> None:
    plan = Table1Plan(scene="arena", seconds=2.0)
    rows = list(
        _free(plan, node_environment(), write_robot(tmp_path, (256, 256)), 24, MODE_GROUPS[0], IN_PROCESS_ROWS, MESSAGE_MS)
    )
    assert [row.mode for row in rows] == [mode.name for mode in MODES if not mode.outputs]
    assert all(row.way == FREE and row.fps > 0.0 and DDS not in row.bounds for row in rows)
