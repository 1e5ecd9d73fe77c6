"""Lockstep on topics: who takes part, who is late, and what then."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Any

from rclpy.node import Node

from gibson_msgs.msg import TickDone
from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import LockstepError
from gibson_sim.ros import conversions, names, qos
from gibson_sim.simulation.lockstep import Lockstep, parse_participants
from gibson_sim.types import NS_PER_S

LATE_NS = 2 * NS_PER_S
"""A tick that waits for so long is worth a warning."""
JOIN_LIMIT_S = 120.0
"""So long time waits for participants that were announced."""
_MATCHING_NS = 3 * NS_PER_S
"""After so long a new participant is believed to hear us."""
_AGAIN_NS = NS_PER_S // 2
"""How often a participant that came back is given the present tick, until it has done it."""


class LockstepGate:
    """Holds time until every participant has done the present tick.

    Subscribes:
        tick_done (gibson_msgs/TickDone): who takes part, and has done what.
    """

    def __init__(self, node: Node, config: PhysicsConfig, go_on: Callable[[], None], publish_again: Callable[[], None]) -> None:
        """Starts to listen.

        Args:
            node: the physics node.
            config: its settings.
            go_on: is called when a tick is done.
            publish_again: publishes the state of the present tick once more, for a participant that came back.

        Raises:
            ConfigError: setting ``participants`` is not of the form that the message shows.
        """
        self.core = Lockstep(parse_participants(config.participants))
        self._node, self._config, self._go_on, self._publish_again = node, config, go_on, publish_again
        self._started_ns = time.monotonic_ns()
        self._reported_ns = self._again_ns = 0
        self._came_back: set[str] = set()
        self._new: dict[str, int] = {}
        self.timeouts = 0
        self.failure: LockstepError | None = None
        """Why the run has to end."""
        node.create_subscription(TickDone, names.TICK_DONE, self._on_done, qos.TICK_DONE)

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

    def _on_done(self, msg: Any) -> None:
        now_ns, core, was_open = time.monotonic_ns(), self.core, self.core.is_open
        name = msg.participant
        if msg.event == TickDone.JOIN:
            self._node.get_logger().info(f"lockstep: {name!r} takes part{f', after {msg.after}' if msg.after else ''}")
            self._new[name] = now_ns
            if core.join(name, msg.after.lstrip("/")):
                self._came_back.add(name)
        elif msg.event == TickDone.LEAVE:
            self._node.get_logger().info(f"lockstep: {name!r} leaves")
            core.leave(name, now_ns)
        elif any(p.name == name for p in core.participants):
            sent = [topic.lstrip("/") for topic in msg.sent]
            if core.done(name, conversions.time_from_msg(msg.stamp), sent, now_ns):
                self._came_back.discard(name)
        else:
            self._node.get_logger().warning(
                f"lockstep: {name!r} has done a tick, but has not joined: nobody waits for it; send a JOIN first",
                throttle_duration_sec=5.0,
            )
        if core.is_open and not was_open:
            self._go_on()

    def may_go(self) -> bool:
        """Returns whether the next tick may begin; says who is late, and sets ``failure`` where somebody is too late."""
        core, now_ns = self.core, time.monotonic_ns()
        if core.is_open:
            self._new = {n: since for n, since in self._new.items() if now_ns - since < _MATCHING_NS and not self._hears_us(n)}
            return not self._new
        limit_s = self._config.participant_timeout
        if core.absent:
            waited_ns, limit_s = now_ns - self._started_ns, max(JOIN_LIMIT_S, limit_s)
            what = f"has not joined after {waited_ns / NS_PER_S:.1f} s"
        else:
            waited_ns = core.waited_ns(now_ns)
            what = f"has not done the tick at {(core.stamp_ns or 0) / NS_PER_S:.3f} s after {waited_ns / NS_PER_S:.1f} s"
        if self._came_back and now_ns - self._again_ns > _AGAIN_NS:
            self._again_ns = now_ns
            self._publish_again()
        if waited_ns < min(LATE_NS, limit_s * NS_PER_S):
            return False
        if waited_ns > limit_s * NS_PER_S:
            return self._give_up(what, now_ns)
        if now_ns - self._reported_ns > LATE_NS:
            self._reported_ns = now_ns
            self._node.get_logger().warning(f"lockstep: {self._late()} {what}; time waits")
        return False

    def _give_up(self, what: str, now_ns: int) -> bool:
        late = self._late()
        if self.core.absent or self._config.on_timeout == "stop":
            self.failure = LockstepError(
                f"lockstep: {late} {what}: the run ends. Mend it, raise 'participant_timeout', or set 'on_timeout' to go_on "
                "to do without its answer"
            )
            return False
        self.core.give_up(now_ns)
        self.timeouts += 1
        self._node.get_logger().warning(
            f"lockstep: {late} {what}: this tick goes on without it; the run cannot be repeated to the bit"
        )
        return True

    def _hears_us(self, name: str) -> bool:
        """Returns whether all that a participant listens to reaches it: its messages may be here before its subscriptions are."""
        node = self._node
        found = next((p for p in node.get_publishers_info_by_topic(names.TICK_DONE) if _full_name(p) == name), None)
        if found is None:
            return False
        topics = {topic for topic, _ in node.get_subscriber_names_and_types_by_node(found.node_name, found.node_namespace)}
        ours = [publisher for publisher in node.publishers if publisher.topic_name in topics]
        return all(publisher.get_subscription_count() >= node.count_subscribers(publisher.topic_name) for publisher in ours)

    def _late(self) -> str:
        """Returns the names of those who are waited for, and what is known of them."""
        there = {_full_name(p) for p in self._node.get_publishers_info_by_topic(names.TICK_DONE)}
        rules = {p.name: p.answer for p in self.core.participants}
        parts = []
        for name in self.core.waits_for:
            if rules.get(name):
                gone = not self._node.count_publishers(rules[name])
                parts.append(f"{name!r} ({'nobody publishes' if gone else 'no message on'} {rules[name]})")
            else:
                parts.append(f"{name!r} ({'it hangs or is slow' if name in there else 'there is no such node'})")
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
