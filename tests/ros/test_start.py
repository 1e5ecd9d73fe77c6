"""The start of a run: nothing is compiled once time has begun, and a user is told once what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.robots import write_gibson_bot
from support.scenes import write_room
from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs")

from sensor_msgs.msg import Image  # noqa: E402

from gibson_sim.geometry.compiling import CAN_COMPILE  # noqa: E402
from support.clients import DEEP  # noqa: E402

pytestmark = pytest.mark.ros


def test_the_first_start_compiles_before_time_begins(
    ros_domain: int, listener: Listener, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "compiled"))
    robot = write_gibson_bot(tmp_path / "robot", camera={"width": 80, "height": 60, "rate_hz": 10.0})
    run = Launched("run", "--scene", str(write_room(tmp_path / "room")), "--robot", str(robot))
    try:
        run.wait_for_line("ready: tiny_room in ROS domain")
        compiled = {path.name for path in (tmp_path / "compiled").rglob("*.nbc")}
        assert bool(compiled) == CAN_COMPILE
        images = listener.collect(Image, "camera/image_raw", DEEP)
        depths = listener.collect(Image, "camera/depth/image_raw", DEEP)
        listener.spin_until(lambda: len(images) > 5 and len(depths) > 5, "images")
    finally:
        run.stop()
    assert {path.name for path in (tmp_path / "compiled").rglob("*.nbc")} == compiled
    told = [
        line.partition(":")[0] for line in run.lines if line.partition(":")[0] in ("ready", "cameras", "drive", "look", "stop")
    ]
    assert told == ["ready", "cameras", "drive", "look", "stop"], "\n".join(run.lines)
