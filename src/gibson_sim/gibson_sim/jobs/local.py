"""Execution of units in worker processes of this machine: ``LocalWorkers`` and its ``Pool`` of processes."""

from __future__ import annotations

import json
import os
import selectors
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any
from uuid import uuid4

from gibson_sim.errors import ConfigError
from gibson_sim.interrupts import held_back
from gibson_sim.jobs.units import LOG_SUFFIX, REPEATS, Unit, UnitResult, ignore
from gibson_sim.processes.descendants import Janitor, end_marked, with_mark
from gibson_sim.writing import cannot_write, write_file

MAX_WORKERS = 256
GRACE_S = 20.0
"""Wall time that running units have to end after a request to stop, seconds."""
_PERIOD_S = 0.1
"""Polling period of ``stop`` and of the state of the workers, seconds of wall time."""
_EXIT_PERIOD_S = 0.005


class LocalWorkers:
    """Worker processes of this machine: each is a Python process that runs many units, so that imports and loading happen once.

    Args:
        count: number of processes.
        bind: whether each process is bound to its share of the cores; results do not depend on it.
        repeats: number of repetitions of a unit whose worker died.
        on_interrupt: called at the first Ctrl-C with the number of running units, before they are ended.

    Raises:
        ConfigError: the count is not allowed.
    """

    def __init__(
        self, count: int, *, bind: bool = False, repeats: int = REPEATS, on_interrupt: Callable[[int], None] = ignore
    ) -> None:
        if not 1 <= count <= MAX_WORKERS:
            raise ConfigError(f"the number of workers is {count}, must be from 1 to {MAX_WORKERS}")
        self._count, self._bind, self._repeats, self._on_interrupt = count, bind, repeats, on_interrupt

    def run(
        self,
        units: Sequence[Unit],
        output: Path,
        on_result: Callable[[UnitResult], None],
        on_progress: Callable[[str, str], None],
        stop: Callable[[], bool],
    ) -> None:
        """Runs all units, see ``run_units``."""
        with Interrupts(self._on_interrupt) as interrupts:
            pool = Pool(min(self._count, len(units)), bind=self._bind)
            try:
                pool.run(units, output, on_result, on_progress, stop, interrupts, repeats=self._repeats)
            finally:
                pool.close(interrupts)
        if interrupts.count:
            raise KeyboardInterrupt


