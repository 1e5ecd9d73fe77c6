"""Reads an mcap file to its last byte, whatever in it is damaged, and judges every part of it. Records: https://mcap.dev/spec.

The file is read record by record. Where no sound record begins, the next one whose structure holds, and whose checksum holds if it has
one, is searched for byte by byte; what lies between is a gap. Indices are never trusted: they are compared with the chunks themselves.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from gibson_sim.bags.mcap_file import COMPRESSIONS, MESSAGE, RECORD

_CHUNK_HEAD = struct.Struct("<QQQII")
"""First and last log time, uncompressed size, checksum, length of the name of the compression."""
_LENGTH = struct.Struct("<Q")
_FOOTER = struct.Struct("<QQI")
_NAMES = frozenset("" if name == "none" else name for name in COMPRESSIONS)
_LONGEST_NAME = max(len(name) for name in _NAMES)
_DESCRIPTIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
_FIRST, _LAST, _PRIVATE = int(Opcode.HEADER), int(Opcode.DATA_END), 0x80
_CANDIDATE = re.compile(rb"(?=[\x01-\x0f][\s\S]{5}\0\0\0)")
"""A known opcode and a length of less than a terabyte."""
_WINDOW = 4 * 2**20
"""Bytes that are searched at once."""
_CHAIN = 3
"""Number of records in a row that must look sound where they have no structure of their own that could prove it."""
_MOST_UNPACKED = 2**30
"""Maximum size of the content of a compressed chunk, bytes."""
_RUN_BYTES = 2**20
"""Size at which a run of messages outside of chunks is ended, bytes."""
# Exceptions of the parsers for damaged bytes: struct, text, absurd lengths, lz4, zstd, mcap.
DAMAGE = (struct.error, ValueError, KeyError, OverflowError, MemoryError, RuntimeError, EOFError, zstandard.ZstdError, McapError)


UNFINISHED = "the file ends within a record"


@dataclass(frozen=True, slots=True)
class Gap:
    """Bytes that were stepped over."""

    start: int
    end: int
    """Offset in the file of the first byte after the gap."""
    reason: str

    @property
    def size(self) -> int:
        """Number of bytes."""
        return self.end - self.start


@dataclass(slots=True)
class FoundChunk:
    """A chunk whose content can be read, or a run of messages outside of chunks: its bytes are those of an uncompressed chunk."""

    start: int
    """Offset in the file of the record."""
    end: int
    """Offset after it."""
    body: int
    """Offset of its content."""
    size: int
    """Size of its content in the file, bytes."""
    unpacked_size: int
    compression: str
    crc: int
    """Checksum of the unpacked content; 0 = it has none."""
    messages: dict[int, list[tuple[int, int]]]
    """Channel -> (log time, offset in the unpacked content) of each message."""
    indices: dict[int, int] = field(default_factory=dict)
    """Channel -> offset in the file of its sound message index."""
    indices_end: int = 0
    """Offset after the message indices."""

    @property
    def is_run(self) -> bool:
        """Whether these are messages outside of chunks."""
        return self.body == self.start

    @property
    def counts(self) -> Counter[int]:
        """Channel -> number of messages."""
        return Counter({channel: len(entries) for channel, entries in self.messages.items()})

    @property
    def times(self) -> tuple[int, int]:
        """Log times of the first and the last message, nanoseconds; 0 without messages."""
        times = [time for entries in self.messages.values() for time, _ in entries]
        return min(times, default=0), max(times, default=0)


@dataclass(slots=True)
class _Copies:
    """All copies of the descriptions of one kind that a file has, by id."""

    kind: str
    by_id: dict[int, list[tuple[int, Schema | Channel]]] = field(default_factory=dict)
    """(trust, description); the greater the trust, the better it is known to be unchanged."""

    def add(self, trust: int, record: Schema | Channel) -> None:
        """Adds a copy."""
        self.by_id.setdefault(record.id, []).append((trust, record))


@dataclass(slots=True)
class Scan:
    """What a file holds."""

    path: Path
    size: int
    header: tuple[int, int] | None = None
    """Offsets of the begin and the end of the header record."""
    lead: int = 0
    """Offset after the sound records before the first chunk."""
    data_end: int = 0
    """Offset of the record that ends the data section; 0 = not found. Behind it there are no messages."""
    chunks: list[FoundChunk] = field(default_factory=list)
    others: list[tuple[int, int, int]] = field(default_factory=list)
    """(opcode, begin, end) of metadata, attachments and private records."""
    gaps: list[Gap] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    """What is wrong beside the gaps, and costs no message."""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    listed: Counter[int] | None = None
    """Channel -> number of messages as the statistics list it; None without statistics."""
    unchecked: int = 0
    """Number of messages whose bytes have no checksum."""

    @property
    def is_whole(self) -> bool:
        """Whether nothing is damaged or missing."""
        return not self.gaps and not self.faults

    @property
    def counts(self) -> Counter[int]:
        """Channel -> number of messages."""
        return sum((chunk.counts for chunk in self.chunks), Counter())


def scan(path: Path, known_topics: Callable[[Channel, Schema | None], bool] = lambda *_: False) -> Scan:
    """Reads a file to its end.

    Args:
        path: the file.
        known_topics: whether another source confirms the topic and the type of a channel; decides between copies that differ.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        return _Scanner(file, path).run(known_topics)


