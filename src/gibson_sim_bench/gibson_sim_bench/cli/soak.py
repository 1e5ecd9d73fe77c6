"""``gibson-sim bench soak``: long runs, in this process and free-running over ROS 2."""

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
from gibson_sim.cli.report_file import add_report_options, tell, write_json
from gibson_sim.cli.shared_memory import remove_dead_segments
from gibson_sim.resources import cache_folder
from gibson_sim_bench.cli.processes import CAMERA, answer, process

START_S = 120.0
INTERVAL_S = 5.0
"""Between two looks, at least; a run has at most 200 of them."""
_LOOKS = 200
_TOPICS = [f"{CAMERA}/image_raw", f"{CAMERA}/depth/image_raw"]


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "soak",
        help="long runs: environment steps, then a free-running simulation; memory, rates and files must stay as they are",
        description="The whole takes about an hour and a half; --quick three minutes. Exit code 1 where something grows or drifts.",
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
    """Prints the table, writes the JSON file if one is named; returns 1 where something grew or drifted."""
    from gibson_sim_bench import timing
    from gibson_sim_bench.reports.soak import report_text
    from gibson_sim_bench.soak import Samples, SoakReport, environment_steps

    steps, seconds = (2_000, 60.0) if args.quick else (args.steps, args.seconds)
    if seconds > 0:
        require_nodes()
    facts = timing.facts()
    environment, episodes = environment_steps(steps, tell=tell) if steps > 0 else (Samples(), 0)
    running, images = free_running(args.scene, seconds, args.domain_id, tell) if seconds > 0 else (Samples(), 0)
    report = SoakReport(facts, steps, episodes, environment, seconds, images, running)
    print(report_text(report, markdown=args.markdown))
    write_json(args.json, report.as_json())
    return 1 if report.problems else 0


def free_running(scene: str, seconds: float, domain_id: int | None, tell: Callable[[str], None]) -> tuple[Any, int]:
    """Returns what was seen of a simulation at real time with a subscriber to its images, and how many sets of them came.

    Args:
        scene: name or path.
        seconds: wall time.
        domain_id: ROS domain; None = as the environment says.
        tell: is told in one line what is going on.

    Raises:
        BenchError: it did not start, or died.
    """
    from gibson_sim_bench.soak import Samples

    environment = node_environment(domain_id=domain_id)
    samples, interval = Samples(), max(INTERVAL_S, seconds / _LOOKS)
    with tempfile.TemporaryDirectory(prefix="gibson-sim-bench-") as logs:
        environment["ROS_LOG_DIR"] = logs
        command = [sys.executable, "-m", "gibson_sim.cli.main", "run", "--scene", scene]
        with process(command, environment) as pid:
            ended = threading.Event()
            watcher = threading.Thread(target=_watch, args=(pid, samples, interval, Path(logs), ended, tell), daemon=True)
            watcher.start()
            try:
                heard = _heard(environment, seconds, interval)
            finally:
                ended.set()
                watcher.join()
    remove_dead_segments()
    samples.values["images received /s"] = [round(count / interval, 3) for count in heard["sets"]]
    samples.values["simulated seconds /s"] = [round(part, 4) for part in heard["factors"]]
    return samples, sum(heard["sets"])


def _heard(environment: Mapping[str, str], seconds: float, interval: float) -> dict[str, Any]:
    return answer(environment, "soak_listener", START_S + seconds, topics=_TOPICS, seconds=seconds, interval=interval)


def _watch(pid: int, samples: Any, interval: float, logs: Path, ended: threading.Event, tell: Callable[[str], None]) -> None:
    """Looks at the processes of a simulation and at the files that it may leave, until told to end."""
    from gibson_sim_bench.memory import descendants, files_below, open_files, resident_mb

    began = time.monotonic()
    while not ended.wait(interval):
        alive = descendants(pid)
        nodes = {name: number for number, name in sorted(alive.items()) if name.endswith("_node")}
        if len(nodes) < 2:
            continue  # it is still starting
        samples.seconds.append(round(time.monotonic() - began, 1))
        for name, number in nodes.items():
            samples.put(f"{name} MB", resident_mb(number))
            samples.put(f"{name} open files", float(open_files(number)))
        samples.put("logs and shared memory files", float(files_below([logs, Path("/dev/shm")])))
        samples.put("cache files", float(files_below([cache_folder("scenes"), cache_folder("bench")])))
        memory = ", ".join(f"{name} {samples.values[f'{name} MB'][-1]:.0f} MB" for name in nodes)
        tell(f"{samples.seconds[-1]:.0f} s: {memory}")
