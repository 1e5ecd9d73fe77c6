"""``gibson-sim bench ros``: measures each case with its nodes, one after the other, and reports."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

from gibson_sim.cli.environment import RMW, domain_of, node_environment, require_nodes
from gibson_sim.cli.report_file import add_report_options, chosen, print_progress, write_json
from gibson_sim.processes.domain_lock import DomainLock
from gibson_sim.processes.shared_memory import remove_dead_segments
from gibson_sim_bench import timing
from gibson_sim_bench.cli.processes import CAMERA, BenchError, background_node, node_result, process
from gibson_sim_bench.protocol import write_changed_robot
from gibson_sim_bench.ros import (
    PARTS,
    ClockCost,
    IdleNode,
    Pipeline,
    RosPlan,
    RosReport,
    RoundTrip,
    Size,
    Transport,
    pipeline_of,
    report_text,
    spread,
)

START_S = 90.0
"""Timeout for a simulation to load its scene, seconds of wall time."""
Progress = Callable[[str], None]


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "ros",
        help="round-trip time of a state, image transport, the cost of /clock, images of a running simulation",
        description="Measures messages between processes, and the cost of idle nodes. Nothing else should run on the machine.",
    )
    parser.add_argument("--quick", action="store_true", help="fewer and shorter cases: about four minutes instead of ten")
    parser.add_argument("--only", default="", metavar="A,B", help=f"some of {', '.join(PARTS)} (default: all)")
    parser.add_argument("--scene", help="scene of the running simulation (default: flat)")
    add_report_options(parser)
    parser.add_argument("--domain-id", type=int, metavar="N", help="ROS domain (default: $ROS_DOMAIN_ID, or 0)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints the report, and writes the JSON file if one is named."""
    require_nodes()
    report = measure(plan_of(args), domain_id=args.domain_id, progress=print_progress)
    print(report_text(report, markdown=args.markdown))
    write_json(args.json, report.as_json())
    return 0


def plan_of(args: argparse.Namespace) -> RosPlan:
    """Returns the plan of the options.

    Raises:
        ConfigError: an option is invalid.
    """
    parts = chosen(args.only, PARTS)
    plan = RosPlan.quick(parts) if args.quick else RosPlan(parts)
    return replace(plan, scene=args.scene) if args.scene else plan


def measure(plan: RosPlan, *, domain_id: int | None = None, progress: Progress = lambda line: None) -> RosReport:
    """Returns the measurements; a case that fails is left out, and the report says why.

    Args:
        plan: parts and number of measurements.
        domain_id: ROS domain; None = that of the environment.
        progress: called with one line of progress.

    Raises:
        AlreadyRunningError: a simulation runs in this domain; its /clock would interfere.
    """
    environment = node_environment(domain_id=domain_id)
    report = RosReport(
        timing.now(), timing.version(), timing.machine(), timing.cores(), timing.load(), {"Python": _python(), **_versions()}
    )
    found: dict[str, list[Any]] = {"state": [], "transport": [], "clock": [], "pipeline": []}
    left_out: list[str] = []
    domain = domain_of(environment)
    for part, cases in _cases(plan, environment):
        for name, case in cases:
            progress(f"{part}: {name}")
            try:
                # A simulation locks the domain itself. In the other parts the lock keeps simulations from receiving this /clock.
                lock = None if part == "pipeline" else DomainLock(domain)
                try:
                    found[part].append(case())
                finally:
                    if lock is not None:
                        lock.close()
            except BenchError as error:
                left_out.append(f"{part}, {name}: {error}")
    remove_dead_segments()
    return replace(
        report,
        round_trips=tuple(found["state"]),
        transports=tuple(found["transport"]),
        clocks=tuple(found["clock"]),
        pipelines=tuple(found["pipeline"]),
        left_out=tuple(left_out),
    )


_Case = tuple[str, Callable[[], Any]]


