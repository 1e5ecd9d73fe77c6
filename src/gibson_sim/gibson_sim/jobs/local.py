"""Units on worker processes of this machine: ``LocalWorkers``, and the ``Pool`` of processes behind it."""

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
"""Wall time that running units have to end once they are told to, seconds."""
_PERIOD_S = 0.1
"""Wall time between two looks at ``stop`` and at the health of the workers, seconds."""
_EXIT_PERIOD_S = 0.005


class LocalWorkers:
    """Worker processes of this machine: each a Python of its own that runs unit after unit, so that it imports and loads once.

    Args:
        count: number of processes.
        bind: whether each may use its share of the cores alone; results do not depend on it.
        repeats: how often a unit is repeated whose worker died.
        on_interrupt: called at the first Ctrl-C with the number of units that run, before they are ended.

    Raises:
        ConfigError: the count is impossible.
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


def shares(cores: Sequence[int], count: int) -> list[list[int]]:
    """Returns the cores of each of ``count`` workers: neighbours, as many for each as there are; shared if there are fewer than workers."""
    if len(cores) < count:
        return [[cores[k % len(cores)]] for k in range(count)]
    return [list(cores[k * len(cores) // count : (k + 1) * len(cores) // count]) for k in range(count)]


class _Task:
    """A unit on its way through the pool."""

    def __init__(self, unit: Unit, output: Path, files: Mapping[str, str], base: str) -> None:
        self.unit, self.files, self.base = unit, files, base
        self.folder, self.log = output / unit.id, output / (unit.id + LOG_SUFFIX)
        self.attempts, self.began = 0, 0.0

    def prepare(self) -> None:
        """Makes its folder anew, without what an attempt that died left there.

        Raises:
            WriteError: that is impossible.
        """
        try:
            if self.folder.exists():
                shutil.rmtree(self.folder)
            self.folder.mkdir()
        except OSError as error:
            raise cannot_write(self.folder, error) from error

    def result(self, **values: Any) -> UnitResult:
        """Returns its result; removes an empty log."""
        if self.log.exists() and not self.log.stat().st_size:
            self.log.unlink()
        seconds = time.monotonic() - self.began if self.attempts else 0.0
        log = self.log if self.log.exists() else None
        return UnitResult(self.unit.id, attempts=self.attempts, log=log, seconds=seconds, **values)


class _Worker:
    """One worker process, with the unit that it runs."""

    def __init__(self, mark: str, folder: Path, cores: Sequence[int]) -> None:
        self.mark, self._folder, self._cores = f"{mark}.{uuid4().hex[:8]}", folder, cores
        self.task: _Task | None = None
        self._unread = b""
        requests, self._requests = os.pipe()
        self.answers, answers = os.pipe()
        os.set_blocking(self.answers, False)
        arguments = (str(requests), str(answers), ",".join(map(str, cores)))
        try:
            # A mark for this worker, after the mark of the pool: either finds what it started.
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

    def give(self, task: _Task) -> None:
        """Begins a unit."""
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
            return  # it has died, which is found with the next look

    @property
    def _result(self) -> Path:
        return self._folder / f"{self.mark}.result.json"

    def read(self) -> list[dict[str, Any]]:
        """Returns the messages that have come."""
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

    def finished(self) -> dict[str, Any]:
        """Returns what the function of the ended unit returned, see ``worker.call``."""
        found: dict[str, Any] = json.loads(self._result.read_text(encoding="utf-8"))
        return found

    def close_requests(self) -> None:
        """Tells the unit to stop, and the process to end then; a second call does nothing."""
        if self._requests >= 0:
            os.close(self._requests)
            self._requests = -1

    def end(self) -> None:
        """Ends the process and all that it started, and frees its pipes."""
        self.close_requests()
        end_marked(self.mark)
        self.process.wait()
        os.close(self.answers)


class Pool:
    """Worker processes that stay from one call of ``run`` to the next. Close it."""

    def __init__(self, count: int, *, bind: bool = False) -> None:
        """``count``: number of processes; ``bind``: whether each has its share of the cores; they start with the first units."""
        self._mark = uuid4().hex
        self.folder = Path(tempfile.mkdtemp(prefix="gibson-sim-units-"))
        """For temporary files; it is removed once this process closes the pool or ends, however it ends."""
        self._janitor = Janitor(self._mark, self.folder)
        self._cores = shares(sorted(os.sched_getaffinity(0)), count) if bind else [[]] * count
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
            units: with different ids.
            output: folder of their outputs.
            on_result: receives each result.
            on_progress: receives ids and texts.
            stop: whether to end.
            interrupts: the first one ends as ``stop`` does; a second one does not wait.
            repeats: how often a unit is repeated whose worker died.
            files: path at the caller -> path here; None = they are where the units say.
            base: folder that the caller works in; empty = that of this process.
        """
        waiting = deque(_Task(unit, output, _in_place(unit) if files is None else files, base or os.getcwd()) for unit in units)
        deadline: float | None = None
        """When units that were told to stop are ended, monotonic clock."""
        while waiting or any(worker.task for worker in self._running()):
            if deadline is None and (interrupts.count or stop()):
                deadline = time.monotonic() + GRACE_S
                interrupts.tell(sum(worker.task is not None for worker in self._running()))
                for worker in self._running():
                    worker.close_requests()
                while waiting:
                    on_result(waiting.popleft().result(error="stopped before it began", stopped=True))
            if deadline is None:
                self._give(waiting)
            for key, _ in self._selector.select(_PERIOD_S):
                _take(key.data, on_result, on_progress)
            for worker in self._running():
                if worker.process.poll() is not None:
                    _take(worker, on_result, on_progress)  # what it sent before
                    reason = f"its worker {_ending(worker.process.returncode)}"
                    task = self._bury(worker)
                    if task is not None and deadline is None and task.attempts <= repeats:
                        on_progress(task.unit.id, f"{reason}: repeated")
                        waiting.appendleft(task)
                    elif task is not None:
                        on_result(task.result(error=reason, stopped=deadline is not None, died=deadline is None))
            if deadline is not None and (time.monotonic() > deadline or interrupts.count > 1):
                for task in self._bury_all():
                    on_result(task.result(error="stopped, and ended since it went on", stopped=True))

    def close(self, interrupts: Interrupts) -> None:
        """Ends all processes; a second call does nothing. A worker may finish what it does at its exit, unless there is an interrupt."""
        for worker in self._running():
            worker.close_requests()
        deadline, asked = time.monotonic() + GRACE_S, interrupts.count
        while self._running() and time.monotonic() < deadline and interrupts.count == asked:
            for worker in self._running():
                if worker.process.poll() is not None:
                    self._bury(worker)
            time.sleep(_EXIT_PERIOD_S)
        self._bury_all()
        self._selector.close()
        self._janitor.close()

    def _running(self) -> list[_Worker]:
        return [worker for worker in self._workers if worker is not None]

    def _give(self, waiting: deque[_Task]) -> None:
        """Gives units to workers that have none, and starts missing workers."""
        for k in range(len(self._workers)):
            if not waiting:
                return
            worker = self._workers[k]
            if worker is None:
                worker = self._workers[k] = _Worker(self._mark, self.folder, self._cores[k])
                self._selector.register(worker.answers, selectors.EVENT_READ, worker)
            if worker.task is None:
                worker.give(waiting.popleft())

    def _bury(self, worker: _Worker) -> _Task | None:
        """Ends a worker and all that it started; returns the unit that it had."""
        self._selector.unregister(worker.answers)
        self._workers[self._workers.index(worker)] = None
        worker.end()
        return worker.task

    def _bury_all(self) -> list[_Task]:
        """Ends all workers and all that they started; returns the units that they had."""
        end_marked(self._mark)
        tasks = [self._bury(worker) for worker in self._running()]
        return [task for task in tasks if task is not None]


