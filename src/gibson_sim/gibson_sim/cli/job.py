"""A job of several nodes: started together, watched, ended in order, reported."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gibson_sim.cli.environment import domain_of
from gibson_sim.cli.exit_codes import ExitCode
from gibson_sim.cli.processes import NodeProcess, StopRequest
from gibson_sim.cli.report_file import write_json
from gibson_sim.cli.shared_memory import remove_dead_segments
from gibson_sim.errors import RecordError
from gibson_sim.simulation.domain_lock import DomainLock

MAX_RESTARTS = 3
USER_ERROR = 1
"""Exit code of a node whose settings, scene or machine is at fault: starting it again would not help."""
ENDS_THE_JOB = ("physics", "drive", "snapshot", "replay", "task")
"""Nodes after whose end nothing is left to do."""
STATE_TOPIC, ROBOTS, CAMERAS = "scene_state", "robots", "cameras"
"""What physics waits for readers of, before time begins."""


@dataclass
class Job:
    """What is to be started and made."""

    folder: Path
    configs: dict[str, Any] = field(default_factory=dict)
    """Node name -> settings, in the order in which they are stopped: clients first, physics last."""
    bag: Path | None = None
    keep_bag: bool = False
    video: Path | None = None
    summary: Path | None = None


def check_new_bag(bag: Path) -> None:
    """Checks that a bag can be recorded there.

    Raises:
        RecordError: something is there already.
    """
    if bag.exists() and (not bag.is_dir() or any(bag.iterdir())):
        raise RecordError(f"--record {bag}: it is there already and is not an empty folder; give another name or remove it")


def run_job(plan: Callable[[Path], Job], environment: dict[str, str]) -> tuple[int, dict[str, dict[str, Any]]]:
    """Runs a job in the ROS domain of an environment, which it has to itself meanwhile.

    Args:
        plan: returns the job; it is given a folder for what the nodes leave, which is gone afterwards.
        environment: of the nodes.

    Returns:
        The exit code, and what each node measured.

    Raises:
        GibsonSimError: the job is impossible, or another simulation runs there; nothing was started.
    """
    with tempfile.TemporaryDirectory(prefix="gibson-sim-") as temporary:
        job = plan(Path(temporary))
        lock = DomainLock(domain_of(environment))
        try:
            running = JobRun(job, environment)
            return running.run(), running.found
        finally:
            remove_dead_segments()
            lock.close()


class JobRun:
    """The running job."""

    def __init__(self, job: Job, environment: dict[str, str]) -> None:
        self._job, self._environment = job, environment
        self._nodes: dict[str, NodeProcess] = {}
        self._restarts = 0
        self._code = ExitCode.OK
        self.found: dict[str, dict[str, Any]] = {}
        """Node name -> what it measured; once the job is over."""

    def run(self) -> int:
        """Starts the nodes, watches them, stops them, makes what was asked for."""
        stop = StopRequest()
        remove_dead_segments()  # whoever comes upon the port of a dead process waits for an answer of it
        try:
            # Physics first: it has the most to do before anybody can go on.
            for name in reversed(self._job.configs):
                self._nodes[name] = NodeProcess(name, self._job.configs[name], self._environment)
            while not stop.count and not self._finished():
                time.sleep(0.05)
        finally:
            self._stop_all(stop)
            stop.close()
        self._report()
        return int(self._code)

    def _finished(self) -> bool:
        """Looks after the nodes; returns whether the job is done or lost."""
        for name, node in list(self._nodes.items()):
            code = node.poll()
            if code is None:
                continue
            del self._nodes[name]
            if code == 0:
                if name in ENDS_THE_JOB:
                    return True
            elif name == "render" and code != USER_ERROR and self._restarts < MAX_RESTARTS:
                self._restarts += 1
                remove_dead_segments()
                say(f"the render node ended with code {code} ({node.last_error()}): starting it again")
                self._nodes[name] = NodeProcess(name, self._job.configs[name], self._environment)
            elif name == "record" and code != USER_ERROR:
                say(f"error: the recording ended early: {node.last_error()}; the simulation goes on")
                self._code = ExitCode.RECORDING_ENDED_EARLY
            else:
                died = "" if code == USER_ERROR else f"the {name} node ended with code {code}: "
                say(f"error: {died}{node.last_error()}")
                self._code = ExitCode.ERROR if code == USER_ERROR else ExitCode.NODE_DIED
                return True
        return False

    def _stop_all(self, stop: StopRequest) -> None:
        """Ends the nodes in order: those that listen before those that speak."""
        asked = stop.count
        for name in self._job.configs:
            node = self._nodes.pop(name, None)
            if node is not None:
                node.stop(hurry=lambda: stop.count > asked + 1)

    def _report(self) -> None:
        """Prints what was measured and makes the pictures."""
        names = dict.fromkeys(("physics", "render", "record", *self._job.configs))
        read = {name: _read_json(self._job.folder / f"{name}.json") for name in names}
        found = self.found = {name: values for name, values in read.items() if values or name in ("physics", "render", "record")}
        for line in _summary_lines(found, self._restarts):
            say(line)
            write_json(self._job.summary, {**found, "render_restarts": self._restarts})
        if self._job.video and self._job.bag and found["record"].get("messages"):
            from gibson_sim.cli.pictures import write_pictures  # OpenCV and a video encoder with it

            for path in write_pictures(self._job.bag, self._job.video):
                say(f"wrote {path}")
        if self._job.bag and not self._job.keep_bag:
            shutil.rmtree(self._job.bag, ignore_errors=True)


def _summary_lines(found: dict[str, dict[str, Any]], restarts: int) -> list[str]:
    """Returns the summary as measured, one line a part."""
    lines = []
    if p := found["physics"]:
        lines.append(
            f"physics: scene {p['scene']}, {p['simulation_time_s']:.2f} s simulated in {p['wall_time_s']:.2f} s, "
            f"real-time factor {p['real_time_factor']:.3f}, {p['commands']} commands, {p['refused_commands']} refused"
        )
    if r := found["render"]:
        if not r["images"]:
            lines.append("render: nobody asked for an image, so none was drawn")
        for name, count in r["images"].items():
            lines.append(
                f"render: camera {name}, {count} images, {r['images_per_wall_s'][name]:.1f}/s of wall time, "
                f"{r['images_per_simulated_s'][name]:.1f}/s of simulation time, {r['skipped_images']} skipped, "
                f"{r['draw_ms_median']:.1f} ms to draw, {r['publish_ms_median']:.1f} ms to publish (medians), on {r['renderer']}"
            )
    if restarts:
        lines.append(f"render: started again {restarts} times")
    if b := found["record"]:
        lines.append(
            f"record: {sum(b['messages'].values())} messages on {len(b['messages'])} topics, {sum(b['lost'].values())} lost"
            + (f", {b['error']}" if b["error"] else "")
        )
    return lines


def _read_json(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text()) if path.is_file() else {}


def say(text: str) -> None:
    """Prints a line on stderr."""
    print(text, file=sys.stderr, flush=True)
