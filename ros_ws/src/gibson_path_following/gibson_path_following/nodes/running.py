"""Runs a node as a program: ``--help`` describes it, an error is one line and an exit code, and Ctrl-C and SIGTERM end it cleanly."""

from __future__ import annotations

import inspect
import logging
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from gibson_path_following.errors import PathFollowingError, SettingError, quoted
from gibson_path_following.options import Options, describe

_PARAMETER = "NAME:=VALUE, such as -p use_sim_time:=true; --help lists the parameters"
_TOPIC = "TOPIC:=OTHER_TOPIC, such as -r odom:=wheel_odom; --help lists the topics"
_RULES = {"-p": _PARAMETER, "--param": _PARAMETER, "-r": _TOPIC, "--remap": _TOPIC}
"""Arguments of ROS that are followed by a rule, and its form."""


def run_node(kind: type[Any], options: type[Options], args: list[str] | None = None) -> None:
    """Runs a node with ``exit_code`` (None = go on) and ``stop()``, until it ends itself or gets SIGINT or SIGTERM; exits the program.

    Args:
        kind: class of the node.
        options: its parameters.
        args: arguments of the program; None = those of this process.
    """
    args = sys.argv[1:] if args is None else args
    if {"-h", "--help"} & set(args):
        _print(help_text(kind, options))
        sys.exit(0)
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    # Before there is a node nothing has to end in order; KeyboardInterrupt would leave a traceback of rclpy.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Python has surrogates for bytes that are not UTF-8; rclpy cannot encode them.
    if unreadable := [arg for arg in args if any("\ud800" <= character <= "\udfff" for character in arg)]:
        print(f"error: argument {quoted(unreadable[0])} is not UTF-8", file=sys.stderr)
        sys.exit(1)
    if wrong := _wrong_rule(args):  # rcl's text is long, and does not say what is right
        print(f"error: {wrong}", file=sys.stderr)
        sys.exit(1)
    try:
        # No signal handlers of rclpy: the context must stay valid until the node has stopped the robot, or has written its files.
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # an argument that rcl cannot parse, an invalid domain, missing SROS2 keys
        unknown = "unknown ROS arguments: " if type(error).__name__ == "UnknownROSArgsError" else ""
        print(f"error: ROS cannot start: {unknown}{error}", file=sys.stderr)
        sys.exit(1)
    node, code, end = None, 0, _End()
    try:
        # Python sets no handler of SIGINT in a process that a shell script started in the background.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, end)
        if others := remove_ros_args(args):
            raise SettingError(
                f"argument {quoted(others[0])} is unknown; parameters are given as --ros-args -p NAME:=VALUE; --help lists them"
            )
        try:
            node = kind()
        except Exception:
            if end.is_requested:  # imports, such as that of onnxruntime, turn KeyboardInterrupt into other errors
                raise KeyboardInterrupt from None
            raise
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while rclpy.ok() and node.exit_code is None and not end.is_requested:
            executor.spin_once(timeout_sec=0.5)
        code = node.exit_code or 0
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        if rclpy.ok():
            raise
    except (PathFollowingError, InvalidParameterTypeException) as error:  # the latter of a parameter of ROS: use_sim_time
        print(f"error: {error}", file=sys.stderr)
        code = 1
    finally:
        # ros2 launch sends a second SIGINT after that of the terminal.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        if node is not None:
            code = max(code, _stopped(node))
            node.destroy_node()
        rclpy.try_shutdown()
    sys.exit(code)


def help_text(kind: type[Any], options: type[Options]) -> str:
    """Returns what ``--help`` prints: what a node does, its topics and services by its docstring, and its parameters."""
    about = "\n\n".join(part for part in inspect.cleandoc(kind.__doc__ or "").split("\n\n") if not part.startswith("Parameters:"))
    return (
        f"usage: {Path(sys.argv[0]).stem} [--ros-args [-p PARAMETER:=VALUE]... [-r TOPIC:=OTHER_TOPIC]... [--params-file FILE]]\n\n"
        f"{about.replace('``', '')}\n\nParameters:\n{describe(options)}"
    )


def _print(text: str) -> None:
    """Prints a text; a reader that ends, as in ``path_policy --help | head``, is no error."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes the rest of the text at its end


def pop_queue(subscription: Any) -> Iterator[Any]:
    """Yields all messages in a subscription's queue; the executor would call back for one after another."""
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            yield taken[0]


def _wrong_rule(args: list[str]) -> str | None:
    """Returns the line about the first parameter or renamed topic that lacks := or a side of it; None = there is none."""
    is_ros = False
    for option, rule in zip(args, [*args[1:], ""], strict=False):
        is_ros = option == "--ros-args" or (is_ros and option != "--")
        if is_ros and option in _RULES and not all(rule.partition(":=")):
            return f"argument {option} {quoted(rule)} is not {_RULES[option]}"
    return None


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


class _End:
    """Handler of SIGINT and SIGTERM, which end the program."""

    is_requested = False

    def __call__(self, number: int, frame: object) -> NoReturn:
        """Raises KeyboardInterrupt."""
        self.is_requested = True
        raise KeyboardInterrupt
