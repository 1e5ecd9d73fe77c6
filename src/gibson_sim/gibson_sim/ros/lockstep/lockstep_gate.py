"""The simulation's side of lockstep: participants join and report ticks as done on ``tick_done``; late ones are named, then skipped or fatal."""

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
from gibson_sim.config import PhysicsConfig
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
"""Wall time after which a waiting tick is logged as late, and then again, ns."""
JOIN_TIMEOUT_S = 120.0
"""Least wall time that declared participants have to join, and those known by a rule to be discovered, s."""
IDLE_NS = 5 * NS_PER_S
"""Wall time of silence after which a participant whose rule has a ``from`` counts as idle, ns."""
_DISCOVERY_TIMEOUT_NS = 3 * NS_PER_S
"""Wall time after which a new participant counts as matched, ns."""
_REPUBLISH_PERIOD_NS = NS_PER_S // 2
"""Wall time between two copies of the present tick for a participant that rejoined, ns."""
_SETTLED_NS = NS_PER_S // 2
"""Wall time for which a participant known by a rule must be matched before time starts, ns: then its own messages arrive, too."""
_FIRST_ANSWER_TIMEOUT_NS = 5 * NS_PER_S
"""Wall time without the very first answer of a participant after which the whole tick is published again, ns: it may have been lost."""
_CACHE_SIZE = 256
"""Messages in the cache of ``_read``."""


