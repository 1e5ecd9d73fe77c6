"""Entry points of the nodes: Ctrl-C ends them silently while they import their modules. Imports the standard library alone."""

from __future__ import annotations

import signal
from importlib import import_module


def run(name: str) -> None:
    """Runs the ``main`` of a module of this package.

    Python's own handler would print a traceback of the import; and it sets none in a process that a shell script started in the background.

    Args:
        name: name of the module, and of the program.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    import_module(f"gibson_path_following.nodes.{name}").main()


def path_recorder() -> None:
    """Runs the path recorder."""
    run("path_recorder")


def path_localiser() -> None:
    """Runs the path localiser."""
    run("path_localiser")


def path_policy() -> None:
    """Runs the path policy."""
    run("path_policy")


def path_evaluator() -> None:
    """Runs the path evaluator."""
    run("path_evaluator")


def camera_faults() -> None:
    """Runs the camera faults."""
    run("camera_faults")


def goggles() -> None:
    """Runs Goggles."""
    run("goggles")
