"""``gibson-sim run``: both nodes, and, if asked for, a drive, a recording and a video, as one job that ends by itself."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from gibson_sim.cli.environment import domain_of, node_environment, require_nodes
from gibson_sim.cli.exit_codes import ExitCode
from gibson_sim.cli.options import add_settings, settings_from_args
from gibson_sim.cli.pictures import write_pictures
from gibson_sim.cli.processes import DomainLock, NodeProcess, StopRequest
from gibson_sim.cli.shared_memory import remove_dead_segments
from gibson_sim.config import DriveConfig, PhysicsConfig, RecordConfig, RenderConfig, SnapshotConfig
from gibson_sim.errors import ConfigError, RecordError
from gibson_sim.resources import find_config, find_scene

MAX_RESTARTS = 3
USER_ERROR = 1
"""Exit code of a node whose settings, scene or machine is at fault: starting it again would not help."""
STATE_TOPIC, TRUTH_TOPIC, CAMERAS = "scene_state", "ground_truth/odom", "cameras"


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "run",
        help="start the simulation: both nodes, and a drive, a recording or a video if asked for",
        description="Starts the physics and the render node, and stops both on Ctrl-C, at --duration or when the drive is done.",
    )
    add_settings(
        parser,
        PhysicsConfig,
        (
            "scene",
            "robot",
            "start",
            "robot_tf",
            "rate",
            "start_paused",
            "reset_time",
            "seed",
            "map",
            "map_resolution",
            "duration",
            "lockstep",
            "participants",
            "participant_timeout",
            "on_timeout",
            "digests",
            "step_hz",
            "clock_hz",
            "publish_hz",
            "camera_rate",
            "camera_outputs",
            "cmd_vel_timeout",
            "publish_map_tf",
            "sdf_lamps",
            "randomise",
            "randomise_seed",
        ),
    )
    add_settings(
        parser,
        RenderConfig,
        tuple(f.name for f in fields(RenderConfig) if f.name not in ("digests", "summary_path")),
    )
    parser.add_argument("--no-render", action="store_true", help="physics alone, no images")
    drive = parser.add_argument_group("drive")
    add_settings(drive, DriveConfig, ("drive", "length", "linear", "angular", "stamped"))
    record = parser.add_argument_group("record")
    record.add_argument("--record", metavar="DIR", help="record a rosbag2 bag (mcap) into this folder, which must not exist")
    add_settings(record, RecordConfig, ("topics", "compression", "reserve_mb"))
    record.add_argument("--video", metavar="FILE.mp4", help="make a video and, beside it, a contact sheet PNG of RGB and depth")
    record.add_argument("--snapshot", metavar="DIR", help="write one PNG of each image of every camera, then stop")
    parser.add_argument("--domain-id", type=int, metavar="N", help="ROS domain (default: $ROS_DOMAIN_ID, or 0)")
    parser.add_argument("--summary", metavar="FILE.json", help="write what was measured to this file as well")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Runs the job; returns the exit code."""
    require_nodes()
    environment = node_environment(domain_id=args.domain_id)
    domain_id = domain_of(environment)
    with tempfile.TemporaryDirectory(prefix="gibson-sim-") as temporary:
        job = _plan(args, Path(temporary))
        lock = DomainLock(domain_id)
        try:
            return _Run(job, environment).run()
        finally:
            remove_dead_segments()
            lock.close()


@dataclass
class _Job:
    """What is to be started and made."""

    folder: Path
    configs: dict[str, Any] = field(default_factory=dict)
    """Node name -> settings, in the order in which they are stopped: clients first, physics last."""
    bag: Path | None = None
    keep_bag: bool = False
    video: Path | None = None
    summary: Path | None = None


