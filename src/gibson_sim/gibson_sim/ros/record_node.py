"""The record node: writes topics to a bag, byte for byte as they came, at simulation time."""

from __future__ import annotations

from functools import partial
from importlib import import_module
from typing import Any, cast

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock as ClockMsg

from gibson_sim.bags.writer import BagWriter, Compression
from gibson_sim.config import RecordConfig
from gibson_sim.errors import ConfigError, RecordError
from gibson_sim.ros import conversions, names, qos
from gibson_sim.ros.node_main import run_node, spin_while, write_summary
from gibson_sim.ros.params import config_from_parameters
from gibson_sim.types import NS_PER_S

DEPTH = 200
"""Messages of a topic that may wait for the disk."""
MOST_WAITING = 1000
"""Messages that wait for the first clock, beside latched ones."""
PATIENCE_S = 30.0
"""Without /clock for so long, a user wants to know why nothing is recorded."""


class RecordNode(Node):
    """Subscribes to topics as they appear and writes what they carry; ends cleanly, bag intact, when the disk is nearly full.

    The time of each message in the bag is the newest /clock, as `ros2 bag record --use-sim-time` has it; nothing is written
    before the first /clock, except latched messages, which get its time.

    Parameters: the fields of ``gibson_sim.config.RecordConfig``.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Makes the bag. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            RecordError: the folder cannot be used.
        """
        super().__init__("record", **kwargs)
        self._bag: BagWriter | None = None
        self._config = config = config_from_parameters(self, RecordConfig)
        if not config.output:
            raise ConfigError("setting 'output' is empty, must be the folder of the bag")
        self._wanted = {self.resolve_topic_name(t.strip()) for t in config.topics.split(",") if t.strip()}
        self._bag = BagWriter(
            config.output, reserve_bytes=config.reserve_mb * 1_000_000, compression=cast(Compression, config.compression)
        )
        self._seen: set[str] = set()
        self._now_ns = 0
        self._start_ns = 0
        self._waiting: list[tuple[str, bytes]] = []
        self._counts: dict[str, int] = {}
        self._error = ""
        self._done = False
        self.create_subscription(ClockMsg, names.CLOCK, self._on_clock, DEPTH, raw=True)
        self.create_timer(0.2, self._find_topics, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._find_topics()

    def _find_topics(self) -> None:
        """Subscribes to what has appeared since the last look. The scene state comes last: see ``PhysicsConfig``."""
        found = dict(self.get_topic_names_and_types())
        state = self.resolve_topic_name(names.SCENE_STATE)
        for topic in sorted(found, key=lambda t: t == state):
            if topic in self._seen or not self._is_wanted(topic):
                continue
            publishers = self.get_publishers_info_by_topic(topic)
            if topic == names.CLOCK or not publishers:
                continue
            self._seen.add(topic)
            self._record(topic, publishers)
        if names.CLOCK in found and names.CLOCK not in self._seen and (not self._wanted or names.CLOCK in self._wanted):
            self._seen.add(names.CLOCK)
            self._writer.add_topic(names.CLOCK, "rosgraph_msgs/msg/Clock", qos.CLOCK)

    def _is_wanted(self, topic: str) -> bool:
        """Whether to record a topic. Of all topics those are left out that hold what others hold, and hidden ones, as rosbag2 does."""
        if self._wanted:
            return topic in self._wanted
        return not (names.is_derived(topic) or names.is_hidden(topic))

    def _record(self, topic: str, publishers: list[Any]) -> None:
        """Subscribes to one topic, as reliable and as latched as its publishers allow."""
        type_name = publishers[0].topic_type
        package, _, name = type_name.partition("/msg/")
        try:
            message_type = getattr(import_module(f"{package}.msg"), name)
        except (ImportError, AttributeError):
            self.get_logger().warning(f"{topic} is not recorded: its type {type_name} is not installed here")
            return
        profiles = [p.qos_profile for p in publishers]
        reliable = all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles)
        latched = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
        profile = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        try:
            self._writer.add_topic(topic, type_name, profile)
        except RecordError as error:
            self.get_logger().warning(f"{topic} is not recorded: {error}")
            return
        self.create_subscription(message_type, topic, partial(self._on_message, topic, latched), profile, raw=True)

    @property
    def _writer(self) -> BagWriter:
        assert self._bag is not None, "the bag is closed"
        return self._bag

    def _on_clock(self, data: bytes) -> None:
        self._now_ns = conversions.time_from_msg(deserialize_message(data, ClockMsg).clock)
        if not self._start_ns:
            self._start_ns = self._now_ns
            waiting, self._waiting = self._waiting, []
            for topic, message in waiting:
                self._write(topic, message)
        if names.CLOCK in self._seen:
            self._write(names.CLOCK, data)
        if self._config.duration and self._now_ns - self._start_ns >= self._config.duration * NS_PER_S:
            self._done = True

    def _on_message(self, topic: str, latched: bool, data: bytes) -> None:
        if self._now_ns:
            self._write(topic, data)
        elif latched or len(self._waiting) < MOST_WAITING:
            # The first clock may be handed out after what came behind it.
            self._waiting.append((topic, data))

    def _write(self, topic: str, data: bytes) -> None:
        """Writes one message; a full disk ends the recording, not the simulation."""
        if self._done:
            return
        try:
            self._writer.write(topic, data, self._now_ns, self._now_ns)
            self._counts[topic] = self._counts.get(topic, 0) + 1
        except RecordError as error:
            self._error, self._done = str(error), True
            self.get_logger().error(f"recording ends: {error}")

    def spin(self) -> int:
        """Records until the context ends, ``duration`` has passed or the disk is full; returns the exit code."""
        self.create_timer(PATIENCE_S, self._complain_without_clock, clock=Clock(clock_type=ClockType.STEADY_TIME))
        spin_while(self, lambda: not self._done)
        return 1 if self._error else 0

    def _complain_without_clock(self) -> None:
        if not self._now_ns:
            self.get_logger().warning("nothing is recorded yet: no /clock arrives; is a simulation running in this domain?")

    def close(self) -> None:
        """Closes the bag."""
        if self._bag is not None:
            bag, self._bag = self._bag, None
            bag.close()
            summary = {"bag": self._config.output, "messages": self._counts, "error": self._error}
            write_summary(self._config.summary_path, summary)


def main(args: list[str] | None = None) -> None:
    """Runs the record node."""
    run_node(RecordNode, args)


if __name__ == "__main__":
    main()
