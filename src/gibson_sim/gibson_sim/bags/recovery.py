"""Makes an mcap file readable whose writer could not finish: after a crash, a power cut or a full disk.

The file is read from the start, chunk by chunk. What follows the last whole chunk is cut off, damaged chunks before it are left
out of the index, and index, statistics, footer and ``metadata.yaml`` are written anew. The records: https://mcap.dev/spec.
"""

from __future__ import annotations

import logging
import os
import struct
from collections import Counter
from dataclasses import dataclass, field
from io import BytesIO, FileIO
from pathlib import Path
from typing import BinaryIO

import yaml
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from gibson_sim.bags.metadata import METADATA_FILE, TopicRecord, bag_information, dump_information, write_metadata
from gibson_sim.errors import RecordError

RESERVE_FILE = ".reserve"
"""Holds disk space while a bag is recorded, to be given up when the disk is full."""
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_FOOTER_BYTES = _RECORD.size + 20 + len(MCAP0_MAGIC)
_KNOWN = frozenset(int(opcode) for opcode in Opcode)
# What the parsers raise on bytes that are not what they should be: struct, text and checksums, absurd lengths, lz4, zstd, mcap.
_DAMAGE = (struct.error, ValueError, KeyError, OverflowError, MemoryError, RuntimeError, zstandard.ZstdError, McapError)
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Repair:
    """What ``repair`` did."""

    file: Path
    messages: int
    """Messages that can be read now."""
    cut_bytes: int
    """Bytes behind the last whole chunk that were cut off."""
    changed: bool = True

    def __str__(self) -> str:
        if not self.changed:
            return f"{self.file} is whole, with {self.messages} messages: nothing to do"
        return f"{self.file} can be read again: {self.messages} messages; {self.cut_bytes} bytes of a broken end were cut off"


@dataclass(slots=True)
class _ChunkEntry:
    """One whole chunk of the file."""

    index: ChunkIndex
    messages: dict[int, list[tuple[int, int]]]
    """(log time, offset in the chunk) of its messages by channel."""
    end: int
    """Offset in the file behind the chunk and the message indices that follow it."""


@dataclass(slots=True)
class _Contents:
    """What stands in the data section of a file, as far as it is whole."""

    start: int = 0
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[_ChunkEntry] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)

    @property
    def end(self) -> int:
        """Offset behind the last whole chunk."""
        return self.chunks[-1].end if self.chunks else self.start


def repair(folder: str | Path) -> Repair:
    """Makes a bag readable that was cut off. A whole bag is left as it is; doing it twice does no harm.

    Raises:
        RecordError: there is no bag, or its beginning is not that of a bag of ours.
    """
    folder = Path(folder)
    files = sorted(folder.glob("*.mcap")) if folder.is_dir() else []
    if len(files) != 1:
        raise RecordError(
            f"{folder} holds {len(files)} mcap files, must be a bag folder with one; give the folder that was recorded"
        )
    path = files[0]
    try:
        count = _count_if_whole(path)
        if count is not None and (folder / METADATA_FILE).is_file():
            return Repair(path, count, 0, changed=False)
        (folder / RESERVE_FILE).unlink(missing_ok=True)
        return rebuild(path)
    except OSError as error:
        raise RecordError(
            f"{path} cannot be repaired: {error.strerror}; make room and check the permissions, then try again"
        ) from error


def rebuild(path: Path) -> Repair:
    """Writes the end of an mcap file and its ``metadata.yaml`` anew.

    If the disk has no room even for these, chunks are given up from the end until there is.

    Raises:
        RecordError: the beginning of the file is not that of a bag.
        OSError: the file cannot be written.
    """
    size = path.stat().st_size
    with path.open("rb") as source:
        contents = _scan(source, size)
    cut = size - contents.end
    # Unbuffered: what could not be written must not be tried again with the next seek.
    with path.open("r+b", buffering=0) as file:
        while True:
            try:
                information = _finish(file, contents, path.name)
                write_metadata(path.parent, information)
                break
            except OSError as error:
                if not contents.chunks:
                    raise
                lost = contents.chunks.pop()
                cut += lost.end - lost.index.chunk_start_offset
                _log.warning("no room for the end of %s (%s): %d messages are given up", path, error.strerror, _count(lost))
    messages = sum(map(_count, contents.chunks))
    return Repair(path, messages, max(cut, 0))


