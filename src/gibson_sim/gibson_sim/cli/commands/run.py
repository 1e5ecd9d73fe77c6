"""``gibson-sim run``: runs both nodes, and on request a drive, a recording and a video, as one job."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from gibson_sim.cli.environment import add_network, domain_of, environment_of, is_free, require_foxglove, require_nodes
from gibson_sim.cli.job import CAMERAS, COMMANDS, ROBOTS, STATE_TOPIC, WEB, Job, check_new_bag, run_job
from gibson_sim.cli.job_status import Hints
from gibson_sim.cli.launching import PAGE_VIEWS
from gibson_sim.cli.options import add_settings, settings_from_args
from gibson_sim.cli.ports import check_port
from gibson_sim.client_config import DriveConfig, FoxgloveConfig, RecordConfig, SnapshotConfig, WebConfig
from gibson_sim.config import PhysicsConfig, RenderConfig
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted

_OF_ONE_ROBOT = ("clock", "tf", "odom", "ground_truth/odom", "joint_states", STATE_TOPIC)
"""Topics of every robot."""
_RENDER = tuple(f.name for f in fields(RenderConfig) if f.name not in ("digests", "summary_path"))
_FIRST = "scene and robots"
_GROUPS: dict[str, tuple[str, ...]] = {
    _FIRST: ("scene", "robot", "start", "robot_tf", "seed", "map", "map_resolution", "publish_map_tf"),
    "time": ("rate", "duration", "start_paused", "reset_time", "step_hz", "clock_hz", "publish_hz"),
    "commands and grippers": (
        "cmd_vel_timeout",
        "cmd_vel_type",
        "grasp_mode",
        "grasp_distance",
        "grasp_force",
        "grasp_release_force",
        "grasp_release_angle_deg",
    ),
    "cameras": ("camera_rate", "camera_outputs", "camera_fill", "cameras", "views", "view_size", "view_rate", "register_depth"),
    "compressed images": (
        "compressed_format",
        "jpeg_quality",
        "png_level",
        "compressed_depth_max",
        "compressed_depth_quantization",
    ),
    "rendering": (
        "egl_device",
        "egl_uuid",
        "egl_library",
        "detail_px",
        "compress_textures",
        "cache",
        "asset_roots",
        "sdf_lamps",
        "randomise",
        "randomise_seed",
    ),
    "lockstep": (
        "lockstep",
        "pipelined",
        "participants",
        "participant_timeout",
        "on_timeout",
        "image_timeout",
        "digests",
    ),
}
"""Settings of both nodes, grouped by subject, in the order of the help."""


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "run",
        help="start the simulation: both nodes, and on request a drive, a recording or a video",
        usage="%(prog)s [options]",
        description="Starts the physics and the render node, and stops both on Ctrl-C, after --duration or at the end of the drive. "
        "Most used: --scene, --robot, --web, --drive, --record; all have defaults.",
    )
    for title, settings in _GROUPS.items():
        group = parser.add_argument_group(title)
        if title == "rendering":
            group.add_argument("--no-render", action="store_true", help="run physics only, without images")
        add_settings(group, PhysicsConfig, [name for name in settings if name not in _RENDER])
        add_settings(group, RenderConfig, [name for name in settings if name in _RENDER])
        if title == _FIRST:
            _add_uses(parser)
    job = parser.add_argument_group("the run")
    add_network(job)
    job.add_argument("--summary", metavar="FILE.json", help="also write the measurements to this file")
    parser.set_defaults(run=run)


def _add_uses(parser: argparse.ArgumentParser) -> None:
    """Adds the options of additional functions of a run: a page, a drive, a recording."""
    web = parser.add_argument_group("page")
    web.add_argument(
        "--web",
        action="store_true",
        help=f"serve a page for any browser; its address is printed. Without --record and --video, it comes with --views {PAGE_VIEWS}",
    )
    web.add_argument(
        "--web-host", metavar="ADDRESS", help="address to serve it on (default: 127.0.0.1, this machine alone); implies --web"
    )
    web.add_argument(
        "--web-port",
        metavar="PORT",
        type=int,
        help="TCP port of the page (default: 8080, or any if that is taken); implies --web",
    )
    web.add_argument(
        "--web-token", metavar="TEXT", help="access token for pages on other machines (default: generated and printed)"
    )
    web.add_argument(
        "--web-folder",
        metavar="DIR",
        help="folder of the page's recordings; the page lists what is below it: bags, reports of trials (default: out/web)",
    )
    web.add_argument(
        "--foxglove",
        action="store_true",
        help="serve the Foxglove WebSocket protocol, to this machine alone; needs `pip install foxglove-sdk`",
    )
    web.add_argument(
        "--foxglove-port",
        metavar="PORT",
        type=int,
        help="its TCP port (default: 8765, or any if that is taken); implies --foxglove",
    )
    drive = parser.add_argument_group("drive")
    drive.add_argument(
        "--drive",
        metavar="NAME|FILE",
        help="drive the robot, then end: tour, forward, square, spin, or a file with lines `linear angular seconds` (default: no drive)",
    )
    add_settings(drive, DriveConfig, ("length", "linear", "angular", "stamped"))
    record = parser.add_argument_group("record")
    record.add_argument("--record", metavar="DIR", help="record a rosbag2 bag into this folder, which must not exist")
    add_settings(
        record,
        RecordConfig,
        ("topics", "record_images", "storage", "compression", "max_bag_size", "max_bag_duration", "flush_period", "reserve_mb"),
    )
    record.add_argument("--video", metavar="FILE.mp4", help="write a video and, beside it, a contact sheet PNG of RGB and depth")
    record.add_argument("--snapshot", metavar="DIR", help="write one PNG of each image of every camera, then stop")


def run(args: argparse.Namespace) -> int:
    """Runs the job; returns the exit code."""
    require_nodes()
    check_ports(args)
    environment = environment_of(args)
    code, _ = run_job(lambda folder: _plan(args, folder, domain_of(environment)), environment)
    return code


def check_ports(args: argparse.Namespace) -> None:
    """Checks the requested ports before processes are started.

    Raises:
        ConfigError: one cannot be used.
    """
    if args.web_port is not None:
        check_port("--web-port", args.web_host or WebConfig().host, args.web_port)
    if args.foxglove_port is not None:
        check_port("--foxglove-port", FoxgloveConfig().host, args.foxglove_port)


def _plan(args: argparse.Namespace, folder: Path, domain: int = 0) -> Job:
    """Returns the job for the options, in a ROS domain.

    Raises:
        GibsonSimError: an option is invalid; nothing was started yet.
    """
    physics_config = settings_from_args(PhysicsConfig, args)
    job = Job(folder, video=_new_file(args.video), summary=Path(args.summary) if args.summary else None)
    waits = {} if args.no_render else {STATE_TOPIC: 1}
    physics: dict[str, Any] = {"summary_path": str(folder / "physics.json")}
    if args.drive:
        waits[ROBOTS] = waits[COMMANDS] = 1
        if args.drive == "tour" and args.publish_map_tf is None:
            physics["publish_map_tf"] = True
    if args.snapshot:
        job.configs["snapshot"] = SnapshotConfig(output=args.snapshot)
    if args.record or args.video:
        job.bag = Path(args.record) if args.record else folder / "bag"
        job.keep_bag = bool(args.record)
        record = {"output": str(job.bag), "summary_path": str(folder / "record.json")}
        settings = settings_from_args(RecordConfig, args, duration=0.0, **record)
        check_new_bag(job.bag, settings.reserve_mb)
        job.configs["record"] = settings
        topics = [topic.lstrip("/") for topic in settings.wanted_topics()]
        if args.video and settings.record_images == "none":
            raise ConfigError("--video is made of recorded images: leave --record-images none out, or make it compressed")
        cameras = () if args.no_render or settings.record_images == "none" else (CAMERAS,)
        for topic in [t for t in topics if t in _OF_ONE_ROBOT] if topics else (STATE_TOPIC, ROBOTS, *cameras):
            waits[topic] = waits.get(topic, 0) + 1
    if args.drive:
        topics = [topic.lstrip("/") for topic in job.configs["record"].wanted_topics()] if job.bag else ["none"]
        recorded = not topics or "cmd_vel" in topics
        job.configs["drive"] = _drive_settings(args, physics_config, subscribers=1 + recorded)
    if args.web or args.web_host or args.web_port is not None:
        job.configs["web"] = _web_settings(args)
        waits[WEB] = 1
        if args.views is None and not args.no_render and not job.bag:  # a recording would have each of them drawn
            physics["views"] = PAGE_VIEWS
    if args.foxglove or args.foxglove_port is not None:
        job.configs["foxglove"] = _foxglove_settings(args)
    if not args.no_render:
        job.configs["render"] = settings_from_args(RenderConfig, args, summary_path=str(folder / "render.json"))
    elif args.video or args.snapshot:
        raise ConfigError("--no-render makes no images: leave it out, or leave out --video and --snapshot")
    if physics_config.sync.lockstep:
        ours = ["drive"] * bool(args.drive) + ["render"] * (not args.no_render) + ["record"] * bool(job.bag)
        physics["participants"] = "; ".join(filter(None, (*ours, physics_config.sync.participants)))
    physics["wait_for"] = ",".join(f"{topic}:{count}" for topic, count in waits.items())
    job.configs["physics"] = config = settings_from_args(PhysicsConfig, args, **physics)
    drive = f"the drive {args.drive} commands the robot" if args.drive else ""
    ends = [f"after {config.time.duration:g} s of simulation time"] * bool(config.time.duration) + [
        "at the end of the drive"
    ] * bool(drive)
    ends += ["when the images are written"] * bool(args.snapshot)
    web = job.configs.get("web")
    taken_port = WebConfig().port if web and not web.port and args.web_port is None else 0
    job.hints = Hints(domain, drive, f"{', '.join(ends)} or Ctrl-C" if ends else "Ctrl-C", config.time.start_paused, taken_port)
    return job


def _web_settings(args: argparse.Namespace) -> WebConfig:
    """Returns the settings of the page: the default port, or any free port if it is occupied."""
    given = {"host": args.web_host, "port": args.web_port, "token": args.web_token, "folder": args.web_folder}
    config = WebConfig(**{name: value for name, value in given.items() if value is not None})
    if args.web_port is None and not is_free(config.host, config.port):
        return replace(config, port=0)
    return config


def _foxglove_settings(args: argparse.Namespace) -> FoxgloveConfig:
    """Returns the settings of the Foxglove server: the default port, or any free port if it is occupied."""
    require_foxglove()
    if args.foxglove_port is not None:
        return FoxgloveConfig(port=args.foxglove_port)
    config = FoxgloveConfig()
    return config if is_free(config.host, config.port) else replace(config, port=0)


def _drive_settings(args: argparse.Namespace, physics: PhysicsConfig, subscribers: int) -> DriveConfig:
    """Returns the settings of the drive: a tour as long as the duration allows, with a command type that the robot accepts."""
    given: dict[str, Any] = {"subscribers": subscribers, "scene": physics.world.scene, "robot": physics.world.robot}
    if args.drive == "keyboard":
        raise ConfigError("--drive keyboard needs the terminal: run `gibson-sim drive keyboard` in a second one")
    config = settings_from_args(DriveConfig, args)
    if args.duration and args.length is None and args.drive == "tour":
        given["length"] = max(1.0, args.duration * config.linear)
    if physics.commands.cmd_vel_type == "stamped":
        given["stamped"] = True
    elif physics.commands.cmd_vel_type == "twist" and config.stamped:
        raise ConfigError("--stamped sends TwistStamped, which --cmd-vel-type twist does not receive: leave one of them out")
    return settings_from_args(DriveConfig, args, **given)


def _new_file(name: str | None) -> Path | None:
    if name is None:
        return None
    path = Path(name)
    if path.suffix.lower() != ".mp4":
        raise ConfigError(f"--video {quoted(name)}: the name must end in .mp4; other kinds of video are not written")
    return path
