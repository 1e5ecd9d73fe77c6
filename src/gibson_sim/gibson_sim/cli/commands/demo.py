"""``gibson-sim demo``: runs a scripted robot in a new simulation, and writes a film strip and a video of it."""

from __future__ import annotations

import argparse
import json
import math
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim.bags.film import write_film, write_film_strip
from gibson_sim.bags.reader import BagReader
from gibson_sim.cli.console import say
from gibson_sim.cli.environment import add_network, environment_of, require_nodes
from gibson_sim.cli.job import STATE_TOPIC, Job, run_job
from gibson_sim.cli.parser import ExitCode, choice_error
from gibson_sim.cli.report_file import write_json
from gibson_sim.client_config import RecordConfig, TaskConfig
from gibson_sim.config import DEFAULT_SCENE, PhysicsConfig, RenderConfig
from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import yaw_from_quat
from gibson_sim.resources import find_scene
from gibson_sim.types import NS_PER_S
from gibson_sim.writing import write_file

if TYPE_CHECKING:
    from gibson_sim.tasks.episode import Episode
    from gibson_sim.tasks.scripts.doors import HingedDoor

DEMOS = {"open-door": "drives to a closed door, grasps its handle, pulls it open by backing up, and drives through"}
VIEW = "view_orbit"
_LATE_S = 120.0
"""Timeout of a lockstep participant, seconds of wall time: software rendering is slow."""
_TOPICS = ("scene", STATE_TOPIC, "cmd_vel", "joint_command", "grasp", "grasp_state", "task/info", "task/goal", "task/result")
_MOST_HZ = 60.0
"""Maximum image rate, Hz."""


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "demo",
        help="let a robot open a door; write a film strip and a video of it",
        description="Starts its own simulation in lockstep, in which a scripted robot drives by published commands, and measures it.",
    )
    parser.add_argument("demo", metavar="NAME", help="; ".join(f"{name}: the robot {about}" for name, about in DEMOS.items()))
    parser.add_argument(
        "--scene", default=DEFAULT_SCENE, help=f"name or path of a scene with doors, or arena (default: {DEFAULT_SCENE})"
    )
    parser.add_argument("--robot", default="arm_bot", help="name or path of a robot with an arm and a camera (default: arm_bot)")
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of start, door, height of the handle, damping and friction (default: 0)"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("open_door"), metavar="DIR", help="folder to write to (default: open_door)"
    )
    parser.add_argument("--image-rate", type=float, default=10.0, metavar="HZ", help="images per second (default: 10)")
    parser.add_argument(
        "--size", default="640x480", metavar="WxH", help="size of an image in the video, pixels (default: 640x480)"
    )
    parser.add_argument("--columns", type=int, default=6, help="moments in the film strip (default: 6)")
    parser.add_argument("--keep-bag", action="store_true", help="keep the recorded bag in the folder")
    add_network(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Runs the demo; returns the exit code of the job, or 1 if the robot did not succeed."""
    _check(args)
    require_nodes()
    from gibson_sim.tasks.ground import ground_of
    from gibson_sim.tasks.kinds.open_door import OPEN, OpenDoor, episode_door
    from gibson_sim.tasks.scripts.arm import Arm

    find_scene(args.scene)
    ground = ground_of(args.scene, args.robot)
    if not ground.robot.cameras:
        raise ConfigError(f"robot {args.robot!r} has no camera; choose one that has, such as arm_bot")
    Arm(ground.robot)  # raises if the robot has no arm
    episode = OpenDoor().generate(args.seed, ground)
    bag = args.out / "bag"
    if bag.exists():
        raise ConfigError(f"--out {args.out}: it contains a bag already; give another folder, or remove {bag}")
    args.out.mkdir(parents=True, exist_ok=True)
    camera = ground.robot.cameras[0].name
    try:
        code, reports = run_job(lambda folder: _plan(args, folder, episode, episode_door(episode), camera), environment_of(args))
        if code or not reports.get("task"):
            return code or ExitCode.ERROR
        measured = _measured(bag, episode_door(episode), OPEN)
        for path in _pictures(args, bag, camera, measured):
            say(f"wrote {path}")
    finally:
        if not args.keep_bag:
            shutil.rmtree(bag, ignore_errors=True)
    return _report(args, reports["task"]["all"][0], measured)


def _check(args: argparse.Namespace) -> None:
    """Raises ConfigError if an option is invalid."""
    if args.demo not in DEMOS:
        raise ConfigError(f"demo {choice_error(args.demo, DEMOS)}")
    if not 0.1 <= args.image_rate <= _MOST_HZ:
        raise ConfigError(f"--image-rate is {args.image_rate:g} Hz, must be 0.1 to {_MOST_HZ:g}")
    if not 1 <= args.columns <= 100:
        raise ConfigError(f"--columns is {args.columns}, must be 1 to 100")
    if args.seed < 0:
        raise ConfigError(f"--seed is {args.seed}, must be 0 or more")
    PhysicsConfig.of(view_size=args.size)


def _plan(args: argparse.Namespace, folder: Path, episode: Episode, door: HingedDoor, camera: str) -> Job:
    """Returns the job: the simulation, the recorder, and the task node that drives the robot."""
    views = folder / "views.yaml"
    width, height = PhysicsConfig.of(view_size=args.size).cameras.size_of_views
    write_file(views, json.dumps({"cameras": [_view(door, width, height, args.image_rate)]}))
    x, y, _ = episode.start.position
    yaw_deg = math.degrees(yaw_from_quat(episode.start.quat_xyzw))
    job = Job(folder, bag=args.out / "bag", keep_bag=True)
    job.configs["task"] = TaskConfig(
        task=episode.task,
        seed=args.seed,
        baseline="scripted",
        scene=args.scene,
        robot=args.robot,
        output=str(folder / "task.json"),
    )
    topics = (*_TOPICS, *(f"{name}/image_raw" for name in (camera, VIEW)))
    job.configs["record"] = RecordConfig(
        output=str(job.bag), topics=",".join(topics), compression="lz4", summary_path=str(folder / "record.json")
    )
    job.configs["render"] = RenderConfig(cameras=f"{camera},{VIEW}", summary_path=str(folder / "render.json"))
    job.configs["physics"] = PhysicsConfig.of(
        scene=args.scene,
        robot=args.robot,
        start=f"{x!r},{y!r},{yaw_deg!r}",
        rate=0.0,
        lockstep=True,
        participants="task; render; record",
        participant_timeout=_LATE_S,
        camera_rate=args.image_rate,
        camera_outputs="rgb",
        views=str(views),
        view_size=args.size,
        view_rate=args.image_rate,
        wait_for=f"{STATE_TOPIC}:3",
        summary_path=str(folder / "physics.json"),
    )
    return job


def _view(door: HingedDoor, width: int, height: int, rate_hz: float) -> dict[str, Any]:
    """Returns a camera above the room in front of a door, on the side from which the leaf swings away."""
    x, y = door.off(0.35 * door.width, 0.7)
    return {
        "name": VIEW,
        "width": width,
        "height": height,
        "rate_hz": rate_hz,
        "fov_y_deg": 55.0,
        "outputs": ["rgb"],
        "view": {
            "kind": "orbit",
            "center": [x, y, door.closed.position[2]],
            "distance": 2.0,
            "height": 2.1,
            "look_at": 0.55,
            "yaw_deg": math.degrees(door.outwards - door.sense * math.radians(25.0)),
            "period": 1e6,
        },
    }


def _measured(bag: Path, door: HingedDoor, wide: float) -> dict[str, float]:
    """Returns the motion of a door, measured from the published states: seconds after the start of the bag, and degrees."""
    from gibson_sim.tasks.episode import Observation
    from gibson_sim.types import Pose

    links: dict[int, list[str]] = {}
    begin, passed, end, widest, last = math.nan, math.nan, math.nan, 0.0, 0.0
    with BagReader(bag) as reader:
        first_ns = reader.span_ns[0]
        names = [name for name in reader.topics() if name.strip("/") in ("scene", STATE_TOPIC)]
        for _, log_ns, msg in sorted(reader.messages(names), key=lambda entry: entry[1]):
            if hasattr(msg, "links"):
                links[msg.revision] = list(msg.links)
                continue
            if door.leaf not in links.get(msg.revision, ()):
                continue
            row = msg.poses.reshape(-1, 7)[links[msg.revision].index(door.leaf)].tolist()
            pose = Pose((row[0], row[1], row[2]), (row[3], row[4], row[5], row[6]))
            seconds, last = (log_ns - first_ns) / NS_PER_S, door.opening(Observation(0.0, {door.leaf: pose}, ""))
            begin = seconds if math.isnan(begin) else begin
            if last > wide and math.isnan(passed):
                passed = seconds
            end, widest = seconds, max(widest, last)
    return {
        "begin_s": begin,
        "open_after_s": passed - begin,
        "end_s": end,
        "widest_deg": math.degrees(widest),
        "end_deg": math.degrees(last),
    }


def _pictures(args: argparse.Namespace, bag: Path, camera: str, measured: dict[str, float]) -> tuple[Path, Path]:
    """Writes the film strip and the video: the robot's camera at the top, the view of the robot at the bottom."""
    strip, video = args.out / f"{args.demo.replace('-', '_')}.png", args.out / f"{args.demo.replace('-', '_')}.mp4"
    write_film_strip(bag, strip, topics=(camera, VIEW), columns=args.columns, begin=measured["begin_s"])
    write_film(bag, video, topics=(camera, VIEW), begin=measured["begin_s"])
    return strip, video


def _report(args: argparse.Namespace, result: dict[str, Any], measured: dict[str, float]) -> int:
    """Prints and writes the measurements; returns the exit code."""
    opened = measured["open_after_s"]
    passed = "never 60 degrees" if math.isnan(opened) else f"60 degrees after {opened:.1f} s"
    print(
        f"{args.demo}, scene {args.scene}, seed {args.seed}: {'success' if result['success'] else 'failure'} after {result['time']:.1f} s; "
        f"door {passed}, opened by at most {measured['widest_deg']:.0f} degrees, {measured['end_deg']:.0f} at the end; "
        f"{result['path_length']:.2f} m driven, {result['collisions']} collisions"
    )
    numbers = {name: None if math.isnan(value) else value for name, value in measured.items()}
    write_json(args.out / "result.json", {"demo": args.demo, "scene": args.scene, **result, **numbers})
    return ExitCode.OK if result["success"] else ExitCode.ERROR
