"""Lockstep on topics: who takes part, who is late, and what then."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Any

from rclpy.node import Node, NodeNameNonExistentError
from rclpy.serialization import deserialize_message

from gibson_msgs.msg import TickDone
from gibson_sim.bags.stamps import stamp_ns
from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import LockstepError
from gibson_sim.quoting import quoted
from gibson_sim.ros import conversions
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.matching import reaches_all
from gibson_sim.ros.topics.stamped_commands import StampedCommands
from gibson_sim.standard.lockstep import CAMERAS, Lockstep, parse_participants
from gibson_sim.types import NS_PER_S

LATE_NS = 2 * NS_PER_S
"""A tick that waits for so long is worth a warning."""
JOIN_LIMIT_S = 120.0
"""So long time waits for participants that were announced."""
_MATCHING_NS = 3 * NS_PER_S
"""After so long a new participant is believed to hear us."""
_AGAIN_NS = NS_PER_S // 2
"""How often a participant that came back is given the present tick, until it has done it."""
_SETTLED_NS = NS_PER_S // 2
"""For so long somebody who knows nothing of lockstep must have heard us before time begins: then we hear it, too."""
_MOST_KNOWN = 256
_FIRST_ANSWER_NS = 5 * NS_PER_S
"""After so long without its very first answer, what it listens to is published once more: it may have been lost."""


class LockstepGate:
    """Holds time until every participant has done the present tick.

    Subscribes:
        tick_done (gibson_msgs/TickDone): who takes part, and has done what.
    """

    def __init__(
        self, node: Node, config: PhysicsConfig, go_on: Callable[[], None], publish_again: Callable[[bool], None]
    ) -> None:
        """Hears nobody before ``listen``.

        Args:
            node: the physics node.
            config: its settings.
            go_on: is called when a tick is done.
            publish_again: publishes the state of the present tick once more, for a participant that came back; with True
                all of the tick, for one that knows nothing of lockstep.

        Raises:
            ConfigError: setting ``participants`` is not of the form that the message shows.
        """
        self.core = Lockstep(parse_participants(config.participants))
        self._node, self._config, self._go_on, self._publish_again = node, config, go_on, publish_again
        self._started_ns = time.monotonic_ns()
        self._reported_ns = self._again_ns = 0
        self._came_back: set[str] = set()
        self._new: dict[str, int] = {}
        self._watchers: set[str] = set()
        self._strangers = {p.name: 0 for p in self.core.participants}
        """Those known by a rule that may not hear us yet, and since when they seem to."""
        self.timeouts = 0
        self.failure: LockstepError | None = None
        """Why the run has to end."""
        self._stamped: StampedCommands | None = None
        self._beside: Any = None
        """What hears participants join in the context of commands of a second type; None once time has begun."""
        self._joined_beside: set[str] = set()
        self._known: dict[bytes, Any] = {}
        """Messages by all their bytes but for the stamp: those of a participant differ in nothing else, tick after tick."""

    def listen(self, stamped: StampedCommands | None) -> None:
        """Lets participants join; the node must listen to all commands by now, those under a second type in ``stamped``.

        News of a context's subscriptions come in the order in which they were made. So whose JOIN arrives knows of all the others already, and
        none of the commands that it sends from then on is lost; those under a second type once it has arrived in their context, too.
        """
        self._stamped = stamped
        if stamped is not None:
            self._beside = stamped.hear(
                TickDone, names.TICK_DONE, qos.TICK_DONE, lambda msg: self._joined_beside.add(msg.participant)
            )
        self._node.create_subscription(TickDone, names.TICK_DONE, self._on_done, qos.TICK_DONE, raw=True)

    def publish_tick(self, stamp_ns: int, topics: Callable[[], Collection[str]]) -> None:
        """Takes note that a tick was published; ``topics`` says with what, if anybody wants to know."""
        core = self.core
        core.publish_tick(stamp_ns, topics() if core.topics else (), time.monotonic_ns())

    def receive(self, topic: str) -> None:
        """Takes note that a command arrived; goes on where that was the last that the tick waited for."""
        was_open = self.core.is_open
        self.core.receive(topic.lstrip("/"), time.monotonic_ns())
        if self.core.is_open and not was_open:
            self._go_on()

    def restart(self) -> None:
        """Forgets the present tick: the simulation was reset."""
        self.core.restart()

    def _read(self, data: bytes) -> tuple[Any, int]:
        """Returns a TickDone, whose own stamp may be that of another tick, and its stamp; a tenth of the time that rclpy takes."""
        if data[1] != 1:  # not little-endian
            msg = deserialize_message(data, TickDone)
            return msg, conversions.time_from_msg(msg.stamp)
        length = int.from_bytes(data[8:12], "little")
        start = 12 + -(-length // 4) * 4
        key = data[:start] + data[start + 8 :]
        msg = self._known.get(key)
        if msg is None:
            if len(self._known) >= _MOST_KNOWN:
                self._known.clear()
            msg = self._known[key] = deserialize_message(data, TickDone)
        return msg, stamp_ns(data, start)

    def _on_done(self, data: bytes) -> None:
        now_ns, core, was_open = time.monotonic_ns(), self.core, self.core.is_open
        msg, stamp_ns = self._read(data)
        name = msg.participant
        if msg.event in (TickDone.JOIN, TickDone.WATCH):
            self._node.get_logger().info(f"lockstep: {quoted(name)} takes part{f', after {msg.after}' if msg.after else ''}")
            self._new[name] = now_ns
            (self._watchers.add if msg.event == TickDone.WATCH else self._watchers.discard)(name)
            if core.join(name, msg.after.lstrip("/")):
                self._came_back.add(name)
        elif msg.event == TickDone.LEAVE:
            self._node.get_logger().info(f"lockstep: {quoted(name)} leaves")
            core.leave(name, now_ns)
        elif any(p.name == name for p in core.participants):
            sent = [topic.lstrip("/") for topic in msg.sent]
            if core.done(name, stamp_ns, sent, now_ns):
                self._came_back.discard(name)
        else:
            self._node.get_logger().warning(
                f"lockstep: {quoted(name)} has done a tick, but has not joined: nobody waits for it; send a JOIN first",
                throttle_duration_sec=5.0,
            )
        if core.is_open and not was_open:
            self._go_on()

    def may_go(self) -> bool:
        """Returns whether the next tick may begin; says who is late, and sets ``failure`` where somebody is too late."""
        core, now_ns = self.core, time.monotonic_ns()
        limit_s, opened_ns = self._config.participant_timeout, self._started_ns
        if core.absent:
            what, limit_s = "has not joined", max(JOIN_LIMIT_S, limit_s)
        elif not core.is_open:
            what, opened_ns = f"has not done the tick at {(core.stamp_ns or 0) / NS_PER_S:.3f} s", now_ns - core.waited_ns(now_ns)
            self._repeat_tick(now_ns)
        elif self._is_matched(now_ns):
            return True
        elif not self._strangers:
            return False
        else:
            what = "does not listen yet"
        waited_s = (now_ns - opened_ns) / NS_PER_S
        if waited_s > limit_s:
            return self._give_up(f"{what} after {waited_s:.1f} s", now_ns)
        if waited_s * NS_PER_S > LATE_NS and now_ns - self._reported_ns > LATE_NS:
            self._reported_ns = now_ns
            if self._gone_watchers(now_ns):
                return core.is_open
            self._node.get_logger().warning(f"lockstep: {self._late()} {what} after {waited_s:.1f} s; time waits")
        return False

    def _gone_watchers(self, now_ns: int) -> list[str]:
        """Lets those go whose nodes have gone and who only watched; returns their names."""
        there = self._names_there()
        gone = [name for name in self.core.waits_for if name in self._watchers and name not in there]
        for name in gone:
            self._node.get_logger().warning(f"lockstep: {quoted(name)} has gone without leaving; time goes on without it")
            self.core.leave(name, now_ns)
        return gone

    def _names_there(self) -> set[str]:
        return {_full_name(p) for p in self._node.get_publishers_info_by_topic(names.TICK_DONE)}

    def _is_matched(self, now_ns: int) -> bool:
        """Returns whether everybody hears what is published from now on."""
        if not self._new and not self._strangers:
            self._end_listening_beside()
            return True
        self._new = {n: since for n, since in self._new.items() if now_ns - since < _MATCHING_NS and not self._is_ready(n)}
        rules = {p.name: p.answer for p in self.core.participants}
        heard = {n: since or now_ns if self._is_matched_with(rules[n]) else 0 for n, since in self._strangers.items()}
        self._strangers = {n: since for n, since in heard.items() if not since or now_ns - since < _SETTLED_NS}
        return not self._new and not self._strangers

    def _repeat_tick(self, now_ns: int) -> None:
        """Gives the present tick again to one that came back, and to one whose first answer does not come."""
        mute = [p for p in self.core.participants if p.answer and p.waits_for_it and not p.ticks and not p.missed]
        lost = bool(mute) and self.core.waited_ns(now_ns) > _FIRST_ANSWER_NS
        if (lost and now_ns - self._again_ns > _FIRST_ANSWER_NS) or (self._came_back and now_ns - self._again_ns > _AGAIN_NS):
            self._again_ns = now_ns
            self._publish_again(lost)

    def _give_up(self, what: str, now_ns: int) -> bool:
        late = self._late()
        if self.core.absent or self._config.on_timeout == "stop":
            self.failure = LockstepError(
                f"lockstep: {late} {what}: the run ends. Mend it, raise 'participant_timeout', or set 'on_timeout' to go_on "
                "to do without its answer"
            )
            return False
        self.core.give_up(now_ns)
        self._strangers = {}
        self.timeouts += 1
        self._node.get_logger().warning(
            f"lockstep: {late} {what}: this tick goes on without it; the run cannot be repeated to the bit"
        )
        return True

    def _is_ready(self, name: str) -> bool:
        """Returns whether all between a participant and us arrives."""
        return (self._beside is None or name in self._joined_beside) and self._hears_us(name)

    def _end_listening_beside(self) -> None:
        if self._beside is not None and self._stamped is not None:
            self._stamped.unsubscribe(self._beside)
            self._beside = None

    def _hears_us(self, name: str) -> bool:
        """Returns whether all that a participant listens to reaches it: its messages may be here before its subscriptions are."""
        after = next((p.after for p in self.core.participants if p.name == name), "")
        topic = names.SCENE_STATE if after == CAMERAS else after
        return any(
            _full_name(p) == name and self._reaches(p, topic) for p in self._node.get_publishers_info_by_topic(names.TICK_DONE)
        )

    def _is_matched_with(self, answer: str) -> bool:
        """Returns whether somebody publishes a topic, and all that those listen to reaches them."""
        found = [p for p in self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(answer)) if p.node_name]
        return bool(found) and all(map(self._reaches, found))

    def _reaches(self, endpoint: Any, topic: str = "") -> bool:
        """Returns whether all that the node of an endpoint listens to reaches it, a certain topic among it.

        Not while its name has not arrived, nor while nothing is known of its subscription to that topic: news of publishers and of
        subscriptions come apart from each other.
        """
        node = self._node
        if not endpoint.node_namespace.startswith("/"):
            return False
        try:
            found = node.get_subscriber_names_and_types_by_node(endpoint.node_name, endpoint.node_namespace)
        except NodeNameNonExistentError:
            return False
        topics = {listened for listened, _ in found}
        if topic and node.resolve_topic_name(topic) not in topics:
            return False
        ours = [publisher for publisher in node.publishers if publisher.topic_name in topics]
        return all(reaches_all(node, publisher) for publisher in ours)

    def _late(self) -> str:
        """Returns the names of those who are waited for, and what is known of them."""
        there = self._names_there()
        rules = {p.name: p.answer for p in self.core.participants}
        parts = []
        for name in self.core.waits_for or self._strangers:
            if rules.get(name):
                gone = not self._node.count_publishers(rules[name])
                parts.append(f"{quoted(name)} ({'nobody publishes' if gone else 'no message on'} {rules[name]})")
            else:
                parts.append(f"{quoted(name)} ({'it hangs or is slow' if name in there else 'there is no such node'})")
        return ", ".join(parts)

    def summary(self) -> dict[str, Any]:
        """Returns for how long everybody waited for whom."""
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


def _full_name(info: Any) -> str:
    """Returns the name under which the node of an endpoint takes part."""
    return f"{info.node_namespace.strip('/')}/{info.node_name}".lstrip("/")
