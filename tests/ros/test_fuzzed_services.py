"""A running simulation answers requests of every kind, good and bad ones, and time goes on; ``make fuzz`` does it for hours."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.simulation import Listener, require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from fuzz import services  # noqa: E402

pytestmark = pytest.mark.ros
REQUESTS = 120


def test_requests_and_messages_of_every_kind_do_no_harm(listener: Listener, tmp_path: Path) -> None:
    sim = services.start(tmp_path)
    try:
        report = services.ServiceFuzzer(sim, listener, tmp_path, seed=1).run(REQUESTS)
        print("\n".join(report.lines()))
        assert not report.faults, "\n".join([*report.lines(), *sim.lines[-40:]])
        assert report.share >= 0.5
    finally:
        code = sim.stop()
    assert code == 0
