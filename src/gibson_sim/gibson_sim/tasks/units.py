"""Episodes as units of work for ``jobs``. A worker process keeps its ``TaskRun``, but each episode resets the engine, so that no episode depends
on earlier ones.
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
"""File of the unit with a picture of the end of the episode."""
_KEPT: dict[tuple[str, str, str], TaskRun] = {}
"""(task, scene, robot) -> the run of this process, at most one."""


def run_one(arguments: dict[str, Any], folder: Path, context: Context) -> dict[str, Any]:
    """Runs one episode with a baseline; returns its ``Metrics`` as JSON values.

    Args:
        arguments: ``task``, ``scene``, ``robot``, ``baseline``, ``seed``, ``picture``, and ``files``: arguments that are files of the unit.
        folder: folder for the picture.
        context: context of the unit.
    """
    scene, robot = (
        str(context.path(arguments[name])) if name in arguments["files"] else arguments[name] for name in ("scene", "robot")
    )
    key = (arguments["task"], scene, robot)
    if key not in _KEPT:
        while _KEPT:
            _KEPT.popitem()[1].close()
        _KEPT[key] = TaskRun(task_of(arguments["task"]), scene=scene, robot=robot)
    run = _KEPT[key]
    metrics = run_episode(run, arguments["seed"], arguments["baseline"])
    if arguments["picture"]:
        picture_of(run, folder / PICTURE)
    return asdict(metrics)


def picture_of(run: TaskRun, path: Path) -> None:
    """Renders the current state of a run to a file: the robot's camera image beside a top view."""
    from gibson_sim.picture_files import write_picture
    from gibson_sim.tasks.pictures import TaskCamera

    write_picture(path, TaskCamera(run, (480, 480)).camera_and_top_view(480)[..., ::-1])