def _count(chunk: _ChunkEntry) -> int:
    return sum(map(len, chunk.messages.values()))


def _count_if_whole(path: Path) -> int | None:
    """Returns the number of messages if the file ends as it should, else None."""
    size = path.stat().st_size
    if size < _FOOTER_BYTES + len(MCAP0_MAGIC):
        return None
    with path.open("rb") as file:
        file.seek(size - _FOOTER_BYTES)
        end = file.read()
        opcode, length = _RECORD.unpack_from(end)
        if not end.endswith(MCAP0_MAGIC) or (opcode, length) != (Opcode.FOOTER, 20):
            return None
        (position,) = struct.unpack_from("<Q", end, _RECORD.size)
        while 0 < position < size - _FOOTER_BYTES:
            file.seek(position)
            opcode, length = _RECORD.unpack(file.read(_RECORD.size))
            if opcode == Opcode.STATISTICS:
                return int(Statistics.read(ReadDataStream(BytesIO(file.read(length)))).message_count)
            position += _RECORD.size + length
    return None


def _scan(file: BinaryIO, size: int) -> _Contents:
    """Reads the data section up to its end or to the first record that is cut off or damaged."""
    contents = _Contents()
    file.seek(0)
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise RecordError(f"{file.name} is not an mcap file: nothing can be repaired")
    while True:
        position = file.tell()
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            break
        opcode, length = _RECORD.unpack(head)
        if position + _RECORD.size + length > size or opcode in (Opcode.DATA_END, Opcode.FOOTER):
            break
        if opcode not in _KNOWN:
            _log.warning("%s is damaged at byte %d", file.name, position)
            break
        try:
            _take(contents, opcode, length, position, file)
        except _DAMAGE as error:
            _log.warning("%s: the record at byte %d is damaged (%s): it is left out", file.name, position, error)
        file.seek(position + _RECORD.size + length)
    if not contents.start:
        raise RecordError(f"{file.name} ends before its first record: nothing was recorded, delete it")
    return contents


def _take(contents: _Contents, opcode: int, length: int, position: int, file: BinaryIO) -> None:
    """Adds one record to the contents."""
    end = position + _RECORD.size + length
    if opcode == Opcode.CHUNK:
        contents.chunks.append(_read_chunk(contents, file.read(length), position))
    elif opcode == Opcode.MESSAGE_INDEX and contents.chunks and position == contents.chunks[-1].end:
        chunk = contents.chunks[-1]
        (channel,) = struct.unpack("<H", file.read(2))
        chunk.index.message_index_offsets[channel] = position
        chunk.index.message_index_length += _RECORD.size + length
        chunk.end = end
    elif opcode == Opcode.METADATA:
        name = Metadata.read(ReadDataStream(BytesIO(file.read(length)))).name
        contents.metadata.append(MetadataIndex(offset=position, length=_RECORD.size + length, name=name))
        # In front of the first chunk it stays; behind the last one it is written anew.
        contents.start = contents.start if contents.chunks else end
    elif opcode == Opcode.HEADER:
        Header.read(ReadDataStream(BytesIO(file.read(length))))
        contents.start = end
    elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and not contents.chunks:
        _add_definition(contents, opcode, file.read(length))
        contents.start = end
    elif opcode == Opcode.MESSAGE:
        raise RecordError(
            f"{file.name} holds messages outside of chunks, so this program did not write it: use `ros2 bag reindex`"
        )


def _add_definition(contents: _Contents, opcode: int, payload: bytes) -> None:
    stream = ReadDataStream(BytesIO(payload))
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        contents.schemas[schema.id] = schema
    else:
        channel = Channel.read(stream)
        contents.channels[channel.id] = channel


