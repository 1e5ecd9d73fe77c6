"""Runs each renderer in its own process, with one command at a time over a pipe: OpenGL of several libraries does not mix in one process.

Imports the standard library only, so that it runs in any Python that has a third-party renderer installed.
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
    """T_world_camera (optical frame), 16 numbers in row-major order."""
else:
    Matrix = Any  # Python 3.8, which some renderers need, cannot subscript the type


class WorkerError(Exception):
    """A command to a worker failed; the message is one line."""


class BenchRenderer(Protocol):
    """A renderer that has loaded its scene."""

    info: dict[str, str]
    """Name and version of the library and of the device."""

    def prepare(self, width: int, height: int, fov_y: float, outputs: tuple[str, ...]) -> None:
        """Prepares for images of a size, pixels, and a vertical field of view, radians, with these outputs."""

    def render(self, pose: Matrix) -> Any:
        """Renders an image, and returns all its outputs as host arrays."""

    def rgb_image(self, rendered: Any) -> tuple[bytes, int, int]:
        """Returns RGB bytes, height and width, pixels, of what ``render`` returned; row 0 is the top."""

    def triangles(self) -> int:
        """Returns the number of triangles drawn for the last image; 0 = unknown."""


class Worker:
    """A renderer in its own process, as the parent process sees it. Use it in a ``with`` statement, which ends the process.

    Args:
        module: module that ``python -m`` runs; it calls ``serve``.
        python: path of the interpreter; empty = this one.
        environment: additional environment variables.

    Raises:
        WorkerError: the interpreter cannot be run.
    """

    def __init__(self, module: str, python: str = "", environment: Mapping[str, str] | None = None) -> None:
        own_paths = (str(Path(__file__).resolve().parents[1]), package_path())
        path = os.pathsep.join(p for p in (*own_paths, os.environ.get("PYTHONPATH", "") if not python else "") if p)
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

    def request(self, command: str, **values: Any) -> Any:
        """Sends a command, and returns its response.

        Raises:
            WorkerError: the command failed, or the process has ended.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            _send(self._process.stdin, (command, values))
            succeeded, response = _receive(self._process.stdout)
        except (OSError, EOFError) as error:
            code = self._process.wait()
            raise WorkerError(f"its process ended with code {code} at the command {command!r}") from error
        if not succeeded:
            raise WorkerError(str(response))
        return response

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


def serve(renderers: Mapping[str, Callable[..., BenchRenderer]]) -> None:
    """Runs in the worker process: executes commands until the pipe is closed.

    Args:
        renderers: constructors, by the name that the command ``open`` gives.
    """
    commands, responses = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # Output of libraries must not mix with the responses.
    os.dup2(2, 1)
    renderer: BenchRenderer | None = None
    with commands, responses:
        while True:
            try:
                command, values = _receive(commands)
            except EOFError:
                break
            try:
                if command == "open":
                    renderer = renderers[values.pop("renderer")](**values)
                    response: Any = renderer.info
                else:
                    assert renderer is not None
                    response = _execute(renderer, command, **values)
            except Exception as error:  # any error of a third-party library: the parent process reports it
                text = " ".join(str(error).split())[:300]
                _send(responses, (False, f"{type(error).__name__}: {text}" if text else type(error).__name__))
            else:
                _send(responses, (True, response))
    # Some libraries crash in their destructors.
    os._exit(0)


def _execute(
    renderer: BenchRenderer, command: str, width: int, height: int, fov_y: float, outputs: Sequence[str], poses: list[Matrix]
) -> Any:
    renderer.prepare(width, height, fov_y, tuple(outputs))
    if command == "image":
        return renderer.rgb_image(renderer.render(poses[0]))
    assert command == "frames"
    seconds, triangles = [], []
    # Warms the CPU caches, which another renderer has just used.
    renderer.render(poses[0])
    for pose in poses:
        started = time.perf_counter()
        rendered = renderer.render(pose)
        seconds.append(time.perf_counter() - started)
        triangles.append(renderer.triangles())
        del rendered
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
