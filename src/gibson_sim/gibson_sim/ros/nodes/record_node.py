"""The record node: writes serialized messages to a bag unchanged, with simulation time."""

from __future__ import annotations

import math
import shutil
import sys
import time
from collections.abc import Callable, Iterable
from typing import Any, cast

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message

from gibson_msgs.msg import Scene, SceneState
from gibson_sim.bags.images.compress import ImageCompressor, ImageForm, ImageStream, size_line
from gibson_sim.bags.images.decode import COMPRESSED, IMAGE, IMAGE_TYPES, SUFFIXES as IMAGE_SUFFIXES
from gibson_sim.bags.metadata import TopicQos
from gibson_sim.bags.recording import Recording, StartGate, report_lines
from gibson_sim.client_config import RecordConfig
from gibson_sim.errors import RecordError
from gibson_sim.interrupts import held_back
from gibson_sim.ros.lockstep.lockstep_client import DISCOVERY_TIMEOUT_S, SETTLED_S, LockstepParticipant
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node, started_by_launcher, write_summary
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.nodes.wait_for_simulation import WaitCondition
from gibson_sim.ros.recording.raw_subscriptions import (
    DEPTH,
    RawSubscriptions,
    ReceivedMessage,
    offered_qos,
    recording_profile,
)
from gibson_sim.ros.topics import names, qos
from gibson_sim.settings import nearest
from gibson_sim.standard.lockstep import CAMERAS

try:
    from rosbag2_interfaces.srv import IsPaused, Pause, Resume, Snapshot, SplitBagfile
except ImportError:
    IsPaused = None

CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
PERIOD_S = 0.01
"""Period at which the subscriptions are read, s. The middleware stamps the messages, so it does not affect the times in the bag."""
QUIET_S, MAX_DRAIN_S = 0.3, 3.0
"""Time without a message sent before the end after which a recording ends, and timeout for that, s of wall time."""
TIME_KNOWN_S = 0.5
"""Time after the discovery of a publisher of /clock after which it is known whether time runs and whether lockstep is on, s of wall time."""
ALONE_S = 3.0
"""Time without a publisher of /clock after which the recorder counts as started before the simulation, s of wall time."""
IMAGES_TIMEOUT_S = 20.0
"""Timeout for the first image of each topic in a simulation whose time runs, s of wall time."""
UNMATCHED_S = 5.0
"""Time after which an unmatched publisher is reported, s of wall time."""
ENDED_EARLY = 5
"""Exit code if the disk was full; the bag is readable. Invalid settings give 1, as in every node."""


