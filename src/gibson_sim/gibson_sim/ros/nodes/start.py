"""Entry points of the node processes; Ctrl-C ends them silently while they import their modules.

``python -m gibson_sim.ros.nodes.start gibson_sim.ros.nodes.physics_node ...`` runs ``main`` of that module with the remaining arguments; the
functions are the executables of ``ros2 run`` and ``ros2 launch``. All other modules are imported afterwards.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Any

from gibson_sim import interrupts
from gibson_sim.errors import missing_package


def run(module: str) -> None:
    """Runs ``main`` of a module, which reads the command line from ``sys.argv``; its exit code ``INTERRUPTED`` ends the process by SIGINT."""
    interrupts.end_silently()
    from gibson_sim.processes.job_folder import leave_job

    try:
        main: Any = import_module(module).main
        main()
    except ImportError as error:
        problem = missing_package(error)
        if problem is None:
            raise
        sys.exit(f"error: {problem}")
    except SystemExit as end:
        if end.code != interrupts.INTERRUPTED:
            raise
        leave_job()
        interrupts.die()
    finally:
        interrupts.end_silently()
        leave_job()


def physics_node() -> None:
    """Runs the physics node."""
    run("gibson_sim.ros.nodes.physics_node")


def render_node() -> None:
    """Runs the render node."""
    run("gibson_sim.ros.nodes.render_node")


def drive_node() -> None:
    """Runs the drive node."""
    run("gibson_sim.ros.nodes.drive_node")


def record_node() -> None:
    """Runs the record node."""
    run("gibson_sim.ros.nodes.record_node")


def snapshot_node() -> None:
    """Runs the snapshot node."""
    run("gibson_sim.ros.nodes.snapshot_node")


def replay_node() -> None:
    """Runs the replay node."""
    run("gibson_sim.ros.nodes.replay_node")


def task_node() -> None:
    """Runs the task node."""
    run("gibson_sim.ros.nodes.task_node")


def web_node() -> None:
    """Runs the web node."""
    run("gibson_sim.ros.nodes.web_node")


def foxglove_node() -> None:
    """Runs the foxglove node."""
    run("gibson_sim.ros.foxglove.foxglove_node")


if __name__ == "__main__":
    run(sys.argv.pop(1))
