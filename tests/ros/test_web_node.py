"""The web node among messages that no page can show, and robots that come and go."""

from __future__ import annotations

import asyncio
import math
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from support.simulation import Launched, Listener, require, wait_until

require("rclpy", "gibson_msgs")

import aiohttp  # noqa: E402
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped, Twist, TwistStamped  # noqa: E402
from nav_msgs.msg import OccupancyGrid, Odometry  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import Image, LaserScan  # noqa: E402
from simulation_interfaces.srv import StepSimulation  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from gibson_sim.bags.reader import BagReader  # noqa: E402
from gibson_sim.types import NS_PER_S  # noqa: E402
from support.clients import stamp_ns  # noqa: E402

pytestmark = pytest.mark.ros
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def web(ros_domain: int) -> Iterator[Launched]:
    """The page beside a real robot: no simulation runs."""
    launched = Launched("web", "--port", "0")
    launched.wait_for_line("look: http://")
    yield launched
    launched.stop()


def _talk(web: Launched, talk: Callable[[aiohttp.ClientWebSocketResponse], Any]) -> Any:
    url = web.wait_for_line("look: http://").partition("look: ")[2] + "socket"

    async def run() -> Any:
        async with aiohttp.ClientSession() as session, session.ws_connect(url) as socket:
            return await asyncio.wait_for(talk(socket), 100)

    return asyncio.run(run())


async def _reply(socket: aiohttp.ClientWebSocketResponse) -> Any:
    while True:
        message = await socket.receive(timeout=60)
        if message.type is aiohttp.WSMsgType.TEXT and message.json()["type"] == "reply":
            return message.json()["value"]


async def _values(socket: aiohttp.ClientWebSocketResponse, kind: str) -> list[Any]:
    while True:
        message = await socket.receive(timeout=60)
        if message.type is aiohttp.WSMsgType.TEXT and message.json()["type"] == kind:
            found: list[Any] = message.json()["value"]
            return found


async def _robots(socket: aiohttp.ClientWebSocketResponse) -> list[Any]:
    return await _values(socket, "robots")


def _bad_messages() -> list[tuple[type, str, Any, Any]]:
    tf = TransformStamped()
    tf.child_frame_id, tf.transform.rotation.w = "base", 0.0
    odometry = Odometry(child_frame_id="base")
    odometry.pose.pose.orientation.w = math.nan
    grid = OccupancyGrid(data=[0])
    grid.info.width, grid.info.height, grid.info.resolution = 1, 1, math.nan
    estimate = PoseWithCovarianceStamped()
    estimate.pose.covariance[0] = 1e308
    scan = LaserScan(ranges=[math.nan, math.inf])
    empty = Image(encoding="rgb8", width=640, height=0, step=1920)
    return [
        (TFMessage, "/tf", TFMessage(transforms=[tf]), 10), (Odometry, "/odom", odometry, 10), (OccupancyGrid, "/map", grid, LATCHED),
        (PoseWithCovarianceStamped, "/amcl_pose", estimate, LATCHED), (LaserScan, "/scan", scan, 10), (Image, "/cam/image_raw", empty, 10),
        (Image, "/cam2/image_raw", Image(encoding="odd", width=2, height=2, step=4, data=[0] * 8), 10),
    ]  # fmt: skip


def test_no_message_ends_the_page_server(web: Launched, listener: Listener) -> None:
    node = listener.node
    publishers = [(node.create_publisher(kind, topic, profile), message) for kind, topic, message, profile in _bad_messages()]
    listener.spin_until(
        lambda: all(p.get_subscription_count() for p, m in publishers if not isinstance(m, Image)), "subscriptions"
    )

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> None:
        await socket.send_json({"type": "watch", "topics": ["/cam/image_raw", "/cam2/image_raw"]})
        for _ in range(30):
            for publisher, message in publishers:
                publisher.publish(message)
            await asyncio.sleep(0.1)
        await socket.send_str(r'{"type": "delete", "name": "\ud800"}')
        await socket.send_json({"type": "spawn", "uri": "/etc/passwd", "x": 0, "y": 0})
        await _robots(socket)

    _talk(web, talk)
    assert web.process.poll() is None
    wait_until(lambda: any("/tf cannot be shown" in line for line in web.lines), "warning of what cannot be shown")
    assert sum("/tf cannot be shown" in line for line in web.lines) == 1
    for publisher, _ in publishers:
        node.destroy_publisher(publisher)


