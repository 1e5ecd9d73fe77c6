"""Reads the rows of a damaged SQLite database page by page, without SQLite, which gives up at the first page that it cannot follow.

Rows are taken from all leaf pages of tables, those that the tree no longer reaches too, and are told apart by their columns. SQLite has no
checksums in the database: a row counts as sound if its lengths, its types and its chain of overflow pages agree. Pages that were committed
to the write-ahead log, whose checksums hold, take the place of those in the database. Format: https://sqlite.org/fileformat.html.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

_HEADER_BYTES = 100
_TABLE_LEAF, _TABLE_INTERIOR, _INDEX_LEAF, _INDEX_INTERIOR = 13, 5, 10, 2
_KINDS = (_TABLE_LEAF, _TABLE_INTERIOR, _INDEX_LEAF, _INDEX_INTERIOR)
_SIZES = tuple(2**k for k in range(9, 17))
_USUAL_SIZE = 4096
_LOG_MAGIC = (0x377F0682, 0x377F0683)
_INTEGER_BYTES = (0, 1, 2, 3, 4, 6, 8)
"""Size of an integer by its type code."""
_MOST_COLUMNS = 12

Value = int | float | str | bytes | None


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a table."""

    page: int
    """Number of the leaf page, from 1."""
    offset: int
    """Offset in the page of the cell."""
    rowid: int
    kinds: tuple[int, ...]
    """Type codes of the columns."""
    size: int
    """Size of the columns with their type codes, bytes."""
    chain: tuple[int, ...]
    """Numbers of the overflow pages."""
    local: int
    """Offset in the page of the columns with their type codes."""

    @property
    def in_order(self) -> bool:
        """Whether the overflow pages follow each other, as those of a table that only grows."""
        return all(b == a + 1 for a, b in pairwise(self.chain))


@dataclass(slots=True)
class PageScan:
    """What the pages of a database hold."""

    pages: int
    rows: list[Row] = field(default_factory=list)
    damaged: dict[int, str] = field(default_factory=dict)
    """Page -> what is wrong with it."""


