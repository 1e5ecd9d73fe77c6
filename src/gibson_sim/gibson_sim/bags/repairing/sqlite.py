"""Writes the readable part of a damaged SQLite file of a bag to a new one.

A copy is given to SQLite, which merges the write-ahead log and checks its pages. Only if it finds damage are the rows read page by page.
"""

from __future__ import annotations

import shutil
import sqlite3
from collections import Counter
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path

from gibson_sim.bags.definitions import MessageDefinitions, settled
from gibson_sim.bags.metadata import (
    VERSION,
    TopicRecord,
    bag_information,
    damaged_qos,
    dump_information,
    dump_qos,
    is_qos,
    listed_topics,
    parse_information,
)
from gibson_sim.bags.repairing.sqlite_pages import DatabasePages, PageScan, Row, Value, page_layouts
from gibson_sim.bags.sqlite_file import INSERT_METADATA, SCHEMA, as_os_error, contents_of
from gibson_sim.bags.storage import EmptyFileError, FileContents, FileRepair
from gibson_sim.errors import RecordError
from gibson_sim.quoting import enumerated

COMPANIONS = ("-wal", "-journal", "-shm")
"""Endings of the files that SQLite puts beside a database."""
_MAGIC = b"SQLite format 3\0"
_MOST_NOTES = 3
_ENCODINGS = ("ros2msg", "ros2idl", "unknown", "")
_ODD_ROWS = "SELECT COUNT(*) FROM messages WHERE typeof(topic_id) != 'integer' OR typeof(timestamp) != 'integer' OR typeof(data) != 'blob'"

_DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"


@dataclass(slots=True)
class _Tables:
    """Rows of a bag's tables, found page by page."""

    topics: dict[int, list[Value]] = field(default_factory=dict)
    """Id -> name, type, serialization format, QoS, hash."""
    definitions: dict[int, list[Value]] = field(default_factory=dict)
    messages: list[tuple[int, Row]] = field(default_factory=list)
    """(id, row), sorted."""
    listed: dict[str, TopicRecord] = field(default_factory=dict)
    """Topics by name, as the metadata in the database lists them."""


def repair_sqlite(path: Path, draft: Path, known: Mapping[str, TopicRecord]) -> FileRepair:
    """Reads a database to its end, and writes what can be read to a new one unless it is whole.

    Args:
        path: the file; never changed.
        draft: the file to write.
        known: topics by name, as the metadata of the bag lists them.

    Raises:
        EmptyFileError: nothing was recorded.
        RecordError: it is not the database of a bag.
        OSError: a file cannot be read or written.
    """
    broken_off = any(path.with_name(path.name + ending).is_file() for ending in COMPANIONS[:2])
    pages = _pages(path)
    try:
        contents, complaints = _copied(path, draft, known)
        if contents is not None and not complaints and pages.log_is_whole:
            if not broken_off:
                remove(draft)
            return FileRepair(contents, "pages", (), tuple(pages.notes), None, True, True, contents.count, changed=broken_off)
        remove(draft)
        return _salvage(path, draft, pages, complaints, known)
    except sqlite3.Error as error:
        raise as_os_error(error) from error
    finally:
        pages.close()


def remove(path: Path) -> None:
    """Deletes a database and the files of SQLite beside it."""
    for ending in ("", *COMPANIONS):
        path.with_name(path.name + ending).unlink(missing_ok=True)


def _copied(path: Path, draft: Path, known: Mapping[str, TopicRecord]) -> tuple[FileContents | None, list[str]]:
    """Copies a database with its log and lets SQLite merge and check the copy; returns what it holds, and what is wrong with it."""
    remove(draft)
    for ending in ("", *COMPANIONS[:2]):
        source = path.with_name(path.name + ending)
        if source.is_file():
            shutil.copyfile(source, draft.with_name(draft.name + ending))
    try:
        with closing(sqlite3.connect(draft, isolation_level=None)) as connection:
            connection.execute("PRAGMA synchronous=FULL")
            connection.execute("PRAGMA journal_mode=DELETE")
            complaints = [str(row[0]) for row in connection.execute(f"PRAGMA integrity_check({_MOST_NOTES})") if row[0] != "ok"]
            (odd,) = connection.execute(_ODD_ROWS).fetchone()
            if odd:
                complaints.append(f"{odd} messages have values of other types than messages have")
            contents = contents_of(path, connection)
            rows = (
                connection.execute("SELECT metadata FROM metadata ORDER BY id DESC LIMIT 1").fetchall()
                if _has_metadata(connection)
                else []
            )
            agreed = _agreed(known, listed_topics(parse_information(str(rows[0][0])))) if rows else {}
            strange = {t.name for t in contents.topics if t.name not in agreed or agreed[t.name].type_name != t.type_name}
            if strange and agreed.keys() - {t.name for t in contents.topics if t.name not in strange}:
                complaints.append(f"topics {', '.join(sorted(strange))} are not those of the metadata"[:200])
            complaints += [
                damaged_qos(name, "metadata") for name, qos in _qos_texts(connection) if _is_altered(name, qos, agreed)
            ]
            complaints += [text for text in (_complaint_about_topics(connection),) if text]
            return contents, complaints
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        if "full" in str(error):
            raise
        return None, [str(error)]


