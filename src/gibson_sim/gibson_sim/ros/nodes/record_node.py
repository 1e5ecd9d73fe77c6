"""The record node: writes topics to a bag, byte for byte as they came, at simulation time."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from gibson_msgs.msg import SceneState
from gibson_sim.bags.recording import Beginning, Recording, report_lines
from gibson_sim.client_config import RecordConfig
from gibson_sim.errors import RecordError
from gibson_sim.ros.lockstep.lockstep_client import MATCHING_S, SETTLED_S, LockstepParticipant
from gibson_sim.ros.nodes.awaited import Awaited
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node, started_by_launcher, write_summary
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.recording.intake import DEPTH, Intake, Taken, offered_qos, recording_profile
from gibson_sim.ros.topics import names, qos
from gibson_sim.settings import nearest
from gibson_sim.standard.lockstep import CAMERAS

try:
    from rosbag2_interfaces.srv import IsPaused, Pause, Resume, Snapshot, SplitBagfile
except ImportError:
    IsPaused = None


def offer_services(node: Node, recording: Recording, take_waiting: Callable[[], None]) -> None:
    """Offers ~/pause, ~/resume, ~/is_paused and ~/split_bagfile, or ~/snapshot in place of the last; says where they are missing.

    Args:
        node: of the services.
        recording: what they rule.
        take_waiting: records what waits; called first, since it was sent before the request.
    """
    if IsPaused is None:
        node.get_logger().warning("no package rosbag2_interfaces here: ~/pause, ~/resume, ~/snapshot and their like are missing")
        return

    def on_pause(_: Any, response: Any) -> Any:
        take_waiting()
        recording.pause()
        return response

    def on_resume(_: Any, response: Any) -> Any:
        take_waiting()
        recording.resume()
        return response

    def on_is_paused(_: Any, response: Any) -> Any:
        response.paused = recording.paused
        return response

    def on_split(_: Any, response: Any) -> Any:
        take_waiting()
        recording.split()
        return response

    def on_snapshot(_: Any, response: Any) -> Any:
        take_waiting()
        response.success = recording.snapshot() is not None
        return response

    node.create_service(Pause, "~/pause", on_pause)
    node.create_service(Resume, "~/resume", on_resume)
    node.create_service(IsPaused, "~/is_paused", on_is_paused)
    if recording.keeps_snapshots:
        node.create_service(Snapshot, "~/snapshot", on_snapshot)
    else:
        node.create_service(SplitBagfile, "~/split_bagfile", on_split)


CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
TURN_S = 0.01
"""What waits is taken so often. The middleware holds it until then, so this decides no time in the bag."""
QUIET_S, MOST_DRAIN_S = 0.3, 3.0
"""At the end: nothing came for so long that was sent before; and how long that may take."""
TIME_KNOWN_S = 0.5
"""So long after the publisher of /clock is known, it is known, too, whether time runs and whether its node listens to participants of lockstep."""
ALONE_S = 3.0
"""Where nobody who publishes /clock is known after so long, the recorder was there first."""
UNHEARD_S = 5.0
"""So long it may take until a new publisher is heard."""
ENDED_EARLY = 5
"""Exit code where the disk was full: the bag is readable. With settings that cannot be used it is 1, as of every node."""


class RecordNode(Node):
    """Subscribes to topics as they appear and writes what they carry; ends cleanly, bag intact, when the disk is nearly full.

    All that waits is taken at once and written in the order in which it was sent. The time of each message in the bag is the newest
    /clock before it, as `ros2 bag record --use-sim-time` has it; nothing is written before the first /clock, except latched
    messages, which get its time. Asked to end, it takes everything that was sent before, then closes the bag.

    It takes part in a simulation in lockstep: time does not go on with new images before it has written those of the tick before,
    however slow the disk is. Where the simulation was there before it, the bag begins with a /clock: where time runs, with the
    first one after it knows of all topics; where time stands, as soon as it goes on. See ``Beginning``.

    Parameters: the fields of ``gibson_sim.config.RecordConfig``.

    Subscribes, where there is lockstep:
        scene_state (gibson_msgs/SceneState): at which ticks cameras are due.

    Services (rosbag2_interfaces): ~/pause, ~/resume, ~/is_paused; ~/split_bagfile, or ~/snapshot with ``snapshot_seconds``.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Makes the bag. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            RecordError: the folder cannot be used.
        """
        super().__init__("record", **kwargs)
        self._intake: Intake | None = None
        self._config = config = config_from_parameters(self, RecordConfig)
        self._wanted = {self.resolve_topic_name(topic) for topic in config.wanted_topics()}
        self._recording = Recording(config)
        self._seen: set[str] = set()
        self._topics: set[str] = set()
        """All that there were at any time."""
        self._unheard: dict[str, float] = {}
        self._lockstep: LockstepParticipant | None = None
        self._latched: set[str] = set()
        self._beginning = Beginning(self._latched.__contains__)
        # Steady clock, seconds.
        self._started, self._changed, self._time_known = time.monotonic(), 0.0, math.inf
        self._intake = Intake(self)
        self._intake.subscribe(names.CLOCK, CLOCK_TYPE, QoSProfile(depth=DEPTH))
        offer_services(self, self._recording, self._take_all)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.2, self._find_topics, clock=steady)
        self.create_timer(config.flush_period, self._recording.flush, clock=steady)
        self._simulation = Awaited.simulation(self, names.CLOCK, config.timeout)
        self._find_topics()

    def _find_topics(self) -> None:
        """Subscribes to what has appeared since the last look. Last comes what the physics node waits for: see ``PhysicsConfig``."""
        assert self._intake is not None
        known, unheard = len(self._seen), self._intake.count_publishers()
        self._warn_of_unheard(unheard)
        topics = {topic for topic, _ in self.get_topic_names_and_types()}
        self._topics |= topics
        found = {topic for topic in topics if topic not in self._seen and self._is_wanted(topic)}
        last = (f"/{names.SCENE_STATE}", f"/{names.GROUND_TRUTH}")
        for topic in sorted(found, key=lambda t: (t.endswith(last), t)):
            publishers = self.get_publishers_info_by_topic(topic)
            if topic == names.CLOCK:
                self._seen.add(topic)
                self._recording.add_topic(topic, CLOCK_TYPE, qos.CLOCK)
            elif publishers:
                self._seen.add(topic)
                self._record(topic, publishers)
        if unheard or len(self._seen) > known:
            self._changed = time.monotonic()
        if self._lockstep is None:
            self._look_where_to_begin()

    def _look_where_to_begin(self) -> None:
        """Takes part where the node that makes time listens to participants; those that listen besides may be recorders as we are."""
        assert self._intake is not None
        now, makers, beginning = time.monotonic(), _nodes(self.get_publishers_info_by_topic(names.CLOCK)), self._beginning
        if makers:
            self._time_known = min(self._time_known, now)
        known_s = now - self._time_known
        if not makers & _nodes(self.get_subscriptions_info_by_topic(names.TICK_DONE)):
            if known_s > TIME_KNOWN_S or (not makers and now - self._started > ALONE_S):
                beginning.open()
        elif started_by_launcher() or beginning.is_open:
            beginning.open()
            self._join()
        elif known_s > TIME_KNOWN_S and not beginning.is_late:
            # Time stands. An image of where it stands may be sent once more, without the rest of its tick.
            beginning.begin_with_clock()
            self._join()
        elif known_s > MATCHING_S or now - max(self._changed, self._time_known) > SETTLED_S:
            self._take_waiting(all_of_it=True)
            self._intake.forget_losses()
            beginning.begin_with_clock()
            self.get_logger().info(f"time is running already: the bag begins with the next /clock, with {len(self._seen)} topics")
            self._join()
        elif beginning.is_late:
            beginning.leave_out()

    def _join(self) -> None:
        self.create_subscription(SceneState, names.SCENE_STATE, self._on_state, qos.STATE)
        self._lockstep = LockstepParticipant(self, after=CAMERAS, watches=True)

    def _on_state(self, msg: SceneState) -> None:
        """Writes what came before this tick; what it brings itself is being drawn meanwhile."""
        if msg.due_cameras and self._lockstep is not None:
            self._take_waiting()
            self._lockstep.done(msg.header.stamp)

    def _warn_of_unheard(self, unheard: dict[str, tuple[int, int]]) -> None:
        """Warns once of publishers that stay unheard: those that came later may offer less than the subscription asks for."""
        now = time.monotonic()
        self._unheard = {topic: self._unheard.get(topic, now) for topic in unheard}
        for topic, since in self._unheard.items():
            if UNHEARD_S < now - since < math.inf:
                self._unheard[topic] = -math.inf
                heard, there = unheard[topic]
                self.get_logger().warning(
                    f"{topic}: {heard} of {there} publishers are recorded; the others offer less (best effort, not latched) than the "
                    "first ones did, or another type"
                )

    def _is_wanted(self, topic: str) -> bool:
        """Whether to record a topic. Of all topics those are left out that hold what others hold, and hidden ones, as rosbag2 does."""
        if self._wanted:
            return topic in self._wanted
        return not (names.is_derived(topic) or names.is_hidden(topic))

    def _record(self, topic: str, publishers: list[Any]) -> None:
        """Subscribes to one topic, as reliable and as latched as its publishers allow."""
        assert self._intake is not None
        type_name = publishers[0].topic_type
        profile = recording_profile(publishers, type_name)
        latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        if latched:
            self._latched.add(topic)
        try:
            self._recording.add_topic(topic, type_name, offered_qos(profile, type_name), latched=latched)
            self._intake.subscribe(topic, type_name, profile)
        except RecordError as error:
            self.get_logger().warning(f"{topic} is not recorded: {error}")

    def _take_waiting(self, *, all_of_it: bool = False) -> None:
        assert self._intake is not None
        self._write(self._intake.take(all_of_it=all_of_it))

    def _take_all(self) -> None:
        """Records all that was sent before now and is not left out, and begins here if it has not begun."""
        self._take_waiting(all_of_it=True)
        self._beginning.open()
        self._write([])

    def _write(self, messages: list[Taken]) -> None:
        """Writes messages in the order in which they were sent."""
        for topic, data in self._beginning.let_through((message.topic, message.data) for message in messages):
            if topic == names.CLOCK:
                self._recording.on_clock(data)
            else:
                self._recording.take(topic, data)

    def spin(self) -> int:
        """Records until it is asked to end, ``duration`` has passed or the disk is full; returns the exit code."""
        executor = make_executor()
        executor.add_node(self)
        while is_running() and not self._recording.done:
            self._simulation.look()
            began = time.monotonic()
            self._take_waiting()
            executor.spin_once(timeout_sec=max(0.0, TURN_S - (time.monotonic() - began)))
        executor.remove_node(self)
        if self._lockstep is not None:
            self._lockstep.leave()
        if not self._recording.done:
            self._drain()
        return ENDED_EARLY if self._recording.error else 0

    def _drain(self) -> None:
        """Takes what was sent before now and is still on its way."""
        assert self._intake is not None
        asked_ns, began = time.time_ns(), time.monotonic()
        quiet = began
        while (now := time.monotonic()) - quiet < QUIET_S and now - began < MOST_DRAIN_S:
            messages = self._intake.take()
            self._write(messages)
            if any(message.sent_ns <= asked_ns for message in messages):
                quiet = time.monotonic()
            time.sleep(TURN_S)
        self._take_all()

    def close(self) -> None:
        """Closes the bag, and says what is in it."""
        intake, self._intake = self._intake, None
        if intake is None:
            return
        self._recording.close()
        summary = {**self._recording.summary(), "lost": intake.lost(), "message_lost": intake.reported_lost()}
        summary["absent"] = {topic: nearest(topic, sorted(self._topics - {topic})) for topic in sorted(self._wanted - self._seen)}
        intake.close()
        write_summary(self._config.summary_path, summary)
        lines = report_lines(summary)
        if started_by_launcher():  # which has the numbers in its own summary
            lines = [line for line in lines if line.startswith("WARNING")]
        for line in lines:
            sys.stderr.write(f"{line}\n")


def _nodes(endpoints: list[Any]) -> set[tuple[str, str]]:
    return {(endpoint.node_namespace, endpoint.node_name) for endpoint in endpoints}


def main(args: list[str] | None = None) -> None:
    """Runs the record node."""
    run_node(RecordNode, args)


if __name__ == "__main__":
    main()
