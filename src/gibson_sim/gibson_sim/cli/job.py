"""Jobs of several nodes: starts, monitors and stops the nodes in order, and reports."""

from __future__ import annotations

import json
import shutil
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gibson_sim.bags.folders import check_room
from gibson_sim.cli.console import CONSOLE, say
from gibson_sim.cli.environment import domain_of
from gibson_sim.cli.job_status import PERIOD_S, Hints, JobStatus
from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.processes import NodeProcess, StopRequest
from gibson_sim.cli.report_file import write_json
from gibson_sim.errors import ConfigError, GibsonSimError, RecordError
from gibson_sim.processes.domain_lock import DomainLock
from gibson_sim.processes.job_folder import LOADED, PAGE, JobFolder, read_note
from gibson_sim.processes.shared_memory import remove_dead_segments
from gibson_sim.reach import describe_reach
from gibson_sim.writing import write_file

MAX_RESTARTS, RESTART_WINDOW_S = 3, 600.0
"""Maximum number of restarts of a crashing render node within a window, seconds of wall time; another crash ends the run."""
USER_ERROR = 1
"""Exit code of a node for errors in settings, scene or machine, which a restart would not fix."""
_LOADING = ("physics", "render")
"""Nodes that take long to load, in their start order; the other nodes start once physics has loaded the world."""
ENDS_THE_JOB = ("physics", "drive", "snapshot", "replay", "task")
"""Nodes whose exit ends the job."""
STATE_TOPIC, ROBOTS, CAMERAS, COMMANDS, WEB = "scene_state", "robots", "cameras", "commands", "page"
"""Topics, and groups of topics, whose subscribers (publishers for commands) physics waits for before time starts; and the page."""
END_FIRST = ("physics", "render", "record")
"""Nodes that are stopped first, in this order, so that the recording contains the last step with its images; then the others."""


@dataclass
class Job:
    """The nodes to start, and the files to write."""

    folder: Path
    """Temporary folder of the nodes' reports."""
    configs: dict[str, Any] = field(default_factory=dict)
    """Node name -> settings; the nodes are started in reverse order."""
    bag: Path | None = None
    keep_bag: bool = False
    video: Path | None = None
    summary: Path | None = None
    hints: Hints | None = None
    """Content of the ready and status lines; None = these are not printed."""


def run_job(plan: Callable[[Path], Job], environment: dict[str, str]) -> tuple[int, dict[str, dict[str, Any]]]:
    """Runs a job with exclusive use of the ROS domain of an environment.

    Args:
        plan: returns the job; receives a temporary folder for the reports of the nodes.
        environment: environment of the nodes.

    Returns:
        The exit code, and the report of each node.

    Raises:
        GibsonSimError: the job is invalid, or another simulation is running in the domain; no process has been started.
    """
    with JobFolder() as folder:
        job = plan(folder.path)
        lock = DomainLock(domain_of(environment))
        folder.add_to(environment)
        try:
            running = JobRun(job, environment, inherit=(folder.descriptor,))
            return running.run(), running.found
        finally:
            remove_dead_segments()
            lock.close()


def check_new_bag(bag: Path, reserve_mb: float) -> None:
    """Checks that a bag can be recorded in a folder, with ``reserve_mb`` of free disk space remaining.

    Raises:
        RecordError: the folder is not empty, or the disk is full.
    """
    if bag.exists() and (not bag.is_dir() or any(bag.iterdir())):
        raise RecordError(f"--record {bag}: already exists and is not an empty folder; give another name or remove it")
    check_room(bag, round(reserve_mb * 1e6))


