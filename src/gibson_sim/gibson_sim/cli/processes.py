"""Node processes: start, listen to, stop."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, TextIO

from gibson_sim.cli.options import node_arguments

GRACE_S = ((signal.SIGINT, 20.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 5.0))
"""Signals to stop a node with, and how long each may take."""


class NodeProcess:
    """One node in a process of its own; its lines come out on our stderr with its name before them."""

    def __init__(self, name: str, config: Any, environment: Mapping[str, str], *, out: TextIO = sys.stderr) -> None:
        """Starts the node ``<name>_node`` with its settings."""
        self.name, self.config, self._environment, self._out = name, config, dict(environment), out
        self._tail: deque[str] = deque(maxlen=20)
        command = [sys.executable, "-m", f"gibson_sim.ros.{name}_node", *node_arguments(config)]
        # A session of its own: Ctrl-C reaches the launcher alone, which then stops the nodes in order.
        self._process = subprocess.Popen(
            command,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, name=f"{name}-output", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as output:
            for line in output:
                self._tail.append(line.rstrip())
                self._out.write(f"{self.name:8} | {line.rstrip()}\n")
                self._out.flush()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def poll(self) -> int | None:
        """Returns the exit code, negative for a signal, or None while it runs."""
        return self._process.poll()

    def last_error(self) -> str:
        """Returns the last line that reports an error, else the last line."""
        self._reader.join(timeout=1.0)
        errors = [line.removeprefix("error: ") for line in self._tail if line.startswith("error: ")]
        return errors[-1] if errors else next((line for line in reversed(self._tail) if line), "it said nothing")

    def stop(self, hurry: Callable[[], bool] = lambda: False) -> int:
        """Ends the process and returns its exit code; ``hurry`` returning True shortens the waiting."""
        for number, seconds in GRACE_S:
            if self._process.poll() is not None:
                break
            self._process.send_signal(number)
            deadline = time.monotonic() + seconds
            while self._process.poll() is None and time.monotonic() < deadline and not hurry():
                time.sleep(0.02)
        self._reader.join(timeout=1.0)
        return self._process.wait()


class StopRequest:
    """Notes SIGINT and SIGTERM while it is open, instead of being interrupted by them."""

    def __init__(self) -> None:
        self.count = 0
        self._before = {s: signal.signal(s, self._on_signal) for s in (signal.SIGINT, signal.SIGTERM)}

    def _on_signal(self, number: int, frame: object) -> None:
        self.count += 1

    def close(self) -> None:
        """Restores what was there before."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
