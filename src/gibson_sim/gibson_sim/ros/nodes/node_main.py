"""The ``main`` of every node: starts rclpy, reports user errors in one line, ends cleanly on SIGINT and SIGTERM."""

from __future__ import annotations

import ctypes
import faulthandler
import json
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import FrameType
from typing import Any, Literal

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from gibson_sim.errors import GibsonSimError
from gibson_sim.interrupts import Interruptible
from gibson_sim.processes.node_process import PARENT_VARIABLE
from gibson_sim.processes.shared_memory import reopen_replaced_ports
from gibson_sim.quoting import clipped
from gibson_sim.writing import cannot_write, is_disk_error, write_file

logger = logging.getLogger(__name__)

ExecutorKind = Literal["auto", "events", "standard"]
PORT_CHECK_S = 5.0
"""Wall time between two checks of the process's ports in shared memory, seconds."""


def run_node(make_node: Callable[[], Any], args: list[str] | None = None, *, interrupted: int = 0) -> None:
    """Creates a node, calls its ``spin() -> exit code`` and finally its ``close()``.

    Ends the process with the node's exit code, or with 1 and one line on stderr for a user error.

    Args:
        make_node: creates the node.
        args: ROS arguments; None = those of this process.
        interrupted: exit code if a KeyboardInterrupt ends the creation of the node or its ``spin``.
    """
    logging.addLevelName(logging.WARNING, "WARN")  # as rclpy spells it
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="%(levelname)s %(message)s")
    faulthandler.register(signal.SIGUSR1)  # prints the stack of each thread to stderr
    end_with_parent()
    keep_large_blocks()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # from rcl: missing SROS2 keys, an invalid domain, an argument that it cannot parse
        unknown = "unknown arguments: " if type(error).__name__ == "UnknownROSArgsError" else ""
        print(f"error: ROS cannot start: {unknown}{error}", file=sys.stderr, flush=True)
        sys.exit(1)
    threading.Thread(target=_reopen_replaced_ports, daemon=True).start()
    code = 0
    with _signals:
        try:
            code = _create_and_spin(make_node)
        except KeyboardInterrupt:
            code = interrupted
        except Exception:
            if not _signals.was_interrupted:
                raise
    sys.exit(code)


def _reopen_replaced_ports() -> None:
    """Looks for replaced ports of this process from time to time: its node would receive nothing through them any more."""
    while True:
        time.sleep(PORT_CHECK_S)
        if ports := reopen_replaced_ports():
            logger.info("ports in shared memory that another process has replaced are opened anew: %s", ", ".join(ports))


def is_running() -> bool:
    """Returns whether no end of the process is requested: the condition of every node's loop."""
    return rclpy.ok() and not _signals.end_requested


def spin_while(node: Node, condition: Callable[[], bool] = lambda: True) -> None:
    """Spins a node while ``condition()`` holds and no end of the process is requested; checks both at least ten times a second."""
    executor = make_executor()
    executor.add_node(node)
    while is_running() and condition():
        executor.spin_once(timeout_sec=0.1)


def make_executor(kind: ExecutorKind = "auto", *, context: Context | None = None) -> Executor:
    """Returns a single-threaded executor.

    Args:
        kind: ``events`` handles events of the middleware, at a cost that does not depend on the number of entities of a node; rclpy calls
            it experimental. ``standard`` is rclpy's SingleThreadedExecutor, which builds a wait set of all entities in every iteration:
            a quarter of a millisecond in the physics node. ``auto`` is ``events`` if rclpy has it (7.1.4 and later).
        context: context of the nodes that will be added; None = the default one.

    Raises:
        ImportError: ``events`` is requested and rclpy does not have it.
    """
    if kind == "standard":
        return SingleThreadedExecutor(context=context)
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        if kind == "events":
            raise
        logger.info("this rclpy has no EventsExecutor: the standard executor needs more CPU time")
        return SingleThreadedExecutor(context=context)
    executor: Executor = EventsExecutor(context=context)
    return executor


def write_summary(path: str, summary: dict[str, Any]) -> None:
    """Writes the summary as JSON, unless the path is empty.

    Raises:
        WriteError: the file cannot be written.
    """
    if path:
        write_file(path, json.dumps(summary, indent=2) + "\n")


def started_by_launcher() -> bool:
    """Returns whether ``gibson-sim run`` started this process."""
    return bool(os.environ.get(PARENT_VARIABLE))


PARENT_ENDED = signal.SIGHUP
"""Signal of the kernel when the launcher has ended. It comes once for each of the launcher's threads, so it is not one of those of which a second
one ends a node in the middle of its cleaning up. Nodes have their own session: no terminal sends it."""
_PR_SET_PDEATHSIG = 1
"""Number of an option of prctl(2)."""


