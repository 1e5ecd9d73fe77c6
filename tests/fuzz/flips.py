"""One flipped bit anywhere in a bag of any kind: what ``bag repair`` makes of it loses nothing outside of the part that was hit.

The part is a chunk of an mcap file, a message outside of chunks, or a page of a database. Where the part has a checksum, no message of it
comes out other than it went in either. SQLite has no checksums, and mcap files may have none: there, messages of the part that was hit can
come out changed, and the report says that they were not checked.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
import struct
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from random import Random

from mcap.writer import CompressionType, Writer as McapLibraryWriter
from rosbags.highlevel import AnyReader

from fuzz.grammar import Mutator
from fuzz.trial import Trial
from gibson_sim.bags.metadata import METADATA_FILE
from gibson_sim.bags.repairing.bag import Repair, repair
from gibson_sim.bags.repairing.mcap_scan import scan
from gibson_sim.bags.writer import BagWriter

STRING = "std_msgs/msg/String"
TOPICS = ("/a", "/b", "/c/d")
_MESSAGES = 60
Message = tuple[str, int, bytes]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of bag."""

    write: Callable[[Path, Random], None]
    checked: bool
    """Whether every message has a checksum."""


def _messages(rng: Random) -> list[Message]:
    """Returns messages of different sizes, so that chunks and pages hold several, and some need several pages."""
    made = []
    for k in range(_MESSAGES):
        text = bytes(rng.randrange(32, 127) for _ in range(rng.choice((1, 30, 200, 200, 900, 3000))))
        data = b"\0\1\0\0" + struct.pack("<I", len(text) + 1) + text + b"\0"
        made.append((rng.choice(TOPICS), 1000 + k, data))
    return made


def _write_ours(folder: Path, rng: Random, **settings: str) -> None:
    with BagWriter(folder, reserve_bytes=0, chunk_bytes=4000, **settings) as writer:  # type: ignore[arg-type]
        for topic in TOPICS:
            writer.add_topic(topic, STRING)
        for topic, time, data in _messages(rng):
            writer.write(topic, data, time, time)


def _mcap(compression: str) -> Callable[[Path, Random], None]:
    return lambda folder, rng: _write_ours(folder, rng, compression=compression)


def _cut(compression: str) -> Callable[[Path, Random], None]:
    """As of a killed recorder: all chunks, no summary, no metadata."""

    def write(folder: Path, rng: Random) -> None:
        _write_ours(folder, rng, compression=compression)
        (path,) = folder.glob("*.mcap")
        end = scan(path).chunks[-1].indices_end
        with path.open("r+b") as file:
            file.truncate(end)
        (folder / METADATA_FILE).unlink()

    return write


def _library(*, chunks: bool) -> Callable[[Path, Random], None]:
    """By the mcap library, without checksums; descriptions are in the chunks."""

    def write(folder: Path, rng: Random) -> None:
        folder.mkdir()
        with (folder / "bag_0.mcap").open("wb") as file:
            writer = McapLibraryWriter(
                file, chunk_size=4000, compression=CompressionType.NONE, use_chunking=chunks, enable_crcs=False
            )
            writer.start("ros2", "test")
            schema = writer.register_schema(STRING, "ros2msg", b"string data")
            numbers = {topic: writer.register_channel(topic, "cdr", schema) for topic in TOPICS}
            for topic, time, data in _messages(rng):
                writer.add_message(numbers[topic], time, data, time)
            writer.finish()
        repair(folder)
        for kept in folder.glob("*.damaged*"):
            kept.unlink()

    return write


def _database(*, index: bool, log: bool = False) -> Callable[[Path, Random], None]:
    """``log``: as of a killed recorder, all in the write-ahead log, no metadata."""

    def write(folder: Path, rng: Random) -> None:
        made = folder.with_name("made")
        _write_ours(made, rng, storage="sqlite3")
        (path,) = made.glob("*.db3")
        folder.mkdir()
        with closing(sqlite3.connect(path, isolation_level=None)) as connection:
            if not index:
                connection.execute("DROP INDEX timestamp_idx")
                connection.execute("VACUUM")
            if log:
                with closing(sqlite3.connect(folder / "bag_0.db3", isolation_level=None)) as copy:
                    copy.execute("PRAGMA journal_mode=WAL")
                    copy.executescript("\n".join(connection.iterdump()))
                    for name in ("bag_0.db3", "bag_0.db3-wal"):
                        shutil.copyfile(folder / name, made / name)
                for name in ("bag_0.db3", "bag_0.db3-wal"):
                    shutil.copyfile(made / name, folder / name)
                (folder / "bag_0.db3-shm").unlink(missing_ok=True)
        if not log:
            shutil.copyfile(path, folder / "bag_0.db3")
            repair(folder)
        shutil.rmtree(made)

    return write


KINDS: dict[str, Kind] = {
    **{f"mcap {name}": Kind(_mcap(name), True) for name in ("none", "zstd", "lz4")},
    **{f"mcap {name} without summary": Kind(_cut(name), True) for name in ("none", "zstd", "lz4")},
    "mcap without checksums": Kind(_library(chunks=True), False),
    "mcap without chunks": Kind(_library(chunks=False), False),
    "sqlite3": Kind(_database(index=True), False),
    "sqlite3 without index": Kind(_database(index=False), False),
    "sqlite3 with a log": Kind(_database(index=True, log=True), False),
}


