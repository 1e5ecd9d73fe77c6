"""The record node, with a publisher of our own in place of a simulation; and a bag's commands played into a running one."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.robots import write_gibson_bot
from support.scenes import write_room
from support.simulation import PATIENCE_S, Launched, Listener, require, wait_until

require("rclpy", "gibson_msgs", "rosbag2_interfaces")

from geometry_msgs.msg import Twist  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.duration import Duration  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from rosbag2_interfaces.srv import IsPaused, Pause, Resume, Snapshot, SplitBagfile  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from gibson_msgs.msg import TickDone  # noqa: E402
from gibson_sim.bags.images.decode import raw_image  # noqa: E402
from gibson_sim.bags.reader import BagReader, image_to_array  # noqa: E402
from gibson_sim.bags.stamps import stamp_ns  # noqa: E402
from gibson_sim.bags.writer import BagWriter  # noqa: E402
from gibson_sim.processes.domain_lock import DomainLock  # noqa: E402
from gibson_sim.processes.node_process import PARENT_VARIABLE  # noqa: E402
from gibson_sim.ros.conversions import image_to_msg, time_to_msg  # noqa: E402
from gibson_sim.ros.topics import qos  # noqa: E402
from support.clients import DEEP, LATCHED, LaunchedNode, client_of  # noqa: E402

pytestmark = pytest.mark.ros
NS = 10**9


class Source:
    """Publishes topics for a recorder, and calls its services."""

    def __init__(self, listener: Listener, folder: Path) -> None:
        self.listener, self.folder = listener, folder
        self.control = client_of(listener)
        self._clock = listener.node.create_publisher(Clock, "/clock", DEEP)
        self._text = listener.node.create_publisher(String, "/text", DEEP)
        self._short = listener.node.create_publisher(String, "/short", 10)
        self._room = listener.node.create_publisher(String, "/room", LATCHED)
        self._room.publish(String(data="four walls"))
        self.recorder: LaunchedNode | None = None

    def record(self, **settings: Any) -> LaunchedNode:
        """Starts a recorder that is ready."""
        settings = {"output": self.folder / "bag", "reserve_mb": 1, "summary_path": self.folder / "summary.json", **settings}
        parameters = [part for name, value in settings.items() for part in ("-p", f"{name}:={value}")]
        # Without a launcher, which would print the numbers instead.
        self.recorder = LaunchedNode("record", *parameters, env={PARENT_VARIABLE: ""})
        publishers = (self._clock, self._text, self._short, self._room)
        self.listener.spin_until(lambda: all(p.get_subscription_count() for p in publishers), "a recorder that subscribes")
        self._wait_for_an_answer()
        return self.recorder

    def _wait_for_an_answer(self) -> None:
        """Calls a service until the recorder answers: then both are matched. A response to a client that is not matched yet is dropped."""
        client = self.listener.node.create_client(IsPaused, "record/is_paused")
        self.listener.spin_until(client.service_is_ready, "service is_paused")
        asked: list[tuple[float, Any]] = []

        def answered() -> bool:
            if not asked or time.monotonic() - asked[-1][0] > 2.0:
                asked.append((time.monotonic(), client.call_async(IsPaused.Request())))
            return any(future.done() for _, future in asked)

        self.listener.spin_until(answered, "answer of is_paused")

    def wait_until_delivered(self) -> None:
        """Returns once all that was published is in the recorder's queues."""
        for publisher in (self._clock, self._text, self._short):
            assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE_S))

    def say(self, *texts: str, at_ns: int) -> None:
        self._clock.publish(Clock(clock=time_to_msg(at_ns)))
        for text in texts:
            self._text.publish(String(data=text))

    def flood(self, first: int, count: int) -> None:
        for number in range(first, first + count):
            self._short.publish(String(data=str(number)))

    def stop(self) -> dict[str, Any]:
        """Stops the recorder and returns its summary."""
        assert self.recorder is not None
        assert self.recorder.stop() == 0, "\n".join(self.recorder.lines)
        summary: dict[str, Any] = json.loads((self.folder / "summary.json").read_text())
        return summary


@pytest.fixture
def source(ros_domain: int, listener: Listener, tmp_path: Path) -> Iterator[Source]:
    lock = DomainLock(ros_domain)  # no simulation of another test run may come into this domain
    source = Source(listener, tmp_path)
    yield source
    lock.close()
    if source.recorder is not None:
        source.recorder.kill()
        print("\n".join(source.recorder.lines))


