from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from gibson_sim.bags.writer import BagWriter, TopicQos, repair
from gibson_sim.errors import RecordError

STRING = "std_msgs/msg/String"


@pytest.fixture(params=["none", "zstd"])
def bag(request: pytest.FixtureRequest, tmp_path: Path, messages: Any) -> Path:
    """20 messages in chunks of two; the second topic starts in the third chunk."""
    folder = tmp_path / "bag"
    with BagWriter(folder, reserve_bytes=0, chunk_bytes=2050, compression=request.param) as writer:
        writer.add_topic("/a", STRING, TopicQos.latched())
        for i in range(20):
            if i == 5:
                writer.add_topic("/b", STRING)
            writer.write("/b" if i >= 5 and i % 2 else "/a", messages.text(f"{i:1000d}"), 100 + i, i)
    return folder


def _read(folder: Path) -> list[tuple[str, int]]:
    with AnyReader([folder]) as reader:
        read = [(c.topic, t) for c, t, _ in reader.messages()]
        assert len(read) == reader.message_count
    return read


WHOLE = [("/b" if i >= 5 and i % 2 else "/a", 100 + i) for i in range(20)]


def _chunk_ends(file: Path) -> list[int]:
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return [c.chunk_start_offset + c.chunk_length for c in summary.chunk_indexes]


@pytest.mark.parametrize("part", [0.05, 0.13, 0.31, 0.5, 0.501, 0.77, 0.9, 0.95, 0.99])
def test_bag_cut_at_any_byte_is_readable_up_to_its_last_whole_chunk(bag: Path, part: float) -> None:
    file = bag / "bag_0.mcap"
    size = int(file.stat().st_size * part)
    whole_chunks = sum(end <= size for end in _chunk_ends(file))
    os.truncate(file, size)
    (bag / "metadata.yaml").unlink()
    result = repair(bag)
    assert result.messages == 2 * whole_chunks
    assert _read(bag) == WHOLE[: 2 * whole_chunks]


def test_bag_cut_near_the_end_of_its_last_chunk_is_readable(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    content = file.read_bytes()
    ends = _chunk_ends(file)
    for size in [*range(ends[-2] - 5, ends[-1], 151), *range(ends[-1] - 3, ends[-1] + 30)]:
        file.write_bytes(content[:size])
        repair(bag)
        assert _read(bag) == WHOLE[: 2 * sum(end <= size for end in ends)], size


def test_bag_cut_in_its_summary_loses_nothing(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    os.truncate(file, file.stat().st_size - 20)
    assert repair(bag).messages == 20
    assert _read(bag) == WHOLE


def test_repaired_bag_has_the_metadata_of_the_whole_one(bag: Path) -> None:
    file, before = bag / "bag_0.mcap", yaml.safe_load((bag / "metadata.yaml").read_text())
    os.truncate(file, file.stat().st_size - 20)
    (bag / "metadata.yaml").unlink()
    repair(bag)
    assert yaml.safe_load((bag / "metadata.yaml").read_text()) == before


def test_index_of_a_repaired_bag_leads_to_its_messages(bag: Path) -> None:
    """The mcap library's reader uses the index; the cut is between the last chunk and its message index."""
    file = bag / "bag_0.mcap"
    os.truncate(file, _chunk_ends(file)[6] + 3)
    repair(bag)
    with file.open("rb") as stream:
        assert [m.log_time for _, c, m in make_reader(stream, validate_crcs=True).iter_messages(topics=["/b"])] == [
            105,
            107,
            109,
            111,
            113,
        ]
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert [len(c.message_index_offsets) for c in summary.chunk_indexes] == [1, 1, 2, 2, 2, 2, 2]


def test_damaged_chunk_loses_only_its_own_messages(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    content[_chunk_ends(file)[3] - 60] ^= 0xFF
    file.write_bytes(content[:-10])
    repair(bag)
    assert _read(bag) == WHOLE[:6] + WHOLE[8:]


def test_zeros_after_the_data_are_cut_off(bag: Path) -> None:
    """As after a power cut: the file has its length, but not its content."""
    file = bag / "bag_0.mcap"
    content = file.read_bytes()[: _chunk_ends(file)[4]]
    file.write_bytes(content + bytes(5000))
    assert repair(bag).cut_bytes == 5000
    assert _read(bag) == WHOLE[:10]


def test_whole_bag_is_left_alone(bag: Path) -> None:
    before = {p.name: p.read_bytes() for p in bag.iterdir()}
    result = repair(bag)
    assert (result.changed, result.messages) == (False, 20)
    assert {p.name: p.read_bytes() for p in bag.iterdir()} == before


def test_missing_metadata_file_is_rewritten(bag: Path) -> None:
    (bag / "metadata.yaml").unlink()
    repair(bag)
    assert _read(bag) == WHOLE


def test_repairing_twice_changes_nothing(bag: Path) -> None:
    os.truncate(bag / "bag_0.mcap", _chunk_ends(bag / "bag_0.mcap")[2])
    repair(bag)
    assert not repair(bag).changed


def test_killed_recording_can_be_repaired(tmp_path: Path, root: Path) -> None:
    script = """
import os, signal, sys
from gibson_sim.bags.writer import BagWriter
bag = BagWriter(sys.argv[1], reserve_bytes=0, chunk_bytes=1000)
bag.add_topic("/a", "std_msgs/msg/String")
data = b"\\0\\1\\0\\0" + (1001).to_bytes(4, "little") + b"x" * 1000 + b"\\0"
for i in range(50):
    bag.write("/a", data, i, i)
os.kill(os.getpid(), signal.SIGKILL)
"""
    environment = {**os.environ, "PYTHONPATH": str(root / "src/gibson_sim")}
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path / "bag")], env=environment, check=False)
    assert done.returncode == -signal.SIGKILL
    assert repair(tmp_path / "bag").messages == 50
    assert _read(tmp_path / "bag") == [("/a", i) for i in range(50)]
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]


def test_folder_without_a_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="holds no mcap or db3 file"):
        repair(tmp_path)


def test_file_of_another_kind_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"something else")
    with pytest.raises(RecordError, match="not an mcap file"):
        repair(tmp_path)
    assert (tmp_path / "a.mcap").read_bytes() == b"something else"


def test_empty_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(RecordError, match="nothing was recorded"):
        repair(tmp_path)
