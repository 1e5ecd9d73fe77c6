"""Recording: determines which messages are written, to which bag, and with which log time. Must not import ROS: a node passes it bytes.

The log time of a message is the newest /clock before it, as with `ros2 bag record --use-sim-time`. When /clock runs backwards (the
simulation was reset or restarted), the bag is closed and the recording continues in another one, ``<bag>_epoch1``.
"""

from __future__ import annotations

import heapq
import logging
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from gibson_sim.bags.definitions import MessageDefinitions
from gibson_sim.bags.mcap_file import Compression
from gibson_sim.bags.metadata import Profile, TopicQos
from gibson_sim.bags.stamps import stamp_ns
from gibson_sim.bags.storage import Storage
from gibson_sim.bags.writer import BagWriter
from gibson_sim.client_config import RecordConfig
from gibson_sim.errors import ConfigError, RecordError
from gibson_sim.types import NS_PER_S

CLOCK = "/clock"
TF = "tf2_msgs/msg/TFMessage"
MOST_WAITING = 1000
"""Maximum number of messages, apart from latched ones, that wait for the first /clock."""
MOST_EPOCHS = 100
"""Resets of time in one recording, at most: two programs that publish /clock would cause them without end."""
_MOST_TRANSFORMS = 200
"""Number of messages kept of a latched transform topic, whose publishers send different transforms."""

Message = tuple[str, bytes]
"""Topic and CDR bytes."""
Stored = tuple[int, str, bytes]
"""Log time in nanoseconds, topic, CDR bytes."""
_log = logging.getLogger(__name__)


