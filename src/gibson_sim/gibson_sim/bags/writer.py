"""Writes rosbag2 folders (storage mcap or sqlite3), message by message, at the speed of the disk.

Messages are CDR bytes. A full disk ends the recording but never damages the bag: recorded messages remain readable.
Must not import rclpy.
"""

from __future__ import annotations

import logging
import os
import shutil
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

from gibson_sim.bags.definitions import MessageDefinitions, canonical_type
from gibson_sim.bags.folders import EMERGENCY_BYTES, MIB, DiskFullError, check_room
from gibson_sim.bags.mcap_file import COMPRESSIONS, Compression, McapFile
from gibson_sim.bags.metadata import FileRecord, Profile, TopicQos, TopicRecord, bag_information, write_metadata
from gibson_sim.bags.repairing.bag import Repair, finish, repair
from gibson_sim.bags.sqlite_file import SqliteFile
from gibson_sim.bags.storage import RESERVE_FILE, SUFFIXES, Storage, StorageFile, Tally
from gibson_sim.errors import RecordError
from gibson_sim.quoting import quoted
from gibson_sim.writing import FULL

__all__ = ["EMERGENCY_BYTES", "BagWriter", "Compression", "DiskFullError", "Repair", "Storage", "TopicQos", "repair"]

RESERVE_BYTES = 128 * MIB
"""Default of the free disk space below which recording ends, bytes."""
CHUNK_BYTES = MIB
"""Size at which a chunk is written, bytes."""
CHECK_BYTES = MIB
"""Number of bytes written between two checks of the free space."""
_log = logging.getLogger(__name__)


