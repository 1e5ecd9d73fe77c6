"""Writes the readable part of a damaged mcap file to a new one, and finishes, in place, the file of a recording that could not end."""

from __future__ import annotations

import logging
import os
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from io import BytesIO, FileIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, ChunkIndex, Header, Metadata, MetadataIndex, Schema
from mcap.writer import MCAP0_MAGIC

from gibson_sim.bags.definitions import MessageDefinitions, settled
from gibson_sim.bags.mcap_file import CHUNK_TIMES, MESSAGE, RECORD, ChunkEntry, DataSection, end_of_file, message_index
from gibson_sim.bags.metadata import TopicRecord, bag_information, damaged_qos, dump_qos, is_qos, offered_qos
from gibson_sim.bags.repairing.mcap_scan import DAMAGE, UNFINISHED, FoundChunk, Scan, records, scan, unpacked
from gibson_sim.bags.storage import EmptyFileError, FileContents, FileRepair
from gibson_sim.errors import RecordError

_BLOCK = 4 * 2**20
"""Bytes that are copied at once."""
_log = logging.getLogger(__name__)


def repair_mcap(path: Path, draft: Path, known: Mapping[str, TopicRecord]) -> FileRepair:
    """Reads a file to its end, and writes what can be read to a new one unless the file is whole.

    Args:
        path: the file; never changed.
        draft: the file to write.
        known: topics by name, as the metadata of the bag lists them.

    Raises:
        EmptyFileError: nothing was recorded.
        RecordError: it is not an mcap file.
        OSError: a file cannot be read or written.
    """
    found = _scanned(path, known)
    section = DataSection(schemas=dict(found.schemas), channels=dict(found.channels))
    notes = [*dict.fromkeys(found.faults), *_complete(section, known)]
    counts = found.counts
    nameless = {channel: count for channel, count in counts.items() if channel not in section.channels}
    notes += [
        f"{count} messages of channel {channel} are left out: nothing says which topic it is"
        for channel, count in nameless.items()
    ]
    listed: Counter[str] | None = None
    if found.listed is not None:
        names = {number: channel.topic for number, channel in section.channels.items()}
        listed = Counter()
        for number, count in found.listed.items():
            listed[names.get(number, f"channel {number}")] += count
    if not found.is_whole or notes:
        with path.open("rb") as source, draft.open("wb", buffering=0) as file:
            contents = _write(found, section, source, file)
    else:
        contents = _contents(path, section, counts, found.chunks)
    gaps = tuple((gap.start, gap.end, gap.reason) for gap in found.gaps)
    harmless = not nameless and all(gap.reason == UNFINISHED or 0 < found.data_end < gap.start for gap in found.gaps)
    sure = not nameless and found.listed == found.counts
    return FileRepair(contents, "bytes", gaps, tuple(notes), listed, harmless, sure, found.unchecked, changed=bool(gaps or notes))


def finish_mcap(path: Path, write_bag_metadata: Callable[[FileContents], None]) -> FileContents:
    """Finishes the file of a recording that ended in the middle of a write: cuts off its incomplete end, and writes the end of the file.

    If the disk is too full even for this, and for the metadata of the bag, chunks are dropped from the end until they fit.

    Raises:
        EmptyFileError: nothing was recorded.
        RecordError: the file is damaged elsewhere: nothing is changed.
        OSError: the file cannot be written.
    """
    found = _scanned(path, {})
    if found.is_whole:
        return _contents(path, DataSection(found.schemas, found.channels), found.counts, found.chunks)
    section = DataSection(dict(found.schemas), dict(found.channels))
    end = found.chunks[-1].indices_end if found.chunks else found.lead
    if any(gap.start < end for gap in found.gaps) or any(chunk.is_run for chunk in found.chunks):
        raise RecordError(f"{path} is damaged at byte {found.gaps[0].start if found.gaps else 0}")
    chunks = list(found.chunks)
    # Unbuffered: a failed write must not be repeated by the next seek.
    with path.open("r+b", buffering=0) as file:
        while True:
            section.chunks = [_entry(chunk, chunk.start, chunk.end - chunk.start, dict(chunk.indices)) for chunk in chunks]
            contents = _contents(path, section, sum((c.counts for c in chunks), Counter()), chunks)
            try:
                _finish(file, section, contents, chunks, found.lead)
                write_bag_metadata(contents)
                return contents
            except OSError as error:
                if not chunks:
                    raise
                dropped = chunks.pop()
                _log.warning(
                    "no room for the end of %s (%s): %d messages are given up", path, error.strerror, dropped.counts.total()
                )


