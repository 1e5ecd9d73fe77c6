"""Storage sqlite3: the tables of rosbag2, reading, and recovery after a crash or a full disk."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import yaml
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer as RosbagsWriter

from gibson_sim.bags.writer import BagWriter, DiskFullError, TopicQos, repair
from gibson_sim.errors import RecordError

STRING = "std_msgs/msg/String"


def _write(folder: Path, messages: Any, count: int = 10) -> list[bytes]:
    data = [messages.text(f"{i:1000d}") for i in range(count)]
    with BagWriter(folder, reserve_bytes=0, storage="sqlite3") as bag:
        bag.add_topic("/a", STRING, TopicQos.latched())
        for i, message in enumerate(data):
            bag.write("/a", message, 1000 + i, 900 + i)
    return data


def _rows(file: Path, query: str) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(file)) as connection:
        return connection.execute(query).fetchall()


def test_rosbags_reads_back_every_byte_and_time(tmp_path: Path, messages: Any) -> None:
    data = _write(tmp_path / "bag", messages)
    with AnyReader([tmp_path / "bag"]) as reader:
        assert [(c.topic, t, raw) for c, t, raw in reader.messages()] == [("/a", 1000 + i, d) for i, d in enumerate(data)]
        assert reader.connections[0].ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"


def test_repair_leaves_out_rows_that_are_no_messages_and_says_which(tmp_path: Path, messages: Any) -> None:
    data = _write(tmp_path / "bag", messages)
    (file,) = (tmp_path / "bag").glob("*.db3")
    with closing(sqlite3.connect(file)) as connection:
        connection.execute("UPDATE messages SET timestamp = 'soon' WHERE id = 3")
        connection.commit()
    result = repair(tmp_path / "bag")
    assert (result.messages, dict(result.lost), result.complete) == (len(data) - 1, {"/a": 1}, False)
    assert "messages that are missing, by their numbers: 3" in result.text()
    with AnyReader([tmp_path / "bag"]) as reader:
        assert [raw for _, _, raw in reader.messages()] == [*data[:2], *data[3:]]


def test_tables_and_columns_are_those_that_rosbags_writes(tmp_path: Path, messages: Any) -> None:
    _write(tmp_path / "ours", messages)
    with RosbagsWriter(tmp_path / "theirs", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        writer.write(writer.add_connection("/a", STRING, typestore=messages.store), 7, messages.text("x"))
    query = "SELECT m.name, c.name, c.type, c.pk, c.\"notnull\" FROM sqlite_master m, pragma_table_info(m.name) c WHERE m.type = 'table'"
    ours, theirs = _rows(tmp_path / "ours/ours_0.db3", query), _rows(tmp_path / "theirs/theirs.db3", query)
    assert sorted(ours) == sorted(theirs)
    index = "SELECT name, tbl_name FROM sqlite_master WHERE type = 'index'"
    assert _rows(tmp_path / "ours/ours_0.db3", index) == _rows(tmp_path / "theirs/theirs.db3", index)
    columns = "SELECT topic_type, encoding, type_description_hash FROM message_definitions"
    assert _rows(tmp_path / "ours/ours_0.db3", columns) == _rows(tmp_path / "theirs/theirs.db3", columns)
    assert _rows(tmp_path / "ours/ours_0.db3", "SELECT * FROM schema") == [(4, "jazzy")]


def test_database_carries_the_metadata_of_its_file(tmp_path: Path, messages: Any) -> None:
    _write(tmp_path / "bag", messages)
    ((version, text),) = _rows(tmp_path / "bag/bag_0.db3", "SELECT metadata_version, metadata FROM metadata")
    outside = yaml.safe_load((tmp_path / "bag/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (version, yaml.safe_load(text)) == (9, outside)
    assert outside["storage_identifier"] == "sqlite3"


def test_folder_contains_only_the_bag(tmp_path: Path, messages: Any) -> None:
    _write(tmp_path / "bag", messages)
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == ["bag_0.db3", "metadata.yaml"]


def test_compression_of_chunks_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="must be none with storage sqlite3"):
        BagWriter(tmp_path / "bag", storage="sqlite3", compression="zstd")


def test_unknown_storage_is_refused_with_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="must be one of mcap, sqlite3"):
        BagWriter(tmp_path / "bag", storage="leveldb")  # type: ignore[arg-type]


def test_killed_recording_can_be_repaired(tmp_path: Path, root: Path) -> None:
    script = """
import os, signal, sys
from gibson_sim.bags.writer import BagWriter
bag = BagWriter(sys.argv[1], reserve_bytes=0, storage="sqlite3")
bag.add_topic("/a", "std_msgs/msg/String")
data = b"\\0\\1\\0\\0" + (1001).to_bytes(4, "little") + b"x" * 1000 + b"\\0"
for i in range(50):
    bag.write("/a", data, i, i)
bag.flush()
bag.write("/a", data, 50, 50)
os.kill(os.getpid(), signal.SIGKILL)
"""
    environment = {**os.environ, "PYTHONPATH": str(root / "src/gibson_sim")}
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path / "bag")], env=environment, check=False)
    assert done.returncode == -signal.SIGKILL
    before = {p.name: p.read_bytes() for p in (tmp_path / "bag").glob("*.db3*") if not p.name.endswith("-shm")}
    result = repair(tmp_path / "bag")
    assert (result.messages, result.changed, result.complete) == (50, True, True)
    with AnyReader([tmp_path / "bag"]) as reader:
        assert [t for _, t, _ in reader.messages()] == list(range(50))
    assert not repair(tmp_path / "bag").changed
    after = {p.name: p.read_bytes() for p in (tmp_path / "bag").iterdir()}
    assert sorted(after) == ["bag_0.db3", "bag_0.db3.damaged", "bag_0.db3.damaged-wal", "metadata.yaml"]
    assert before == {name.replace(".damaged", ""): after[name] for name in ("bag_0.db3.damaged", "bag_0.db3.damaged-wal")}


def test_file_that_is_no_database_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "a.db3").write_bytes(b"something else" * 100)
    with pytest.raises(RecordError, match="is not a bag"):
        repair(tmp_path)
    assert (tmp_path / "a.db3").read_bytes() == b"something else" * 100


def test_full_disk_loses_no_accepted_message(small_disk: Path, messages: Any) -> None:
    bag = BagWriter(small_disk / "bag", reserve_bytes=0, storage="sqlite3")
    bag.add_topic("/a", STRING)
    with pytest.raises(DiskFullError, match="make room"):
        _fill(bag, messages.text("x" * 300_000))
    taken = bag.message_count
    with AnyReader([small_disk / "bag"]) as reader:
        times = [t for _, t, _ in reader.messages()]
        assert len(times) == reader.message_count
    # Messages pending when the disk was full are where the emergency file was.
    assert times == list(range(taken))
    assert taken > 10_000_000 // 300_000


def _fill(bag: BagWriter, data: bytes) -> None:
    for i in range(1000):
        bag.write("/a", data, i, i)