class BagWriter:
    """Writer of a new bag: a folder with one or more files, and with ``metadata.yaml`` once it is closed.

    Messages stay in memory until their chunk is full or ``flush`` is called, so a crash loses at most the last chunk; ``repair``
    makes the other messages readable. Not thread-safe.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        storage: Storage = "mcap",
        message_definitions: Mapping[str, str] | MessageDefinitions | None = None,
        reserve_bytes: int = RESERVE_BYTES,
        chunk_bytes: int = CHUNK_BYTES,
        compression: Compression = "none",
        max_file_bytes: int = 0,
        max_file_ns: int = 0,
    ) -> None:
        """Creates the folder and the first file.

        Args:
            folder: folder of the bag; must not exist, or be empty.
            storage: storage format of the files.
            message_definitions: text of the ``.msg`` file by type name, for types that are not installed; or the definitions
                of another bag.
            reserve_bytes: free disk space below which recording ends.
            chunk_bytes: size after which a chunk is written; mcap only.
            compression: compression of the chunks; mcap only.
            max_file_bytes: size at which a new file is started; 0 = never.
            max_file_ns: time span of the messages at which a new file is started, nanoseconds; 0 = never.

        Raises:
            RecordError: the folder is not empty or cannot be created, or a setting is invalid.
            DiskFullError: the disk has less free space than ``reserve_bytes``.
        """
        _check(storage, compression, chunk_bytes, reserve_bytes, max_file_bytes, max_file_ns)
        self.folder = Path(folder)
        self._storage: Storage = storage
        given = message_definitions
        self._definitions = given if isinstance(given, MessageDefinitions) else MessageDefinitions(given)
        self._reserve_bytes, self._chunk_bytes, self._compression = reserve_bytes, chunk_bytes, compression
        self._max_file_bytes, self._max_file_ns = max_file_bytes, max_file_ns
        self._topics: dict[str, TopicRecord] = {}
        self._done: list[FileRecord] = []
        self._done_counts: Counter[str] = Counter()
        self._tally = Tally()
        self._end_ns = self._unchecked = 0
        self._closed = False
        self._finished = False
        # False during a write, which Ctrl-C may interrupt, so that the file may be truncated anywhere.
        self._whole = True
        self._emergency = self.folder / RESERVE_FILE
        self._make_folder()
        try:
            self._file = self._new_file()
        except OSError as error:
            self._emergency.unlink(missing_ok=True)
            raise RecordError(f"{self._next_path()} cannot be written: {error.strerror}") from error

    @property
    def message_count(self) -> int:
        """Number of messages written so far."""
        return sum(self._done_counts.values()) + self._tally.count

    @property
    def file_count(self) -> int:
        """Number of files created so far."""
        return len(self._done) + 1

    def add_topic(self, topic: str, type_name: str, qos: TopicQos | Profile | None = None) -> None:
        """Declares a topic; declaring it again with the same type does nothing.

        Args:
            topic: full name, such as ``/camera/image_raw``.
            type_name: ``<package>/msg/<Type>``.
            qos: ``TopicQos`` or ``rclpy.qos.QoSProfile`` for a replay; None = reliable, depth 10.

        Raises:
            RecordError: the type is unknown, or the topic already has another type.
        """
        self._require_open()
        type_name = canonical_type(type_name)
        known = self._topics.get(topic)
        if known is not None:
            if known.type_name != type_name:
                raise RecordError(f"topic {topic} has the type {known.type_name} already, so it cannot also have {type_name}")
            return
        record = TopicRecord(topic, type_name, [TopicQos.of(qos).as_dict()], self._definitions.type_hash(type_name), 0)
        self._whole = False
        try:
            self._file.add_topic(record, self._definitions.full_text(type_name))
        except OSError as error:
            self._rescue(error)
        self._whole = True
        self._topics[topic] = record

    def write(self, topic: str, data: bytes | memoryview, log_time_ns: int, publish_time_ns: int) -> None:
        """Writes one message.

        Args:
            topic: topic that was declared with ``add_topic``.
            data: the message as CDR, with its encapsulation header of four bytes.
            log_time_ns: time by which the bag is ordered, nanoseconds; must not decrease.
            publish_time_ns: time of publication, nanoseconds.

        Raises:
            RecordError: the topic is unknown, the log time decreases, or the bag is closed.
            DiskFullError: the disk is (nearly) full; the bag is closed and complete.
        """
        self._require_open()
        if topic not in self._topics:
            raise RecordError(f"topic {topic} was not declared; known: {', '.join(sorted(self._topics)) or 'none'}")
        if log_time_ns < self._end_ns or log_time_ns < 0:
            raise RecordError(
                f"time runs backwards on {topic}: {log_time_ns} ns after {self._end_ns} ns. The simulation was started anew: "
                "record each run into a bag of its own"
            )
        self._check_space(len(data))
        if self._is_file_long(log_time_ns):
            self.split()
        self._whole = False
        try:
            self._file.write(topic, bytes(data), log_time_ns, publish_time_ns)
        except OSError as error:
            self._rescue(error)
        self._end_ns = log_time_ns
        self._tally.add(topic, log_time_ns)
        self._whole = True
        self._end_if_full()

    def flush(self) -> None:
        """Hands all messages in memory to the kernel, so that they survive a crash of this process.

        Raises:
            DiskFullError: the disk is full; the bag is closed and complete.
        """
        if self._closed:
            return
        self._whole = False
        try:
            self._file.flush()
        except OSError as error:
            self._rescue(error)
        self._whole = True
        self._end_if_full()

    def split(self) -> bool:
        """Closes the current file and starts the next one of the bag; returns False if the current one has no message yet."""
        self._require_open()
        if not self._tally.count:
            return False
        self._whole = False
        try:
            full = self._finish_file()
            write_metadata(self.folder, self._information())
            if not full:
                self._file = self._new_file()
                for topic in self._topics.values():
                    self._file.add_topic(topic, self._definitions.full_text(topic.type_name))
        except OSError as error:
            self._rescue(error)
        self._whole = True
        if full:
            self._closed = self._finished = True
            raise DiskFullError(self._full_text())
        return True

    def close(self) -> None:
        """Writes index and metadata and closes the bag; a second call does nothing.

        Raises:
            RecordError: index or metadata could not be written; the message names the remedy.
        """
        if self._finished:
            return
        is_complete, self._closed = self._whole, True
        try:
            if is_complete:
                self._whole = False
                self._finish_file()
                write_metadata(self.folder, self._information())
                self._emergency.unlink(missing_ok=True)
            else:
                self._file.rescue()
                self._emergency.unlink(missing_ok=True)
                count = finish(self.folder).count
                _log.warning(
                    "recording was interrupted in the middle of a write: %s was closed and holds %d messages", self.folder, count
                )
            self._finished = True
        except OSError as error:
            self._rescue(error)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()

    def _next_path(self) -> Path:
        return self.folder / f"{self.folder.resolve().name}_{len(self._done)}{SUFFIXES[self._storage]}"

    def _new_file(self) -> StorageFile:
        path = self._next_path()
        if self._storage == "sqlite3":
            return SqliteFile(path, self._emergency)
        return McapFile(path, self._emergency, chunk_bytes=self._chunk_bytes, compression=self._compression)

    def _is_file_long(self, log_time_ns: int) -> bool:
        """Returns whether the next message belongs in a new file."""
        if not self._tally.count:
            return False
        too_long = bool(self._max_file_ns) and log_time_ns - self._tally.start_ns >= self._max_file_ns
        return too_long or (bool(self._max_file_bytes) and self._file.size >= self._max_file_bytes)

    def _finish_file(self) -> bool:
        """Writes the end of the current file, after its messages; returns whether the disk is full."""
        self._file.flush()
        record = FileRecord(self._file.path.name, self._tally.start_ns, self._tally.end_ns, self._tally.count)
        topics = [replace(topic, count=self._tally.counts[name]) for name, topic in self._topics.items()]
        self._file.finish(bag_information(topics, [record], self._storage))
        self._done.append(record)
        self._done_counts.update(self._tally.counts)
        self._tally = Tally()
        return self._file.full

    def _information(self) -> dict[str, Any]:
        """Returns the metadata of the finished files."""
        topics = [replace(topic, count=self._done_counts[name]) for name, topic in self._topics.items()]
        return bag_information(topics, self._done, self._storage)

    def _make_folder(self) -> None:
        """Creates the folder with the emergency file, and checks the free space."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if any(self.folder.iterdir()):
                raise RecordError(f"{self.folder} is not empty: bags are never overwritten; choose another folder or delete it")
            check_room(self.folder, self._reserve_bytes)
            with self._emergency.open("xb") as file:
                os.posix_fallocate(file.fileno(), 0, EMERGENCY_BYTES)
        except OSError as error:
            if self._emergency.parent.is_dir():
                self._emergency.unlink(missing_ok=True)
            raise RecordError(
                f"bag folder {self.folder} cannot be used: {error.strerror}; choose a folder that can be written"
            ) from error

    def _require_open(self) -> None:
        if self._closed:
            raise RecordError(f"bag {self.folder} is closed: nothing more can be written")

    def _check_space(self, size: int) -> None:
        """Ends the recording when the free space falls below the reserve."""
        self._unchecked += size
        if self._unchecked < CHECK_BYTES:
            return
        self._unchecked = 0
        try:
            free = shutil.disk_usage(self.folder).free
        except OSError as error:
            self._rescue(error)
        if free < self._reserve_bytes:
            self.close()
            raise DiskFullError(self._full_text())

    def _end_if_full(self) -> None:
        """Ends the recording, with all messages written, once it uses the emergency space."""
        if self._file.full:
            self.close()
            raise DiskFullError(self._full_text())

    def _rescue(self, error: OSError) -> NoReturn:
        """Truncates the current file after its last complete part and closes the bag, after an unrecoverable write error."""
        self._closed = self._finished = True
        try:
            self._file.rescue()
            self._emergency.unlink(missing_ok=True)
            count = finish(self.folder).count
        except (OSError, RecordError) as second:
            raise RecordError(
                f"{self._file.path} could not be finished ({error.strerror}; {second}): make room, "
                f"then run `gibson-sim bag repair {self.folder}`"
            ) from error
        _log.warning("%s: %s was closed", error.strerror, self.folder)
        kind = DiskFullError if error.errno in FULL else RecordError
        raise kind(
            f"the bag cannot grow ({error.strerror}): {self.folder} was closed and holds {count} messages, "
            "all readable; make room and record into a new folder"
        ) from error

    def _full_text(self) -> str:
        return (
            f"the disk is full: {self.folder} was closed and holds all {self.message_count} messages; "
            "make room, or record fewer topics or compressed, into a new folder"
        )


def _check(
    storage: str, compression: str, chunk_bytes: int, reserve_bytes: int, max_file_bytes: int, max_file_ns: int
) -> None:  # fmt: skip
    """Raises RecordError if a setting of a writer is invalid."""
    if storage not in SUFFIXES:
        raise RecordError(f"storage is {quoted(storage)}, must be one of {', '.join(SUFFIXES)}")
    if compression not in COMPRESSIONS:
        raise RecordError(f"compression is {quoted(compression)}, must be one of {', '.join(COMPRESSIONS)}")
    if storage == "sqlite3" and compression != "none":
        raise RecordError(
            f"compression is {quoted(compression)}, must be none with storage sqlite3: only mcap has compressed chunks"
        )
    if chunk_bytes < 1 or reserve_bytes < 0:
        raise RecordError(f"chunk_bytes is {chunk_bytes} and reserve_bytes is {reserve_bytes}; must be at least 1 and 0")
    if max_file_bytes < 0 or max_file_ns < 0:
        raise RecordError(f"max_file_bytes is {max_file_bytes} and max_file_ns is {max_file_ns}; must be 0 (never) or more")
