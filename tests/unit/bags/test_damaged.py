"""Bags with corrupt bytes: whatever fails in a parser, the error is one line."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.bags.check import check_bag
from gibson_sim.bags.export.read import find_cameras
from gibson_sim.bags.reader import BagReader
from gibson_sim.bags.repairing.bag import repair
from gibson_sim.bags.writer import BagWriter
from gibson_sim.errors import RecordError

MAGIC = b"\x89MCAP0\r\n"


def _refused(folder: Path) -> str:
    with pytest.raises(RecordError) as error, BagReader(folder) as bag:
        list(bag.messages())
    text = str(error.value)
    assert "\n" not in text and len(text) < 1000
    assert "gibson-sim bag repair" in text
    return text


def test_record_that_is_longer_than_any_memory_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(MAGIC + struct.pack("<BQ", 1, 2**62) + b"\0" * 100 + MAGIC)
    _refused(tmp_path)


def test_metadata_with_invalid_yaml_is_refused_in_one_line(write_drive: Callable[..., Path]) -> None:
    bag = write_drive()
    (bag / "metadata.yaml").write_text("a: [\n" + "x" * 5000)
    _refused(bag)


def test_messages_that_are_only_in_the_index_are_named(write_drive: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """The bag lists a chunk under the times of another one."""
    bag, read = write_drive(), BagReader.raw_messages

    def without_images(self: BagReader, *args: Any, **limits: Any) -> Iterator[tuple[str, int, bytes]]:
        return (message for message in read(self, *args, **limits) if "image" not in message[0])

    monkeypatch.setattr(BagReader, "raw_messages", without_images)
    with BagReader(bag) as reader:
        assert reader.topics()["/camera/image_raw"].count == 11
        with pytest.raises(RecordError, match="no message of /camera/image_raw is there"):
            reader.first("/camera/image_raw")
        with pytest.raises(RecordError, match="no message of /camera/"):
            find_cameras(reader)
    assert any("/camera/image_raw: the index of the bag lists messages" in problem for problem in check_bag(bag).problems)


def test_damaged_summary_is_rewritten(write_drive: Callable[..., Path]) -> None:
    bag = write_drive()
    (path,) = bag.glob("*.mcap")
    data = bytearray(path.read_bytes())
    (begin,) = struct.unpack_from("<Q", data, len(data) - 28)
    struct.pack_into("<I", data, begin + 11, 2**32 - 1)  # the length of the name in the first schema
    path.write_bytes(data)
    assert repair(bag).messages > 50
    check_bag(bag)


def test_row_without_binary_data_is_refused(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", storage="sqlite3", reserve_bytes=0) as bag:
        bag.add_topic("/odom", "nav_msgs/msg/Odometry")
        bag.write("/odom", messages.odometry(1, 0.0, 0.0), 1, 1)
    (path,) = (tmp_path / "bag").glob("*.db3")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE messages SET data = ?", ("text",))
    with pytest.raises(RecordError) as error, BagReader(tmp_path / "bag") as reader:
        list(reader.messages())
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("wrong", [("name: /odom", "name: 7"), ("message_count: 11", "message_count: eleven")])
def test_metadata_with_values_of_the_wrong_kind_is_refused(write_drive: Callable[..., Path], wrong: tuple[str, str]) -> None:
    bag = write_drive()
    text = (bag / "metadata.yaml").read_text()
    assert wrong[0] in text, text
    (bag / "metadata.yaml").write_text(text.replace(*wrong))
    with pytest.raises(RecordError), BagReader(bag):
        pass
