"""Writes files of rosbag2's storage ``sqlite3``, schema 4, in transactions."""

from __future__ import annotations

import errno
import os
import sqlite3
from collections import Counter
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from gibson_sim.bags.folders import MIB
from gibson_sim.bags.metadata import ROS_DISTRO, VERSION, TopicRecord, dump_information, dump_qos, offered_qos
from gibson_sim.bags.storage import EmptyFileError, FileContents

TRANSACTION_BYTES = 2 * MIB
"""Maximum size of the messages in memory, bytes. Twice this size must fit into the emergency space: once in the log, once in the database."""
SCHEMA = f"""
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
  offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema (schema_version, ros_distro) VALUES (4, '{ROS_DISTRO}');
"""
_INSERT_MESSAGE = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)"
INSERT_METADATA = "INSERT INTO metadata (metadata_version, metadata) VALUES (?, ?)"


class SqliteFile:
    """A database that is being written. Committed messages survive a crash of this process; the schema has no publish time."""

    def __init__(self, path: Path, emergency: Path) -> None:
        """Creates the database.

        Raises:
            OSError: the database cannot be created.
        """
        self._path, self._emergency = path, emergency
        self._full = False
        self._topics: dict[str, int] = {}
        self._types: set[str] = set()
        self._waiting: list[tuple[int, int, bytes | memoryview]] = []
        self._waiting_bytes = self._size = 0
        self._connection: sqlite3.Connection | None = None
        with path.open("xb"):
            pass  # sqlite would append to an existing file
        try:
            self._connection = sqlite3.connect(path, isolation_level=None)
            # The log of a transaction reaches the kernel with its commit; waiting for the disk would only help in a power cut.
            self._connection.execute("PRAGMA journal_mode=WAL")
            self._connection.execute("PRAGMA synchronous=OFF")
            self._connection.executescript(SCHEMA)
        except sqlite3.Error as error:
            raise as_os_error(error) from error

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self._path

    @property
    def full(self) -> bool:
        """Whether the disk was full: later writes use the emergency space."""
        return self._full

    @property
    def size(self) -> int:
        """Total size of all messages, slightly less than the size of the file, bytes."""
        return self._size

    def add_topic(self, topic: TopicRecord, definition: str) -> None:
        """Declares a topic, with the definition of its type and of all nested types."""
        statements: list[tuple[str, tuple[Any, ...]]] = []
        if topic.type_name not in self._types:
            text = (
                "INSERT INTO message_definitions (topic_type, encoding, encoded_message_definition, type_description_hash) "
                "VALUES (?, 'ros2msg', ?, ?)"
            )
            statements.append((text, (topic.type_name, definition, topic.type_hash)))
        number = len(self._topics) + 1
        text = "INSERT INTO topics VALUES (?, ?, ?, 'cdr', ?, ?)"
        statements.append((text, (number, topic.name, topic.type_name, dump_qos(topic.qos), topic.type_hash)))
        self._transact(statements)
        self._types.add(topic.type_name)
        self._topics[topic.name] = number

    def write(self, topic: str, data: bytes | memoryview, log_time_ns: int, publish_time_ns: int) -> None:
        """Adds one message of a declared topic; the publish time is not stored."""
        self._waiting.append((self._topics[topic], log_time_ns, data))
        self._waiting_bytes += len(data)
        self._size += len(data)
        if self._waiting_bytes > TRANSACTION_BYTES:
            self.flush()

    def flush(self) -> None:
        """Commits the messages in memory."""
        if self._waiting:
            self._transact([])

    def finish(self, information: Mapping[str, Any]) -> None:
        """Writes the metadata, merges the log into the database and closes it."""
        self._transact([(INSERT_METADATA, (VERSION, dump_information(dict(information))))])
        try:
            self._open().execute("PRAGMA journal_mode=DELETE")
        except sqlite3.Error as error:
            raise as_os_error(error) from error
        self._close()

    def rescue(self) -> None:
        """Drops uncommitted messages and closes the database."""
        self._waiting, self._waiting_bytes = [], 0
        with suppress(sqlite3.Error):
            self._close()

    def _transact(self, statements: list[tuple[str, tuple[Any, ...]]]) -> None:
        """Commits the messages in memory and the statements; retries without the emergency file if the disk is full."""
        connection = self._open()
        while True:
            try:
                connection.execute("BEGIN")
                connection.executemany(_INSERT_MESSAGE, self._waiting)
                for text, values in statements:
                    connection.execute(text, values)
                connection.execute("COMMIT")
                break
            except sqlite3.Error as error:
                if connection.in_transaction:
                    connection.execute("ROLLBACK")
                failure = as_os_error(error)
                if failure.errno != errno.ENOSPC or self._full:
                    raise failure from error
                self._full = True
                self._emergency.unlink(missing_ok=True)
        self._waiting, self._waiting_bytes = [], 0

    def _open(self) -> sqlite3.Connection:
        assert self._connection is not None, "the database is closed"
        return self._connection

    def _close(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()


def merge_log(path: Path) -> FileContents:
    """Merges the write-ahead log of a database into it, so that a reader does not need the log; returns its readable content.

    Raises:
        EmptyFileError: nothing was recorded.
        RecordError: the file is not the database of a bag.
        sqlite3.DatabaseError: it is damaged.
        OSError: the file cannot be written.
    """
    try:
        with closing(sqlite3.connect(path, isolation_level=None)) as connection:
            connection.execute("PRAGMA synchronous=FULL")
            connection.execute("PRAGMA journal_mode=DELETE")
            return contents_of(path, connection)
    except sqlite3.OperationalError as error:
        if "no such table" in str(error):
            raise EmptyFileError(f"{path} ends before its first record: nothing was recorded, delete it") from error
        raise as_os_error(error) from error


def contents_of(path: Path, connection: sqlite3.Connection) -> FileContents:
    """Returns the topics and the number of messages of an open database.

    Raises:
        sqlite3.DatabaseError: it is damaged, or not that of a bag.
    """
    columns = {name for _, name, *_ in connection.execute("PRAGMA table_info(topics)")}
    # Databases of older releases do not have all columns.
    named = [
        "id",
        "name",
        "type",
        *("''" if name not in columns else name for name in ("offered_qos_profiles", "type_description_hash")),
    ]
    rows = connection.execute(f"SELECT {', '.join(named)} FROM topics ORDER BY id").fetchall()
    counts = Counter(dict(connection.execute("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id").fetchall()))
    start, end = connection.execute("SELECT MIN(timestamp), MAX(timestamp) FROM messages").fetchone()
    topics = tuple(
        TopicRecord(name, type_name, offered_qos(qos), type_hash, counts[number])
        for number, name, type_name, qos, type_hash in rows
    )
    return FileContents(path, start or 0, end or 0, topics)


def as_os_error(error: sqlite3.Error) -> OSError:
    """Converts an error of SQLite by its text; `sqlite_errorcode` would need Python 3.11."""
    text = str(error)
    number = errno.ENOSPC if "full" in text else errno.EACCES if "unable to open" in text or "readonly" in text else errno.EIO
    return OSError(number, f"{os.strerror(number)} ({text})")
