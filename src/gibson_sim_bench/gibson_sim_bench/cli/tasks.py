"""``gibson-sim bench tasks``: environment steps per second by task, observation and number of processes."""

from __future__ import annotations

import argparse
from typing import Any

from gibson_sim.cli.quiet import quiet
from gibson_sim.cli.report_file import add_report_options, print_progress, write_json


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "tasks",
        help="environment steps per second by task and observation, in one process and in two; loose objects at rest and moving",
        description="Steps are those of the Gymnasium environments, with random actions. Nothing else should run on the machine.",
    )
    parser.add_argument("--tasks", nargs="+", metavar="NAME", help="names of tasks (default: all)")
    parser.add_argument(
        "--observations", nargs="+", metavar="KIND", default=["state", "rgbd"], help="state, rgbd (default: both)"
    )
    parser.add_argument(
        "--processes", nargs="+", type=int, default=[1, 2], metavar="N", help="numbers of processes (default: 1 2)"
    )
    parser.add_argument("--scene", default="", help="scene of all tasks (default: that of each task)")
    parser.add_argument("--steps", type=int, default=200, help="steps of each case (default: 200)")
    parser.add_argument("--size", type=int, default=256, help="width and height of images, pixels (default: 256)")
    parser.add_argument(
        "--loose-scene", default="flat", metavar="SCENE", help="scene with 50 loose objects; none = not measured (default: flat)"
    )
    add_report_options(parser)
    parser.set_defaults(run=run)


@quiet()
def run(args: argparse.Namespace) -> int:
    """Prints the report, and writes the JSON file if one is named."""
    from gibson_sim.tasks.registry import TASKS
    from gibson_sim_bench.tasks import TaskPlan, measure, report_text

    plan = TaskPlan(
        tasks=tuple(args.tasks or TASKS),
        observations=tuple(args.observations),
        processes=tuple(args.processes),
        scene=args.scene,
        steps=args.steps,
        size=args.size,
        loose_scene="" if args.loose_scene == "none" else args.loose_scene,
    )
    report = measure(plan, progress=print_progress)
    print(report_text(report, markdown=args.markdown))
    write_json(args.json, report.as_json())
    return 0
