"""``gibson-sim bench table1``: the paper's table, in this process, in lockstep and free-running over ROS."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gibson_sim.cli.environment import node_environment, require_nodes
from gibson_sim.cli.quiet import quiet
from gibson_sim.cli.report_file import add_report_options, chosen, parse_device, print_progress, require_device, write_json
from gibson_sim.processes.shared_memory import remove_dead_segments
from gibson_sim.types import OUTPUTS
from gibson_sim_bench.cli.processes import CAMERA, BenchError, background_node, node_result, node_session, process
from gibson_sim_bench.protocol import PARTS, STEP_HZ, TICK_WARM_UP, Table1Plan, write_robot
from gibson_sim_bench.reports.paper import MODE_GROUPS, MODES, PHYSICS_SIZE, Mode
from gibson_sim_bench.reports.table1 import report_text
from gibson_sim_bench.rows import FREE, HOST, IN_PROCESS, LOCKSTEP, Table1, Table1Row, free_row

START_S = 120.0
"""Timeout for a simulation to load its scene, seconds of wall time."""
_TOPIC: dict[str, str] = {
    "rgb": f"{CAMERA}/image_raw",
    **{name: f"{CAMERA}/{name}/image_raw" for name in OUTPUTS if name != "rgb"},
}
_ROUND_TRIPS = 60
"""Timed round trips of the messages of each mode."""
_MIN_RECEIVED = 0.9
"""Fraction of the images in lockstep that must have arrived by the last tick."""
Progress = Callable[[str], None]


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "table1",
        help="the paper's table: frames per second by mode, with full physics and rendering only, in process and over ROS",
        description="The paper's rows, the limits measured with them, and the fraction that is reached. Nothing else should run on the machine.",
    )
    parser.add_argument("--quick", action="store_true", help="24 substeps and 1 only, fewer frames")
    parser.add_argument("--only", default="", metavar="A,B", help=f"some of {', '.join(PARTS)} (default: all)")
    parser.add_argument("--scene", help=f"scene with physics (default: {Table1Plan().scene})")
    parser.add_argument(
        "--house",
        action="append",
        default=[],
        metavar="X",
        help="scene of the rendering-only part instead of the built-in ones, name or path; may be repeated",
    )
    parser.add_argument("--device", help="EGL device for measurements in this process, as `gibson-sim doctor` lists them")
    add_report_options(parser)
    parser.add_argument("--domain-id", type=int, metavar="N", help="ROS domain (default: $ROS_DOMAIN_ID, or 0)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints the report, and writes the JSON file if one is named."""
    plan = plan_of(args)
    require_device(plan.device)
    if {LOCKSTEP, FREE} & set(plan.parts):
        require_nodes()
    report = measure(plan, domain_id=args.domain_id, progress=print_progress)
    print(report_text(report, markdown=args.markdown))
    write_json(args.json, report.as_json())
    return 0


def plan_of(args: argparse.Namespace) -> Table1Plan:
    """Returns the plan of the options.

    Raises:
        ConfigError: an option is invalid.
    """
    plan = replace(Table1Plan.quick() if args.quick else Table1Plan(), parts=chosen(args.only, PARTS))
    return replace(
        plan, scene=args.scene or plan.scene, scan_scenes=tuple(args.house) or plan.scan_scenes, device=parse_device(args.device)
    )


@quiet()
def measure(plan: Table1Plan, *, domain_id: int | None = None, progress: Progress = lambda line: None) -> Table1:
    """Returns the measurements; what fails over ROS is left out, and the report says why.

    Args:
        plan: parts and number of measurements; rows over ROS also need those in process, whose limits they share.
        domain_id: ROS domain; None = that of the environment.
        progress: called with one line of progress.
    """
    from gibson_sim_bench.table1 import LockstepRunner, measure as measure_here

    over_ros = [part for part in (LOCKSTEP, FREE) if part in plan.parts]
    with tempfile.TemporaryDirectory(prefix="gibson-sim-bench-") as folder:
        robot = write_robot(Path(folder), PHYSICS_SIZE)
        environment = node_environment(domain_id=domain_id) if over_ros else {}
        message_ms: dict[str, dict[str, float]] = {}
        left_out: list[str] = []
        if over_ros:
            progress("messages alone")
            try:
                message_ms = _message_ms(environment)
            except BenchError as error:
                left_out.append(f"{', '.join(over_ros)}: {error}")
                over_ros = []
        lockstep = (
            LockstepRunner(partial(_lockstep, plan, environment, robot, left_out), message_ms) if LOCKSTEP in over_ros else None
        )
        parts = tuple(dict.fromkeys((*plan.parts, *((IN_PROCESS,) if over_ros else ()))))
        report = measure_here(replace(plan, parts=parts), robot, progress, lockstep)
        rows = list(report.rows)
        in_process = {(r.mode, r.substeps): r for r in rows if r.way == IN_PROCESS and r.substeps and r.to == HOST}
        for substeps, modes in ((k, group) for k in plan.substeps for group in MODE_GROUPS) if FREE in over_ros else ():
            what = f"{FREE}: {substeps} substeps, {', '.join(mode.name for mode in modes)}"
            progress(what)
            try:
                rows += _free(plan, environment, robot, substeps, modes, in_process, message_ms)
            except BenchError as error:
                left_out.append(f"{what}: {error}")
        remove_dead_segments()
    return replace(report, rows=tuple(rows), left_out=tuple(left_out))


