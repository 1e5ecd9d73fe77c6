"""The recordings and the trial reports below one folder, for a page. Must not import ROS.

A request names none of them: it gives a key that the last listing has given out. Symbolic links are neither listed nor followed, on any level
below the folder, so that nothing outside of it is read.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
import stat
import subprocess
import sys
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from gibson_sim.errors import GibsonSimError, TextError
from gibson_sim.reading import check_status, parse_yaml

MAX_DEPTH, MAX_ENTRIES, MAX_FOLDERS = 5, 500, 20_000
"""Levels of folders that are searched, entries that are listed, and folders that are looked into."""
MAX_REPORT_BYTES = 64 * 2**20
"""Largest size of a trial's report or of a page of plots that is served."""
_MAX_METADATA_BYTES, _MAX_RESULTS_BYTES = 2 * 2**20, 16 * 2**20
_PLOT_TIMEOUT_S = 180.0
"""Timeout of ``gibson-sim bag plot``, s of wall time."""
_KEPT = 8
"""Number of pages of plots that are kept in memory."""
_METADATA, _REPORT, _RESULTS = "metadata.yaml", "index.html", "results.json"
_OPEN = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC


class RecordingError(GibsonSimError):
    """What a page has asked for cannot be shown; the message says why."""


@dataclass(frozen=True, slots=True)
class Recording:
    """A bag, or the report of a trial."""

    key: str
    """Identifies it in requests."""
    path: tuple[str, ...]
    """Names of the folders from the folder of all recordings to its own."""
    kind: Literal["bag", "trial"]
    bytes: int
    """Size of the files in its folder."""
    modified_s: float
    """Time of the last change, s since 1970."""
    seconds: float | None
    """Length of a bag, s of its own clock; None = unknown."""
    text: str
    """Number of messages of a bag; passed and failed runs of a trial."""

    def values(self) -> dict[str, Any]:
        """Returns the values for a page."""
        return {
            "key": self.key, "name": "/".join(self.path) or ".", "kind": self.kind, "bytes": self.bytes, "modified": self.modified_s,
            "seconds": self.seconds, "text": self.text,
        }  # fmt: skip


