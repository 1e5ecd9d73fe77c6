"""Node processes: start, listen to, stop."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn, TextIO

from gibson_sim.cli.environment import PARENT_VARIABLE, enclave_variables
from gibson_sim.cli.options import node_arguments
from gibson_sim.interrupts import held_back

GRACE_S = ((signal.SIGINT, 20.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 5.0))
"""Signals to stop a node with, and how long each may take."""
_ERROR = re.compile(
    r"""(?:error:\ |\[?(?:ERROR|FATAL)\]?[:\ ]+(?:\[[^]]*\][:\ ]*)*)(?P<error>.+)  # of ours; of rclpy and logging
    |(?P<native>Fatal\ Python\ error:\ .+|terminate\ called\ .+|[A-Za-z_][\w.]*(?:Error|Exception)(?::\ .+)?)$  # the end of a stack""",
    re.VERBOSE,
)
"""A line that reports an error. ``[INFO] ...`` is none, whatever it speaks of."""


def command_of(module: str, *arguments: str) -> list[str]:
    """Returns the command line of a module of ``gibson_sim.ros`` in a process of its own."""
    return [sys.executable, "-m", "gibson_sim.ros.nodes.start", f"gibson_sim.ros.nodes.{module}", *arguments]


def become(module: str, arguments: Sequence[str], environment: Mapping[str, str]) -> NoReturn:
    """Replaces this process by a module of ``gibson_sim.ros``, which thereby gets the terminal, its signals and its exit code."""
    command = command_of(module, *arguments)
    sys.stdout.flush()
    alone = {name: value for name, value in environment.items() if name != PARENT_VARIABLE}
    alone.update(enclave_variables(environment, module.removesuffix("_node")))
    with held_back():
        os.execve(command[0], command, alone)


class NodeProcess:
    """One node in a process of its own; its lines come out on our stderr with its name before them."""

    def __init__(
        self,
        name: str,
        config: Any,
        environment: Mapping[str, str],
        *,
        inherit: Sequence[int] = (),
        out: TextIO = sys.stderr,
        silent: bool = False,
    ) -> None:
        """Starts the node ``<name>_node`` with its settings.

        Args:
            name: of the node.
            config: its settings.
            environment: its environment.
            inherit: file descriptors that it inherits.
            out: where its lines go.
            silent: keep its lines until ``speak``; they are dropped where it is stopped before.
        """
        self.name, self.config, self._environment, self._out = (
            name,
            config,
            {**environment, **enclave_variables(environment, name)},
            out,
        )
        self._tail: deque[str] = deque(maxlen=20)
        self._unsaid = ""
        self._kept: list[str] | None = [] if silent else None
        self._speaking = threading.Lock()
        command = command_of(f"{name}_node", *node_arguments(config))
        # A session of its own: Ctrl-C reaches the launcher alone, which then stops the nodes in order.
        with held_back():
            self._process = subprocess.Popen(
                command,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                start_new_session=True,
                pass_fds=inherit,
            )
        self._reader = threading.Thread(target=self._read, name=f"{name}-output", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as output:
            for line in output:
                self._tail.append(line.rstrip())
                # The last line of a node that fails: whoever started it says it, once.
                self.say_error()
                if line.startswith("error: "):
                    self._unsaid = line.rstrip()
                else:
                    self._say(line.rstrip())

    def _say(self, line: str) -> None:
        with self._speaking:
            if self._kept is not None:
                self._kept.append(line)
                return
        self._out.write(f"{self.name:8} | {line}\n")
        self._out.flush()

    def speak(self) -> None:
        """Prints the lines that were kept, and from now on each as it comes."""
        with self._speaking:
            kept, self._kept = self._kept or [], None
        for line in kept:
            self._say(line)

    def say_error(self) -> None:
        """Prints the error with which the node ended, unless ``reason`` or ``ending`` returned it."""
        line, self._unsaid = self._unsaid, ""
        if line:
            self._say(line)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def poll(self) -> int | None:
        """Returns the exit code, negative for a signal, or None while it runs."""
        return self._process.poll()

    def reason(self) -> str:
        """Returns the last error that the ended node reported; how it ended, if it reported none."""
        return self._last_error() or self.ending()

    def ending(self) -> str:
        """Returns how the node ended: which signal or exit code, and the last error that it reported, if it did."""
        code = self._process.wait()
        how = f"was killed by {_signal_name(-code)}" if code < 0 else f"ended with code {code}"
        error = self._last_error()
        return f"the {self.name} node {how}" + (f": {error}" if error else "")

    def _last_error(self) -> str:
        """Returns the newest of the last lines that reports an error, without the word; empty if none does."""
        self._process.wait()
        self._reader.join(timeout=1.0)
        self._unsaid = ""
        found = (_ERROR.match(line) for line in reversed(self._tail))
        return next((match["error"] or match["native"] for match in found if match), "")

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
        self.say_error()
        return self._process.wait()


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # real-time signals have none
        return f"signal {number}"


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