class Recording:
    """Writes messages to bags at simulation time. A full disk or another write error ends it: see ``error``."""

    def __init__(self, config: RecordConfig) -> None:
        """Creates the bag, unless only snapshots are requested.

        Raises:
            ConfigError: no output folder is given.
            RecordError: the folder cannot be used.
        """
        if not config.output:
            raise ConfigError("setting 'output' is empty, must be the folder of the bag")
        self._config = config
        self._output = Path(config.output)
        self._definitions = MessageDefinitions()
        self._memory: SnapshotMemory | None = None
        self._bag: BagWriter | None = None
        self._bags: list[Path] = []
        if config.snapshot_seconds:
            self._memory = SnapshotMemory(round(config.snapshot_seconds * NS_PER_S), config.snapshot_mb * 1_000_000)
        else:
            self._bag = self._new_bag(self._output)
        self._topics: dict[str, _Topic] = {}
        self._latched = LatchedMessages()
        self._latched_while_paused: dict[str, bytes] = {}
        self._waiting: list[Message] = []
        self._unwritten = 0
        self._now_ns: int | None = None
        self._recorded_ns = self._epochs = 0
        self._messages: Counter[str] = Counter()
        self._bytes: Counter[str] = Counter()
        self.paused = False
        """Whether writing is suspended until ``resume``."""
        self.done = False
        """Whether the duration has elapsed or an error has ended the recording."""
        self.error = ""
        """Reason for which the recording ended early; empty = none."""

    @property
    def keeps_snapshots(self) -> bool:
        """Whether messages are kept in memory instead of written to disk."""
        return self._memory is not None

    def add_topic(self, topic: str, type_name: str, profile: TopicQos | Profile | None, *, latched: bool = False) -> None:
        """Declares a topic.

        Raises:
            RecordError: the type is unknown or cannot be recorded; the recording continues without the topic.
        """
        record = _Topic(type_name, TopicQos.of(profile), latched)
        if self._bag is not None:
            self._bag.add_topic(topic, record.type_name, record.qos)
        self._topics[topic] = record

    def receive_clock(self, data: bytes) -> None:
        """Advances time to that of a /clock message, which is recorded only if the topic is declared."""
        now_ns = stamp_ns(data)
        previous_ns, self._now_ns = self._now_ns, now_ns
        if previous_ns is None:
            self._write_waiting(now_ns)
        elif now_ns < previous_ns:
            self._begin_epoch(previous_ns, now_ns)
        elif not self.paused:
            self._recorded_ns += now_ns - previous_ns
        if CLOCK in self._topics:
            self._record(CLOCK, data, now_ns)
        if self._config.duration and self._recorded_ns >= self._config.duration * NS_PER_S:
            self.done = True

    def receive(self, topic: str, data: bytes) -> None:
        """Records a message of a declared topic, CDR bytes."""
        if self._now_ns is not None:
            self._record(topic, data, self._now_ns)
        elif self._topics[topic].latched or len(self._waiting) < MOST_WAITING:
            # The middleware may deliver the first /clock after messages that were published later.
            self._waiting.append((topic, data))
        else:
            self._unwritten += 1

    def pause(self) -> None:
        """Suspends writing. Latched messages that arrive during the pause are written on ``resume``."""
        if not self.paused:
            _log.info("recording is paused")
        self.paused = True

    def resume(self) -> None:
        """Resumes writing."""
        if not self.paused:
            return
        self.paused = False
        _log.info("recording goes on")
        latched, self._latched_while_paused = self._latched_while_paused, {}
        for topic, data in latched.items():
            self._store(topic, data, self._now_ns or 0)

    def split(self) -> bool:
        """Continues in the next file of the bag; returns False if no bag is being written, or the file is empty."""
        if self._bag is None or self.done:
            return False
        try:
            return self._bag.split()
        except RecordError as error:
            self._fail(error)
            return False

    def flush(self) -> None:
        """Hands the written messages to the kernel, so that they survive a crash of this process."""
        if self._bag is not None and not self.done:
            try:
                self._bag.flush()
            except RecordError as error:
                self._fail(error)

    def snapshot(self) -> Path | None:
        """Writes the messages in memory to a new bag and keeps them; returns the bag, or None if there are no messages or the write fails."""
        messages = [] if self._memory is None else list(self._memory.with_latched(self._latched))
        if not messages:
            _log.warning(
                "no snapshot is written: %s", "no message has arrived yet" if self.keeps_snapshots else "snapshot_seconds is 0"
            )
            return None
        folder = self._free_folder("snapshot")
        try:
            with self._new_bag(folder) as bag:
                self._declare(bag)
                _write_all(bag, messages)
        except RecordError as error:
            _log.error("snapshot %s: %s", folder, error)
            return None
        seconds = (messages[-1][0] - messages[0][0]) / NS_PER_S
        _log.info("snapshot %s: %d messages of %.2f s", folder, len(messages), seconds)
        for _, topic, data in messages:
            self._count(topic, data)
        return folder

    def close(self) -> None:
        """Closes the bag.

        Raises:
            RecordError: the end of the bag cannot be written.
        """
        if self._bag is not None:
            bag, self._bag = self._bag, None
            bag.close()

    def summary(self) -> dict[str, Any]:
        """Returns the number of messages and bytes by topic, the bags, and the reason for an early end."""
        return {
            "bag": self._config.output,
            "bags": [str(folder) for folder in self._bags],
            "storage": self._config.storage,
            "messages": {topic: self._messages[topic] for topic in sorted(self._topics) if self._messages[topic]},
            "bytes": {topic: self._bytes[topic] for topic in sorted(self._topics) if self._messages[topic]},
            "before_clock": self._unwritten + len(self._waiting),
            "error": self.error,
        }

    def _record(self, topic: str, data: bytes, now_ns: int) -> None:
        """Stores one message; during a pause, keeps it for the end of the pause if it is latched."""
        record = self._topics[topic]
        if record.latched:
            self._latched.add(topic, record.type_name, now_ns, data)
        if not self.paused:
            self._store(topic, data, now_ns)
        elif record.latched:
            self._latched_while_paused[topic] = data

    def _store(self, topic: str, data: bytes, now_ns: int) -> None:
        """Writes one message to the bag or to the snapshot memory; a full disk ends the recording, not the simulation."""
        if self.done:
            return
        if self._memory is not None:
            crowded = self._memory.crowded
            if not self._topics[topic].latched:
                self._memory.add(topic, now_ns, data)
            if self._memory.crowded and not crowded:
                _log.warning("snapshot_mb, %d MB, is too little for snapshot_seconds", self._config.snapshot_mb)
            return
        assert self._bag is not None, "the recording is closed"
        try:
            self._bag.write(topic, data, now_ns, now_ns)
            self._count(topic, data)
        except RecordError as error:
            self._fail(error)

    def _count(self, topic: str, data: bytes) -> None:
        self._messages[topic] += 1
        self._bytes[topic] += len(data)

    def _fail(self, error: RecordError) -> None:
        self.error, self.done = str(error), True
        _log.error("recording ends: %s", error)

    def _write_waiting(self, now_ns: int) -> None:
        """Writes the messages that arrived before the first /clock, with its time."""
        waiting, self._waiting = self._waiting, []
        for topic, data in waiting:
            self._record(topic, data, now_ns)

    def _begin_epoch(self, before_ns: int, now_ns: int) -> None:
        """Continues in a new bag after time jumped backwards, beginning with the latched messages."""
        self._epochs += 1
        self._latched.restart(now_ns)
        times = f"{before_ns / NS_PER_S:.3f} s to {now_ns / NS_PER_S:.3f} s"
        if self._memory is not None:
            self._memory.clear()
            _log.info("time went back from %s: snapshots begin there", times)
            return
        if self.done:
            return
        try:
            if self._epochs > MOST_EPOCHS:
                raise RecordError(f"time went back {self._epochs} times, last from {times}: do two programs publish /clock?")
            closed, folder = self._bags[-1], self._free_folder("epoch")
            self.close()
            self._bag = self._new_bag(folder)
            self._declare(self._bag)
            for _, topic, data in self._latched.messages():
                self._store(topic, data, now_ns)
            _log.info("time went back from %s: %s is closed, recording goes on in %s", times, closed, folder)
        except RecordError as error:
            self._fail(error)

    def _free_folder(self, what: str) -> Path:
        """Returns ``<output>_<what><number>`` with the first unused number."""
        number = 1
        while (folder := self._output.with_name(f"{self._output.resolve().name}_{what}{number}")).exists():
            number += 1
        return folder

    def _new_bag(self, folder: Path) -> BagWriter:
        config = self._config
        bag = BagWriter(
            folder,
            message_definitions=self._definitions,
            storage=cast(Storage, config.storage),
            reserve_bytes=config.reserve_mb * 1_000_000,
            compression=cast(Compression, config.compression),
            max_file_bytes=config.max_bag_size,
            max_file_ns=round(config.max_bag_duration * NS_PER_S),
        )
        self._bags.append(folder)
        return bag

    def _declare(self, bag: BagWriter) -> None:
        for topic, record in self._topics.items():
            bag.add_topic(topic, record.type_name, record.qos)


