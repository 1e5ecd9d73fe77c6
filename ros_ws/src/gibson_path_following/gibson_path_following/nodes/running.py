"""Runs a node as a program: parameters that cannot be used are one line and exit code 1, Ctrl-C and SIGTERM end it in order."""

from __future__ import annotations

import logging
import signal
import sys
from collections.abc import Callable
from typing import Any, NoReturn

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from gibson_path_following.errors import PathFollowingError


def run_node(make: Callable[[], Any], args: list[str] | None = None) -> None:
    """Runs a node with ``exit_code`` (None = go on) and ``stop()``, until it ends itself or is told to; exits the program.

    Args:
        make: makes the node.
        args: of ROS; None = those of the program.
    """
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    signal.signal(signal.SIGTERM, _end)
    # No signal handlers of rclpy: the context must stay valid until the node has stopped the robot, or has written its files.
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    node, code = None, 0
    try:
        node = make()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while rclpy.ok() and node.exit_code is None:
            executor.spin_once(timeout_sec=0.5)
        code = node.exit_code or 0
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        if rclpy.ok():
            raise
    except PathFollowingError as error:
        print(f"error: {error}", file=sys.stderr)
        code = 1
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        if node is not None:
            code = max(code, _stopped(node))
            node.destroy_node()
        rclpy.try_shutdown()
    sys.exit(code)


def _stopped(node: Any) -> int:
    """Stops a node and returns 1 if that failed."""
    try:
        node.stop()
    except PathFollowingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except RCLError:
        if rclpy.ok():
            raise
    return 0


def _end(number: int, frame: object) -> NoReturn:
    """Ends the program on SIGTERM as on Ctrl-C."""
    raise KeyboardInterrupt
