"""Units of work, their results, and ``run_units``, which runs units on a backend."""

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
"""Number of repetitions of a unit whose worker process died."""
MAX_ARGUMENTS_BYTES = 64_000_000
"""Largest size of a unit's arguments as JSON, bytes; larger data belong in files."""
LOG_SUFFIX = ".log"
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_FUNCTION = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")


class Context(Protocol):
    """Interface between a unit's function and its worker."""

    def stop(self) -> bool:
        """Returns whether the unit must end early; it then has a few seconds to end its processes and return."""
        ...

    def progress(self, text: str) -> None:
        """Reports one line about the unit to the caller of ``run_units``."""
        ...

    def path(self, path: str | Path) -> Path:
        """Returns the path on this machine of a file or folder in the unit's ``files`` or below one of these folders."""
        ...


@dataclass(frozen=True, slots=True)
class Unit:
    """A piece of work that depends on no other unit.

    Raises:
        ConfigError: a value is not allowed.
    """

    id: str
    """Name of the unit and of its folder: at most 100 letters, digits, ``.``, ``_`` and ``-``."""
    function: str
    """``module:function``, called as ``function(arguments, folder, context)``; returns JSON values."""
    arguments: dict[str, Any] = field(default_factory=dict)
    """JSON values; the function receives them after a JSON round trip, which turns tuples into lists."""
    files: tuple[Path, ...] = ()
    """Files and folders that the unit reads; ``context.path`` returns the paths of their copies on other machines."""

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
            raise ConfigError(f"unit {self.id}: its arguments are not JSON: {error}") from error
        if size > MAX_ARGUMENTS_BYTES:
            raise ConfigError(
                f"unit {self.id}: its arguments have {size / 1e6:.0f} MB as JSON, at most {MAX_ARGUMENTS_BYTES / 1e6:.0f} MB; pass files"
            )
        for path in self.files:
            if not exists(path):
                raise ConfigError(f"unit {self.id}: file {quoted(str(path))} does not exist")


@dataclass(frozen=True, slots=True)
class UnitResult:
    """Result of a unit."""

    id: str
    value: Any = None
    """Return value of the function, JSON values."""
    error: str = ""
    """Reason of a failure, one line; empty = none."""
    attempts: int = 1
    """Number of attempts; 0 = stopped before the unit began."""
    log: Path | None = None
    """File with its output and the full traceback; None = no output."""
    stopped: bool = False
    """Whether the unit failed because all units were stopped."""
    died: bool = False
    """Whether the unit failed because its worker died at every attempt."""
    seconds: float = 0.0
    """Wall time of the last attempt, seconds."""


class Backend(Protocol):
    """Executor of units."""

    def run(
        self,
        units: Sequence[Unit],
        output: Path,
        on_result: Callable[[UnitResult], None],
        on_progress: Callable[[str, str], None],
        stop: Callable[[], bool],
    ) -> None:
        """Runs all units and hands over each result exactly once; see ``run_units``."""
        ...


def backend_for(workers: int | str, on_interrupt: Callable[[int], None] = lambda running: None) -> Backend:
    """Returns the backend for a number of worker processes of this machine, or for the address of a Ray cluster.

    Args:
        workers: the number, or the address, such as ``auto`` or ``10.0.0.5:6379``.
        on_interrupt: called at the first Ctrl-C with the number of running units, before they are ended; 0 = unknown.

    Raises:
        GibsonSimError: the number is not allowed, or Ray is not installed.
    """
    # Imported here: each backend builds on this module, and only one is needed.
    if isinstance(workers, str):
        from gibson_sim.jobs.ray_cluster import RayCluster

        return RayCluster(workers, on_interrupt=on_interrupt)
    from gibson_sim.jobs.local import LocalWorkers

    return LocalWorkers(workers, on_interrupt=on_interrupt)


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
    """Runs units; returns their results in the order of the units.

    The folder of unit ``x`` is ``output/x``, its output is in ``output/x.log``. A unit that raises has failed; the others continue. A unit
    whose worker died is repeated, at most twice, with an empty folder. Ctrl-C and ``stop`` ask the running units to end, and end them if they
    do not. No process of a unit is left behind, even if this process is killed.

    Args:
        units: units with different ids.
        backend: executor of the units.
        output: folder of the outputs; it is created.
        on_result: called in this thread with each result when it is available.
        on_progress: called in this thread with the id and the text of ``context.progress``.
        stop: called several times a second; no unit begins after it has returned True.

    Raises:
        ConfigError: two units have the same id.
        WriteError: the output of a unit exists already, or the folder cannot be written.
        KeyboardInterrupt: Ctrl-C; all units have ended.
    """
    ids = [unit.id for unit in units]
    duplicate = next((name for k, name in enumerate(ids) if name in ids[:k]), None) if len(set(ids)) < len(ids) else None
    if duplicate is not None:
        raise ConfigError(f"two units have the id {quoted(duplicate)}; ids must be unique")
    try:
        output.mkdir(parents=True, exist_ok=True)
        existing = {path.name for path in output.iterdir()}
    except OSError as error:
        raise cannot_write(output, error) from error
    used = next((name for name in ids if name in existing or name + LOG_SUFFIX in existing), None)
    if used is not None:
        raise WriteError(f"{output / used} exists already; remove it, or choose another folder")
    results: dict[str, UnitResult] = {}

    def keep(result: UnitResult) -> None:
        results[result.id] = result
        on_result(result)

    if units:
        backend.run(units, output, keep, on_progress, stop)
    return [results[name] for name in ids]
