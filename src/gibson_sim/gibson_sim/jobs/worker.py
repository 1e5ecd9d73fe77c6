"""The program of a worker process: ``python -m gibson_sim.jobs.worker REQUESTS ANSWERS CORES``; runs units until its pipe is closed.

REQUESTS and ANSWERS are descriptors of pipes with one line of JSON per message. Units and results pass through files, so that no message
exceeds the capacity of a pipe. Standard output and error of a unit go to its log.
"""

from __future__ import annotations

import faulthandler
import json
import os
import queue
import sys
import threading
import traceback
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from gibson_sim.errors import GibsonSimError, missing_package
from gibson_sim.quoting import clipped, quoted
from gibson_sim.writing import write_file

_MAX_LENGTH = 500
"""Largest length of a progress line, characters."""


class WorkerContext:
    """Context of a unit's function, see ``units.Context``."""

    def __init__(
        self, stopping: threading.Event, send: Callable[[dict[str, Any]], None], files: dict[str, str], base: str
    ) -> None:
        """``files``: path at the caller -> path on this machine; ``base``: the caller's folder, to which relative paths refer."""
        self._stopping, self._send, self._files, self._base = stopping, send, files, base

    def stop(self) -> bool:
        """Returns whether the unit must end early."""
        return self._stopping.is_set()

    def progress(self, text: str) -> None:
        """Sends one line about the unit."""
        self._send({"progress": clipped(text, _MAX_LENGTH)})

    def path(self, path: str | Path) -> Path:
        """Returns the path of a file of the unit on this machine."""
        absolute = Path(os.path.normpath(os.path.join(self._base, path)))
        for original, copy in self._files.items():
            if absolute == Path(original) or Path(original) in absolute.parents:
                return Path(copy) / absolute.relative_to(original)
        raise GibsonSimError(f"{quoted(str(path))} is not among the unit's files: {', '.join(self._files) or 'it has none'}")


class _Requests:
    """Reads the requests in a thread, so that the request to stop arrives while a unit runs."""

    def __init__(self, descriptor: int) -> None:
        self._units: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self.stopping = threading.Event()
        """Set when the caller requests an end or has ended."""
        threading.Thread(target=self._read, args=(descriptor,), daemon=True).start()

    def _read(self, descriptor: int) -> None:
        with open(descriptor, encoding="utf-8") as file:
            for line in file:
                self._units.put(json.loads(line))
        self.stopping.set()
        self._units.put(None)

    def next(self) -> str | None:
        """Returns the file of the next unit; None = no further units."""
        return self._units.get()


def call(function: str, arguments: Any, folder: Path, context: WorkerContext) -> dict[str, Any]:
    """Calls a unit's function; returns ``{"value": ...}``, or ``{"error": ...}`` with one line; the traceback goes to standard error."""
    module, _, name = function.partition(":")
    try:
        value = getattr(import_module(module), name)(arguments, folder, context)
        try:
            json.dumps(value)
        except (TypeError, ValueError, RecursionError) as error:
            raise GibsonSimError(f"{function} returned a value that is not JSON: {error}") from error
        return {"value": value}
    except GibsonSimError as error:
        return {"error": str(error)}
    except BaseException as error:
        traceback.print_exc()
        is_unit_module = isinstance(error, ImportError) and module.startswith(error.name or module)
        missing = missing_package(error) if isinstance(error, ImportError) and not is_unit_module else None
        return {"error": str(missing) if missing else clipped(traceback.format_exception_only(error)[-1].strip(), _MAX_LENGTH)}


def _redirect_output(path: str) -> None:
    """Redirects standard output and error to a file, including those of compiled code and of child processes."""
    sys.stdout.flush()
    sys.stderr.flush()
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    os.close(descriptor)


def main() -> None:
    """Runs units until the pipe of requests is closed."""
    requests, answers = int(sys.argv[1]), int(sys.argv[2])
    for descriptor in (requests, answers):
        os.set_inheritable(descriptor, False)
    if sys.argv[3]:
        os.sched_setaffinity(0, [int(core) for core in sys.argv[3].split(",")])
    faulthandler.enable()
    incoming = _Requests(requests)
    sending = threading.Lock()

    def send(message: dict[str, Any]) -> None:
        with sending:
            try:
                os.write(answers, json.dumps(message).encode() + b"\n")
            except BrokenPipeError:  # the caller has ended, and this process is about to end
                incoming.stopping.set()

    while (file := incoming.next()) is not None:
        unit = json.loads(Path(file).read_text(encoding="utf-8"))
        _redirect_output(unit["log"])
        context = WorkerContext(incoming.stopping, send, unit["files"], unit["base"])
        result = call(unit["function"], unit["arguments"], Path(unit["folder"]), context)
        _redirect_output(os.devnull)
        write_file(unit["result"], json.dumps(result), durable=False)
        send({"done": True})


if __name__ == "__main__":
    main()
