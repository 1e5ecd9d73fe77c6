"""Replay of a recorded run: bit-equal, and different if an input differs."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import pytest

from support.robots import write_gibson_bot
from support.scenes import write_room
from support.simulation import Launched, Listener, new_context, require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from geometry_msgs.msg import Twist  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from simulation_interfaces.srv import LoadWorld, SetEntityState, SpawnEntity, UnloadWorld  # noqa: E402

from gibson_msgs.msg import Input, SceneState  # noqa: E402
from gibson_sim.bags.reader import BagReader  # noqa: E402
from gibson_sim.bags.writer import BagWriter  # noqa: E402
from gibson_sim.cli.main import main  # noqa: E402
from gibson_sim.cli.parser import ExitCode  # noqa: E402
from support.clients import DEEP, client_of  # noqa: E402

pytestmark = pytest.mark.ros
NS = 1_000_000_000
STEPS_OF_A_TICK = 4
CUBE = """<robot name="cube"><link name="cube">
<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><box size="0.3 0.3 0.3"/></geometry></visual>
<collision><geometry><box size="0.3 0.3 0.3"/></geometry></collision></link></robot>"""


class Driver:
    """A client that drives while time does not wait for it."""

    def __init__(self, listener: Listener) -> None:
        self.control = client_of(listener)
        self._listener = listener
        self._states = listener.collect(SceneState, "scene_state", DEEP)
        self._publisher = listener.node.create_publisher(Twist, "cmd_vel", 1)
        listener.spin_until(lambda: bool(self._states) and self._publisher.get_subscription_count() > 0, "a robot")

    def drive(self, linear: float, angular: float, ticks: int) -> None:
        """Sends a velocity (m/s, rad/s) for a number of ticks."""
        command, until = Twist(), len(self._states) + ticks
        command.linear.x, command.angular.z = linear, angular

        def done() -> bool:
            self._publisher.publish(command)
            return len(self._states) >= until

        self._listener.spin_until(done, "time")

    def spawn(self) -> None:
        """Lets a cube fall ahead of the robot."""
        request = SpawnEntity.Request(name="cube", resource_string=CUBE)
        request.initial_pose.pose.position.x, request.initial_pose.pose.position.z = 0.8, 0.4
        assert self.control.call("spawn_entity", request).result.result == 1

    def move(self) -> None:
        """Puts the cube into the way."""
        request = SetEntityState.Request(entity="cube")
        position = request.state.pose.position
        position.x, position.y, position.z = 0.5, 0.1, 0.3
        assert self.control.call("set_entity_state", request).result.result == 1

    def load(self, scene: str) -> None:
        """Unloads the world, loads another one and plays."""
        assert self.control.call("unload_world", UnloadWorld.Request()).result.result == 1
        assert self.control.call("load_world", LoadWorld.Request(uri=scene)).result.result == 1
        self.control.play()


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Options: a room, and a robot whose IMU alone has noise."""
    folder = tmp_path_factory.mktemp("world")
    imu = {"link": "base_link", "rate_hz": 100.0, "gyro_noise": 1e-3, "accel_noise": 1e-2}
    return ["--scene", str(write_room(folder / "room")), "--robot", str(write_gibson_bot(folder / "robot", imu=imu))]