def _qos_texts(connection: sqlite3.Connection) -> list[tuple[str, str]]:
    columns = {name for _, name, *_ in connection.execute("PRAGMA table_info(topics)")}
    if "offered_qos_profiles" not in columns:
        return []
    return [(str(name), str(qos)) for name, qos in connection.execute("SELECT name, offered_qos_profiles FROM topics")]


def _is_altered(topic: str, qos: str, known: Mapping[str, TopicRecord]) -> bool:
    """Returns whether one character of the QoS of a topic is another one than in the metadata: readers may then not find the topic."""
    right = dump_qos(known[topic].qos) if topic in known else qos
    return len(qos) == len(right) and sum(a != b for a, b in zip(qos, right, strict=True)) == 1


def _has_metadata(connection: sqlite3.Connection) -> bool:
    return bool(connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'metadata'").fetchone())


def _agreed(known: Mapping[str, TopicRecord], listed: Mapping[str, TopicRecord]) -> dict[str, TopicRecord]:
    """Returns the topics for which the metadata of the bag and that in the database agree, so that neither can be what is damaged."""
    return {name: topic for name, topic in known.items() if name in listed and listed[name].type_name == topic.type_name}


def _pages(path: Path) -> DatabasePages:
    """Opens a database as pages, with the page size for which most rows can be read."""
    best: tuple[int, int, int] | None = None
    layouts = list(page_layouts(path))
    for size, reserved in layouts if len(layouts) > 1 else ():
        pages = DatabasePages(path, size, reserved)
        try:
            count = len(pages.scan().rows)
        finally:
            pages.close()
        if best is None or count > best[0]:
            best = count, size, reserved
    return DatabasePages(path, *(best[1:] if best else layouts[0]))


def _salvage(
    path: Path, draft: Path, pages: DatabasePages, complaints: list[str], known: Mapping[str, TopicRecord]
) -> FileRepair:  # fmt: skip
    """Writes all rows that can be read page by page to a new database."""
    found = pages.scan()
    tables = _sorted_rows(pages, found)
    if not tables.messages and not tables.topics:
        with path.open("rb") as file:
            begin = file.read(len(_MAGIC))
        if not begin or begin == _MAGIC:
            raise EmptyFileError(f"{path} ends before its first record: nothing was recorded, delete it")
        raise RecordError(f"{path} is not a bag ({complaints[0] if complaints else 'no messages'}): nothing can be repaired")
    notes = [*pages.notes, *(f"SQLite finds: {' '.join(text.split())[:200]}" for text in complaints[:_MOST_NOTES])]
    agreed = _agreed(known, tables.listed) if known and tables.listed else dict(known or tables.listed)
    notes += _name_topics(pages, tables, agreed)
    notes += _settle_types(tables, agreed)
    written, left_out = _write(draft, pages, tables)
    notes += [
        f"{count} messages of topic number {number} are left out: nothing says which topic it is"
        for number, count in left_out.items()
    ]
    missing = _missing(tables.messages)
    if missing:
        notes.append(f"messages that are missing, by their numbers: {missing}")
    with closing(sqlite3.connect(draft, isolation_level=None)) as connection:
        contents = contents_of(path, connection)
        information = bag_information(contents.topics, [contents.record], "sqlite3")
        connection.execute(INSERT_METADATA, (VERSION, dump_information(information)))
    gaps = tuple((number, number + 1, reason) for number, reason in sorted(found.damaged.items()))
    harmless = not (gaps or left_out or missing)
    return FileRepair(contents, "pages", gaps, tuple(notes), None, harmless, False, written, changed=True)


def _sorted_rows(pages: DatabasePages, found: PageScan) -> _Tables:
    """Returns the rows by table, which their columns tell; of several with one number, the first counts."""
    tables = _Tables()
    messages: dict[int, Row] = {}
    for row in found.rows:
        if len(row.kinds) == 4 and _is_integer(row.kinds[1]) and _is_integer(row.kinds[2]) and _is_blob(row.kinds[3]):
            messages.setdefault(row.rowid, row)
            continue
        texts = len([kind for kind in row.kinds[1:] if kind > 12 and kind % 2])
        is_metadata = len(row.kinds) == 3 and texts == 1
        if not (is_metadata or (texts == len(row.kinds) - 1 and texts >= 3)):
            continue
        try:
            values = pages.columns(row)[1:]
        except ValueError as error:
            found.damaged[row.page] = f"a text on it cannot be read: {error}"
            continue
        if is_metadata:
            tables.listed = listed_topics(parse_information(str(values[-1]))) or tables.listed
        elif str(values[0]).startswith("/"):
            tables.topics.setdefault(row.rowid, [*values, "", ""][:5])
        elif len(values) == 4 and values[1] in _ENCODINGS:
            tables.definitions.setdefault(row.rowid, values)
    tables.messages = sorted(messages.items())
    return tables


def _is_integer(kind: int) -> bool:
    return 1 <= kind <= 6 or kind in (8, 9)


def _is_blob(kind: int) -> bool:
    return kind >= 12 and kind % 2 == 0


def _name_topics(pages: DatabasePages, tables: _Tables, known: Mapping[str, TopicRecord]) -> list[str]:
    """Gives topics whose row is lost or damaged the name that only the metadata has, if there is just one; returns what was done."""
    notes = []
    used = {int(str(pages.columns(row, 2)[1])) for _, row in tables.messages}
    names = {str(values[0]): number for number, values in tables.topics.items()}
    missing = [name for name in known if name not in names]
    strange = [number for name, number in names.items() if known and name not in known]
    nameless = [number for number in used if number not in tables.topics]
    if len(missing) == 1 and len(strange) + len(nameless) == 1:
        (number,), name = (*strange, *nameless), missing[0]
        before = repr(tables.topics[number][0])[:100] if number in tables.topics else f"number {number}"
        notes.append(f"topic {before} is {name!r:.100}: the metadata of the bag says so")
        tables.topics[number] = [name, known[name].type_name, "cdr", dump_qos(known[name].qos), known[name].type_hash]
    for values in tables.topics.values():
        topic = known.get(str(values[0]))
        if topic is not None and topic.type_name != values[1]:
            notes.append(
                f"the type of {values[0]!r:.100} is {topic.type_name!r:.100} as in the metadata of the bag, not {values[1]!r:.100}"
            )
            values[1] = topic.type_name
    return notes


def _settle_types(tables: _Tables, known: Mapping[str, TopicRecord]) -> list[str]:
    """Replaces descriptions of topics and types that are lost or damaged beyond use; returns what was done."""
    notes = []
    texts = {str(values[0]): values for values in tables.definitions.values() if values[1] == "ros2msg"}
    for values in tables.topics.values():
        topic, name = str(values[0]), str(values[1])
        if not is_qos(str(values[3])) or _is_altered(topic, str(values[3]), known):
            replacement = dump_qos(known[topic].qos) if topic in known else ""
            values[3] = replacement
            notes.append(damaged_qos(topic, replacement))
        definition = texts.get(name)
        if definition is None and not any(name == described[0] for described in tables.definitions.values()):
            with suppress(RecordError):
                definition = texts[name] = [name, "ros2msg", MessageDefinitions().full_text(name), ""]
                tables.definitions[max(tables.definitions, default=0) + 1] = definition
                notes.append(f"the description of type {name} is missing; in its place: that of the installed type")
        if definition is not None and values[4]:
            definition[2], values[4], note = settled(name, str(definition[2]), str(values[4]))
            definition[3] = values[4]
            notes += [note] if note else []
    return list(dict.fromkeys(notes))


def _complaint_about_topics(connection: sqlite3.Connection) -> str:
    """Returns what is wrong with the descriptions of topics and types; empty if nothing is, or the database is older and has none."""
    columns = {name for _, name, *_ in connection.execute("PRAGMA table_info(topics)")}
    if "offered_qos_profiles" in columns:
        for topic, qos in connection.execute("SELECT name, offered_qos_profiles FROM topics"):
            if not is_qos(str(qos)):
                return f"the QoS of topic {topic!r:.200} cannot be parsed"
    if "type_description_hash" not in columns or not connection.execute("PRAGMA table_info(message_definitions)").fetchall():
        return ""
    texts = {name: (encoding, text) for name, encoding, text in connection.execute(_DEFINITIONS)}
    for name, value in connection.execute("SELECT type, type_description_hash FROM topics").fetchall():
        encoding, text = texts.get(name, ("", ""))
        if encoding not in _ENCODINGS or (texts and name not in texts):
            return f"type {name!r:.200} has no description"
        note = settled(str(name), str(text), str(value))[2] if encoding == "ros2msg" and value else ""
        if note:
            return note
    return ""


def _write(draft: Path, pages: DatabasePages, tables: _Tables) -> tuple[int, Counter[int]]:
    """Writes the rows to a new database; returns how many messages, and how many of each unknown topic are left out."""
    left_out: Counter[int] = Counter()
    written = 0
    with closing(sqlite3.connect(draft, isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode=OFF")
        connection.execute("PRAGMA synchronous=FULL")
        connection.executescript(SCHEMA)
        connection.execute("BEGIN")
        for number, values in sorted(tables.topics.items()):
            connection.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", (number, *values))
        for number, values in sorted(tables.definitions.items()):
            connection.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, ?)", (number, *values))
        for number, row in tables.messages:
            _, topic, timestamp, data = pages.columns(row)
            if topic not in tables.topics:
                left_out[int(topic or 0)] += 1
                continue
            connection.execute("INSERT INTO messages VALUES (?, ?, ?, ?)", (number, topic, timestamp, data))
            written += 1
        connection.execute("COMMIT")
    return written, left_out


def _missing(messages: list[tuple[int, Row]]) -> str:
    """Returns the numbers between the first and the last message that are missing, as text; rosbag2 counts them from 1."""
    parts, expected = [], 1
    for number, _ in messages:
        if number > expected:
            parts.append(f"{expected}" if number == expected + 1 else f"{expected} to {number - 1}")
        expected = number + 1
    return enumerated(parts, 20)
