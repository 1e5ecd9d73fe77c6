"""Common interface of the storage formats, mcap and sqlite3, for writing and repairing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

from gibson_sim.bags.metadata import FileRecord, TopicRecord
from gibson_sim.errors import RecordError

Storage = Literal["mcap", "sqlite3"]
SUFFIXES: dict[Storage, str] = {"mcap": ".mcap", "sqlite3": ".db3"}
RESERVE_FILE = ".reserve"
"""Name of the emergency file: it reserves disk space during a recording and is deleted when the disk is full."""


class EmptyFileError(RecordError):
    """A storage file that ends before its first record: its writer was killed before it wrote anything."""


@dataclass(frozen=True, slots=True)
class FileContents:
    """Readable content of one storage file."""

    path: Path
    start_ns: int
    """Log time of the first message, nanoseconds; 0 for an empty file."""
    end_ns: int
    """Log time of the last message, nanoseconds; 0 for an empty file."""
    topics: tuple[TopicRecord, ...]
    """Topics, with the number of messages in this file."""

    @property
    def count(self) -> int:
        """Number of messages."""
        return sum(topic.count for topic in self.topics)

    @property
    def record(self) -> FileRecord:
        """The file as the metadata lists it."""
        return FileRecord(self.path.name, self.start_ns, self.end_ns, self.count)


@dataclass(frozen=True, slots=True)
class FileRepair:
    """What was found in one storage file, and what became of it."""

    contents: FileContents
    """What can be read after the repair."""
    unit: str
    """Unit of the offsets of the gaps: bytes, pages."""
    gaps: tuple[tuple[int, int, str], ...]
    """(first, one after the last, reason) of what was stepped over, in ``unit``."""
    notes: tuple[str, ...]
    """What else was wrong and is right now, or is left out; one line each."""
    listed: Counter[str] | None
    """Topic -> number of messages that the file says it has; None if it does not."""
    harmless: bool
    """Whether nothing that had been written whole seems to be missing."""
    sure: bool
    """Whether it is proven that nothing is missing."""
    unchecked: int
    """Number of messages whose bytes no checksum confirms."""
    changed: bool
    """Whether a new file was written; the file was whole otherwise."""
    kept: str = ""
    """Name of the file as it was before."""


@dataclass(slots=True)
class Tally:
    """Time range and counts of the messages written to one file."""

    start_ns: int = 0
    end_ns: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    """Topic -> number of messages."""
    count: int = 0
    """Number of all messages."""

    def add(self, topic: str, log_time_ns: int) -> None:
        """Counts one message."""
        self.start_ns = min(self.start_ns, log_time_ns) if self.count else log_time_ns
        self.end_ns = max(self.end_ns, log_time_ns)
        self.counts[topic] += 1
        self.count += 1


class StorageFile(Protocol):
    """A storage file that is being written. Disk errors are raised as ``OSError``."""

    @property
    def path(self) -> Path:
        """Path of the file."""

    @property
    def full(self) -> bool:
        """Whether the disk was full: later writes use the emergency space."""

    @property
    def size(self) -> int:
        """Size on disk and in memory, bytes."""

    def add_topic(self, topic: TopicRecord, definition: str) -> None:
        """Declares a topic, with the definition of its type and of all nested types."""

    def write(self, topic: str, data: bytes | memoryview, log_time_ns: int, publish_time_ns: int) -> None:
        """Adds one message of a declared topic."""

    def flush(self) -> None:
        """Hands all messages in memory to the kernel, so that they outlive this process."""

    def finish(self, information: Mapping[str, Any]) -> None:
        """Writes the end of the file, after the messages, and closes it; ``information``: metadata of a bag of only this file."""

    def rescue(self) -> None:
        """Closes the file in any state, after an unrecoverable write error. Never raises ``OSError``."""
