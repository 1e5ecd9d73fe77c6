"""Episodes as units of work for ``jobs``.

Each has a ``TaskRun`` of its own: what Bullet remembers of the pairs that came near each other in one episode changes how piles are pushed in
the next one, and which episodes a process ran before must not matter.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim.tasks.registry import task_of
from gibson_sim.tasks.run import TaskRun, run_episode

if TYPE_CHECKING:
    from gibson_sim.jobs.units import Context

EPISODE = "gibson_sim.tasks.units:run_one"
PICTURE = "end.png"
"""File of the unit with the end of the episode."""


def run_one(arguments: dict[str, Any], folder: Path, context: Context) -> dict[str, Any]:
    """Runs one episode with a baseline; returns its ``Metrics`` as values of JSON.

    Args:
        arguments: ``task``, ``scene``, ``robot``, ``baseline``, ``seed``, ``files`` (those of them that are files of the unit), ``picture``.
        folder: for the picture.
        context: of the unit.
    """
    scene, robot = (
        str(context.path(arguments[name])) if name in arguments["files"] else arguments[name] for name in ("scene", "robot")
    )
    with TaskRun(task_of(arguments["task"]), scene=scene, robot=robot) as run:
        metrics = run_episode(run, arguments["seed"], arguments["baseline"])
        if arguments["picture"]:
            picture_of(run, folder / PICTURE)
    return asdict(metrics)


def picture_of(run: TaskRun, path: Path) -> None:
    """Draws the present state of a run into a file: the robot's camera image beside one from above."""
    from gibson_sim.picture_files import write_picture
    from gibson_sim.tasks.pictures import TaskCamera

    write_picture(path, TaskCamera(run, (480, 480)).both(480)[..., ::-1])
