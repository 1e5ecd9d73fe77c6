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
    cut_bytes: int = 0
    """Number of bytes of a damaged end that were cut off."""
    whole: bool = True
    """Whether the file was already complete and was not changed."""

    @property
    def count(self) -> int:
        """Number of messages."""
        return sum(topic.count for topic in self.topics)

    @property
    def record(self) -> FileRecord:
        """The file as the metadata lists it."""
        return FileRecord(self.path.name, self.start_ns, self.end_ns, self.count)


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
        if not self.count:
            self.start_ns = log_time_ns
        self.end_ns = log_time_ns
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