def _texts(folder: Path, topic: str = "/text") -> list[tuple[int, str]]:
    """Returns time and text of a topic's messages."""
    with AnyReader([folder]) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        return [(t, reader.deserialize(data, c.msgtype).data) for c, t, data in reader.messages(connections)]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_everything_sent_before_the_end_is_in_the_bag_in_its_order(source: Source, storage: str) -> None:
    recorder = source.record(storage=storage)
    expected = []
    for step in range(300):
        texts = [f"{step} a", f"{step} b"]
        source.say(*texts, at_ns=step)
        expected += [(step, text) for text in texts]
    source.wait_until_delivered()
    summary = source.stop()
    assert _texts(source.folder / "bag") == expected, "each message at the clock that was sent before it"
    assert _texts(source.folder / "bag", "/room") == [(0, "four walls")]
    assert (summary["messages"]["/text"], summary["lost"]["/text"], summary["message_lost"]) == (600, 0, {})
    assert any("/text" in line and "600 messages" in line and "nothing lost" in line for line in recorder.lines)


def test_images_are_compressed_and_keep_their_stamps_and_counts(source: Source) -> None:
    """Colours, depth and labels of three publishers; normals have no compressed form."""
    node = source.listener.node
    pixels = {
        "/c/image_raw": ("rgb8", np.full((48, 64, 3), (200, 10, 10), np.uint8)),
        "/c/depth/image_raw": ("32FC1", np.full((48, 64), 1.5, np.float32)),
        "/c/semantic/image_raw": ("16UC1", np.full((48, 64), 7, np.uint16)),
        "/c/normal/image_raw": ("32FC3", np.ones((48, 64, 3), np.float32)),
    }
    publishers = {topic: node.create_publisher(Image, topic, DEEP) for topic in pixels}
    source.record(record_images="compressed")
    source.listener.spin_until(lambda: all(p.get_subscription_count() for p in publishers.values()), "subscriptions to images")
    for step in range(1, 11):
        source.say(f"{step}", at_ns=step * NS)
        for topic, (encoding, values) in pixels.items():
            publishers[topic].publish(image_to_msg(values, encoding, step * NS, "optical"))
    for publisher in publishers.values():
        assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE_S))
    source.wait_until_delivered()
    summary = source.stop()
    expected = {
        "/c/image_raw/compressed": ("bgr8", (10, 10, 200)),
        "/c/depth/image_raw/compressedDepth": ("32FC1", 1.5),
        "/c/semantic/image_raw/compressed": ("16UC1", 7),
        "/c/normal/image_raw": ("32FC3", (1.0, 1.0, 1.0)),
    }
    with BagReader(source.folder / "bag") as bag:
        assert {topic for topic in bag.topics() if topic.startswith("/c/")} == set(expected)
        for topic, (encoding, value) in expected.items():
            found = [(log_ns, message.header.stamp.sec, raw_image(message)) for _, log_ns, message in bag.messages([topic])]
            assert [(log_ns, second) for log_ns, second, _ in found] == [(step * NS, step) for step in range(1, 11)], topic
            assert all(image.encoding == encoding for _, _, image in found)
            np.testing.assert_allclose(image_to_array(found[-1][2])[20, 20], value, atol=3)
    assert {topic: summary["lost"][topic] for topic in expected} == dict.fromkeys(expected, 0)
    assert summary["bytes"]["/c/image_raw/compressed"] < 0.2 * 10 * 48 * 64 * 3


def test_without_images_only_named_topics_are_subscribed(source: Source) -> None:
    node = source.listener.node
    named, other = (node.create_publisher(Image, topic, DEEP) for topic in ("/named/image_raw", "/other/image_raw"))
    source.record(record_images="none", topics="/clock,/text,/short,/room,/named/image_raw")
    source.listener.spin_until(lambda: bool(named.get_subscription_count()), "a subscription to the named images")
    assert other.get_subscription_count() == 0
    source.say("x", at_ns=NS)
    named.publish(image_to_msg(np.zeros((4, 4, 3), np.uint8), "rgb8", NS, "optical"))
    assert named.wait_for_all_acked(Duration(seconds=PATIENCE_S))
    assert source.stop()["messages"]["/named/image_raw"] == 1


