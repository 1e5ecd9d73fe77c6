"""Execution of units on a Ray cluster, one Ray task each; their files are transferred by content hash. The only module that imports Ray.

A Ray worker runs a unit in a worker process with the same code as ``LocalWorkers`` and keeps this process for its next units.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gibson_sim import __version__
from gibson_sim.errors import ConfigError, EnvironmentProblemError, GibsonSimError
from gibson_sim.jobs.local import GRACE_S, Interrupts, Pool
from gibson_sim.jobs.packing import Contents, Entry, FileCache, entries_of, unpack
from gibson_sim.jobs.units import LOG_SUFFIX, REPEATS, Unit, UnitResult, ignore, never
from gibson_sim.quoting import clipped, quoted
from gibson_sim.resources import cache_folder
from gibson_sim.writing import size_text, write_file

logger = logging.getLogger(__name__)
MAX_FILES_BYTES = 8_000_000_000
"""Largest size of the files of all units together, each content counted once, bytes."""
MAX_OUTPUT_BYTES = 2_000_000_000
"""Largest size of the output of one unit, bytes."""
MAX_LOG_BYTES = 4_000_000
"""Largest size of a log, bytes; of a longer log only the end is sent back."""
_PERIOD_S = 0.1
"""Polling period of ``stop``, seconds of wall time."""


class RayCluster:
    """The machines of a Ray cluster; all must have this version of Gibson Sim.

    Args:
        address: ``host:port`` of the cluster, ``ray://host:port`` of its client server, or ``auto`` = the cluster of this machine.
        cpus: cores that Ray reserves for a unit.
        gpus: graphics cards that Ray reserves for a unit.
        repeats: number of repetitions of a unit whose worker or machine died.
        limit_bytes: largest size of the files of all units together.
        on_interrupt: called at the first Ctrl-C, before the units are ended, with 0: the number of running units is unknown.

    Raises:
        EnvironmentProblemError: Ray is not installed.
    """

    def __init__(
        self,
        address: str = "auto",
        *,
        cpus: float = 1.0,
        gpus: float = 0.0,
        repeats: int = REPEATS,
        limit_bytes: int = MAX_FILES_BYTES,
        on_interrupt: Callable[[int], None] = ignore,
    ) -> None:
        self._ray, self._on_interrupt = _import_ray(), on_interrupt
        if cpus < 0.0 or gpus < 0.0:
            raise ConfigError(f"a unit needs {cpus:g} cores and {gpus:g} graphics cards, must be 0 or more")
        self._address, self._cpus, self._gpus, self._repeats, self._limit = address, cpus, gpus, repeats, limit_bytes

    def run(
        self,
        units: Sequence[Unit],
        output: Path,
        on_result: Callable[[UnitResult], None],
        on_progress: Callable[[str, str], None],
        stop: Callable[[], bool],
    ) -> None:
        """Runs all units, see ``run_units``; ``on_progress`` is called only for repeated units."""
        with Interrupts(self._on_interrupt) as interrupts, _connection(self._ray, self._address):
            self._warn_if_too_small()
            uploads = _Uploads(self._ray, self._limit)
            submit = self._ray.remote(_run_in_ray_worker).options(num_cpus=self._cpus, num_gpus=self._gpus, max_retries=0)
            _Run(self._ray, submit, uploads, output, on_result, on_progress, self._repeats).run(units, stop, interrupts)
        if interrupts.count:
            raise KeyboardInterrupt

    def _warn_if_too_small(self) -> None:
        for name, required in (("CPU", self._cpus), ("GPU", self._gpus)):
            if all(node["Resources"].get(name, 0.0) < required for node in self._ray.nodes() if node["Alive"]):
                logger.warning(
                    "each unit waits for a machine with %g %s, which the Ray cluster does not have now", required, name
                )


class _Uploads:
    """The files of units in Ray's object store, each content once."""

    def __init__(self, ray: Any, limit_bytes: int) -> None:
        self._ray, self._limit = ray, limit_bytes
        self._contents: dict[str, Any] = {}
        self._known: dict[Path, Any] = {}
        self._size = 0

    def reference(self, path: Path) -> Any:
        """Uploads a file or folder once; returns the reference to its entries and to the references of its contents."""
        path = Path(os.path.abspath(path))
        if path not in self._known:
            digests: dict[str, None] = {}

            def keep(digest: str, content: bytes) -> None:
                digests[digest] = None
                if digest in self._contents:
                    return
                self._size += len(content)
                if self._size > self._limit:
                    raise ConfigError(
                        f"the files of the units have more than {size_text(self._limit)} together, up to {path}; name fewer files, "
                        "or put large ones at the same path on all machines"
                    )
                self._contents[digest] = self._ray.put(content)

            entries = entries_of(Path(path.resolve()), keep, limit_bytes=self._limit)
            self._known[path] = self._ray.put((entries, {digest: self._contents[digest] for digest in digests}))
        return self._known[path]