@dataclass(frozen=True, slots=True)
class _Topic:
    """A recorded topic."""

    type_name: str
    qos: TopicQos
    latched: bool


def _write_all(bag: BagWriter, messages: Iterable[Stored]) -> None:
    for stamp, topic, data in messages:
        bag.write(topic, data, stamp, stamp)


def report_lines(summary: dict[str, Any]) -> list[str]:
    """Returns the summary of a recording for a terminal: one line per topic, and the losses."""
    counts, sizes = summary["messages"], summary["bytes"]
    lost, late = summary.get("lost", {}), summary.get("message_lost", {})
    width = max((len(topic) for topic in counts), default=0)
    lines = [", ".join(summary["bags"]) or "no bag was written"]
    for topic, count in counts.items():
        known = "" if topic not in lost else "  nothing lost" if not lost[topic] else f"  LOST {lost[topic]}"
        lines.append(f"  {topic:{width}} {count:8d} messages {sizes[topic] / 1e6:10.2f} MB{known}")
    lines.append(f"  {'together':{width}} {sum(counts.values()):8d} messages {sum(sizes.values()) / 1e6:10.2f} MB")
    # Where sequence numbers are known, they are right: the middleware also reports messages sent before the subscription as lost.
    missing = {**late, **lost}
    if any(missing.values()):
        names = ", ".join(f"{topic} {count}" for topic, count in sorted(missing.items()) if count)
        lines.append(f"WARNING: messages were lost on the way: {names}; record fewer topics, or on a faster machine or disk")
    if early := summary.get("before_clock", 0):
        lines.append(
            f"WARNING: {early} messages are not recorded, since no /clock had come to give them a time; start the simulation first, or play a "
            "bag with `gibson-sim bag play --clock`"
        )
    for topic, hint in summary.get("absent", {}).items():
        lines.append(f"WARNING: nothing is recorded of {topic}, which no node publishes{f'; {hint}' if hint else ''}")
    if summary["error"]:
        lines.append(f"WARNING: the recording ended early: {summary['error']}")
    return lines


