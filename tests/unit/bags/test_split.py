"""Bags of several files: splitting, the content of each file, and recovery after a crash."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from gibson_sim.bags.writer import BagWriter, Storage, repair
from gibson_sim.errors import RecordError

STRING = "std_msgs/msg/String"
NS = 1_000_000_000
STORAGES = pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
SUFFIX = {"mcap": "mcap", "sqlite3": "db3"}


def _write(folder: Path, messages: Any, storage: Storage = "mcap", count: int = 25, **limits: int) -> None:
    """Writes messages of 1000 bytes, a tenth of a second apart, to two topics in turn."""
    with BagWriter(folder, reserve_bytes=0, chunk_bytes=2500, storage=storage, **limits) as bag:
        bag.add_topic("/a", STRING)
        bag.add_topic("/b", STRING)
        for i in range(count):
            bag.write("/ab"[:1] + "ab"[i % 2], messages.text(f"{i:1000d}"), i * NS // 10, i)


def _information(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    return found


def _read(folder: Path) -> list[int]:
    """Returns the numbers in the messages, after comparing their count with the metadata."""
    with AnyReader([folder]) as reader:
        numbers = [int(raw[8:-1]) for _, _, raw in reader.messages()]
        assert len(numbers) == reader.message_count == sum(c.msgcount for c in reader.connections)
    return numbers


@STORAGES
def test_file_ends_before_a_message_beyond_the_duration(tmp_path: Path, messages: Any, storage: Storage) -> None:
    _write(tmp_path / "bag", messages, storage, max_file_ns=NS)
    files = _information(tmp_path / "bag")["files"]
    assert [f["path"] for f in files] == [f"bag_{i}.{SUFFIX[storage]}" for i in range(3)]
    assert [f["message_count"] for f in files] == [10, 10, 5]
    assert [f["starting_time"]["nanoseconds_since_epoch"] for f in files] == [0, NS, 2 * NS]
    assert [f["duration"]["nanoseconds"] for f in files] == [9 * NS // 10, 9 * NS // 10, 4 * NS // 10]
    assert _read(tmp_path / "bag") == list(range(25))


@STORAGES
def test_file_ends_at_its_size(tmp_path: Path, messages: Any, storage: Storage) -> None:
    _write(tmp_path / "bag", messages, storage, max_file_bytes=8000)
    files = sorted((tmp_path / "bag").glob(f"*.{SUFFIX[storage]}"))
    assert len(files) == len(_information(tmp_path / "bag")["files"]) >= 3
    assert _read(tmp_path / "bag") == list(range(25))


def test_file_of_a_bag_can_be_read_alone(tmp_path: Path, messages: Any) -> None:
    _write(tmp_path / "bag", messages, max_file_ns=NS)
    with (tmp_path / "bag/bag_1.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert [m.log_time for _, _, m in reader.iter_messages()] == [i * NS // 10 for i in range(10, 20)]
        (record,) = reader.iter_metadata()
    information = yaml.safe_load(record.metadata["serialized_metadata"])
    assert (information["message_count"], information["relative_file_paths"]) == (10, ["bag_1.mcap"])


def test_bag_is_split_on_request_but_never_into_empty_files(tmp_path: Path, messages: Any) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/a", STRING)
        assert not bag.split()
        bag.write("/a", messages.text("0"), 0, 0)
        assert bag.split()
        assert not bag.split()
        assert _information(tmp_path / "bag")["relative_file_paths"] == ["bag_0.mcap"], "what is finished can be read already"
        bag.write("/a", messages.text("1"), 1, 1)
        assert (bag.message_count, bag.file_count) == (2, 2)
    assert _read(tmp_path / "bag") == [0, 1]


@STORAGES
def test_crash_in_the_last_of_several_files_can_be_repaired(tmp_path: Path, messages: Any, storage: Storage) -> None:
    bag = BagWriter(tmp_path / "bag", reserve_bytes=0, storage=storage, max_file_ns=NS)
    bag.add_topic("/a", STRING)
    for i in range(25):
        bag.write("/a", messages.text(str(i)), i * NS // 10, i)
    bag.flush()
    bag.write("/a", messages.text("25"), 3 * NS, 25)  # starts the fourth file, and is not flushed
    copy = tmp_path / "copy"
    copy.mkdir()
    for path in (tmp_path / "bag").iterdir():  # as after a killed writer
        (copy / path.name).write_bytes(path.read_bytes())
    bag.close()
    result = repair(copy)
    assert (result.messages, result.changed) == (25, True)
    assert _read(copy) == list(range(25))
    assert not repair(copy).changed
    assert {p.suffix for p in copy.iterdir() if ".damaged" not in p.name} == {f".{SUFFIX[storage]}", ".yaml"}


def test_tenth_file_follows_the_ninth_in_a_repaired_bag(tmp_path: Path, messages: Any) -> None:
    _write(tmp_path / "bag", messages, max_file_ns=NS // 5)
    (tmp_path / "bag/metadata.yaml").unlink()
    assert repair(tmp_path / "bag").files == 13
    assert _information(tmp_path / "bag")["relative_file_paths"] == [f"bag_{i}.mcap" for i in range(13)]


def test_file_without_any_record_is_ignored(tmp_path: Path, messages: Any) -> None:
    _write(tmp_path / "bag", messages, max_file_ns=NS)
    os.truncate(tmp_path / "bag/bag_2.mcap", 8)
    assert repair(tmp_path / "bag").messages == 20
    assert _read(tmp_path / "bag") == list(range(20))


def test_files_of_two_kinds_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"")
    (tmp_path / "a.db3").write_bytes(b"")
    with pytest.raises(RecordError, match="both mcap and sqlite3"):
        repair(tmp_path)
