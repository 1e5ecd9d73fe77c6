"""The node server: forks node processes with preloaded modules, and starts other programs.

A node needs a second of CPU time to import its modules; a fork of this process takes milliseconds. Requests arrive as packets on a socket
that ``trials.execution.node_server`` owns. When that socket closes, even if its owner crashed, all processes started by the server are ended.
Orphans become children of this process (PR_SET_CHILD_SUBREAPER, prctl(2)), so that it finds also those that changed their environment.
"""

from __future__ import annotations

import ctypes
import gc
import inspect
import json
import logging
import os
import select
import signal
import socket
import sys
import time
import traceback
from collections.abc import Callable
from importlib import import_module
from typing import Any, NoReturn

from gibson_sim.bags.definitions import MessageDefinitions
from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import GibsonSimError, RecordError
from gibson_sim.maps.placement import populate
from gibson_sim.processes.descendants import descendants, end_all, end_marked
from gibson_sim.processes.node_process import PARENT_VARIABLE
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class
from gibson_sim.standard.simulator import Simulator
from gibson_sim.trials.execution.node_server import SOCKET_VARIABLE

PRELOADED = ("nodes.physics_node", "nodes.record_node", "trials.trial_node")
"""Node modules that are imported before any fork."""
_SCENE = "arena"
"""Name of a small scene that is loaded to initialize the physics engine."""
_TYPES = (
    "builtin_interfaces/msg/Time",
    "control_msgs/msg/DynamicJointState",
    "diagnostic_msgs/msg/DiagnosticArray",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/WrenchStamped",
    "gibson_msgs/msg/CollisionCount",
    "gibson_msgs/msg/Contacts",
    "gibson_msgs/msg/Epoch",
    "gibson_msgs/msg/GraspState",
    "gibson_msgs/msg/Input",
    "gibson_msgs/msg/RunInfo",
    "gibson_msgs/msg/Scene",
    "gibson_msgs/msg/SceneState",
    "gibson_msgs/msg/TickDigest",
    "gibson_msgs/msg/TickDone",
    "nav_msgs/msg/OccupancyGrid",
    "nav_msgs/msg/Odometry",
    "nav_msgs/msg/Path",
    "rcl_interfaces/msg/Log",
    "rcl_interfaces/msg/ParameterEvent",
    "rosgraph_msgs/msg/Clock",
    "sensor_msgs/msg/BatteryState",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/PointCloud2",
    "std_msgs/msg/Bool",
    "std_msgs/msg/Float64",
    "std_msgs/msg/String",
    "tf2_msgs/msg/TFMessage",
    "trajectory_msgs/msg/JointTrajectory",
)
"""Message types that nodes of trials publish or record."""
_MAX_PACKET_BYTES = 1 << 20
"""Maximum size of a packet, bytes."""
_END_TIMEOUT_S = 3.0
"""Timeout for the end of processes after a signal, s of wall time."""
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
"""Numbers of options of prctl(2)."""
Task = Callable[[], None]