class JobRun:
    """A running job."""

    def __init__(self, job: Job, environment: dict[str, str], *, inherit: Sequence[int] = ()) -> None:
        """``inherit``: file descriptors that all nodes inherit."""
        self._job, self._environment, self._inherit = job, environment, inherit
        self._nodes: dict[str, NodeProcess] = {}
        self._restarts = Restarts(MAX_RESTARTS, RESTART_WINDOW_S)
        self._code = ExitCode.OK
        self._accepted = "physics" not in job.configs
        self.found: dict[str, dict[str, Any]] = {}
        """Node name -> report, at the end of the job."""
        self._status = JobStatus(job.folder, list(job.configs))
        self._was_ready = False
        self._next_status = 0.0

    def run(self) -> int:
        """Starts, monitors and stops the nodes, and writes the requested files; returns the exit code."""
        stop = StopRequest()
        remove_dead_segments()  # a new participant waits for an answer on the port of a dead process
        try:
            # Validate scenes and cameras before other nodes produce output.
            for name in _LOADING:
                if name in self._job.configs:
                    self._start(name)
            while not stop.count and not self._finished():
                if not self._accepted and (note := read_note(self._job.folder, LOADED)) is not None and not self._accept(note):
                    break
                if self._job.hints is not None and self._accepted:
                    self._show_status(self._job.hints)
                time.sleep(0.05)
        finally:
            CONSOLE.status("")
            if stop.count:  # at once: nodes that still load take seconds to end
                begun = self._status.is_ready or "physics" not in self._job.configs
                say(f"ending{'' if begun else ' before time has started'}: the nodes are stopping")
            self._stop_all(stop)
            stop.close()
        if self._accepted:
            self._report()
        if stop.count and not self.found.get("physics", {}).get("simulation_time_s") and not self._code:
            self._code = ExitCode.INTERRUPTED  # time had not begun
        return int(self._code)

    def _start(self, name: str) -> None:
        silent = not self._accepted and name != "physics"
        self._nodes[name] = NodeProcess(name, self._job.configs[name], self._environment, inherit=self._inherit, silent=silent)

    def _accept(self, loaded: str) -> bool:
        """Starts the other nodes after physics has loaded scene and robots; returns False if a requested camera does not exist."""
        try:
            if "render" in self._job.configs:
                self._job.configs["render"].check_cameras([camera["name"] for camera in json.loads(loaded)["cameras"]])
        except ConfigError as error:
            say(f"error: {error}")
            self._code = ExitCode.ERROR
            return False
        self._accepted = True
        say(describe_reach(self._environment))
        for node in self._nodes.values():
            node.print_held()
        for name in reversed(self._job.configs):
            if name not in _LOADING:
                self._start(name)
        return True

    def _show_status(self, hints: Hints) -> None:
        """Prints the ready lines once; shows the current state, as a line that is rewritten or as a new line every ten seconds."""
        now = time.monotonic()
        if not self._was_ready and self._status.is_ready:
            self._was_ready = True
            self._next_status = now + (0.5 if CONSOLE.is_terminal else PERIOD_S)
            CONSOLE.status("")
            for line in self._status.ready_lines(hints):
                say(line)
        if now < self._next_status or not (CONSOLE.is_terminal or self._was_ready):
            return  # elsewhere than on a terminal, the nodes' own lines tell what they load
        self._next_status = now + (0.2 if CONSOLE.is_terminal else PERIOD_S)
        line = self._status.line()
        if CONSOLE.is_terminal:
            CONSOLE.status(line)
        elif line:
            say(line)

    def _finished(self) -> bool:
        """Polls the nodes and restarts a crashed render node; returns whether the job has ended."""
        for name, node in list(self._nodes.items()):
            code = node.poll()
            if code is None:
                continue
            del self._nodes[name]
            if code == 0:
                node.print_error()
                if name in ENDS_THE_JOB:
                    return True
            elif name == "render" and code != USER_ERROR and self._restarts.allow():
                remove_dead_segments()
                say(f"{node.ending()}; restarting it")
                self._start(name)
            elif name == "web" and code != USER_ERROR:
                write_file(self._job.folder / PAGE, "", durable=False)  # time need not wait for it
                say(f"{node.ending()}; the simulation goes on without its page: `gibson-sim web` restarts it")
            elif name == "foxglove" and code != USER_ERROR:
                say(f"{node.ending()}; the simulation goes on without it: `gibson-sim web --foxglove` restarts it")
            elif name == "record" and code != USER_ERROR:
                say(f"error: the recording ended early: {node.reason()}; the simulation goes on")
                self._code = ExitCode.RECORDING_ENDED_EARLY
            else:
                if name == "render" and code != USER_ERROR:
                    say(
                        f"the render node crashed {MAX_RESTARTS + 1} times within {RESTART_WINDOW_S / 60:.0f} minutes: the run ends"
                    )
                say(f"error: {node.reason() if code == USER_ERROR else node.ending()}")
                self._code = ExitCode.ERROR if code == USER_ERROR else ExitCode.NODE_DIED
                return True
        return False

    def _stop_all(self, stop: StopRequest) -> None:
        """Stops the nodes in order, see ``END_FIRST``."""
        requests = stop.count
        for name in (*END_FIRST, *self._job.configs):
            node = self._nodes.pop(name, None)
            if node is not None:
                node.stop(hurry=lambda: stop.count > requests + 1)

    def _report(self) -> None:
        """Prints the reports of the nodes, and writes summary and images."""
        names = dict.fromkeys(("physics", "render", "record", *self._job.configs))
        read = {name: _read_json(self._job.folder / f"{name}.json") for name in names}
        found = self.found = {name: values for name, values in read.items() if values or name in ("physics", "render", "record")}
        for line in _summary_lines(found, self._restarts.total):
            say(line)
        render = found["render"]
        if render and (without := [name for name in render["failed_images"] if name not in render["images"]]):
            say(f"error: no image of {', '.join(without)} could be rendered: see the warnings")
            self._code = self._code or ExitCode.ERROR
        self._attempt(lambda: write_json(self._job.summary, {**found, "render_restarts": self._restarts.total}))
        if self._job.video and found["record"].get("messages"):
            self._attempt(self._write_pictures)
        recorded = found["record"].get("messages")  # a killed recorder leaves no report, but a bag that can be repaired
        empty = recorded is not None and not any(recorded.values())
        if self._job.bag and (empty or not self._job.keep_bag):
            shutil.rmtree(self._job.bag, ignore_errors=True)

    def _attempt(self, write: Callable[[], None]) -> None:
        """Writes a requested file; prints the error if that fails, so that the other files are still written."""
        try:
            write()
        except GibsonSimError as error:
            say(f"error: {error}")
            self._code = self._code or ExitCode.ERROR

    def _write_pictures(self) -> None:
        from gibson_sim.bags.video import write_pictures  # OpenCV and a video encoder with it

        assert self._job.bag is not None and self._job.video is not None
        for path in write_pictures(self._job.bag, self._job.video):
            say(f"wrote {path}")


