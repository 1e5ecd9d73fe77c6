"""Child processes of the benchmarks: simulations, and the nodes of ``gibson_sim_bench.nodes``."""

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

TIMEOUT_S = 120.0
"""Wall time beyond the expected duration after which a process has failed, seconds."""
CAMERA = "camera"


class BenchError(GibsonSimError):
    """A measurement failed."""


def _command(node: str, options: Mapping[str, Any]) -> list[str]:
    return [sys.executable, "-m", "gibson_sim_bench.nodes", node, json.dumps(options)]


@contextmanager
def background_node(environment: Mapping[str, str], node: str, **options: Any) -> Iterator[None]:
    """Runs a node in its own process inside the block."""
    with process(_command(node, options), environment):
        yield


@contextmanager
def process(command: list[str], environment: Mapping[str, str]) -> Iterator[int]:
    """Runs a process inside the block, and yields its id; a ``BenchError`` of the block gets the last line of its output."""
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as output:
        running = subprocess.Popen(command, env=dict(environment), stdin=subprocess.DEVNULL, stdout=output, stderr=output)
        try:
            yield running.pid
        except BenchError as error:
            code = running.poll()
            output.seek(0)
            status = "still runs" if code is None else f"ended with code {code}"
            raise BenchError(f"{error}; the background process {status}: {_last_line(output.read())}") from error
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


def node_result(environment: Mapping[str, str], node: str, expected_s: float, **options: Any) -> dict[str, Any]:
    """Runs a node that ends by itself; returns its result.

    Raises:
        BenchError: there is none, or the node ran longer than ``expected_s`` plus ``TIMEOUT_S`` seconds.
    """
    try:
        done = subprocess.run(
            _command(node, options),
            env=dict(environment),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=expected_s + TIMEOUT_S,
        )
    except subprocess.TimeoutExpired:
        raise BenchError(f"the {node} process still ran after {expected_s + TIMEOUT_S:.0f} s") from None
    lines = done.stdout.splitlines()
    if done.returncode or not lines:
        raise BenchError(f"the {node} process ended with code {done.returncode}: {_last_line(done.stderr)}")
    found: dict[str, Any] = json.loads(lines[-1])
    return found


@contextmanager
def node_session(
    environment: Mapping[str, str], node: str, expected_s: float, **options: Any
) -> Iterator[Callable[[Mapping[str, Any]], dict[str, Any]]]:
    """Runs a node inside the block, and yields a function that sends it a request and returns the response, a line of JSON each.

    The function raises BenchError if there is no response within ``expected_s`` plus ``TIMEOUT_S`` seconds.
    """
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
        running = subprocess.Popen(
            _command(node, options), env=dict(environment), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors
        )
        assert running.stdin is not None and running.stdout is not None
        lines: queue.Queue[bytes] = queue.Queue()
        reader = threading.Thread(target=_put_lines, args=(running.stdout, lines), daemon=True)
        reader.start()

        def send(request: Mapping[str, Any]) -> dict[str, Any]:
            assert running.stdin is not None
            try:
                running.stdin.write(json.dumps(request).encode() + b"\n")
                running.stdin.flush()
                line = lines.get(timeout=expected_s + TIMEOUT_S)
            except queue.Empty:
                raise BenchError(f"the {node} process still ran after {expected_s + TIMEOUT_S:.0f} s") from None
            except BrokenPipeError:
                line = b""
            if not line:
                code = running.wait(TIMEOUT_S)
                errors.seek(0)
                raise BenchError(f"the {node} process ended with code {code}: {_last_line(errors.read())}")
            found: dict[str, Any] = json.loads(line)
            return found

        try:
            yield send
        finally:
            with suppress(BrokenPipeError):  # a request that the process did not read
                running.stdin.close()
            # Python handles signals after a read, not before it: a process about to read a request ends only because the pipe is closed.
            _end(running)
            reader.join()
            running.stdout.close()


def _put_lines(stream: IO[bytes], lines: queue.Queue[bytes]) -> None:
    """Puts the lines of a stream into a queue, then an empty one."""
    for line in stream:
        lines.put(line)
    lines.put(b"")


def _last_line(text: str) -> str:
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "no output")
