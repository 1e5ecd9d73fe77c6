"""The ``main`` of every node: starts rclpy, reports user errors in one line, stops cleanly on SIGINT and SIGTERM."""

from __future__ import annotations

import ctypes
import faulthandler
import json
import logging
import os
import signal
import sys
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
from gibson_sim.quoting import clipped
from gibson_sim.writing import cannot_write, is_of_the_disk, write_file

logger = logging.getLogger(__name__)

ExecutorKind = Literal["auto", "events", "standard"]


def run_node(make: Callable[[], Any], args: list[str] | None = None) -> None:
    """Makes the node, calls its ``spin() -> exit code`` and, whatever happens, its ``close()``.

    Ends the process with the node's code, or with 1 and one line on stderr for a user's error.
    """
    logging.addLevelName(logging.WARNING, "WARN")  # as rclpy spells it
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="%(levelname)s %(message)s")
    faulthandler.register(signal.SIGUSR1)  # prints the stack of each thread on stderr
    end_with_parent()
    keep_large_blocks()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except (
        RuntimeError
    ) as error:  # of rcl: SROS2 keys that are missing, a domain that does not exist, an argument it cannot parse
        unknown = "unknown arguments: " if type(error).__name__ == "UnknownROSArgsError" else ""
        print(f"error: ROS cannot start: {unknown}{error}", file=sys.stderr, flush=True)
        sys.exit(1)
    code = 0
    with _signals:
        try:
            code = _make_and_spin(make)
        except KeyboardInterrupt:
            pass
        except Exception:
            if not _signals.was_interrupted:
                raise
    sys.exit(code)


def is_running() -> bool:
    """Returns whether the process has not been asked to end: the condition of every node's loop."""
    return rclpy.ok() and not _signals.asked


def spin_while(node: Node, condition: Callable[[], bool] = lambda: True) -> None:
    """Spins a node while ``condition()`` holds and the process is not asked to end; checks both at least ten times a second."""
    executor = make_executor()
    executor.add_node(node)
    while is_running() and condition():
        executor.spin_once(timeout_sec=0.1)


def make_executor(kind: ExecutorKind = "auto", *, context: Context | None = None) -> Executor:
    """Returns a single-threaded executor.

    Args:
        kind: ``events`` reacts to events of the middleware at a cost that does not grow with the number of a node's entities; rclpy
            calls it experimental. ``standard`` is rclpy's SingleThreadedExecutor, which at every turn builds a wait set of all
            entities: a quarter of a millisecond in the physics node. ``auto`` is ``events`` where rclpy has it (7.1.4 and later).
        context: of the nodes to come; None = the default one.

    Raises:
        ImportError: ``events`` is requested and rclpy has none.
    """
    if kind == "standard":
        return SingleThreadedExecutor(context=context)
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        if kind == "events":
            raise
        logger.info("this rclpy has no EventsExecutor: the standard executor takes more of a processor")
        return SingleThreadedExecutor(context=context)
    executor: Executor = EventsExecutor(context=context)
    return executor


def write_summary(path: str, summary: dict[str, Any]) -> None:
    """Writes the summary as JSON; an empty path = nowhere.

    Raises:
        WriteError: it cannot be written.
    """
    if path:
        write_file(path, json.dumps(summary, indent=2) + "\n")


def started_by_launcher() -> bool:
    """Returns whether ``gibson-sim run`` started this process."""
    return bool(os.environ.get(PARENT_VARIABLE))


_PR_SET_PDEATHSIG = 1
"""Option of prctl(2)."""


def end_with_parent() -> None:
    """Asks the kernel to end this process when the launcher that started it ends."""
    if not started_by_launcher():
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(os.environ[PARENT_VARIABLE]):  # it ended before the call
        sys.exit(1)


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Parameters of mallopt(3)."""


def keep_large_blocks() -> None:
    """Keeps malloc from returning image-sized blocks to the kernel: page faults, not copies, bound large messages."""
    try:
        libc = ctypes.CDLL("libc.so.6")
        libc.mallopt(_M_MMAP_THRESHOLD, 32 << 20)
        libc.mallopt(_M_TRIM_THRESHOLD, 256 << 20)
    except (OSError, AttributeError):
        logger.debug("no glibc mallopt here; large messages are a little slower")


class _Signals(Interruptible):
    """SIGINT and SIGTERM: while a node spins, the first asks it to end after the present callback, a second one ends it at once.

    rclpy's own handlers would end the context in the middle of a callback that is about to publish.
    """

    def __init__(self) -> None:
        super().__init__(signal.SIGINT, signal.SIGTERM)
        self.spinning = self.asked = False

    def __enter__(self) -> _Signals:
        self.spinning = self.asked = False
        super().__enter__()
        return self

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self.asked or not self.spinning:
            super()._on_signal(number, frame)
        self.asked = True


_signals = _Signals()


def _make_and_spin(make: Callable[[], Any]) -> int:
    """Makes a node, spins it and closes it; returns its exit code."""
    node = None
    code = 1
    try:
        with _errors_reported():
            node = make()
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
    """Ends the block with one line on stderr at an error that the user can fix, such as a full disk."""
    try:
        yield
    except (GibsonSimError, OSError) as error:
        if isinstance(error, OSError) and not is_of_the_disk(error):
            raise
        if not _signals.was_interrupted:
            text = cannot_write(error.filename, error) if isinstance(error, OSError) else error
            print(f"error: {text}", file=sys.stderr)


# Parameter services

_Callback = Callable[[Any, Any], Any]
_READING = (DescribeParameters, GetParameters, GetParameterTypes, ListParameters)
_LONGEST_REASON = 200
"""Characters of the reason in an answer and in the log."""


def guard_parameters(node: Node) -> None:
    """Makes the parameter services of a node answer every request, with a reason for what is refused, where rclpy would raise."""
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
    reason = clipped(str(error), _LONGEST_REASON) or type(error).__name__
    node.get_logger().warning(f"a parameter request is refused: {reason}", throttle_duration_sec=1.0)
    return SetParametersResult(successful=False, reason=reason)