@pytest.mark.parametrize("kind", [Twist, TwistStamped])
def test_a_real_robot_is_driven_and_stopped_when_the_page_server_ends(
    web: Launched, other_listener: Listener, kind: type
) -> None:
    listener, node = other_listener, other_listener.node  # one participant cannot know /cmd_vel under two types
    odometry = node.create_publisher(Odometry, "/odom", 10)
    idle = node.create_publisher(Twist, "/cmd_vel", 10) if kind is Twist else None  # another node that could drive
    commands = listener.collect(kind, "/cmd_vel", 10)
    message = Odometry(child_frame_id="base")
    message.pose.pose.orientation.w = 1.0

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> float:
        begin = time.monotonic()
        while not commands:
            assert time.monotonic() - begin < 60
            odometry.publish(message)
            await socket.send_json({"type": "drive", "linear": 0.3})
            listener._executor.spin_once(timeout_sec=0.05)
            await asyncio.sleep(0.05)
        web.process.terminate()
        begin = time.monotonic()
        while not _is_zero(commands[-1]):
            listener._executor.spin_once(timeout_sec=0.05)
            await asyncio.sleep(0)
            assert time.monotonic() - begin < 60
        return begin

    _talk(web, talk)
    listener.spin_until(lambda: sum(map(_is_zero, commands)) >= 3, "three zero commands")
    assert not all(map(_is_zero, commands))
    for publisher in filter(None, (odometry, idle)):
        node.destroy_publisher(publisher)


def _is_zero(command: Any) -> bool:
    return bool(getattr(command, "twist", command).linear.x == 0.0)


def test_a_deleted_robot_is_forgotten(web: Launched, listener: Listener) -> None:
    message = Odometry(child_frame_id="base")
    message.pose.pose.orientation.w = 1.0
    publisher = listener.node.create_publisher(Odometry, "/left/odom", 10)

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> list[Any]:
        while not [r for r in await _robots(socket) if r["name"] == "left"]:
            publisher.publish(message)
        listener.node.destroy_publisher(publisher)
        while robots := await _robots(socket):
            pass
        return robots

    assert _talk(web, talk) == []


def _floor(z: float, width: int) -> OccupancyGrid:
    grid = OccupancyGrid(data=[0] * width)
    grid.info.width, grid.info.height, grid.info.resolution, grid.info.origin.position.z = width, 1, 1.0, z
    return grid


def test_each_floor_of_a_house_has_its_map_and_its_robots(web: Launched, listener: Listener) -> None:
    node = listener.node
    grids = {"map": _floor(0.0, 2), "floor_0/map": _floor(0.0, 2), "floor_1/map": _floor(2.86, 3)}
    maps = {topic: node.create_publisher(OccupancyGrid, topic, LATCHED) for topic in grids}
    for topic, publisher in maps.items():
        publisher.publish(grids[topic])
    robots = {name: node.create_publisher(Odometry, f"/{name}/odom", 10) for name in ("low", "high")}
    goals = listener.collect(PoseStamped, "/high/goal_pose", 10)

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> None:
        while len(floors := await _values(socket, "floors")) < 2 or None in (floor["map"] for floor in floors):
            pass
        assert [(floor["z"], floor["map"]["width"]) for floor in floors] == [(0.0, 2), (2.86, 3)]
        while (found := {r["name"]: r["floor"] for r in await _robots(socket)}) != {"low": 0, "high": 1}:
            for name, publisher in robots.items():
                message = Odometry(child_frame_id="base")
                message.pose.pose.orientation.w, message.pose.pose.position.z = 1.0, {"low": 0.05, "high": 2.9}[name]
                publisher.publish(message)
            assert set(found.values()) <= {0, 1}
        texts = []
        for z in (0.0, 2.86):
            reply = {"text": "has no subscriber"}
            while "has no subscriber" in reply["text"]:  # it is not discovered yet
                await socket.send_json({"type": "goal", "x": 1.0, "y": 2.0, "z": z, "yaw": 0.0, "robot": "high"})
                reply = await _reply(socket)
            texts.append(reply["text"])
        assert texts[0].startswith("sent to high/goal_pose, on floor 0; the robot is on floor 1")
        assert texts[1] == "sent to high/goal_pose"
        listener.spin_until(lambda: goals and goals[-1].pose.position.z == 2.86, "goal on the upper floor")
        node.destroy_publisher(maps["floor_0/map"])
        node.destroy_publisher(maps["floor_1/map"])
        while len(await _values(socket, "floors")) > 1:  # a world with one floor has been loaded
            pass

    _talk(web, talk)
    for publisher in (maps["map"], *robots.values()):
        node.destroy_publisher(publisher)