class Restarts:
    """Limits the rate of restarts of a node: repeated crashes end the run, occasional ones do not.

    Args:
        limit: maximum number of restarts within a window.
        window_s: length of the window, seconds.
        now_s: monotonic clock, seconds.
    """

    def __init__(self, limit: int, window_s: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self._limit, self._window_s, self._now_s = limit, window_s, now_s
        self._recent: deque[float] = deque()
        self.total = 0
        """Total number of restarts."""

    def allow(self) -> bool:
        """Counts a restart and returns whether it is allowed."""
        now = self._now_s()
        while self._recent and now - self._recent[0] >= self._window_s:
            self._recent.popleft()
        if len(self._recent) >= self._limit:
            return False
        self._recent.append(now)
        self.total += 1
        return True


def _summary_lines(reports: dict[str, dict[str, Any]], restarts: int) -> list[str]:
    """Returns the summary of the reports, one line each."""
    lines = []
    if p := reports["physics"]:
        lines.append(
            f"physics: scene {p['scene']}, {p['simulation_time_s']:.2f} s simulated in {p['wall_time_s']:.2f} s, "
            f"real-time factor {p['real_time_factor']:.3f}, {p['commands']} commands, {p['refused_commands']} refused"
        )
    if r := reports["render"]:
        has_begun = not p or p["simulation_time_s"] > 0.0  # otherwise no image was due
        if has_begun and not r["images"] and not r["failed_images"]:
            lines.append("render: no image topic had a subscriber, so no image was rendered")
        for name, count in r["images"].items():
            lines.append(
                f"render: camera {name}, {count} images, {r['images_per_wall_s'][name]:.1f}/s of wall time, "
                f"{r['images_per_simulated_s'][name]:.1f}/s of simulation time, {r['skipped_by_camera'][name]} skipped, "
                f"{r['draw_ms_median']:.1f} ms to render, {r['publish_ms_median']:.1f} ms to publish (medians), on {r['renderer']}"
            )
        lines += [
            f"render: camera {name}, {count} images could not be rendered: see the warnings"
            for name, count in r["failed_images"].items()
        ]
    if restarts:
        lines.append(f"render: restarted {restarts} times")
    if b := reports["record"]:
        lines.append(
            f"record: {sum(b['messages'].values())} messages on {len(b['messages'])} topics, {sum(b['lost'].values())} lost"
            + (f", {b['error']}" if b["error"] else "")
        )
    return lines


def _read_json(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text()) if path.is_file() else {}