class DatabasePages:
    """A database, with its write-ahead log, as pages."""

    def __init__(self, path: Path, page_size: int, reserved: int) -> None:
        """Opens it; ``reserved``: unused bytes at the end of each page.

        Raises:
            OSError: it cannot be read.
        """
        self._file = os.open(path, os.O_RDONLY)
        self.page_size, self._usable = page_size, page_size - reserved
        self._log: int | None = None
        self._in_log: dict[int, int] = {}
        self._log_pages = 0
        self._extra: list[int] = []
        """Offsets of damaged pages in the log: their rows count where no sound page has them."""
        self.notes: list[str] = []
        self.log_is_whole = True
        """Whether nothing that was committed to the write-ahead log is damaged."""
        log = path.with_name(path.name + "-wal")
        if log.is_file():
            self._log = os.open(log, os.O_RDONLY)
            self._read_log()
        size = os.fstat(self._file).st_size
        self.pages = max(-(-size // page_size), max(self._in_log, default=0), self._log_pages)

    def close(self) -> None:
        """Closes the files."""
        os.close(self._file)
        if self._log is not None:
            os.close(self._log)

    def page(self, number: int) -> bytes:
        """Returns the bytes of a page, without the reserved ones; fewer if the file ends within it.

        Damaged pages of the log have the numbers after those of the database.
        """
        if number > self.pages and self._log is not None:
            return os.pread(self._log, self._usable, self._extra[number - self.pages - 1])
        if number in self._in_log and self._log is not None:
            return os.pread(self._log, self._usable, self._in_log[number])
        return os.pread(self._file, self._usable, (number - 1) * self.page_size)

    def columns(self, row: Row, count: int = _MOST_COLUMNS) -> list[Value]:
        """Returns the first values of a row; those of numbers do not need its overflow pages.

        Raises:
            ValueError: a text is not UTF-8.
        """
        kinds = row.kinds[:count]
        content = self._content(row) if count >= len(row.kinds) else self.page(row.page)[row.local :]
        _, offset = _varint(content, 0)
        for _ in row.kinds:
            _, offset = _varint(content, offset)
        values: list[Value] = []
        for kind in kinds:
            size = _size(kind)
            part = content[offset : offset + size]
            offset += size
            values.append(_value(kind, part))
        return values

    def scan(self) -> PageScan:
        """Finds all rows, and the pages that cannot be what they should be."""
        found = PageScan(self.pages)
        free = self._free_pages()
        odd: list[tuple[int, int]] = []
        for number in range(1, self.pages + 1):
            page = self.page(number)
            kind = page[_HEADER_BYTES if number == 1 else 0] if len(page) > _HEADER_BYTES else 0
            if number in free:
                continue
            if len(page) < self._usable:
                found.damaged[number] = "the file ends within it"
            if kind == _TABLE_LEAF:
                found.rows += self._leaf(number, page, found)
            elif kind not in (_INDEX_LEAF, _INDEX_INTERIOR):
                odd.append((number, kind))
        used = {page for row in found.rows for page in row.chain}
        for number, kind in odd:
            if number in used:
                continue
            # A leaf whose kind is damaged; or the middle of a tree; or part of a row that is damaged.
            attempt = PageScan(self.pages)
            rows = self._leaf(number, self.page(number), attempt) if (kind ^ _TABLE_LEAF).bit_count() == 1 else []
            if rows and not attempt.damaged:
                found.rows += rows
                found.damaged[number] = "its kind is wrong"
            elif kind != _TABLE_INTERIOR and any(self.page(number)):
                found.damaged[number] = "nothing leads to it"
        for number in range(self.pages + 1, self.pages + 1 + len(self._extra)):
            sound = {(row.rowid, len(row.kinds)) for row in found.rows}
            found.rows += [
                row for row in self._leaf(number, self.page(number), found) if (row.rowid, len(row.kinds)) not in sound
            ]
            found.damaged[number] = "a page of the write-ahead log whose checksum does not match"
        self._settle(found)
        return found

    def _settle(self, found: PageScan) -> None:
        """Leaves out rows that claim an overflow page of another row: one of the two was led there by a damaged number."""
        owners: dict[int, list[Row]] = {}
        for row in found.rows:
            for page in row.chain:
                owners.setdefault(page, []).append(row)
        wrong: set[tuple[int, int]] = set()
        for page, rows in owners.items():
            if len(rows) > 1:
                trusted = [row for row in rows if row.in_order]
                for row in rows:
                    if len(trusted) != 1 or row is not trusted[0]:
                        wrong.add((row.page, row.offset))
                        found.damaged[row.page] = f"a row on it continues on page {page}, which belongs to another row"
        found.rows = [row for row in found.rows if (row.page, row.offset) not in wrong]

    def _leaf(self, number: int, page: bytes, found: PageScan) -> list[Row]:
        """Returns the rows on a leaf page, and notes the page as damaged where some cannot be read."""
        begin = _HEADER_BYTES if number == 1 else 0
        rows: list[Row] = []
        try:
            _, _, count, _, _ = struct.unpack_from(">BHHHB", page, begin)
            pointers = struct.unpack_from(f">{count}H", page, begin + 8)
        except struct.error:
            found.damaged[number] = "it has no room for its rows"
            return rows
        content_begin = begin + 8 + 2 * count
        spans = []
        for pointer in pointers:
            try:
                if pointer < content_begin:
                    raise ValueError("a row in the head of the page")
                row, end = self._row(number, page, pointer)
            except (ValueError, IndexError, struct.error) as error:
                found.damaged[number] = f"a row on it cannot be read: {error}"
                continue
            rows.append(row)
            spans.append((pointer, end, row))
        # Rows never overlap; where they do, a length or a pointer is wrong, and it is unknown which.
        spans.sort(key=lambda span: span[:2])
        wrong = {id(r) for (_, end, a), (start, _, b) in pairwise(spans) if end > start for r in (a, b)}
        if wrong:
            found.damaged[number] = "rows on it overlap"
        return [row for row in rows if id(row) not in wrong]

    def _row(self, number: int, page: bytes, offset: int) -> tuple[Row, int]:
        """Returns the row of a cell, and the offset after the cell; raises if its lengths do not agree."""
        cell = offset
        size, offset = _varint(page, offset)
        rowid, offset = _varint(page, offset)
        local = self._local_bytes(size)
        if size < 2 or offset + local > len(page):
            raise ValueError("it is longer than the page")
        chain: list[int] = []
        end = offset + local
        if local < size:
            (following,) = struct.unpack_from(">I", page, end)
            end += 4
            for _ in range(-(-(size - local) // (self._usable - 4))):
                if not 1 <= following <= self.pages or following in chain:
                    raise ValueError("its overflow pages end early")
                chain.append(following)
                (following,) = struct.unpack_from(">I", self.page(following))
            if following:
                raise ValueError("it has too many overflow pages")
        head_size, at = _varint(page, offset)
        kinds: list[int] = []
        while at < offset + head_size:
            kind, at = _varint(page, at)
            kinds.append(kind)
            if len(kinds) > _MOST_COLUMNS:
                raise ValueError("it has too many columns")
        if at != offset + head_size or head_size + sum(map(_size, kinds)) != size:
            raise ValueError("the lengths of its columns do not add up")
        return Row(number, cell, _signed(rowid), tuple(kinds), size, tuple(chain), offset), end

    def _local_bytes(self, size: int) -> int:
        """Returns how many bytes of a row of a table are in the page itself."""
        most, least = self._usable - 35, (self._usable - 12) * 32 // 255 - 23
        if size <= most:
            return size
        some = least + (size - least) % (self._usable - 4)
        return some if some <= most else least

    def _content(self, row: Row) -> bytes:
        page = self.page(row.page)
        parts = [page[row.local : row.local + self._local_bytes(row.size)]]
        missing = row.size - len(parts[0])
        for number in row.chain:
            part = self.page(number)[4 : 4 + missing]
            parts.append(part)
            missing -= len(part)
        return b"".join(parts)

    def _free_pages(self) -> set[int]:
        """Returns the numbers of the pages that the database has given up, as far as its list of them can be read."""
        free: set[int] = set()
        (trunk,) = struct.unpack_from(">I", self.page(1).ljust(_HEADER_BYTES, b"\0"), 32)
        while 1 < trunk <= self.pages and trunk not in free:
            page = self.page(trunk)
            if len(page) < 8:
                break
            following, count = struct.unpack_from(">II", page)
            # A trunk is no page of a tree: its first number is that of a page, so that its first byte is 0.
            if page[0] in _KINDS or count > self._usable // 4 - 2:
                break
            leaves = struct.unpack_from(f">{count}I", page, 8)
            if not all(1 < leaf <= self.pages for leaf in leaves):
                break
            free.update((trunk, *leaves))
            trunk = following
        return free

    def _read_log(self) -> None:
        """Finds the newest committed version of each page in the write-ahead log.

        The checksum of a frame covers the one before it, so frames after a damaged one can still be checked.
        """
        assert self._log is not None
        head = os.pread(self._log, 32, 0)
        if len(head) < 32:
            return
        magic, _, size, _, *salts = struct.unpack_from(">6I", head)
        order = ">" if magic == _LOG_MAGIC[1] else "<"
        checksum = struct.unpack_from(">2I", head, 24)
        if magic not in _LOG_MAGIC or size != self.page_size or _checksum(order, head[:24], (0, 0)) != checksum:
            self.log_is_whole = False
            self.notes.append("the head of the write-ahead log is damaged")
            size = self.page_size
            salts = list(struct.unpack(">2I", os.pread(self._log, 8, 40).ljust(8, b"\0")))  # those of the first page
        waiting: dict[int, int] = {}
        odd: list[int] = []
        damaged, offset = 0, 32
        while True:
            frame = os.pread(self._log, 24 + size, offset)
            if len(frame) < 24 + size:
                break
            number, commit, *rest = struct.unpack_from(">6I", frame)
            stored = (rest[2], rest[3])
            actual = _checksum(order, frame[24:], _checksum(order, frame[:8], checksum))
            if list(rest[:2]) != list(salts) and actual != stored:
                break  # the rest is from before the log was begun anew
            if actual == stored:
                waiting[number] = offset + 24
                if commit:
                    self._log_pages = commit
                    self._in_log.update(waiting)
                    self._extra += odd
                    waiting, odd = {}, []
            else:
                damaged += 1
                odd.append(offset + 24)
            checksum = stored
            offset += 24 + size
        if odd:
            # The mark that the last transaction is finished may be what is damaged.
            self._in_log.update(waiting)
            self._extra += odd
            waiting = {}
        if damaged:
            self.log_is_whole = False
            self.notes.append(f"{damaged} pages of the write-ahead log are damaged: what can be read of them is used, unchecked")
        if waiting:
            self.notes.append("the last transaction was not finished: its messages are left out")


def page_layouts(path: Path) -> Iterator[tuple[int, int]]:
    """Yields the possible (page size, reserved bytes per page) of a database, the most probable first.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES).ljust(_HEADER_BYTES, b"\0")
    (size,) = struct.unpack_from(">H", head, 16)
    size = 65536 if size == 1 else size
    sizes = [size] if size in _SIZES else [_USUAL_SIZE, *(s for s in _SIZES if s != _USUAL_SIZE)]
    for reserved in dict.fromkeys((0, head[20])):
        for one in sizes:
            if one - reserved >= 480:
                yield one, reserved


def _varint(data: bytes, offset: int) -> tuple[int, int]:
    """Returns the integer of 1 to 9 bytes at an offset, and the offset after it; raises IndexError at the end of the data."""
    value = 0
    for k in range(8):
        byte = data[offset + k]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, offset + k + 1
    return value << 8 | data[offset + 8], offset + 9


def _signed(value: int) -> int:
    return value - 2**64 if value >= 2**63 else value


def _size(kind: int) -> int:
    """Returns the size of a value by its type code."""
    if kind < 7:
        return _INTEGER_BYTES[kind]
    if kind < 12:
        if kind > 9:
            raise ValueError("a column has a reserved type")
        return 8 if kind == 7 else 0
    return (kind - 12) // 2


def _value(kind: int, data: bytes) -> Value:
    if kind == 0:
        return None
    if kind < 7:
        return int.from_bytes(data, "big", signed=True)
    if kind == 7:
        return float(struct.unpack(">d", data)[0])
    if kind < 10:
        return kind - 8
    return data.decode() if kind % 2 else data


def _checksum(order: str, data: bytes, start: tuple[int, int]) -> tuple[int, int]:
    """Returns the checksum of the write-ahead log."""
    a, b = start
    words = struct.unpack(f"{order}{len(data) // 4}I", data)
    for k in range(0, len(words), 2):
        a = (a + words[k] + b) & 0xFFFFFFFF
        b = (b + words[k + 1] + a) & 0xFFFFFFFF
    return a, b
