"""``gibson-sim bench lockstep``: ticks a second in processes that wait for each other, against one process."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gibson_sim.bench import timing
from gibson_sim.bench.lockstep import (
    STEP_HZ,
    Alone,
    Case,
    LockstepPlan,
    LockstepReport,
    Turns,
    case_of,
    in_turns,
    rate_of,
    targets,
)
from gibson_sim.bench.protocol import write_changed_robot
from gibson_sim.bench.render_report import table
from gibson_sim.bench.ros import Size, Spread
from gibson_sim.cli.bench_processes import CAMERA, BenchError, conversation, process
from gibson_sim.cli.environment import node_environment, require_nodes
from gibson_sim.cli.quiet import quiet
from gibson_sim.cli.report_file import add_report_options, tell, write_json
from gibson_sim.cli.shared_memory import remove_dead_segments

START_S = 90.0
"""Within so long a simulation has loaded its scene."""
_SMALLEST = Size(16, 16)
"""Of a camera that nobody listens to."""


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "lockstep",
        help="ticks a second in lockstep, without and with images, and what the processes add to one process",
        description="One physics step a tick, a controller that answers each, an image at each. Nothing else should run meanwhile.",
    )
    parser.add_argument("--quick", action="store_true", help="fewer ticks")
    parser.add_argument("--scene", help="scene (default: flat)")
    add_report_options(parser)
    parser.add_argument("--domain-id", type=int, metavar="N", help="ROS domain (default: $ROS_DOMAIN_ID, or 0)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints the table, and writes the JSON file if one is named."""
    require_nodes()
    plan = LockstepPlan.quick() if args.quick else LockstepPlan()
    if args.scene:
        plan = replace(plan, scene=args.scene)
    report = measure(plan, domain_id=args.domain_id, tell=tell)
    print(report_text(report, markdown=args.markdown))
    write_json(args.json, report.as_json())
    return 0


@quiet()
def measure(
    plan: LockstepPlan, *, domain_id: int | None = None, tell: Callable[[str], None] = lambda line: None
) -> LockstepReport:
    """Returns what was measured; a case that fails is left out, and the report says why.

    Args:
        plan: what to measure.
        domain_id: ROS domain; None = as the environment says.
        tell: is told in one line what is going on.
    """
    environment = node_environment(domain_id=domain_id, here_alone=True)
    report = LockstepReport(timing.now(), timing.version(), timing.machine(), timing.cores(), timing.load(), plan.scene)
    cases: list[Case] = []
    left_out: list[str] = []
    for size in (None, *plan.sizes):
        name = f"{size} RGB + depth at every tick" if size else "no images"
        ticks = plan.image_ticks if size else plan.ticks
        with tempfile.TemporaryDirectory(prefix="gibson-sim-bench-") as folder:
            pixels = size or _SMALLEST
            robot = write_changed_robot(Path(folder), (pixels.width, pixels.height))
            try:
                tell(f"{name}: one process and lockstep in turns")
                lockstep = _turns(plan, environment, robot, size, ticks)
                tell(f"{name}: the same in a pipeline")
                cases.append(case_of(size, lockstep, _turns(plan, environment, robot, size, ticks, "--pipelined")))
            except BenchError as error:
                left_out.append(f"{name}: {error}")
    remove_dead_segments()
    return replace(report, cases=tuple(cases), left_out=tuple(left_out))


def _turns(
    plan: LockstepPlan, environment: Mapping[str, str], robot: Path, size: Size | None, ticks: int, *further: str
) -> Turns:
    hz = str(STEP_HZ)
    options = ["--scene", plan.scene, "--robot", str(robot), "--lockstep", "--participants", "bench_controller", "--rate", "max"]
    options += ["--step-hz", hz, "--publish-hz", hz, "--clock-hz", hz]
    options += ["--camera-rate", hz, "--camera-outputs", "rgb,depth"] if size else ["--no-render"]
    command = [sys.executable, "-m", "gibson_sim.cli.main", "run", *options, *further]
    topics = [f"{CAMERA}/image_raw", f"{CAMERA}/depth/image_raw"] if size else []
    with (
        Alone(plan.scene, str(robot), size) as alone,
        process(command, environment),
        conversation(environment, "controller", START_S, topics=topics) as ask,
    ):
        return in_turns(alone, lambda count: ask({"ticks": count})["tick_ns"], ticks)


def report_text(report: LockstepReport, *, markdown: bool = False) -> str:
    """Returns the whole report, plain for the terminal or as Markdown."""
    lines = [
        f"{report.machine}; {report.cores} cores usable, load {report.load:g}; Gibson Sim {report.version}; {report.date[:10]}.",
        f"Scene {report.scene}, {STEP_HZ} Hz, one physics step a tick; milliseconds a tick, medians; one process and the others in turns.",
        *(f"Left out: {line}" for line in report.left_out),
    ]
    parts = ["\n".join(f"- {line}" if markdown else line for line in lines)]
    if report.cases:
        head = ("images", "physics", "draw", "one process", "lockstep", "ticks/s", "added", "pipelined", "ticks/s", "added")
        rows = [
            (
                f"{case.size} RGB + depth" if case.size else "none",
                *(_median(part) for part in (case.physics, case.draw, case.one_process)),
                *_way(case.lockstep, case.overheads[0]),
                *_way(case.pipelined, case.overheads[1]),
            )
            for case in report.cases
        ]
        parts.append(table(head, rows, markdown, left=(0,)))
        reached = [(t.what, t.wanted, t.measured, "met" if t.met else "MISSED") for t in targets(report.cases)]
        parts += ["Targets for two cores:", table(("what", "wanted", "measured", ""), reached, markdown, left=(0, 1, 3))]
    return "\n\n".join(parts)


def _way(ticks: Spread, added: float) -> tuple[str, str, str]:
    return _median(ticks), f"{rate_of(ticks):,.0f}", f"{100 * added:.0f} %"


def _median(part: Spread) -> str:
    return "-" if part.median != part.median else f"{part.median:.2f}"
