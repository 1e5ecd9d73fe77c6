"""``gibson-sim bench soak``: long runs, in this process and free-running over ROS."""

from __future__ import annotations

import argparse
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from gibson_sim.cli.environment import node_environment, require_nodes
from gibson_sim.cli.quiet import quiet
from gibson_sim.cli.report_file import add_report_options, print_progress, write_json
from gibson_sim.processes.shared_memory import remove_dead_segments
from gibson_sim.resources import cache_folder
from gibson_sim_bench.cli.processes import CAMERA, node_result, process

START_S = 120.0
"""Timeout for a simulation to load its scene, seconds of wall time."""
INTERVAL_S = 5.0
"""Minimum wall time between two samples, seconds."""
_MAX_SAMPLES = 200
_TOPICS = [f"{CAMERA}/image_raw", f"{CAMERA}/depth/image_raw"]


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "soak",
        help="long runs: environment steps, then a free-running simulation; memory, rates and numbers of files must stay constant",
        description="Takes about an hour and a half; with --quick three minutes. The exit code is 1 if a value grows or drifts above its limit.",
    )
    parser.add_argument("--steps", type=int, default=100_000, metavar="N", help="environment steps (default: 100000)")
    parser.add_argument("--seconds", type=float, default=3600.0, metavar="S", help="free-running, wall time (default: 3600)")
    parser.add_argument("--quick", action="store_true", help="2,000 steps and 60 s")
    parser.add_argument("--scene", default="linden_flat", help="scene of the running simulation (default: linden_flat)")
    add_report_options(parser)
    parser.add_argument("--domain-id", type=int, metavar="N", help="ROS domain (default: $ROS_DOMAIN_ID, or 0)")
    parser.set_defaults(run=run)


@quiet()
def run(args: argparse.Namespace) -> int:
    """Prints the report, writes the JSON file if one is named; returns 1 if a value grew or drifted above its limit."""
    from gibson_sim_bench import timing
    from gibson_sim_bench.soak import Samples, SoakReport, environment_steps, report_text

    steps, seconds = (2_000, 60.0) if args.quick else (args.steps, args.seconds)
    if seconds > 0:
        require_nodes()
    facts = timing.facts()
    environment, episodes = environment_steps(steps, progress=print_progress) if steps > 0 else (Samples(), 0)
    running, images = free_running(args.scene, seconds, args.domain_id, print_progress) if seconds > 0 else (Samples(), 0)
    report = SoakReport(facts, steps, episodes, environment, seconds, images, running)
    print(report_text(report, markdown=args.markdown))
    write_json(args.json, report.as_json())
    return 1 if report.problems else 0


def free_running(scene: str, seconds: float, domain_id: int | None, progress: Callable[[str], None]) -> tuple[Any, int]:
    """Returns samples of a simulation in real time with a subscriber to its images, and the number of sets of images received.

    Args:
        scene: name or path of the scene.
        seconds: wall time.
        domain_id: ROS domain; None = that of the environment.
        progress: called with one line of progress.

    Raises:
        BenchError: the simulation did not start, or ended early.
    """
    from gibson_sim_bench.soak import Samples

    environment = node_environment(domain_id=domain_id)
    samples, interval = Samples(), max(INTERVAL_S, seconds / _MAX_SAMPLES)
    with tempfile.TemporaryDirectory(prefix="gibson-sim-bench-") as logs:
        environment["ROS_LOG_DIR"] = logs
        command = [sys.executable, "-m", "gibson_sim.cli.main", "run", "--scene", scene]
        with process(command, environment) as pid:
            ended = threading.Event()
            watcher = threading.Thread(target=_watch, args=(pid, samples, interval, Path(logs), ended, progress), daemon=True)
            watcher.start()
            try:
                received = _received(environment, seconds, interval)
            finally:
                ended.set()
                watcher.join()
    remove_dead_segments()
    samples.values["images received /s"] = [round(count / interval, 3) for count in received["sets"]]
    samples.values["simulated seconds /s"] = [round(factor, 4) for factor in received["factors"]]
    return samples, sum(received["sets"])


def _received(environment: Mapping[str, str], seconds: float, interval: float) -> dict[str, Any]:
    return node_result(environment, "soak_subscriber", START_S + seconds, topics=_TOPICS, seconds=seconds, interval=interval)


def _watch(pid: int, samples: Any, interval: float, logs: Path, ended: threading.Event, progress: Callable[[str], None]) -> None:
    """Samples the processes of a simulation and the number of its files, until ``ended`` is set."""
    from gibson_sim_bench.memory import descendants, files_below, open_files, resident_mb

    began = time.monotonic()
    while not ended.wait(interval):
        alive = descendants(pid)
        nodes = {name: number for number, name in sorted(alive.items()) if name.endswith("_node")}
        if len(nodes) < 2:
            continue  # the nodes are still starting
        samples.seconds.append(round(time.monotonic() - began, 1))
        for name, number in nodes.items():
            samples.append(f"{name} MB", resident_mb(number))
            samples.append(f"{name} open files", float(open_files(number)))
        samples.append("logs and shared memory files", float(files_below([logs, Path("/dev/shm")])))
        samples.append("cache files", float(files_below([cache_folder("scenes"), cache_folder("bench")])))
        memory = ", ".join(f"{name} {samples.values[f'{name} MB'][-1]:.0f} MB" for name in nodes)
        progress(f"{samples.seconds[-1]:.0f} s: {memory}")