def test_without_images_none_of_all_topics_is_an_image(source: Source) -> None:
    images = source.listener.node.create_publisher(Image, "/camera/image_raw", DEEP)
    source.record(record_images="none")
    source.say("x", at_ns=NS)
    assert images.get_subscription_count() == 0
    assert "/camera/image_raw" not in source.stop()["messages"]


def test_lost_messages_are_counted_and_reported(source: Source) -> None:
    recorder = source.record()
    source.say(at_ns=1)
    source.flood(0, 5)
    os.kill(recorder.process.pid, signal.SIGSTOP)
    source.flood(5, 4000)  # far more than the publisher's queue for a subscriber that hangs
    os.kill(recorder.process.pid, signal.SIGCONT)
    source.flood(4005, 5)
    source.wait_until_delivered()
    summary = source.stop()
    numbers = [int(text) for _, text in _texts(source.folder / "bag", "/short")]
    assert summary["lost"]["/short"] == numbers[-1] - numbers[0] + 1 - len(numbers) > 0
    assert any("WARNING: messages were lost on the way: /short" in line for line in recorder.lines)


def test_topics_that_no_node_publishes_are_named_with_the_nearest_one(source: Source) -> None:
    recorder = source.record(topics="text,short,room,txt,/nothing_like_it")
    source.say("a", at_ns=1)
    source.wait_until_delivered()
    assert set(source.stop()["absent"]) == {"/txt", "/nothing_like_it"}
    warnings = [line for line in recorder.lines if line.startswith("WARNING: nothing is recorded of")]
    assert warnings[0] == "WARNING: nothing is recorded of /nothing_like_it, which no node publishes"
    assert warnings[1] == "WARNING: nothing is recorded of /txt, which no node publishes; did you mean '/text'?"


def test_services_pause_resume_and_split(source: Source) -> None:
    source.record()
    call = source.control.call
    source.say("first", at_ns=1)
    call("record/split_bagfile", SplitBagfile.Request())
    assert not call("record/is_paused", IsPaused.Request()).paused
    call("record/pause", Pause.Request())
    assert call("record/is_paused", IsPaused.Request()).paused
    source.say("not recorded", at_ns=2)
    call("record/resume", Resume.Request())
    assert not call("record/is_paused", IsPaused.Request()).paused
    source.say("last", at_ns=3)
    source.stop()
    assert _texts(source.folder / "bag") == [(1, "first"), (3, "last")]
    assert len(list((source.folder / "bag").glob("*.mcap"))) == 2


def test_snapshot_writes_the_last_seconds_again_and_again(source: Source) -> None:
    source.record(snapshot_seconds=2.0)
    for second in range(5):
        source.say(str(second), at_ns=second * NS)
    assert source.control.call("record/snapshot", Snapshot.Request()).success
    source.say("5", at_ns=5 * NS)
    assert source.control.call("record/snapshot", Snapshot.Request()).success
    source.stop()
    assert _texts(source.folder / "bag_snapshot1") == [(second * NS, str(second)) for second in (2, 3, 4)]
    assert _texts(source.folder / "bag_snapshot2") == [(second * NS, str(second)) for second in (3, 4, 5)]
    ((at_ns, text),) = _texts(source.folder / "bag_snapshot2", "/room")
    assert text == "four walls"
    assert 3 * NS <= at_ns <= 5 * NS, "at the begin, or when the latched message came, which takes a while"


def test_recording_goes_on_in_another_bag_after_a_reset(source: Source) -> None:
    recorder = source.record()
    source.say("before", at_ns=5 * NS)
    source.say("after", at_ns=0)
    summary = source.stop()
    assert _texts(source.folder / "bag") == [(5 * NS, "before")]
    assert _texts(source.folder / "bag_epoch1") == [(0, "after")]
    assert _texts(source.folder / "bag_epoch1", "/room") == [(0, "four walls")]
    assert len(summary["bags"]) == 2
    assert sum("time went back from 5.000 s to 0.000 s" in line for line in recorder.lines) == 1


