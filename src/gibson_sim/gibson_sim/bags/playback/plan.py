"""Plans a playback: selected topics, their QoS, the messages in order, and the wall time until each is due.

Must not import rclpy. ``gibson_sim.ros.nodes.play_node`` publishes what this module plans.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from gibson_sim.bags.metadata import TopicQos
from gibson_sim.bags.playback.options import PlayOptions
from gibson_sim.bags.reader import BagReader
from gibson_sim.config import absolute_name
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.settings import nearest
from gibson_sim.types import NS_PER_S

CLOCK = "/clock"


@dataclass(frozen=True, slots=True)
class PlayedTopic:
    """A topic of a bag that is played."""

    name: str
    """Topic in the bag."""
    published_as: str
    """Topic on which it is published."""
    type_name: str
    qos: TopicQos
    """QoS of its publisher."""

    @property
    def is_latched(self) -> bool:
        """Whether late subscribers receive the last messages."""
        return self.qos.durability == "transient_local"


class PlayedMessage(NamedTuple):
    """A message with the time at which it is due."""

    time_ns: int
    """Log time in the bag, ns."""
    topic: str
    """Topic in the bag; ``CLOCK`` = the time itself, whose message is the time."""
    data: bytes
    """CDR bytes; empty for ``CLOCK``."""


@dataclass(frozen=True, slots=True)
class Span:
    """The part of a bag that is played, log times in ns, both included."""

    start_ns: int
    end_ns: int

    @property
    def seconds(self) -> float:
        """Length, s."""
        return (self.end_ns - self.start_ns) / NS_PER_S


def select_topics(bag: BagReader, options: PlayOptions) -> tuple[PlayedTopic, ...]:
    """Returns the topics to play, those with messages, sorted by name. The bag's own /clock is never among them.

    Raises:
        ConfigError: a requested topic is not in the bag or cannot be played, nothing is left to play, or topics of different types would be
            published on the same topic.
    """
    infos = {name: info for name, info in bag.topics().items() if name != CLOCK}
    requested = [_known(topic, infos, "--topics", options.bag) for topic in options.topics] or list(infos)
    # Other players play the bag's /clock unless it is excluded: it may be named here, too.
    others = [topic for topic in options.exclude_topics if absolute_name(topic) != CLOCK]
    excluded = {_known(topic, infos, "--exclude-topics", options.bag) for topic in others}
    names = {_known(old, infos, "--remap", options.bag): new for old, new in options.remapped().items()}
    profiles = bag.offered_qos()
    played = tuple(
        PlayedTopic(name, names.get(name, name), infos[name].type_name, playback_qos(profiles[name]))
        for name in sorted(set(requested) - excluded)
        if infos[name].count
    )
    if not played:
        filled = ", ".join(name for name, info in infos.items() if info.count) or "none"
        raise ConfigError(f"nothing of bag {options.bag} is selected: topics with messages, apart from {CLOCK}, are {filled}")
    by_target: dict[str, PlayedTopic] = {}
    for topic in played:
        other = by_target.setdefault(topic.published_as, topic)
        if other.type_name != topic.type_name:
            raise ConfigError(
                f"{other.name} ({other.type_name}) and {topic.name} ({topic.type_name}) would both be published as "
                f"{topic.published_as}: choose another --remap, or exclude one"
            )
        if topic.published_as == CLOCK:
            raise ConfigError(
                f"--remap publishes {topic.name} as {CLOCK}: leave it out; --clock publishes the time of the playback"
            )
    return played


def _known(topic: str, infos: Mapping[str, Any], flag: str, bag: str) -> str:
    """Returns the full name of a topic of the bag.

    Raises:
        ConfigError: the bag does not have it, or it is /clock.
    """
    name = absolute_name(topic)
    if name == CLOCK:
        raise ConfigError(f"{flag} has {CLOCK}, which is not played: --clock publishes the time of the playback")
    if name not in infos:
        hint = nearest(name, tuple(infos)) or f"it has {', '.join(infos) or 'none'}"
        raise ConfigError(f"{flag}: bag {bag} has no topic {quoted(name)}; {hint}")
    return name


def playback_qos(profiles: Sequence[TopicQos]) -> TopicQos:
    """Returns the QoS of the one publisher that replaces the recorded publishers of a topic.

    If they agree in all policies that affect matching, it is theirs, as in rosbag2; otherwise the strictest that any of them offered, which
    matches all of their subscribers. Its queue is as long as theirs together: each may have had latched messages of its own.
    """
    if not profiles:
        return TopicQos()
    first, depth = profiles[0], sum(profile.depth for profile in profiles)
    if len({_matching_policies(profile) for profile in profiles}) == 1:
        return replace(first, depth=depth)
    return TopicQos(
        depth=depth,
        reliability="reliable" if any(profile.reliability == "reliable" for profile in profiles) else "best_effort",
        durability="transient_local" if any(profile.durability == "transient_local" for profile in profiles) else "volatile",
    )


def _matching_policies(profile: TopicQos) -> tuple[Any, ...]:
    return (
        profile.reliability, profile.durability, profile.deadline_ns, profile.liveliness, profile.liveliness_lease_duration_ns,
    )  # fmt: skip


def played_span(bag: BagReader, options: PlayOptions) -> Span:
    """Returns the part of the bag that the options select.

    Raises:
        ConfigError: it begins after the end of the bag.
    """
    first_ns, last_ns = bag.span_ns
    start_ns = first_ns + round(options.start_offset * NS_PER_S)
    if start_ns > last_ns:
        length_s = (last_ns - first_ns) / NS_PER_S
        raise ConfigError(
            f"--start-offset is {options.start_offset:g} s, must be less than the length of the bag, {length_s:.1f} s"
        )
    end_ns = min(last_ns, start_ns + round(options.playback_duration * NS_PER_S)) if options.playback_duration else last_ns
    return Span(start_ns, end_ns)


def messages_in_order(
    bag: BagReader, topics: Sequence[PlayedTopic], span: Span, clock_period_ns: int = 0
) -> Iterator[PlayedMessage]:
    """Yields the messages of a playback in the order of their times, beginning with the latched ones that are valid at its start.

    Args:
        bag: the bag.
        topics: topics to play.
        span: part of the bag to play.
        clock_period_ns: time between two messages of /clock, ns of the bag's time; 0 = none. /clock precedes messages of the same time,
            and has the time of the last message at the end.

    Raises:
        RecordError: the bag is damaged.
    """
    if clock_period_ns:
        yield PlayedMessage(span.start_ns, CLOCK, b"")
    for topic, data in _latched_before(bag, topics, span.start_ns):
        yield PlayedMessage(span.start_ns, topic, data)
    clock_ns = last_ns = span.start_ns
    for topic, time_ns, data in bag.raw_messages([t.name for t in topics], start_ns=span.start_ns, stop_ns=span.end_ns + 1):
        while clock_period_ns and clock_ns + clock_period_ns <= time_ns:
            clock_ns += clock_period_ns
            yield PlayedMessage(clock_ns, CLOCK, b"")
        last_ns = time_ns
        yield PlayedMessage(time_ns, topic, bytes(data))
    if clock_period_ns and clock_ns < last_ns:
        yield PlayedMessage(last_ns, CLOCK, b"")


def _latched_before(bag: BagReader, topics: Sequence[PlayedTopic], start_ns: int) -> list[tuple[str, bytes]]:
    """Returns topic and data of the latched messages before a time that a late subscriber would still have received then, in order."""
    latched = {topic.name: topic.qos for topic in topics if topic.is_latched}
    queues = {
        name: deque[tuple[int, bytes]](maxlen=qos.depth if qos.history == "keep_last" else None) for name, qos in latched.items()
    }
    if start_ns <= bag.span_ns[0] or not queues:
        return []
    for number, (topic, _, data) in enumerate(bag.raw_messages(queues, stop_ns=start_ns)):
        queues[topic].append((number, bytes(data)))
    valid = sorted((number, topic, data) for topic, queue in queues.items() for number, data in queue)
    return [(topic, data) for _, topic, data in valid]


class Pace:
    """Converts times of a bag to wall time: a rate, and pauses."""

    def __init__(self, rate: float, start_ns: int, now_s: float, *, paused: bool = False) -> None:
        """Starts at a time of the bag.

        Args:
            rate: seconds of the bag per second of wall time.
            start_ns: time of the bag at the start, ns.
            now_s: present wall time, s, of a monotonic clock.
            paused: whether it starts paused.
        """
        self._rate, self._at_ns, self._at_s, self._paused = rate, float(start_ns), now_s, paused

    @property
    def paused(self) -> bool:
        """Whether time stands still."""
        return self._paused

    def remaining_s(self, time_ns: int, now_s: float) -> float:
        """Returns the wall time until a time of the bag, s: negative if it has passed, infinite during a pause."""
        return math.inf if self._paused else (time_ns - self._at_ns) / NS_PER_S / self._rate - (now_s - self._at_s)

    def toggle(self, now_s: float) -> None:
        """Pauses, or resumes."""
        if not self._paused:
            self._at_ns += (now_s - self._at_s) * self._rate * NS_PER_S
        self._at_s, self._paused = now_s, not self._paused
