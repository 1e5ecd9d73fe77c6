"""Repairs a bag whose writer could not finish: after a crash, a power cut or a full disk.

An mcap file is read from the start, chunk by chunk. It is truncated after the last complete chunk, damaged chunks before that are left out
of the index, and index, statistics and footer are rewritten. The log of a database is merged into it. Then ``metadata.yaml`` is rewritten
for all files. Records of mcap: https://mcap.dev/spec.
"""

from __future__ import annotations

import logging
import os
import re
import struct
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO, FileIO
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Header, Metadata, MetadataIndex, Schema, Statistics
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from gibson_sim.bags.mcap_file import MESSAGE, RECORD, ChunkEntry, DataSection, end_of_file, message_index
from gibson_sim.bags.metadata import TopicRecord, bag_information, offered_qos, read_metadata, write_metadata
from gibson_sim.bags.sqlite_file import repair_database
from gibson_sim.bags.storage import RESERVE_FILE, SUFFIXES, EmptyFileError, FileContents, Storage
from gibson_sim.errors import RecordError

_FOOTER_BYTES = RECORD.size + 20 + len(MCAP0_MAGIC)
_KNOWN = frozenset(int(opcode) for opcode in Opcode)
# Exceptions of the parsers for damaged bytes: struct, text and checksums, absurd lengths, lz4, zstd, mcap.
_DAMAGE = (struct.error, ValueError, KeyError, OverflowError, MemoryError, RuntimeError, zstandard.ZstdError, McapError)
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Repair:
    """Result of ``repair``."""

    folder: Path
    files: int
    """Number of readable files."""
    messages: int
    """Number of readable messages."""
    cut_bytes: int
    """Number of bytes after the last complete chunk that were cut off."""
    changed: bool = True

    def __str__(self) -> str:
        files = "" if self.files == 1 else f" in {self.files} files"
        if not self.changed:
            return f"{self.folder} is whole, with {self.messages} messages{files}: nothing to do"
        cut = f"; {self.cut_bytes} bytes of a broken end were cut off" if self.cut_bytes else ""
        return f"{self.folder} can be read again: {self.messages} messages{files}{cut}"


@dataclass(slots=True)
class _Section(DataSection):
    """The complete part of the data section of a file."""

    start: int = 0
    """Offset of the end of the records before the first chunk."""
    last_messages: dict[int, list[tuple[int, int]]] = field(default_factory=dict)
    """Channel -> (log time, offset in the chunk) of the messages of the last chunk."""

    @property
    def end(self) -> int:
        """Offset of the end of the last complete chunk."""
        return self.chunks[-1].end if self.chunks else self.start


def repair(folder: str | Path) -> Repair:
    """Repairs a bag whose recording was cut off. Leaves a complete bag unchanged; idempotent.

    Raises:
        RecordError: the bag does not exist, or was not written by this program.
    """
    folder = Path(folder)
    storage, paths = _storage_files(folder)
    contents: list[FileContents] = []
    try:
        (folder / RESERVE_FILE).unlink(missing_ok=True)
        for path in paths:
            try:
                # On a full disk, the last file makes room for the metadata as well.
                contents.append(
                    _repair_file(path, storage, lambda repaired: _write_metadata(folder, storage, [*contents, repaired]))
                )
            except EmptyFileError as error:
                if len(paths) == 1:
                    raise
                _log.warning("%s: it is left out", error)
        messages, cut = sum(c.count for c in contents), sum(c.cut_bytes for c in contents)
        listed = _is_listed(folder, contents)
        if not listed:
            _write_metadata(folder, storage, contents)
        changed = not listed or any(not c.whole for c in contents)
        return Repair(folder, len(contents), messages, cut, changed)
    except OSError as error:
        raise RecordError(
            f"{folder} cannot be repaired: {error.strerror}; make room and check the permissions, then try again"
        ) from error


def _storage_files(folder: Path) -> tuple[Storage, list[Path]]:
    """Returns the storage format of a bag, and its files in order.

    Raises:
        RecordError: the bag has no storage files, or files of two formats.
    """
    paths_of: dict[Storage, list[Path]] = {kind: sorted(folder.glob("*" + s), key=_number) for kind, s in SUFFIXES.items()}
    kinds = [kind for kind, paths in paths_of.items() if paths]
    if len(kinds) != 1:
        what = "files of both mcap and sqlite3" if kinds else "no mcap or db3 file"
        raise RecordError(f"{folder} holds {what}, must be the folder of one bag; give the folder that was recorded")
    return kinds[0], paths_of[kinds[0]]


def _number(path: Path) -> tuple[int, str]:
    """Returns a sort key that sorts ``bag_10`` after ``bag_9``."""
    match = re.search(r"_(\d+)$", path.stem)
    return int(match[1]) if match else 0, path.name