def test_the_robot_that_the_page_chooses_is_driven(web: Launched, listener: Listener) -> None:
    node = listener.node
    message = Odometry(child_frame_id="base")
    message.pose.pose.orientation.w = 1.0
    publishers = [node.create_publisher(Odometry, f"/{name}/odom", 10) for name in ("left", "right")]
    commands = {name: listener.collect(Twist, f"/{name}/cmd_vel", 10) for name in ("left", "right")}

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> None:
        while len(await _robots(socket)) < 2:
            for publisher in publishers:
                publisher.publish(message)
        for robot, chosen in (("right", "right"), ("left", "")):  # without a choice it is the first one
            begin = time.monotonic()
            while not any(command.linear.x == 0.3 for command in commands[robot]):
                assert time.monotonic() - begin < 60
                await socket.send_json({"type": "drive", "linear": 0.3, "robot": chosen})
                listener._executor.spin_once(timeout_sec=0.02)
                await asyncio.sleep(0.05)
            assert robot == "left" or not commands["left"]

    _talk(web, talk)
    for publisher in publishers:
        node.destroy_publisher(publisher)


def test_a_service_that_never_answers_is_reported(web: Launched, other_listener: Listener) -> None:
    node = other_listener.node  # it is not spun, so that it never answers
    kept = node.create_service(StepSimulation, "step_simulation", lambda _, response: response)

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> list[str]:
        said: list[str] = []
        while not said or "has not answered for 5 s" not in said[-1]:
            if not said or "does a simulation run" in said[-1]:  # the service is not discovered yet
                await socket.send_json({"type": "time", "action": "step", "steps": 1})
            said.append((await _reply(socket))["text"])
        return said

    assert _talk(web, talk)[-1].startswith("step_simulation has not answered")
    node.destroy_service(kept)


def test_a_page_is_told_why_an_image_is_not_drawn(web: Launched, listener: Listener) -> None:
    publisher = listener.node.create_publisher(Image, "/odd/image_raw", 10)

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> Any:
        await socket.send_json({"type": "watch", "topics": ["/odd/image_raw"]})
        while True:
            publisher.publish(Image(encoding="odd", width=2, height=2, step=4, data=[0] * 8))
            message = await socket.receive(timeout=60)
            if message.type is aiohttp.WSMsgType.TEXT and message.json()["type"] == "problems" and message.json()["value"]:
                return message.json()["value"]

    assert _talk(web, talk) == {"/odd/image_raw": "images of 2x2 with encoding 'odd' are not drawn"}
    listener.node.destroy_publisher(publisher)