@pytest.fixture(scope="module")
def recorded(ros_domain: int, world: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bag of a run at the pace of wall time, with commands, a spawn, a push, a reset and another world, at any times."""
    bag = tmp_path_factory.mktemp("recorded") / "bag"
    sim, context = Launched("run", *world, "--no-render", "--digests", "--record", str(bag)), new_context()
    listener = Listener(context)
    try:
        driver = Driver(listener)
        driver.drive(0.4, 0.3, 20)
        driver.spawn()
        driver.drive(0.5, 0.0, 30)
        driver.move()
        driver.drive(0.5, -0.2, 30)
        driver.control.reset()
        driver.drive(0.3, 0.5, 20)
        driver.load(world[1])
        driver.drive(0.3, 0.5, 20)
    finally:
        listener.close()
        context.try_shutdown()
        code = sim.stop()
        print("\n".join(sim.lines))
    assert code == 0
    return bag


def _replay(bag: Path, *options: str) -> tuple[int, str]:
    """Returns exit code and output of a replay."""
    launched = Launched("replay", str(bag), "--no-render", "--rate", "max", *options)
    code = launched.wait()
    print("\n".join(launched.lines))
    return code, "\n".join(launched.lines)


def test_a_free_run_is_repeated_to_the_bit(recorded: Path) -> None:
    code, said = _replay(recorded, "--verify")
    assert code == ExitCode.OK and "equal to the bit" in said
    assert "after its step" not in said and "came after" not in said, "no input may be late"
    compared = re.search(r"compared (\d+) ticks of physics, (\d+) topics", said)
    assert compared is not None and int(compared[1]) >= 110


def test_another_seed_differs_from_the_first_tick_and_only_where_there_is_noise(recorded: Path) -> None:
    code, said = _replay(recorded, "--verify", "--seed", "1")
    assert code == ExitCode.REPLAY_DIFFERS
    assert re.search(r"first difference: epoch 0, step 4, 0\.0167 s, on /imu$", said, re.MULTILINE), said
    assert re.findall(r"(/\S+): \d+ of \d+ ticks differ", said) == ["/imu"]


def test_one_changed_command_differs_at_the_tick_after_it(recorded: Path, tmp_path: Path) -> None:
    step = _copy_with_one_command_changed(recorded, tmp_path / "changed")
    code, said = _replay(tmp_path / "changed", "--verify")
    assert code == ExitCode.REPLAY_DIFFERS
    first = re.search(r"first difference: epoch 0, step (\d+), .* on (.*)", said)
    assert first is not None
    assert int(first[1]) == (step // STEPS_OF_A_TICK + 1) * STEPS_OF_A_TICK
    assert "/joint_states" in first[2]


def _copy_with_one_command_changed(bag: Path, copy: Path) -> int:
    """Copies what a replay reads, with one command turned round; returns its step."""
    topics = ("/run_info", "/inputs", "/tick_digest")
    with BagReader(bag) as reader:
        kinds = {topic: reader.topics()[topic].type_name for topic in topics}
        found = list(reader.raw_messages(topics))
    inputs = [(i, deserialize_message(data, Input)) for i, (topic, _, data) in enumerate(found) if topic == "/inputs"]
    # The last of its step: it is the one in effect.
    changed, message = next(
        (i, now)
        for (i, now), (_, following) in pairwise(inputs)
        if now.name == "/cmd_vel" and following.step > now.step > 40 and now.epoch == following.epoch
    )
    command = deserialize_message(bytes(message.data), Twist)
    command.linear.x = -command.linear.x
    message.data = serialize_message(command)
    found[changed] = ("/inputs", found[changed][1], serialize_message(message))
    with BagWriter(copy, reserve_bytes=0) as writer:
        for topic, kind in kinds.items():
            writer.add_topic(topic, kind)
        for topic, time_ns, data in found:
            writer.write(topic, data, time_ns, time_ns)
    return int(message.step)


def test_commands_alone_of_a_robot_that_was_elsewhere_drive_ours(ros_domain: int, world: list[str], tmp_path: Path) -> None:
    begin, command = 1_700_000_000 * NS, Twist()
    command.linear.x = 0.4
    with BagWriter(tmp_path / "real", reserve_bytes=0) as bag:
        bag.add_topic("/cmd_vel", "geometry_msgs/msg/Twist")
        for tenth in range(16):
            time_ns = begin + tenth * NS // 10
            bag.write("/cmd_vel", serialize_message(command), time_ns, time_ns)
    code, said = _replay(tmp_path / "real", *world, "--rate", "1", "--record", str(tmp_path / "sim"))
    assert code == ExitCode.OK
    assert "15 commands at their times, free" in said, "the run ends with the sixteenth"
    assert "continues without" not in said, "the subscriber of TwistStamped on the same topic is not waited for"
    with BagReader(tmp_path / "sim") as bag_of_ours:
        x = [message.pose.pose.position.x for _, _, message in bag_of_ours.messages(["/odom"])]
    assert x[-1] > 0.3, "1.5 s at 0.4 m/s, without the start"


def test_verify_without_digests_says_what_to_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/cmd_vel", "geometry_msgs/msg/Twist")
        bag.write("/cmd_vel", serialize_message(Twist()), NS, NS)
    with pytest.raises(SystemExit) as ended:
        main(["replay", str(tmp_path / "bag"), "--verify"])
    assert ended.value.code == ExitCode.ERROR
    assert "has no digests to compare with: record with `gibson-sim run --digests --record" in capsys.readouterr().err
