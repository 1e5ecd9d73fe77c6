"""Renderers in processes of their own, one command at a time over a pipe: OpenGL of several libraries does not mix in one process.

Imports the standard library only, so that it runs in any Python that has a peer installed.
"""

from __future__ import annotations

import os
import pickle
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol

from gibson_sim_tools import package_path

if TYPE_CHECKING:
    Matrix = Sequence[float]
    """T_world_camera (optical frame), 16 numbers by rows."""
else:
    Matrix = Any  # Python 3.8, which some peers need, cannot subscript the type


class WorkerError(Exception):
    """A command to a worker failed; one line says why."""


class Engine(Protocol):
    """A renderer that has loaded its scene."""

    info: dict[str, str]
    """Name and version of the library and of the device."""

    def prepare(self, width: int, height: int, fov_y: float, outputs: tuple[str, ...]) -> None:
        """Prepares for images of a size, pixels, and a vertical field of view, radians, with these outputs."""

    def draw(self, pose: Matrix) -> Any:
        """Draws an image, and returns all its outputs as host arrays."""

    def picture(self, drawn: Any) -> tuple[bytes, int, int]:
        """Returns RGB bytes, height and width of what ``draw`` returned, row 0 = top."""

    def triangles(self) -> int:
        """Returns the number of triangles drawn for the last image; 0 = unknown."""


class Worker:
    """A renderer in a process of its own, seen from the caller. Use it in a ``with`` statement, which ends the process.

    Args:
        module: run with ``python -m``; calls ``serve``.
        python: the interpreter; empty = this one.
        environment: additional environment variables.

    Raises:
        WorkerError: the interpreter cannot be run.
    """

    def __init__(self, module: str, python: str = "", environment: Mapping[str, str] | None = None) -> None:
        ours = (str(Path(__file__).resolve().parents[1]), package_path())
        path = os.pathsep.join(p for p in (*ours, os.environ.get("PYTHONPATH", "") if not python else "") if p)
        try:
            self._process = subprocess.Popen(
                [python or sys.executable, "-m", module],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **(environment or {}), "PYTHONPATH": path},
            )
        except OSError as error:
            raise WorkerError(f"{python or sys.executable} cannot be run: {error.strerror}") from error

    def ask(self, command: str, **values: Any) -> Any:
        """Returns the answer to a command.

        Raises:
            WorkerError: the command failed, or the process has ended.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            _send(self._process.stdin, (command, values))
            good, answer = _receive(self._process.stdout)
        except (OSError, EOFError) as error:
            code = self._process.wait()
            raise WorkerError(f"its process ended with code {code} at the command {command!r}") from error
        if not good:
            raise WorkerError(str(answer))
        return answer

    def close(self) -> None:
        """Ends the process."""
        if self._process.stdin is not None and not self._process.stdin.closed:
            self._process.stdin.close()
        try:
            self._process.wait(timeout=20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def serve(engines: Mapping[str, Callable[..., Engine]]) -> None:
    """Runs in the worker: executes commands until the pipe is closed."""
    commands, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # Output of libraries must not mix with the answers.
    os.dup2(2, 1)
    engine: Engine | None = None
    with commands, answers:
        while True:
            try:
                command, values = _receive(commands)
            except EOFError:
                break
            try:
                if command == "open":
                    engine = engines[values.pop("engine")](**values)
                    answer: Any = engine.info
                else:
                    assert engine is not None
                    answer = _execute(engine, command, **values)
            except Exception as error:  # of a foreign library, whatever it is: the caller reports it
                text = " ".join(str(error).split())[:300]
                _send(answers, (False, f"{type(error).__name__}: {text}" if text else type(error).__name__))
            else:
                _send(answers, (True, answer))
    # Some libraries crash in their destructors.
    os._exit(0)


def _execute(
    engine: Engine, command: str, width: int, height: int, fov_y: float, outputs: Sequence[str], poses: list[Matrix]
) -> Any:
    engine.prepare(width, height, fov_y, tuple(outputs))
    if command == "picture":
        return engine.picture(engine.draw(poses[0]))
    assert command == "frames"
    seconds, triangles = [], []
    # Another contestant has just used the processor and its caches.
    engine.draw(poses[0])
    for pose in poses:
        started = time.perf_counter()
        drawn = engine.draw(pose)
        seconds.append(time.perf_counter() - started)
        triangles.append(engine.triangles())
        del drawn
    return seconds, triangles


def _send(pipe: BinaryIO | Any, message: Any) -> None:
    data = pickle.dumps(message)
    pipe.write(struct.pack("<Q", len(data)) + data)
    pipe.flush()


def _receive(pipe: BinaryIO | Any) -> Any:
    (size,) = struct.unpack("<Q", _exactly(pipe, 8))
    return pickle.loads(_exactly(pipe, size))


def _exactly(pipe: BinaryIO | Any, size: int) -> bytes:
    data: bytes = pipe.read(size)
    if len(data) < size:
        raise EOFError
    return data
