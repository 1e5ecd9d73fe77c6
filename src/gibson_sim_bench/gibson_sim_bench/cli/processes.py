"""Processes of measurements: simulations, and the roles of ``gibson_sim_bench.roles``."""

from __future__ import annotations

import json
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import IO, Any

from gibson_sim.errors import GibsonSimError

PATIENCE_S = 120.0
"""Time beyond the expected one after which a process is given up, seconds."""
CAMERA = "camera"


class BenchError(GibsonSimError):
    """A scenario failed."""


def _command(role: str, options: Mapping[str, Any]) -> list[str]:
    return [sys.executable, "-m", "gibson_sim_bench.roles", role, json.dumps(options)]


@contextmanager
def role(environment: Mapping[str, str], role: str, **options: Any) -> Iterator[None]:
    """Runs a role in a process of its own inside the block."""
    with process(_command(role, options), environment):
        yield


@contextmanager
def process(command: list[str], environment: Mapping[str, str]) -> Iterator[int]:
    """Runs a process inside the block, and yields its id; its output is shown only if the block fails."""
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as output:
        running = subprocess.Popen(command, env=dict(environment), stdin=subprocess.DEVNULL, stdout=output, stderr=output)
        try:
            yield running.pid
        except BenchError as error:
            code = running.poll()
            output.seek(0)
            how = "runs" if code is None else f"ended with code {code}"
            raise BenchError(f"{error}; the other process {how}: {_last_line(output.read())}") from error
        finally:
            _end(running)


def _end(process: subprocess.Popen[Any]) -> None:
    for number, seconds in ((signal.SIGINT, 20.0), (signal.SIGKILL, 10.0)):
        if process.poll() is None:
            process.send_signal(number)
        try:
            process.wait(seconds)
            return
        except subprocess.TimeoutExpired:
            continue


def answer(environment: Mapping[str, str], role: str, expected_s: float, **options: Any) -> dict[str, Any]:
    """Returns the answer of a role that ends by itself.

    Raises:
        BenchError: there is none, or the role took too long.
    """
    try:
        done = subprocess.run(
            _command(role, options),
            env=dict(environment),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=expected_s + PATIENCE_S,
        )
    except subprocess.TimeoutExpired:
        raise BenchError(f"the {role} process was still at it after {expected_s + PATIENCE_S:.0f} s") from None
    lines = done.stdout.splitlines()
    if done.returncode or not lines:
        raise BenchError(f"the {role} process ended with code {done.returncode}: {_last_line(done.stderr)}")
    found: dict[str, Any] = json.loads(lines[-1])
    return found


@contextmanager
def conversation(
    environment: Mapping[str, str], role: str, expected_s: float, **options: Any
) -> Iterator[Callable[[Mapping[str, Any]], dict[str, Any]]]:
    """Runs a role inside the block, and yields a function that sends it a question and returns the answer, a line of JSON each.

    The function raises BenchError if there is no answer within ``expected_s`` plus ``PATIENCE_S`` seconds.
    """
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
        running = subprocess.Popen(
            _command(role, options), env=dict(environment), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors
        )
        assert running.stdin is not None and running.stdout is not None
        lines: queue.Queue[bytes] = queue.Queue()
        reader = threading.Thread(target=_put_lines, args=(running.stdout, lines), daemon=True)
        reader.start()

        def ask(question: Mapping[str, Any]) -> dict[str, Any]:
            assert running.stdin is not None
            try:
                running.stdin.write(json.dumps(question).encode() + b"\n")
                running.stdin.flush()
                line = lines.get(timeout=expected_s + PATIENCE_S)
            except queue.Empty:
                raise BenchError(f"the {role} process was still at it after {expected_s + PATIENCE_S:.0f} s") from None
            except BrokenPipeError:
                line = b""
            if not line:
                code = running.wait(PATIENCE_S)
                errors.seek(0)
                raise BenchError(f"the {role} process ended with code {code}: {_last_line(errors.read())}")
            found: dict[str, Any] = json.loads(line)
            return found

        try:
            yield ask
        finally:
            with suppress(BrokenPipeError):  # a question that the process did not read
                running.stdin.close()
            # Python handles signals after a read, not before it: a process about to read a question ends only because the pipe is closed.
            _end(running)
            reader.join()
            running.stdout.close()


def _put_lines(stream: IO[bytes], lines: queue.Queue[bytes]) -> None:
    """Puts the lines of a stream into a queue, then an empty one."""
    for line in stream:
        lines.put(line)
    lines.put(b"")


def _last_line(text: str) -> str:
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "it said nothing")
