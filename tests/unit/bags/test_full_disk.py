"""A full disk, a real one where possible: a small tmpfs (root only), otherwise a limit on the file size."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import namedtuple
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

import gibson_sim.bags.writer as writer_module
from gibson_sim.bags.folders import EMERGENCY_BYTES, MIB, DiskFullError
from gibson_sim.bags.writer import BagWriter
from gibson_sim.errors import RecordError

STRING = "std_msgs/msg/String"
Usage = namedtuple("Usage", "total used free")


def _count(folder: Path) -> int:
    """Returns the number of messages that rosbags reads, after comparing it with the metadata."""
    with AnyReader([folder]) as reader:
        count = sum(1 for _ in reader.messages())
        assert count == reader.message_count
    (file,) = folder.glob("*.mcap")
    with file.open("rb") as stream:
        assert sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages()) == count
    return count


def _fill(bag: BagWriter, data: bytes) -> int:
    """Writes until the disk is full; returns the number of accepted messages."""
    bag.add_topic("/a", STRING)
    with pytest.raises(DiskFullError, match="make room"):
        _write(bag, data, 1000)
    return bag.message_count


def _write(bag: BagWriter, data: bytes, count: int) -> None:
    for i in range(count):
        bag.write("/a", data, i, i)


def _fill_with_another_file(path: Path) -> None:
    with path.open("wb", buffering=0) as file:
        while file.write(b"x" * 4096):
            pass


@pytest.mark.parametrize("size", [900_000, 3_000_000])
def test_full_disk_loses_no_accepted_message(small_disk: Path, messages: Any, size: int) -> None:
    data = messages.text("x" * size)
    taken = _fill(BagWriter(small_disk / "bag", reserve_bytes=0), data)
    assert _count(small_disk / "bag") == taken >= 14 * MIB // len(data)


def test_disk_filled_by_another_program_loses_no_accepted_message(small_disk: Path, messages: Any) -> None:
    bag = BagWriter(small_disk / "bag", reserve_bytes=0)
    bag.add_topic("/a", STRING)
    with pytest.raises(OSError, match="No space"):
        _fill_with_another_file(small_disk / "other")
    # Free space is checked at every MiB, but 0 bytes are not less than a reserve of 0: the real error occurs.
    taken = _fill(bag, messages.text("x" * 5000))
    assert _count(small_disk / "bag") == taken > MIB // 5100


def test_reserve_is_left_free(small_disk: Path, messages: Any) -> None:
    taken = _fill(BagWriter(small_disk / "bag", reserve_bytes=6 * MIB), messages.text("x" * 900_000))
    free = os.statvfs(small_disk).f_bavail * os.statvfs(small_disk).f_frsize
    # It stopped with 4 to 6 MiB left, and also freed the emergency file.
    assert 4 * MIB + EMERGENCY_BYTES < free <= 6 * MIB + EMERGENCY_BYTES
    assert _count(small_disk / "bag") == taken


def test_bag_is_truncated_to_its_last_whole_chunk_when_other_programs_use_the_emergency_space(
    small_disk: Path, messages: Any
) -> None:
    bag = BagWriter(small_disk / "bag", reserve_bytes=0)
    (small_disk / "bag/.reserve").unlink()
    (small_disk / "other").write_bytes(b"x" * EMERGENCY_BYTES)
    bag.add_topic("/a", STRING)
    with pytest.raises(DiskFullError, match="all readable"):
        _write(bag, messages.text("x" * 900_000), 100)
    # 24 - 8 MiB hold 18 messages of 0.9 MB; a chunk has two.
    assert _count(small_disk / "bag") == 18


def test_full_disk_at_the_start_is_refused_with_the_numbers(small_disk: Path) -> None:
    with pytest.raises(DiskFullError, match=r"24 MiB left, recording needs more than 136 MiB: make room"):
        BagWriter(small_disk / "bag")


def test_recording_ends_when_free_space_falls_below_the_reserve(
    tmp_path: Path, messages: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = iter([100 * MIB, 100 * MIB, 31 * MIB, 29 * MIB])
    monkeypatch.setattr(writer_module.shutil, "disk_usage", lambda _: Usage(0, 0, next(free)))
    bag = BagWriter(tmp_path / "bag", reserve_bytes=30 * MIB)
    # Space is checked at each message, since each is longer than 1 MiB: the third one is refused.
    assert _fill(bag, messages.text("x" * 1_100_000)) == 2
    assert _count(tmp_path / "bag") == 2


def test_bag_closed_by_a_full_disk_accepts_no_more_messages(
    tmp_path: Path, messages: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = BagWriter(tmp_path / "bag", reserve_bytes=0)
    bag.add_topic("/a", STRING)
    monkeypatch.setattr(writer_module.shutil, "disk_usage", lambda _: Usage(0, 0, -1))
    with pytest.raises(DiskFullError):
        bag.write("/a", messages.text("x" * 1_100_000), 0, 0)
    with pytest.raises(RecordError, match="closed"):
        bag.write("/a", messages.text("x"), 0, 0)


LIMITED = """
import resource, sys
from gibson_sim.bags.writer import BagWriter, DiskFullError
limit = int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
bag = BagWriter(sys.argv[1], reserve_bytes=0)
bag.add_topic("/a", "std_msgs/msg/String")
text = b"x" * int(sys.argv[3])
data = b"\\0\\1\\0\\0" + (len(text) + 1).to_bytes(4, "little") + text + b"\\0"
try:
    for i in range(100):
        bag.write("/a", data, i, i)
except DiskFullError as error:
    print(error)
    sys.exit(7)
"""


@pytest.mark.parametrize(
    ("room", "whole"),
    [
        ("half of chunk 6", 10),
        ("chunk 6, no index of it", 10),
        ("all but the last byte", 10),
        ("half of chunk 7", 12),
    ],
)
def test_limit_on_the_file_size_leaves_a_whole_bag(tmp_path: Path, root: Path, messages: Any, room: str, whole: int) -> None:
    """As on a FAT disk: space freed elsewhere does not help, so chunks (of two messages each) are removed to make room for the summary."""
    with BagWriter(tmp_path / "model", reserve_bytes=0) as bag:
        bag.add_topic("/a", STRING)
        _write(bag, messages.text("x" * 900_000), 12)
    file = tmp_path / "model/model_0.mcap"
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[5]
    chunk_end, size = chunk.chunk_start_offset + chunk.chunk_length, file.stat().st_size
    limit = {
        "half of chunk 6": chunk_end - chunk.chunk_length // 2,
        "chunk 6, no index of it": chunk_end + 100,
        "all but the last byte": size - 1 - 2 * len("model") + 2 * len("bag"),
        "half of chunk 7": size + chunk.chunk_length // 2,
    }[room]
    command = [sys.executable, "-c", LIMITED, str(tmp_path / "bag"), str(limit), "900000"]
    environment = {**os.environ, "PYTHONPATH": str(root / "src/gibson_sim")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 7, done.stderr
    assert "File too large" in done.stdout
    assert (tmp_path / "bag/bag_0.mcap").stat().st_size <= limit
    assert _count(tmp_path / "bag") == whole
