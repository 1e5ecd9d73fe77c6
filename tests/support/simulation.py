"""A simulation in a process of its own, and a client to talk to it."""

from __future__ import annotations

import importlib.util
import os
import re
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PATIENCE_S = 120.0
"""How long anything may take before a test calls it missing; never how long it should take."""


def require(*modules: str) -> None:
    """Skips, loudly, where a module is missing; fails instead where ``GIBSON_REQUIRE`` names ros."""
    missing = [m for m in modules if importlib.util.find_spec(m) is None]
    if missing:
        message = f"SKIPPED: no {', '.join(missing)} in this Python; run `make setup`"
        if "ros" in os.environ.get("GIBSON_REQUIRE", ""):
            pytest.fail(message)
        pytest.skip(message, allow_module_level=True)


class Launched:
    """``gibson-sim`` in a process of its own, and what it said."""

    def __init__(self, *argv: str, env: dict[str, str] | None = None) -> None:
        if argv[0] == "run" and "--scene" not in argv:  # the scene that loads most quickly
            argv = ("run", "--scene", "flat", *argv[1:])
        self._start([sys.executable, "-m", "gibson_sim.cli.main", *argv], {**os.environ, **(env or {})})

    def _start(self, command: list[str], env: dict[str, str]) -> None:
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=env)
        self.lines: list[str] = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        _launched.add(self)

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as output:
            for line in output:
                self.lines.append(line.rstrip())

    def wait_for_line(self, text: str, *, after: int = 0) -> str:
        """Returns the first line, from number ``after`` on, that holds ``text``."""
        found: list[str] = []

        def look() -> bool:
            found[:] = [line for line in self.lines[after:] if text in line]
            return bool(found) or self.process.poll() is not None

        wait_until(look, f"a line with {text!r}")
        assert found, f"it ended with {self.process.poll()} and never said {text!r}:\n" + "\n".join(self.lines)
        return found[0]

    def node_pid(self, name: str) -> int:
        """Returns the process id of a node."""
        nodes = _nodes(self.process.pid)
        assert name in nodes, f"no {name} node among the children of {self.process.pid}"
        return nodes[name]

    def stop(self, number: int = signal.SIGINT) -> int:
        """Asks it to stop and returns its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        code = self.process.wait(timeout=PATIENCE_S)
        self._thread.join(timeout=10)
        return code

    def wait(self) -> int:
        """Waits for its end and returns its exit code."""
        code = self.process.wait(timeout=PATIENCE_S * 3)
        self._thread.join(timeout=10)
        return code


_launched: weakref.WeakSet[Launched] = weakref.WeakSet()


def _nodes(pid: int) -> dict[str, int]:
    """Returns name -> process id of the nodes among the children of a process."""
    found = {}
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        line = Path(f"/proc/{child}/cmdline").read_bytes().decode(errors="replace")
        if name := re.search(r"gibson_sim\.ros\.\w+\.(\w+)_node", line):
            found[name[1]] = int(child)
    return found


def what_runs() -> str:
    """Returns which processes are deaf, and of each running ``gibson-sim`` what it said last and where its nodes are now."""
    found = [_replaced_ports(os.getpid(), "this process")]
    for launched in list(_launched):
        if (code := launched.process.poll()) is not None:
            found += [f"{' '.join(launched.process.args[3:])} ended with {code} and said last:", *launched.lines[-5:]]
            continue
        nodes = _nodes(launched.process.pid)
        for name, pid in nodes.items():
            found.append(_replaced_ports(pid, f"{name} node"))
            os.kill(pid, signal.SIGUSR1)  # each says where it is
        time.sleep(2.0)
        found += [f"{' '.join(launched.process.args[3:])} said last:", *launched.lines[-80:]]
    return "".join(f"\n{line}" for line in found if line)


def _replaced_ports(pid: int, who: str) -> str:
    """Returns which of a process's own ports in shared memory another process has replaced: it hears nothing on them any more."""
    maps = Path(f"/proc/{pid}/maps").read_text().splitlines()
    gone = {line.split()[5] for line in maps if "fastrtps_port" in line and line.endswith("(deleted)")}
    own = {os.readlink(link).removesuffix("_el") for link in Path(f"/proc/{pid}/fd").iterdir() if link.is_symlink()}
    return f"{who} is deaf: replaced were {', '.join(sorted(gone & own))}" if gone & own else ""


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Returns as soon as ``condition`` holds; fails after a patience that no healthy machine needs."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"still no {what} after {PATIENCE_S:.0f} s{what_runs()}"
        time.sleep(0.02)


def new_context() -> Any:
    """Returns a running context: a participant of its own in the ROS domain."""
    import rclpy

    context = rclpy.Context()
    context.init()
    return context


class Listener:
    """A client that keeps what arrives. The context is its owner's: making and ending one takes others seconds to notice."""

    def __init__(self, context: Any) -> None:
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        self.node: Any = Node("test_listener", context=context, use_global_arguments=False, start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)

    def collect(self, message_type: Any, topic: str, qos: Any = 10) -> list[Any]:
        """Returns a list that fills with the topic's messages while ``spin_until`` works."""
        messages: list[Any] = []
        self.node.create_subscription(message_type, topic, lambda msg: messages.append(msg), qos)
        return messages

    def spin_until(self, condition: Callable[[], bool], what: str) -> None:
        """Works until ``condition`` holds."""
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, f"still no {what} after {PATIENCE_S:.0f} s{what_runs()}"
            self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        self._executor.shutdown(timeout_sec=PATIENCE_S)
        self.node.destroy_node()
