"""A flipped bit costs at most the chunk, the message or the page that it hits; ``make fuzz ARGS="--targets flip"`` tries thousands."""

from __future__ import annotations

import shutil
from pathlib import Path
from random import Random

import pytest

from fuzz.flips import KINDS, faults, flip
from gibson_sim.bags.metadata import METADATA_FILE
from gibson_sim.bags.repairing.bag import repair

FLIPS = 18
"""Of each kind; 200 in all."""


@pytest.mark.parametrize("kind", KINDS)
def test_flipped_bit_loses_nothing_outside_of_the_part_that_it_hits(kind: str, tmp_path: Path) -> None:
    rng = Random(kind)
    KINDS[kind].write(tmp_path / "whole", rng)
    found = []
    for k in range(FLIPS):
        bag = tmp_path / f"bag{k}"
        shutil.copytree(tmp_path / "whole", bag)
        paths = [path for path in sorted(bag.iterdir()) if path.name != METADATA_FILE]
        path = rng.choices(paths, [path.stat().st_size for path in paths])[0]
        bit = rng.randrange(8 * path.stat().st_size)
        flip(path, bit)
        result = repair(bag)
        found += [f"{path.name}, bit {bit}: {fault}" for fault in faults(tmp_path / "whole", bag, result, kind, path.name, bit)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("byte", [0, 3, 9, 17, 26, -4096 - 24, -4096 - 18, -4096 - 10, -100])
def test_bit_in_the_head_or_the_last_page_of_a_write_ahead_log_loses_no_message(byte: int, tmp_path: Path) -> None:
    """SQLite gives up the whole log, or the last transaction, which here is all that was recorded."""
    kind, name = "sqlite3 with a log", "bag_0.db3-wal"
    KINDS[kind].write(tmp_path / "whole", Random(1))
    shutil.copytree(tmp_path / "whole", tmp_path / "bag")
    bit = 8 * (byte % (tmp_path / "bag" / name).stat().st_size)
    flip(tmp_path / "bag" / name, bit)
    result = repair(tmp_path / "bag")
    assert result.messages == 60
    assert faults(tmp_path / "whole", tmp_path / "bag", result, kind, name, bit) == []


@pytest.mark.parametrize(
    ("kind", "name", "text", "offset"),
    [("mcap without chunks", "bag_0.mcap", b"\0\1\0\0", -31), ("sqlite3", "bag_0.db3", b"keep_last", 1)],
    ids=["length of the first message outside of chunks", "one letter of the QoS"],
)
def test_bit_that_once_lost_all_messages(kind: str, name: str, text: bytes, offset: int, tmp_path: Path) -> None:
    KINDS[kind].write(tmp_path / "whole", Random(1))
    shutil.copytree(tmp_path / "whole", tmp_path / "bag")
    bit = 8 * ((tmp_path / "bag" / name).read_bytes().index(text) + offset) + 1
    flip(tmp_path / "bag" / name, bit)
    assert faults(tmp_path / "whole", tmp_path / "bag", repair(tmp_path / "bag"), kind, name, bit) == []
