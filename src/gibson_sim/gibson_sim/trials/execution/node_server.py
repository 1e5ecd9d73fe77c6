"""Client of the node server (``ros/trials/node_server.py``), which starts the processes of a run and is reused by later runs."""

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
"""Environment variable of the server: descriptor of the socket that it inherits."""
REST = "rest"
"""Name for the processes that exited processes left behind."""
_LARGEST = 1 << 16
"""Largest size of a report, bytes."""
_END_S = 15.0
"""Timeout for the server to end its processes, seconds of wall time."""


class NodeServer:
    """Starts programs, and nodes by forking a process that has already imported their modules.

    The server and all its processes end when this object is closed or when this process ends for any reason.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        """Starts the server; ``environment`` is the base environment of its nodes."""
        self._environment = dict(environment)
        own_end, server_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with server_end, held_back():
            self._process = subprocess.Popen(
                command_of("node_server"),
                env={**environment, SOCKET_VARIABLE: str(server_end.fileno())},
                stdin=subprocess.DEVNULL,
                pass_fds=[server_end.fileno()],
                start_new_session=True,
            )
        self._socket = own_end
        self._hung_up = False
        """Whether the server has closed its end of the socket."""
        self._running: set[str] = set()
        self.ended: dict[str, int] = {}
        """Name -> exit code of each exited process; negative = the signal."""
        self.cpu_s: dict[str, float] = {}
        """Name -> CPU time of each exited process, including children that it waited for, seconds."""

    @property
    def running(self) -> frozenset[str]:
        """Names of the running processes."""
        return frozenset(self._running)

    @property
    def is_alive(self) -> bool:
        """Whether the server is running."""
        return not self._hung_up and self._process.poll() is None

    def fileno(self) -> int:
        """Returns the file descriptor that becomes readable when a process has exited."""
        return self._socket.fileno()

    def start_node(self, name: str, module: str, config: Any, environment: Mapping[str, str], output: int) -> None:
        """Starts a node.

        Args:
            name: name for the other methods; a previous process of this name must have exited.
            module: module of ``gibson_sim.ros.nodes``.
            config: settings of the node.
            environment: variables that differ from the server's environment.
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
            name: name for the other methods; a previous process of this name must have exited.
            command: program and arguments.
            folder: working folder.
            environment: complete environment.
            marker: name of the variable that identifies the program's processes.
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
            raise EnvironmentProblemError(f"{name} cannot be started: the node server does not respond ({error})") from error
        self._running.add(name)

    def signal(self, name: str, number: int) -> None:
        """Sends a signal to the process group of a process; does nothing after the process has exited."""
        if name in self._running and self.is_alive:
            try:
                self._socket.send(json.dumps({"do": "signal", "name": name, "number": int(number)}).encode())
            except OSError:  # the server has exited, which ``poll`` detects
                return

    def end_rest(self) -> None:
        """Ends the processes that exited processes left behind; ``REST`` is in ``running`` until they have ended."""
        try:
            self._socket.send(json.dumps({"do": "end rest", "name": REST}).encode())
        except OSError:  # the server has exited with all its processes
            return
        self._running.add(REST)

    def poll(self) -> None:
        """Updates ``running`` and ``ended`` without waiting; if the server has exited, all processes have."""
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
        """Ends the server and all its processes."""
        self._socket.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class ServerPool:
    """The node servers of this process: each serves one run at a time and is reused."""

    def __init__(self) -> None:
        self._idle: list[tuple[dict[str, str], NodeServer]] = []
        self._lock, self._owner = threading.Lock(), os.getpid()

    def acquire(self, environment: Mapping[str, str]) -> NodeServer:
        """Returns an idle or new server with the given environment."""
        with self._lock:
            self._drop_if_forked()
            for number, (server_environment, server) in enumerate(self._idle):
                if server_environment == environment and server.is_alive:
                    del self._idle[number]
                    return server
        return NodeServer(environment)

    def release(self, environment: Mapping[str, str], server: NodeServer) -> None:
        """Returns a server to the pool; closes it if it still has processes or has exited."""
        if server.running or not server.is_alive:
            server.close()
            return
        server.ended.clear()
        with self._lock:
            self._idle.append((dict(environment), server))

    def close(self) -> None:
        """Ends the idle servers."""
        with self._lock:
            self._drop_if_forked()
            for _, server in self._idle:
                server.close()
            self._idle.clear()

    def _drop_if_forked(self) -> None:
        """Drops the servers of the parent process after a fork."""
        if self._owner != os.getpid():
            self._owner = os.getpid()
            self._idle.clear()


SERVERS = ServerPool()
"""Servers of this process; they end with the process."""
atexit.register(SERVERS.close)