def _finish(file: FileIO, section: DataSection, contents: FileContents, chunks: list[FoundChunk], lead: int) -> None:
    """Truncates the file after its last complete chunk and writes the end of the file."""
    position = chunks[-1].indices_end if chunks else lead
    file.seek(position)
    file.truncate()
    end = bytearray()
    if chunks:
        last, index = chunks[-1], section.chunks[-1].index
        for channel, entries in last.messages.items():
            if channel not in index.message_index_offsets:
                index.message_index_offsets[channel] = position + len(end)
                end += message_index(channel, entries)
        index.message_index_length = position + len(end) - last.end
    end += end_of_file(section, position + len(end), bag_information(contents.topics, [contents.record]))
    _write_all(file, end)
    os.fsync(file.fileno())


def _scanned(path: Path, known: Mapping[str, TopicRecord]) -> Scan:
    found = scan(
        path, lambda channel, schema: channel.topic in known and known[channel.topic].type_name == (schema.name if schema else "")
    )
    if not (found.header or found.chunks):
        with path.open("rb") as file:
            begin = file.read(len(MCAP0_MAGIC))
        if MCAP0_MAGIC.startswith(begin):
            raise EmptyFileError(f"{path} ends before its first record: nothing was recorded, delete it")
        raise RecordError(f"{path} is not an mcap file: nothing can be repaired")
    return found


def _complete(section: DataSection, known: Mapping[str, TopicRecord]) -> list[str]:
    """Replaces descriptions that are lost, or that are damaged beyond use, by those of the metadata and of the installed types.

    Topics whose type is unknown are removed.

    Returns:
        What was done, one line each.
    """
    notes = []
    for number, channel in list(section.channels.items()):
        if channel.schema_id in section.schemas:
            continue
        name = known[channel.topic].type_name if channel.topic in known else ""
        if not name:
            notes.append(f"topic {channel.topic!r:.200}: nothing says which type it has")
            del section.channels[number]
            continue
        try:
            definition, encoding, origin = MessageDefinitions().full_text(name), "ros2msg", "that of the installed type"
        except RecordError:
            definition, encoding, origin = "", "", "none"
        section.schemas[channel.schema_id] = Schema(channel.schema_id, definition.encode(), encoding, name)
        notes.append(f"the description of type {name} is lost; in its place: {origin}")
    for channel in list(section.channels.values()):
        extra = dict(channel.metadata)
        if not is_qos(extra.get("offered_qos_profiles", "")):
            extra["offered_qos_profiles"] = dump_qos(known[channel.topic].qos) if channel.topic in known else ""
            notes.append(damaged_qos(channel.topic, extra["offered_qos_profiles"]))
        schema, recorded = section.schemas[channel.schema_id], extra.get("topic_type_hash", "")
        if schema.encoding == "ros2msg" and recorded:
            text, extra["topic_type_hash"], note = settled(schema.name, schema.data.decode(errors="replace"), recorded)
            if note:
                notes.append(note)
                section.schemas[schema.id] = replace(schema, data=text.encode())
        section.channels[channel.id] = replace(channel, metadata=extra)
    return list(dict.fromkeys(notes))


def _write(found: Scan, section: DataSection, source: BinaryIO, file: FileIO) -> FileContents:
    """Writes a whole file with all that was found."""
    builder = RecordBuilder()
    builder.write(MCAP0_MAGIC)
    position = 0
    if found.header is None:
        Header("ros2", "gibson_sim").write(builder)
    begin = bytes(builder.end())  # type: ignore[no-untyped-call]
    position += _write_all(file, begin)
    if found.header is not None:
        position += _copy(source, file, found.header[0], found.header[1] - found.header[0])
    builder = RecordBuilder()
    for schema in section.schemas.values():
        schema.write(builder)
    for channel in section.channels.values():
        channel.write(builder)
    position += _write_all(file, bytes(builder.end()))  # type: ignore[no-untyped-call]
    parts: list[tuple[int, FoundChunk | tuple[int, int, int]]] = [(chunk.start, chunk) for chunk in found.chunks]
    parts += [(other[1], other) for other in found.others]
    kept = []
    for _, part in sorted(parts, key=lambda item: item[0]):
        if isinstance(part, FoundChunk):
            chunk, content = _known_part(part, section, source)
            if not chunk.messages:
                continue
            position = _write_chunk(chunk, content, section, source, file, position)
            kept.append(chunk)
        else:
            position = _write_other(part, section, source, file, position)
    contents = _contents(found.path, section, sum((chunk.counts for chunk in kept), Counter()), kept)
    _write_all(file, end_of_file(section, position, bag_information(contents.topics, [contents.record])))
    os.fsync(file.fileno())
    return contents