class RecordNode(Node):
    """Subscribes to topics as they appear and writes their messages; ends cleanly, with an intact bag, when the disk is nearly full.

    Messages are written in the order in which they were sent. The time of each message in the bag is the newest /clock before it, as with
    `ros2 bag record --use-sim-time`; before the first /clock only latched messages are written, with its time. At the end, all messages sent
    before are written, then the bag is closed.

    With ``record_images`` compressed, images are compressed as image_transport does it, and recorded on its topics: raw images on
    ``<camera>/image_raw`` as ``<camera>/image_raw/compressed``.

    In lockstep, time waits at ticks with images until the node has written the images of the previous tick, however slow the disk is. If the
    simulation was started first, the bag begins with a /clock: if time runs, the first one after all topics are discovered and
    each image topic has delivered an image; if time stands still, the next one. See ``StartGate``.

    Parameters: the fields of ``gibson_sim.client_config.RecordConfig``.

    Subscribes, in lockstep:
        scene_state (gibson_msgs/SceneState): the ticks at which cameras are due.

    Services (rosbag2_interfaces): ~/pause, ~/resume, ~/is_paused; ~/split_bagfile, or ~/snapshot with ``snapshot_seconds``.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Creates the bag. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            RecordError: the folder cannot be used.
        """
        super().__init__("record", **kwargs)
        self._subscribed: RawSubscriptions | None = None
        self._config = config = config_from_parameters(self, RecordConfig)
        self._requested = {self.resolve_topic_name(topic) for topic in config.wanted_topics()}
        recording: Recording | None = None
        try:
            with held_back():
                recording = self._recording = Recording(config)
            self._begin()
        except BaseException:  # closes the bag after an interrupt, too
            if recording is not None:
                recording.close()
            raise

    def _begin(self) -> None:
        """Creates services and timers, and subscribes to the topics that exist."""
        config = self._config
        self._seen: set[str] = set()
        """Topics with a subscription, and refused ones."""
        self._topics: set[str] = set()
        """All topics that have been discovered."""
        self._unmatched: dict[str, float] = {}
        """Topic with unmatched publishers -> monotonic time since which it has some, s; -inf = it was reported."""
        self._lockstep: LockstepParticipant | None = None
        self._latched: set[str] = set()
        self._compressor = ImageCompressor() if config.record_images == "compressed" else None
        self._compressed_profiles: dict[str, TopicQos] = {}
        """Raw image topic whose messages are compressed -> QoS of the recorded topic."""
        self._recorded_as: dict[str, str] = {}
        """Raw image topic -> topic in the bag."""
        self._streams: dict[str, ImageStream] = {}
        """Image topic -> image stream that a camera of the scene publishes on it."""
        self._image_topics: set[str] = set()
        """Topics with images to which this node subscribes."""
        self._images: set[str] | None = set()
        """Recorded topics of raw images; None = the estimate of their size was logged."""
        self._start_gate = StartGate(self._latched.__contains__)
        # Monotonic clock, s.
        self._started, self._changed, self._time_known = time.monotonic(), 0.0, math.inf
        self._scene_topic = self.resolve_topic_name(names.SCENE)
        self._subscribed = RawSubscriptions(self)
        self._subscribed.subscribe(names.CLOCK, CLOCK_TYPE, QoSProfile(depth=DEPTH))
        offer_services(self, self._recording, self._flush)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.2, self._find_topics, clock=steady)
        self.create_timer(config.flush_period, self._recording.flush, clock=steady)
        bag = "play a bag with `gibson-sim bag play --clock`"
        self._simulation = WaitCondition.for_simulation(self, names.CLOCK, config.timeout, alternative=bag)
        self._find_topics()

    def _find_topics(self) -> None:
        """Subscribes to the topics that have appeared since the last call."""
        assert self._subscribed is not None
        previous_count, unmatched = len(self._seen), self._subscribed.unmatched_publishers()
        self._warn_of_unmatched(unmatched)
        topics = {topic for topic, _ in self.get_topic_names_and_types()}
        self._topics |= topics
        new = {topic for topic in topics if topic not in self._seen and self._is_requested(topic)}
        last = (f"/{names.SCENE_STATE}", f"/{names.GROUND_TRUTH}")  # the physics node waits for these: see ``PhysicsConfig``
        for topic in sorted(new, key=lambda t: (t.endswith(last), t)):
            publishers = self.get_publishers_info_by_topic(topic)
            if topic == names.CLOCK:
                self._seen.add(topic)
                self._recording.add_topic(topic, CLOCK_TYPE, qos.CLOCK)
            elif publishers:
                self._seen.add(topic)
                self._record(topic, publishers)
        if unmatched or len(self._seen) > previous_count:
            self._changed = time.monotonic()
        elif self._images and self._streams:
            self._log_size(self._images)
        if self._lockstep is None:
            self._choose_start()

    def _choose_start(self) -> None:
        """Chooses the start of the bag, and joins lockstep if the publisher of /clock subscribes to ``tick_done``."""
        assert self._subscribed is not None
        now, simulations, gate = time.monotonic(), _nodes(self.get_publishers_info_by_topic(names.CLOCK)), self._start_gate
        if simulations:
            self._time_known = min(self._time_known, now)
        known_s = now - self._time_known
        if not simulations & _nodes(self.get_subscriptions_info_by_topic(names.TICK_DONE)):
            if known_s > TIME_KNOWN_S or (not simulations and now - self._started > ALONE_S):
                gate.open()
        elif started_by_launcher() or gate.is_open:
            gate.open()
            self._join()
        elif known_s > TIME_KNOWN_S and not gate.is_late:
            # Time stands still. An image of the present tick may be published again, without the other messages of the tick.
            gate.open_at_next_clock()
            self._join()
        elif self._all_arrive(known_s, now - max(self._changed, self._time_known)):
            self._write_received(flush=True)
            self._subscribed.reset_losses()
            gate.open_at_next_clock()
            self.get_logger().info(f"time is running already: the bag begins with the next /clock, with {len(self._seen)} topics")
            self._join()
        elif gate.is_late:
            gate.discard()

    def _all_arrive(self, known_s: float, settled_s: float) -> bool:
        """Returns whether all messages arrive that are published from now on, as far as can be known while time runs.

        A subscription knows its publishers before they know it, and a renderer that is short of CPU time is slow to discover it. Time does
        not wait for that, so the first image of each topic must have arrived.

        Args:
            known_s: time since the simulation was discovered, s of wall time.
            settled_s: time since the last discovery of a topic or a publisher, s of wall time.
        """
        assert self._subscribed is not None
        silent = self._subscribed.silent(self._image_topics)
        if not silent or known_s <= IMAGES_TIMEOUT_S:
            return not silent and (settled_s > SETTLED_S or known_s > DISCOVERY_TIMEOUT_S)
        self.get_logger().warning(
            f"no image on {', '.join(silent)} within {IMAGES_TIMEOUT_S:g} s: the bag begins without it, and may lack the first ones"
        )
        return True

    def _join(self) -> None:
        self.create_subscription(SceneState, names.SCENE_STATE, self._on_state, qos.STATE)
        self._lockstep = LockstepParticipant(self, after=CAMERAS, passive=True)

    def _on_state(self, msg: SceneState) -> None:
        """Writes the messages before this tick; the messages of the tick are written while its images are rendered."""
        if msg.due_cameras and self._lockstep is not None:
            self._write_received()
            self._lockstep.tick_done(msg.header.stamp)

    def _warn_of_unmatched(self, unmatched: dict[str, tuple[int, int]]) -> None:
        """Warns once of publishers that stay unmatched: later ones may offer a weaker QoS than the subscription requests."""
        now = time.monotonic()
        self._unmatched = {topic: self._unmatched.get(topic, now) for topic in unmatched}
        for topic, since in self._unmatched.items():
            if UNMATCHED_S < now - since < math.inf:
                self._unmatched[topic] = -math.inf
                matched, discovered = unmatched[topic]
                self.get_logger().warning(
                    f"{topic}: {matched} of {discovered} publishers are recorded; the others have another message type, or a weaker QoS than "
                    "the first ones (best effort, not latched)"
                )

    def _is_requested(self, topic: str) -> bool:
        """Returns whether to record a topic: a requested one, or if none is requested, any but derived topics and, as in rosbag2, hidden ones."""
        if self._requested:
            return topic in self._requested
        return not (names.is_derived(topic) or names.is_hidden(topic))

    def _log_size(self, topics: set[str]) -> None:
        """Logs once the disk space that the images will take, if their cameras are known; called when no more topics appear."""
        self._images = None
        streams = [self._streams[topic] for topic in topics if topic in self._streams]
        if streams:
            free = shutil.disk_usage(self._config.output).free - self._config.reserve_mb * 1_000_000
            form = cast(ImageForm, "raw" if self._config.record_images == "none" else self._config.record_images)
            self.get_logger().info(size_line(streams, form, max(0, free), self._config.compression))

    def _read_streams(self, data: bytes) -> None:
        """Reads the image streams of the cameras from a serialized scene."""
        for camera in deserialize_message(data, Scene).cameras:
            topics = names.camera_topics(camera.name)
            for output in (name for name in camera.outputs if name in topics):  # other entries set the hole filling
                topic = self.resolve_topic_name(topics[output])
                self._streams[topic] = ImageStream(output, camera.width, camera.height, camera.rate)

    def _record(self, topic: str, publishers: list[Any]) -> None:
        """Subscribes to one topic with the strictest QoS that its publishers offer."""
        assert self._subscribed is not None
        type_name = publishers[0].topic_type
        if type_name in IMAGE_TYPES:
            if self._config.record_images == "none" and topic not in self._requested:
                return
            if self._images is not None and type_name != COMPRESSED:
                self._images.add(topic)
            self._image_topics.add(topic)
        profile = recording_profile(publishers, type_name)
        latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        if latched:
            self._latched.add(topic)
        try:
            if self._is_compressed_here(topic, type_name):
                self._compressed_profiles[topic] = offered_qos(profile, type_name)
            else:
                self._recording.add_topic(topic, type_name, offered_qos(profile, type_name), latched=latched)
            self._subscribed.subscribe(topic, type_name, profile)
        except RecordError as error:
            self.get_logger().warning(f"{topic} is not recorded: {error}")

    def _is_compressed_here(self, topic: str, type_name: str) -> bool:
        """Returns whether this node compresses the images of a topic; not if compressed images from their publisher are recorded as well."""
        if self._compressor is None or type_name not in IMAGE_TYPES or type_name == COMPRESSED:
            return False
        if any(topic + suffix in self._requested for suffix in IMAGE_SUFFIXES):
            return False
        self._compressor.add_topic(topic)
        return True

    def _write_received(self, *, flush: bool = False) -> None:
        """Writes the messages that arrived; with ``flush``, also those that are held back for sorting."""
        assert self._subscribed is not None
        self._write(self._subscribed.receive(flush=flush))

    def _flush(self) -> None:
        """Writes all messages that arrived; starts the bag now if it has not started."""
        self._write_received(flush=True)
        self._start_gate.open()
        self._write([])

    def _write(self, messages: list[ReceivedMessage]) -> None:
        """Writes messages, which must be in the order in which they were sent."""
        for topic, data, received_on in self._compressed(self._start_gate.release((m.topic, m.data) for m in messages)):
            if topic == names.CLOCK:
                self._recording.receive_clock(data)
                continue
            if topic == self._scene_topic and not self._streams:
                self._read_streams(data)
            if received_on in self._compressed_profiles and topic not in self._recorded_as.values():
                self._recorded_as[received_on] = topic
                type_name = COMPRESSED if topic != received_on else IMAGE
                self._recording.add_topic(topic, type_name, self._compressed_profiles[received_on])
            self._recording.receive(topic, data)

    def _compressed(self, messages: Iterable[tuple[str, bytes]]) -> Iterable[tuple[str, bytes, str]]:
        """Returns the topic in the bag, the bytes and the original topic of each message."""
        if self._compressor is None:
            return ((topic, data, topic) for topic, data in messages)
        return self._compressor.compress(messages)

    def spin(self) -> int:
        """Records until the context ends, ``duration`` has passed or the disk is full; returns the exit code."""
        executor = make_executor()
        executor.add_node(self)
        while is_running() and not self._recording.done:
            self._simulation.is_met()
            start = time.monotonic()
            self._write_received()
            executor.spin_once(timeout_sec=max(0.0, PERIOD_S - (time.monotonic() - start)))
        executor.remove_node(self)
        if self._lockstep is not None:
            self._lockstep.leave()
        if not self._recording.done:
            self._drain()
        return ENDED_EARLY if self._recording.error else 0

    def _drain(self) -> None:
        """Writes the messages that were sent before now and have not arrived yet."""
        assert self._subscribed is not None
        end_ns, start = time.time_ns(), time.monotonic()
        last_message = start
        while (now := time.monotonic()) - last_message < QUIET_S and now - start < MAX_DRAIN_S:
            messages = self._subscribed.receive()
            self._write(messages)
            if any(message.sent_ns <= end_ns for message in messages):
                last_message = time.monotonic()
            time.sleep(PERIOD_S)
        self._flush()

    def close(self) -> None:
        """Closes the bag, and prints a summary."""
        subscribed, self._subscribed = self._subscribed, None
        if subscribed is None:
            return
        self._recording.close()
        if self._compressor is not None:
            self._compressor.close()
        lost = {self._recorded_as.get(topic, topic): count for topic, count in subscribed.lost().items()}
        summary = {**self._recording.summary(), "lost": lost, "message_lost": subscribed.reported_lost()}
        absent = sorted(self._requested - self._seen)
        summary["absent"] = {topic: nearest(topic, sorted(self._topics - {topic})) for topic in absent}
        subscribed.close()
        write_summary(self._config.summary_path, summary)
        lines = report_lines(summary)
        if started_by_launcher():  # the summary of the launcher contains the other lines
            lines = [line for line in lines if line.startswith("WARNING")]
        for line in lines:
            sys.stderr.write(f"{line}\n")