def _message_ms(environment: Mapping[str, str]) -> dict[str, dict[str, float]]:
    """Returns the milliseconds of the messages, measured alone, by mode and stage."""
    outputs = [list(mode.outputs) for mode in MODES]
    width, height = PHYSICS_SIZE
    with background_node(environment, "image_pong", outputs=outputs):
        options = {"outputs": outputs, "width": width, "height": height, "bodies": 50, "count": _ROUND_TRIPS}
        rows = node_result(environment, "image_ping", 30.0, **options)["rows"]
    return {mode.name: row for mode, row in zip(MODES, rows, strict=True)}


@contextmanager
def _lockstep(
    plan: Table1Plan, environment: Mapping[str, str], robot: Path, left_out: list[str], substeps: int, modes: Sequence[Mode]
) -> Iterator[Callable[[int, int], Sequence[float]]]:
    """Runs a simulation in lockstep, and yields a function that makes ticks of one mode; appends an error to ``left_out``."""
    topics = [[_TOPIC[output] for output in mode.outputs] for mode in modes]
    failed: list[BenchError] = []

    def make_ticks(index: int, count: int) -> Sequence[float]:
        if failed:
            return []
        ticks = count + TICK_WARM_UP
        try:
            found = ask({"case": index, "ticks": ticks})
            if topics[index] and found["sets"] < _MIN_RECEIVED * ticks:
                raise BenchError(f"{found['sets']} sets of images received in {ticks} ticks")
        except BenchError as error:
            failed.append(BenchError(f"{LOCKSTEP}, {modes[index].name} with {substeps} substeps and those after it: {error}"))
            return []
        seconds: list[float] = (np.diff(found["tick_ns"])[TICK_WARM_UP:] / 1e9).tolist()
        return seconds

    try:
        with (
            process(_command(LOCKSTEP, plan.scene, robot, substeps, modes), environment),
            node_session(environment, "controller", START_S, cases=topics, substeps=substeps) as ask,
        ):
            yield make_ticks
            if failed:
                raise failed[0]  # `process` appends the last line of its output
    except BenchError as error:
        left_out.append(str(error))


def _free(
    plan: Table1Plan,
    environment: Mapping[str, str],
    robot: Path,
    substeps: int,
    modes: Sequence[Mode],
    in_process: Mapping[tuple[str, int], Table1Row],
    message_ms: Mapping[str, Mapping[str, float]],
) -> Iterator[Table1Row]:
    """Yields the rows of a group of modes, measured in one free-running simulation."""
    topics = [[_TOPIC[output] for output in mode.outputs] for mode in modes]
    with process(_command(FREE, plan.scene, robot, substeps, modes), environment):
        expected = START_S + len(modes) * plan.seconds
        received = node_result(
            environment, "free_running_subscriber", expected, cases=topics, seconds=plan.seconds, substeps=substeps
        )
    for k, mode in enumerate(modes):
        if len(received["received"][k]) > 2:
            yield free_row(received["received"][k], received["ticks"][k], in_process[mode.name, substeps], message_ms[mode.name])


def _command(configuration: str, scene: str, robot: Path, substeps: int, modes: Sequence[Mode]) -> list[str]:
    """Returns the command that starts a simulation with one tick per frame, as fast as possible."""
    hz = str(STEP_HZ // substeps)
    outputs = ",".join(name for name in OUTPUTS if any(name in mode.outputs for mode in modes))
    options = [
        "--scene",
        scene,
        "--robot",
        str(robot),
        "--rate",
        "max",
        "--step-hz",
        str(STEP_HZ),
        "--publish-hz",
        hz,
        "--clock-hz",
        hz,
    ]
    options += ["--camera-rate", hz, "--camera-outputs", outputs] if outputs else ["--no-render"]
    options += ["--camera-fill", modes[0].fill] if modes[0].fill else []
    options += ["--lockstep", "--participants", "bench_controller"] if configuration == LOCKSTEP else ["--image-timeout", "0"]
    return [sys.executable, "-m", "gibson_sim.cli.main", "run", *options]
