"""Writes mcap files chunk by chunk, without copying large messages, and the summary at their end. Records: https://mcap.dev/spec.

Large messages, mostly images, are in separate chunks, so that a reader of other topics need not read gigabytes of images.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Literal

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from gibson_sim.bags.metadata import TopicRecord, dump_information, dump_qos
from gibson_sim.writing import FULL

Compression = Literal["none", "zstd", "lz4"]
COMPRESSIONS: tuple[Compression, ...] = ("none", "zstd", "lz4")
RECORD = struct.Struct("<BQ")
"""Opcode and length of a record."""
MESSAGE = struct.Struct("<HIQQ")
"""Channel, sequence number, log time and publish time of a message."""
_MESSAGE_RECORD = struct.Struct("<BQHIQQ")
"""``RECORD`` and ``MESSAGE``."""
CHUNK_TIMES = struct.Struct("<QQQI")
"""First and last log time, uncompressed size and checksum of a chunk."""
_INDEX_HEAD = struct.Struct("<BQHI")
"""``RECORD``, channel, and length of the entries in bytes."""
_INDEX_ENTRY = struct.Struct("<QQ")
"""Log time of a message, and its offset in the chunk."""
LARGE_BYTES = 32 * 1024
"""Size from which a message is written from its own memory, into chunks of large messages; smaller ones are copied into a buffer."""
_SPAN_NS = 1_000_000_000
"""Maximum time for which small messages stay in memory while large ones are written, nanoseconds of log time."""


class McapFile:
    """An mcap file that is being written. Written chunks remain readable after a crash of this process."""

    def __init__(self, path: Path, emergency: Path, *, chunk_bytes: int, compression: Compression) -> None:
        """Creates the file.

        Raises:
            OSError: the file cannot be created.
        """
        self._path = path
        self._sink = Sink(path, emergency)
        self._chunk_bytes, self._compression = chunk_bytes, compression
        self._section = DataSection()
        self._small, self._large = _Chunk(set()), _Chunk(set())
        self._channels: dict[str, int] = {}
        self._descriptions: dict[int, bytes] = {}
        self._schemas: dict[str, int] = {}
        builder = RecordBuilder()
        builder.write(MCAP0_MAGIC)
        Header("ros2", "gibson_sim").write(builder)
        self._sink.write(builder.end())  # type: ignore[no-untyped-call]

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self._path

    @property
    def full(self) -> bool:
        """Whether the disk was full: later writes use the emergency space."""
        return self._sink.full

    @property
    def size(self) -> int:
        """Size on disk and in memory, bytes."""
        return self._sink.position + self._small.size + self._large.size

    def add_topic(self, topic: TopicRecord, definition: str) -> None:
        """Declares a topic, with the definition of its type and of all nested types. Written immediately, since either chunk may be written next."""
        builder = RecordBuilder()
        schema_id = self._schemas.get(topic.type_name)
        if schema_id is None:
            schema_id = self._schemas[topic.type_name] = len(self._schemas) + 1
            schema = Schema(id=schema_id, data=definition.encode(), encoding="ros2msg", name=topic.type_name)
            schema.write(builder)
            self._section.schemas[schema_id] = schema
        extra = {"offered_qos_profiles": dump_qos(topic.qos), "topic_type_hash": topic.type_hash}
        channel_id = len(self._channels) + 1
        channel = Channel(id=channel_id, topic=topic.name, message_encoding="cdr", metadata=extra, schema_id=schema_id)
        channel.write(builder)
        self._section.channels[channel_id] = channel
        self._channels[topic.name] = channel_id
        self._sink.write(builder.end())  # type: ignore[no-untyped-call]
        self._section.schemas[channel.schema_id].write(builder)
        channel.write(builder)
        self._descriptions[channel_id] = bytes(builder.end())  # type: ignore[no-untyped-call]

    def write(self, topic: str, data: bytes | memoryview, log_time_ns: int, publish_time_ns: int) -> None:
        """Adds one message of a declared topic."""
        chunk, channel = self._large if len(data) >= LARGE_BYTES else self._small, self._channels[topic]
        if channel not in chunk.described:
            # Outside of chunks a description has no checksum.
            chunk.describe(channel, self._descriptions[channel])
        chunk.add_message(channel, data, log_time_ns, publish_time_ns)
        if chunk.size - chunk.described_bytes > self._chunk_bytes:
            if chunk is self._large and self._small.messages and log_time_ns - self._small.start_ns > _SPAN_NS:
                self._write_indexed(self._small)
            self._write_indexed(chunk)

    def flush(self) -> None:
        """Writes the unfinished chunks that have messages."""
        for chunk in (self._small, self._large):
            if chunk.messages:
                self._write_indexed(chunk)

    def _write_indexed(self, chunk: _Chunk) -> None:
        """Writes a chunk and its message indices, and starts the next one in its place."""
        position = self._sink.position
        index = self._write_chunk(chunk)
        end = position + index.chunk_length
        indices = bytearray()
        for channel, messages in chunk.messages.items():
            index.message_index_offsets[channel] = end + len(indices)
            indices += message_index(channel, messages)
        index.message_index_length = len(indices)
        self._sink.write(indices)
        counts = Counter({channel: len(messages) for channel, messages in chunk.messages.items()})
        self._section.chunks.append(ChunkEntry(index, counts, self._sink.position))
        if chunk is self._large:
            self._large = _Chunk(chunk.described)
        else:
            self._small = _Chunk(chunk.described)

    def _write_chunk(self, chunk: _Chunk) -> ChunkIndex:
        """Writes the chunk record; returns its index, without the message indices that follow."""
        crc = 0
        for part in chunk.parts:
            crc = zlib.crc32(part, crc)
        parts, size = chunk.parts, chunk.size
        if self._compression != "none":
            packed = _compress(b"".join(parts), self._compression)
            parts, size = [packed], len(packed)
        name = b"" if self._compression == "none" else self._compression.encode()
        times = CHUNK_TIMES.pack(chunk.start_ns, chunk.end_ns, chunk.size, crc)
        body = times + struct.pack("<I", len(name)) + name + struct.pack("<Q", size)
        position = self._sink.position
        self._sink.write(RECORD.pack(Opcode.CHUNK, len(body) + size) + body)
        for part in parts:
            self._sink.write(part)
        return ChunkIndex(
            chunk_length=self._sink.position - position,
            chunk_start_offset=position,
            compression=name.decode(),
            compressed_size=size,
            message_end_time=chunk.end_ns,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=chunk.start_ns,
            uncompressed_size=chunk.size,
        )

    def finish(self, information: Mapping[str, Any]) -> None:
        """Writes metadata, summary and footer and closes the file."""
        self.flush()
        self._sink.write(end_of_file(self._section, self._sink.position, information))
        self._sink.close()

    def rescue(self) -> None:
        """Closes the file as it is."""
        self._sink.close()


class _Chunk:
    """A chunk that is being filled."""

    def __init__(self, described: set[int]) -> None:
        """Starts a chunk; ``described``: channels that earlier chunks describe, and that this one will."""
        self.described, self.described_bytes = described, 0
        self.parts: list[bytes | bytearray | memoryview] = []
        self.size = 0
        self.start_ns = self.end_ns = 0
        self.messages: dict[int, list[tuple[int, int]]] = {}
        self._gathered: bytearray | None = None

    def add(self, data: bytes | memoryview) -> None:
        """Appends bytes of a record."""
        if len(data) >= LARGE_BYTES:
            self.parts.append(data)
            self._gathered = None
        else:
            if self._gathered is None:
                self._gathered = bytearray()
                self.parts.append(self._gathered)
            self._gathered += data
        self.size += len(data)

    def describe(self, channel: int, records: bytes) -> None:
        """Appends the descriptions of a channel and its type."""
        self.described.add(channel)
        self.described_bytes += len(records)
        self.add(records)

    def add_message(self, channel: int, data: bytes | memoryview, log_time_ns: int, publish_time_ns: int) -> None:
        """Appends one message."""
        self.start_ns = min(self.start_ns, log_time_ns) if self.messages else log_time_ns
        self.end_ns = max(self.end_ns, log_time_ns)
        self.messages.setdefault(channel, []).append((log_time_ns, self.size))
        length = MESSAGE.size + len(data)
        self.add(_MESSAGE_RECORD.pack(Opcode.MESSAGE, length, channel, 0, log_time_ns, publish_time_ns))
        self.add(data)


def _compress(data: bytes, compression: Compression) -> bytes:
    if compression == "zstd":
        return bytes(zstandard.compress(data))
    return bytes(lz4.frame.compress(data))


@dataclass(slots=True)
class ChunkEntry:
    """One complete chunk of a file."""

    index: ChunkIndex
    counts: Counter[int]
    """Channel -> number of messages."""
    end: int
    """Offset in the file after the chunk and its message indices."""


@dataclass(slots=True)
class DataSection:
    """Content of the data section of a file."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkEntry] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)

    def times_and_counts(self) -> tuple[int, int, Counter[int]]:
        """Returns the times of the first and the last message, 0 without messages, and channel -> number of messages."""
        counts: Counter[int] = Counter()
        for chunk in self.chunks:
            counts.update(chunk.counts)
        filled = [chunk.index for chunk in self.chunks if chunk.counts]
        start = min((index.message_start_time for index in filled), default=0)
        return start, max((index.message_end_time for index in filled), default=0), counts


