"""Starts node processes, forwards their output, and stops them."""

from __future__ import annotations

import os
import re
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

from gibson_sim.cli.console import CONSOLE, Console
from gibson_sim.cli.environment import enclave_variables
from gibson_sim.interrupts import held_back
from gibson_sim.processes.node_process import PARENT_VARIABLE, command_of, end_node, node_arguments, start_node

_ERROR = re.compile(
    r"""(?:error:\ |\[?(?:ERROR|FATAL)\]?[:\ ]+(?:\[[^]]*\][:\ ]*)*)(?P<error>.+)  # of ours; of rclpy and logging
    |(?P<native>Fatal\ Python\ error:\ .+|terminate\ called\ .+|[A-Za-z_][\w.]*(?:Error|Exception)(?::\ .+)?)$  # the end of a stack""",
    re.VERBOSE,
)
"""Pattern of lines that report an error; does not match ``[INFO] ...``."""
_WARNING = re.compile(r"\[?WARN")
"""Pattern of warnings."""


def become(module: str, arguments: Sequence[str], environment: Mapping[str, str]) -> NoReturn:
    """Replaces this process by a module of ``gibson_sim.ros.nodes``, so that it owns the terminal, the signals and the exit code."""
    alone = {name: value for name, value in environment.items() if name != PARENT_VARIABLE}
    alone.update(enclave_variables(environment, module.removesuffix("_node")))
    replace_process(command_of(module, *arguments), alone)


def replace_process(command: Sequence[str], environment: Mapping[str, str]) -> NoReturn:
    """Replaces this process by a program; SIGINT is held back until the program is ready for it."""
    sys.stdout.flush()
    with held_back():
        os.execve(command[0], list(command), environment)


class NodeProcess:
    """A node in a separate process; its output lines are printed on stderr, prefixed with its name."""

    def __init__(
        self,
        name: str,
        config: Any,
        environment: Mapping[str, str],
        *,
        inherit: Sequence[int] = (),
        out: Console = CONSOLE,
        silent: bool = False,
    ) -> None:
        """Starts the node ``<name>_node`` with its settings.

        Args:
            name: name of the node.
            config: settings of the node.
            environment: environment of the process.
            inherit: file descriptors that the process inherits.
            out: receives the output lines; identical warnings of any nodes within ten seconds are printed once.
            silent: whether to buffer the output lines until ``print_held``; they are dropped if the node is stopped before.
        """
        self.name, self.config, self._environment, self._out = (
            name,
            config,
            {**environment, **enclave_variables(environment, name)},
            out,
        )
        self._tail: deque[str] = deque(maxlen=20)
        self._pending_error = ""
        self._held: list[str] | None = [] if silent else None
        self._held_lock = threading.Lock()
        command = command_of(f"{name}_node", *node_arguments(config))
        self._process = start_node(command, self._environment, inherit)
        self._reader = threading.Thread(target=self._read, name=f"{name}-output", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as output:
            for line in output:
                self._tail.append(line.rstrip())
                # The launcher reports the last line of a failing node, so do not print it twice.
                self.print_error()
                if line.startswith("error: "):
                    self._pending_error = line.rstrip()
                else:
                    self._print(line.rstrip())

    def _print(self, line: str) -> None:
        with self._held_lock:
            if self._held is not None:
                self._held.append(line)
                return
        if _WARNING.match(line) and self._out.was_written(line):
            return
        self._out.write(f"{self.name:8} | {line}")

    def print_held(self) -> None:
        """Prints the buffered lines, and later lines immediately."""
        with self._held_lock:
            held, self._held = self._held or [], None
        for line in held:
            self._print(line)

    def print_error(self) -> None:
        """Prints the last error of the node, unless ``reason`` or ``ending`` has returned it."""
        line, self._pending_error = self._pending_error, ""
        if line:
            self._print(line)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def poll(self) -> int | None:
        """Returns the exit code, negative for a signal, or None while the node is running."""
        return self._process.poll()

    def reason(self) -> str:
        """Returns the last error that the exited node reported, else how it exited."""
        return self._last_error() or self.ending()

    def ending(self) -> str:
        """Returns how the node exited: the signal or exit code, and the last reported error, if any."""
        code = self._process.wait()
        how = f"was killed by {_signal_name(-code)}" if code < 0 else f"ended with code {code}"
        error = self._last_error()
        return f"the {self.name} node {how}" + (f": {error}" if error else "")

    def _last_error(self) -> str:
        """Returns the most recent error in the last output lines; empty if there is none."""
        self._process.wait()
        self._reader.join(timeout=1.0)
        self._pending_error = ""
        matches = (_ERROR.match(line) for line in reversed(self._tail))
        return next((match["error"] or match["native"] for match in matches if match), "")

    def stop(self, hurry: Callable[[], bool] = lambda: False) -> int:
        """Stops the process and returns its exit code; escalates to the next signal earlier while ``hurry`` returns True."""
        end_node(self._process, hurry=hurry)
        self._reader.join(timeout=1.0)
        self.print_error()
        return self._process.wait()


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # real-time signals have none
        return f"signal {number}"


class StopRequest:
    """Counts SIGINT and SIGTERM while it is open, instead of interrupting."""

    def __init__(self) -> None:
        self.count = 0
        self._before = {s: signal.signal(s, self._on_signal) for s in (signal.SIGINT, signal.SIGTERM)}

    def _on_signal(self, number: int, frame: object) -> None:
        self.count += 1

    def close(self) -> None:
        """Restores the previous handlers."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
