"""Resumable job of several stages in a folder: a stage runs again only if its inputs or options change (incremental build).

``import.json`` in the folder records the completed stages and their keys. The key of a stage is a digest of its options and the key of the
previous stage, so that a changed stage invalidates all later ones. Stages write their files atomically; an interrupted one leaves none.
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
"""Record of the completed stages; marks the folder of a job."""
_FORMAT = "gibson_sim import from photographs"
_VERSION = 3
"""Version of the stages; another version invalidates all of them."""
_MAX_BYTES = 64 * 2**20


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage of a job."""

    name: str
    """Key in the record."""
    run: Callable[[Progress], Sequence[str]]
    """Runs the stage; returns its report, one message per line."""
    files: tuple[str, ...] = ()
    """Output files, relative to the folder; the stage runs again if one is missing."""
    options: Any = None
    """Everything on which the result depends besides the previous stages; an argument of ``digest_of``."""
    weight: float = 1.0
    """Expected duration, relative to the other stages."""


@dataclass(frozen=True, slots=True)
class StageResult:
    """Result of a completed stage."""

    name: str
    lines: tuple[str, ...]
    """Its report."""
    seconds: float
    """Its wall time, in this run or the earlier one, seconds."""
    reused: bool
    """Whether it was completed in an earlier run."""


@dataclass(slots=True)
class StagedJob:
    """A resumable job in a folder."""

    folder: Path
    source: str
    """Identifies the inputs; a job of another source is refused in the folder."""
    _stages: dict[str, dict[str, Any]] = field(default_factory=dict)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Locks the folder against other processes for the duration of a block, and opens it.

        Raises:
            SceneError: another job has locked the folder, or it holds something else.
            WriteError: the folder cannot be written.
        """
        in_use = SceneError(
            f"{self.folder}: another import is being made in the folder; wait until it ends, or give another folder with --output"
        )
        with locked_folder(self.folder, in_use):
            self.open()
            yield

    def open(self) -> None:
        """Creates the folder, or reads the record in it.

        Raises:
            SceneError: the folder holds something else.
            WriteError: the folder cannot be written.
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
            record = json.loads(read_file(path, _MAX_BYTES))
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
        self,
        stages: Sequence[Stage],
        stage_progress: Callable[[int], AbstractContextManager[Progress]],
        on_result: Callable[[StageResult], None],
    ) -> None:
        """Runs the stages that are not completed or are invalidated.

        Args:
            stages: stages in their order.
            stage_progress: returns a context manager that yields the progress callback of a stage, by its index.
            on_result: called with the result of each completed stage.
        """
        key = ""
        for number, stage in enumerate(stages):
            key = f"{digest_of((key, stage.name, stage.options)):016x}"
            recorded = self._stages.get(stage.name)
            if recorded is not None and recorded.get("key") == key and all((self.folder / file).exists() for file in stage.files):
                on_result(StageResult(stage.name, tuple(recorded["lines"]), float(recorded["seconds"]), reused=True))
                continue
            # All later stages depend on this one.
            for following in stages[number:]:
                self._stages.pop(following.name, None)
            # Saved before its files change: if this run is interrupted, they must not count as results of the former options.
            self._save()
            start = time.monotonic()
            with stage_progress(number) as progress:
                lines = tuple(stage.run(progress))
            seconds = time.monotonic() - start
            self._stages[stage.name] = {"key": key, "seconds": round(seconds, 2), "lines": list(lines)}
            self._save()
            on_result(StageResult(stage.name, lines, seconds, reused=False))

    def _save(self) -> None:
        record = {"format": _FORMAT, "version": _VERSION, "source": self.source, "stages": self._stages}
        write_file(self.folder / RECORD, json.dumps(record, indent=1))