def end_of_file(section: DataSection, position: int, information: Mapping[str, Any]) -> bytes:
    """Returns the end of the file, after the last chunk and its message indices: metadata, summary and footer.

    Args:
        section: the data section before it.
        position: offset of the result in the file.
        information: metadata of a bag of this file alone.
    """
    start, end, counts = section.times_and_counts()
    builder = RecordBuilder()
    Metadata(name="rosbag2", metadata={"serialized_metadata": dump_information(dict(information))}).write(builder)
    metadata = [m for m in section.metadata if m.offset < position]
    metadata.append(MetadataIndex(offset=position, length=builder.count, name="rosbag2"))
    DataEnd(0).write(builder)
    statistics = Statistics(
        attachment_count=len(section.attachments),
        channel_count=len(section.channels),
        channel_message_counts=dict(counts),
        chunk_count=len(section.chunks),
        message_count=sum(counts.values()),
        message_end_time=end,
        message_start_time=start,
        metadata_count=len(metadata),
        schema_count=len(section.schemas),
    )
    summary_start = position + builder.count
    groups = (
        (Opcode.SCHEMA, list(section.schemas.values())),
        (Opcode.CHANNEL, list(section.channels.values())),
        (Opcode.STATISTICS, [statistics]),
        (Opcode.CHUNK_INDEX, [chunk.index for chunk in section.chunks]),
        (Opcode.ATTACHMENT_INDEX, section.attachments),
        (Opcode.METADATA_INDEX, metadata),
    )
    offsets = []
    for opcode, records in groups:
        if not records:
            continue
        group = position + builder.count
        for record in records:
            record.write(builder)
        offsets.append(SummaryOffset(group_opcode=opcode, group_start=group, group_length=position + builder.count - group))
    offset_start = position + builder.count
    for offset in offsets:
        offset.write(builder)
    # The checksum covers the summary and the footer up to the checksum itself.
    Footer(summary_start=summary_start, summary_offset_start=offset_start, summary_crc=0).write(builder)
    written = bytearray(builder.end())  # type: ignore[no-untyped-call]
    crc = zlib.crc32(memoryview(written)[summary_start - position : -4])
    return bytes(written[:-4]) + struct.pack("<I", crc) + MCAP0_MAGIC


