"""The replay node: sends the inputs of a recorded run to a simulation, and verifies that it repeats the run."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

from gibson_msgs.msg import Input, RunInfo, SceneState, TickDigest
from gibson_sim.bags.digest_comparison import DigestComparison, Tick, TickDigests
from gibson_sim.bags.replaying import InputSchedule, RecordedCommand, RecordedInput, mapping_in, read_run
from gibson_sim.client_config import ReplayConfig
from gibson_sim.errors import ConfigError, GibsonSimError, RecordError
from gibson_sim.ros import conversions
from gibson_sim.ros.lockstep.lockstep_client import LockstepParticipant
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node, write_summary
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.nodes.wait_for_simulation import WaitCondition
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.discovery import is_fully_matched
from gibson_sim.ros.wire.message_types import message_class

LAST_DIGESTS_S = 2.0, 20.0
"""Timeouts for the digests of the last tick, s of wall time: free-running, where images may be missing, and in lockstep."""
_TICKS_AHEAD = 2
"""Number of ticks by which inputs are sent ahead in lockstep: the present one, and the next one in case a reset ends the present one early."""
_SECONDS_AHEAD = 1
"""Simulation time by which inputs are sent ahead without lockstep, s."""
_MAX_UNACKNOWLEDGED = 50
"""Number of inputs after which the sender waits for their acknowledgement: half the queue of the simulation."""
_ARRIVAL_S = 5.0
"""Timeout for an acknowledgement, s of wall time."""
_DEEP = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=2000, reliability=ReliabilityPolicy.RELIABLE)
_DISCARD = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Profile of images that are subscribed to only to have them rendered for their digests."""
_IGNORED, _DRIVER = ("system", "opengl"), ("renderer", "version")
"""Keys of the environment that are not compared as a whole, and keys of ``opengl`` that are compared."""


