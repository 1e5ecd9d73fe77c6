"""``gibson-sim bag play``: a bag on its topics, with subscribers before and after the start."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from support.simulation import Launched, Listener, require

require("rclpy")

from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from gibson_sim.bags.writer import BagWriter, TopicQos  # noqa: E402
from support.clients import DEEP, LATCHED, stamp_ns  # noqa: E402

pytestmark = pytest.mark.ros
NS = 10**9
BEGIN_NS, PERIOD_NS, COUNT = 7 * NS, NS // 20, 41
"""The texts of the bag: 41 over 2 s."""


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A bag with a text every 50 ms on two topics, a latched one at its start, and a clock."""
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as writer:
        writer.add_topic("/text", "std_msgs/msg/String")
        writer.add_topic("/weak", "std_msgs/msg/String", TopicQos(reliability="best_effort"))
        writer.add_topic("/room", "std_msgs/msg/String", TopicQos.latched())
        writer.add_topic("/clock", "rosgraph_msgs/msg/Clock")
        writer.write("/room", serialize_message(String(data="four walls")), BEGIN_NS, BEGIN_NS)
        for number in range(COUNT):
            now = BEGIN_NS + number * PERIOD_NS
            for topic in ("/text", "/weak"):
                writer.write(topic, serialize_message(String(data=str(number))), now, now)
            writer.write("/clock", serialize_message(Clock()), now, now)
    return tmp_path / "bag"


@pytest.fixture
def play(bag: Path) -> Iterator[Callable[..., Launched]]:
    """Returns a function that starts a playback."""
    started: list[Launched] = []

    def start(*options: str, folder: Path = bag) -> Launched:
        started.append(Launched("bag", "play", str(folder), *options))
        return started[-1]

    yield start
    for launched in started:
        if launched.process.poll() is None:
            launched.process.kill()
        launched.process.wait()
        print("\n".join(launched.lines))


def _texts(messages: list[Any]) -> list[str]:
    return [message.data for message in messages]


def _publishes(listener: Listener, topic: str) -> bool:
    return bool(listener.node.count_publishers(topic))


def _until_ended(listener: Listener, playing: Launched) -> None:
    listener.spin_until(lambda: playing.process.poll() is not None, "end of the playback")
    assert playing.wait() == 0, "\n".join(playing.lines)


def test_all_messages_arrive_in_order_at_the_recorded_distances(listener: Listener, play: Callable[..., Launched]) -> None:
    sent: list[tuple[float, str]] = []
    """When each text was published, s, and the text."""

    def on_text(msg: String, info: Any) -> None:
        sent.append((info["source_timestamp"] / NS, msg.data))

    listener.node.create_subscription(String, "/text", on_text, DEEP)
    took = {}
    for rate in (1.0, 4.0):
        sent.clear()
        playing = play("--rate", f"{rate:g}", "--wait-for", "/text")
        _until_ended(listener, playing)
        listener.spin_until(lambda: len(sent) >= COUNT, "texts")
        assert [text for _, text in sent] == [str(number) for number in range(COUNT)]
        assert any(line.startswith(f"played {2 * COUNT + 1} messages in ") for line in playing.lines), playing.lines
        took[rate] = sent[-1][0] - sent[0][0]
    assert took[1.0] > 1.5 and took[4.0] > 0.375, "a slow machine takes longer, never less"
    assert took[4.0] < took[1.0]


def test_publishers_have_the_recorded_qos_and_a_latched_message_reaches_a_late_subscriber(
    listener: Listener, play: Callable[..., Launched]
) -> None:
    early = listener.collect(String, "/words", DEEP)
    playing = play("--loop", "--remap", "/text:=/words")
    listener.spin_until(lambda: bool(early), "a text")
    late = listener.collect(String, "/room", LATCHED)
    listener.spin_until(lambda: bool(late), "the latched message")
    assert _texts(late[:1]) == ["four walls"]
    (weak,) = listener.node.get_publishers_info_by_topic("/weak")
    assert weak.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert not listener.node.count_publishers("/text") and not listener.node.count_publishers("/clock")
    assert any("the bag's own /clock is not played" in line for line in playing.lines)
    assert playing.stop() == 0, "a loop ends with Ctrl-C"
    assert playing.lines[-1].startswith("stopped at "), playing.lines


def test_playback_waits_for_the_required_subscribers_and_names_them(listener: Listener, play: Callable[..., Launched]) -> None:
    texts = listener.collect(String, "/text", DEEP)
    playing = play("--topics", "/text", "/room", "--rate", "4", "--wait-for", "/text", "room:2")
    playing.wait_for_line("INFO waiting for 2 subscribers of /room")
    others = [listener.collect(String, "/room", LATCHED) for _ in range(2)]
    assert not texts
    _until_ended(listener, playing)
    listener.spin_until(lambda: len(texts) == COUNT and all(others), "all messages, from the first")