def _known_part(chunk: FoundChunk, section: DataSection, source: BinaryIO) -> tuple[FoundChunk, bytes | None]:
    """Returns a chunk without the messages of unknown channels; and its content if it differs from that in the file, else None."""
    if chunk.messages.keys() <= section.channels.keys():
        return chunk, None
    content = unpacked(_read(source, chunk.body, chunk.size), chunk.compression, chunk.unpacked_size)
    kept = bytearray()
    messages: dict[int, list[tuple[int, int]]] = {}
    for opcode, begin, end in records(content):
        if opcode != Opcode.MESSAGE:
            continue
        channel, _, log_time, _ = MESSAGE.unpack_from(content, begin)
        if channel in section.channels:
            messages.setdefault(channel, []).append((log_time, len(kept)))
            kept += content[begin - RECORD.size : end]
    crc = zlib.crc32(kept) if chunk.crc else 0
    return FoundChunk(chunk.start, chunk.end, chunk.body, len(kept), len(kept), "", crc, messages), bytes(kept)


def _write_chunk(
    chunk: FoundChunk, content: bytes | None, section: DataSection, source: BinaryIO, file: FileIO, position: int
) -> int:  # fmt: skip
    """Writes a chunk with a new head and new message indices; returns the offset after them."""
    start, compression = position, chunk.compression.encode()
    head = CHUNK_TIMES.pack(*chunk.times, chunk.unpacked_size, chunk.crc)
    head += struct.pack("<I", len(compression)) + compression + struct.pack("<Q", chunk.size)
    position += _write_all(file, RECORD.pack(Opcode.CHUNK, len(head) + chunk.size) + head)
    position += _write_all(file, content) if content is not None else _copy(source, file, chunk.body, chunk.size)
    length, offsets, indices = position - start, {}, bytearray()
    for channel, entries in chunk.messages.items():
        offsets[channel] = position + len(indices)
        indices += message_index(channel, entries)
    position += _write_all(file, indices)
    section.chunks.append(_entry(chunk, start, length, offsets, len(indices)))
    return position


def _entry(chunk: FoundChunk, start: int, length: int, offsets: dict[int, int], indices_length: int | None = None) -> ChunkEntry:
    """Returns how the summary lists a chunk."""
    first, last = chunk.times
    size = chunk.indices_end - chunk.end if indices_length is None else indices_length
    index = ChunkIndex(
        chunk_length=length,
        chunk_start_offset=start,
        compression=chunk.compression,
        compressed_size=chunk.size,
        message_end_time=last,
        message_index_length=size,
        message_index_offsets=offsets,
        message_start_time=first,
        uncompressed_size=chunk.unpacked_size,
    )
    return ChunkEntry(index, chunk.counts, start + length + size)


def _write_other(other: tuple[int, int, int], section: DataSection, source: BinaryIO, file: FileIO, position: int) -> int:
    """Copies metadata, an attachment or a private record, and lists it; returns the offset after it."""
    opcode, begin, end = other
    head = ReadDataStream(BytesIO(_read(source, begin + RECORD.size, min(end - begin - RECORD.size, 2**20))))
    try:
        if opcode == Opcode.METADATA:
            name = Metadata.read(head).name
            if name == "rosbag2":  # that of the whole file is written at its end
                return position
            section.metadata.append(MetadataIndex(offset=position, length=end - begin, name=name))
        elif opcode == Opcode.ATTACHMENT:
            log_time, create_time = head.read8(), head.read8()
            name, media_type, size = head.read_prefixed_string(), head.read_prefixed_string(), head.read8()
            section.attachments.append(
                AttachmentIndex(
                    offset=position,
                    length=end - begin,
                    log_time=log_time,
                    create_time=create_time,
                    data_size=size,
                    name=name,
                    media_type=media_type,
                )
            )
    except DAMAGE as error:
        _log.warning("the record at byte %d cannot be listed: %s", begin, error)
    return position + _copy(source, file, begin, end - begin)


def _contents(path: Path, section: DataSection, counts: Counter[int], chunks: list[FoundChunk]) -> FileContents:
    times = [time for chunk in chunks if chunk.messages for time in chunk.times]
    topics = tuple(_topic(channel, section.schemas, counts) for channel in section.channels.values())
    return FileContents(path, min(times, default=0), max(times, default=0), topics)


def _topic(channel: Channel, schemas: dict[int, Schema], counts: Counter[int]) -> TopicRecord:
    qos = offered_qos(channel.metadata.get("offered_qos_profiles", ""))
    schema = schemas.get(channel.schema_id)
    type_hash = channel.metadata.get("topic_type_hash", "")
    return TopicRecord(channel.topic, schema.name if schema else "", qos, type_hash, counts[channel.id])


def _read(source: BinaryIO, offset: int, size: int) -> bytes:
    return os.pread(source.fileno(), size, offset)


def _copy(source: BinaryIO, file: FileIO, offset: int, size: int) -> int:
    for begin in range(offset, offset + size, _BLOCK):
        _write_all(file, _read(source, begin, min(_BLOCK, offset + size - begin)))
    return size


def _write_all(file: FileIO, data: bytes | bytearray) -> int:
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest) :]
    return len(data)