def unpacked(data: bytes, compression: str, size: int) -> bytes:
    """Returns the content of a chunk.

    Args:
        data: content as it is in the file.
        compression: empty, lz4 or zstd.
        size: size that the chunk claims; a content that is much larger is refused.

    Raises:
        ValueError, RuntimeError, ZstdError: the content is damaged.
    """
    if not compression:
        return data
    most = min(max(size, 2**26), _MOST_UNPACKED)
    if compression == "lz4":
        lz4_part = lz4.frame.LZ4FrameDecompressor()
        content = bytes(lz4_part.decompress(data, max_length=most + 1))
        if not lz4_part.eof:
            raise ValueError("the lz4 frame has no end")
    elif compression == "zstd":
        parts, total = [], 0
        with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as stream:
            while (part := stream.read(2**20)) and total <= most:
                parts.append(part)
                total += len(part)
        content = b"".join(parts)
    else:
        raise ValueError(f"compression {compression!r:.20} is unknown")
    if len(content) > most:
        raise ValueError(f"the content has more than {most} bytes")
    return content


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yields (opcode, begin, end) of the records in the content of a chunk; begin is that of the record's own content.

    Raises:
        ValueError, struct.error: the records do not fill the content exactly.
    """
    offset = 0
    while offset < len(data):
        opcode, length = RECORD.unpack_from(data, offset)
        begin = offset + RECORD.size
        offset = begin + length
        if offset > len(data):
            raise ValueError("a record in the chunk is longer than the chunk")
        yield opcode, begin, offset


class _Broken(Exception):
    """No sound record begins here; ``end``: where the next one begins, if that is known."""

    def __init__(self, reason: str, end: int = 0) -> None:
        super().__init__(reason)
        self.reason, self.end = reason, end


class _Scanner:
    """Reads one file."""

    def __init__(self, file: BinaryIO, path: Path) -> None:
        self._descriptor = file.fileno()
        self._size = os.fstat(self._descriptor).st_size
        self._found = Scan(path, self._size)
        self._schemas, self._channels = _Copies("type"), _Copies("topic")
        self._last: FoundChunk | None = None
        self._run: FoundChunk | None = None
        self._chunk_indices: list[ChunkIndex] = []
        self._message_indices: dict[int, int] = {}
        self._statistics: Statistics | None = None
        self._described: set[tuple[int, int, int]] = set()
        self._run_seen = False
        self._offsets: list[tuple[int, int, int]] = []
        self._other_indices: list[tuple[int, int]] = []
        self._data_crc = self._footer = 0
        self._starts: dict[int, int] = {}

    def run(self, known_topics: Callable[[Channel, Schema | None], bool]) -> Scan:
        """Returns what the file holds."""
        position = len(MCAP0_MAGIC)
        if self._read(0, position) != MCAP0_MAGIC:
            position = 0
            begin = self._next(0) if self._size else 0
            self._gap(0, begin, "the file does not begin like an mcap file")
            position = begin
        while position < self._size:
            if self._is_end(position):
                position = self._size
                break
            try:
                position = self._record(position)
            except _Broken as broken:
                end = broken.end or self._next(position + 1)
                if not (self._found.chunks or self._run_seen) and self._is_without_chunks(end):
                    self._run_seen = True
                    end = self._next(position + 1)
                unfinished = end == self._size and self._is_unfinished(position)
                self._gap(position, end, UNFINISHED if unfinished else broken.reason)
                self._last = self._run = None
                position = end
        self._check_end()
        self._drop_copies()
        self._choose(known_topics)
        self._check_summary()
        self._found.unchecked = sum(sum(chunk.counts.values()) for chunk in self._found.chunks if not chunk.crc)
        return self._found

    def _drop_copies(self) -> None:
        """Drops each chunk whose bytes the file has before already, unless the statistics and the index count it, too."""
        found = self._found
        is_counted = self._statistics is not None and self._statistics.message_count == found.counts.total()
        if is_counted and (not self._chunk_indices or self._are_chunks_listed()):
            return
        first: dict[tuple[object, ...], list[FoundChunk]] = {}
        kept = []
        for chunk in found.chunks:
            alike = first.setdefault((chunk.times, chunk.size, chunk.crc, chunk.compression, chunk.is_run), [])
            same = next((one for one in alike if chunk.messages and self._are_same(one, chunk)), None)
            if same is None or chunk.is_run:
                alike.append(chunk)
                kept.append(chunk)
            else:
                found.faults.append(
                    f"the chunk at byte {chunk.start} is a copy of that at byte {same.start}: its {chunk.counts.total()} messages count once"
                )
        found.chunks = kept

    def _are_same(self, a: FoundChunk, b: FoundChunk) -> bool:
        return self._read(a.body, a.size) == self._read(b.body, b.size)

    def _read(self, offset: int, size: int) -> bytes:
        return os.pread(self._descriptor, max(0, min(size, self._size - offset)), offset)

    def _gap(self, start: int, end: int, reason: str) -> None:
        gaps = self._found.gaps
        if gaps and gaps[-1].end == start:
            before = gaps.pop()
            start, reason = before.start, before.reason
        if end > start:
            gaps.append(Gap(start, end, reason))

    def _is_unfinished(self, position: int) -> bool:
        """Returns whether a record begins at an offset that the end of the file cuts off."""
        head = self._read(position, RECORD.size)
        if len(head) < RECORD.size:
            return True
        opcode, length = RECORD.unpack(head)
        return bool(_FIRST <= opcode <= _LAST and position + RECORD.size + length > self._size)

    def _is_end(self, position: int) -> bool:
        return position == self._size - len(MCAP0_MAGIC) and self._read(position, 8) == MCAP0_MAGIC

    def _head(self, position: int) -> tuple[int, int] | None:
        """Returns opcode and length of the record at an offset; None if no record that ends in the file can begin there."""
        head = self._read(position, RECORD.size)
        if len(head) < RECORD.size:
            return None
        opcode, length = RECORD.unpack(head)
        if not (_FIRST <= opcode <= _LAST or opcode >= _PRIVATE) or position + RECORD.size + length > self._size:
            return None
        return opcode, length

    def _follows(self, position: int, chain: int = 1, *, private: bool = True) -> bool:
        """Returns whether so many records could be at an offset, or the end of the file is there."""
        for _ in range(chain):
            if position == self._size or self._is_end(position):
                return True
            head = self._head(position)
            if head is None or (head[0] >= _PRIVATE and not private):
                return False
            if head[0] == Opcode.MESSAGE and head[1] < MESSAGE.size:
                return False
            position += RECORD.size + head[1]
        return True

    def _is_without_chunks(self, position: int) -> bool:
        """Returns whether the statistics, in the records from an offset on, list messages and no chunk."""
        while (head := self._head(position)) is not None and head[0] != Opcode.CHUNK:
            if head[0] == Opcode.STATISTICS and head[1] >= 46:
                count, chunks = struct.unpack("<Q14xI", self._read(position + RECORD.size, 26))
                return bool(count and not chunks)
            position += RECORD.size + head[1]
        return False

    def _is_damaged_head(self, position: int) -> bool:
        """Returns whether the head of a record is at an offset, but for one bit: it would then lead to the next sound record."""
        head, following = self._read(position, RECORD.size), self._next(position + 1)
        if len(head) < RECORD.size:
            return False
        for bit in range(8 * RECORD.size):
            changed = bytearray(head)
            changed[bit // 8] ^= 1 << bit % 8
            opcode, length = RECORD.unpack(changed)
            if _FIRST <= opcode <= _LAST and position + RECORD.size + length == following:
                return True
        return False

    def _next(self, position: int) -> int:
        """Returns the offset of the next sound record that can be told from the inside of a damaged one; else the end of the file."""
        while position < self._size:
            window = self._read(position, _WINDOW + RECORD.size)
            for match in _CANDIDATE.finditer(window):
                if match.start() < _WINDOW and self._is_anchor(position + match.start()):
                    return position + match.start()
            position += _WINDOW
        return self._size

    def _is_anchor(self, position: int) -> bool:
        head = self._head(position)
        if head is None:
            return False
        opcode, length = head
        end = position + RECORD.size + length
        try:
            if opcode == Opcode.CHUNK:
                self._chunk(position, length, strict=True)
                return True
            if opcode == Opcode.MESSAGE:
                # Inside a damaged chunk, messages cannot be checked: they count only in files without chunks.
                is_plain = self._run_seen and not any(chunk.crc or chunk.compression for chunk in self._found.chunks)
                return is_plain and length >= MESSAGE.size and self._follows(end, _CHAIN, private=False)
            payload = self._read(position + RECORD.size, length) if length < 2**26 else b""
            if opcode in _DESCRIPTIONS and _is_exact(opcode, payload):
                # They are in chunks, too: what they say is kept for the case that no other copy is left, but the search goes on.
                if not self._footer_follows(end):
                    self._describe(opcode, payload, trust=0)
                    return False
                return True
            return _is_exact(opcode, payload) and self._follows(end, 2, private=False)
        except (*DAMAGE, _Broken):
            return False

    def _footer_follows(self, position: int) -> bool:
        """Returns whether the records from here lead to the end of the file, as they do in the summary."""
        for _ in range(100_000):
            if self._is_end(position):
                return True
            head = self._head(position)
            if head is None or head[0] in (Opcode.CHUNK, Opcode.MESSAGE) or head[0] >= _PRIVATE:
                return False
            position += RECORD.size + head[1]
        return False

    def _record(self, position: int) -> int:
        """Takes the record at an offset; returns the offset after it.

        Raises:
            _Broken: it is damaged.
        """
        head = self._head(position)
        if head is None:
            # The length of a chunk stands in it twice.
            if self._read(position, 1) == bytes([Opcode.CHUNK]):
                return self._take_chunk(position, 0)
            raise _Broken("no record begins here")
        opcode, length = head
        if opcode == Opcode.CHUNK:
            return self._take_chunk(position, length)
        try:
            return self._other_record(position, opcode, length)
        except _Broken as broken:
            # A chunk with a checksum proves that it is one, whatever its opcode says.
            try:
                return self._take_chunk(position, length, proven=True)
            except _Broken:
                raise broken from None

    def _other_record(self, position: int, opcode: int, length: int) -> int:
        """Takes a record that is not a chunk, as ``_record``."""
        end = position + RECORD.size + length
        known_end = end if self._follows(end, _CHAIN) else 0
        if opcode == Opcode.MESSAGE:
            return self._take_message(position, length, end)
        if opcode == Opcode.ATTACHMENT or opcode >= _PRIVATE:
            is_sound = (
                self._is_attachment(position, end) if opcode == Opcode.ATTACHMENT else self._is_private(position, opcode, length)
            )
            if not self._follows(end) or not is_sound:
                raise _Broken("a damaged record", known_end)
            self._found.others.append((opcode, position, end))
        else:
            try:
                self._take(opcode, position, self._read(position + RECORD.size, length))
            except DAMAGE as error:
                raise _Broken("a damaged record", known_end) from error
        if opcode != Opcode.MESSAGE_INDEX:
            self._starts[position] = opcode
        if not (self._found.chunks or self._found.gaps or self._found.data_end):
            self._found.lead = end
        return end

    def _is_private(self, position: int, opcode: int, length: int) -> bool:
        """Returns whether a record with a private opcode is not one of the known kinds, whose opcode is damaged."""
        kind = opcode - _PRIVATE
        if kind == Opcode.MESSAGE:
            return not self._run_seen
        return kind != Opcode.CHUNK and not (length < 2**26 and _is_exact(kind, self._read(position + RECORD.size, length)))

    def _take(self, opcode: int, position: int, payload: bytes) -> None:
        """Takes a record that is neither chunk nor message; raises if it is damaged."""
        end = position + RECORD.size + len(payload)
        if opcode in _DESCRIPTIONS:
            if not (_is_exact(opcode, payload) or self._follows(end)):
                raise ValueError("a description is shorter than its record")
            self._describe(opcode, payload, trust=1)
            self._described.add((position, opcode, int.from_bytes(payload[:2], "little")))
            return
        if not _is_exact(opcode, payload) and not (_is_exact(opcode, payload, longer=True) and self._follows(end, _CHAIN)):
            raise ValueError("the record does not have the structure of its kind")
        if opcode == Opcode.HEADER:
            if self._found.header is None:
                self._found.header = (position, end)
        elif opcode == Opcode.METADATA:
            self._found.others.append((opcode, position, end))
        elif opcode == Opcode.MESSAGE_INDEX:
            self._check_index(payload, position)
        elif opcode == Opcode.DATA_END:
            self._found.data_end, (self._data_crc,) = position, struct.unpack_from("<I", payload)
        elif opcode == Opcode.CHUNK_INDEX:
            self._chunk_indices.append(ChunkIndex.read(ReadDataStream(BytesIO(payload))))
        elif opcode == Opcode.STATISTICS:
            self._statistics = Statistics.read(ReadDataStream(BytesIO(payload)))
        elif opcode in (Opcode.METADATA_INDEX, Opcode.ATTACHMENT_INDEX):
            start, length = struct.unpack_from("<QQ", payload)
            self._other_indices.append((start, length))
        elif opcode == Opcode.SUMMARY_OFFSET:
            self._offsets.append(struct.unpack_from("<BQQ", payload))
        elif opcode == Opcode.FOOTER:
            self._footer = position

    def _describe(self, opcode: int, payload: bytes, trust: int) -> None:
        stream = ReadDataStream(BytesIO(payload))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            if not schema.id or not schema.name:
                raise ValueError("a type without id or name")
            self._schemas.add(trust, schema)
        else:
            channel = Channel.read(stream)
            if not channel.topic:
                raise ValueError("a topic without a name")
            self._channels.add(trust, channel)

    def _is_attachment(self, position: int, end: int) -> bool:
        """Returns whether the checksum of an attachment holds."""
        crc, (expected,) = 0, struct.unpack("<I", self._read(end - 4, 4))
        for offset in range(position + RECORD.size, end - 4, _WINDOW):
            crc = zlib.crc32(self._read(offset, min(_WINDOW, end - 4 - offset)), crc)
        return not expected or crc == expected

    def _take_message(self, position: int, length: int, end: int) -> int:
        """Takes a message outside of chunks."""
        if length < MESSAGE.size or not (self._follows(end) or self._is_damaged_head(end)):
            raise _Broken("a damaged message outside of chunks")
        channel, _, log_time, _ = MESSAGE.unpack(self._read(position + RECORD.size, MESSAGE.size))
        run = self._run
        if run is None or run.end != position or run.size > _RUN_BYTES:
            run = self._run = FoundChunk(position, position, position, 0, 0, "", 0, {})
            self._found.chunks.append(run)
            self._run_seen = True
        run.messages.setdefault(channel, []).append((log_time, run.size))
        run.size += end - position
        run.unpacked_size, run.end = run.size, end
        return end

    def _take_chunk(self, position: int, length: int, *, proven: bool = False) -> int:
        """Takes a chunk; ``proven``: only if its checksum proves that it is one."""
        chunk, descriptions = self._chunk(position, length)
        if proven:
            if not chunk.crc or not chunk.messages:
                raise _Broken("a damaged record")
            self._found.faults.append(f"the kind of the record at byte {position} is wrong")
        for opcode, payload in descriptions:
            self._describe(opcode, payload, trust=3 if chunk.crc else 1)
            self._described.add((position, opcode, int.from_bytes(payload[:2], "little")))
        self._found.chunks.append(chunk)
        self._last, self._run = chunk, None
        return chunk.end

    def _chunk(self, position: int, length: int, *, strict: bool = False) -> tuple[FoundChunk, list[tuple[int, bytes]]]:
        """Returns the chunk at an offset, and the descriptions of types and topics in it.

        Args:
            position: offset of its record.
            length: length of the record as its head says; 0 = absurd.
            strict: refuse heads that contradict themselves, as bytes that only look like a chunk do.

        Raises:
            _Broken: it is damaged.
        """
        start = position + RECORD.size
        head = self._read(start, _CHUNK_HEAD.size + _LONGEST_NAME + _LENGTH.size)
        try:
            first, last, unpacked_size, crc, name_length = _CHUNK_HEAD.unpack_from(head)
            name = head[_CHUNK_HEAD.size : _CHUNK_HEAD.size + min(name_length, _LONGEST_NAME)].decode("ascii")
            (size,) = _LENGTH.unpack_from(head, _CHUNK_HEAD.size + len(name))
        except DAMAGE as error:
            raise _Broken("a damaged chunk") from error
        body = start + _CHUNK_HEAD.size + len(name) + _LENGTH.size
        is_exact = name in _NAMES and name_length == len(name) and first <= last and start + length == body + size
        known_end = start + length if length and self._follows(start + length, _CHAIN) else 0
        if name not in _NAMES or (strict and not is_exact):
            raise _Broken("a chunk whose head is damaged", known_end)
        reason = "a chunk whose head is damaged"
        # One of the lengths may be damaged: the checksum shows which one is right.
        sizes = {size} if is_exact else {size, start + length - body, *({unpacked_size} if not name else ())}
        for tried in sorted(s for s in sizes if 0 < s <= self._size - body or s == size == 0):
            try:
                content = unpacked(self._read(body, tried), name, unpacked_size)
                if crc and zlib.crc32(content) != crc:
                    raise ValueError("its checksum does not match")
                if not crc and not (is_exact and len(content) == unpacked_size):
                    raise ValueError("its size does not match")
                messages, descriptions = _content(content)
            except DAMAGE as error:
                reason = f"a chunk that is damaged: {' '.join(str(error).split())[:100]}"
                continue
            end = body + tried
            if start + length > end and self._follows(start + length, _CHAIN) and not self._follows(end, _CHAIN):
                end = start + length  # newer versions of the format may add fields
            chunk = FoundChunk(position, end, body, tried, len(content), name, crc, messages, indices_end=end)
            if not strict and (not is_exact or len(content) != unpacked_size or (messages and chunk.times != (first, last))):
                self._found.faults.append(f"the head of the chunk at byte {position} is wrong")
            return chunk, descriptions
        raise _Broken(reason, known_end)

    def _check_index(self, payload: bytes, position: int) -> None:
        """Compares the index of one channel with the chunk before it."""
        (channel,) = struct.unpack_from("<H", payload)
        self._message_indices[position] = channel
        if self._last is None:
            return
        if list(struct.iter_unpack("<QQ", payload[6:])) == self._last.messages.get(channel, []):
            self._last.indices[channel] = position
            self._last.indices_end = position + RECORD.size + len(payload)
        else:
            self._found.faults.append(f"the message index at byte {position} is wrong")

    def _check_end(self) -> None:
        """Checks the footer and the records that it leads to."""
        found = self._found
        if not self._footer or not self._is_end(self._size - len(MCAP0_MAGIC)):
            found.faults.append("the end of the file is missing or damaged")
            return
        start, offset_start, crc = _FOOTER.unpack(self._read(self._footer + RECORD.size, _FOOTER.size))
        summary = self._found.data_end + RECORD.size + 4
        if (
            start not in (0, summary)
            or not self._found.data_end
            or (offset_start and offset_start not in (*self._starts, self._footer))
        ):
            found.faults.append("the footer is wrong")
        elif crc and start:
            actual = zlib.crc32(self._read(start, self._footer + RECORD.size + 16 - start))
            if actual != crc:
                found.faults.append("the checksum of the summary does not match")
            elif not found.gaps:
                self._trust_summary(start)
        if self._data_crc and not found.gaps and self._data_crc not in self._data_checksums():
            found.faults.append("the checksum of the data section does not match, although those of its chunks do")

    def _trust_summary(self, start: int) -> None:
        """Notes that the descriptions in the summary are known to be unchanged."""
        for position, opcode in list(self._starts.items()):
            if position >= start and opcode in _DESCRIPTIONS:
                _, length = RECORD.unpack(self._read(position, RECORD.size))
                self._describe(opcode, self._read(position + RECORD.size, length), trust=2)

    def _data_checksums(self) -> tuple[int, int]:
        """Returns the checksums of the data section with and without the magic bytes before it; writers do either."""
        whole, inner, magic = 0, 0, len(MCAP0_MAGIC)
        for offset in range(0, self._found.data_end, _WINDOW):
            data = self._read(offset, min(_WINDOW, self._found.data_end - offset))
            whole, inner = zlib.crc32(data, whole), zlib.crc32(data[magic:] if not offset else data, inner)
        return whole, inner

    def _check_summary(self) -> None:
        """Compares the summary with what the file really holds."""
        found = self._found
        if self._statistics:
            statistics, counts = self._statistics, found.counts
            listed = Counter({channel: count for channel, count in statistics.channel_message_counts.items() if count})
            times = [time for chunk in found.chunks if chunk.messages for time in chunk.times]
            span = min(times, default=0), max(times, default=0)
            is_right = statistics.message_count == counts.total() and listed in (counts, Counter())
            is_right = is_right and (not times or span == (statistics.message_start_time, statistics.message_end_time))
            if not found.gaps and not is_right:
                found.faults.append("the statistics are wrong")
            # Statistics that contradict themselves tell nothing about what is lost.
            found.listed = listed if listed.total() == statistics.message_count else None
        # Behind gaps the index is another one in any case: it lists what was in them.
        if self._chunk_indices and not found.gaps and not self._are_chunks_listed():
            found.faults.append("the index of chunks is wrong")
        others = {(begin, end - begin) for _, begin, end in found.others}
        is_outside = any(self._starts.get(start) != opcode for opcode, start, length in self._offsets if length)
        if is_outside or not others.issuperset(self._other_indices) or not self._is_described():
            found.faults.append("the summary is wrong")

    def _are_chunks_listed(self) -> bool:
        """Returns whether the index of chunks lists exactly the chunks that have messages, and their message indices."""
        chunks = {c.start: c for c in self._found.chunks if not c.is_run}
        listed = {index.chunk_start_offset: index for index in self._chunk_indices}
        if len(listed) != len(self._chunk_indices) or {start for start, c in chunks.items() if c.messages} - listed.keys():
            return False
        for start, index in listed.items():
            chunk = chunks.get(start)
            if chunk is None:
                return False
            sizes = (index.chunk_length, index.compression, index.compressed_size, index.uncompressed_size)
            is_right = sizes == (chunk.end - start, chunk.compression, chunk.size, chunk.unpacked_size)
            is_right = is_right and (not chunk.messages or chunk.times == (index.message_start_time, index.message_end_time))
            offsets = index.message_index_offsets
            is_right = is_right and all(self._message_indices.get(offset) == channel for channel, offset in offsets.items())
            if not is_right or (offsets and offsets.keys() != chunk.messages.keys()):
                return False
        return True

    def _is_described(self) -> bool:
        """Returns whether the data section describes the topics and types that the summary does, if it does. Those of topics without messages
        may be in the summary alone, as the C++ library writes them.
        """
        data = {(opcode, number) for position, opcode, number in self._described if position < self._found.data_end}
        summary = {(opcode, number) for position, opcode, number in self._described if position > self._found.data_end}
        if not self._found.data_end or not summary:
            return True
        counts = self._found.counts
        without_messages = {
            (opcode, number) for opcode, number in summary - data if opcode == Opcode.SCHEMA or not counts[number]
        }
        return data == summary - without_messages

    def _choose(self, known_topics: Callable[[Channel, Schema | None], bool]) -> None:
        """Chooses the best copy of each description, and names those that differ."""
        found = self._found
        found.schemas = {k: v for k, v in self._chosen(self._schemas, lambda _: False).items() if isinstance(v, Schema)}
        is_known = lambda record: isinstance(record, Channel) and known_topics(record, found.schemas.get(record.schema_id))  # noqa: E731
        found.channels = {k: v for k, v in self._chosen(self._channels, is_known).items() if isinstance(v, Channel)}
        used = found.counts.keys()
        trusted = {number for number, copies in self._channels.by_id.items() if any(trust for trust, _ in copies)}
        found.channels = {number: channel for number, channel in found.channels.items() if number in used | trusted}
        needed = {channel.schema_id for channel in found.channels.values()}
        trusted = {number for number, copies in self._schemas.by_id.items() if any(trust for trust, _ in copies)}
        found.schemas = {number: schema for number, schema in found.schemas.items() if number in needed | trusted}

    def _chosen(self, copies: _Copies, is_known: Callable[[Schema | Channel], bool]) -> dict[int, Schema | Channel]:
        chosen: dict[int, Schema | Channel] = {}
        for number, all_copies in sorted(copies.by_id.items()):
            # What was found inside of damaged bytes counts only if there is nothing else.
            kept = [copy for copy in all_copies if copy[0]] or all_copies
            best = max(kept, key=lambda copy: (copy[0], is_known(copy[1])))[1]
            chosen[number] = best
            if any(record != best for trust, record in kept if trust):
                name = best.name if isinstance(best, Schema) else best.topic
                self._found.faults.append(f"the descriptions of {copies.kind} {name!r:.200} differ")
        return chosen


def _content(content: bytes) -> tuple[dict[int, list[tuple[int, int]]], list[tuple[int, bytes]]]:
    """Returns the messages in a chunk, and the descriptions as (opcode, payload); raises if it is damaged."""
    messages: dict[int, list[tuple[int, int]]] = {}
    descriptions = []
    for opcode, begin, end in records(content):
        if opcode == Opcode.MESSAGE:
            channel, _, log_time, _ = MESSAGE.unpack_from(content, begin)
            messages.setdefault(channel, []).append((log_time, begin - RECORD.size))
        elif opcode in _DESCRIPTIONS:
            payload = content[begin:end]
            if not _is_exact(opcode, payload, longer=True):
                raise ValueError("a description in the chunk is damaged")
            descriptions.append((opcode, payload))
    return messages, descriptions


_LAYOUTS: dict[int, str] = {
    Opcode.HEADER: "ss",
    Opcode.FOOTER: "20",
    Opcode.SCHEMA: "2sss",
    Opcode.CHANNEL: "4sss",
    Opcode.MESSAGE_INDEX: "2s",
    Opcode.CHUNK_INDEX: "32s8s16",
    Opcode.ATTACHMENT_INDEX: "40ss",
    Opcode.STATISTICS: "42s",
    Opcode.METADATA: "ss",
    Opcode.METADATA_INDEX: "16s",
    Opcode.SUMMARY_OFFSET: "17",
    Opcode.DATA_END: "4",
}
"""Content of each kind of record: number of bytes, or s = a length of 4 bytes and so many bytes."""
_FIELD = re.compile(r"\d+|s")


def _is_exact(opcode: int, payload: bytes, *, longer: bool = False) -> bool:
    """Returns whether the fields of a record fill it exactly; ``longer``: or leave a rest, as those of newer versions of the format."""
    layout = _LAYOUTS.get(opcode)
    if layout is None:
        return False
    offset = 0
    for part in _FIELD.findall(layout):
        if part == "s":
            if offset + 4 > len(payload):
                return False
            offset += 4 + int(struct.unpack_from("<I", payload, offset)[0])
        else:
            offset += int(part)
    if opcode == Opcode.MESSAGE_INDEX and (len(payload) - 6) % 16:
        return False
    return offset <= len(payload) if longer else offset == len(payload)
