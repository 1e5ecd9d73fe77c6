"""The Foxglove server, seen by a client of the published protocol: it looks, drives, calls services and sets parameters of a simulation."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import signal
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from support.simulation import Launched, Listener, require, wait_until

require("rclpy", "gibson_msgs", "foxglove")

import aiohttp  # noqa: E402
import numpy as np  # noqa: E402
from geometry_msgs.msg import Twist  # noqa: E402
from nav_msgs.msg import OccupancyGrid, Odometry  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402
from sensor_msgs.msg import Image, JointState  # noqa: E402
from simulation_interfaces.msg import SimulationState  # noqa: E402
from simulation_interfaces.srv import GetSimulationState, SpawnEntity  # noqa: E402

from support.foxglove import FoxgloveClient  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.egl]
NS = 1_000_000_000


@pytest.fixture(scope="module")
def simulation(ros_domain: int) -> Iterator[Launched]:
    """A simulation, running."""
    launched = Launched("run", "--scene", "flat", "--foxglove-port", "0")
    wait_until(lambda: any("scene flat is ready" in line for line in launched.lines), "scene")
    yield launched
    launched.stop()


@pytest.fixture(scope="module")
def server(simulation: Launched) -> Iterator[Launched]:
    """The Foxglove server beside it."""
    with _serve() as launched:
        yield launched


@contextlib.contextmanager
def _serve(*options: str) -> Iterator[Launched]:
    launched = Launched("web", "--foxglove", "--port", "0", *options)
    try:
        launched.wait_for_line("foxglove: ws://")
        yield launched
    finally:
        launched.stop()


def _url(server: Launched) -> str:
    found = re.search(r"ws://\S+", server.wait_for_line("foxglove: ws://"))
    assert found is not None
    return found[0]


def _talk(server: Launched, talk: Callable[[FoxgloveClient], Awaitable[Any]], **options: Any) -> Any:
    async def run() -> Any:
        async with FoxgloveClient(_url(server), **options) as client:
            return await asyncio.wait_for(talk(client), 300)

    return asyncio.run(run())


def test_images_and_odometry_arrive_as_they_were_published_with_simulation_time(server: Launched) -> None:
    async def talk(client: FoxgloveClient) -> FoxgloveClient:
        await client.subscribe("/camera/image_raw", "/odom")
        seen = client.messages
        await client.until(lambda: len(seen.get("/camera/image_raw", ())) > 2 and len(seen.get("/odom", ())) > 5, "messages")
        count = len(client.times)
        await client.until(lambda: len(client.times) > count + 10, "time")
        return client

    client = _talk(server, talk)
    assert client.socket.protocol == "foxglove.sdk.v1"
    assert {"time", "clientPublish", "parameters", "services"} <= set(client.info["capabilities"])
    time_ns, data = client.messages["/camera/image_raw"][-1]
    image = deserialize_message(data, Image)
    pixels = np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, 3)
    assert (image.encoding, image.header.frame_id) == ("rgb8", "camera_optical_frame")
    assert pixels.std() > 10
    stamp_ns = image.header.stamp.sec * NS + image.header.stamp.nanosec
    assert 0 <= time_ns - stamp_ns < 60 * NS
    clock = [t for t in client.times if t < 3600 * NS]  # before a clock is discovered, time is this machine's
    assert len(clock) > 5 and clock == sorted(clock) and client.times[-1] == clock[-1]
    odometry = deserialize_message(client.messages["/odom"][-1][1], Odometry)
    assert odometry.child_frame_id == "base_footprint"


def test_each_channel_has_a_definition_that_decodes_its_bytes(server: Launched) -> None:
    """The client knows no ROS: rosbags builds the type from the schema that the server sent."""

    async def talk(client: FoxgloveClient) -> FoxgloveClient:
        await client.subscribe("/joint_states")
        await client.until(lambda: "/joint_states" in client.messages, "joint states")
        return client

    client = _talk(server, talk)
    channel = client.channels["/joint_states"]
    assert (channel["encoding"], channel["schemaEncoding"], channel["schemaName"]) == (
        "cdr",
        "ros2msg",
        "sensor_msgs/msg/JointState",
    )
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(channel["schema"], channel["schemaName"]))
    data = client.messages["/joint_states"][-1][1]
    assert list(store.deserialize_cdr(data, channel["schemaName"]).name) == deserialize_message(data, JointState).name
    for channel in client.channels.values():
        get_typestore(Stores.EMPTY).register(get_types_from_msg(channel["schema"], channel["schemaName"]))
    assert not [name for name in client.channels if "/_" in name]


def test_images_are_received_only_while_a_client_subscribes(server: Launched, listener: Listener) -> None:
    topic = "/camera/depth/image_raw"
    wait_until(lambda: listener.node.count_publishers(topic) > 0, "camera")

    async def talk(client: FoxgloveClient) -> None:
        assert listener.node.count_subscribers(topic) == 0
        await client.subscribe(topic)
        await client.until(lambda: topic in client.messages, "image")
        await client.until(lambda: listener.node.count_subscribers(topic) == 1, "one subscription")
        await client.unsubscribe(topic)
        await client.until(lambda: listener.node.count_subscribers(topic) == 0, "end of the subscription")
        await client.subscribe(topic)
        await client.until(lambda: listener.node.count_subscribers(topic) == 1, "subscription")

    _talk(server, talk)
    wait_until(lambda: listener.node.count_subscribers(topic) == 0, "end of the subscription of a client that has gone")


def test_every_client_gets_the_latched_map(server: Launched) -> None:
    async def talk(first: FoxgloveClient) -> None:
        await first.subscribe("/map")
        await first.until(lambda: "/map" in first.messages, "map")
        async with FoxgloveClient(_url(server)) as second:
            await second.subscribe("/map")
            await second.until(lambda: "/map" in second.messages, "map of a later client")
            grid = deserialize_message(second.messages["/map"][0][1], OccupancyGrid)
        assert len(grid.data) == grid.info.width * grid.info.height > 1000

    _talk(server, talk)


@pytest.mark.parametrize("encoding", ["cdr", "json"])
def test_a_client_drives_and_the_robot_stops_when_it_goes(server: Launched, listener: Listener, encoding: str) -> None:
    commands = listener.collect(Twist, "/cmd_vel")
    turn = Twist()
    turn.angular.z = 0.8
    data = serialize_message(turn) if encoding == "cdr" else json.dumps({"angular": {"z": 0.8}}).encode()

    async def talk(client: FoxgloveClient) -> tuple[float, float]:
        await client.subscribe("/ground_truth/odom")
        await client.until(lambda: "/ground_truth/odom" in client.messages, "pose")
        number = await client.advertise("/cmd_vel", "geometry_msgs/msg/Twist", encoding)
        before = _yaw(client)
        await client.until(lambda: abs(_yaw(client) - before) > 0.3, "turn", send=lambda: client.publish(number, data))
        return before, _yaw(client)

    before, after = _talk(server, talk)  # the client goes without a word
    assert after != before
    listener.spin_until(lambda: sum(c.angular.z == 0.0 for c in commands) >= 3, "three zero commands")
    assert commands[-1].angular.z == 0.0
    assert commands[0].angular.z == 0.8


def _yaw(client: FoxgloveClient) -> float:
    q = deserialize_message(client.messages["/ground_truth/odom"][-1][1], Odometry).pose.pose.orientation
    return float(2.0 * np.arctan2(q.z, q.w))


def test_malformed_message_reaches_no_node_and_ends_nothing(server: Launched, listener: Listener) -> None:
    commands = listener.collect(Twist, "/cmd_vel")

    async def talk(client: FoxgloveClient) -> None:
        wrong = await client.advertise("/cmd_vel", "geometry_msgs/msg/Twist")
        for data in (b"", b"\0\1\0\0", b"\xff" * 7, b"\0\1\0\0" + bytes(20)):
            await client.publish(wrong, data)
        unknown = await client.advertise("/thing", "no_such_msgs/msg/Thing")
        await client.publish(unknown, b"\0\1\0\0")
        name = await client.advertise("not a topic", "geometry_msgs/msg/Twist")
        await client.publish(name, serialize_message(Twist()))
        odd = await client.advertise("/cmd_vel_2", "geometry_msgs/msg/Twist", "json")
        for text in (b"{", b"[1]", b'{"linear": 3}', b'{"speed": 1}'):
            await client.publish(odd, text)
        wanted = (
            "bytes are not a geometry_msgs/msg/Twist",
            "type 'no_such_msgs/msg/Thing' is not installed",
            "is not JSON",
            "this field does not exist",
        )
        await client.until(lambda: all(any(w in text for text in client.warnings) for w in wanted), "warnings")

    _talk(server, talk)
    assert server.process.poll() is None
    assert not commands
    assert not any("Traceback" in line for line in server.lines)


def test_services_are_called_and_failures_are_reported(server: Launched) -> None:
    async def talk(client: FoxgloveClient) -> None:
        request = SpawnEntity.Request(name="fox", allow_renaming=True)
        uri = "bottle_water"
        setattr(*((request.entity_resource, "uri", uri) if hasattr(request, "entity_resource") else (request, "uri", uri)))
        request.initial_pose.pose.position.z = 1.0
        response = await client.call("/spawn_entity", serialize_message(request))
        assert response is not None
        assert deserialize_message(response, SpawnEntity.Response).result.result == 1
        state = await client.call("/get_simulation_state", serialize_message(GetSimulationState.Request()))
        assert state is not None
        assert deserialize_message(state, GetSimulationState.Response).state.state == SimulationState.STATE_PLAYING
        types = client.services["/spawn_entity"]
        assert (types["type"], types["request"]["schemaName"]) == (
            "simulation_interfaces/srv/SpawnEntity",
            "simulation_interfaces/srv/SpawnEntity_Request",
        )
        for part in ("request", "response"):
            assert "MSG: simulation_interfaces/" in types[part]["schema"] or "MSG: geometry_msgs/" in types[part]["schema"]
            get_typestore(Stores.EMPTY).register(get_types_from_msg(types[part]["schema"], "a/msg/B"))
        assert await client.call("/get_simulation_state", b"\0\1") is None or client.failures == []
        assert await client.call("/spawn_entity", b"\0\1\0\0\xff\xff\xff\xff") is None
        assert "are not a request of simulation_interfaces/srv/SpawnEntity" in client.failures[-1]
        assert not [name for name in client.services if name.endswith("/get_parameters")]

    _talk(server, talk)


def test_parameters_are_read_set_and_refused_with_a_reason(server: Launched) -> None:
    async def talk(client: FoxgloveClient) -> None:
        assert await client.get_parameters("/physics.rate") == {"/physics.rate": 1}
        everything = await client.get_parameters()
        assert everything["/physics.scene"] == "flat"
        assert {name.partition(".")[0] for name in everything} >= {"/physics", "/render", "/foxglove"}
        await client.socket.send_json({"op": "subscribeParameterUpdates", "parameterNames": ["/physics.rate"]})
        for given, now in ((0.5, 0.5), (1, 1), (-1.0, 1)):
            assert await client.set_parameters({"/physics.rate": given}) == {"/physics.rate": now}
        await client.until(lambda: {"/physics.rate": 0.5} in client.updates and {"/physics.rate": 1} in client.updates, "updates")
        assert await client.set_parameters({"/no_such_node.rate": 1, "rate": 1}) == {}
        await client.until(lambda: any("'/physics.rate' is not set" in text for text in client.warnings), "reason")

    _talk(server, talk)


def test_read_only_client_can_only_subscribe(simulation: Launched, listener: Listener) -> None:
    commands = listener.collect(Twist, "/cmd_vel")

    async def talk(client: FoxgloveClient) -> None:
        assert client.info["capabilities"] == ["time"]
        await client.subscribe("/odom")
        number = await client.advertise("/cmd_vel", "geometry_msgs/msg/Twist")
        turn = Twist()
        turn.angular.z = 1.0
        for _ in range(5):
            await client.publish(number, serialize_message(turn))
        await client.until(lambda: len(client.messages.get("/odom", ())) > 20, "odometry")
        assert client.services == {}

    with _serve("--no-commands") as launched:
        _talk(launched, talk)
    assert not commands


def test_topics_of_other_nodes_come_and_go(listener: Listener, ros_domain: int) -> None:
    publisher = listener.node.create_publisher(JointState, "/robot/joints", 10)

    async def talk(client: FoxgloveClient) -> None:
        await client.subscribe("/robot/joints")
        message = JointState(name=["wheel"], position=[0.5])

        async def send() -> None:
            publisher.publish(message)

        await client.until(lambda: "/robot/joints" in client.messages, "message", send=send)
        assert deserialize_message(client.messages["/robot/joints"][0][1], JointState) == message
        listener.node.destroy_publisher(publisher)
        await client.until(lambda: "/robot/joints" not in client.channels, "end of the channel")

    with _serve() as launched:
        _talk(launched, talk)


def test_wall_time_is_used_without_a_clock(ros_domain: int) -> None:
    launched = Launched(
        "web", "--foxglove", "--port", "0", env={"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}
    )  # it discovers no simulation
    launched.wait_for_line("foxglove: ws://")

    async def talk(client: FoxgloveClient) -> list[int]:
        await client.until(lambda: len(client.times) > 3, "time")
        return client.times

    begin = time.time_ns()
    times = _talk(launched, talk)
    launched.stop()
    assert begin <= times[0] < times[-1] <= time.time_ns()


def test_layout_names_topics_fields_and_services_that_exist(server: Launched, root: Path) -> None:
    panels: dict[str, Any] = json.loads((root / "config" / "foxglove_layout.json").read_text())["configById"]
    ours = {"/cmd_vel", "/goal_pose", "/initialpose", "/clicked_point"}  # published by panels
    of_nav2 = {"/plan", "/amcl_pose", "/global_costmap/costmap", "/local_costmap/costmap"}
    called = {name: panels.pop(name) for name in list(panels) if name.startswith("CallService!")}

    async def talk(client: FoxgloveClient) -> FoxgloveClient:
        await client.subscribe("/camera/image_raw", "/diagnostics", "/map")
        for config in called.values():
            await client.until(lambda config=config: config["serviceName"] in client.services, "service")  # type: ignore[misc]
            fields = client.services[config["serviceName"]]["request"]["schema"]
            assert all(f" {key}\n" in fields for key in json.loads(config["requestPayload"]))
        return client

    channels = _talk(server, talk).channels
    named = {word for word in _texts(panels) if word.startswith("/")}
    series = {word for word in named if "." in word}
    assert len(series) >= 5
    assert named - series - ours - of_nav2 <= set(channels)
    for path in series:
        topic, *fields = path.split(".")
        store = get_typestore(Stores.EMPTY)
        kind = channels[topic]["schemaName"]
        store.register(get_types_from_msg(channels[topic]["schema"], kind))
        for name in fields:
            desc: Any = dict(store.fielddefs[kind][1])[name]
            kind = str(desc[1]) if desc[0].name == "NAME" else ""
        assert kind == "", f"{path} is no number"


def _texts(value: Any) -> Iterator[str]:
    """Yields all keys and texts of a JSON value."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield key
            yield from _texts(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _texts(inner)


def test_cross_origin_pages_are_accepted_with_a_warning(server: Launched) -> None:
    """The SDK checks no origin: the line at the start must not promise more than it does."""

    async def talk(client: FoxgloveClient) -> int:
        return len(client.info["capabilities"])

    assert _talk(server, talk, headers={"Origin": "https://another.example"}) > 1
    assert "every web page in a browser on it, can read and command everything" in server.wait_for_line("foxglove: ws://")


def test_non_local_address_is_warned_of(ros_domain: int) -> None:
    with _serve("--host", "0.0.0.0") as launched:
        assert "every machine that reaches 0.0.0.0 port" in launched.wait_for_line("warning: ")


def test_occupied_port_is_refused_in_one_line(server: Launched) -> None:
    port = _url(server).rpartition(":")[2]
    other = Launched("web", "--foxglove", "--port", port)
    assert other.wait() == 1
    assert [line for line in other.lines if "error: " in line] == [
        f"gibson-sim: error: --port {port} is taken on 127.0.0.1; choose another port"
    ]


def test_run_starts_the_foxglove_server_and_survives_its_end(simulation: Launched) -> None:
    async def talk(client: FoxgloveClient) -> None:
        await client.subscribe("/odom")
        await client.until(lambda: "/odom" in client.messages, "odometry")

    _talk(simulation, talk)
    pid = int(simulation.node_pid("foxglove"))
    os.kill(pid, signal.SIGKILL)
    simulation.wait_for_line("the simulation goes on without it: `gibson-sim web --foxglove` restarts it")
    assert simulation.process.poll() is None


def test_unknown_protocol_is_refused(server: Launched) -> None:
    async def run() -> None:
        async with aiohttp.ClientSession() as session, session.ws_connect(_url(server), protocols=["other"]) as socket:
            await socket.receive()

    with pytest.raises(aiohttp.ClientError):
        asyncio.run(run())