class Recordings:
    """Lists, plots and opens what is below a folder. Every method may block, and may be called from any thread.

    Args:
        folder: the folder; need not exist.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: dict[str, Recording] = {}
        self._plots: OrderedDict[tuple[str, float], bytes] = OrderedDict()
        self._plotting = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._closed = False

    def list(self) -> dict[str, Any]:
        """Returns the folder and its entries, the newest first."""
        found = sorted(self._search(), key=lambda entry: -entry.modified_s)[:MAX_ENTRIES]
        self._known = {entry.key: entry for entry in found}
        return {"folder": str(self._folder), "entries": [entry.values() for entry in found]}

    def report(self, key: str) -> bytes:
        """Returns the HTML report of a trial.

        Raises:
            RecordingError: no trial has this key, or its report cannot be read.
        """
        return self._read(self._entry(key, "trial"), _REPORT, MAX_REPORT_BYTES)

    def plots(self, key: str) -> bytes:
        """Returns the HTML page that ``gibson-sim bag plot`` writes for a bag; one bag is plotted at a time.

        Raises:
            RecordingError: no bag has this key, or it cannot be plotted.
        """
        entry = self._entry(key, "bag")
        with self._plotting:
            kept = self._plots.pop((key, entry.modified_s), None)
            page = self._plot(entry) if kept is None else kept
            self._plots[key, entry.modified_s] = page
            while len(self._plots) > _KEPT:
                self._plots.popitem(last=False)
        return page

    def close(self) -> None:
        """Ends a plot that is being made."""
        self._closed = True
        process = self._process
        if process is not None:
            with suppress(OSError):
                process.kill()

    def _entry(self, key: str, kind: str) -> Recording:
        entry = self._known.get(key)
        if entry is None or entry.kind != kind:
            raise RecordingError(f"no {kind} with this key is listed: list the recordings again")
        return entry

    def _search(self) -> Iterator[Recording]:
        remaining = MAX_FOLDERS
        folders: list[tuple[str, ...]] = [()]
        while folders and remaining:
            path, remaining = folders.pop(), remaining - 1
            try:
                with os.scandir(self._folder.joinpath(*path)) as entries:
                    rows = [(e.name, e.is_dir(follow_symlinks=False), e.stat(follow_symlinks=False)) for e in entries]
            except OSError:
                continue
            files = {name: status for name, _, status in rows if stat.S_ISREG(status.st_mode)}
            key = hashlib.sha256("/".join(path).encode(errors="surrogateescape")).hexdigest()[:24]
            size = sum(status.st_size for status in files.values())
            if _METADATA in files:
                seconds, text = self._about_bag(path)
                yield Recording(key, path, "bag", size, files[_METADATA].st_mtime, seconds, text)
                continue  # nothing of interest lies inside of a bag
            if _REPORT in files and _RESULTS in files:
                yield Recording(key, path, "trial", size, files[_REPORT].st_mtime, None, self._about_trial(path))
            if len(path) < MAX_DEPTH:
                folders += [(*path, name) for name, is_folder, _ in rows if is_folder and name.isprintable()]

    def _about_bag(self, path: tuple[str, ...]) -> tuple[float | None, str]:
        """Returns the length of a bag, s, and the number of its messages as text."""
        try:
            content = parse_yaml(self._bytes(path, _METADATA, _MAX_METADATA_BYTES))
            information = content["rosbag2_bagfile_information"]
            seconds, count = float(information["duration"]["nanoseconds"]) / 1e9, int(information["message_count"])
        except (OSError, TextError, TypeError, ValueError, KeyError, OverflowError):
            return None, "its metadata cannot be read"
        return (seconds if math.isfinite(seconds) else None), f"{count:,} messages"

    def _about_trial(self, path: tuple[str, ...]) -> str:
        """Returns how many runs of a trial have passed, as text."""
        try:
            totals = json.loads(self._bytes(path, _RESULTS, _MAX_RESULTS_BYTES))["totals"]
            return f"{int(totals['passed'])} of {int(totals['runs'])} runs passed"
        except (OSError, ValueError, TypeError, KeyError, OverflowError, RecursionError):
            return "its results cannot be read"

    def _read(self, entry: Recording, name: str, most: int) -> bytes:
        try:
            return self._bytes(entry.path, name, most)
        except OSError as error:
            raise RecordingError(f"{'/'.join((*entry.path, name))} cannot be read: {error.strerror}") from error

    def _bytes(self, path: tuple[str, ...], name: str, most: int) -> bytes:
        """Returns the content of a regular file; none of the folders to it may be a symbolic link.

        Raises:
            OSError: it cannot be read, is larger than ``most`` bytes, or is reached through a symbolic link.
        """
        folder = os.open(self._folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            for part in path:
                below = os.open(part, _OPEN | os.O_DIRECTORY, dir_fd=folder)
                os.close(folder)
                folder = below
            descriptor = os.open(name, _OPEN, dir_fd=folder)
        finally:
            os.close(folder)
        with open(descriptor, "rb") as file:
            check_status(os.fstat(descriptor), most)
            return file.read(most)

    def _plot(self, entry: Recording) -> bytes:
        """Returns the plots of a bag, made by ``gibson-sim bag plot`` in a process of its own, which a page waits for."""
        bag = self._folder.joinpath(*entry.path)
        self._read(entry, _METADATA, _MAX_METADATA_BYTES)  # it is still there, and reached without symbolic links
        with os.scandir(bag) as items:
            has_links = any(item.is_symlink() for item in items)
        if has_links:
            raise RecordingError(f"{bag} has symbolic links, which are not followed")
        with tempfile.TemporaryDirectory(prefix="gibson_sim_plot_") as folder:
            page = Path(folder, "plots.html")
            polite = ("nice", "-n", "10") if shutil.which("nice") else ()
            command = [*polite, sys.executable, "-m", "gibson_sim.cli.main", "bag", "plot", str(bag.absolute()), str(page)]
            if self._closed:
                raise RecordingError("the page's server ends")
            self._process = subprocess.Popen(
                command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace"
            )
            try:
                _, errors = self._process.communicate(timeout=_PLOT_TIMEOUT_S)
            except subprocess.TimeoutExpired as error:
                raise RecordingError(
                    f"{bag} is not plotted within {_PLOT_TIMEOUT_S:.0f} s: use `gibson-sim bag plot {bag}`"
                ) from error
            finally:
                self._process.kill()
                self._process.wait()
                self._process = None
            if not page.is_file():
                lines = [line for line in errors.splitlines() if line.strip()] or ["no reason is known"]
                raise RecordingError(lines[-1].rpartition("error: ")[2][:500])
            if page.stat().st_size > MAX_REPORT_BYTES:
                raise RecordingError(f"the plots of {bag} have more than {MAX_REPORT_BYTES // 2**20} MB")
            return page.read_bytes()
