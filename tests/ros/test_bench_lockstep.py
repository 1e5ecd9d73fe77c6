"""``gibson-sim bench lockstep`` with few ticks: every way makes its own, whatever they take."""

from __future__ import annotations

import math

from support.simulation import require

require("rclpy", "gibson_msgs")

import pytest  # noqa: E402

from gibson_sim_bench.cli.lockstep import measure, report_text  # noqa: E402
from gibson_sim_bench.lockstep import BLOCKS, LockstepPlan  # noqa: E402
from gibson_sim_bench.ros import Size  # noqa: E402

pytestmark = pytest.mark.ros


def test_all_ways_make_ticks_without_and_with_images(ros_domain: int) -> None:
    plan = LockstepPlan("arena", 24, ticks=BLOCKS, image_ticks=BLOCKS, sizes=(Size(64, 48),))
    report = measure(plan, domain_id=ros_domain)
    assert report.left_out == ()
    without, with_images = report.cases
    assert math.isnan(without.draw.median) and math.isnan(without.one_process.median)  # one node is no split
    assert 0.0 < without.physics.median < without.lockstep.median
    assert 0.0 < with_images.draw.median < with_images.without_ros.median
    for ticks in (with_images.one_process, with_images.lockstep, with_images.pipelined):
        assert ticks.median > 0.0
    assert "physics steps per tick: 24;" in report_text(report)
