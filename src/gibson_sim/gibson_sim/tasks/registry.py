"""All tasks by name."""

from __future__ import annotations

from gibson_sim.errors import ConfigError
from gibson_sim.tasks.kinds.object_search import ObjectSearch
from gibson_sim.tasks.kinds.open_cabinet import OpenCabinet
from gibson_sim.tasks.kinds.open_door import OpenDoor
from gibson_sim.tasks.kinds.pick_and_place import PickAndPlace
from gibson_sim.tasks.kinds.point_goal import PointGoal
from gibson_sim.tasks.kinds.push_through import PushThrough
from gibson_sim.tasks.task import Task

TASKS: dict[str, Task] = {
    task.name: task for task in (PointGoal(), PushThrough(), ObjectSearch(), OpenDoor(), OpenCabinet(), PickAndPlace())
}
"""Name -> task."""


def task_of(name: str) -> Task:
    """Returns a task by its name.

    Raises:
        ConfigError: the task does not exist.
    """
    if name not in TASKS:
        raise ConfigError(f"task {name!r} is unknown; known: {', '.join(TASKS)}")
    return TASKS[name]


def check_baseline(task: Task, baseline: str) -> None:
    """Checks that a task has a baseline.

    Raises:
        ConfigError: the task has no baseline of this name.
    """
    if baseline not in task.baselines:
        raise ConfigError(f"task {task.name}: baseline {baseline!r} is unknown; known: {', '.join(task.baselines)}")
