"""``gibson-sim bench lockstep``: ticks per second in lockstep, compared with one process and without ROS."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from gibson_sim.cli.environment import domain_of, node_environment, require_nodes
from gibson_sim.cli.quiet import quiet
from gibson_sim.cli.report_file import add_report_options, print_progress, write_json
from gibson_sim.processes.shared_memory import remove_dead_segments
from gibson_sim_bench import timing
from gibson_sim_bench.cli.processes import CAMERA, BenchError, background_node, node_session, process
from gibson_sim_bench.lockstep import (
    CONFIGURATIONS,
    ONE_PROCESS,
    PIPELINED,
    InProcessTicks,
    LockstepCase,
    LockstepPlan,
    LockstepReport,
    TickTimes,
    case_of,
    measure_interleaved,
    rate_of,
    targets,
)
from gibson_sim_bench.protocol import STEP_HZ, SUBSTEPS, write_changed_robot
from gibson_sim_bench.reports.render import table
from gibson_sim_bench.ros import Size, Spread

_COLUMNS = (
    "no ROS: physics and rendering, one after the other. One process: both nodes in one process and thread, a controller in another that\n"
    "replies to each tick and receives the images. Lockstep: each node in its own process. Split overhead: relative to one process; ROS\n"
    "overhead: relative to no ROS."
)
_DOMAINS = 233
"""Number of ROS domains."""
START_S = 90.0
"""Timeout for a simulation to load its scene, seconds of wall time."""
_SMALLEST = Size(16, 16)
"""Image size of a camera without subscribers."""


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "lockstep",
        help="ticks per second in lockstep, without and with images, and the overhead of separate processes",
        description="A controller replies to each tick. Nothing else should run on the machine.",
    )
    parser.add_argument("--quick", action="store_true", help="fewer ticks")
    parser.add_argument("--scene", help="scene (default: flat)")
    parser.add_argument("--substeps", type=int, choices=SUBSTEPS, help="physics steps of 1/240 s per tick (default: 1)")
    add_report_options(parser)
    parser.add_argument("--domain-id", type=int, metavar="N", help="ROS domain (default: $ROS_DOMAIN_ID, or 0)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints the report, and writes the JSON file if one is named."""
    require_nodes()
    plan = LockstepPlan.quick() if args.quick else LockstepPlan()
    if args.scene:
        plan = replace(plan, scene=args.scene)
    if args.substeps:
        plan = replace(plan, substeps=args.substeps)
    report = measure(plan, domain_id=args.domain_id, progress=print_progress)
    print(report_text(report, markdown=args.markdown))
    write_json(args.json, report.as_json())
    return 0


@quiet()
def measure(
    plan: LockstepPlan, *, domain_id: int | None = None, progress: Callable[[str], None] = lambda line: None
) -> LockstepReport:
    """Returns the measurements; a case that fails is left out, and the report says why.

    Args:
        plan: what to measure.
        domain_id: ROS domain; None = that of the environment.
        progress: called with one line of progress.
    """
    facts = timing.now(), timing.version(), timing.machine(), timing.cores(), timing.load()
    report = LockstepReport(*facts, plan.scene, substeps=plan.substeps)
    cases: list[LockstepCase] = []
    left_out: list[str] = []
    for size in (None, *plan.sizes):
        name = f"{size} RGB + depth at every tick" if size else "no images"
        with tempfile.TemporaryDirectory(prefix="gibson-sim-bench-") as folder:
            pixels = size or _SMALLEST
            robot = write_changed_robot(Path(folder), (pixels.width, pixels.height), lidar=False)
            try:
                progress(f"{name}: all configurations, interleaved")
                cases.append(case_of(size, _tick_times(plan, domain_id, robot, size)))
            except BenchError as error:
                left_out.append(f"{name}: {error}")
    remove_dead_segments()
    return replace(report, cases=tuple(cases), left_out=tuple(left_out))