class SnapshotMemory:
    """A ring buffer of the messages of the last seconds of simulation time, with a memory limit.

    Args:
        span_ns: age beyond which messages are dropped, nanoseconds.
        most_bytes: memory limit, bytes; the oldest messages are dropped first.
    """

    def __init__(self, span_ns: int, most_bytes: int) -> None:
        self._span_ns, self._most_bytes = span_ns, most_bytes
        self._messages: deque[Stored] = deque()
        self._bytes = 0
        self.crowded = False
        """Whether messages were dropped before the end of the span, for lack of memory."""

    def add(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Adds a message; stamps (nanoseconds) must not decrease."""
        self._messages.append((stamp_ns, topic, data))
        self._bytes += len(data)
        while self._messages[0][0] < stamp_ns - self._span_ns:
            self._drop_oldest()
        while self._bytes > self._most_bytes:
            self.crowded = True
            self._drop_oldest()

    def with_latched(self, latched: LatchedMessages) -> Iterator[Stored]:
        """Yields the messages ordered by time; earlier latched messages get the time of the first message."""
        if not self._messages:
            return iter(())
        start = self._messages[0][0]
        first = [(max(start, stamp), topic, data) for stamp, topic, data in latched.messages()]
        return heapq.merge(first, self._messages, key=lambda message: message[0])

    def clear(self) -> None:
        """Drops all messages."""
        self._messages.clear()
        self._bytes = 0

    def _drop_oldest(self) -> None:
        self._bytes -= len(self._messages.popleft()[2])


class LatchedMessages:
    """Messages that a late joiner would receive: the last message of each latched topic, and all messages of latched transform topics."""

    def __init__(self) -> None:
        self._kept: dict[str, deque[Stored]] = {}

    def add(self, topic: str, type_name: str, stamp_ns: int, data: bytes) -> None:
        """Adds a message of a latched topic."""
        messages = self._kept.setdefault(topic, deque(maxlen=_MOST_TRANSFORMS if type_name == TF else 1))
        duplicate = next((message for message in messages if message[2] == data), None)
        if duplicate is not None:
            messages.remove(duplicate)
        messages.append((stamp_ns, topic, data))

    def restart(self, stamp_ns: int) -> None:
        """Sets the log time of all messages to the start of the new epoch, nanoseconds."""
        for topic, messages in self._kept.items():
            self._kept[topic] = deque(((stamp_ns, name, data) for _, name, data in messages), maxlen=messages.maxlen)

    def messages(self) -> list[Stored]:
        """Returns the messages in the order of their arrival."""
        return sorted((message for messages_of_topic in self._kept.values() for message in messages_of_topic), key=lambda m: m[0])


class StartGate:
    """Buffers messages until the start of the recording is determined.

    DDS discovers publishers one by one, over a second or more. While time runs freely, all messages that arrive are recorded. In lockstep no message
    may be missing: if the simulation was running before the recorder, the bag starts with the first /clock after all publishers are matched, and
    with the earlier latched messages.

    Args:
        is_latched: returns whether a topic is latched.
    """

    def __init__(self, is_latched: Callable[[str], bool]) -> None:
        self._is_latched = is_latched
        self._held: list[Message] = []
        self._first_ns: int | None = None
        self._discards = self._waits_for_clock = False
        self.is_open = False
        """Whether the recording has started, so that messages are no longer buffered."""

    @property
    def has_clock(self) -> bool:
        """Whether a /clock has arrived."""
        return self._first_ns is not None

    @property
    def is_late(self) -> bool:
        """Whether time was already running when the first /clock arrived."""
        return bool(self._first_ns)

    def open(self) -> None:
        """Starts with all buffered messages."""
        self.is_open = True

    def discard(self) -> None:
        """Discards all messages that arrive before ``open_at_next_clock``, including buffered ones, except latched messages."""
        self._discards = True

    def open_at_next_clock(self) -> None:
        """Starts with the next /clock."""
        self._discards = self._waits_for_clock = True

    def release(self, messages: Iterable[Message]) -> list[Message]:
        """Adds messages; returns the messages to record now, buffered ones first."""
        for topic, data in messages:
            if topic == CLOCK and not self.is_open:
                self._note_clock(stamp_ns(data))
            self._held.append((topic, data))
        if self.is_open:
            released, self._held = self._held, []
            return released
        if self._discards:
            self._discard_held()
        return []

    def _note_clock(self, now_ns: int) -> None:
        if self._first_ns is None:
            self._first_ns = now_ns
        if self._waits_for_clock:
            self._discard_held()
            self.is_open = True

    def _discard_held(self) -> None:
        self._held = [message for message in self._held if self._is_latched(message[0])]