def _read_chunk(contents: _Contents, payload: bytes, position: int) -> _ChunkEntry:
    """Reads a whole chunk; raises if it is damaged."""
    chunk = Chunk.read(ReadDataStream(BytesIO(payload)))
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    data = memoryview(stream.read(length))
    if len(data) != chunk.uncompressed_size:
        raise ValueError(f"chunk has {len(data)} bytes, must be {chunk.uncompressed_size}")
    messages: dict[int, list[tuple[int, int]]] = {}
    offset = 0
    while offset < len(data):
        opcode, size = _RECORD.unpack_from(data, offset)
        body = offset + _RECORD.size
        if body + size > len(data):
            raise ValueError("a record in the chunk is longer than the chunk")
        if opcode == Opcode.MESSAGE:
            channel, _, log_time, _ = _MESSAGE.unpack_from(data, body)
            messages.setdefault(channel, []).append((log_time, offset))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            _add_definition(contents, opcode, bytes(data[body : body + size]))
        offset = body + size
    unknown = messages.keys() - contents.channels.keys()
    if unknown:
        raise ValueError(f"the chunk has messages of unknown channels {sorted(unknown)}")
    index = ChunkIndex(
        chunk_length=_RECORD.size + len(payload),
        chunk_start_offset=position,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )
    return _ChunkEntry(index, messages, position + _RECORD.size + len(payload))


def _finish(file: FileIO, contents: _Contents, file_name: str) -> dict[str, object]:
    """Cuts the file behind its last whole chunk and writes everything that follows; returns the bag's information."""
    file.seek(contents.end)
    file.truncate()
    builder = RecordBuilder()
    if contents.chunks:
        _complete_message_index(contents.chunks[-1], builder)
    start, end, counts = _times_and_counts(contents.chunks)
    information = bag_information(_topics(contents, counts), file_name, start, end)
    position = contents.end
    metadata = [m for m in contents.metadata if m.offset < position]
    metadata.append(MetadataIndex(offset=position + builder.count, length=0, name="rosbag2"))
    before = builder.count
    Metadata(name="rosbag2", metadata={"serialized_metadata": dump_information(information)}).write(builder)
    metadata[-1].length = builder.count - before
    DataEnd(0).write(builder)
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(contents.channels),
        channel_message_counts=dict(counts),
        chunk_count=len(contents.chunks),
        message_count=sum(counts.values()),
        message_end_time=end,
        message_start_time=start,
        metadata_count=len(metadata),
        schema_count=len(contents.schemas),
    )
    summary_start = position + builder.count
    groups = (
        (Opcode.SCHEMA, list(contents.schemas.values())),
        (Opcode.CHANNEL, list(contents.channels.values())),
        (Opcode.STATISTICS, [statistics]),
        (Opcode.CHUNK_INDEX, [chunk.index for chunk in contents.chunks]),
        (Opcode.METADATA_INDEX, metadata),
    )
    offsets = []
    for opcode, records in groups:
        group = position + builder.count
        for record in records:
            record.write(builder)
        offsets.append(SummaryOffset(group_opcode=opcode, group_start=group, group_length=position + builder.count - group))
    offset_start = position + builder.count
    for offset in offsets:
        offset.write(builder)
    # A checksum of 0 means: none.
    Footer(summary_start=summary_start, summary_offset_start=offset_start, summary_crc=0).write(builder)
    builder.write(MCAP0_MAGIC)
    rest = memoryview(builder.end())  # type: ignore[no-untyped-call]
    while rest:
        rest = rest[file.write(rest) :]
    os.fsync(file.fileno())
    return information


def _complete_message_index(chunk: _ChunkEntry, builder: RecordBuilder) -> None:
    """Writes the message indices of the last chunk that had not reached the disk."""
    for channel, messages in chunk.messages.items():
        if channel in chunk.index.message_index_offsets:
            continue
        before = builder.count
        chunk.index.message_index_offsets[channel] = chunk.end + before
        MessageIndex(channel_id=channel, records=messages).write(builder)
        chunk.index.message_index_length += builder.count - before


def _times_and_counts(chunks: list[_ChunkEntry]) -> tuple[int, int, Counter[int]]:
    """Returns the times of the first and the last message, 0 if there is none, and the number of messages by channel."""
    counts: Counter[int] = Counter()
    for chunk in chunks:
        for channel, messages in chunk.messages.items():
            counts[channel] += len(messages)
    filled = [chunk.index for chunk in chunks if chunk.messages]
    start = min((index.message_start_time for index in filled), default=0)
    return start, max((index.message_end_time for index in filled), default=0), counts


def _topics(contents: _Contents, counts: Counter[int]) -> list[TopicRecord]:
    records = []
    for channel in contents.channels.values():
        qos = yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or []
        schema = contents.schemas.get(channel.schema_id)
        type_hash = channel.metadata.get("topic_type_hash", "")
        records.append(TopicRecord(channel.topic, schema.name if schema else "", qos, type_hash, counts[channel.id]))
    return records
