"""The replay node: gives a simulation the inputs of a recorded run again, and says whether the same comes of it."""

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
from gibson_sim.ros.nodes.awaited import Awaited
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node, write_summary
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.matching import reaches_all
from gibson_sim.ros.wire.message_types import message_class

LAST_DIGESTS_S = 2.0, 20.0
"""So long (wall time) after the last tick its digests may take: free, where images may be left out, and in lockstep."""
_TICKS_AHEAD = 2
"""Ticks whose inputs are on their way in lockstep: the present one, and, should a reset cut it short, the one behind it."""
_SECONDS_AHEAD = 1
"""Simulation time by which inputs are early in a simulation that does not wait."""
_MOST_AT_ONCE = 50
"""Inputs between two looks whether they have arrived: the simulation keeps twice as many that it has not read."""
_ARRIVAL_S = 5.0
_DEEP = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=2000, reliability=ReliabilityPolicy.RELIABLE)
_GLANCE = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""For images that are to be drawn, not looked at."""
_LEFT_OUT, _DRIVER = ("system", "opengl"), ("renderer", "version")
"""Surroundings that do not matter, or not as a whole; and what matters of OpenGL."""


class ReplayNode(Node):
    """Gives back what a bag says of a run; ends with exit code 0 when the recorded run's last tick is reached.

    With the journal ``inputs`` in the bag, or in lockstep, every input is given to be obeyed at its step. Else commands are published on
    their topics when simulation time reaches theirs.

    Parameters: the fields of ``gibson_sim.config.ReplayConfig``.

    Subscribes:
        scene_state (gibson_msgs/SceneState): where time is. With ``verify``: tick_digest (gibson_msgs/TickDigest), run_info
        (gibson_msgs/RunInfo), and images of which the bag has digests.

    Publishes:
        inputs_at (gibson_msgs/Input), or the commands' own topics; tick_done (gibson_msgs/TickDone), in lockstep.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Reads the bag. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            RecordError: the bag cannot be read, or holds nothing to repeat or to compare with.
        """
        super().__init__("replay", **kwargs)
        self._config = config = config_from_parameters(self, ReplayConfig)
        if not config.bag:
            raise ConfigError("setting 'bag' is empty, must be the folder of the bag")
        self._run = run = read_run(config.bag, digests=config.verify)
        if run.begins_late:
            self.get_logger().warning(
                "recording began in the middle of the run: what came before is unknown, so this will differ"
            )
        self._end = run.end(config.step_hz, config.publish_hz)
        self._comparison = DigestComparison(run.digests, images=config.images) if config.verify else None
        if self._comparison is not None and self._comparison.last is None:
            raise RecordError(
                f"bag {config.bag} has no digests to compare with: record with `gibson-sim run --digests --record ...`"
            )
        self._ticks_ahead = _TICKS_AHEAD * config.step_hz // config.publish_hz
        self._lockstep: LockstepParticipant | None = None
        self._giver = self._make_giver()
        self._now: Tick = (0, 0)
        self._ended_s: float | None = None
        self._given = 0
        self._other_surroundings: dict[str, dict[str, list[str]]] = {}

    def _make_giver(self) -> _Inputs | _Commands:
        """Returns what gives the simulation its inputs."""
        config, run = self._config, self._run
        if config.lockstep or run.journal is not None:
            ahead = self._ticks_ahead if config.lockstep else _SECONDS_AHEAD * config.step_hz
            return _Inputs(self, run.inputs(config.step_hz), ahead)
        return _Commands(self, run.commands)

    # Beginning

    def spin(self) -> int:
        """Gives inputs until the last tick is reached or the context ends; returns the exit code."""
        executor = make_executor()
        executor.add_node(self)
        self._prepare(executor)
        while is_running() and not self._is_over():
            executor.spin_once(timeout_sec=0.05)
        if self._lockstep is not None and self._ended_s is None:
            self._lockstep.leave()
        return 0

    def _prepare(self, executor: Executor) -> None:
        """Gives what comes before the first tick, then lets time begin: it waits for a reader of the state."""
        simulation = Awaited.simulation(self, names.SCENE_STATE, self._config.timeout)
        while is_running() and not simulation.look():
            executor.spin_once(timeout_sec=0.05)
        self._wait(executor, self._giver.has_subscribers, "a simulation that takes the inputs")
        if self._comparison is not None:
            self.create_subscription(TickDigest, names.TICK_DIGEST, self._on_digests, _DEEP)
            self.create_subscription(RunInfo, names.RUN_INFO, self._on_run_info, qos.RUN_INFO)
            topics = self._comparison.image_topics
            for topic in topics:
                self.create_subscription(Image, topic, _look_away, _GLANCE, raw=True)
            self._wait(executor, lambda: all(self.count_publishers(topic) for topic in topics), f"images on {', '.join(topics)}")
        self._given += len(self._giver.give((0, 0), 0))
        self._giver.wait_for_arrival()
        self.create_subscription(SceneState, names.SCENE_STATE, self._on_state, _DEEP)
        if self._config.lockstep:
            self._lockstep = LockstepParticipant(self)

    def _wait(self, executor: Executor, condition: Callable[[], bool], what: str) -> None:
        """Works until a condition holds; without, after a timeout, the replay goes on, and what is missing differs."""
        awaited = Awaited(self, what, condition, timeout_s=self._config.timeout)
        try:
            while is_running() and not awaited.look():
                executor.spin_once(timeout_sec=0.05)
        except GibsonSimError as error:
            self.get_logger().warning(f"{error}; the replay goes on without")

    # Time

    def _on_state(self, msg: SceneState) -> None:
        """Gives what is due now. The last tick is never done, so that time stands still behind it."""
        self._now = msg.epoch, msg.epoch_step
        if self._now >= self._end:
            self._ended_s = self._ended_s or time.monotonic()
            return
        sent = self._giver.give(self._now, conversions.time_from_msg(msg.header.stamp))
        self._given += len(sent)
        if self._lockstep is not None:
            self._lockstep.done(msg.header.stamp, sent)

    def _is_over(self) -> bool:
        """Returns whether the last tick was reached and all was compared that may still come."""
        if self._ended_s is None:
            return False
        comparison = self._comparison
        lost = self._config.lockstep and self._now > self._end  # another run than the recorded one: nothing more will come
        if comparison is None or lost or comparison.is_complete(min(self._end, comparison.last or self._end)):
            return True
        return time.monotonic() - self._ended_s > LAST_DIGESTS_S[self._config.lockstep]

    # Comparing

    def _on_digests(self, msg: TickDigest) -> None:
        assert self._comparison is not None
        stamp_ns = conversions.time_from_msg(msg.header.stamp)
        self._comparison.add((msg.epoch, msg.step), TickDigests(stamp_ns, tuple(msg.topics), msg.digests))

    def _on_run_info(self, msg: RunInfo) -> None:
        """Notes what of the machine and its software is not as it was."""
        now = {**mapping_in(msg.platform), "gibson_sim": msg.version}
        before = self._run.surroundings.get(msg.kind, {})
        keys = [key for key in {**before, **now} if key not in _LEFT_OUT]
        pairs = {key: [str(before.get(key)), str(now.get(key))] for key in keys}
        pairs["opengl"] = [" ".join(str(x.get("opengl", {}).get(key, "")) for key in _DRIVER) for x in (before, now)]
        other = {key: pair for key, pair in pairs.items() if pair[0] != pair[1]}
        if before and other:
            self._other_surroundings[msg.kind] = other

    def summary(self) -> dict[str, Any]:
        """Returns what was given, and what came of it."""
        comparison = self._comparison
        return {
            "bag": self._config.bag,
            "journal": self._run.journal is not None,
            "lockstep": self._config.lockstep,
            "inputs": self._given,
            "reached": list(self._now),
            "end": list(self._end),
            "finished": self._ended_s is not None,
            "other_surroundings": self._other_surroundings,
            "verification": None if comparison is None else comparison.result().to_json(),
        }

    def close(self) -> None:
        """Writes the summary."""
        write_summary(self._config.summary_path, self.summary())


class _Inputs:
    """Gives inputs to be obeyed at exactly their steps."""

    def __init__(self, node: Node, inputs: Sequence[RecordedInput], ahead: int) -> None:
        """``ahead``: steps by which inputs are given before their own."""
        self._node, self._schedule, self._ahead = node, InputSchedule(inputs), ahead
        self._publisher = node.create_publisher(Input, names.INPUTS_AT, qos.INPUTS)

    def has_subscribers(self) -> bool:
        """Returns whether the simulation listens."""
        return _is_matched(self._node, self._publisher) and self._simulation() in _readers(self._node, self._publisher)

    def _simulation(self) -> str:
        """Returns the name of the node that moves the scene; empty = it is not there."""
        found = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(names.SCENE_STATE))
        return next((f"{info.node_namespace}/{info.node_name}" for info in found), "")

    def give(self, tick: Tick, stamp_ns: int) -> Sequence[str]:
        """Sends what is due at a tick; returns the topics of what it sent, once for each message."""
        inputs = self._schedule.take(*tick, self._ahead)
        for number, item in enumerate(inputs, 1):
            message = Input(epoch=item.epoch, step=item.step, name=item.name, type=item.type_name)
            message.data = item.data
            self._publisher.publish(message)
            if number % _MOST_AT_ONCE == 0:
                self.wait_for_arrival()
        return (self._publisher.topic_name,) * len(inputs)

    def wait_for_arrival(self) -> None:
        """Waits until all that was sent has arrived."""
        self._publisher.wait_for_all_acked(Duration(seconds=_ARRIVAL_S))


class _Commands:
    """Publishes commands on their own topics when simulation time reaches theirs."""

    def __init__(self, node: Node, commands: Sequence[RecordedCommand]) -> None:
        """Takes commands in the order of time."""
        self._node, self._commands, self._next = node, commands, 0
        self._publishers: dict[str, Publisher] = {}
        for item in commands:
            if item.name not in self._publishers:
                self._publishers[item.name] = node.create_publisher(message_class(item.type_name), item.name, qos.COMMAND)

    def has_subscribers(self) -> bool:
        """Returns whether somebody listens to every topic."""
        return all(_is_matched(self._node, publisher) for publisher in self._publishers.values())

    def give(self, tick: Tick, stamp_ns: int) -> Sequence[str]:
        """Sends what is due at a stamp; returns the topics of what it sent, once for each message."""
        first = self._next
        while self._next < len(self._commands) and self._commands[self._next].time_ns <= stamp_ns:
            item = self._commands[self._next]
            self._publishers[item.name].publish(item.data)
            self._next += 1
        return tuple(item.name for item in self._commands[first : self._next])

    def wait_for_arrival(self) -> None:
        """Does not wait: a command that is late is obeyed a little later."""


def _readers(node: Node, publisher: Publisher) -> list[str]:
    """Returns the full names of the nodes that listen to a publisher; one that records is among them."""
    found = node.get_subscriptions_info_by_topic(publisher.topic_name)
    return [f"{info.node_namespace}/{info.node_name}" for info in found]


def _is_matched(node: Node, publisher: Publisher) -> bool:
    """Returns whether somebody reads a topic, and all such that are known get what is published from now on."""
    return publisher.get_subscription_count() > 0 and reaches_all(node, publisher)


def _look_away(data: bytes) -> None:
    """Takes an image that is only wanted drawn."""


def main(args: list[str] | None = None) -> None:
    """Runs the replay node."""
    run_node(ReplayNode, args)


if __name__ == "__main__":
    main()
