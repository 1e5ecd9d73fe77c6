"""Processes that die: restarted ones show the current state, and bags are whole."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from support.scenes import write_room
from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from nav_msgs.msg import Odometry  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402
from simulation_interfaces.srv import DeleteEntity, GetEntityState, SpawnEntity  # noqa: E402

from gibson_sim.ros.client.simulation_client import SimulationClient  # noqa: E402
from gibson_sim.ros.conversions import array_from_image, time_from_msg  # noqa: E402
from support.clients import DEEP, client_of, stamp_ns, step_of, steps_of  # noqa: E402
from support.robots import write_gibson_bot  # noqa: E402

pytestmark = pytest.mark.ros
CUBE = """<robot name="cube"><link name="cube">
<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><box size="0.3 0.3 0.3"/></geometry><material name="m"><color rgba="{rgb} 1"/></material></visual>
<collision><geometry><box size="0.3 0.3 0.3"/></geometry></collision></link></robot>"""
GREEN, BLUE = "0 1 0", "0 0 1"
"""The wall behind is red."""
MAX_RESTARTS = 3


@pytest.fixture
def room(tmp_path: Path) -> list[str]:
    """Options of a run in a room of four walls, with a small camera."""
    robot = write_gibson_bot(tmp_path / "robot", camera={"width": 160, "height": 120, "rate_hz": 10.0})
    return ["run", "--scene", str(write_room(tmp_path / "room")), "--robot", str(robot)]


@pytest.fixture
def start(ros_domain: int, room: list[str]) -> Iterator[Callable[..., Launched]]:
    """Starts a run in the room; a run that a test leaves is ended, and its output is printed."""
    runs: list[Launched] = []

    def begin(*options: str) -> Launched:
        runs.append(Launched(*room, *options))
        return runs[-1]

    yield begin
    for run in runs:
        run.stop()
        print("\n".join(run.lines))


@pytest.fixture
def sim(start: Callable[..., Launched]) -> Launched:
    launched = start()
    launched.wait_for_line("triangles")
    return launched


def _spawn(control: SimulationClient, name: str, rgb: str, y: float) -> None:
    """Puts a cube on the floor, a metre ahead of the robot."""
    request = SpawnEntity.Request(name=name, resource_string=CUBE.format(rgb=rgb))
    place = request.initial_pose.pose.position
    place.x, place.y, place.z = 1.0, y, 0.15
    result = control.call("spawn_entity", request).result
    assert result.result == result.RESULT_OK, result.error_message


def _delete(control: SimulationClient, name: str) -> None:
    result = control.call("delete_entity", DeleteEntity.Request(entity=name)).result
    assert result.result == result.RESULT_OK, result.error_message


def _now_ns(control: SimulationClient, name: str) -> int:
    """Returns the simulation time at which an entity was looked at."""
    state = control.call("get_entity_state", GetEntityState.Request(entity=name)).state
    return int(time_from_msg(state.header.stamp))


def _pixels_of(rgb: str, image: Any) -> int:
    """Returns how many pixels are of a colour rather than of the others."""
    pixels: NDArray[np.int64] = array_from_image(image).astype(np.int64)
    strongest = rgb.split().index("1")
    others = np.delete(pixels, strongest, axis=2).max(axis=2)
    return int((pixels[:, :, strongest] > others + 40).sum())


def test_renderer_that_was_killed_shows_what_changed_while_it_was_gone(sim: Launched, listener: Listener) -> None:
    control, images = client_of(listener), listener.collect(Image, "camera/image_raw", DEEP)
    _spawn(control, "old", GREEN, -0.3)
    listener.spin_until(lambda: bool(images) and _pixels_of(GREEN, images[-1]) > 100, "a green cube in the image")
    lines = len(sim.lines)
    os.kill(sim.node_pid("render"), signal.SIGKILL)
    killed = time.monotonic()
    _spawn(control, "new", BLUE, 0.3)
    _delete(control, "old")
    present = _now_ns(control, "new")
    sim.wait_for_line("restarting it", after=lines)
    listener.spin_until(lambda: stamp_ns(images[-1]) > present, "an image of the present")
    print(f"images came back {time.monotonic() - killed:.1f} s after the renderer was killed")
    image = next(image for image in images if stamp_ns(image) > present)
    assert _pixels_of(BLUE, image) > 100, "what was spawned while it was gone"
    assert _pixels_of(GREEN, image) == 0, "what was deleted while it was gone"


def test_time_goes_on_while_the_renderer_is_gone(sim: Launched, listener: Listener) -> None:
    odometry, images = listener.collect(Odometry, "odom", DEEP), listener.collect(Image, "camera/image_raw", DEEP)
    listener.spin_until(lambda: bool(odometry and images), "odometry and images")
    os.kill(sim.node_pid("render"), signal.SIGKILL)
    last = stamp_ns(images[-1])
    listener.spin_until(lambda: stamp_ns(images[-1]) > last + 10**9, "images after the restart")
    steps = steps_of(odometry)
    assert steps == list(range(steps[0], steps[-1] + 1, 4)), "not one tick is missing"


def test_renderer_that_dies_again_and_again_ends_the_run(start: Callable[..., Launched]) -> None:
    launched = start()
    for attempt in range(MAX_RESTARTS + 1):
        lines = len(launched.lines) if attempt else 0
        launched.wait_for_line("triangles", after=lines)
        os.kill(launched.node_pid("render"), signal.SIGKILL)
        if attempt < MAX_RESTARTS:
            launched.wait_for_line("restarting it", after=lines)
    assert launched.wait() == 4, "\n".join(launched.lines)
    assert any(line.startswith("error: the render node was killed by SIGKILL") for line in launched.lines)


def test_bag_is_whole_when_physics_is_killed(start: Callable[..., Launched], listener: Listener, tmp_path: Path) -> None:
    bag, summary = tmp_path / "bag", tmp_path / "summary.json"
    launched = start("--no-render", "--record", str(bag), "--summary", str(summary))
    odometry = listener.collect(Odometry, "odom", DEEP)
    listener.spin_until(lambda: bool(odometry) and step_of(stamp_ns(odometry[-1])) > 480, "two seconds")
    last, pid = step_of(stamp_ns(odometry[-1])), launched.node_pid("physics")
    os.kill(pid, signal.SIGKILL)
    assert launched.wait() == 4, "\n".join(launched.lines)
    assert any(line.startswith("error: the physics node was killed by SIGKILL") for line in launched.lines)
    checked = Launched("bag", "check", str(bag))
    assert checked.wait() == 0, "\n".join(checked.lines)
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == "/odom"]
        recorded = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(connections)]
    steps = [step_of(m.header.stamp.sec * 10**9 + m.header.stamp.nanosec) for m in recorded]
    missing = sorted(set(range(4, steps[-1] + 1, 4)) - set(steps))
    lost = json.loads(summary.read_text())["record"]["lost"][
        "/odom"
    ]  # in real time a machine that stalls may lose some: they are counted
    assert len(missing) == lost and steps == sorted(set(steps)), f"{lost} reported as lost, missing: {missing}"
    # A publisher hands each reader its own copy, one after the other: SIGKILL may come between the listener's and the recorder's.
    assert steps[-1] >= last - 4, (
        "up to the end: what was sent to one reader need not have been sent to the next, but only the very last tick may be missing"
    )


def test_run_goes_on_when_the_recorder_is_killed_and_its_bag_can_be_mended(
    start: Callable[..., Launched], listener: Listener, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    launched = start("--record", str(bag))
    odometry = listener.collect(Odometry, "odom", DEEP)
    listener.spin_until(lambda: bool(odometry) and step_of(stamp_ns(odometry[-1])) > 720, "three seconds")
    os.kill(launched.node_pid("record"), signal.SIGKILL)
    last = stamp_ns(odometry[-1])
    launched.wait_for_line("the recording ended early")
    listener.spin_until(lambda: stamp_ns(odometry[-1]) > last + 10**9, "another second")
    assert launched.stop() == 5, "\n".join(launched.lines)
    mended = Launched("bag", "repair", str(bag))
    assert mended.wait() == 0, "\n".join(mended.lines)
    with AnyReader([bag]) as reader:
        written = sum(1 for c, _, _ in reader.messages() if c.topic == "/odom")
    # Three seconds of 60 messages were recorded; those since the last flush, a second before, are lost with the process.
    assert written > 10
