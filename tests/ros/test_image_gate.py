"""At full speed without lockstep, time waits for images that have subscribers, and for nothing else."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from support.robots import write_gibson_bot
from support.scenes import write_room
from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import CompressedImage, Image  # noqa: E402

from support.clients import DEEP, client_of, stamp_ns, steps_of  # noqa: E402

pytestmark = pytest.mark.ros
IMAGE_STEPS = 24
"""Steps between two images at 10 Hz."""
ENOUGH = 40
"""Number of images of 80x60 pixels of which a free-running simulation skips some."""


@pytest.fixture
def start(ros_domain: int, tmp_path: Path) -> Iterator[Callable[..., Launched]]:
    """Starts a run without lockstep in a room of four walls; ends it, and prints its output."""
    robot = write_gibson_bot(tmp_path / "robot", camera={"width": 80, "height": 60, "rate_hz": 10.0})
    runs: list[Launched] = []

    def begin(*options: str) -> Launched:
        runs.append(Launched("run", "--scene", str(write_room(tmp_path / "room")), "--robot", str(robot), *options))
        return runs[-1]

    yield begin
    for run in runs:
        run.stop()
        print("\n".join(run.lines))


def _whole(images: list[Any]) -> bool:
    """Returns whether none of the newest images is missing; earlier ones, before time waited, may be."""
    return {b - a for a, b in pairwise(steps_of(images[-ENOUGH:]))} == {IMAGE_STEPS}


def _receives_all(listener: Listener, images: list[Any]) -> None:
    before = len(images)
    listener.spin_until(lambda: len(images) > before + ENOUGH + 20, "images")
    assert _whole(images), steps_of(images)


@pytest.mark.parametrize(("kind", "topic"), [(Image, "camera/depth/image_raw"), (CompressedImage, "camera/image_raw/compressed")])
def test_no_image_with_a_subscriber_is_skipped(start: Callable[..., Launched], listener: Listener, kind: Any, topic: str) -> None:
    start("--rate", "max")
    _receives_all(listener, listener.collect(kind, topic, DEEP))


def test_image_gate_can_be_disabled(start: Callable[..., Launched], listener: Listener) -> None:
    start("--rate", "max", "--image-timeout", "0")
    images = listener.collect(Image, "camera/image_raw", DEEP)
    listener.spin_until(lambda: len(images) > 5 and not _whole(images), "an image that was skipped")


def test_time_waits_from_when_full_speed_is_requested(start: Callable[..., Launched], listener: Listener) -> None:
    launched = start("--rate", "1")
    images = listener.collect(Image, "camera/image_raw", DEEP)
    listener.spin_until(lambda: len(images) > 3, "images")
    control = client_of(listener)
    assert control.set_parameter("physics", "rate", 0.0) == (True, "")
    _receives_all(listener, images)
    os.kill(launched.node_pid("render"), signal.SIGSTOP)
    try:
        assert control.set_parameter("physics", "rate", 1.0) == (True, "")
        clock = listener.collect(Clock, "/clock")
        listener.spin_until(lambda: len(clock) > 100, "time that no longer waits")
    finally:
        os.kill(launched.node_pid("render"), signal.SIGCONT)
    assert not any("image_timeout" in line for line in launched.lines)


def test_time_passes_without_a_renderer_that_stands_still_and_waits_for_it_again(
    start: Callable[..., Launched], listener: Listener
) -> None:
    launched = start("--rate", "max", "--image-timeout", "1")
    images, clock = listener.collect(Image, "camera/image_raw", DEEP), listener.collect(Clock, "/clock")
    _receives_all(listener, images)
    pid = launched.node_pid("render")
    os.kill(pid, signal.SIGSTOP)
    try:
        launched.wait_for_line("did not arrive from 'render' within 'image_timeout', 1 s; time goes on without them")
        begin = len(clock)
        listener.spin_until(lambda: len(clock) > begin + 200, "time that goes on")
    finally:
        os.kill(pid, signal.SIGCONT)
    _receives_all(listener, images)


def test_time_does_not_wait_for_images_without_subscribers(start: Callable[..., Launched], listener: Listener) -> None:
    launched = start("--rate", "max")
    launched.wait_for_line("triangles")
    clock = listener.collect(Clock, "/clock")
    listener.spin_until(lambda: len(clock) > 10, "time")
    pid = launched.node_pid("render")
    os.kill(pid, signal.SIGSTOP)
    try:
        begin = stamp_ns(clock[-1])
        listener.spin_until(lambda: stamp_ns(clock[-1]) > begin + 5 * 10**9, "time that goes on")
    finally:
        os.kill(pid, signal.SIGCONT)
    assert not any("image_timeout" in line for line in launched.lines)


def test_a_renderer_that_is_killed_comes_back_and_none_of_its_images_is_missing(
    start: Callable[..., Launched], listener: Listener
) -> None:
    launched = start("--rate", "max", "--image-timeout", "100")
    images = listener.collect(Image, "camera/image_raw", DEEP)
    _receives_all(listener, images)
    known = len(images)
    os.kill(launched.node_pid("render"), signal.SIGKILL)
    listener.spin_until(lambda: len(images) > known + ENOUGH, "images after the restart")
    steps = sorted(set(steps_of(images[known - ENOUGH :])))
    assert steps == list(range(steps[0], steps[-1] + 1, IMAGE_STEPS)), "not one is missing"
