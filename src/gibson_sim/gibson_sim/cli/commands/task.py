"""``gibson-sim task``: runs interactive tasks in a running simulation or in this process, and measures baselines."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gibson_sim.cli.environment import add_network, environment_of, require_nodes
from gibson_sim.cli.options import add_settings, settings_from_args
from gibson_sim.cli.processes import become
from gibson_sim.cli.report_file import write_json
from gibson_sim.client_config import TaskConfig
from gibson_sim.errors import ConfigError
from gibson_sim.standard.node_process import node_arguments


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "task",
        help="set up and judge interactive tasks: push-through, object-search, ...; or run a baseline on them",
        description="Without --in-process a simulation must be running: gibson-sim run --scene SCENE --robot ROBOT.",
    )
    parser.add_argument("task", nargs="?", metavar="NAME", help="name of the task")
    parser.add_argument("--list", action="store_true", help="print all tasks with their scenes, robots and baselines, and exit")
    add_settings(parser, TaskConfig, ("seed", "episodes", "baseline", "scene", "robot", "timeout"))
    parser.add_argument("--json", type=Path, metavar="FILE", help="JSON file to write, with every episode")
    parser.add_argument("--in-process", action="store_true", help="without ROS: physics and baseline in this process, one core")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="with --in-process: the end of every episode as a PNG")
    add_network(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Lists the tasks, runs one in this process, or replaces the process by the task node."""
    if args.list:
        return _list()
    if args.task is None:
        raise ConfigError("give the NAME of a task; gibson-sim task --list has them all")
    config = settings_from_args(TaskConfig, args, output=str(args.json.absolute()) if args.json else "")
    if args.in_process:
        return _in_process(config, args.pictures)
    if args.pictures:
        raise ConfigError("--pictures is for --in-process; of a running simulation take them with gibson-sim snapshot")
    require_nodes()
    environment = environment_of(args)
    become("task_node", node_arguments(config), environment)


def _list() -> int:
    from gibson_sim.tasks.registry import TASKS

    for name, task in TASKS.items():
        print(f"{name:18s} {task.about}")
        print(f"{'':18s} scene {task.scene}, robot {task.robot}; baselines {', '.join(task.baselines)}")
    return 0


def _in_process(config: TaskConfig, pictures: Path | None) -> int:
    """Runs a baseline on the episodes in this process; prints one line for each and one for all."""
    from gibson_sim.tasks.metrics import episode_line, episode_values, summary, summary_line
    from gibson_sim.tasks.registry import check_baseline, task_of
    from gibson_sim.tasks.run import TaskRun, run_episode

    task = task_of(config.task)
    check_baseline(task, config.baseline)
    found = []
    with TaskRun(task, scene=config.scene, robot=config.robot) as there:
        for seed in range(config.seed, config.seed + config.episodes):
            found.append(run_episode(there, seed, config.baseline))
            print(episode_line(seed, found[-1]), flush=True)
            if pictures is not None:
                for path in _pictures(there, pictures / f"{task.name}_{seed}.png"):
                    print(f"wrote {path}", file=sys.stderr)
    total = summary(found)
    print(summary_line(task.name, config.baseline, total))
    if config.output:
        episodes = [{"seed": config.seed + k, **episode_values(metrics)} for k, metrics in enumerate(found)]
        write_json(
            Path(config.output), {"task": task.name, "baseline": config.baseline, **episode_values(total), "all": episodes}
        )
    return 0


def _pictures(there: Any, path: Path) -> Iterator[Path]:
    from gibson_sim.picture_files import write_picture
    from gibson_sim.tasks.pictures import TaskCamera

    write_picture(path, TaskCamera(there, (480, 480)).both(480)[..., ::-1])
    yield path
