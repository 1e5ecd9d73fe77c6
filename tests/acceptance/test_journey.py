"""The README's workflow for users with ROS, from colcon build to Ctrl-C, with the ROS installation of this machine."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs", "colcon_core")
pytestmark = pytest.mark.ros


def test_workspace_built_with_links_launches_draws_and_loads_every_scene(root: Path, ros_domain: int, tmp_path: Path) -> None:
    """Messages and launch itself are beyond it where ROS is from pip: see the script."""
    command = [sys.executable, str(root / "tests/acceptance/journey.py"), "--folder", str(tmp_path)]
    if not (Path(sys.prefix) / "gibson_setup").is_dir():
        prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)]
        command += ["--ros", *(str(prefix) for prefix in prefixes if (prefix / "share/rclpy").is_dir())]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    scenes = len(list((root / "scenes").glob("*/scene.yaml")))
    started = "ros2 launch" if "--ros" in command else "the launch file's nodes"
    assert [line.rpartition(" (")[0] for line in done.stdout.splitlines()] == [
        f"ok  colcon build --symlink-install: {scenes} scenes installed as links",
        f"ok  {started}: a picture of 640x480",
        f"ok  load_world: {scenes} scenes",
        "ok  Ctrl-C: all ended with 0, and nothing was left",
    ], done.stdout