def test_recording_of_running_lockstep_begins_once_all_publishers_are_matched(source: Source) -> None:
    listener, node, publishers = source.listener, source.listener.node, list[Any]()
    said = listener.collect(TickDone, "tick_done", qos.TICK_DONE)
    news = node.create_timer(0.2, lambda: publishers.append(node.create_publisher(String, f"/new_{len(publishers)}", 10)))
    recorder = source.record()
    stamps = count(1)

    def happens(condition: Callable[[], bool]) -> Callable[[], bool]:
        def look() -> bool:
            source.say("before", at_ns=next(stamps))
            return condition()

        return look

    there = len(publishers)
    listener.spin_until(happens(lambda: len(publishers) > there + 5), "news")
    news.cancel()
    made_ns = next(stamps)
    listener.spin_until(happens(lambda: any(m.event == TickDone.WATCH for m in said)), "a recorder that takes part")
    assert all(publisher.get_subscription_count() for publisher in publishers)
    time.sleep(0.5)  # messages on their way arrive
    source.say("first", at_ns=NS)
    publishers[-1].publish(String(data="first"))
    source.wait_until_delivered()
    summary = source.stop()
    bag = source.folder / "bag"
    texts = _texts(bag)
    assert texts[-1] == (NS, "first")
    assert _texts(bag, publishers[-1].topic_name) == [(NS, "first")]
    assert texts[0][0] > made_ns, "nothing of the time before all publishers were matched"
    assert _texts(bag, "/room") == [(texts[0][0], "four walls")]
    assert (summary["lost"]["/text"], summary["message_lost"]) == (0, {})
    assert any("time is running already: the bag begins" in line for line in recorder.lines)


def test_recording_of_running_lockstep_begins_once_each_image_topic_has_an_image(source: Source) -> None:
    """A renderer that is short of CPU time discovers the recorder's subscription late: its images before that do not arrive."""
    listener, node = source.listener, source.listener.node
    said = listener.collect(TickDone, "tick_done", qos.TICK_DONE)
    images = node.create_publisher(Image, "/c/image_raw", DEEP)
    recorder = source.record()
    stamps, sent = count(1), list[int]()
    listener.spin_until(lambda: bool(images.get_subscription_count()), "a recorder that subscribes to the images")
    silent_until = time.monotonic() + 3.0  # three times as long as discovery takes to settle

    def takes_part() -> bool:
        now_ns = next(stamps)
        source.say("before", at_ns=now_ns)
        if time.monotonic() > silent_until:
            sent.append(now_ns)
            images.publish(image_to_msg(np.zeros((4, 4, 3), np.uint8), "rgb8", now_ns, "c"))
        return any(m.event == TickDone.WATCH for m in said)

    listener.spin_until(takes_part, "a recorder that takes part")
    assert sent, "it takes part only after the first image"
    time.sleep(0.5)  # messages on their way arrive
    source.say("first", at_ns=NS)
    source.wait_until_delivered()
    source.stop()
    assert _texts(source.folder / "bag")[0][0] > sent[0], "the bag begins after it"
    assert not any("no image on" in line for line in recorder.lines)


def test_recorder_that_cannot_start_says_why(ros_domain: int, tmp_path: Path) -> None:
    (tmp_path / "bag").write_text("mine")
    recorder = LaunchedNode("record", "-p", f"output:={tmp_path / 'bag'}")
    assert recorder.wait() == 1
    assert any(line.startswith("error: bag folder") and "choose a folder" in line for line in recorder.lines)


@pytest.fixture
def start() -> Iterator[Callable[..., Launched]]:
    """Starts a command that is ended after the test."""
    runs: list[Launched] = []

    def begin(*options: str) -> Launched:
        runs.append(Launched(*options))
        return runs[-1]

    yield begin
    for run in runs:
        run.stop()
        print("\n".join(run.lines))


