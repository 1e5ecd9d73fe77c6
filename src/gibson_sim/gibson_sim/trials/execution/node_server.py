"""The supervisor's end of the node server (``ros/trials/node_server.py``), which starts the processes of a run, and outlives runs."""

from __future__ import annotations

import atexit
import json
import os
import signal
import socket
import subprocess
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gibson_sim.errors import EnvironmentProblemError
from gibson_sim.interrupts import held_back
from gibson_sim.processes.node_process import command_of, node_arguments

SOCKET_VARIABLE = "GIBSON_SIM_NODE_SERVER"
"""Environment variable of the server with the number of the socket that it inherits."""
REST = "rest"
"""Stands for processes that ended ones left behind."""
_LARGEST = 1 << 16
"""Largest report, bytes."""
_END_S = 15.0
"""Wall time that the server has to end what it started, seconds."""


class NodeServer:
    """Starts nodes by forking a process that has loaded their modules, and programs.

    The server ends, and all that it started, when this object is closed or this process ends in any way.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        """Starts the server; ``environment`` is that of its nodes, but for what each start changes."""
        self._environment = dict(environment)
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs, held_back():
            self._process = subprocess.Popen(
                command_of("node_server"),
                env={**environment, SOCKET_VARIABLE: str(theirs.fileno())},
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        self._socket = ours
        self._hung_up = False
        """Whether the server has closed its end of the socket."""
        self._running: set[str] = set()
        self.ended: dict[str, int] = {}
        """Name -> exit code of each process that ended; negative = the signal."""
        self.cpu_s: dict[str, float] = {}
        """Name -> processor time of each process that ended, with those of its children that it waited for, seconds."""

    @property
    def running(self) -> frozenset[str]:
        """Names of the processes that have not ended."""
        return frozenset(self._running)

    @property
    def is_alive(self) -> bool:
        """Whether the server itself runs."""
        return not self._hung_up and self._process.poll() is None

    def fileno(self) -> int:
        """Returns the descriptor that becomes readable when a process has ended."""
        return self._socket.fileno()

    def start_node(self, name: str, module: str, config: Any, environment: Mapping[str, str], output: int) -> None:
        """Starts a node.

        Args:
            name: by which the other methods know it; any of before that has ended.
            module: of ``gibson_sim.ros.nodes``.
            config: its settings.
            environment: what differs from the server's environment.
            output: descriptor for stdout and stderr.
        """
        command = command_of(module, *node_arguments(config))
        start = {"do": "node", "module": command[3], "arguments": command[4:], "marker": None, "folder": str(Path.cwd())}
        self._start(name, {**start, "environment": dict(environment)}, output)

    def start_program(
        self, name: str, command: Sequence[str], folder: Path, environment: Mapping[str, str], marker: str, output: int
    ) -> None:
        """Starts a program in a session of its own.

        Args:
            name: by which the other methods know it.
            command: program and arguments.
            folder: in which it starts.
            environment: all of its variables.
            marker: the one of them that tells its processes from all others.
            output: descriptor for stdout and stderr.
        """
        changes: dict[str, str | None] = {n: v for n, v in environment.items() if self._environment.get(n) != v}
        changes.update(dict.fromkeys(self._environment.keys() - environment.keys()))
        start = {"do": "program", "command": list(command), "marker": (marker, environment[marker]), "folder": str(folder)}
        self._start(name, {**start, "environment": changes}, output)

    def _start(self, name: str, request: dict[str, Any], output: int) -> None:
        self.ended.pop(name, None)
        try:
            socket.send_fds(self._socket, [json.dumps({"name": name, **request}).encode()], [output])
        except OSError as error:
            raise EnvironmentProblemError(f"{name} cannot be started: the node server does not answer ({error})") from error
        self._running.add(name)

    def signal(self, name: str, number: int) -> None:
        """Sends a signal to the process group of a process; does nothing once that has ended."""
        if name in self._running and self.is_alive:
            try:
                self._socket.send(json.dumps({"do": "signal", "name": name, "number": int(number)}).encode())
            except OSError:  # the server has ended meanwhile, which ``poll`` tells
                return

    def end_rest(self) -> None:
        """Ends what the processes that have ended left behind; ``REST`` is in ``running`` until that is done."""
        try:
            self._socket.send(json.dumps({"do": "end rest", "name": REST}).encode())
        except OSError:  # the server has ended meanwhile, and all with it
            return
        self._running.add(REST)

    def poll(self) -> None:
        """Reads which processes have ended, without waiting; all have if the server has ended."""
        while self._running:
            try:
                data = self._socket.recv(_LARGEST, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self._hung_up = True
                self.ended.update(dict.fromkeys(self._running, -signal.SIGKILL))
                self._running.clear()
                return
            event = json.loads(data)
            self.ended[event["ended"]] = event["code"]
            self._running.discard(event["ended"])
            self.cpu_s[event["ended"]] = event["cpu_s"]

    def close(self) -> None:
        """Ends the server, and all that it started."""
        self._socket.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class ServerPool:
    """The node servers of this process: each serves one run at a time, and is used again."""

    def __init__(self) -> None:
        self._idle: list[tuple[dict[str, str], NodeServer]] = []
        self._lock, self._owner = threading.Lock(), os.getpid()

    def acquire(self, environment: Mapping[str, str]) -> NodeServer:
        """Returns a server with this environment."""
        with self._lock:
            self._forget_if_forked()
            for number, (own, server) in enumerate(self._idle):
                if own == environment and server.is_alive:
                    del self._idle[number]
                    return server
        return NodeServer(environment)

    def release(self, environment: Mapping[str, str], server: NodeServer) -> None:
        """Gives a server back; one that still has processes, or has ended, is closed."""
        if server.running or not server.is_alive:
            server.close()
            return
        server.ended.clear()
        with self._lock:
            self._idle.append((dict(environment), server))

    def close(self) -> None:
        """Ends the idle servers."""
        with self._lock:
            self._forget_if_forked()
            for _, server in self._idle:
                server.close()
            self._idle.clear()

    def _forget_if_forked(self) -> None:
        """Leaves the servers of the process that this one was forked from to that process."""
        if self._owner != os.getpid():
            self._owner = os.getpid()
            self._idle.clear()


SERVERS = ServerPool()
"""Servers of this process; they end with it."""
atexit.register(SERVERS.close)
