"""Writes rosbag2 folders (storage mcap), message by message, as fast as the disk takes them.

The messages come as CDR bytes. A disk that runs full ends the recording, but never the bag: what was recorded stays readable.
Must not import rclpy.
"""

from __future__ import annotations

import errno
import logging
import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Literal, NoReturn

from mcap.writer import CompressionType, IndexType, Writer as McapWriter

from gibson_sim.bags.definitions import MessageDefinitions, canonical_type
from gibson_sim.bags.metadata import Profile, TopicQos, TopicRecord, bag_information, dump_information, dump_qos, write_metadata
from gibson_sim.bags.recovery import RESERVE_FILE, Repair, rebuild, repair
from gibson_sim.errors import RecordError

__all__ = ["BagWriter", "Compression", "DiskFullError", "Repair", "TopicQos", "repair"]

Compression = Literal["none", "zstd", "lz4"]
MIB = 1024 * 1024
RESERVE_BYTES = 128 * MIB
CHUNK_BYTES = MIB
"""A chunk ends with the message that makes it longer than this. Larger chunks are slower to write and to read from."""
EMERGENCY_BYTES = 8 * MIB
"""Size of the file that is given up when the disk is full: room for the chunk in hand, the index and the metadata."""
CHECK_BYTES = MIB
"""Free space is asked for each time that so many bytes were written."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_COMPRESSIONS = {"none": CompressionType.NONE, "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}
_log = logging.getLogger(__name__)


class DiskFullError(RecordError):
    """The disk is full, or nearly so. The bag was closed and holds everything up to here."""


class _Sink:
    """An unbuffered file that, when the disk is full, gives up the emergency file and goes on."""

    def __init__(self, path: Path, emergency: Path) -> None:
        self._emergency = emergency
        self._file: BinaryIO | None = path.open("xb", buffering=0)
        self._position = 0
        self.full = False
        """True once the disk was full: what is written since lives on the emergency space."""

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            try:
                written = self._open_file().write(view)
            except OSError as error:
                if error.errno not in _FULL or self.full:
                    raise
                self.full = True
                self._emergency.unlink(missing_ok=True)
                continue
            self._position += written
            view = view[written:]
        return len(data)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Nothing waits here."""

    def close(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _open_file(self) -> BinaryIO:
        assert self._file is not None, "the file is closed"
        return self._file


class BagWriter:
    """A bag that is being written: a new folder with one mcap file, and with ``metadata.yaml`` once it is closed.

    Messages wait in memory until their chunk is full, so a crash loses the last chunk at most; ``repair`` makes the rest
    readable. Not thread-safe: one thread calls.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        message_definitions: Mapping[str, str] | None = None,
        reserve_bytes: int = RESERVE_BYTES,
        chunk_bytes: int = CHUNK_BYTES,
        compression: Compression = "none",
    ) -> None:
        """Makes the folder and the file.

        Args:
            folder: must not exist, or be empty.
            message_definitions: text of the ``.msg`` file by type name, for types that are not installed.
            reserve_bytes: recording ends when the disk has less than this left.
            chunk_bytes: size from which on a chunk is written.
            compression: of the chunks.

        Raises:
            RecordError: the folder is not empty or cannot be made, or a setting is impossible.
            DiskFullError: the disk has less than ``reserve_bytes`` left already.
        """
        if compression not in _COMPRESSIONS:
            raise RecordError(f"compression is {compression!r}, must be one of {', '.join(_COMPRESSIONS)}")
        if chunk_bytes < 1 or reserve_bytes < 0:
            raise RecordError(f"chunk_bytes is {chunk_bytes} and reserve_bytes is {reserve_bytes}; must be at least 1 and 0")
        self.folder = Path(folder)
        self._definitions = MessageDefinitions(message_definitions)
        self._reserve_bytes = reserve_bytes
        self._topics: dict[str, TopicRecord] = {}
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._start_ns = self._end_ns = 0
        self._unchecked = 0
        self._closed = False
        self._finished = False
        # False while a write is under way: Ctrl-C may come in the middle of it, and what lies on the disk then ends anywhere.
        self._whole = True
        self._path = self.folder / f"{self.folder.resolve().name}_0.mcap"
        self._emergency = self.folder / RESERVE_FILE
        self._make_folder()
        indices = IndexType.CHUNK | IndexType.MESSAGE | IndexType.METADATA
        try:
            self._sink = _Sink(self._path, self._emergency)
            self._writer = McapWriter(self._sink, chunk_bytes, _COMPRESSIONS[compression], index_types=indices)  # type: ignore[arg-type]
            self._writer.start(profile="ros2", library="gibson_sim")
        except OSError as error:
            self._emergency.unlink(missing_ok=True)
            raise RecordError(f"{self._path} cannot be written: {error.strerror}") from error

    @property
    def message_count(self) -> int:
        """Messages taken so far."""
        return sum(self._counts.values())

    def add_topic(self, topic: str, type_name: str, qos: TopicQos | Profile | None = None) -> None:
        """Declares a topic; again with the same type does nothing.

        Args:
            topic: full name, such as ``/camera/image_raw``.
            type_name: ``<package>/msg/<Type>``.
            qos: ``TopicQos`` or ``rclpy.qos.QoSProfile``, with which a replay publishes it; None = reliable, depth 10.

        Raises:
            RecordError: the type is unknown, or the topic has another one already.
        """
        self._require_open()
        type_name = canonical_type(type_name)
        known = self._topics.get(topic)
        if known is not None:
            if known.type_name != type_name:
                raise RecordError(f"topic {topic} has the type {known.type_name} already, so it cannot also have {type_name}")
            return
        text, type_hash = self._definitions.full_text(type_name), self._definitions.type_hash(type_name)
        profiles = [TopicQos.of(qos).as_dict()]
        self._whole = False
        try:
            if type_name not in self._schemas:
                self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", text.encode())
            extra = {"offered_qos_profiles": dump_qos(profiles), "topic_type_hash": type_hash}
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[type_name], extra)
        except OSError as error:
            self._rescue(error)
        self._whole = True
        self._topics[topic] = TopicRecord(topic, type_name, profiles, type_hash, 0)
        self._counts[topic] = 0

    def write(self, topic: str, data: bytes | memoryview, log_time_ns: int, publish_time_ns: int) -> None:
        """Writes one message.

        Args:
            topic: declared with ``add_topic``.
            data: the message as CDR, with its four bytes of encapsulation.
            log_time_ns: time that the bag is ordered by, nanoseconds; must not run backwards.
            publish_time_ns: time at which it was published, nanoseconds.

        Raises:
            RecordError: the topic is unknown, time runs backwards, or the bag is closed.
            DiskFullError: the disk is (nearly) full; the bag is closed, and whole.
        """
        self._require_open()
        channel = self._channels.get(topic)
        if channel is None:
            raise RecordError(f"topic {topic} was not declared; known: {', '.join(sorted(self._channels)) or 'none'}")
        if log_time_ns < self._end_ns or log_time_ns < 0:
            raise RecordError(
                f"time runs backwards on {topic}: {log_time_ns} ns after {self._end_ns} ns. The simulation was started anew: "
                "record each run into a bag of its own"
            )
        self._check_space(len(data))
        if not self.message_count:
            self._start_ns = log_time_ns
        self._end_ns = log_time_ns
        self._whole = False
        try:
            self._writer.add_message(channel, log_time_ns, data, publish_time_ns)  # type: ignore[arg-type]
        except OSError as error:
            self._rescue(error)
        self._counts[topic] += 1
        self._whole = True
        if self._sink.full:
            self.close()
            raise DiskFullError(self._full_text())

    def close(self) -> None:
        """Writes index and metadata and closes the bag; a second time does nothing.

        Raises:
            RecordError: the end could not be written; the message says what is left to do.
        """
        if self._finished:
            return
        whole, self._closed = self._whole, True
        try:
            if whole:
                self._whole = False
                self._finish()
            else:
                self._sink.close()
                self._emergency.unlink(missing_ok=True)
                _log.warning("recording was interrupted in the middle of a write: %s", rebuild(self._path))
            self._finished = True
        except OSError as error:
            self._rescue(error)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()

    def _finish(self) -> None:
        """Writes everything that follows the messages."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        topics = [replace(topic, count=self._counts[name]) for name, topic in self._topics.items()]
        information = bag_information(topics, self._path.name, self._start_ns, self._end_ns)
        self._writer.add_metadata("rosbag2", {"serialized_metadata": dump_information(information)})
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._sink.close()
        self._emergency.unlink(missing_ok=True)
        write_metadata(self.folder, information)

    def _make_folder(self) -> None:
        """Makes the folder and the emergency file in it, and checks the free space."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if any(self.folder.iterdir()):
                raise RecordError(f"{self.folder} is not empty: bags are never overwritten; choose another folder or delete it")
            free = shutil.disk_usage(self.folder).free
            if free < self._reserve_bytes + EMERGENCY_BYTES:
                raise DiskFullError(
                    f"the disk of {self.folder} has {free / MIB:.0f} MiB left, recording needs more than "
                    f"{(self._reserve_bytes + EMERGENCY_BYTES) / MIB:.0f} MiB: make room, choose another disk or reserve less"
                )
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
        """Ends the recording while the disk still has the reserve."""
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

    def _rescue(self, error: OSError) -> NoReturn:
        """Cuts the file back to its last whole chunk and closes the bag, after a write that failed for good."""
        self._closed = self._finished = True
        try:
            self._sink.close()
            self._emergency.unlink(missing_ok=True)
            result = rebuild(self._path)
        except (OSError, RecordError) as second:
            raise RecordError(
                f"{self._path} could not be finished ({error.strerror}; {second}): make room, "
                f"then run `gibson-sim bag repair {self.folder}`"
            ) from error
        _log.warning("%s: %s", error.strerror, result)
        kind = DiskFullError if error.errno in _FULL else RecordError
        raise kind(
            f"the bag cannot grow ({error.strerror}): {self.folder} was closed and holds {result.messages} messages, "
            "all readable; make room and record into a new folder"
        ) from error

    def _full_text(self) -> str:
        return (
            f"the disk is full: {self.folder} was closed and holds all {self.message_count} messages; "
            "make room, or record fewer topics or compressed, into a new folder"
        )