class NodeServer:
    """Starts processes on request, and reports ended ones. Single-threaded, so that it can fork at any time."""

    def __init__(self, requests: socket.socket) -> None:
        self._requests = requests
        self._names: dict[int, str] = {}
        """Process ID -> name of the process in its request."""
        self._markers: set[tuple[str, str]] = set()
        """Environment variables, with values, that mark the started programs."""
        self._wake, self._woken = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(self._woken)
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    def serve(self) -> Task | None:
        """Serves until the socket closes. Returns None then; in a forked process, returns the task of that process."""
        while True:
            requests = self._requests.fileno()
            ready = select.select([requests, self._wake], [], [])[0]
            if self._wake in ready:
                os.read(self._wake, 4096)
                self._reap()
            if requests in ready:
                data, descriptors, _, _ = socket.recv_fds(self._requests, _MAX_PACKET_BYTES, 1)
                if not data:
                    self._end_all()
                    return None
                task = self._handle(json.loads(data), descriptors)
                if task is not None:
                    return task

    def _handle(self, request: dict[str, Any], descriptors: list[int]) -> Task | None:
        if request["do"] == "signal":
            for process_id in [pid for pid, name in self._names.items() if name == request["name"]]:
                _signal_group(process_id, request["number"])
            return None
        if request["do"] == "end rest":
            end_all(lambda: descendants(os.getpid(), self._names))
            self._report(request["name"], 0, 0.0)
            return None
        if request["marker"]:
            self._markers.add(tuple(request["marker"]))
        process_id = os.fork()
        if process_id:
            self._names[process_id] = request["name"]
            os.close(descriptors[0])
            return None
        self._become(request, descriptors[0])
        if request["do"] == "program":
            _run_program(request["command"])
        return lambda: _run_node(request["module"], request["arguments"])

    def _become(self, request: dict[str, Any], output: int) -> None:
        """Sets up a forked process: session, signals, environment, output, working directory."""
        os.setsid()
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, ())
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        for descriptor in (self._requests.fileno(), self._wake, self._woken):
            os.close(descriptor)
        null = os.open(os.devnull, os.O_RDONLY)
        for number, descriptor in enumerate((null, output, output)):
            os.dup2(descriptor, number)
        os.close(null)
        os.close(output)
        for name, value in request["environment"].items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        if request["do"] == "node":
            os.environ[PARENT_VARIABLE] = str(os.getppid())
        os.chdir(request["folder"])

    def _reap(self) -> None:
        """Reaps ended child processes, and reports those that were requested."""
        while True:
            try:
                process_id, status, usage = os.wait4(-1, os.WNOHANG)
            except ChildProcessError:
                return
            if not process_id:
                return
            name = self._names.pop(process_id, "")
            if name:  # otherwise it is an orphan of a requested process
                self._report(name, os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime)

    def _report(self, name: str, code: int, cpu_s: float) -> None:
        """Reports the end of a process, with its exit code and CPU time, s."""
        try:
            self._requests.send(json.dumps({"ended": name, "code": code, "cpu_s": cpu_s}).encode())
        except OSError:  # the owner of the socket has ended, which the next read detects
            return

    def _end_all(self) -> None:
        """Ends all started processes and their descendants."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            for process_id in self._names:
                _signal_group(process_id, number)
            deadline = time.monotonic() + _END_TIMEOUT_S
            while self._names and time.monotonic() < deadline:
                self._reap()
                time.sleep(0.02)
        for variable, value in self._markers:
            end_marked(value, variable)
        end_all(lambda: descendants(os.getpid()))


def _signal_group(process_id: int, number: int) -> None:
    for send in (os.killpg, os.kill):  # a new process may have no group yet
        try:
            send(process_id, number)
        except ProcessLookupError:
            continue
        return


def _run_program(command: list[str]) -> NoReturn:
    try:
        os.execvpe(command[0], command, os.environ)
    except OSError as error:
        os.write(2, f"error: {command[0]} cannot be started: {error.strerror}\n".encode())
        os._exit(127)


def _run_node(module: str, arguments: list[str]) -> NoReturn:
    """Runs a node, and ends this process without finalizing the interpreter, which would copy and free all memory shared with the server."""
    from gibson_sim.ros.nodes.start import run

    sys.argv = [module, *arguments]
    code = 1
    try:
        run(module)
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if isinstance(end.code, str):
            sys.stderr.write(f"{end.code}\n")
    except BaseException:
        traceback.print_exc()
    finally:
        gc.unfreeze()
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(code)


def _load() -> None:
    """Preloads node modules, and what nodes load later: compiled loops of the engine, type support and definitions of messages."""
    for name in PRELOADED:
        import_module(f"gibson_sim.ros.{name}")
    import_module("rosidl_generator_py")
    inspect.getmodule(inspect.currentframe())  # fills the cache of module files, which rclpy's first log line would do
    definitions = MessageDefinitions()
    for kind in _TYPES:
        try:
            type(message_class(kind)).__import_type_support__()
            definitions.type_hash(kind)
        except (*UNKNOWN, RecordError):  # a node that needs the type reports it
            continue
    try:
        simulator = Simulator(populate(_SCENE, "gibson_bot", ""), PhysicsConfig.of(scene=_SCENE))
        simulator.step()
        simulator.close()
    except GibsonSimError:  # the scene is not in the package
        return


def main() -> None:
    """Runs the server; in a forked process, runs the node."""
    requests = socket.socket(fileno=int(os.environ.pop(SOCKET_VARIABLE)))
    os.set_inheritable(requests.fileno(), False)
    logging.disable(logging.WARNING)
    _load()
    logging.disable(logging.NOTSET)
    gc.collect()
    gc.freeze()
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)
    task = NodeServer(requests).serve()
    if task is not None:
        task()