def _is_listed(folder: Path, contents: list[FileContents]) -> bool:
    """Returns whether the metadata lists exactly these files with all their messages."""
    information = read_metadata(folder)
    listed = information.get("relative_file_paths"), information.get("message_count")
    return listed == ([c.path.name for c in contents], sum(c.count for c in contents))


def _write_metadata(folder: Path, storage: Storage, contents: list[FileContents]) -> None:
    """Writes ``metadata.yaml`` for a bag of these files."""
    topics: dict[str, TopicRecord] = {}
    for topic in (topic for c in contents for topic in c.topics):
        earlier = topics.get(topic.name)
        count = topic.count + (earlier.count if earlier else 0)
        topics[topic.name] = TopicRecord(topic.name, topic.type_name, topic.qos, topic.type_hash, count)
    write_metadata(folder, bag_information(list(topics.values()), [c.record for c in contents], storage))


def _repair_file(path: Path, storage: Storage, write_bag_metadata: Callable[[FileContents], None]) -> FileContents:
    """Repairs one file and returns its content."""
    if storage == "sqlite3":
        return repair_database(path)
    return _contents_if_whole(path) or _rebuild(path, write_bag_metadata)


def _rebuild(path: Path, write_bag_metadata: Callable[[FileContents], None]) -> FileContents:
    """Rewrites the end of an mcap file, and the metadata of the bag.

    If the disk is too full even for these, chunks are dropped from the end until they fit.

    Raises:
        RecordError: the file does not begin like an mcap file.
        OSError: the file cannot be written.
    """
    size = path.stat().st_size
    with path.open("rb") as source:
        section = _scan(source, size)
    cut = size - section.end
    # Unbuffered: a failed write must not be repeated by the next seek.
    with path.open("r+b", buffering=0) as file:
        while True:
            recovered = _file_contents(path, section, max(cut, 0))
            try:
                _finish(file, section, recovered)
                write_bag_metadata(recovered)
                return recovered
            except OSError as error:
                if not section.chunks:
                    raise
                dropped = section.chunks.pop()
                section.last_messages = {}
                cut += dropped.end - dropped.index.chunk_start_offset
                messages = sum(dropped.counts.values())
                _log.warning("no room for the end of %s (%s): %d messages are given up", path, error.strerror, messages)


def _file_contents(path: Path, section: DataSection, cut_bytes: int) -> FileContents:
    start, end, counts = section.times_and_counts()
    topics = tuple(_topic(channel, section.schemas, counts) for channel in section.channels.values())
    return FileContents(path, start, end, topics, cut_bytes, whole=False)


def _topic(channel: Channel, schemas: dict[int, Schema], counts: Counter[int]) -> TopicRecord:
    qos = offered_qos(channel.metadata.get("offered_qos_profiles", ""))
    schema = schemas.get(channel.schema_id)
    type_hash = channel.metadata.get("topic_type_hash", "")
    return TopicRecord(channel.topic, schema.name if schema else "", qos, type_hash, counts[channel.id])


def _contents_if_whole(path: Path) -> FileContents | None:
    """Returns the content according to the summary of a file; None if its end is missing or damaged."""
    try:
        return _contents_by_summary(path)
    except _DAMAGE:
        return None


def _contents_by_summary(path: Path) -> FileContents | None:
    """Returns the content according to the summary of a file; None if its end is missing; raises if the summary is damaged."""
    size = path.stat().st_size
    if size < _FOOTER_BYTES + len(MCAP0_MAGIC):
        return None
    section, statistics = DataSection(), None
    with path.open("rb") as file:
        file.seek(size - _FOOTER_BYTES)
        end = file.read()
        opcode, length = RECORD.unpack_from(end)
        if not end.endswith(MCAP0_MAGIC) or (opcode, length) != (Opcode.FOOTER, 20):
            return None
        (position,) = struct.unpack_from("<Q", end, RECORD.size)
        while 0 < position < size - _FOOTER_BYTES:
            file.seek(position)
            opcode, length = RECORD.unpack(file.read(RECORD.size))
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                _add_definition(section, opcode, file.read(length))
            elif opcode == Opcode.STATISTICS:
                statistics = Statistics.read(ReadDataStream(BytesIO(file.read(length))))
            position += RECORD.size + length
    if statistics is None:
        return None
    counts = Counter(statistics.channel_message_counts)
    topics = tuple(_topic(channel, section.schemas, counts) for channel in section.channels.values())
    return FileContents(path, statistics.message_start_time, statistics.message_end_time, topics)


