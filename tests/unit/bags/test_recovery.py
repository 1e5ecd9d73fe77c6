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
from mcap.records import Channel, Schema
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from gibson_sim.bags.check import check_bag
from gibson_sim.bags.reader import BagReader
from gibson_sim.bags.writer import BagWriter, TopicQos, repair
from gibson_sim.cli.command_line import run as run_command
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
    content[_chunk_ends(file)[3] - 10] ^= 0xFF
    file.write_bytes(content[:-10])
    repair(bag)
    assert _read(bag) == WHOLE[:6] + WHOLE[8:]


def test_zeros_after_the_data_are_cut_off(bag: Path) -> None:
    """As after a power cut: the file has its length, but not its content."""
    file = bag / "bag_0.mcap"
    content = file.read_bytes()[: _chunk_ends(file)[4]]
    file.write_bytes(content + bytes(5000))
    assert repair(bag).skipped == 5000
    assert _read(bag) == WHOLE[:10]


def test_whole_bag_is_left_alone(bag: Path) -> None:
    before = {p.name: p.read_bytes() for p in bag.iterdir()}
    result = repair(bag)
    assert (result.changed, result.messages) == (False, 20)
    assert {p.name: p.read_bytes() for p in bag.iterdir()} == before


@pytest.mark.parametrize("has_messages", [False, True])
def test_topic_that_only_the_summary_describes_is_no_fault_if_it_has_no_messages(
    tmp_path: Path, messages: Any, has_messages: bool
) -> None:
    """The C++ library, which rosbag2 uses, writes the description of a topic before its first message, and all of them into the summary."""
    path = tmp_path / "bag_0.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        schema = writer.register_schema(STRING, "ros2msg", b"string data")
        used = writer.register_channel("/used", "cdr", schema)
        writer._Writer__schemas[2] = Schema(id=2, name="std_msgs/msg/Bool", encoding="ros2msg", data=b"bool data")  # type: ignore[attr-defined]
        writer._Writer__channels[2] = Channel(id=2, topic="/empty", message_encoding="cdr", metadata={}, schema_id=2)  # type: ignore[attr-defined]
        for k in range(5):
            writer.add_message(2 if has_messages and k == 4 else used, k, messages.text(f"{k:100d}"), k)
        writer.finish()
    before = path.read_bytes()
    assert repair(tmp_path).complete
    assert (path.read_bytes() == before) == (not has_messages)


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
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "bag_0.mcap.damaged", "metadata.yaml"]


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


def _flip(file: Path, byte: int, bit: int = 0) -> bytes:
    content = bytearray(file.read_bytes())
    content[byte] ^= 1 << bit
    file.write_bytes(content)
    return bytes(content)


@pytest.mark.parametrize("field", range(9, 9 + 28))
def test_bit_in_the_head_of_a_chunk_costs_nothing_or_is_reported_and_never_touches_the_chunks_behind(
    bag: Path, field: int
) -> None:
    """The head holds the times, the size, the checksum; a flipped bit there once cut off all chunks behind it."""
    file = bag / "bag_0.mcap"
    begin = _chunk_ends(file)[2]
    while file.read_bytes()[begin] != 6:  # the message indices of the chunk before
        begin += 9 + int.from_bytes(file.read_bytes()[begin + 1 : begin + 9], "little")
    damaged = _flip(file, begin + field)
    result = repair(bag)
    is_checksum = field >= 9 + 24
    assert _read(bag) == (WHOLE[:6] + WHOLE[8:] if is_checksum else WHOLE)
    assert (result.complete, result.lost) == ((False, {"/a": 1, "/b": 1}) if is_checksum else (True, {}))
    assert (bag / "bag_0.mcap.damaged").read_bytes() == damaged
    assert ("stepped over" in result.text()) == is_checksum
    assert "kept as bag_0.mcap.damaged" in result.text()


@pytest.mark.parametrize("byte", range(9))
def test_bit_in_the_kind_or_the_length_of_a_chunk_costs_nothing(bag: Path, byte: int) -> None:
    file = bag / "bag_0.mcap"
    with file.open("rb") as stream:
        begin = make_reader(stream).get_summary().chunk_indexes[3].chunk_start_offset  # type: ignore[union-attr]
    _flip(file, begin + byte, 1)
    assert repair(bag).complete
    assert _read(bag) == WHOLE


