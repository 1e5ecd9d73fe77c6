"""Lockstep as its participants see it: a node that dies, hangs or is slow is named, and nothing is lost."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from support.scenes import write_room
from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from geometry_msgs.msg import Twist  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402

from gibson_msgs.msg import TickDone  # noqa: E402
from gibson_sim.processes.node_process import PARENT_VARIABLE  # noqa: E402
from gibson_sim.ros.topics import qos  # noqa: E402
from support.clients import DEEP, LaunchedNode, step_of, steps_of  # noqa: E402
from support.lockstep import NAME, Controller  # noqa: E402
from support.robots import GIBSON_BOT, write_gibson_bot  # noqa: E402

pytestmark = pytest.mark.ros
STEPS_A_TICK = 4
IMAGE = "camera/image_raw"
IMAGE_STEPS = 24
"""Steps between two images at 10 Hz."""


@pytest.fixture
def start(ros_domain: int, tmp_path: Path) -> Iterator[Callable[..., Launched]]:
    """Starts a lockstep run as fast as possible in a room of four walls; ends it, and prints its output."""
    robot = write_gibson_bot(tmp_path / "robot", camera={"width": 80, "height": 60, "rate_hz": 10.0})
    runs: list[Launched] = []

    def begin(*options: str) -> Launched:
        room = str(write_room(tmp_path / "room"))
        runs.append(Launched("run", "--scene", room, "--robot", str(robot), "--lockstep", "--rate", "max", *options))
        return runs[-1]

    yield begin
    for run in runs:
        run.stop()
        print("\n".join(run.lines))


def _error(launched: Launched) -> str:
    return next(line for line in launched.lines if line.startswith("error: "))


def _steps_in_bag(bag: Path, topic: str) -> list[int]:
    with AnyReader([bag]) as reader:
        found = [c for c in reader.connections if c.topic == topic]
        assert found, f"{bag} has no topic {topic}"
        messages = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(found)]
    return [step_of(m.header.stamp.sec * 10**9 + m.header.stamp.nanosec) for m in messages]


def test_time_waits_for_declared_participants(start: Callable[..., Launched], listener: Listener, tmp_path: Path) -> None:
    summary = tmp_path / "summary.json"
    launched = start("--no-render", "--participants", NAME, "--duration", "2", "--summary", str(summary))
    odometry = listener.collect(Odometry, "odom", DEEP)
    launched.wait_for_line(f"waiting for '{NAME}' to join")
    assert not odometry
    controller = Controller(listener)
    assert _ended(launched, listener) == 0
    assert steps_of(odometry) == list(range(STEPS_A_TICK, 480 + 1, STEPS_A_TICK)), "every tick, once"
    found = json.loads(summary.read_text())["physics"]
    assert found["lockstep"]["participants"][NAME]["ticks"] == controller.ticks == 120
    assert found["commands"] == 119, "one a tick; that of the last has no step to obey it"


def _ended(launched: Launched, listener: Listener) -> int | None:
    """Works as the controller until the run has ended; returns its exit code."""
    listener.spin_until(lambda: launched.process.poll() is not None, "the end of the run")
    return launched.wait()


def test_a_node_that_knows_nothing_of_lockstep_takes_part_by_its_commands(
    start: Callable[..., Launched], listener: Listener, tmp_path: Path
) -> None:
    summary = tmp_path / "summary.json"
    rules = ("--participants", "follow=cmd_vel after odom", "--participant-timeout", "60")
    publisher = listener.node.create_publisher(Twist, "cmd_vel", 1)
    listener.node.create_subscription(Odometry, "odom", lambda msg: publisher.publish(Twist()), 10)
    launched = start("--no-render", *rules, "--duration", "1", "--summary", str(summary))
    assert _ended(launched, listener) == 0
    found = json.loads(summary.read_text())["physics"]
    assert found["lockstep"]["participants"]["follow"] | {"mean_ms": 0, "longest_ms": 0} == {
        "ticks": 60, "mean_ms": 0, "longest_ms": 0, "missed": 0,
    }  # fmt: skip
    assert found["commands"] == 59


@pytest.mark.parametrize(("options", "later"), [((), 0), (("--pipelined",), 1)])
def test_a_command_takes_effect_in_the_next_tick_or_with_a_pipeline_in_the_one_after_it(
    start: Callable[..., Launched], listener: Listener, tmp_path: Path, options: tuple[str, ...], later: int
) -> None:
    bag = tmp_path / "bag"
    launched = start("--no-render", "--participants", NAME, "--duration", "1", "--record", str(bag), *options)
    Controller(listener)
    assert _ended(launched, listener) == 0
    assert _steps_in_bag(bag, "/odom") == list(range(STEPS_A_TICK, 240 + 1, STEPS_A_TICK))
    assert _steps_in_bag(bag, "/inputs") == list(range((1 + later) * STEPS_A_TICK, 240, STEPS_A_TICK))


def test_a_controller_that_hangs_is_named_and_the_bag_is_whole(
    start: Callable[..., Launched], listener: Listener, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    launched = start("--no-render", "--participants", NAME, "--participant-timeout", "1", "--record", str(bag))
    Controller(listener).hangs_after = 30
    assert _ended(launched, listener) == 1
    assert f"waiting for '{NAME}' to finish the tick at 0.517 s (the node hangs or is slow)" in _error(launched)
    assert _steps_in_bag(bag, "/odom") == list(range(STEPS_A_TICK, 31 * STEPS_A_TICK + 1, STEPS_A_TICK)), "nothing else is lost"


def test_a_run_may_go_on_without_the_answer_of_a_participant_that_hangs(
    start: Callable[..., Launched], listener: Listener, tmp_path: Path
) -> None:
    summary = tmp_path / "summary.json"
    options = ("--participant-timeout", "0.05", "--on-timeout", "go_on", "--duration", "1", "--summary", str(summary))
    launched = start("--no-render", "--participants", NAME, *options)
    Controller(listener).hangs_after = 50
    assert _ended(launched, listener) == 0
    found = json.loads(summary.read_text())["physics"]["lockstep"]
    assert found["participants"][NAME]["missed"] == found["timeouts"] >= 10
    assert any("this tick goes on without it; the run is not repeatable" in line for line in launched.lines)


def test_a_renderer_that_is_killed_comes_back_and_draws_the_tick_that_waits(
    start: Callable[..., Launched], listener: Listener
) -> None:
    launched = start("--participants", NAME, "--participant-timeout", "100")
    launched.wait_for_line("triangles")
    controller = Controller(listener, images=(IMAGE,))
    images = controller.images[IMAGE]
    listener.spin_until(lambda: len(images) > 3, "images")
    os.kill(launched.node_pid("render"), signal.SIGKILL)
    before = len(images)
    listener.spin_until(lambda: len(images) > before + 5, "images after the restart")
    steps = [step_of(stamp) for stamp in images]
    assert sorted(set(steps)) == list(range(steps[0], steps[-1] + 1, IMAGE_STEPS)), "not one is missing"


def test_a_renderer_that_stands_still_is_named_and_nothing_is_lost(start: Callable[..., Launched], listener: Listener) -> None:
    launched = start("--participants", NAME, "--participant-timeout", "100")
    launched.wait_for_line("triangles")
    controller = Controller(listener, images=(IMAGE,))
    images = controller.images[IMAGE]
    listener.spin_until(lambda: len(images) > 3, "images")
    pid = launched.node_pid("render")
    os.kill(pid, signal.SIGSTOP)
    try:
        listener.spin_until(lambda: bool(_said(launched, "waiting for 'render' to finish the tick")), "a word")
    finally:
        os.kill(pid, signal.SIGCONT)
    before = len(images)
    listener.spin_until(lambda: len(images) > before + 5, "images afterwards")
    steps = [step_of(stamp) for stamp in images]
    assert steps == list(range(steps[0], steps[-1] + 1, IMAGE_STEPS)), "each once"


def test_time_waits_for_a_recorder_that_stands_still_and_its_bag_is_whole(
    start: Callable[..., Launched], listener: Listener, tmp_path: Path
) -> None:
    bag, summary = tmp_path / "bag", tmp_path / "summary.json"
    launched = start("--participants", NAME, "--participant-timeout", "100", "--record", str(bag), "--summary", str(summary))
    launched.wait_for_line("triangles")
    images = Controller(listener, images=(IMAGE,)).images[IMAGE]
    listener.spin_until(lambda: len(images) > 3, "images")
    pid = launched.node_pid("record")
    os.kill(pid, signal.SIGSTOP)
    try:
        listener.spin_until(lambda: bool(_said(launched, "waiting for 'record' to finish the tick")), "a word")
        before = len(images)
    finally:
        os.kill(pid, signal.SIGCONT)
    listener.spin_until(lambda: len(images) > before + 5, "images afterwards")
    launched.stop()
    steps = _steps_in_bag(bag, f"/{IMAGE}")
    assert len(steps) > before + 5
    assert steps == list(range(steps[0], steps[-1] + 1, IMAGE_STEPS)), "each once"
    assert {topic: count for topic, count in json.loads(summary.read_text())["record"]["lost"].items() if count} == {}


def test_a_recorder_that_is_killed_does_not_hold_time(start: Callable[..., Launched], listener: Listener, tmp_path: Path) -> None:
    launched = start("--participants", NAME, "--participant-timeout", "100", "--record", str(tmp_path / "bag"))
    launched.wait_for_line("triangles")
    images = Controller(listener, images=(IMAGE,)).images[IMAGE]
    listener.spin_until(lambda: len(images) > 3, "images")
    os.kill(launched.node_pid("record"), signal.SIGKILL)
    listener.spin_until(lambda: bool(_said(launched, "'record' has gone without leaving; time goes on without it")), "a word")
    before = len(images)
    listener.spin_until(lambda: len(images) > before + 5, "images afterwards")


def test_a_recorder_that_comes_later_takes_part_until_it_ends(
    start: Callable[..., Launched], listener: Listener, tmp_path: Path
) -> None:
    launched = start("--participants", NAME, "--participant-timeout", "100")
    launched.wait_for_line("triangles")
    images = Controller(listener, images=(IMAGE,)).images[IMAGE]
    recorder = LaunchedNode("record", "-p", f"output:={tmp_path / 'bag'}", "-p", "duration:=5.0", env={PARENT_VARIABLE: ""})
    listener.spin_until(
        lambda: bool(_said(launched, "'record' joined; time waits for it at ticks with camera images")), "a recorder"
    )
    listener.spin_until(lambda: recorder.process.poll() is not None, "its end")
    assert recorder.wait() == 0
    assert _said(launched, "'record' left")
    before = len(images)
    listener.spin_until(lambda: len(images) > before + 5, "images afterwards")
    steps = _steps_in_bag(tmp_path / "bag", f"/{IMAGE}")
    assert steps == list(range(steps[0], steps[-1] + 1, IMAGE_STEPS)), "each once"
    assert len(steps) == 50, "ten a second, for five seconds"


def test_time_goes_on_after_a_drive_started_by_a_user_has_finished(start: Callable[..., Launched], listener: Listener) -> None:
    launched = start("--no-render", "--participant-timeout", "100")
    odometry = listener.collect(Odometry, "odom", DEEP)
    drive = LaunchedNode("drive", "-p", "drive:=forward", "-p", "length:=0.2", env={PARENT_VARIABLE: ""})
    listener.spin_until(lambda: drive.process.poll() is not None, "its end")
    assert drive.wait() == 0
    assert _said(launched, "'drive' joined; time waits for it at ticks with ground_truth/odom")
    listener.spin_until(lambda: bool(_said(launched, "'drive' left")), "a word")
    before = len(odometry)
    listener.spin_until(lambda: len(odometry) > before + 5, "odometry afterwards")


def test_several_render_nodes_draw_every_image_that_is_due(
    start: Callable[..., Launched], listener: Listener, tmp_path: Path
) -> None:
    camera = yaml.safe_load(GIBSON_BOT.read_text(encoding="utf-8"))["cameras"][0] | {"width": 80, "height": 60}
    cameras = [{**camera, "rate_hz": 10.0}, {**camera, "name": "left", "rate_hz": 6.0, "link": "base_link"}]
    robot = write_gibson_bot(tmp_path / "two_cameras", cameras=cameras)
    launched = start("--no-render", "--robot", str(robot), "--participants", f"{NAME}; render_a; render_b")
    renderers = [
        LaunchedNode("render", "-r", f"__node:=render_{letter}", "-p", f"cameras:={name}")
        for letter, name in (("a", "camera"), ("b", "left"))
    ]
    try:
        for renderer in renderers:
            renderer.wait_for_line("triangles")
        topics = (IMAGE, "left/image_raw")
        controller = Controller(listener, images=topics)
        listener.spin_until(lambda: all(len(controller.images[topic]) > 12 for topic in topics), "images")
    finally:
        launched.stop()
        for renderer in renderers:
            renderer.stop()
    for topic, steps in zip(topics, (24, 40), strict=True):
        found = [step_of(stamp) for stamp in controller.images[topic]]
        assert found == list(range(steps, found[-1] + 1, steps)), topic


def _said(launched: Launched, text: str) -> list[str]:
    return [line for line in launched.lines if text in line]


def test_a_report_of_a_node_that_has_not_joined_is_a_warning(start: Callable[..., Launched], listener: Listener) -> None:
    launched = start("--no-render", "--participants", NAME)
    controller = Controller(listener)
    listener.spin_until(lambda: controller.ticks > 5, "ticks")
    publisher: Any = listener.node.create_publisher(TickDone, "tick_done", qos.TICK_DONE)
    publisher.publish(TickDone(event=TickDone.DONE, participant="stranger"))
    listener.spin_until(lambda: bool(_said(launched, "'stranger' reports a tick as done, but has not joined")), "a word")
    publisher.publish(TickDone(event=TickDone.LEAVE, participant=NAME))
    listener.spin_until(lambda: bool(_said(launched, f"'{NAME}' left")), "a word")
    ticks = controller.ticks
    listener.spin_until(lambda: controller.ticks > ticks + 100, "time that goes on without it")


def test_invalid_participant_rules_are_refused_before_anything_starts() -> None:
    launched = Launched("run", "--lockstep", "--participants", "follow=cmd_vel because odom")
    assert launched.wait() == 1
    assert "must be `render`, `follow=cmd_vel after odom`" in "\n".join(launched.lines)