class _Run:
    """The tasks of one call of ``run``."""

    def __init__(
        self,
        ray: Any,
        submit: Any,
        uploads: _Uploads,
        output: Path,
        on_result: Callable[[UnitResult], None],
        on_progress: Callable[[str, str], None],
        repeats: int,
    ) -> None:
        self._ray, self._remote, self._uploads, self._output = ray, submit, uploads, output
        self._on_result, self._on_progress, self._repeats = on_result, on_progress, repeats
        self._tasks: dict[Any, tuple[Unit, int]] = {}
        """Reference of a task -> its unit and the number of the attempt."""
        self._logs: dict[str, bytes] = {}
        """Id of a unit -> output of all its attempts."""
        self._stopping = False

    def run(self, units: Sequence[Unit], stop: Callable[[], bool], interrupts: Interrupts) -> None:
        """Submits all units and collects their results."""
        deadline = 0.0
        forced = False
        try:
            for unit in units:
                self._submit(unit, 1)
            while self._tasks:
                if not self._stopping and (interrupts.count or stop()):
                    self._stopping, deadline = True, time.monotonic() + 1.5 * GRACE_S
                    interrupts.report(0)
                    self._cancel(force=False)
                if self._stopping and not forced and (time.monotonic() > deadline or interrupts.count > 1):
                    forced = True
                    self._cancel(force=True)
                ready, _ = self._ray.wait(list(self._tasks), num_returns=1, timeout=_PERIOD_S)
                for task in ready:
                    self._collect(task)
        finally:
            self._cancel(force=True)

    def _submit(self, unit: Unit, attempt: int) -> None:
        files = {os.path.abspath(path): [self._uploads.reference(path)] for path in unit.files}
        task = self._remote.remote(__version__, unit.id, unit.function, unit.arguments, files, os.getcwd())
        self._tasks[task] = (unit, attempt)

    def _cancel(self, *, force: bool) -> None:
        for task in self._tasks:
            self._ray.cancel(task, force=force)

    def _collect(self, task: Any) -> None:
        """Collects the result of a task, or submits its unit again."""
        unit, attempt = self._tasks.pop(task)
        errors = self._ray.exceptions
        reply: dict[str, Any] = {}
        try:
            reply = self._ray.get(task)
            result = UnitResult(log=None, **reply["result"])
        except errors.TaskCancelledError:
            result = UnitResult(unit.id, error="stopped", stopped=True)
        except errors.RayTaskError as error:
            result = UnitResult(unit.id, error=_reason(error))
        except errors.RayError as error:
            reason = clipped(str(error).strip().split("\n")[0], 300)
            result = UnitResult(unit.id, error=f"its Ray worker died: {reason}", died=not self._stopping, stopped=self._stopping)
        self._logs[unit.id] = self._logs.pop(unit.id, b"") + reply.get("log", b"")
        if result.died and attempt <= self._repeats and not self._stopping:
            self._on_progress(unit.id, f"{result.error}: repeated")
            self._submit(unit, attempt + 1)
            return
        log = self._output / (unit.id + LOG_SUFFIX)
        printed = self._logs.pop(unit.id)
        if printed:
            write_file(log, printed, durable=False)
        folder = self._output / unit.id
        folder.mkdir()
        unpack(folder, reply.get("entries", ()), reply.get("contents", {}))
        values = {**asdict(result), "attempts": attempt, "log": log if printed else None}
        self._on_result(UnitResult(**values))