class ReplayNode(Node):
    """Sends the inputs in a bag; ends with exit code 0 when the last tick of the recorded run is reached.

    If the bag has the journal ``inputs``, or in lockstep, every input is sent with the step at which it must be applied. Otherwise commands
    are published on their topics when simulation time reaches their times.

    Parameters: the fields of ``gibson_sim.client_config.ReplayConfig``.

    Subscribes:
        scene_state (gibson_msgs/SceneState): the present tick. With ``verify``: tick_digest (gibson_msgs/TickDigest), run_info
        (gibson_msgs/RunInfo), and the images that the bag has digests of.

    Publishes:
        inputs_at (gibson_msgs/Input), or the commands' own topics; tick_done (gibson_msgs/TickDone), in lockstep.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Reads the bag. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            RecordError: the bag cannot be read, or has no inputs, or no digests to compare with.
        """
        super().__init__("replay", **kwargs)
        self._config = config = config_from_parameters(self, ReplayConfig)
        if not config.bag:
            raise ConfigError("setting 'bag' is empty, must be the folder of the bag")
        self._run = run = read_run(config.bag, digests=config.verify)
        if run.begins_late:
            self.get_logger().warning(
                "recording began in the middle of the run: earlier inputs are unknown, so the replay will differ"
            )
        self._end = run.end(config.step_hz, config.publish_hz)
        self._comparison = DigestComparison(run.digests, images=config.images) if config.verify else None
        if self._comparison is not None and self._comparison.last is None:
            raise RecordError(
                f"bag {config.bag} has no digests to compare with: record with `gibson-sim run --digests --record ...`"
            )
        self._ticks_ahead = _TICKS_AHEAD * config.step_hz // config.publish_hz
        self._lockstep: LockstepParticipant | None = None
        self._sender = self._make_sender()
        self._now: Tick = (0, 0)
        self._ended_s: float | None = None
        self._sent = 0
        self._environment_changes: dict[str, dict[str, list[str]]] = {}
        """Kind of node -> key of its environment -> recorded and present value, if they differ."""

    def _make_sender(self) -> _InputSender | _CommandSender:
        """Returns the sender of the inputs."""
        config, run = self._config, self._run
        if config.lockstep or run.journal is not None:
            ahead = self._ticks_ahead if config.lockstep else _SECONDS_AHEAD * config.step_hz
            return _InputSender(self, run.inputs(config.step_hz), ahead)
        return _CommandSender(self, run.commands)

    # Start

    def spin(self) -> int:
        """Sends inputs until the last tick is reached or the context ends; returns the exit code."""
        executor = make_executor()
        executor.add_node(self)
        self._prepare(executor)
        while is_running() and not self._is_finished():
            executor.spin_once(timeout_sec=0.05)
        if self._lockstep is not None and self._ended_s is None:
            self._lockstep.leave()
        return 0

    def _prepare(self, executor: Executor) -> None:
        """Sends the inputs before the first tick, then subscribes to the state, which lets time start."""
        simulation = WaitCondition.for_simulation(self, names.SCENE_STATE, self._config.timeout)
        while is_running() and not simulation.is_met():
            executor.spin_once(timeout_sec=0.05)
        self._wait(executor, self._sender.has_subscribers, "a simulation that subscribes to the inputs")
        if self._comparison is not None:
            self.create_subscription(TickDigest, names.TICK_DIGEST, self._on_digests, _DEEP)
            self.create_subscription(RunInfo, names.RUN_INFO, self._on_run_info, qos.RUN_INFO)
            topics = self._comparison.image_topics
            for topic in topics:
                self.create_subscription(Image, topic, _discard, _DISCARD, raw=True)
            self._wait(executor, lambda: all(self.count_publishers(topic) for topic in topics), f"images on {', '.join(topics)}")
        self._sent += len(self._sender.send((0, 0), 0))
        self._sender.wait_until_acknowledged()
        self.create_subscription(SceneState, names.SCENE_STATE, self._on_state, _DEEP)
        if self._config.lockstep:
            self._lockstep = LockstepParticipant(self)

    def _wait(self, executor: Executor, condition: Callable[[], bool], awaited: str) -> None:
        """Spins until a condition holds; after the timeout the replay continues with a warning."""
        wait = WaitCondition(self, awaited, condition, timeout_s=self._config.timeout)
        try:
            while is_running() and not wait.is_met():
                executor.spin_once(timeout_sec=0.05)
        except GibsonSimError as error:
            self.get_logger().warning(f"{error}; the replay continues without it")

    # Ticks

    def _on_state(self, msg: SceneState) -> None:
        """Sends the inputs that are due. The last tick is not reported as done, so that time stops at it."""
        self._now = msg.epoch, msg.epoch_step
        if self._now >= self._end:
            self._ended_s = self._ended_s or time.monotonic()
            return
        sent = self._sender.send(self._now, conversions.time_from_msg(msg.header.stamp))
        self._sent += len(sent)
        if self._lockstep is not None:
            self._lockstep.tick_done(msg.header.stamp, sent)

    def _is_finished(self) -> bool:
        """Returns whether the last tick was reached, and its digests were compared or have timed out."""
        if self._ended_s is None:
            return False
        comparison = self._comparison
        passed = self._config.lockstep and self._now > self._end  # the run differs: no more digests will arrive
        if comparison is None or passed or comparison.is_complete(min(self._end, comparison.last or self._end)):
            return True
        return time.monotonic() - self._ended_s > LAST_DIGESTS_S[self._config.lockstep]

    # Verification

    def _on_digests(self, msg: TickDigest) -> None:
        assert self._comparison is not None
        stamp_ns = conversions.time_from_msg(msg.header.stamp)
        self._comparison.add((msg.epoch, msg.step), TickDigests(stamp_ns, tuple(msg.topics), msg.digests))

    def _on_run_info(self, msg: RunInfo) -> None:
        """Records the differences between the recorded and the present machine and software."""
        present = {**mapping_in(msg.platform), "gibson_sim": msg.version}
        recorded = self._run.surroundings.get(msg.kind, {})
        keys = [key for key in {**recorded, **present} if key not in _IGNORED]
        pairs = {key: [str(recorded.get(key)), str(present.get(key))] for key in keys}
        pairs["opengl"] = [" ".join(str(x.get("opengl", {}).get(key, "")) for key in _DRIVER) for x in (recorded, present)]
        changes = {key: pair for key, pair in pairs.items() if pair[0] != pair[1]}
        if recorded and changes:
            self._environment_changes[msg.kind] = changes

    def summary(self) -> dict[str, Any]:
        """Returns the number of inputs, the ticks reached, and the result of the verification."""
        comparison = self._comparison
        return {
            "bag": self._config.bag,
            "journal": self._run.journal is not None,
            "lockstep": self._config.lockstep,
            "inputs": self._sent,
            "reached": list(self._now),
            "end": list(self._end),
            "finished": self._ended_s is not None,
            "other_surroundings": self._environment_changes,
            "verification": None if comparison is None else comparison.result().to_json(),
        }

    def close(self) -> None:
        """Writes the summary."""
        write_summary(self._config.summary_path, self.summary())


