"""``gibson-sim bench learning``: environment steps per second for reinforcement learning, by number of environments and configuration."""

from __future__ import annotations

import argparse
from typing import Any

from gibson_sim.cli.quiet import quiet
from gibson_sim.cli.report_file import add_report_options, print_progress, write_json


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "learning",
        help="steps per second of many environments: each in its own process, or in one process with one renderer for all",
        description="Random actions; resets of episodes are included. Nothing else should run on the machine.",
    )
    parser.add_argument("--task", default="point-goal", help="name of a task (default: point-goal)")
    parser.add_argument("--scene", default="", help="name or path of a scene (default: that of the task)")
    parser.add_argument(
        "--observations", nargs="+", metavar="KIND", default=["state", "rgbd"], help="state, rgbd (default: both)"
    )
    parser.add_argument(
        "--environments",
        nargs="+",
        type=int,
        default=[1, 2, 4, 8],
        metavar="N",
        help="numbers of environments (default: 1 2 4 8)",
    )
    parser.add_argument("--no-batched", action="store_true", help="do not measure environments that share a renderer")
    parser.add_argument("--seconds", type=float, default=20.0, help="duration of each case, seconds (default: 20)")
    parser.add_argument("--size", type=int, default=128, help="width and height of images, pixels (default: 128)")
    parser.add_argument("--control-hz", type=int, default=10, help="actions per second of simulation time (default: 10)")
    parser.add_argument("--step-hz", type=int, default=240, help="physics steps per second of simulation time (default: 240)")
    add_report_options(parser)
    parser.set_defaults(run=run)


@quiet()
def run(args: argparse.Namespace) -> int:
    """Prints the report, and writes the JSON file if one is named."""
    from gibson_sim_bench.learning import LearningPlan, measure, report_text

    plan = LearningPlan(
        task=args.task,
        scene=args.scene,
        observations=tuple(args.observations),
        environments=tuple(args.environments),
        batched=not args.no_batched,
        seconds=args.seconds,
        size=args.size,
        control_hz=args.control_hz,
        step_hz=args.step_hz,
    )
    report = measure(plan, progress=print_progress)
    print(report_text(report, markdown=args.markdown))
    write_json(args.json, report.as_json())
    return 0
