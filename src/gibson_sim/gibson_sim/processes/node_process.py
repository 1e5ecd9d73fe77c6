"""Node processes: command lines, start and end. Does not import ROS."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from gibson_sim.interrupts import held_back
from gibson_sim.settings import setting_values

PARENT_VARIABLE = "GIBSON_SIM_PARENT_PID"
"""Environment variable with the id of the process that starts a node; the node ends when that process ends for any reason."""
GRACE_S = ((signal.SIGINT, 20.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 5.0))
"""Signals that end a node, each with the wall time until the next signal, seconds."""
_SUBPACKAGES = {
    "foxglove_node": "foxglove.foxglove_node",
    "node_server": "trials.node_server",
    "render_bag": "recording.render_bag",
    "trial_node": "trials.trial_node",
}
"""Node modules in other subpackages of ``gibson_sim.ros`` than ``nodes``."""


def command_of(module: str, *arguments: str) -> list[str]:
    """Returns the command line that runs a node module of ``gibson_sim.ros`` in its own process."""
    module = _SUBPACKAGES.get(module, module)
    return [
        sys.executable,
        "-m",
        "gibson_sim.ros.nodes.start",
        f"gibson_sim.ros.{module if '.' in module else f'nodes.{module}'}",
        *arguments,
    ]


def node_arguments(config: Any) -> list[str]:
    """Returns the ROS arguments that pass settings to a node. Values are JSON, which is valid YAML."""
    arguments = ["--ros-args"]
    for name, value in setting_values(config).items():
        arguments += ["-p", f"{name}:={json.dumps(value)}"]
    return arguments


def start_node(command: Sequence[str], environment: Mapping[str, str], inherit: Sequence[int] = ()) -> subprocess.Popen[str]:
    """Starts a node in its own session: only the starting process receives Ctrl-C and then ends the node.

    Args:
        command: see ``command_of``.
        environment: complete environment of the node.
        inherit: file descriptors that the node inherits.

    Returns:
        The process; its stdout, a text pipe, includes its stderr.
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
    """Ends a node with a sequence of signals, see ``GRACE_S``, and waits for its end.

    Args:
        process: process of the node.
        interrupted: whether SIGINT was already sent: a second one would end the node before it has closed its files.
        hurry: returns whether to send the next signal early.
    """
    for number, seconds in GRACE_S:
        if process.poll() is not None:
            return
        if number != signal.SIGINT or not interrupted:
            process.send_signal(number)
        deadline = time.monotonic() + seconds
        while process.poll() is None and time.monotonic() < deadline and not hurry():
            time.sleep(0.02)
