"""``cmd_vel`` with one type or two: which commands drive the robot, what ROS's tools see, and where the commands are recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from support.scenes import write_room
from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs")

from geometry_msgs.msg import Twist, TwistStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402

from gibson_sim.bags.reader import BagReader  # noqa: E402
from support.clients import DEEP, client_of, stamp_ns, step_of  # noqa: E402

pytestmark = pytest.mark.ros
TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
RECEIVED = {"both": {TWIST, STAMPED}, "twist": {TWIST}, "stamped": {STAMPED}}


@pytest.fixture
def start(ros_domain: int, tmp_path: Path) -> Iterator[Callable[..., Launched]]:
    """Starts a simulation without images that records, and is ended after the test."""
    runs: list[Launched] = []

    def begin(*options: str) -> Launched:
        room = str(write_room(tmp_path / "room"))
        runs.append(Launched("run", "--no-render", "--scene", room, "--record", str(tmp_path / "bag"), *options))
        return runs[-1]

    yield begin
    for run in runs:
        run.stop()
        print("\n".join(run.lines))


def _command(kind: Any, linear: float) -> Any:
    """Returns a Twist or a TwistStamped."""
    message = kind()
    getattr(message, "twist", message).linear.x = linear
    return message


def _speeds(messages: list[Any]) -> list[float]:
    return [getattr(message, "twist", message).linear.x for message in messages]


@pytest.mark.parametrize("mode", RECEIVED)
def test_each_type_drives_where_it_is_received_and_every_command_is_recorded_under_one_type(
    mode: str, start: Callable[..., Launched], listener: Listener, other_listener: Listener, tmp_path: Path
) -> None:
    run = start("--cmd-vel-type", mode)
    applied = listener.collect(TwistStamped, "cmd_vel_applied", DEEP)
    truth = listener.collect(Odometry, "ground_truth/odom", DEEP)
    listener.spin_until(lambda: bool(truth), "a running simulation")
    types = dict(listener.node.get_topic_names_and_types())
    assert set(types["/cmd_vel"]) == RECEIVED[mode]
    # What `ros2 topic echo` and the filter of `ros2 bag record -a` ask of a topic: exactly one type.
    assert types["/cmd_vel_applied"] == [STAMPED]

    publishers = {
        TWIST: (Twist, listener.node.create_publisher(Twist, "cmd_vel", 10)),
        STAMPED: (TwistStamped, other_listener.node.create_publisher(TwistStamped, "cmd_vel", 10)),
    }
    sent: list[float] = []
    for number, (type_name, (kind, publisher)) in enumerate(publishers.items(), 1):
        if type_name not in RECEIVED[mode]:
            line = run.wait_for_line(f"/cmd_vel: /test_listener publishes {type_name}, which is not received")
            (value,) = RECEIVED[mode]
            assert f"this topic receives {value}; start the simulation with cmd_vel_type both or" in line
            continue
        listener.spin_until(lambda p=publisher: p.get_subscription_count() > 0, "a robot that takes commands")
        for i in range(5):  # one after the other: the queue of a robot holds one
            sent.append(number + i / 10)
            publisher.publish(_command(kind, sent[-1]))
            listener.spin_until(lambda: len(applied) == len(sent), f"command {sent[-1]} of {type_name}")
    if mode == "both":
        assert not [line for line in run.lines if "not received" in line]
    assert _speeds(applied) == sent
    assert {message.header.frame_id for message in applied} == {"base_footprint"}
    assert run.stop() == 0
    with BagReader(tmp_path / "bag") as bag:
        recorded = list(bag.messages(["/cmd_vel_applied"]))
    assert _speeds([message for _, _, message in recorded]) == sent
    steps = [step_of(stamp_ns(message)) for _, _, message in recorded]
    assert steps == sorted(steps)
    assert all(stamp_ns(message) <= clock_ns for _, clock_ns, message in recorded), "never ahead of the clock"


def test_command_holds_from_the_stamp_with_which_it_is_repeated(start: Callable[..., Launched], listener: Listener) -> None:
    start("--start-paused", "--step-hz", "240")
    control = client_of(listener)
    control.pause()
    applied = listener.collect(TwistStamped, "cmd_vel_applied", DEEP)
    clocks = listener.collect(Clock, "/clock", DEEP)
    publisher = listener.node.create_publisher(Twist, "cmd_vel", 1)
    listener.spin_until(lambda: publisher.get_subscription_count() > 1, "a robot and a recorder")
    control.step(7)
    publisher.publish(_command(Twist, 0.25))
    listener.spin_until(lambda: bool(clocks) and step_of(stamp_ns(clocks[-1])) >= 7, "the seventh step")

    def obeyed() -> bool:
        control.step(1)  # the command may arrive some steps later
        return bool(applied)

    listener.spin_until(obeyed, "the command")
    assert _speeds(applied) == [0.25]
    step = step_of(stamp_ns(applied[0]))
    listener.spin_until(lambda: step_of(stamp_ns(clocks[-1])) > step, "the clock of the step that obeyed")
    assert step >= 7