def end_with_parent() -> None:
    """Requests from the kernel that this process ends when its launcher ends."""
    if not started_by_launcher():
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, PARENT_ENDED)
    if os.getppid() != int(os.environ[PARENT_VARIABLE]):  # the launcher ended before the call
        sys.exit(1)


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Numbers of parameters of mallopt(3)."""


def keep_large_blocks() -> None:
    """Prevents malloc from returning image-sized blocks to the kernel: page faults, not copies, dominate the cost of large messages."""
    try:
        libc = ctypes.CDLL("libc.so.6")
        libc.mallopt(_M_MMAP_THRESHOLD, 32 << 20)
        libc.mallopt(_M_TRIM_THRESHOLD, 256 << 20)
    except (OSError, AttributeError):
        logger.debug("no glibc mallopt; large messages are slightly slower")


class _Signals(Interruptible):
    """Handles SIGINT and SIGTERM: while a node spins, the first ends it after the running callback, a second one ends it immediately.

    In a node of a launcher it handles ``PARENT_ENDED`` as well, of which further ones are ignored until the process has ended.
    rclpy's own handlers would shut down the context in the middle of a callback that is about to publish.
    """

    def __init__(self) -> None:
        super().__init__(signal.SIGINT, signal.SIGTERM)
        self.spinning = self.end_requested = self._is_ending = False

    def __enter__(self) -> _Signals:
        self.spinning = self.end_requested = self._is_ending = False
        super().__enter__()
        if started_by_launcher():
            signal.signal(PARENT_ENDED, self._on_parent_ended)
        return self

    def __exit__(self, *exception: object) -> None:
        if started_by_launcher():
            signal.signal(PARENT_ENDED, signal.SIG_IGN)  # the process is ending
        super().__exit__(*exception)

    def _on_parent_ended(self, number: int, frame: FrameType | None) -> None:
        if not self._is_ending:
            self._on_signal(number, frame)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._is_ending = True
        if self.end_requested or not self.spinning:
            super()._on_signal(number, frame)
        self.end_requested = True


_signals = _Signals()


def _create_and_spin(make_node: Callable[[], Any]) -> int:
    """Creates a node, spins it and closes it; returns its exit code."""
    node = None
    code = 1
    try:
        with _errors_reported():
            node = make_node()
            guard_parameters(node)
            _signals.spinning = True
            code = int(node.spin())
    finally:
        if node is not None:
            closed = False
            with _errors_reported():
                node.close()
                closed = True
            code = code if closed else code or 1
            node.destroy_node()
        rclpy.try_shutdown()
    return code


@contextmanager
def _errors_reported() -> Iterator[None]:
    """Ends the block with one line on stderr on an error that the user can fix, such as a full disk."""
    try:
        yield
    except (GibsonSimError, OSError) as error:
        if isinstance(error, OSError) and not is_disk_error(error):
            raise
        if not _signals.was_interrupted:
            text = cannot_write(error.filename, error) if isinstance(error, OSError) else error
            print(f"error: {text}", file=sys.stderr)


# Parameter services

_Callback = Callable[[Any, Any], Any]
_READING = (DescribeParameters, GetParameters, GetParameterTypes, ListParameters)
_MAX_REASON_LENGTH = 200
"""Maximum length of the reason in a response and in the log, characters."""


def guard_parameters(node: Node) -> None:
    """Wraps the parameter services of a node so that they respond to every request, with a reason if it is refused, where rclpy would raise."""
    for service in node.services:
        if service.srv_type is SetParameters:
            service.callback = partial(_set, node, service.callback)
        elif service.srv_type is SetParametersAtomically:
            service.callback = partial(_set_atomically, node, service.callback)
        elif service.srv_type in _READING:
            service.callback = partial(_read, node, service.callback)


def _set(node: Node, callback: _Callback, request: Any, response: Any) -> Any:
    results = []
    for parameter in request.parameters:
        try:
            results += callback(SetParameters.Request(parameters=[parameter]), SetParameters.Response()).results
        except Exception as error:
            results.append(_refusal(node, error))
    response.results = results
    return response


def _set_atomically(node: Node, callback: _Callback, request: Any, response: Any) -> Any:
    try:
        return callback(request, response)
    except Exception as error:
        response.result = _refusal(node, error)
        return response


def _read(node: Node, callback: _Callback, request: Any, response: Any) -> Any:
    try:
        return callback(request, response)
    except Exception as error:
        _refusal(node, error)
        return type(response)()


def _refusal(node: Node, error: Exception) -> SetParametersResult:
    reason = clipped(str(error), _MAX_REASON_LENGTH) or type(error).__name__
    node.get_logger().warning(f"a parameter request is refused: {reason}", throttle_duration_sec=1.0)
    return SetParametersResult(successful=False, reason=reason)
