"""Processes of nodes: their command lines, how they are started, and how they are ended. Pure: it starts them without loading ROS."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any

from gibson_sim.interrupts import held_back

PARENT_VARIABLE = "GIBSON_SIM_PARENT_PID"
"""Environment variable with the id of the process that starts a node: the node ends when that process does, however it ends."""
GRACE_S = ((signal.SIGINT, 20.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 5.0))
"""Signals that end a node, and the wall time after which the next one is sent, seconds."""
_ELSEWHERE = {
    "foxglove_node": "foxglove.foxglove_node",
    "node_server": "trials.node_server",
    "render_bag": "recording.render_bag",
    "trial_node": "trials.trial_node",
}
"""Modules of nodes that stand in a folder of their own below ``gibson_sim.ros``."""


def command_of(module: str, *arguments: str) -> list[str]:
    """Returns the command line that runs a module of ``gibson_sim.ros.nodes`` in a process of its own."""
    module = _ELSEWHERE.get(module, module)
    return [
        sys.executable,
        "-m",
        "gibson_sim.ros.nodes.start",
        f"gibson_sim.ros.{module if '.' in module else f'nodes.{module}'}",
        *arguments,
    ]


def node_arguments(config: Any) -> list[str]:
    """Returns the ROS arguments that pass settings to a node. JSON is valid YAML, with quotes where needed."""
    arguments = ["--ros-args"]
    for f in fields(config):
        arguments += ["-p", f"{f.name}:={json.dumps(getattr(config, f.name))}"]
    return arguments


def start_node(command: Sequence[str], environment: Mapping[str, str], inherit: Sequence[int] = ()) -> subprocess.Popen[str]:
    """Starts a node in a session of its own: only the process that starts it receives Ctrl-C, and ends it.

    Args:
        command: see ``command_of``.
        environment: all of its variables.
        inherit: file descriptors that it inherits.

    Returns:
        The process; its stdout, a pipe of text, has its stderr, too.
    """
    with held_back():
        return subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
            pass_fds=inherit,
        )


def end_node(process: subprocess.Popen[str], *, interrupted: bool = False, hurry: Callable[[], bool] = lambda: False) -> None:
    """Ends a node by one signal after the other, see ``GRACE_S``, and waits until it has ended.

    Args:
        process: of the node.
        interrupted: whether it was sent SIGINT already: a second one would end it before it has closed its files.
        hurry: the next signal is sent early while this returns True.
    """
    for number, seconds in GRACE_S:
        if process.poll() is not None:
            return
        if number != signal.SIGINT or not interrupted:
            process.send_signal(number)
        deadline = time.monotonic() + seconds
        while process.poll() is None and time.monotonic() < deadline and not hurry():
            time.sleep(0.02)