def _cases(plan: RosPlan, environment: Mapping[str, str]) -> Iterator[tuple[str, list[_Case]]]:
    """Yields each part of the plan with its cases: a name, and a function that measures."""

    def bound(function: Callable[..., Any], *arguments: Any) -> Callable[[], Any]:
        return lambda: function(plan, environment, *arguments)

    parts: dict[str, list[_Case]] = {
        "state": [(f"{m.executor}, {m.form}", bound(_round_trip, m.executor, m.form)) for m in plan.methods],
        "transport": [(kind, bound(_transport, kind)) for kind in ("standard", "events", "wait set")],
        "clock": [
            (
                f"{node.executor}, use_sim_time {node.use_sim_time}, parameter services {node.parameter_services}",
                bound(_clock, node),
            )
            for node in plan.idle_nodes
        ],
        "pipeline": [
            (f"{size} at {hz:g} Hz", bound(_pipeline, size, hz)) for size in plan.pipeline_sizes for hz in plan.pipeline_hz
        ],
    }
    yield from ((part, parts[part]) for part in plan.parts)


def _round_trip(plan: RosPlan, environment: Mapping[str, str], executor: str, form: str) -> RoundTrip:
    with background_node(environment, "pong", executor=executor, form=form):
        options = {"executor": executor, "form": form, "bodies": plan.bodies, "count": plan.round_trips}
        found = node_result(environment, "ping", plan.round_trips * 0.05, **options)
    return RoundTrip(executor, form, plan.bodies, len(found["us"]), spread(found["us"]))


def _transport(plan: RosPlan, environment: Mapping[str, str], executor: str) -> Transport:
    size, hz = plan.transport_size, plan.transport_hz
    options = {"width": size.width, "height": size.height, "hz": hz, "count": plan.transport_images}
    with background_node(environment, "image_source", **options):
        latencies = node_result(environment, "image_sink", plan.transport_images / hz, executor=executor)["ms"]
    return Transport(executor, size, hz, plan.transport_images, len(latencies), spread(latencies))


def _clock(plan: RosPlan, environment: Mapping[str, str], node: IdleNode) -> ClockCost:
    options = {"executor": node.executor, "use_sim_time": node.use_sim_time, "parameter_services": node.parameter_services}
    with background_node(environment, "clock_source", hz=plan.clock_hz):
        found = node_result(environment, "idle_node", plan.clock_s, seconds=plan.clock_s, **options)
    percent, seconds, clock_s = round(found["cpu_percent"], 3), round(found["seconds"], 2), round(found["clock_s"], 2)
    return ClockCost(node.executor, node.use_sim_time, node.parameter_services, seconds, percent, clock_s)


def _pipeline(plan: RosPlan, environment: Mapping[str, str], size: Size, hz: float) -> Pipeline:
    with tempfile.TemporaryDirectory(prefix="gibson-sim-bench-") as folder:
        robot = write_changed_robot(Path(folder), (size.width, size.height))
        options = ["--scene", plan.scene, "--robot", str(robot), "--camera-rate", f"{hz:g}", "--camera-outputs", "rgb,depth"]
        command = [sys.executable, "-m", "gibson_sim.cli.main", "run", *options]
        with process(command, environment):
            topics = [f"{CAMERA}/image_raw", f"{CAMERA}/depth/image_raw"]
            received = node_result(
                environment, "pipeline_sink", START_S + plan.pipeline_s, topics=topics, seconds=plan.pipeline_s
            )
    return pipeline_of(size, hz, received)


def _python() -> str:
    return sys.version.split()[0]


def _versions() -> dict[str, str]:
    """Returns the versions of the middleware packages that pip has installed."""
    found = {}
    for package, name in (("rclpy", "rclpy"), ("ros-rmw-fastrtps-cpp", RMW), ("ros-fastrtps", "Fast DDS"), ("numpy", "NumPy")):
        try:
            found[name] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return {**found, "ROS": os.environ.get("ROS_DISTRO", "jazzy")}
