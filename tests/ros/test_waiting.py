"""Commands that need a simulation, while none runs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from support.simulation import PATIENCE_S, require

require("rclpy", "gibson_msgs")

pytestmark = pytest.mark.ros

COMMANDS = {
    "drive": (("drive", "forward"), "/ground_truth/odom"),
    "snapshot": (("snapshot", "shots"), "/scene"),
    "record": (("record", "bag"), "/clock"),
    "task": (("task", "push-through"), "/scene_state"),
}


def test_waiting_commands_report_what_they_wait_for_and_time_out(ros_domain: int, tmp_path: Path) -> None:
    started = {
        name: subprocess.Popen(
            [sys.executable, "-m", "gibson_sim.cli.main", *words, "--timeout", "4"],
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        for name, (words, _) in COMMANDS.items()
    }
    for name, process in started.items():
        error = process.communicate(timeout=PATIENCE_S)[1]
        simulation = (
            f"for a simulation that publishes {COMMANDS[name][1]} in ROS domain {ros_domain}; start one with `gibson-sim run`"
        )
        assert process.returncode == 1, f"{name}: {error}"
        assert f"INFO waiting, at most 4 s, {simulation}" in error
        assert f"error: waited 4 s {simulation}" in error
        assert (", or play a bag with `gibson-sim bag play --clock`\n" in error) == (name == "record")
        assert "Traceback" not in error