def test_a_recording_and_a_task_end_with_their_page_server(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    launched = Launched("run", "--no-render", "--web-port", "0")
    launched.wait_for_line("look: http://")

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> Any:
        await socket.send_json({"type": "task", "action": "start", "task": "point-goal", "baseline": "none", "seed": 3})
        await socket.send_json({"type": "record", "action": "start"})
        size, info = 0, {}
        while size < 300_000 or not info.get("text"):
            message = await socket.receive(timeout=60)
            values = message.json() if message.type is aiohttp.WSMsgType.TEXT else {"type": ""}
            size = values["value"]["bytes"] if values["type"] == "recording" else size
            info = values["value"]["info"] if values["type"] == "task" else info
            assert values["type"] not in ("recording", "task") or not values["value"]["error"]
        return info

    assert _talk(launched, talk)["seed"] == 3
    assert launched.stop() == 0
    [folder] = (tmp_path / "out" / "web").iterdir()
    with BagReader(folder) as bag:  # which an unfinished bag would refuse
        assert bag.topics()["/odom"].count > 10
    assert (folder / "metadata.yaml").is_file()


def test_a_recording_that_is_ended_at_once_is_whole(ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    launched = Launched("web", "--port", "0")
    launched.wait_for_line("look: http://")

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> Any:
        for action in ("start", "stop"):
            await socket.send_json({"type": "record", "action": action})
        ran = False
        while True:
            message = await socket.receive(timeout=60)
            if message.type is aiohttp.WSMsgType.TEXT and message.json()["type"] == "recording":
                values = message.json()["value"]
                ran = ran or values["on"]
                if ran and not values["on"]:
                    return values

    values = _talk(launched, talk)
    folder = tmp_path / values["folder"]
    if folder.exists():
        assert values["error"] == "" and (folder / "metadata.yaml").is_file()
    else:
        assert values["error"] == "nothing was recorded: it was stopped before it had begun"
    assert launched.stop() == 0


def test_the_scans_of_robots_in_namespaces_are_shown(ros_domain: int) -> None:
    launched = Launched("run", "--no-render", "--robot", "left=gibson_bot,right=gibson_bot", "--web-port", "0")
    launched.wait_for_line("look: http://")

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> None:
        while [len(scan["points"]) > 50 for scan in await _values(socket, "scan")] != [True, True]:
            pass

    _talk(launched, talk)
    assert launched.stop() == 0


def test_a_joint_of_an_arm_is_listed_and_moved_within_its_limits(ros_domain: int) -> None:
    launched = Launched("run", "--no-render", "--robot", "arm_bot", "--web-port", "0")
    launched.wait_for_line("look: http://")

    async def joints(socket: aiohttp.ClientWebSocketResponse) -> dict[str, Any]:
        while True:
            message = await socket.receive(timeout=60)
            if message.type is aiohttp.WSMsgType.TEXT and message.json()["type"] == "joints" and message.json()["value"]:
                return {joint["name"]: joint for joint in message.json()["value"][""]}

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> None:
        found = await joints(socket)
        assert not [name for name in found if "wheel" in name], "wheels have no limits"
        name = next(name for name, joint in found.items() if joint["unit"] == "rad" and joint["upper"] - joint["lower"] > 1.0)
        joint = found[name]
        target = joint["position"] + (0.3 if joint["position"] + 0.3 < joint["upper"] else -0.3)
        await socket.send_json({"type": "joint", "joint": name, "position": target})
        while abs((await joints(socket))[name]["position"] - target) > 0.02:
            pass
        await socket.send_json({"type": "joint", "joint": name, "position": joint["upper"] + 1.0})  # the limit is commanded
        while abs((await joints(socket))[name]["position"] - joint["upper"]) > 0.05:
            pass
        await socket.send_json({"type": "joint", "joint": "none", "position": 0.0})
        assert await _reply(socket) == {
            "to": "MoveJoint", "ok": False, "text": "'none' is not a joint with limits of this robot",
        }  # fmt: skip

    _talk(launched, talk)
    assert launched.stop() == 0


def test_a_page_that_is_killed_ends_no_simulation(listener: Listener) -> None:
    clock = listener.collect(Clock, "/clock")
    launched = Launched("run", "--no-render", "--web-port", "0")
    launched.wait_for_line("look: http://")
    os.kill(launched.node_pid("web"), signal.SIGKILL)
    launched.wait_for_line("the simulation goes on without its page")
    clock.clear()
    listener.spin_until(lambda: stamp_ns(clock[-1]) > stamp_ns(clock[0]) + NS_PER_S if clock else False, "time that goes on")
    assert launched.process.poll() is None
    assert launched.stop() == 0
