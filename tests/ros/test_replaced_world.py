"""Commands beside a simulation that does not run the default scene, and whose world is replaced by another one."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.scenes import write_room
from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from geometry_msgs.msg import Twist  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402

from support.clients import DEEP  # noqa: E402

pytestmark = pytest.mark.ros


def _run(*argv: str) -> tuple[int, str]:
    """Returns the exit code of a command, and what it printed."""
    done = subprocess.run([sys.executable, "-m", "gibson_sim.cli.main", *argv], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


@pytest.fixture
def sim(ros_domain: int, tmp_path: Path) -> Iterator[Launched]:
    """The scene ``flat``, and not the default one, which is in other places free."""
    launched = Launched("run", "--no-render", "--summary", str(tmp_path / "summary.json"))
    launched.wait_for_line("ready: ")
    yield launched
    launched.stop()
    print("\n".join(launched.lines))


def test_a_tour_is_planned_in_the_scene_that_is_simulated(sim: Launched) -> None:
    drive = Launched("drive", "tour", "--length", "1")
    assert drive.wait() == 0, "\n".join(drive.lines)
    assert any("the tour is planned in scene flat" in line for line in drive.lines)


def test_a_tour_says_that_nothing_names_the_scene(ros_domain: int, listener: Listener) -> None:
    publisher = listener.node.create_publisher(Odometry, "ground_truth/odom", 10)
    code, text = _run("drive", "tour")
    assert (code, text.splitlines()[-1]) == (
        1,
        "error: waited 5 s for the simulation to name its scene and its robot; name them with --scene and --robot",
    )
    assert publisher


def test_an_unknown_scene_is_refused_before_the_world_is_unloaded(sim: Launched) -> None:
    code, text = _run("load", "linden")
    assert code == 1
    assert text.startswith("error: scene 'linden' does not exist; did you mean 'linden_flat'? known: arena, ")
    assert text.count("\n") == 1
    assert "robot" in _run("service", "call", "get_entities")[1]


def test_a_playing_simulation_does_not_step_and_says_how_to_pause_it(sim: Launched) -> None:
    code, text = _run("step", "5")
    assert code == 1 and "`gibson-sim pause`" in text


def test_a_world_without_robot_is_the_reason_why_nothing_drives(sim: Launched, listener: Listener, tmp_path: Path) -> None:
    poses = listener.collect(Odometry, "ground_truth/odom", DEEP)
    commands = listener.node.create_publisher(Twist, "cmd_vel", 10)
    listener.spin_until(lambda: bool(poses) and commands.get_subscription_count() > 0, "a robot")
    commands.publish(Twist())
    seen = len(poses)
    listener.spin_until(lambda: len(poses) > seen + 30, "a while")
    code, text = _run("load", str(write_room(tmp_path / "room")))
    assert code == 0, text
    code, text = _run("drive", "forward", "--timeout", "4")
    assert code == 1
    assert "for a robot that publishes /ground_truth/odom: the simulation in ROS domain" in text.splitlines()[-1]
    assert text.splitlines()[-1].endswith("has none; `gibson-sim spawn gibson_bot --at X,Y` adds one")
    warning = sim.wait_for_line("publishes commands, but the world has no robot that receives them")
    assert "`gibson-sim spawn gibson_bot --at X,Y` adds one" in warning
    assert not [line for line in sim.lines if "which is not received" in line]
    assert _run("spawn", "gibson_bot", "--at", "0,0")[0] == _run("play")[0] == 0
    tour = Launched("drive", "tour", "--length", "0.5")
    assert tour.wait() == 0, "\n".join(tour.lines)
    assert any("the tour is planned in scene tiny_room" in line for line in tour.lines)
    (sent,) = [int(line.split()[-2]) for line in tour.lines if "done after" in line]
    assert _run("service", "call", "unload_world")[0] == 0
    assert sim.stop() == 0
    physics = json.loads((tmp_path / "summary.json").read_text())["physics"]
    assert physics["scene"] == "tiny_room"
    assert physics["commands"] == pytest.approx(1 + sent, abs=1)  # the last one may not be due before the world is unloaded
