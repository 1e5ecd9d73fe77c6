"""``gibson-sim scene robot``: draws a robot alone, writes a ``robot.yaml`` for a URDF, and makes the meshes of ``arm_bot``."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import yaml

from gibson_sim.cli.parser import ExitCode
from gibson_sim.errors import ConfigError, GibsonSimError, RobotError
from gibson_sim.picture_files import write_picture
from gibson_sim.quoting import quoted
from gibson_sim.robots.load import derive_file, find_robot_file
from gibson_sim.robots.loading.derive import DESCRIPTION_SUFFIXES
from gibson_sim.scenes.robot_files import load_robot, mesh_points
from gibson_sim.writing import write_file


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "robot", help="check a robot and draw it alone; write a robot.yaml for a URDF; make the meshes of arm_bot"
    )
    parser.add_argument("robot", help="name of a robot, or a robot.yaml, URDF or xacro, or a folder with one")
    parser.add_argument("--picture", default="", metavar="FILE", help="draw the robot: PNG or JPEG")
    parser.add_argument("--pose", default="", metavar="NAME", help="a named pose of the robot (default: its initial pose)")
    parser.add_argument("--size", type=int, default=640, metavar="PX", help="edge of the picture (default: 640)")
    parser.add_argument(
        "--yaw-deg",
        type=float,
        default=-35.0,
        metavar="DEG",
        help="azimuth of the camera; 0 = straight ahead of the robot (default: -35)",
    )
    parser.add_argument(
        "--write", default="", metavar="FILE", help="write a robot.yaml with values guessed from a URDF, for editing"
    )
    parser.add_argument(
        "--xacro-arg",
        action="append",
        default=[],
        metavar="NAME:=VALUE",
        help="xacro argument, with --write; may be repeated",
    )
    parser.add_argument(
        "--make-meshes", action="store_true", help="first rewrite meshes/ in the folder of its URDF (arm_bot only)"
    )
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> ExitCode:
    if args.write:
        _write(find_robot_file(args.robot), Path(args.write), _arguments(args.xacro_arg))
        args.robot = args.write
    elif args.xacro_arg:
        raise ConfigError("--xacro-arg goes with --write: a robot.yaml keeps the arguments of a xacro")
    else:
        path = find_robot_file(args.robot)
        if path.suffix.lower() in DESCRIPTION_SUFFIXES:
            print("\n".join(f"guessed {note}" for note in derive_file(path, mesh_points()).guesses))
    robot = load_robot(args.robot)
    if args.make_meshes:
        # Loaded here: the other sub-commands need none of it.
        from gibson_sim_tools.making.robots.arm_bot import write_arm_bot

        if robot.urdf.stem != "arm_bot":
            raise GibsonSimError(f"--make-meshes is for arm_bot; the meshes of {args.robot} are not made here")
        write_arm_bot(robot.urdf.parent / "meshes")
    drive = "none" if robot.drive is None else robot.drive.kind
    print(f"{robot.urdf}: {len(robot.links)} links, {len(robot.moving_joints)} joints that move, drive: {drive}")
    print(f"radius {robot.radius:.3g} m, height {robot.height:.3g} m")
    for arm in robot.manipulators:
        print(f"manipulator {arm.name}: {', '.join(arm.joints)} -> {arm.tip_link}")
    for pose in robot.named_poses:
        print(f"pose {pose.name}: {', '.join(f'{name} {at:g}' for name, at in pose.joints)}")
    if args.picture:
        from gibson_sim_tools.making.robots.picture import robot_picture

        path = Path(args.picture)
        picture = robot_picture(robot, args.pose, width=args.size, height=args.size, yaw_deg=args.yaw_deg)
        write_picture(path, picture[:, :, ::-1])
        print(path)
    return ExitCode.OK


def _arguments(words: list[str]) -> dict[str, str]:
    """Returns the arguments of a xacro by name."""
    arguments = {}
    for word in words:
        name, mark, value = word.partition(":=")
        if not (name and mark):
            raise ConfigError(f"--xacro-arg is {quoted(word)}, must be NAME:=VALUE")
        arguments[name] = value
    return arguments


def _write(description: Path, output: Path, arguments: dict[str, str]) -> None:
    """Writes a ``robot.yaml`` with values guessed from a description."""
    if description.suffix.lower() not in DESCRIPTION_SUFFIXES:
        raise RobotError(f"--write is for a URDF or a xacro; {description} is a robot.yaml already")
    if output.suffix.lower() not in (".yaml", ".yml"):
        raise ConfigError(f"--write is {quoted(str(output))}, must end in .yaml")
    if output.exists():
        raise ConfigError(f"--write {output}: is there already; name another file, or remove it")
    derived = derive_file(description, mesh_points(), arguments, needs_drive=False)
    beside = description.is_relative_to(output.parent.absolute())
    values: dict[str, Any] = {"urdf": os.path.relpath(description, output.parent.absolute()) if beside else str(description)}
    if arguments:
        values["xacro_args"] = arguments
    values |= derived.values
    notes = "".join(f"# {note}\n" for note in derived.guesses)
    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    write_file(output, f"# Guessed from {description.name}; check it. The keys: docs/robots.md\n{notes}{text}")
    print(f"{output}: written\n{''.join(f'guessed {note}' + chr(10) for note in derived.guesses)}", end="")