_POOL: Pool | None = None
"""In a Ray worker: its worker process, kept for the next units. Both end together."""


def _run_in_ray_worker(
    version: str, name: str, function: str, arguments: Any, files: dict[str, list[Any]], base: str
) -> dict[str, Any]:
    """Runs a unit in a Ray worker; returns its result, log and output files.

    Args:
        version: version of Gibson Sim at the caller.
        name: id of the unit.
        function: function of the unit.
        arguments: arguments of the unit.
        files: path at the caller -> reference of its entries, inside a list so that Ray does not resolve it.
        base: working folder of the caller.
    """
    global _POOL
    host = socket.gethostname()
    if version != __version__:
        raise EnvironmentProblemError(
            f"machine {host} has Gibson Sim {__version__}, the caller {version}: install the same version on all machines"
        )
    ray = _import_ray()
    cache = FileCache(cache_folder("jobs"))
    copies = {}
    for path, (reference,) in files.items():
        entries, contents = ray.get(reference)

        def fetch(digests: list[str], contents: dict[str, Any] = contents) -> Contents:
            return dict(zip(digests, ray.get([contents[digest] for digest in digests]), strict=True))

        copies[path] = str(cache.store(Path(path).name, entries, fetch))
    if _POOL is None:
        _POOL = Pool(1)
    results: list[UnitResult] = []
    with Interrupts() as interrupts, tempfile.TemporaryDirectory(dir=_POOL.folder) as output:
        unit = Unit(name, function, arguments)
        _POOL.run([unit], Path(output), results.append, ignore, never, interrupts, repeats=0, files=copies, base=base)
        (result,) = results
        kept: Contents = {}
        log = result.log.read_bytes()[-MAX_LOG_BYTES:] if result.log else b""
        values = {**asdict(result), "error": f"{result.error} on {host}" if result.died else result.error}
        del values["log"]
        written: tuple[Entry, ...] = ()
        try:
            folder = Path(output) / name
            if folder.is_dir():
                written = entries_of(folder, kept.__setitem__, limit_bytes=MAX_OUTPUT_BYTES, links_may_leave=True)
        except GibsonSimError as error:
            values.update(value=None, error=values["error"] or f"its output cannot be sent back: {error}")
            kept.clear()
        return {"result": values, "log": log, "entries": written, "contents": kept}


def _import_ray() -> Any:
    try:
        import ray
    except ImportError as error:
        raise EnvironmentProblemError("Ray is not installed: pip install 'gibson_sim[ray]'") from error
    return ray


@contextmanager
def _connection(ray: Any, address: str) -> Iterator[None]:
    """Connects this process to a cluster within a block, unless it is already connected."""
    if ray.is_initialized():
        yield
        return
    main = threading.current_thread() is threading.main_thread()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)} if main else {}
    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise EnvironmentProblemError(
            f"no Ray cluster at {quoted(address)}: {clipped(str(error), 200)}; start one with `ray start --head`, and set RAY_AUTH_TOKEN "
            "if it requires a token"
        ) from error
    finally:
        for number, handler in handlers.items():  # Ray replaces them
            signal.signal(number, handler)
    try:
        yield
    finally:
        ray.shutdown()


def _reason(error: Exception) -> str:
    """Returns one line about an exception of a Ray task that a unit's function did not raise."""
    cause = getattr(error, "cause", None)
    if isinstance(cause, GibsonSimError):
        return str(cause)
    if isinstance(cause, ModuleNotFoundError) and (cause.name or "").partition(".")[0] == "gibson_sim":
        return "the Python of the Ray cluster has no gibson_sim: install it on all machines"
    return clipped(f"the Ray task failed: {cause or error}", 500)