def _plan(args: argparse.Namespace, folder: Path) -> _Job:
    """Returns the job that the options ask for.

    Raises:
        GibsonSimError: an option is impossible; nothing was started yet.
    """
    wanted = settings_from_args(PhysicsConfig, args)
    find_scene(wanted.scene)
    if wanted.randomise:
        find_config(wanted.randomise, "randomisation")
    job = _Job(folder, video=_new_file(args.video), summary=Path(args.summary) if args.summary else None)
    waits = {} if args.no_render else {STATE_TOPIC: 1}
    physics: dict[str, Any] = {"summary_path": str(folder / "physics.json")}
    if args.drive:
        job.configs["drive"] = _drive_settings(args)
        waits[TRUTH_TOPIC] = 1
        if args.drive == "tour" and args.publish_map_tf is None:
            physics["publish_map_tf"] = True
    if args.snapshot:
        job.configs["snapshot"] = SnapshotConfig(output=args.snapshot)
    if args.record or args.video:
        job.bag = Path(args.record) if args.record else folder / "bag"
        job.keep_bag = bool(args.record)
        if job.bag.exists() and (not job.bag.is_dir() or any(job.bag.iterdir())):
            raise RecordError(
                f"--record {job.bag}: it is there already and is not an empty folder; give another name or remove it"
            )
        record = {"output": str(job.bag), "summary_path": str(folder / "record.json")}
        job.configs["record"] = settings_from_args(RecordConfig, args, duration=0.0, **record)
        waits = {topic: waits.get(topic, 0) + 1 for topic in (STATE_TOPIC, TRUTH_TOPIC)}
        if not args.no_render:
            waits[CAMERAS] = 1
    if not args.no_render:
        job.configs["render"] = settings_from_args(RenderConfig, args, summary_path=str(folder / "render.json"))
    elif args.video or args.snapshot:
        raise ConfigError("--no-render makes no images: leave it out, or leave out --video and --snapshot")
    if wanted.lockstep:
        ours = ["drive"] * bool(args.drive) + ["render"] * (not args.no_render)
        physics["participants"] = "; ".join(filter(None, (*ours, wanted.participants)))
    physics["wait_for"] = ",".join(f"{topic}:{count}" for topic, count in waits.items())
    job.configs["physics"] = settings_from_args(PhysicsConfig, args, **physics)
    return job


def _drive_settings(args: argparse.Namespace) -> DriveConfig:
    """Returns the drive's settings; a tour is as long as the duration allows."""
    given: dict[str, Any] = {}
    if args.drive == "keyboard":
        raise ConfigError("--drive keyboard needs the terminal: run `gibson-sim drive keyboard` in a second one")
    config = settings_from_args(DriveConfig, args)
    if args.duration and args.length is None and args.drive == "tour":
        given["length"] = max(1.0, args.duration * config.linear)
    return settings_from_args(DriveConfig, args, **given)


def _new_file(name: str | None) -> Path | None:
    if name is None:
        return None
    path = Path(name)
    if path.suffix.lower() not in (".mp4", ".webm"):
        raise ConfigError(f"--video {name}: the name must end in .mp4 or .webm")
    return path


class _Run:
    """The running job."""

    def __init__(self, job: _Job, environment: dict[str, str]) -> None:
        self._job, self._environment = job, environment
        self._nodes: dict[str, NodeProcess] = {}
        self._restarts = 0
        self._code = ExitCode.OK

    def run(self) -> int:
        """Starts the nodes, watches them, stops them, makes what was asked for."""
        stop = StopRequest()
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
                if name in ("physics", "drive", "snapshot"):
                    return True
            elif name == "render" and code != USER_ERROR and self._restarts < MAX_RESTARTS:
                self._restarts += 1
                _say(f"the render node ended with code {code} ({node.last_error()}): starting it again")
                self._nodes[name] = NodeProcess(name, self._job.configs[name], self._environment)
            elif name == "record":
                _say(f"error: the recording ended early: {node.last_error()}; the simulation goes on")
                self._code = ExitCode.RECORDING_ENDED_EARLY
            else:
                died = "" if code == USER_ERROR else f"the {name} node ended with code {code}: "
                _say(f"error: {died}{node.last_error()}")
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
        found = {n: _read_json(self._job.folder / f"{n}.json") for n in ("physics", "render", "record")}
        for line in _summary_lines(found, self._restarts):
            _say(line)
        if self._job.summary:
            self._job.summary.parent.mkdir(parents=True, exist_ok=True)
            self._job.summary.write_text(json.dumps({**found, "render_restarts": self._restarts}, indent=2) + "\n")
        if self._job.video and self._job.bag and found["record"].get("messages"):
            for path in write_pictures(self._job.bag, self._job.video):
                _say(f"wrote {path}")
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
            f"record: {sum(b['messages'].values())} messages on {len(b['messages'])} topics"
            + (f", {b['error']}" if b["error"] else "")
        )
    return lines


def _read_json(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text()) if path.is_file() else {}


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
