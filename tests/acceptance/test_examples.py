"""The examples of the documentation that talk ROS, beside a running simulation, as a user starts them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from support.simulation import PATIENCE_S, Launched, require

require("rclpy", "gibson_msgs", "pybullet")


def _run(root: Path, name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(root / "docs" / "examples" / name), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S)


def test_examples_spawn_an_object_and_drive_a_path(ros_domain: int, root: Path) -> None:
    launched = Launched("run", "--no-render")
    try:
        launched.wait_for_line("reach: ")
        spawned = _run(root, "spawn_client.py", "bottle_water", "2.5", "4.5")
        assert (spawned.returncode, spawned.stdout) == (0, "spawned bottle_water\n"), spawned.stderr
        again = _run(root, "spawn_client.py", "botle", "2.5", "4.5")
        assert again.returncode == 1
        assert "refused: 'botle'" in again.stdout
        driven = _run(root, "path_follower.py")
        assert (driven.returncode, driven.stdout) == (0, "the path is driven\n"), driven.stderr
    finally:
        launched.stop()


def test_a_controller_in_lockstep_answers_every_scan(ros_domain: int, root: Path) -> None:
    launched = Launched(
        "run", "--no-render", "--lockstep", "--participants", "lockstep_controller", "--rate", "max", "--duration", "3"
    )
    controller = subprocess.Popen(
        [sys.executable, str(root / "docs" / "examples" / "lockstep_controller.py")], stdout=subprocess.PIPE, text=True
    )
    try:
        assert launched.wait() == 0, "\n".join(launched.lines)
    finally:
        controller.terminate()
        try:
            said, _ = controller.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            controller.kill()  # else the tests after this one are told of a process that was left
            controller.communicate()
            raise
        finally:
            launched.stop()
    assert said == "answered 30 scans\n"
