"""Keeps the last seconds of a recording in memory, and the latched messages that still hold."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator

TF = "tf2_msgs/msg/TFMessage"
_MOST_TRANSFORMS = 200
"""Messages kept of one latched topic of transforms, where each sender adds to what the others said."""

Stored = tuple[int, str, bytes]
"""Log time in nanoseconds, topic, CDR bytes."""


class LatchedMessages:
    """What a late joiner would get: the last message of each latched topic, and all of those with transforms."""

    def __init__(self) -> None:
        self._kept: dict[str, deque[Stored]] = {}

    def add(self, topic: str, type_name: str, stamp_ns: int, data: bytes) -> None:
        """Takes a message of a latched topic."""
        kept = self._kept.setdefault(topic, deque(maxlen=_MOST_TRANSFORMS if type_name == TF else 1))
        again = next((message for message in kept if message[2] == data), None)
        if again is not None:
            kept.remove(again)
        kept.append((stamp_ns, topic, data))

    def restart(self, stamp_ns: int) -> None:
        """Moves everything to one time, nanoseconds: that at which time began anew."""
        for topic, kept in self._kept.items():
            self._kept[topic] = deque(((stamp_ns, name, data) for _, name, data in kept), maxlen=kept.maxlen)

    def messages(self) -> list[Stored]:
        """Returns what is kept in the order in which it came."""
        return sorted((message for kept in self._kept.values() for message in kept), key=lambda m: m[0])


class SnapshotMemory:
    """The messages of the last seconds of simulation time, as far as the memory allows."""

    def __init__(self, span_ns: int, most_bytes: int) -> None:
        """Takes the limits.

        Args:
            span_ns: messages older than this are forgotten, nanoseconds.
            most_bytes: of all messages together; the oldest go first.
        """
        self._span_ns, self._most_bytes = span_ns, most_bytes
        self._messages: deque[Stored] = deque()
        self._bytes = 0
        self.crowded = False
        """True once the memory was too small for the seconds."""

    def add(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Takes a message; stamps (nanoseconds) must not run backwards."""
        self._messages.append((stamp_ns, topic, data))
        self._bytes += len(data)
        while self._messages[0][0] < stamp_ns - self._span_ns:
            self._forget()
        while self._bytes > self._most_bytes:
            self.crowded = True
            self._forget()

    def with_latched(self, latched: LatchedMessages) -> Iterator[Stored]:
        """Yields what is kept in the order of time, latched messages of before at the time of the first one."""
        if not self._messages:
            return iter(())
        start = self._messages[0][0]
        first = [(max(start, stamp), topic, data) for stamp, topic, data in latched.messages()]
        return heapq.merge(first, self._messages, key=lambda message: message[0])

    def clear(self) -> None:
        """Forgets everything."""
        self._messages.clear()
        self._bytes = 0

    def _forget(self) -> None:
        self._bytes -= len(self._messages.popleft()[2])