def _scan(file: BinaryIO, size: int) -> _Section:
    """Reads the data section up to its end or to the first truncated or damaged record."""
    section = _Section()
    file.seek(0)
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise RecordError(f"{file.name} is not an mcap file: nothing can be repaired")
    while True:
        position = file.tell()
        head = file.read(RECORD.size)
        if len(head) < RECORD.size:
            break
        opcode, length = RECORD.unpack(head)
        if position + RECORD.size + length > size or opcode in (Opcode.DATA_END, Opcode.FOOTER):
            break
        if opcode not in _KNOWN:
            _log.warning("%s is damaged at byte %d", file.name, position)
            break
        try:
            _add_record(section, opcode, length, position, file)
        except _DAMAGE as error:
            _log.warning("%s: the record at byte %d is damaged (%s): it is left out", file.name, position, error)
        file.seek(position + RECORD.size + length)
    if not section.start:
        raise EmptyFileError(f"{file.name} ends before its first record: nothing was recorded, delete it")
    return section


def _add_record(section: _Section, opcode: int, length: int, position: int, file: BinaryIO) -> None:
    """Adds a record to the section."""
    end = position + RECORD.size + length
    if opcode == Opcode.CHUNK:
        section.chunks.append(_read_chunk(section, file.read(length), position))
    elif opcode == Opcode.MESSAGE_INDEX and section.chunks and position == section.chunks[-1].end:
        chunk = section.chunks[-1]
        (channel,) = struct.unpack("<H", file.read(2))
        chunk.index.message_index_offsets[channel] = position
        chunk.index.message_index_length += RECORD.size + length
        chunk.end = end
    elif opcode == Opcode.METADATA:
        name = Metadata.read(ReadDataStream(BytesIO(file.read(length)))).name
        section.metadata.append(MetadataIndex(offset=position, length=RECORD.size + length, name=name))
        # Metadata before the first chunk is kept; metadata after the last chunk is rewritten.
        section.start = section.start if section.chunks else end
    elif opcode == Opcode.HEADER:
        Header.read(ReadDataStream(BytesIO(file.read(length))))
        section.start = end
    elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        _add_definition(section, opcode, file.read(length))
        section.start = section.start if section.chunks else end
    elif opcode == Opcode.MESSAGE:
        raise RecordError(
            f"{file.name} holds messages outside of chunks, so this program did not write it: use `ros2 bag reindex`"
        )


def _add_definition(section: DataSection, opcode: int, payload: bytes) -> None:
    stream = ReadDataStream(BytesIO(payload))
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        section.schemas[schema.id] = schema
    else:
        channel = Channel.read(stream)
        section.channels[channel.id] = channel


def _read_chunk(section: _Section, payload: bytes, position: int) -> ChunkEntry:
    """Reads a complete chunk; raises if it is damaged."""
    chunk = Chunk.read(ReadDataStream(BytesIO(payload)))
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    data = memoryview(stream.read(length))
    if len(data) != chunk.uncompressed_size:
        raise ValueError(f"chunk has {len(data)} bytes, must be {chunk.uncompressed_size}")
    messages: dict[int, list[tuple[int, int]]] = {}
    offset = 0
    while offset < len(data):
        opcode, size = RECORD.unpack_from(data, offset)
        body = offset + RECORD.size
        if body + size > len(data):
            raise ValueError("a record in the chunk is longer than the chunk")
        if opcode == Opcode.MESSAGE:
            channel, _, log_time, _ = MESSAGE.unpack_from(data, body)
            messages.setdefault(channel, []).append((log_time, offset))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            _add_definition(section, opcode, bytes(data[body : body + size]))
        offset = body + size
    unknown = messages.keys() - section.channels.keys()
    if unknown:
        raise ValueError(f"the chunk has messages of unknown channels {sorted(unknown)}")
    index = ChunkIndex(
        chunk_length=RECORD.size + len(payload),
        chunk_start_offset=position,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )
    section.last_messages = messages
    counts = Counter({channel: len(entries) for channel, entries in messages.items()})
    return ChunkEntry(index, counts, position + RECORD.size + len(payload))


def _finish(file: FileIO, section: _Section, contents: FileContents) -> None:
    """Truncates the file after its last complete chunk and writes the end of the file."""
    file.seek(section.end)
    file.truncate()
    end = bytearray()
    if section.chunks:
        end += _missing_indices(section.chunks[-1], section.last_messages)
    end += end_of_file(section, section.end + len(end), bag_information(contents.topics, [contents.record]))
    rest = memoryview(end)
    while rest:
        rest = rest[file.write(rest) :]
    os.fsync(file.fileno())


def _missing_indices(chunk: ChunkEntry, messages: dict[int, list[tuple[int, int]]]) -> bytes:
    """Returns the message indices of the last chunk that are missing in the file, and adds them to the chunk's index."""
    added = bytearray()
    for channel, entries in messages.items():
        if chunk.index.message_index_offsets.get(channel, chunk.end) >= chunk.end:
            chunk.index.message_index_offsets[channel] = chunk.end + len(added)
            added += message_index(channel, entries)
    chunk.index.message_index_length = chunk.end + len(added) - chunk.index.chunk_start_offset - chunk.index.chunk_length
    return bytes(added)
