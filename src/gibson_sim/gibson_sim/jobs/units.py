"""Units of work, their results, and ``run_units``, which runs them on a backend."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from gibson_sim.errors import ConfigError, WriteError
from gibson_sim.quoting import quoted
from gibson_sim.reading import exists
from gibson_sim.writing import cannot_write

REPEATS = 2
"""How often a unit is repeated whose worker process died."""
MAX_ARGUMENTS_BYTES = 64_000_000
"""Limit of a unit's arguments as JSON; whatever is larger belongs into files."""
LOG_SUFFIX = ".log"
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_FUNCTION = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")


class Context(Protocol):
    """What a unit's function is told by its worker, and what it can tell."""

    def stop(self) -> bool:
        """Returns whether the unit shall end early: it has a few seconds to end what it started and return."""
        ...

    def progress(self, text: str) -> None:
        """Reports one line about the unit to the caller of ``run_units``."""
        ...

    def path(self, path: str | Path) -> Path:
        """Returns where a file or folder is on this machine that stands in the unit's ``files``, or in a folder of them."""
        ...


@dataclass(frozen=True, slots=True)
class Unit:
    """A piece of work that depends on no other one.

    Raises:
        ConfigError: a value is impossible.
    """

    id: str
    """Name of its folder: at most 100 letters, digits, ``.``, ``_`` and ``-``."""
    function: str
    """``module:function``, called as ``function(arguments, folder, context)``; returns values of JSON."""
    arguments: dict[str, Any] = field(default_factory=dict)
    """Values of JSON; the function receives what JSON makes of them, lists for tuples."""
    files: tuple[Path, ...] = ()
    """Files and folders that it reads; on other machines ``context.path`` tells where their copies are."""

    def __post_init__(self) -> None:
        if not _ID.fullmatch(self.id) or self.id.endswith(LOG_SUFFIX):
            raise ConfigError(
                f"the id of a unit is {quoted(self.id)}, must be at most 100 letters, digits, '.', '_' and '-', begin with a letter or "
                f"digit, and not end in {LOG_SUFFIX}"
            )
        if not _FUNCTION.fullmatch(self.function):
            raise ConfigError(f"unit {self.id}: function is {quoted(self.function)}, must be module:function")
        try:
            size = len(json.dumps(self.arguments))
        except (TypeError, ValueError, RecursionError) as error:
            raise ConfigError(f"unit {self.id}: its arguments are no JSON: {error}") from error
        if size > MAX_ARGUMENTS_BYTES:
            raise ConfigError(
                f"unit {self.id}: its arguments have {size / 1e6:.0f} MB as JSON, at most {MAX_ARGUMENTS_BYTES / 1e6:.0f} MB; pass files"
            )
        for path in self.files:
            if not exists(path):
                raise ConfigError(f"unit {self.id}: file {quoted(str(path))} does not exist")


@dataclass(frozen=True, slots=True)
class UnitResult:
    """How a unit ended."""

    id: str
    value: Any = None
    """What the function returned."""
    error: str = ""
    """Why it failed, in one line; empty = it did not."""
    attempts: int = 1
    """How often it was begun; 0 = never, since all was stopped before."""
    log: Path | None = None
    """All that it printed, and the whole traceback; None = nothing."""
    stopped: bool = False
    """Whether it failed because all was stopped."""
    died: bool = False
    """Whether it failed because its worker died at every attempt."""
    seconds: float = 0.0
    """Wall time of the last attempt."""


class Backend(Protocol):
    """Where units run."""

    def run(
        self,
        units: Sequence[Unit],
        output: Path,
        on_result: Callable[[UnitResult], None],
        on_progress: Callable[[str, str], None],
        stop: Callable[[], bool],
    ) -> None:
        """Runs all units and hands over each result once; see ``run_units``."""
        ...


def never() -> bool:
    """Returns False."""
    return False


def ignore(*_: object) -> None:
    """Does nothing."""


def run_units(
    units: Sequence[Unit],
    backend: Backend,
    *,
    output: Path,
    on_result: Callable[[UnitResult], None] = ignore,
    on_progress: Callable[[str, str], None] = ignore,
    stop: Callable[[], bool] = never,
) -> list[UnitResult]:
    """Runs units, and returns their results in the order of the units.

    What unit ``x`` wrote into its folder is in ``output/x``, what it printed in ``output/x.log``. A unit that raises has failed; the others
    go on. A unit whose worker died is repeated, at most twice, with an empty folder. Ctrl-C and ``stop`` ask the running units to end, and
    end them if they do not; nothing that they started is left behind, also when this process is killed.

    Args:
        units: with different ids.
        backend: where they run.
        output: folder of their outputs, which is made.
        on_result: called in this thread with each result as it comes.
        on_progress: called in this thread with the id and the text of ``context.progress``.
        stop: asked several times a second; no unit begins once it returns True.

    Raises:
        ConfigError: two units have one id, or the output of one is there already.
        KeyboardInterrupt: Ctrl-C; everything has ended.
    """
    ids = [unit.id for unit in units]
    twice = next((name for k, name in enumerate(ids) if name in ids[:k]), None) if len(set(ids)) < len(ids) else None
    if twice is not None:
        raise ConfigError(f"two units have the id {quoted(twice)}, each needs its own")
    try:
        output.mkdir(parents=True, exist_ok=True)
        there = {path.name for path in output.iterdir()}
    except OSError as error:
        raise cannot_write(output, error) from error
    used = next((name for name in ids if name in there or name + LOG_SUFFIX in there), None)
    if used is not None:
        raise WriteError(f"{output / used} is there already from an earlier time; remove it, or choose another folder")
    results: dict[str, UnitResult] = {}

    def keep(result: UnitResult) -> None:
        results[result.id] = result
        on_result(result)

    if units:
        backend.run(units, output, keep, on_progress, stop)
    return [results[name] for name in ids]