class _InputSender:
    """Sends inputs with the steps at which they must be applied."""

    def __init__(self, node: Node, inputs: Sequence[RecordedInput], ahead: int) -> None:
        """Creates the publisher; ``ahead`` is the number of steps by which inputs are sent before their step."""
        self._node, self._schedule, self._ahead = node, InputSchedule(inputs), ahead
        self._publisher = node.create_publisher(Input, names.INPUTS_AT, qos.INPUTS)

    def has_subscribers(self) -> bool:
        """Returns whether the simulation subscribes to the inputs."""
        return _is_matched(self._node, self._publisher) and self._simulation() in _subscribers(self._node, self._publisher)

    def _simulation(self) -> str:
        """Returns the full name of the physics node; empty = it was not discovered."""
        publishers = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(names.SCENE_STATE))
        return next((f"{info.node_namespace}/{info.node_name}" for info in publishers), "")

    def send(self, tick: Tick, stamp_ns: int) -> Sequence[str]:
        """Sends the inputs due at a tick; returns the topic of each message."""
        inputs = self._schedule.pop_due(*tick, self._ahead)
        for number, item in enumerate(inputs, 1):
            message = Input(epoch=item.epoch, step=item.step, name=item.name, type=item.type_name)
            message.data = item.data
            self._publisher.publish(message)
            if number % _MAX_UNACKNOWLEDGED == 0:
                self.wait_until_acknowledged()
        return (self._publisher.topic_name,) * len(inputs)

    def wait_until_acknowledged(self) -> None:
        """Blocks until all inputs are acknowledged."""
        self._publisher.wait_for_all_acked(Duration(seconds=_ARRIVAL_S))


class _CommandSender:
    """Publishes commands on their own topics when simulation time reaches their times."""

    def __init__(self, node: Node, commands: Sequence[RecordedCommand]) -> None:
        """Creates the publishers; ``commands`` must be sorted by time."""
        self._node, self._commands, self._next = node, commands, 0
        self._publishers: dict[str, Publisher] = {}
        for item in commands:
            if item.name not in self._publishers:
                self._publishers[item.name] = node.create_publisher(message_class(item.type_name), item.name, qos.COMMAND)

    def has_subscribers(self) -> bool:
        """Returns whether every topic has subscribers."""
        return all(_is_matched(self._node, publisher) for publisher in self._publishers.values())

    def send(self, tick: Tick, stamp_ns: int) -> Sequence[str]:
        """Publishes the commands due at a stamp; returns the topic of each message."""
        first = self._next
        while self._next < len(self._commands) and self._commands[self._next].time_ns <= stamp_ns:
            item = self._commands[self._next]
            self._publishers[item.name].publish(item.data)
            self._next += 1
        return tuple(item.name for item in self._commands[first : self._next])

    def wait_until_acknowledged(self) -> None:
        """Does nothing: a late command is applied a little later."""


def _subscribers(node: Node, publisher: Publisher) -> list[str]:
    """Returns the full names of the nodes that subscribe to a publisher's topic, including recorders."""
    subscriptions = node.get_subscriptions_info_by_topic(publisher.topic_name)
    return [f"{info.node_namespace}/{info.node_name}" for info in subscriptions]


def _is_matched(node: Node, publisher: Publisher) -> bool:
    """Returns whether a publisher has subscribers, and is matched with all discovered ones."""
    return publisher.get_subscription_count() > 0 and is_fully_matched(node, publisher)


def _discard(data: bytes) -> None:
    """Discards an image."""


def main(args: list[str] | None = None) -> None:
    """Runs the replay node."""
    run_node(ReplayNode, args)


if __name__ == "__main__":
    main()