def test_damage_in_two_places_is_reported_with_offsets_and_what_is_lost(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    ends = _chunk_ends(file)
    _flip(file, ends[1] - 5)
    _flip(file, ends[7] - 5)
    result = repair(bag)
    assert _read(bag) == WHOLE[:2] + WHOLE[4:14] + WHOLE[16:]
    assert all(reason.startswith("a chunk that is damaged: ") for _, _, reason in result.repairs[0].gaps)
    assert [end for _, end, _ in result.repairs[0].gaps] == [ends[1], ends[7]]
    assert sum(result.lost.values()) == 4
    assert "lost:             3 /a" in result.text()


def test_whole_file_whose_chunks_are_damaged_is_not_called_whole(bag: Path) -> None:
    """Its summary is sound and lists all messages."""
    _flip(bag / "bag_0.mcap", _chunk_ends(bag / "bag_0.mcap")[0] - 5)
    result = repair(bag)
    assert (result.changed, result.complete, result.messages) == (True, False, 18)


def test_kept_files_are_never_overwritten(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    first = _flip(file, _chunk_ends(file)[0] - 5)
    repair(bag)
    second = _flip(file, _chunk_ends(file)[3] - 5)
    repair(bag)
    assert (bag / "bag_0.mcap.damaged").read_bytes() == first
    assert (bag / "bag_0.mcap.damaged.2").read_bytes() == second


def test_index_with_wrong_offsets_is_rewritten(bag: Path) -> None:
    """The flipped bit is in the offset of a chunk in the summary: readers that use the index lose the chunk."""
    file = bag / "bag_0.mcap"
    with file.open("rb") as stream:
        offset = make_reader(stream).get_summary().chunk_indexes[3].chunk_start_offset  # type: ignore[union-attr]
    _flip(file, file.read_bytes().rindex(offset.to_bytes(8, "little")))
    result = repair(bag)
    assert "the index of chunks is wrong" in result.text()
    assert result.complete
    assert _read(bag) == WHOLE


def test_topic_whose_description_is_damaged_keeps_its_name(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    _flip(file, file.read_bytes().index(b"/b"), 1)  # outside of chunks; the chunks and the summary have it, too
    assert repair(bag).complete
    assert _read(bag) == WHOLE


def test_messages_outside_of_chunks_attachments_and_foreign_records_are_kept(tmp_path: Path, messages: Any) -> None:
    data = [messages.text(f"{k:100d}") for k in range(10)]
    path = tmp_path / "plain.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start("ros2", "test")
        schema = writer.register_schema(STRING, "ros2msg", b"string data")
        channel = writer.register_channel("/a", "cdr", schema)
        for k in range(5):
            writer.add_message(channel, k, data[k], k)
        writer.add_attachment(1, 2, "map.png", "image/png", b"picture")
        for k in range(5, 10):
            writer.add_message(channel, k, data[k], k)
        writer.add_metadata("mine", {"a": "b"})
        writer.finish()
    damaged = path.read_bytes()
    path.write_bytes(damaged[:-20])
    result = repair(tmp_path)
    assert _read(tmp_path) == [("/a", k) for k in range(10)]
    assert "not checked: the content of 10 messages has no checksum" in result.text()
    with path.open("rb") as stream:
        reader = make_reader(stream)
        assert [(a.name, a.data) for a in reader.iter_attachments()] == [("map.png", b"picture")]
        assert {m.name: m.metadata for m in reader.iter_metadata()}["mine"] == {"a": "b"}


def test_no_room_for_the_new_file_leaves_the_bag_as_it_is(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    damaged = _flip(bag / "bag_0.mcap", _chunk_ends(bag / "bag_0.mcap")[0] - 5)

    def full(*_: Any) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gibson_sim.bags.repairing.mcap._write_all", full)
    with pytest.raises(RecordError, match=r"No space left on device; the new files need as much room"):
        repair(bag)
    assert sorted(p.name for p in bag.iterdir()) == ["bag_0.mcap", "metadata.yaml"]
    assert (bag / "bag_0.mcap").read_bytes() == damaged


def test_files_that_are_compressed_as_a_whole_are_unpacked_first(tmp_path: Path) -> None:
    (tmp_path / "bag_0.mcap.zstd").write_bytes(b"x")
    with pytest.raises(RecordError, match=r"unpack its compressed files first: zstd -d bag_0\.mcap\.zstd"):
        repair(tmp_path)


def test_command_reports_the_loss_and_exits_with_1(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["bag", "repair", str(bag)]) == 0
    assert "is whole, with 20 messages: nothing to do" in capsys.readouterr().out
    _flip(bag / "bag_0.mcap", _chunk_ends(bag / "bag_0.mcap")[0] - 5)
    assert run_command(["bag", "repair", str(bag)]) == 1
    assert "lost:             2 /a" in capsys.readouterr().out


def test_reader_names_the_command_that_reads_the_rest(bag: Path) -> None:
    _flip(bag / "bag_0.mcap", _chunk_ends(bag / "bag_0.mcap")[4] - 5)
    with BagReader(bag) as reader, pytest.raises(RecordError, match=r"bag repair .*bag`, which keeps the damaged file"):
        list(reader.raw_messages())


def test_reader_warns_of_messages_that_the_bag_lists_and_does_not_have(bag: Path, caplog: pytest.LogCaptureFixture) -> None:
    text = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(text.replace("message_count: 12", "message_count: 13"))
    with BagReader(bag) as reader:
        assert len(list(reader.raw_messages())) == 20
    assert "does not have the messages that it lists (/a: 12 of 13)" in caplog.text


def test_statistics_that_contradict_themselves_report_no_loss(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    content = file.read_bytes()
    counts = content.rindex(b"\x01\x00" + (12).to_bytes(8, "little"))  # channel 1 and its number of messages, in the statistics
    _flip(file, counts + 3, 2)
    result = repair(bag)
    assert "the statistics are wrong" in result.text()
    assert (result.complete, dict(result.lost), _read(bag)) == (True, {}, WHOLE)


@pytest.mark.parametrize("place", ["behind it", "at the end"])
def test_copy_of_a_chunk_is_written_once_and_named(bag: Path, place: str) -> None:
    file = bag / "bag_0.mcap"
    whole = file.read_bytes()
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    second = summary.chunk_indexes[1]
    begin, end = second.chunk_start_offset, second.chunk_start_offset + second.chunk_length + second.message_index_length
    last = summary.chunk_indexes[-1]
    at = end if place == "behind it" else last.chunk_start_offset + last.chunk_length + last.message_index_length
    file.write_bytes(whole[:at] + whole[begin:end] + whole[at:])
    result = repair(bag)
    assert f"the chunk at byte {at} is a copy of that at byte {begin}: its 2 messages count once" in result.text()
    assert (result.messages, result.lost) == (20, {})
    assert _read(bag) == WHOLE
    assert not repair(bag).changed


def test_copy_that_hides_another_chunk_does_not_hide_its_loss(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    whole = file.read_bytes()
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    spans = [
        (c.chunk_start_offset, c.chunk_start_offset + c.chunk_length + c.message_index_length) for c in summary.chunk_indexes
    ]
    file.write_bytes(whole[: spans[1][0]] + whole[spans[0][0] : spans[0][1]] + whole[spans[1][1] :])
    result = repair(bag)
    assert (result.messages, sum(result.lost.values())) == (18, 2)
    assert _read(bag) == WHOLE[:2] + WHOLE[4:]


def test_chunks_that_are_alike_and_counted_are_all_kept(tmp_path: Path, messages: Any) -> None:
    """The recording of a paused simulation: the same message again and again, at the same time."""
    file = tmp_path / "bag_0.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, chunk_size=10)
        writer.start("ros2", "test")
        schema = writer.register_schema(STRING, "ros2msg", b"string data\n")
        channel = writer.register_channel("/a", "cdr", schema)
        for _ in range(5):
            writer.add_message(channel, 100, messages.text("same"), 100)
        writer.finish()
    result = repair(tmp_path)
    assert result.messages == 5
    assert " copy of " not in result.text()


def test_empty_file_whose_messages_the_metadata_lists_names_them_as_lost(bag: Path) -> None:
    (bag / "bag_0.mcap").write_bytes(b"")
    with pytest.raises(RecordError) as caught:
        repair(bag)
    assert str(caught.value) == (
        f"{bag / 'bag_0.mcap'} is empty (0 bytes): the 20 messages that metadata.yaml lists in it are lost: nothing can be repaired; "
        "restore the file from a copy"
    )


def _split_bag(folder: Path, messages: Any) -> Path:
    """Two files of five messages each."""
    with BagWriter(folder, reserve_bytes=0) as writer:
        writer.add_topic("/a", STRING)
        for i in range(10):
            if i == 5:
                writer.split()
            writer.write("/a", messages.text("text"), 100 + i, i)
    return folder


@pytest.mark.parametrize("number", [0, 1])
def test_empty_file_among_others_names_its_messages_as_lost(tmp_path: Path, messages: Any, number: int) -> None:
    bag = _split_bag(tmp_path / "bag", messages)
    name = f"bag_{number}.mcap"
    (bag / name).write_bytes(b"")
    result = repair(bag)
    assert (
        f"{bag / name} is empty (0 bytes): the 5 messages that metadata.yaml lists in it are lost; it is left out"
        in result.text()
    )
    assert (result.messages, dict(result.lost), result.complete) == (5, {"/a": 5}, False)


def test_file_that_is_gone_is_a_loss(tmp_path: Path, messages: Any) -> None:
    bag = _split_bag(tmp_path / "bag", messages)
    (bag / "bag_1.mcap").unlink()
    assert dict(repair(bag).lost) == {"/a": 5}


def test_check_says_that_the_bag_was_repaired_and_what_was_lost(bag: Path) -> None:
    os.truncate(bag / "bag_0.mcap", _chunk_ends(bag / "bag_0.mcap")[4])
    metadata = yaml.safe_load((bag / "metadata.yaml").read_text())
    metadata["rosbag2_bagfile_information"]["custom_data"] = {"operator": "anna"}
    (bag / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    assert sum(repair(bag).lost.values()) == 10
    assert "note: the bag was repaired: 10 of 20 messages lost" in check_bag(bag).findings()
    custom = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]["custom_data"]
    assert custom == {"operator": "anna", "gibson_sim_repaired": "10 of 20 messages lost"}
    assert not repair(bag).changed
    os.truncate(bag / "bag_0.mcap", _chunk_ends(bag / "bag_0.mcap")[3])
    repair(bag)
    assert check_bag(bag).notes == ("the bag was repaired: 10 of 20 messages lost; 2 of 10 messages lost",)


def test_check_says_nothing_of_a_repair_that_lost_nothing(bag: Path) -> None:
    os.truncate(bag / "bag_0.mcap", (bag / "bag_0.mcap").stat().st_size - 20)
    repair(bag)
    assert check_bag(bag).notes == ()