def _tick_times(plan: LockstepPlan, domain_id: int | None, robot: Path, size: Size | None) -> TickTimes:
    """Returns the durations of ticks in all configurations; each with ROS has its own domain."""
    hz = STEP_HZ // plan.substeps
    settings: dict[str, Any] = {
        "scene": plan.scene,
        "robot": str(robot),
        "lockstep": True,
        "participants": "bench_controller",
        "rate": 0.0,
    }
    settings |= {"step_hz": STEP_HZ, "publish_hz": hz, "clock_hz": hz}
    settings |= {"camera_rate": float(hz), "camera_outputs": "rgb,depth"} if size else {}
    topics = [f"{CAMERA}/image_raw", f"{CAMERA}/depth/image_raw"] if size else []
    first = domain_of(node_environment(domain_id=domain_id))
    with_ros: dict[str, Callable[[int], Sequence[int]]] = {}
    with ExitStack() as stack:
        in_process = stack.enter_context(InProcessTicks(plan.scene, robot, size, plan.substeps))
        for number, configuration in enumerate(CONFIGURATIONS):
            if configuration == ONE_PROCESS and not size:
                continue  # without images there is one node, as in lockstep
            environment = node_environment(domain_id=(first + number) % _DOMAINS)
            if configuration == ONE_PROCESS:
                both = {**settings, "participants": "render;bench_controller"}
                stack.enter_context(background_node(environment, ONE_PROCESS, physics=both, render={}))
            else:
                stack.enter_context(process(_command(settings, bool(size), configuration == PIPELINED), environment))
            request = stack.enter_context(
                node_session(environment, "controller", START_S, cases=[topics], substeps=plan.substeps)
            )
            with_ros[configuration] = partial(_make_ticks, request)
        return measure_interleaved(in_process, with_ros, plan.image_ticks if size else plan.ticks)


def _command(settings: Mapping[str, Any], renders: bool, pipelined: bool) -> list[str]:
    """Returns the command that starts a simulation with the settings of its physics node."""
    command = [sys.executable, "-m", "gibson_sim.cli.main", "run"]
    for name, value in {**settings, "rate": "max", "pipelined": pipelined}.items():
        option = f"--{name.replace('_', '-')}"
        command += [option] * value if isinstance(value, bool) else [option, str(value)]
    return command if renders else [*command, "--no-render"]


def _make_ticks(request: Callable[[Mapping[str, Any]], dict[str, Any]], count: int) -> Sequence[int]:
    found: list[int] = request({"case": 0, "ticks": count})["tick_ns"]
    return found


def report_text(report: LockstepReport, *, markdown: bool = False) -> str:
    """Returns the whole report, plain for the terminal or as Markdown."""
    lines = [
        f"{report.machine}; {report.cores} cores usable, load {report.load:g}; Gibson Sim {report.version}; {report.date[:10]}.",
        f"Scene {report.scene}, {STEP_HZ} Hz, physics steps per tick: {report.substeps}; median milliseconds per tick; interleaved.",
        *(f"Left out: {line}" for line in report.left_out),
    ]
    parts = ["\n".join(f"- {line}" if markdown else line for line in lines)]
    if report.cases:
        head = (
            *("images", "physics", "render", "no ROS", "one process"),
            *("lockstep", "ticks/s", "split overhead", "ROS overhead", "pipelined", "ticks/s", "split overhead"),
        )
        rows = [
            (
                f"{case.size} RGB + depth" if case.size else "none",
                *(_median(part) for part in (case.physics, case.draw, case.without_ros, case.one_process)),
                *_configuration(case.lockstep, case.split[0]),
                _percent(case.ros),
                *_configuration(case.pipelined, case.split[1]),
            )
            for case in report.cases
        ]
        parts.append(table(head, rows, markdown, left=(0,)))
        parts.append(_COLUMNS)
        reached = [(t.what, t.wanted, t.measured, "met" if t.met else "MISSED") for t in targets(report.cases, report.substeps)]
        if reached:
            parts += [
                "Targets for two cores:",
                table(("measurement", "target", "measured", ""), reached, markdown, left=(0, 1, 3)),
            ]
    return "\n\n".join(parts)


def _configuration(ticks: Spread, split: float) -> tuple[str, str, str]:
    return _median(ticks), f"{rate_of(ticks):,.0f}", _percent(split)


def _percent(fraction: float) -> str:
    return "-" if fraction != fraction else f"{100 * fraction:.0f} %"


def _median(part: Spread) -> str:
    return "-" if part.median != part.median else f"{part.median:.2f}"
