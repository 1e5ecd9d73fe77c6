"""``gibson-sim task``: runs interactive tasks in a running simulation or in this process, and evaluates baselines."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim.cli.environment import add_network, environment_of, require_nodes
from gibson_sim.cli.options import add_settings, settings_from_args
from gibson_sim.cli.processes import become
from gibson_sim.cli.report_file import write_json
from gibson_sim.cli.workers import add_workers, backend_of, files_of
from gibson_sim.client_config import TaskConfig
from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.processes.node_process import node_arguments
from gibson_sim.writing import write_file

if TYPE_CHECKING:
    from gibson_sim.jobs.units import Backend
    from gibson_sim.tasks.metrics import Metrics


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "task",
        help="set up and evaluate interactive tasks: push-through, object-search, ...; or run a baseline on them",
        description="Without --in-process a simulation must be running: gibson-sim run --scene SCENE --robot ROBOT.",
    )
    parser.add_argument("task", nargs="?", metavar="NAME", help="name of the task")
    parser.add_argument("--list", action="store_true", help="print all tasks with their scenes, robots and baselines, and exit")
    add_settings(parser, TaskConfig, ("seed", "episodes", "baseline", "scene", "robot", "timeout"))
    parser.add_argument("--json", type=Path, metavar="FILE", help="JSON file to write, with every episode")
    parser.add_argument(
        "--in-process", action="store_true", help="without ROS: physics and baseline in this process, or in its workers"
    )
    parser.add_argument(
        "--pictures", type=Path, metavar="DIR", help="with --in-process: write the last image of every episode as a PNG"
    )
    add_workers(parser, "with --in-process: episodes")
    add_network(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Lists the tasks, runs a task in this process, or replaces this process by the task node."""
    if args.list:
        return _list()
    if args.task is None:
        raise ConfigError("give the NAME of a task; gibson-sim task --list prints them")
    config = settings_from_args(TaskConfig, args, output=str(args.json.absolute()) if args.json else "")
    if args.in_process:
        return _in_process(config, args.pictures, backend_of(args))
    if args.workers is not None or args.ray is not None:
        raise ConfigError("--workers and --ray are for --in-process; a running simulation has one task at a time")
    if args.pictures:
        raise ConfigError("--pictures is for --in-process; for a running simulation, use gibson-sim snapshot")
    require_nodes()
    environment = environment_of(args)
    become("task_node", node_arguments(config), environment)


def _list() -> int:
    from gibson_sim.tasks.registry import TASKS

    for name, task in TASKS.items():
        print(f"{name:18s} {task.about}")
        print(f"{'':18s} scene {task.scene}, robot {task.robot}; baselines {', '.join(task.baselines)}")
    return 0


def _in_process(config: TaskConfig, pictures: Path | None, backend: Backend | None) -> int:
    """Runs a baseline on the episodes with any backend; prints one line for each episode and one for all."""
    from gibson_sim.tasks.metrics import episode_line, episode_values, summary, summary_line
    from gibson_sim.tasks.registry import check_baseline, task_of

    task = task_of(config.task)
    check_baseline(task, config.baseline)
    all_metrics: list[Metrics] = []

    def show(metrics: Metrics, picture: Path | None) -> None:
        print(episode_line(config.seed + len(all_metrics), metrics), flush=True)
        all_metrics.append(metrics)
        if picture is not None:
            print(f"wrote {picture}", file=sys.stderr)

    if backend is None:
        _run_locally(config, pictures, show)
    else:
        _run_on_workers(backend, config, pictures, show)
    total = summary(all_metrics)
    print(summary_line(task.name, config.baseline, total))
    if config.output:
        episodes = [{"seed": config.seed + k, **episode_values(metrics)} for k, metrics in enumerate(all_metrics)]
        write_json(
            Path(config.output), {"task": task.name, "baseline": config.baseline, **episode_values(total), "all": episodes}
        )
    return 0


def _run_locally(config: TaskConfig, pictures: Path | None, show: Callable[[Metrics, Path | None], None]) -> None:
    """Runs the episodes in this process; ``show`` receives metrics and image of each."""
    from gibson_sim.tasks.registry import task_of
    from gibson_sim.tasks.run import TaskRun, run_episode
    from gibson_sim.tasks.units import picture_of

    with TaskRun(task_of(config.task), scene=config.scene, robot=config.robot) as task_run:
        for seed in range(config.seed, config.seed + config.episodes):
            metrics = run_episode(task_run, seed, config.baseline)
            picture = _picture(pictures, config.task, seed)
            if picture is not None:
                picture_of(task_run, picture)
            show(metrics, picture)


def _run_on_workers(
    backend: Backend, config: TaskConfig, pictures: Path | None, show: Callable[[Metrics, Path | None], None]
) -> None:
    """Runs the episodes on workers; ``show`` receives metrics and image of each, in the order of the seeds.

    Raises:
        GibsonSimError: an episode failed; no further episodes are started.
    """
    from gibson_sim.jobs.units import Unit, UnitResult, run_units
    from gibson_sim.tasks.metrics import Metrics
    from gibson_sim.tasks.units import EPISODE, PICTURE

    values: dict[str, Any] = {"task": config.task, "scene": config.scene, "robot": config.robot, "baseline": config.baseline}
    files = files_of(values, ("scene", "robot"))
    values["files"] = [key for key in ("scene", "robot") if Path(values[key]) in files]
    seeds = {f"seed-{seed}": seed for seed in range(config.seed, config.seed + config.episodes)}
    units = [
        Unit(name, EPISODE, {**values, "seed": seed, "picture": pictures is not None}, files) for name, seed in seeds.items()
    ]
    waiting = iter(units)
    next_one = next(waiting, None)
    came: dict[str, UnitResult] = {}
    failed: list[UnitResult] = []

    def on_result(result: UnitResult) -> None:
        nonlocal next_one
        if result.stopped:
            return
        came[result.id] = result
        if result.error:
            failed.append(result)
        while next_one is not None and next_one.id in came and not failed:
            done = came.pop(next_one.id)
            picture = _picture(pictures, config.task, seeds[done.id])
            if picture is not None:
                write_file(picture, (Path(folder) / done.id / PICTURE).read_bytes())
            show(Metrics(**done.value), picture)
            next_one = next(waiting, None)

    with tempfile.TemporaryDirectory(prefix="gibson-sim-task-") as folder:
        run_units(units, backend, output=Path(folder), on_result=on_result, stop=lambda: bool(failed))
    if failed:
        raise GibsonSimError(f"episode {failed[0].id}: {failed[0].error}")


def _picture(folder: Path | None, task: str, seed: int) -> Path | None:
    """Returns the image file of an episode; None = images are not requested."""
    return None if folder is None else folder / f"{task}_{seed}.png"