def test_subscriber_that_is_required_on_a_topic_that_is_not_played_is_refused(play: Callable[..., Launched]) -> None:
    playing = play("--wait-for", "/nosuch", "--exclude-topics", "/weak")
    assert playing.wait() == 1
    assert playing.lines[-1] == "error: --wait-for has /nosuch, which is not played; played are /room, /text"


def test_clock_has_the_time_of_the_bag(listener: Listener, play: Callable[..., Launched]) -> None:
    clocks = listener.collect(Clock, "/clock", DEEP)
    playing = play("--clock", "--rate", "2", "--topics", "/text", "--start-offset", "1", "--wait-for", "/clock")
    _until_ended(listener, playing)
    listener.spin_until(lambda: bool(clocks) and stamp_ns(clocks[-1]) == BEGIN_NS + 2 * NS, "the end")
    times = [stamp_ns(clock) for clock in clocks]
    assert times == [BEGIN_NS + NS + tick * PERIOD_NS for tick in range(21)], "40 Hz of wall time at twice the speed, once each"


def test_interrupted_playback_is_reported_in_one_line(listener: Listener, play: Callable[..., Launched]) -> None:
    texts = listener.collect(String, "/text", DEEP)
    playing = play("--rate", "0.001", "--wait-for", "/text")
    listener.spin_until(lambda: bool(texts), "the first text")
    before = len(playing.lines)
    assert playing.stop() == -signal.SIGINT
    (line,) = playing.lines[before:]
    assert re.fullmatch(r"stopped at 0\.0 s of 2\.0 s: played [23] messages", line), (
        "the text, the latched message, and perhaps the other text"
    )


def test_topic_whose_type_is_not_installed_is_named_and_skipped(
    listener: Listener, play: Callable[..., Launched], tmp_path: Path
) -> None:
    with BagWriter(tmp_path / "foreign", reserve_bytes=0, message_definitions={"strange_msgs/msg/Thing": "string data\n"}) as bag:
        for topic, name in (("/thing", "strange_msgs/msg/Thing"), ("/text", "std_msgs/msg/String")):
            bag.add_topic(topic, name)
            bag.write(topic, serialize_message(String(data="x")), BEGIN_NS, BEGIN_NS)
    texts = listener.collect(String, "/text", QoSProfile(depth=10))
    playing = play("--wait-for", "/text", folder=tmp_path / "foreign")
    _until_ended(listener, playing)
    listener.spin_until(lambda: bool(texts), "the text")
    (warning,) = [line for line in playing.lines if line.startswith("WARN")]
    assert warning == "WARN /thing is not played: its type strange_msgs/msg/Thing is not installed here"
    alone = play("--topics", "/thing", folder=tmp_path / "foreign")
    assert alone.wait() == 1
    assert alone.lines[-1].startswith("error: no message type of bag ")


def test_other_publishers_are_reported_and_a_second_clock_is_refused(listener: Listener, play: Callable[..., Launched]) -> None:
    publishers = [listener.node.create_publisher(kind, topic, 10) for kind, topic in ((String, "/text"), (Clock, "/clock"))]
    listener.collect(String, "/text", DEEP)
    playing = play("--wait-for", "/text")
    _until_ended(listener, playing)
    (warning,) = [line for line in playing.lines if line.startswith("WARN")]
    assert warning.startswith("WARN other nodes publish /text, too: subscribers receive both")
    clocked = play("--clock", "--wait-for", "/text")
    listener.spin_until(lambda: clocked.process.poll() is not None or _publishes(listener, "/room"), "the refusal")
    assert not _publishes(listener, "/room")  # a simulation would withdraw its map for that of the bag
    assert clocked.wait() == 1
    assert clocked.lines[-1].startswith("error: another node publishes /clock in this ROS domain")
    assert publishers


def test_publishers_that_start_later_are_reported_once_and_a_later_clock_ends_the_playback(
    listener: Listener, play: Callable[..., Launched]
) -> None:
    texts = listener.collect(String, "/text", DEEP)
    playing = play("--loop", "--clock", "--wait-for", "/text")
    listener.spin_until(lambda: bool(texts), "a text")
    others = [listener.node.create_publisher(String, "/text", 10)]
    playing.wait_for_line("WARN other nodes publish /text, too")
    others.append(listener.node.create_publisher(Clock, "/clock", 10))
    assert playing.wait() == 1
    assert playing.lines[-1].startswith("error: another node publishes /clock in this ROS domain")
    assert len([line for line in playing.lines if line.startswith("WARN")]) == 1
    assert all(others)
