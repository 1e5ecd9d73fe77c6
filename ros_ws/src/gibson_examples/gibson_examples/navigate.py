"""``python -m gibson_examples.navigate``: runs the navigation node until Ctrl-C or, with ``exit_at_goal``, until its goal."""

from __future__ import annotations

import signal
import sys
from typing import NoReturn

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from gibson_examples.errors import NavigationError
from gibson_examples.node import NavigateNode, configure_logging


def _end(number: int, frame: object) -> NoReturn:
    """Ends the program on SIGTERM as on Ctrl-C."""
    raise KeyboardInterrupt


def main(args: list[str] | None = None) -> None:
    """Runs the node; exits with 0, or with 1 and one line on stderr if a parameter is invalid or the goal failed."""
    configure_logging()
    signal.signal(signal.SIGTERM, _end)
    # No signal handlers of rclpy: the context must stay valid until the robot has been stopped.
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    node, code = None, 0
    try:
        node = NavigateNode()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while rclpy.ok() and node.exit_code is None:
            executor.spin_once(timeout_sec=0.1)  # Ctrl-C is seen after it
        code = node.exit_code or 0
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        if rclpy.ok():
            raise
    except NavigationError as error:
        print(f"error: {error}", file=sys.stderr)
        code = 1
    finally:
        if node is not None:
            node.stop()
            node.destroy_node()
        rclpy.try_shutdown()
    sys.exit(code)


if __name__ == "__main__":
    main()