def message_index(channel: int, messages: list[tuple[int, int]]) -> bytes:
    """Returns the index record of one channel in a chunk.

    Args:
        channel: id of the channel.
        messages: (log time, offset in the chunk) of each message.
    """
    length = len(messages) * _INDEX_ENTRY.size
    head = _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + length, channel, length)
    return head + b"".join([_INDEX_ENTRY.pack(*message) for message in messages])


class Sink:
    """An unbuffered file that deletes the emergency file and continues when the disk is full."""

    def __init__(self, path: Path, emergency: Path) -> None:
        """Creates the file.

        Raises:
            OSError: the file already exists or cannot be created.
        """
        self._emergency = emergency
        self._file: BinaryIO | None = path.open("xb", buffering=0)
        self.position = 0
        """Number of bytes written."""
        self.full = False
        """Whether the disk was full: later writes use the emergency space."""

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Writes all of ``data``.

        Raises:
            OSError: the disk is full and the emergency space is exhausted, or the write fails for another reason.
        """
        view = memoryview(data)
        while view:
            try:
                written = self._open_file().write(view)
            except OSError as error:
                if error.errno not in FULL or self.full:
                    raise
                self.full = True
                self._emergency.unlink(missing_ok=True)
                continue
            self.position += written
            view = view[written:]

    def close(self) -> None:
        """Closes the file; a second call does nothing."""
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _open_file(self) -> BinaryIO:
        assert self._file is not None, "the file is closed"
        return self._file
