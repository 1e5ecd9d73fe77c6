"""What the two kinds of storage file, mcap and sqlite3, have in common for those who write and mend them."""

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
"""Holds disk space while a bag is recorded, to be given up when the disk is full."""


class EmptyFileError(RecordError):
    """A storage file ends before its first record: its writer was killed before it wrote anything."""


@dataclass(frozen=True, slots=True)
class FileContents:
    """What can be read in one storage file."""

    path: Path
    start_ns: int
    """Log time of the first message, nanoseconds; 0 if there is none."""
    end_ns: int
    """Log time of the last message, nanoseconds; 0 if there is none."""
    topics: tuple[TopicRecord, ...]
    """With the numbers of messages in this file."""
    cut_bytes: int = 0
    """Bytes of a broken end that were cut off."""
    whole: bool = True
    """It was whole already, and was left as it is."""

    @property
    def count(self) -> int:
        """Messages."""
        return sum(topic.count for topic in self.topics)

    @property
    def record(self) -> FileRecord:
        """The file as the metadata lists it."""
        return FileRecord(self.path.name, self.start_ns, self.end_ns, self.count)


@dataclass(slots=True)
class Tally:
    """Times and numbers of the messages that were written into one file."""

    start_ns: int = 0
    end_ns: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    """Messages by topic."""
    count: int = 0
    """Messages."""

    def add(self, topic: str, log_time_ns: int) -> None:
        """Counts one message."""
        if not self.count:
            self.start_ns = log_time_ns
        self.end_ns = log_time_ns
        self.counts[topic] += 1
        self.count += 1


class StorageFile(Protocol):
    """One file of a bag that is being written. Errors of the disk come as ``OSError``."""

    @property
    def path(self) -> Path:
        """Where it lies."""

    @property
    def full(self) -> bool:
        """The disk was full: what was written since lives on the emergency space."""

    @property
    def size(self) -> int:
        """Bytes on the disk and in hand."""

    def add_topic(self, topic: TopicRecord, definition: str) -> None:
        """Declares a topic, with the text of its type and of all types nested in it."""

    def write(self, topic: str, data: bytes | memoryview, log_time_ns: int, publish_time_ns: int) -> None:
        """Takes one message of a declared topic."""

    def flush(self) -> None:
        """Hands everything in hand to the kernel, so that it outlives this process."""

    def finish(self, information: Mapping[str, Any]) -> None:
        """Writes what follows the messages and closes the file; ``information`` is that of a bag of this file alone."""

    def rescue(self) -> None:
        """Closes the file, whatever state it is in, after a write that failed for good. Never raises ``OSError``."""
