"""Repairs a bag that was cut off or damaged: after a crash, a power cut, a full disk, or with changed bytes.

Every file is read to its end and checked. What can be read of a damaged one is written to a new file, which takes its place; the file as it
was is kept beside it. Then ``metadata.yaml`` is rewritten for all files. What was stepped over, and what is missing, is reported.
"""

from __future__ import annotations

import logging
import os
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gibson_sim.bags.metadata import (
    METADATA_FILE,
    REPAIRED,
    TopicRecord,
    bag_information,
    listed_topics,
    read_metadata,
    write_metadata,
)
from gibson_sim.bags.repairing.mcap import finish_mcap, repair_mcap
from gibson_sim.bags.repairing.sqlite import COMPANIONS, remove, repair_sqlite
from gibson_sim.bags.sqlite_file import merge_log
from gibson_sim.bags.storage import RESERVE_FILE, SUFFIXES, EmptyFileError, FileContents, FileRepair, Storage
from gibson_sim.errors import RecordError

_KEPT = ".damaged"
"""Ending of a file as it was before the repair."""
_DRAFT = ".repairing"
"""Ending of a file that is being written."""
_MOST_LINES = 20
"""Maximum number of lines of one kind in a report."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Repair:
    """Result of ``repair``."""

    folder: Path
    repairs: tuple[FileRepair, ...]
    """What became of each readable file."""
    lost: Mapping[str, int]
    """Topic -> number of messages that the bag lists and that could not be read."""
    complete: bool
    """Whether nothing that had been written whole is missing, as far as can be known."""
    notes: tuple[str, ...] = ()
    """What else was done; one line each."""
    changed: bool = True

    @property
    def files(self) -> int:
        """Number of readable files."""
        return len(self.repairs)

    @property
    def messages(self) -> int:
        """Number of readable messages."""
        return sum(one.contents.count for one in self.repairs)

    @property
    def skipped(self) -> int:
        """Size of what was stepped over: bytes of mcap files, pages of databases."""
        return sum(end - start for one in self.repairs for start, end, _ in one.gaps)

    @property
    def counts(self) -> Counter[str]:
        """Topic -> number of readable messages."""
        return _counts([one.contents for one in self.repairs])

    def __str__(self) -> str:
        files = "" if self.files == 1 else f" in {self.files} files"
        if not self.changed:
            return f"{self.folder} is whole, with {self.messages} messages{files}: nothing to do"
        skipped = ""
        if self.skipped:
            skipped = f"; {self.skipped} {next(one.unit for one in self.repairs if one.gaps)} were stepped over"
        lost = f"; {sum(self.lost.values())} messages are lost" if self.lost else ""
        return f"{self.folder} can be read again: {self.messages} messages{files}{skipped}{lost}"

    def text(self) -> str:
        """Returns the report: what was stepped over in which file, which messages were recovered, lost, and not checked."""
        lines = [str(self)]
        for one in self.repairs:
            name = one.contents.path.name
            if one.kept:
                lines.append(f"{name}: written anew; the file as it was is kept as {one.kept}")
            gaps = [f"stepped over {_span(start, end, one.unit)}: {reason}" for start, end, reason in one.gaps]
            lines += [f"  {line}" for line in (*_clipped(gaps), *_clipped(list(one.notes)))]
        lines += self.notes
        if self.changed:
            lines += [f"recovered: {count:8d} {topic}" for topic, count in sorted(self.counts.items())]
        lines += [f"lost:      {count:8d} {topic}" for topic, count in sorted(self.lost.items())]
        unchecked = sum(one.unchecked for one in self.repairs)
        if unchecked:
            what = "SQLite has none" if self.repairs[0].unit == "pages" else "they were written without"
            lines.append(f"not checked: the content of {unchecked} messages has no checksum ({what})")
        if not self.complete and not self.lost:
            lines.append("nothing says how many messages were in what was stepped over")
        return "\n".join(lines)


def repair(folder: str | Path) -> Repair:
    """Repairs a bag. Leaves a whole bag unchanged; idempotent. Files that are not whole are kept under another name.

    Raises:
        RecordError: there is no bag, or nothing of it can be read, or the disk has no room for the new file.
    """
    folder = Path(folder)
    storage, paths = _storage_files(folder)
    information = read_metadata(folder)
    known = listed_topics(information)
    repairs: list[FileRepair] = []
    notes: list[str] = []
    try:
        (folder / RESERVE_FILE).unlink(missing_ok=True)
        for path in paths:
            try:
                repairs.append(_repair_file(path, storage, known))
            except EmptyFileError as error:
                lost_text = _lost_with(path, information, is_only=len(paths) == 1)
                if len(paths) == 1:
                    raise RecordError(lost_text or str(error)) from error
                notes.append(f"{lost_text or error}; it is left out")
        contents = [one.contents for one in repairs]
        is_listed = _is_listed(information, contents)
        lost = _lost(repairs, information)
        proven = not lost and _listed_counts(information) is not None
        complete = not lost and (proven or all(one.harmless for one in repairs))
        changed = not is_listed or any(one.changed for one in repairs)
        mark = _mark(sum(one.count for one in contents), lost.total()) if changed and not complete else ""
        if not is_listed or mark:
            if (folder / METADATA_FILE).exists():
                notes.append(f"{METADATA_FILE}: written anew; the file as it was is kept as {_keep(folder / METADATA_FILE)}")
            else:
                notes.append(f"{METADATA_FILE}: was missing, written")
            _write_metadata(folder, storage, contents, information, mark)
        return Repair(folder, tuple(repairs), lost, complete, tuple(notes), changed)
    except OSError as error:
        raise RecordError(
            f"{folder} cannot be repaired: {error.strerror}; the new files need as much room as the damaged ones: make room and check the "
            "permissions, or repair a copy on another disk"
        ) from error


def finish(folder: str | Path) -> FileContents:
    """Finishes, in place, a bag whose recording ended in the middle of a write, perhaps on a full disk: there is no room for copies.

    Only for bags of this process: their incomplete end, which was never whole, is cut off.

    Returns:
        What the last file holds.

    Raises:
        RecordError: a file is damaged elsewhere.
        OSError: a file cannot be written.
    """
    folder = Path(folder)
    storage, paths = _storage_files(folder)
    contents: list[FileContents] = []
    (folder / RESERVE_FILE).unlink(missing_ok=True)
    for path in paths:
        try:
            if storage == "sqlite3":
                contents.append(merge_log(path))
                _write_metadata(folder, storage, contents, {})
            else:
                # On a full disk, the last file makes room for the metadata as well.
                contents.append(finish_mcap(path, lambda done: _write_metadata(folder, storage, [*contents, done], {})))
        except EmptyFileError as error:
            if len(paths) == 1:
                raise
            _log.warning("%s: it is left out", error)
    if not _is_listed(read_metadata(folder), contents):
        _write_metadata(folder, storage, contents, {})
    topics = tuple(topic for one in contents for topic in one.topics)
    return FileContents(folder, contents[0].start_ns, contents[-1].end_ns, topics)


def _storage_files(folder: Path) -> tuple[Storage, list[Path]]:
    """Returns the storage format of a bag, and its files in order.

    Raises:
        RecordError: the bag has no storage files, or files of two formats.
    """
    paths_of: dict[Storage, list[Path]] = {kind: sorted(folder.glob("*" + s), key=_number) for kind, s in SUFFIXES.items()}
    kinds = [kind for kind, paths in paths_of.items() if paths]
    if len(kinds) != 1:
        what = "files of both mcap and sqlite3" if kinds else "no mcap or db3 file"
        compressed = next((path.name for s in SUFFIXES.values() for path in folder.glob(f"*{s}.zstd")), "")
        hint = f"unpack its compressed files first: zstd -d {compressed}" if compressed else "give the folder that was recorded"
        raise RecordError(f"{folder} holds {what}, must be the folder of one bag; {hint}")
    return kinds[0], paths_of[kinds[0]]


def _number(path: Path) -> tuple[int, str]:
    """Returns a sort key that sorts ``bag_10`` after ``bag_9``."""
    match = re.search(r"_(\d+)$", path.stem)
    return int(match[1]) if match else 0, path.name


def _repair_file(path: Path, storage: Storage, known: Mapping[str, TopicRecord]) -> FileRepair:
    """Repairs one file: a new one takes its place, under its name."""
    new = path.with_name(path.name + _DRAFT)
    done = False
    try:
        result = (repair_sqlite if storage == "sqlite3" else repair_mcap)(path, new, known)
        if result.changed:
            kept = _keep(path)
            for ending in COMPANIONS if storage == "sqlite3" else ():
                path.with_name(path.name + ending).unlink(missing_ok=True)
            os.replace(new, path)
            result = replace(result, kept=kept)
        done = True
        return result
    finally:
        if not done:
            remove(new)


def _keep(path: Path) -> str:
    """Gives a file, with what SQLite has beside it, a second name that is free; returns that name."""
    number = 1
    while (kept := path.with_name(path.name + _KEPT + (f".{number}" if number > 1 else ""))).exists():
        number += 1
    for ending in ("", *COMPANIONS[:2]):
        source, target = path.with_name(path.name + ending), kept.with_name(kept.name + ending)
        if not source.exists():
            continue
        try:
            os.link(source, target)
        except OSError:  # a file system without links
            os.rename(source, target)
    return kept.name


def _is_listed(information: Mapping[str, Any], contents: list[FileContents]) -> bool:
    """Returns whether the metadata lists exactly these files with all their topics and messages."""
    files = information.get("relative_file_paths") == [c.path.name for c in contents]
    count = information.get("message_count") == sum(c.count for c in contents)
    counts = _counts(contents)
    topics = {topic.name: (topic.type_name, counts[topic.name]) for c in contents for topic in c.topics}
    listed = {topic.name: (topic.type_name, topic.count) for topic in listed_topics(information).values()}
    return files and count and listed == topics


def _counts(contents: list[FileContents]) -> Counter[str]:
    counts: Counter[str] = Counter()
    for topic in (topic for c in contents for topic in c.topics):
        counts[topic.name] += topic.count
    return counts


def _listed_counts(information: Mapping[str, Any]) -> Counter[str] | None:
    """Returns topic -> number of messages as the metadata lists them; None if it does not, or contradicts itself."""
    counts = Counter({topic.name: topic.count for topic in listed_topics(information).values()})
    return counts if counts and information.get("message_count") == counts.total() else None


def _lost(repairs: list[FileRepair], information: Mapping[str, Any]) -> Counter[str]:
    """Returns topic -> number of messages that the files or the metadata list and that were not found."""
    found = _counts([one.contents for one in repairs])
    listed_by_files: Counter[str] = Counter()
    for one in repairs:
        listed_by_files += one.listed if one.listed is not None else _counts([one.contents])
    lost = listed_by_files - found
    # A file that was whole, or is proven to be now, tells more than the metadata; a file that is gone tells nothing.
    names = information.get("relative_file_paths")
    are_gone = isinstance(names, list) and not {one.contents.path.name for one in repairs}.issuperset(map(str, names))
    if are_gone or not all(one.sure for one in repairs):
        for topic, count in (_listed_counts(information) or Counter()).items():
            if count > found[topic]:
                lost[topic] = max(lost[topic], count - found[topic])
    return lost


def _lost_with(path: Path, information: Mapping[str, Any], *, is_only: bool) -> str:
    """Returns what is lost with a file that ends before its first record, one line; empty = the metadata lists no message of it.

    Args:
        path: the file.
        information: metadata of the bag.
        is_only: whether the bag has no other file.
    """
    files = information.get("files")
    entries = [one for one in files if isinstance(one, dict) and one.get("path") == path.name] if isinstance(files, list) else []
    count = entries[0].get("message_count") if entries else information.get("message_count") if is_only else None
    if not isinstance(count, int) or count < 1:
        return ""
    state = "ends before its first record" if path.stat().st_size else "is empty (0 bytes)"
    hint = ": nothing can be repaired; restore the file from a copy" if is_only else ""
    return f"{path} {state}: the {count} messages that {METADATA_FILE} lists in it are lost{hint}"


def _mark(kept: int, lost: int) -> str:
    """Returns what the metadata of a repaired bag says about its losses, from the numbers of messages."""
    return (
        f"{lost} of {kept + lost} messages lost"
        if lost
        else "parts of it were damaged; how many messages were in them is not known"
    )


def _write_metadata(
    folder: Path, storage: Storage, contents: list[FileContents], before: Mapping[str, Any], mark: str = ""
) -> None:  # fmt: skip
    """Writes ``metadata.yaml`` for a bag of these files.

    Args:
        folder: folder of the bag.
        storage: format of the files.
        contents: the files, in order.
        before: metadata as it was: what the user added to it is kept.
        mark: what a repair lost, see ``REPAIRED``; empty = nothing.
    """
    topics: dict[str, TopicRecord] = {}
    for topic in (topic for c in contents for topic in c.topics):
        earlier = topics.get(topic.name)
        count = topic.count + (earlier.count if earlier else 0)
        topics[topic.name] = TopicRecord(topic.name, topic.type_name, topic.qos, topic.type_hash, count)
    information = bag_information(list(topics.values()), [c.record for c in contents], storage)
    kept = {name: before[name] for name in ("custom_data", "ros_distro") if before.get(name) is not None}
    if mark:
        custom = kept.get("custom_data")
        custom = custom if isinstance(custom, dict) else {}
        kept["custom_data"] = custom | {REPAIRED: "; ".join(filter(None, (str(custom.get(REPAIRED) or ""), mark)))}
    write_metadata(folder, information | kept)


def _span(start: int, end: int, unit: str) -> str:
    if unit == "pages":
        return f"page {start}" if end == start + 1 else f"pages {start} to {end - 1}"
    return f"{end - start} bytes at {start}"


def _clipped(lines: list[str]) -> list[str]:
    """Returns the first lines, and how many more there are."""
    return lines if len(lines) <= _MOST_LINES else [*lines[:_MOST_LINES], f"and {len(lines) - _MOST_LINES} more"]