def offer_services(node: Node, recording: Recording, flush: Callable[[], None]) -> None:
    """Creates the services ~/pause, ~/resume, ~/is_paused and either ~/split_bagfile or ~/snapshot; warns if rosbag2_interfaces is missing.

    Args:
        node: node of the services.
        recording: recording that they control.
        flush: writes the messages that arrived before a request; called first.
    """
    if IsPaused is None:
        node.get_logger().warning(
            "package rosbag2_interfaces is not installed: the services ~/pause, ~/resume, ~/is_paused, ~/split_bagfile and ~/snapshot "
            "are not offered"
        )
        return

    def on_pause(_: Any, response: Any) -> Any:
        flush()
        recording.pause()
        return response

    def on_resume(_: Any, response: Any) -> Any:
        flush()
        recording.resume()
        return response

    def on_is_paused(_: Any, response: Any) -> Any:
        response.paused = recording.paused
        return response

    def on_split(_: Any, response: Any) -> Any:
        flush()
        recording.split()
        return response

    def on_snapshot(_: Any, response: Any) -> Any:
        flush()
        response.success = recording.snapshot() is not None
        return response

    node.create_service(Pause, "~/pause", on_pause)
    node.create_service(Resume, "~/resume", on_resume)
    node.create_service(IsPaused, "~/is_paused", on_is_paused)
    if recording.keeps_snapshots:
        node.create_service(Snapshot, "~/snapshot", on_snapshot)
    else:
        node.create_service(SplitBagfile, "~/split_bagfile", on_split)


def _nodes(endpoints: list[Any]) -> set[tuple[str, str]]:
    return {(endpoint.node_namespace, endpoint.node_name) for endpoint in endpoints}


def main(args: list[str] | None = None) -> None:
    """Runs the record node."""
    run_node(RecordNode, args)


if __name__ == "__main__":
    main()
