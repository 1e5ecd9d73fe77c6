"""The simulation's side of lockstep: participants join and report finished ticks on ``tick_done``; late ones are logged, then skipped or fatal."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Collection
from functools import partial
from typing import Any

from rclpy.node import Node, NodeNameNonExistentError
from rclpy.serialization import deserialize_message

from gibson_msgs.msg import TickDone
from gibson_sim.bags.stamps import stamp_ns
from gibson_sim.config import SyncSettings
from gibson_sim.errors import LockstepError
from gibson_sim.processes.job_folder import STATUS, note_of_job
from gibson_sim.quoting import quoted
from gibson_sim.ros import conversions
from gibson_sim.ros.lockstep.answer_subscriptions import AnswerSubscriptions
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.discovery import is_fully_matched
from gibson_sim.ros.topics.stamped_commands import StampedCommands
from gibson_sim.standard.lockstep import CAMERAS, Lockstep, Participant, parse_participants
from gibson_sim.types import NS_PER_S

LATE_NS = 2 * NS_PER_S
"""Time after which a waiting tick is logged as late, and period of that log line, ns of wall time."""
JOIN_TIMEOUT_S = 120.0
"""Minimum timeout for participants to join, or to be discovered if a rule declares their output, s of wall time."""
IDLE_NS = 5 * NS_PER_S
"""Time without an answer after which a participant whose rule has a ``from`` counts as idle, ns of wall time."""
_DISCOVERY_TIMEOUT_NS = 3 * NS_PER_S
"""Time after which a new participant counts as matched, ns of wall time."""
_REPUBLISH_PERIOD_NS = NS_PER_S // 2
"""Period at which the present tick is republished for a participant that rejoined, ns of wall time."""
_SETTLED_NS = NS_PER_S // 2
"""Time for which a participant with a rule must be matched before time starts, ns of wall time: then matching is complete in both directions."""
_FIRST_ANSWER_TIMEOUT_NS = 5 * NS_PER_S
"""Time without the very first answer of a participant after which the whole tick is republished, ns of wall time: it may have been lost."""
_CACHE_SIZE = 256
"""Maximum number of messages in the cache of ``_read``."""


class LockstepGate:
    """Holds time until every participant has finished the present tick.

    Subscribes:
        tick_done (gibson_msgs/TickDone): participants join, report finished ticks, and leave.
        The topics in rules, of any type, except command topics, to which the node itself subscribes.
    """

    def __init__(
        self,
        node: Node,
        settings: SyncSettings,
        on_open: Callable[[], None],
        publish_again: Callable[[bool], None],
        is_command: Callable[[str], bool] = lambda topic: False,
    ) -> None:
        """Creates the gate, which receives nothing before ``subscribe``.

        Args:
            node: the physics node.
            settings: settings of the node.
            on_open: called when a tick is done.
            publish_again: called with False to republish the state of the present tick, for a participant that rejoined, or with True to
                republish the whole tick, for one without lockstep support.
            is_command: returns whether a topic, given its full name, is a command topic: the node then calls ``receive_command``.

        Raises:
            ConfigError: setting ``participants`` does not match the syntax.
        """
        self.core = Lockstep([rule.resolved(partial(_short_name, node)) for rule in parse_participants(settings.participants)])
        self._answers = AnswerSubscriptions(node, self.core.received_topics, self._receive, is_command)
        self._node, self._settings, self._on_open, self._publish_again = node, settings, on_open, publish_again
        self._in_namespace = node.get_namespace() != "/"
        self._started_ns = time.monotonic_ns()
        self._reported_ns = self._republished_ns = 0
        self._rejoined: set[str] = set()
        self._unmatched: dict[str, int] = {}
        """Participant that joined and may not be matched yet -> monotonic time at which it joined, ns."""
        self._passive: set[str] = set()
        """Participants that only observe."""
        self._unmatched_rules = {p.name: 0 for p in self.core.participants}
        """Participant with a rule that may not be matched yet -> monotonic time since which it seems to be, ns; 0 = it does not."""
        self.timeouts = 0
        """Number of ticks that ended without an answer, and of idle participants that turned out to be slow."""
        self.failure: LockstepError | None = None
        """The error that ends the run; None = there is none."""
        self._stamped: StampedCommands | None = None
        self._second_subscription: Any = None
        """Subscription to ``tick_done`` in the context of commands of a second type; None once time has started."""
        self._joined_second: set[str] = set()
        """Participants whose JOIN has arrived in that context."""
        self._cache: dict[bytes, Any] = {}
        """Serialized message without its stamp -> message: the messages of a participant usually differ only in the stamp."""

    def subscribe(self, stamped: StampedCommands | None) -> None:
        """Subscribes to ``tick_done``. The node must already subscribe to all commands; ``stamped`` subscribes to those of a second type.

        A context announces its subscriptions in the order of their creation. A participant whose JOIN arrives has therefore discovered all
        others, and none of its later commands is lost. For commands of a second type this holds once its JOIN has arrived in the context
        of ``stamped``, too.
        """
        self._stamped = stamped
        if stamped is not None:
            self._second_subscription = stamped.subscribe(
                TickDone, names.TICK_DONE, lambda msg: self._joined_second.add(msg.participant), qos.TICK_DONE
            )
        self._node.create_subscription(TickDone, names.TICK_DONE, self._on_tick_done, qos.TICK_DONE, raw=True)

    def begin_tick(self, stamp_ns: int, topics: Callable[[], Collection[str]]) -> None:
        """Closes the gate for a published tick; ``topics`` returns the topics published at it, and is called only if a participant needs them."""
        core, published = self.core, set[str]()
        if core.topics:
            published.update(topics())
            if self._in_namespace:
                published.update([_short_name(self._node, topic) for topic in published])
        core.begin_tick(stamp_ns, published, time.monotonic_ns())

    def receive_command(self, topic: str) -> None:
        """Handles the arrival of a command, and calls ``on_open`` if the tick waited only for it."""
        self._receive(topic.lstrip("/"))

    def _receive(self, topic: str) -> None:
        """Handles the arrival of a possible answer, given the topic without its leading slash."""
        was_open = self.core.is_open
        for name in self.core.receive(topic, time.monotonic_ns()):
            self.timeouts += 1
            self._node.get_logger().warning(
                f"lockstep: {quoted(name)} sends again on {topic}: it was slow, or waited for time to pass, not idle; "
                "the run is not repeatable"
            )
        if self.core.is_open and not was_open:
            self._on_open()

    def reset(self) -> None:
        """Discards the present tick: the simulation was reset."""
        self.core.reset()

    def discover(self) -> None:
        """Continues the discovery of participants with a rule; called while the node waits for other peers before time starts."""
        now_ns = time.monotonic_ns()
        self._answers.find(now_ns)
        self._update_unmatched_rules(now_ns)

    def may_step(self) -> bool:
        """Returns whether the next tick may begin; logs late participants, and sets ``failure`` when one has timed out."""
        core, now_ns = self.core, time.monotonic_ns()
        timeout_s, opened_ns = max(JOIN_TIMEOUT_S, self._settings.participant_timeout), self._started_ns
        self._answers.find(now_ns, again=core.any_idle)
        if not core.missing:
            if not core.is_open:
                timeout_s, opened_ns = self._settings.participant_timeout, now_ns - core.waited_ns(now_ns)
                self._republish_tick(now_ns)
                self._idle_silent(now_ns)
                self._lose_first_commands(now_ns)
            if core.is_open:
                if self._all_matched(now_ns):
                    return True
                if not self._unmatched_rules:
                    return False
        waited_ns = now_ns - opened_ns
        if waited_ns > timeout_s * NS_PER_S:
            return self._time_out(waited_ns, now_ns)
        if waited_ns > LATE_NS and now_ns - self._reported_ns > LATE_NS:
            self._reported_ns = now_ns
            self._answers.find(now_ns, again=True)
            if self._remove_gone_passive(now_ns):
                return core.is_open
            if not core.missing or any(_loading(name) is None for name in core.missing):  # a loading participant logs that itself
                self._node.get_logger().warning(
                    f"lockstep: waiting for {self._describe_late()}; {waited_ns / NS_PER_S:.1f} s so far"
                )
        return False

    def summary(self) -> dict[str, Any]:
        """Returns the wall times that ticks waited for each participant, for the summary of the run."""
        return {
            "timeouts": self.timeouts,
            "participants": {
                p.name: {
                    "ticks": p.ticks,
                    "mean_ms": p.waited_ns / max(1, p.ticks) / 1e6,
                    "longest_ms": p.longest_ns / 1e6,
                    "missed": p.missed,
                }
                for p in self.core.participants
            },
        }

    # Reports of participants

    def _on_tick_done(self, data: bytes) -> None:
        now_ns, core, was_open = time.monotonic_ns(), self.core, self.core.is_open
        msg, stamp_ns = self._read(data)
        name = msg.participant
        if msg.event in (TickDone.JOIN, TickDone.WATCH):
            self._node.get_logger().info(f"lockstep: {quoted(name)} joined; time waits for it at {_ticks(msg.after)}")
            self._unmatched[name] = now_ns
            (self._passive.add if msg.event == TickDone.WATCH else self._passive.discard)(name)
            if core.join(name, msg.after.lstrip("/")):
                self._rejoined.add(name)
        elif msg.event == TickDone.LEAVE:
            self._node.get_logger().info(f"lockstep: {quoted(name)} left")
            core.leave(name, now_ns)
        elif any(p.name == name for p in core.participants):
            sent = [topic.lstrip("/") for topic in msg.sent]
            if core.tick_done(name, stamp_ns, sent, now_ns):
                self._rejoined.discard(name)
        else:
            self._node.get_logger().warning(
                f"lockstep: {quoted(name)} reports a tick as done, but has not joined, so time does not wait for it; send JOIN first",
                throttle_duration_sec=5.0,
            )
        if core.is_open and not was_open:
            self._on_open()

    def _read(self, data: bytes) -> tuple[Any, int]:
        """Returns a TickDone and its stamp, ns, in a tenth of rclpy's time. The TickDone is cached: its own stamp may be another tick's."""
        if data[1] != 1:  # not little-endian
            msg = deserialize_message(data, TickDone)
            return msg, conversions.time_from_msg(msg.stamp)
        length = int.from_bytes(data[8:12], "little")
        start = 12 + -(-length // 4) * 4
        key = data[:start] + data[start + 8 :]
        msg = self._cache.get(key)
        if msg is None:
            if len(self._cache) >= _CACHE_SIZE:
                self._cache.clear()
            msg = self._cache[key] = deserialize_message(data, TickDone)
        return msg, stamp_ns(data, start)

    def _republish_tick(self, now_ns: int) -> None:
        """Republishes the present tick for a participant that rejoined, or whose first answer is missing."""
        silent = [p for p in self.core.participants if p.answer and p.pending and not p.ticks and not p.missed]
        lost = bool(silent) and self.core.waited_ns(now_ns) > _FIRST_ANSWER_TIMEOUT_NS
        elapsed_ns = now_ns - self._republished_ns
        if (lost and elapsed_ns > _FIRST_ANSWER_TIMEOUT_NS) or (self._rejoined and elapsed_ns > _REPUBLISH_PERIOD_NS):
            self._republished_ns = now_ns
            self._publish_again(lost)

    # Late participants

    def _time_out(self, waited_ns: int, now_ns: int) -> bool:
        problem = f"lockstep: timed out after {waited_ns / NS_PER_S:.1f} s, waiting for {self._describe_late()}"
        if self.core.missing or self._settings.on_timeout == "stop":
            self.failure = LockstepError(
                f"{problem}: the run ends. Fix it, raise 'participant_timeout', or set 'on_timeout' to go_on to continue without its answer"
            )
            return False
        self.core.skip_late(now_ns)
        self._unmatched_rules = {}
        self.timeouts += 1
        self._node.get_logger().warning(f"{problem}: this tick goes on without it; the run is not repeatable")
        return True

    def _idle_silent(self, now_ns: int) -> None:
        """Stops waiting for silent participants that may be idle."""
        stamp_ns = self.core.stamp_ns or 0
        for name in self.core.idle_silent(now_ns, IDLE_NS):
            rule = next(p for p in self.core.participants if p.name == name)
            topics = rule.answer if rule.answer == rule.activation else f"{rule.answer} or {rule.activation}"
            self._node.get_logger().info(
                f"lockstep: {quoted(name)} has sent nothing on {rule.answer} in answer to {stamp_ns / NS_PER_S:.3f} s; time goes on without it "
                f"until there is a message on {topics}"
            )

    def _lose_first_commands(self, now_ns: int) -> None:
        for name, topic in self.core.lose_first_commands(now_ns, _FIRST_ANSWER_TIMEOUT_NS):
            self._node.get_logger().warning(
                f"lockstep: the first command on {topic} that {quoted(name)} reports has not arrived within "
                f"{_FIRST_ANSWER_TIMEOUT_NS / NS_PER_S:g} s: its publisher was not discovered yet; time goes on without it"
            )

    def _remove_gone_passive(self, now_ns: int) -> list[str]:
        """Removes pending passive participants whose nodes are gone; returns their names."""
        present = self._participating_nodes()
        gone = [name for name in self.core.waits_for if name in self._passive and name not in present]
        for name in gone:
            self._node.get_logger().warning(f"lockstep: {quoted(name)} has gone without leaving; time goes on without it")
            self.core.leave(name, now_ns)
        return gone

    def _participating_nodes(self) -> set[str]:
        """Returns the names of the nodes that publish ``tick_done``."""
        return {
            names.participant(p.node_namespace, p.node_name) for p in self._node.get_publishers_info_by_topic(names.TICK_DONE)
        }

    def _describe_late(self) -> str:
        """Returns a description of the late participants: what each must do, and the state of its node."""
        core = self.core
        if core.missing:
            return ", ".join(f"{quoted(name)} to join ({self._describe_absent(name)})" for name in core.missing)
        overdue = "to be discovered" if core.stamp_ns is None else f"to finish the tick at {core.stamp_ns / NS_PER_S:.3f} s"
        present, answers = self._participating_nodes(), {p.name: p.answer for p in core.participants}
        parts = []
        for name in core.waits_for or self._unmatched_rules:
            if answer := answers.get(name):
                cause = self._answers.problem(answer) or f"no message on {answer}"
            else:
                cause = "the node hangs or is slow" if name in present else self._describe_absent(name)
            parts.append(f"{quoted(name)} {overdue} ({cause})")
        return ", ".join(parts)

    def _describe_absent(self, name: str) -> str:
        """Returns the state of a node that has not joined: what it is loading, if the same job started it, or whether it exists."""
        if (loading := _loading(name)) is not None:
            return f"it is loading: {loading}"
        nodes = {names.participant(namespace, node) for node, namespace in self._node.get_node_names_and_namespaces()}
        return "the node has started, it may be loading" if name in nodes else "no node of this name has been seen yet"

    # Discovery

    def _all_matched(self, now_ns: int) -> bool:
        """Returns whether all participants receive the messages that are published from now on."""
        if not self._unmatched and not self._unmatched_rules:
            self._destroy_second_subscription()
            return True
        self._unmatched = {
            name: since
            for name, since in self._unmatched.items()
            if now_ns - since < _DISCOVERY_TIMEOUT_NS and not self._is_matched_both_ways(name)
        }
        self._update_unmatched_rules(now_ns)
        return not self._unmatched and not self._unmatched_rules

    def _update_unmatched_rules(self, now_ns: int) -> None:
        """Removes participants with a rule that have been matched for ``_SETTLED_NS``; costs nothing once none is left."""
        rules = {p.name: p for p in self.core.participants}
        matched = {n: since or now_ns if self._rule_is_matched(rules[n]) else 0 for n, since in self._unmatched_rules.items()}
        self._unmatched_rules = {n: since for n, since in matched.items() if not since or now_ns - since < _SETTLED_NS}

    def _is_matched_both_ways(self, name: str) -> bool:
        """Returns whether messages arrive in both directions between a participant and the simulation."""
        return (self._second_subscription is None or name in self._joined_second) and self._is_matched(name)

    def _destroy_second_subscription(self) -> None:
        if self._second_subscription is not None and self._stamped is not None:
            self._stamped.unsubscribe(self._second_subscription)
            self._second_subscription = None

    def _is_matched(self, name: str) -> bool:
        """Returns whether all subscriptions of a participant are matched. Its JOIN may arrive before its subscriptions are discovered."""
        after = next((p.after for p in self.core.participants if p.name == name), "")
        topic = names.SCENE_STATE if after == CAMERAS else after
        return any(
            names.participant(p.node_namespace, p.node_name) == name and self._node_is_matched(p, topic)
            for p in self._node.get_publishers_info_by_topic(names.TICK_DONE)
        )

    def _rule_is_matched(self, rule: Participant) -> bool:
        """Returns whether the answer topic of a rule has publishers, the subscriptions of their nodes are matched, and so are ours to them."""
        publishers = [p for p in self._node.get_publishers_info_by_topic(f"/{rule.answer}") if p.node_name]
        topics = [topic for topic in (rule.answer, rule.activation) if topic]
        return bool(publishers) and all(map(self._node_is_matched, publishers)) and all(map(self._answers.is_matched, topics))

    def _node_is_matched(self, endpoint: Any, topic: str = "") -> bool:
        """Returns whether all subscriptions of an endpoint's node to our topics are matched, including one to ``topic`` if it is not empty.

        False while the node's name or its subscription to ``topic`` is not discovered: publishers and subscriptions are discovered
        independently.
        """
        node = self._node
        if not endpoint.node_namespace.startswith("/"):
            return False
        try:
            subscriptions = node.get_subscriber_names_and_types_by_node(endpoint.node_name, endpoint.node_namespace)
        except NodeNameNonExistentError:
            return False
        topics = {name for name, _ in subscriptions}
        if topic and node.resolve_topic_name(topic) not in topics:
            return False
        publishers = [publisher for publisher in node.publishers if publisher.topic_name in topics]
        return all(is_fully_matched(node, publisher) for publisher in publishers)


def _short_name(node: Node, topic: str) -> str:
    """Returns the full name of a topic, without its leading slash."""
    return str(node.resolve_topic_name(topic)).lstrip("/")


def _ticks(after: str) -> str:
    """Returns a description of the ticks at which time waits for a participant."""
    return "ticks with camera images" if after == CAMERAS else f"ticks with {after}" if after else "every tick"


def _loading(name: str) -> str | None:
    """Returns a description of what a participant started by the same job is loading; None = nothing, or started by another job."""
    note = note_of_job(STATUS.format(name.rpartition("/")[2]))
    return None if note is None else json.loads(note).get("loading")