def core_shares(cores: Sequence[int], count: int) -> list[list[int]]:
    """Returns the cores of each of ``count`` workers: equal blocks of neighbours; shared if there are fewer cores than workers."""
    if len(cores) < count:
        return [[cores[k % len(cores)]] for k in range(count)]
    return [list(cores[k * len(cores) // count : (k + 1) * len(cores) // count]) for k in range(count)]


class _Task:
    """A unit with its state in the pool."""

    def __init__(self, unit: Unit, output: Path, files: Mapping[str, str], base: str) -> None:
        self.unit, self.files, self.base = unit, files, base
        self.folder, self.log = output / unit.id, output / (unit.id + LOG_SUFFIX)
        self.attempts, self.began = 0, 0.0

    def prepare(self) -> None:
        """Creates an empty folder for the unit, without the files of an earlier attempt.

        Raises:
            WriteError: the folder cannot be created.
        """
        try:
            if self.folder.exists():
                shutil.rmtree(self.folder)
            self.folder.mkdir()
        except OSError as error:
            raise cannot_write(self.folder, error) from error

    def result(self, **values: Any) -> UnitResult:
        """Returns the result of the unit; removes an empty log."""
        if self.log.exists() and not self.log.stat().st_size:
            self.log.unlink()
        seconds = time.monotonic() - self.began if self.attempts else 0.0
        log = self.log if self.log.exists() else None
        return UnitResult(self.unit.id, attempts=self.attempts, log=log, seconds=seconds, **values)


class _Worker:
    """A worker process with its current unit."""

    def __init__(self, mark: str, folder: Path, cores: Sequence[int]) -> None:
        self.mark, self._folder, self._cores = f"{mark}.{uuid4().hex[:8]}", folder, cores
        self.task: _Task | None = None
        self._unread = b""
        requests, self._requests = os.pipe()
        self.answers, answers = os.pipe()
        os.set_blocking(self.answers, False)
        arguments = (str(requests), str(answers), ",".join(map(str, cores)))
        try:
            # Marks of the pool and of this worker: either finds the processes that the worker started.
            environment = with_mark(with_mark(os.environ, mark), self.mark)
            with held_back():
                self.process = subprocess.Popen(
                    [sys.executable, "-u", "-m", "gibson_sim.jobs.worker", *arguments],
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    start_new_session=True,
                    pass_fds=(requests, answers),
                )
        except BaseException:
            os.close(self._requests)
            os.close(self.answers)
            raise
        finally:
            os.close(requests)
            os.close(answers)

    def start(self, task: _Task) -> None:
        """Starts a unit."""
        task.prepare()
        task.attempts += 1
        task.began = time.monotonic()
        self.task = task
        values = {
            "function": task.unit.function,
            "arguments": task.unit.arguments,
            "folder": str(task.folder.absolute()),
            "log": str(task.log.absolute()),
            "files": dict(task.files),
            "base": task.base,
            "result": str(self._result),
        }
        self._result.unlink(missing_ok=True)
        file = self._folder / f"{self.mark}.unit.json"
        write_file(file, json.dumps(values), durable=False)
        try:
            os.write(self._requests, json.dumps(str(file)).encode() + b"\n")
        except BrokenPipeError:
            return  # the worker has died, which the next poll detects

    @property
    def _result(self) -> Path:
        return self._folder / f"{self.mark}.result.json"

    def read(self) -> list[dict[str, Any]]:
        """Returns the messages that have arrived."""
        while True:
            try:
                data = os.read(self.answers, 1 << 16)
            except BlockingIOError:
                break
            if not data:
                break
            self._unread += data
        *lines, self._unread = self._unread.split(b"\n")
        return [json.loads(line) for line in lines]

    def read_result(self) -> dict[str, Any]:
        """Returns the result of the unit that has ended, see ``worker.call``."""
        result: dict[str, Any] = json.loads(self._result.read_text(encoding="utf-8"))
        return result

    def close_requests(self) -> None:
        """Requests the unit to stop and the process to end after it; a second call does nothing."""
        if self._requests >= 0:
            os.close(self._requests)
            self._requests = -1

    def end(self) -> None:
        """Ends the process and all processes that it started, and closes its pipes."""
        self.close_requests()
        end_marked(self.mark)
        self.process.wait()
        os.close(self.answers)


class Pool:
    """Worker processes that persist between calls of ``run``. Must be closed."""

    def __init__(self, count: int, *, bind: bool = False) -> None:
        """``count``: number of processes, started with the first units; ``bind``: whether each is bound to its share of the cores."""
        self._mark = uuid4().hex
        self.folder = Path(tempfile.mkdtemp(prefix="gibson-sim-units-"))
        """Folder for temporary files; removed when the pool is closed or this process ends for any reason."""
        self._janitor = Janitor(self._mark, self.folder)
        self._cores = core_shares(sorted(os.sched_getaffinity(0)), count) if bind else [[]] * count
        self._workers: list[_Worker | None] = [None] * count
        self._selector = selectors.DefaultSelector()

    def run(
        self,
        units: Sequence[Unit],
        output: Path,
        on_result: Callable[[UnitResult], None],
        on_progress: Callable[[str, str], None],
        stop: Callable[[], bool],
        interrupts: Interrupts,
        *,
        repeats: int = REPEATS,
        files: Mapping[str, str] | None = None,
        base: str = "",
    ) -> None:
        """Runs units, see ``run_units``.

        Args:
            units: units with different ids.
            output: folder of the outputs.
            on_result: receives each result.
            on_progress: receives the id of a unit and its progress text.
            stop: returns whether to end.
            interrupts: the first one has the effect of ``stop``; the second one ends the units without waiting.
            repeats: number of repetitions of a unit whose worker died.
            files: path at the caller -> path on this machine; None = the same paths.
            base: working folder of the caller; empty = that of this process.
        """
        waiting = deque(_Task(unit, output, _in_place(unit) if files is None else files, base or os.getcwd()) for unit in units)
        deadline: float | None = None
        """Time at which units that were requested to stop are ended, s, monotonic clock."""
        while waiting or any(worker.task for worker in self._running()):
            if deadline is None and (interrupts.count or stop()):
                deadline = time.monotonic() + GRACE_S
                interrupts.report(sum(worker.task is not None for worker in self._running()))
                for worker in self._running():
                    worker.close_requests()
                while waiting:
                    on_result(waiting.popleft().result(error="stopped before it began", stopped=True))
            if deadline is None:
                self._assign(waiting)
            for key, _ in self._selector.select(_PERIOD_S):
                _handle_messages(key.data, on_result, on_progress)
            for worker in self._running():
                if worker.process.poll() is not None:
                    _handle_messages(worker, on_result, on_progress)  # messages sent before its end
                    reason = f"its worker {_exit_text(worker.process.returncode)}"
                    task = self._remove(worker)
                    if task is not None and deadline is None and task.attempts <= repeats:
                        on_progress(task.unit.id, f"{reason}: repeated")
                        waiting.appendleft(task)
                    elif task is not None:
                        on_result(task.result(error=reason, stopped=deadline is not None, died=deadline is None))
            if deadline is not None and (time.monotonic() > deadline or interrupts.count > 1):
                for task in self._remove_all():
                    on_result(task.result(error="stopped, and killed since it did not end", stopped=True))

    def close(self, interrupts: Interrupts) -> None:
        """Ends all processes; a second call does nothing. Workers may run their exit handlers unless an interrupt arrives."""
        for worker in self._running():
            worker.close_requests()
        deadline, initial_count = time.monotonic() + GRACE_S, interrupts.count
        while self._running() and time.monotonic() < deadline and interrupts.count == initial_count:
            for worker in self._running():
                if worker.process.poll() is not None:
                    self._remove(worker)
            time.sleep(_EXIT_PERIOD_S)
        self._remove_all()
        self._selector.close()
        self._janitor.close()

    def _running(self) -> list[_Worker]:
        return [worker for worker in self._workers if worker is not None]

    def _assign(self, waiting: deque[_Task]) -> None:
        """Assigns units to idle workers and starts missing workers."""
        for k in range(len(self._workers)):
            if not waiting:
                return
            worker = self._workers[k]
            if worker is None:
                worker = self._workers[k] = _Worker(self._mark, self.folder, self._cores[k])
                self._selector.register(worker.answers, selectors.EVENT_READ, worker)
            if worker.task is None:
                worker.start(waiting.popleft())

    def _remove(self, worker: _Worker) -> _Task | None:
        """Ends a worker and all processes that it started; returns its unit."""
        self._selector.unregister(worker.answers)
        self._workers[self._workers.index(worker)] = None
        worker.end()
        return worker.task

    def _remove_all(self) -> list[_Task]:
        """Ends all workers and all processes that they started; returns their units."""
        end_marked(self._mark)
        tasks = [self._remove(worker) for worker in self._running()]
        return [task for task in tasks if task is not None]


class Interrupts:
    """Counts Ctrl-C (SIGINT) within a block instead of raising KeyboardInterrupt, which would interrupt the bookkeeping of processes."""

    def __init__(self, on_interrupt: Callable[[int], None] = ignore) -> None:
        """``on_interrupt``: see ``report``."""
        self.count = 0
        self._previous_handler: Any = None
        self._on_interrupt = on_interrupt

    def report(self, running: int) -> None:
        """Calls ``on_interrupt`` if an interrupt has arrived. ``running``: number of running units; 0 = unknown."""
        if self.count:
            self._on_interrupt(running)

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            self._previous_handler = signal.signal(signal.SIGINT, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        if self._previous_handler is not None:
            signal.signal(signal.SIGINT, self._previous_handler)

    def _on_signal(self, number: int, frame: object) -> None:
        self.count += 1


def _in_place(unit: Unit) -> dict[str, str]:
    return {path: path for path in (os.path.abspath(file) for file in unit.files)}


def _handle_messages(worker: _Worker, on_result: Callable[[UnitResult], None], on_progress: Callable[[str, str], None]) -> None:
    """Handles the messages of a worker that have arrived."""
    for message in worker.read():
        task = worker.task
        if task is None:  # progress from a thread that an earlier unit left running
            continue
        if "progress" in message:
            on_progress(task.unit.id, message["progress"])
        else:
            values = worker.read_result()
            worker.task = None
            on_result(task.result(**values))


def _exit_text(code: int) -> str:
    """Returns a description of an exit code; negative = the signal."""
    if code >= 0:
        return f"ended with code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:  # real-time signals have no name
        name = f"signal {-code}"
    return f"was killed by {name}" + (" (out of memory?)" if -code == signal.SIGKILL else "")