class LockstepGate:
    """Holds time until every participant has done the present tick.

    Subscribes:
        tick_done (gibson_msgs/TickDone): participants join, report ticks as done, and leave.
        The topics that rules name, of any type, but for those of commands, which the node receives.
    """

    def __init__(
        self,
        node: Node,
        config: PhysicsConfig,
        on_open: Callable[[], None],
        publish_again: Callable[[bool], None],
        is_command: Callable[[str], bool] = lambda topic: False,
    ) -> None:
        """Receives nothing before ``subscribe``.

        Args:
            node: the physics node.
            config: its settings.
            on_open: is called when a tick is done.
            publish_again: publishes the state of the present tick once more, for a participant that rejoined; with True
                all of the tick, for one that knows nothing of lockstep.
            is_command: whether a topic, by its full name, is one of commands: the node then calls ``receive_command``.

        Raises:
            ConfigError: setting ``participants`` is not of the form that the message shows.
        """
        self.core = Lockstep([rule.resolved(partial(_short_name, node)) for rule in parse_participants(config.participants)])
        self._answers = AnswerSubscriptions(node, self.core.received_topics, self._receive, is_command)
        self._node, self._config, self._on_open, self._publish_again = node, config, on_open, publish_again
        self._in_namespace = node.get_namespace() != "/"
        self._started_ns = time.monotonic_ns()
        self._reported_ns = self._republished_ns = 0
        self._rejoined: set[str] = set()
        self._unmatched: dict[str, int] = {}
        """Participants that joined and may not be matched yet -> when they joined."""
        self._watchers: set[str] = set()
        self._unmatched_rules = {p.name: 0 for p in self.core.participants}
        """Participants known by a rule that may not be matched yet -> since when they seem to be; 0 = they are not."""
        self.timeouts = 0
        self.failure: LockstepError | None = None
        """Why the run has to end."""
        self._stamped: StampedCommands | None = None
        self._second_subscription: Any = None
        """To ``tick_done``, in the context of commands of a second type; None once time has started."""
        self._joined_there: set[str] = set()
        """Participants whose JOIN has arrived in that context."""
        self._cache: dict[bytes, Any] = {}
        """Messages by all their bytes but for the stamp: those of a participant differ in nothing else, tick after tick."""

    def subscribe(self, stamped: StampedCommands | None) -> None:
        """Lets participants join. The node must have subscribed to all commands before, under a second type in ``stamped``.

        A context announces its subscriptions in the order in which they were made. A participant whose JOIN arrives has therefore discovered all
        the others, and none of the commands that it sends from then on is lost. For commands of a second type this holds once its JOIN has
        arrived in their context, too.
        """
        self._stamped = stamped
        if stamped is not None:
            self._second_subscription = stamped.create_subscription(
                TickDone, names.TICK_DONE, qos.TICK_DONE, lambda msg: self._joined_there.add(msg.participant)
            )
        self._node.create_subscription(TickDone, names.TICK_DONE, self._on_tick_done, qos.TICK_DONE, raw=True)

    def begin_tick(self, stamp_ns: int, topics: Callable[[], Collection[str]]) -> None:
        """Closes the gate for a tick that was published; ``topics`` returns what was published at it, and is called only if that matters."""
        core, found = self.core, set[str]()
        if core.topics:
            found.update(topics())
            if self._in_namespace:
                found.update([_short_name(self._node, topic) for topic in found])
        core.begin_tick(stamp_ns, found, time.monotonic_ns())

    def receive_command(self, topic: str) -> None:
        """Handles the arrival of a command; opens the gate if the tick waited for nothing else."""
        self._receive(topic.lstrip("/"))

    def note_command(self, topic: str) -> None:
        """Handles the arrival of a command, as ``receive_command`` does, but for a caller that looks itself whether the gate is open now."""
        self._note(topic.lstrip("/"))

    def _receive(self, topic: str) -> None:
        """Handles the arrival of a message that may be an answer, given the topic without its leading slash."""
        was_open = self.core.is_open
        self._note(topic)
        if self.core.is_open and not was_open:
            self._on_open()

    def _note(self, topic: str) -> None:
        for name in self.core.receive(topic, time.monotonic_ns()):
            self.timeouts += 1
            self._node.get_logger().warning(
                f"lockstep: {quoted(name)} sends again on {topic}: it was slow, or waited for time to pass, and had not ended; "
                "the run cannot be repeated to the bit"
            )

    def reset(self) -> None:
        """Forgets the present tick: the simulation was reset."""
        self.core.reset()

    def discover(self) -> None:
        """Looks for the participants known by a rule, which settle while the node waits for something else before time starts."""
        now_ns = time.monotonic_ns()
        self._answers.find(now_ns)
        self._look_at_rules(now_ns)

    def may_step(self) -> bool:
        """Returns whether the next tick may begin; logs which participants are late, and sets ``failure`` when one has timed out."""
        core, now_ns = self.core, time.monotonic_ns()
        timeout_s, opened_ns = max(JOIN_TIMEOUT_S, self._config.participant_timeout), self._started_ns
        self._answers.find(now_ns, again=core.any_idle)
        if not core.missing:
            if not core.is_open:
                timeout_s, opened_ns = self._config.participant_timeout, now_ns - core.waited_ns(now_ns)
                self._republish_tick(now_ns)
                self._let_rest(now_ns)
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
            if self._remove_gone_watchers(now_ns):
                return core.is_open
            if not core.missing or any(_loading(name) is None for name in core.missing):  # what loads tells so itself
                self._node.get_logger().warning(
                    f"lockstep: waiting for {self._describe_late()}; {waited_ns / NS_PER_S:.1f} s so far"
                )
        return False

    def summary(self) -> dict[str, Any]:
        """Returns how long the ticks waited for each participant."""
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
            (self._watchers.add if msg.event == TickDone.WATCH else self._watchers.discard)(name)
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
        """Returns a TickDone and its stamp, in a tenth of the time that rclpy takes. The stamp in the TickDone itself may be another tick's."""
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
        """Publishes the present tick again for a participant that rejoined, and for one whose first answer does not come."""
        silent = [p for p in self.core.participants if p.answer and p.pending and not p.ticks and not p.missed]
        lost = bool(silent) and self.core.waited_ns(now_ns) > _FIRST_ANSWER_TIMEOUT_NS
        elapsed_ns = now_ns - self._republished_ns
        if (lost and elapsed_ns > _FIRST_ANSWER_TIMEOUT_NS) or (self._rejoined and elapsed_ns > _REPUBLISH_PERIOD_NS):
            self._republished_ns = now_ns
            self._publish_again(lost)

    # Late participants

    def _time_out(self, waited_ns: int, now_ns: int) -> bool:
        what = f"lockstep: timed out after {waited_ns / NS_PER_S:.1f} s, waiting for {self._describe_late()}"
        if self.core.missing or self._config.on_timeout == "stop":
            self.failure = LockstepError(
                f"{what}: the run ends. Fix it, raise 'participant_timeout', or set 'on_timeout' to go_on to continue without its answer"
            )
            return False
        self.core.skip_late(now_ns)
        self._unmatched_rules = {}
        self.timeouts += 1
        self._node.get_logger().warning(f"{what}: this tick goes on without it; the run cannot be repeated to the bit")
        return True

    def _let_rest(self, now_ns: int) -> None:
        """Stops waiting for participants that are silent and may be idle."""
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

    def _remove_gone_watchers(self, now_ns: int) -> list[str]:
        """Removes pending participants that only watched and whose nodes have gone; returns their names."""
        there = self._participating_nodes()
        gone = [name for name in self.core.waits_for if name in self._watchers and name not in there]
        for name in gone:
            self._node.get_logger().warning(f"lockstep: {quoted(name)} has gone without leaving; time goes on without it")
            self.core.leave(name, now_ns)
        return gone

    def _participating_nodes(self) -> set[str]:
        """Returns the names of the nodes that publish ``tick_done``."""
        return {_full_name(p) for p in self._node.get_publishers_info_by_topic(names.TICK_DONE)}

    def _describe_late(self) -> str:
        """Returns which participants are late, with what, and what is known of their nodes."""
        core = self.core
        if core.missing:
            return ", ".join(f"{quoted(name)} to join ({self._known_of(name)})" for name in core.missing)
        what = "to be discovered" if core.stamp_ns is None else f"to finish the tick at {core.stamp_ns / NS_PER_S:.3f} s"
        there, answers = self._participating_nodes(), {p.name: p.answer for p in core.participants}
        parts = []
        for name in core.waits_for or self._unmatched_rules:
            if answer := answers.get(name):
                known_of_it = self._answers.problem(answer) or f"no message on {answer}"
            else:
                known_of_it = "the node hangs or is slow" if name in there else self._known_of(name)
            parts.append(f"{quoted(name)} {what} ({known_of_it})")
        return ", ".join(parts)

    def _known_of(self, name: str) -> str:
        """Returns what is known of a participant that does not take part: what it loads, if the same job started it, or whether its node exists."""
        if (loading := _loading(name)) is not None:
            return f"it is loading: {loading}"
        nodes = {f"{namespace.strip('/')}/{node}".lstrip("/") for node, namespace in self._node.get_node_names_and_namespaces()}
        return "the node has started, it may be loading" if name in nodes else "no node of this name has been seen yet"

    # Discovery

    def _all_matched(self, now_ns: int) -> bool:
        """Returns whether all participants get what is published from now on."""
        if not self._unmatched and not self._unmatched_rules:
            self._end_second_subscription()
            return True
        self._unmatched = {
            name: since
            for name, since in self._unmatched.items()
            if now_ns - since < _DISCOVERY_TIMEOUT_NS and not self._is_matched_both_ways(name)
        }
        self._look_at_rules(now_ns)
        return not self._unmatched and not self._unmatched_rules

    def _look_at_rules(self, now_ns: int) -> None:
        """Finds out since when the participants known by a rule are matched; costs nothing once they are settled."""
        rules = {p.name: p for p in self.core.participants}
        matched = {n: since or now_ns if self._rule_is_matched(rules[n]) else 0 for n, since in self._unmatched_rules.items()}
        self._unmatched_rules = {n: since for n, since in matched.items() if not since or now_ns - since < _SETTLED_NS}

    def _is_matched_both_ways(self, name: str) -> bool:
        """Returns whether a participant's messages arrive here, and ours there."""
        return (self._second_subscription is None or name in self._joined_there) and self._is_matched(name)

    def _end_second_subscription(self) -> None:
        if self._second_subscription is not None and self._stamped is not None:
            self._stamped.unsubscribe(self._second_subscription)
            self._second_subscription = None

    def _is_matched(self, name: str) -> bool:
        """Returns whether all that a participant subscribes to reaches it. Its JOIN may arrive before its subscriptions are known."""
        after = next((p.after for p in self.core.participants if p.name == name), "")
        topic = names.SCENE_STATE if after == CAMERAS else after
        return any(
            _full_name(p) == name and self._node_is_matched(p, topic)
            for p in self._node.get_publishers_info_by_topic(names.TICK_DONE)
        )

    def _rule_is_matched(self, rule: Participant) -> bool:
        """Returns whether the topic of a rule has publishers, all that their nodes subscribe to reaches them, and their messages arrive here."""
        found = [p for p in self._node.get_publishers_info_by_topic(f"/{rule.answer}") if p.node_name]
        received = [topic for topic in (rule.answer, rule.activation) if topic]
        return bool(found) and all(map(self._node_is_matched, found)) and all(map(self._answers.is_matched, received))

    def _node_is_matched(self, endpoint: Any, topic: str = "") -> bool:
        """Returns whether all that the node of an endpoint subscribes to reaches it, a certain topic among it.

        It does not while the node's name or its subscription to that topic is unknown: publishers and subscriptions are discovered
        independently of each other.
        """
        node = self._node
        if not endpoint.node_namespace.startswith("/"):
            return False
        try:
            found = node.get_subscriber_names_and_types_by_node(endpoint.node_name, endpoint.node_namespace)
        except NodeNameNonExistentError:
            return False
        topics = {name for name, _ in found}
        if topic and node.resolve_topic_name(topic) not in topics:
            return False
        ours = [publisher for publisher in node.publishers if publisher.topic_name in topics]
        return all(is_fully_matched(node, publisher) for publisher in ours)


def _short_name(node: Node, topic: str) -> str:
    """Returns the full name of a topic, without its leading slash."""
    return str(node.resolve_topic_name(topic)).lstrip("/")


def _full_name(info: Any) -> str:
    """Returns the participant name of an endpoint's node."""
    return f"{info.node_namespace.strip('/')}/{info.node_name}".lstrip("/")


def _ticks(after: str) -> str:
    """Returns which ticks a participant waits for, in words."""
    return "ticks with camera images" if after == CAMERAS else f"ticks with {after}" if after else "every tick"


def _loading(name: str) -> str | None:
    """Returns what a participant that the same job started loads; None = nothing, or another job started it."""
    note = note_of_job(STATUS.format(name.rpartition("/")[2]))
    return None if note is None else json.loads(note).get("loading")