def make(mutator: Mutator, folder: Path) -> None:
    """Writes a bag and flips a bit; a copy of the whole bag is beside it."""
    kind = mutator.rng.choice(list(KINDS))
    KINDS[kind].write(folder / "whole", mutator.rng)
    shutil.copytree(folder / "whole", folder / "bag")
    paths = [path for path in sorted((folder / "bag").iterdir()) if path.name != METADATA_FILE]
    path = mutator.rng.choices(paths, [path.stat().st_size for path in paths])[0]
    bit = mutator.rng.randrange(8 * path.stat().st_size) if mutator.times() else -1
    if bit >= 0:
        flip(path, bit)
    (folder / "case.json").write_text(json.dumps({"kind": kind, "file": path.name, "bit": bit}))


def run(folder: Path, trial: Trial) -> None:
    """Repairs the bag and compares it with the whole one."""
    case = json.loads((folder / "case.json").read_text())
    result = trial.call("repair", repair, folder / "bag")
    trial.reach("messages")
    for fault in faults(folder / "whole", folder / "bag", result, case["kind"], case["file"], case["bit"]):
        trial.fault(f"{case}: {fault}")


def flip(path: Path, bit: int) -> None:
    """Flips a bit of a file."""
    data = bytearray(path.read_bytes())
    data[bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)


def faults(whole: Path, bag: Path, result: Repair, kind: str, file: str, bit: int) -> list[str]:
    """Returns what is wrong with a repaired bag, one line each.

    Args:
        whole: the bag before the bit was flipped.
        bag: the repaired bag.
        result: what the repair reported.
        kind: one of ``KINDS``.
        file: name of the file that was hit.
        bit: number of the bit that was flipped; below 0 = none.
    """
    before, after = Counter(_numbered(whole)), Counter(_numbered(bag))
    hit = Counter(_hit(whole, file, bit // 8)) if bit >= 0 else Counter()
    lost, new = before - after, after - before
    wrong = []
    if lost - hit:
        wrong.append(
            f"{(lost - hit).total()} messages outside of the part that was hit are lost: {[m[:2] for m in lost - hit][:5]}"
        )
    if new and (KINDS[kind].checked or new.total() > hit.total()):
        wrong.append(f"{new.total()} messages came out other than they went in: {[m[:2] for m in new][:5]}")
    if (lost or new) and KINDS[kind].checked and (whole / METADATA_FILE).exists() and (result.complete or not result.lost):
        wrong.append("the loss is not reported")
    if lost and not result.changed and KINDS[kind].checked:
        wrong.append("the bag is called whole")
    if not (lost or new) and (whole / METADATA_FILE).exists() and not result.complete:
        wrong.append(f"nothing is lost, but the report says so: {result.text()}")
    if result.messages != after.total():
        wrong.append(f"the report says {result.messages} messages, there are {after.total()}")
    for one in result.repairs:
        original = (whole / one.contents.path.name).read_bytes()
        data = bytearray(original)
        if one.contents.path.name == file and bit >= 0:
            data[bit // 8] ^= 1 << bit % 8
        if one.changed and (bag / one.kept).read_bytes() != data:
            wrong.append(f"{one.kept} is not the file as it was")
    if repair(bag).changed:
        wrong.append("a second repair changes the bag again")
    return wrong


def _numbered(bag: Path) -> list[Message]:
    """Returns the messages as another reader than ours finds them."""
    if (bag / METADATA_FILE).exists():
        with AnyReader([bag]) as reader:
            return [(c.topic, time, bytes(data)) for c, time, data in reader.messages()]
    copy = bag.with_name("readable")
    shutil.copytree(bag, copy)
    repair(copy)
    messages = _numbered(copy)
    shutil.rmtree(copy)
    return messages


def _hit(whole: Path, file: str, byte: int) -> list[Message]:
    """Returns the messages in the part of a file that holds a byte."""
    path = whole / file
    if path.suffix == ".mcap":
        return _hit_in_mcap(path, byte)
    return _hit_in_database(path, byte)


def _hit_in_mcap(path: Path, byte: int) -> list[Message]:
    from mcap.reader import make_reader

    chunk = next((c for c in scan(path).chunks if c.start <= byte < c.end), None)
    if chunk is None:
        return []
    with path.open("rb") as stream:
        found = scan(path)
        times = {found.channels[number].topic: {time for time, _ in entries} for number, entries in chunk.messages.items()}
        if chunk.is_run:
            begins = sorted(
                (offset, found.channels[n].topic, time) for n, entries in chunk.messages.items() for time, offset in entries
            )
            topic, time = max(b for b in begins if chunk.start + b[0] <= byte)[1:]
            times = {topic: {time}}
        stream.seek(0)
        whole = (
            _numbered(path.parent)
            if not (found.listed)
            else [(c.topic, m.log_time, m.data) for _, c, m in make_reader(stream).iter_messages()]
        )
    return [message for message in whole if message[1] in times.get(message[0], ())]


def _hit_in_database(path: Path, byte: int) -> list[Message]:
    from gibson_sim.bags.repairing.sqlite_pages import DatabasePages, page_layouts

    base = path.with_name(path.name.removesuffix("-wal"))
    size, reserved = next(iter(page_layouts(base)))
    number = byte // size + 1
    if path != base:
        frame = max(0, byte - 32) // (size + 24)
        number = struct.unpack_from(">I", path.read_bytes(), 32 + frame * (size + 24))[0]
    pages = DatabasePages(base, size, reserved)
    names: dict[int, str] = {}
    hit: list[tuple[int, int, bytes]] = []
    topics_hit = False
    for row in pages.scan().rows:
        values = pages.columns(row)
        is_hit = number in (row.page, *row.chain)
        if len(values) == 4 and isinstance(values[3], bytes):
            if is_hit:
                hit.append((int(str(values[1])), int(str(values[2])), values[3]))
        elif str(values[1]).startswith("/"):
            names[row.rowid] = str(values[1])
            topics_hit = topics_hit or is_hit
    pages.close()
    return [(names[topic], time, data) for topic, time, data in hit]