class Interrupts:
    """Counts Ctrl-C (SIGINT) in a block, in place of KeyboardInterrupt, which would break off what keeps account of processes."""

    def __init__(self, on_interrupt: Callable[[int], None] = ignore) -> None:
        """``on_interrupt``: see ``tell``."""
        self.count = 0
        self._before: Any = None
        self._on_interrupt = on_interrupt

    def tell(self, running: int) -> None:
        """Tells that work ends because of an interrupt, if it does. ``running``: number of units that run; 0 = not known."""
        if self.count:
            self._on_interrupt(running)

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            self._before = signal.signal(signal.SIGINT, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _on_signal(self, number: int, frame: object) -> None:
        self.count += 1


def _in_place(unit: Unit) -> dict[str, str]:
    return {place: place for place in (os.path.abspath(path) for path in unit.files)}


def _take(worker: _Worker, on_result: Callable[[UnitResult], None], on_progress: Callable[[str, str], None]) -> None:
    """Handles the messages of a worker that have come."""
    for message in worker.read():
        task = worker.task
        if task is None:  # a thread that the last unit left reports progress
            continue
        if "progress" in message:
            on_progress(task.unit.id, message["progress"])
        else:
            found = worker.finished()
            worker.task = None
            on_result(task.result(**found))


def _ending(code: int) -> str:
    """Returns how a process ended, from its exit code, negative for a signal."""
    if code >= 0:
        return f"ended with code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:  # real-time signals have none
        name = f"signal {-code}"
    return f"was killed by {name}" + (" (has the memory run out?)" if -code == signal.SIGKILL else "")