def test_commands_of_a_bag_drive_a_running_robot(start: Callable[..., Launched], listener: Listener, tmp_path: Path) -> None:
    """As `ros2 bag play --topics /cmd_vel` does: a bag's bytes, published at the pace of its times."""
    command = Twist()
    command.linear.x = 0.3
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/cmd_vel", "geometry_msgs/msg/Twist")
        for i in range(21):
            bag.write("/cmd_vel", serialize_message(command), i * NS // 10, i * NS // 10)
    files = ("--record", str(tmp_path / "run"), "--summary", str(tmp_path / "summary.json"))
    run = start("run", "--no-render", "--scene", str(write_room(tmp_path / "room")), *files)
    odometry = listener.collect(Odometry, "odom", DEEP)
    publisher = listener.node.create_publisher(Twist, "/cmd_vel", 10)
    listener.spin_until(lambda: bool(odometry and publisher.get_subscription_count()), "a robot")
    before = odometry[-1].pose.pose.position.x
    with BagReader(tmp_path / "bag") as reader:
        begin = time.monotonic()
        for _, due_ns, data in reader.raw_messages(["/cmd_vel"]):
            wait_until(lambda due=begin + due_ns / NS: time.monotonic() >= due, "time to play the next message")
            publisher.publish(bytes(data))
    listener.spin_until(lambda: odometry[-1].pose.pose.position.x > before + 0.3, "a robot that followed the bag")
    run.stop()
    assert last_clock_s(tmp_path / "run") == simulated_s(tmp_path / "summary.json"), "Ctrl-C ends the bag at the last step"


def test_bag_of_a_drive_has_every_command_and_lasts_to_the_last_step(start: Callable[..., Launched], tmp_path: Path) -> None:
    (tmp_path / "drive.txt").write_text("0.2 0.3 2.4\n0 0 0.1\n")
    files = ("--record", str(tmp_path / "run"), "--summary", str(tmp_path / "summary.json"))
    options = ("--scene", str(write_room(tmp_path / "room")), "--drive", str(tmp_path / "drive.txt"))
    run = start("run", "--no-render", *options, *files)
    assert run.wait() == 0, "\n".join(run.lines)
    sent = int(run.wait_for_line("done after").split()[-2])
    with BagReader(tmp_path / "run") as bag:
        topics = bag.topics()
    obeyed = json.loads((tmp_path / "summary.json").read_text())["physics"]["commands"]
    assert (sent, obeyed, topics["/cmd_vel"].count, topics["/cmd_vel_applied"].count) == (sent,) * 4
    assert sent > 10, "one for each of 150 odometry messages, but for those that a stalled machine lets it miss"
    assert last_clock_s(tmp_path / "run") == simulated_s(tmp_path / "summary.json")


@pytest.mark.parametrize(
    ("ending", "options"),
    [
        ("duration", ("--duration", "1.5", "--drive", "{turn}")),
        ("drive", ("--drive", "{short}")),
        ("Ctrl-C", ("--drive", "{turn}")),
        ("Ctrl-C", ("--drive", "{turn}", "--lockstep")),
    ],
)
def test_bag_has_every_message_of_the_last_tick_however_slow_its_images_are(
    start: Callable[..., Launched], tmp_path: Path, ending: str, options: tuple[str, ...]
) -> None:
    """The robot turns, and its camera has motion blur: without a GPU an image takes longer than the recorder waits for what is on its way."""
    camera = {"width": 1600, "height": 1000, "outputs": ["rgb"], "effects": {"shutter_s": 0.03, "readout_s": 0.03}}
    robot = write_gibson_bot(tmp_path / "robot", camera=camera)
    drives = {"turn": tmp_path / "turn.txt", "short": tmp_path / "short.txt"}
    drives["turn"].write_text("0 1.2 60\n")
    drives["short"].write_text("0 1.2 1\n")
    given = [option.format(**drives) for option in options]
    files = ("--record", str(tmp_path / "run"), "--summary", str(tmp_path / "summary.json"))
    run = start("run", "--robot", str(robot), *given, *files)
    if ending == "Ctrl-C":
        bag = tmp_path / "run" / "run_0.mcap"
        wait_until(
            lambda: (bag.exists() and bag.stat().st_size > 4_000_000) or run.process.poll() is not None, "images in the bag"
        )
        run.process.send_signal(signal.SIGINT)
    assert run.wait() == 0, "\n".join(run.lines)
    last: dict[str, int] = {}
    images = ("/camera/image_raw", "/camera/camera_info")
    with BagReader(tmp_path / "run") as reader:
        due = 0
        for topic, _, data in reader.raw_messages(["/scene_state", "/odom", "/clock", *images]):
            last[topic] = max(last.get(topic, 0), stamp_ns(data))
            if topic == "/scene_state" and len(reader.decode("gibson_msgs/msg/SceneState", data).due_cameras):
                due = stamp_ns(data)
    assert last["/clock"] / NS == simulated_s(tmp_path / "summary.json")
    assert last["/odom"] == last["/scene_state"], "of the same tick"
    assert {topic: last[topic] for topic in images} == dict.fromkeys(images, due), (
        "the images of the last tick at which they were due"
    )


def last_clock_s(bag: Path) -> float:
    with BagReader(bag) as reader:
        return [stamp_ns(data) for _, _, data in reader.raw_messages(["/clock"])][-1] / NS


def simulated_s(summary: Path) -> float:
    """Returns the end time of a run that began at 0."""
    return float(json.loads(summary.read_text())["physics"]["simulation_time_s"])
