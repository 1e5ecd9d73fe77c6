"""Stages of a long job in a folder: each is made once, and again only if its inputs or options change.

``import.json`` in the folder says which stages ended, with what key. The key of a stage is a digest of its own options and of the key of the
stage before it, so that whatever follows a changed stage is made again. Stages write their files atomically: one that was interrupted left none.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gibson_sim.digests import digest_of
from gibson_sim.errors import SceneError
from gibson_sim.processes.folder_lock import locked_folder
from gibson_sim.reading import read_file
from gibson_sim.writing import write_file

Progress = Callable[[float], None]

RECORD = "import.json"
"""File that marks the folder of a job."""
_FORMAT = "gibson_sim import from photographs"
_VERSION = 3
"""Version of what the stages do: another one makes all of them again."""
_MOST_BYTES = 64 * 2**20


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage."""

    name: str
    run: Callable[[Progress], Sequence[str]]
    """Does the work; returns what is to be said of it, one line each."""
    files: tuple[str, ...] = ()
    """What it writes, relative to the folder; if one is missing it is made again."""
    options: Any = None
    """All that its result depends on beside the stages before it, as ``digest_of`` takes it."""
    weight: float = 1.0
    """Expected share of the time."""


@dataclass(frozen=True, slots=True)
class Ended:
    """A stage that ended."""

    name: str
    lines: tuple[str, ...]
    seconds: float
    """Wall time that it took, now or earlier."""
    reused: bool
    """Whether it had ended in an earlier run."""


@dataclass(slots=True)
class Work:
    """The folder of a job."""

    folder: Path
    source: str
    """What the job is made from; another job may not go on in the folder."""
    _stages: dict[str, dict[str, Any]] = field(default_factory=dict)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Opens the folder as ``open`` does, and keeps other jobs out of it in a block.

        Raises:
            SceneError: another job is at work in it, or it holds something else.
            WriteError: it cannot be written.
        """
        in_use = SceneError(
            f"{self.folder}: another import is being made in the folder; wait until it ends, or give another folder with --output"
        )
        with locked_folder(self.folder, in_use):
            self.open()
            yield

    def open(self) -> None:
        """Creates the folder or reads its record.

        Raises:
            SceneError: the folder holds something else.
            WriteError: it cannot be written.
        """
        path = self.folder / RECORD
        if not path.exists():
            if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
                raise SceneError(
                    f"{self.folder}: already exists and is not empty; give another folder with --output, or delete it first"
                )
            self._save()
            return
        try:
            record = json.loads(read_file(path, _MOST_BYTES))
            ours = record["format"] == _FORMAT
            source, version, stages = record["source"], record["version"], record["stages"]
            if not (ours and isinstance(stages, dict)):
                raise ValueError("it is of another program")
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise SceneError(
                f"{path}: is not the record of an import from photographs ({error}); give another folder with --output, or delete this one"
            ) from error
        if source != self.source:
            raise SceneError(
                f"{self.folder}: holds an import of {source}; give another folder with --output for {self.source}, or delete it first"
            )
        self._stages = stages if version == _VERSION else {}

    def run(
        self, stages: Sequence[Stage], bar: Callable[[int], AbstractContextManager[Progress]], say: Callable[[Ended], None]
    ) -> None:
        """Makes the stages that are not made yet.

        Args:
            stages: in their order.
            bar: returns the context that shows the progress of the stage with a number, from 0.
            say: receives each stage that ended.
        """
        key = ""
        for number, stage in enumerate(stages):
            key = f"{digest_of((key, stage.name, stage.options)):016x}"
            known = self._stages.get(stage.name)
            if known is not None and known.get("key") == key and all((self.folder / file).exists() for file in stage.files):
                say(Ended(stage.name, tuple(known["lines"]), float(known["seconds"]), reused=True))
                continue
            # What follows was made from the former result.
            for later in stages[number:]:
                self._stages.pop(later.name, None)
            # Before its files change: they would else count as made with the former options if this run is cut off.
            self._save()
            begin = time.monotonic()
            with bar(number) as progress:
                lines = tuple(stage.run(progress))
            seconds = time.monotonic() - begin
            self._stages[stage.name] = {"key": key, "seconds": round(seconds, 2), "lines": list(lines)}
            self._save()
            say(Ended(stage.name, lines, seconds, reused=False))

    def _save(self) -> None:
        record = {"format": _FORMAT, "version": _VERSION, "source": self.source, "stages": self._stages}
        write_file(self.folder / RECORD, json.dumps(record, indent=1))
