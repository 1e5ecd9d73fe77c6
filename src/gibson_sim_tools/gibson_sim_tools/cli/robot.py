"""``gibson-sim scene robot``: writes a ``robot.yaml`` for a URDF, test-drives a robot, draws it, and makes the meshes of ``arm_bot``."""

from __future__ import annotations

import argparse
import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gibson_sim.cli.parser import ExitCode
from gibson_sim.errors import ConfigError, GibsonSimError, RenderError, RobotError
from gibson_sim.picture_files import write_picture
from gibson_sim.quoting import quoted
from gibson_sim.robots.load import derive_file, find_robot_file
from gibson_sim.robots.loading.derive import DESCRIPTION_SUFFIXES
from gibson_sim.robots.loading.guess import Guess
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.robot_files import load_robot, mesh_points
from gibson_sim.writing import write_file
from gibson_sim_tools.robots.robot_file import robot_file_text

_TOLD_BY_REPORT = ("gibson_sim.robots.load", "gibson_sim.physics.world")
"""Loggers whose warnings about a description are in the report."""


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "robot",
        help="write a robot.yaml for a URDF or a xacro and test-drive it; check a robot and draw it; make the meshes of arm_bot",
    )
    parser.add_argument("robot", help="name of a robot, or a robot.yaml, URDF or xacro, or a folder with one")
    parser.add_argument(
        "--new",
        action="store_true",
        help="write a robot.yaml with values guessed from a URDF or a xacro, test it as --trial does, and draw it",
    )
    parser.add_argument(
        "--output",
        default="robot.yaml",
        metavar="FILE",
        help="with --new: the file to write (default: robot.yaml); its picture is written beside it",
    )
    parser.add_argument(
        "--xacro-arg",
        action="append",
        default=[],
        metavar="NAME:=VALUE",
        help="with --new: argument of the xacro; may be repeated",
    )
    parser.add_argument(
        "--trial",
        action="store_true",
        help="measure how the robot stands, drives 1 m and turns 360 degrees on a flat floor; report its footprint and topics",
    )
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
        "--make-meshes", action="store_true", help="first rewrite meshes/ in the folder of its URDF (arm_bot only)"
    )
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> ExitCode:
    guesses: Sequence[Guess] = ()
    path = find_robot_file(args.robot)
    is_description = path.suffix.lower() in DESCRIPTION_SUFFIXES
    if args.new:
        if not is_description:
            raise RobotError(f"--new is for a URDF or a xacro; {path} is a robot.yaml already: test it with --trial")
        output = Path(args.output)
        guesses = _write(path, output, _arguments(args.xacro_arg))
        args.robot, args.picture = str(output), args.picture or str(output.with_suffix(".png"))
    elif args.xacro_arg:
        raise ConfigError("--xacro-arg goes with --new: a robot.yaml keeps the arguments of a xacro")
    elif is_description:
        guesses = derive_file(path, mesh_points()).guesses
        _print_guesses(guesses)
    with _unlogged(_TOLD_BY_REPORT if args.new or args.trial else ()):
        return _check(args, guesses)


def _check(args: argparse.Namespace, guesses: Sequence[Guess]) -> ExitCode:
    """Loads, lists, tests and draws the robot."""
    robot = load_robot(args.robot)
    if args.make_meshes:
        # Loaded here: the other sub-commands need none of it.
        from gibson_sim_tools.making.robots.arm_bot import write_arm_bot

        if robot.urdf.stem != "arm_bot":
            raise GibsonSimError(f"--make-meshes is for arm_bot; the meshes of {args.robot} are not made here")
        write_arm_bot(robot.urdf.parent / "meshes")
    _print_robot(robot)
    if args.new or args.trial:
        from gibson_sim_tools.robots.report import report_lines
        from gibson_sim_tools.robots.trial import try_robot

        print("\n".join(report_lines(try_robot(robot, mesh_points()), guesses)))
    if args.picture:
        _draw(robot, args, needed=not args.new)
    if args.new:
        print(f"run it: gibson-sim run --robot {args.robot}; after changes: gibson-sim scene robot {args.robot} --trial")
    return ExitCode.OK


@contextmanager
def _unlogged(names: Sequence[str]) -> Iterator[None]:
    """Keeps loggers from warning: the report has the same lines, once."""
    levels = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.ERROR)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


def _print_robot(robot: RobotSpec) -> None:
    drive = "none" if robot.drive is None else robot.drive.kind
    print(f"{robot.urdf}: {len(robot.links)} links, {len(robot.moving_joints)} joints that move, drive: {drive}")
    print(f"radius {robot.radius:.3g} m, height {robot.height:.3g} m")
    for arm in robot.manipulators:
        print(f"manipulator {arm.name}: {', '.join(arm.joints)} -> {arm.tip_link}")
    for pose in robot.named_poses:
        print(f"pose {pose.name}: {', '.join(f'{name} {at:g}' for name, at in pose.joints)}")


def _draw(robot: RobotSpec, args: argparse.Namespace, *, needed: bool) -> None:
    """Draws the robot; where no device draws, that is an error only if the picture is ``needed``."""
    from gibson_sim_tools.making.robots.picture import robot_picture

    try:
        picture = robot_picture(robot, args.pose, width=args.size, height=args.size, yaw_deg=args.yaw_deg)
    except RenderError as error:
        if needed:
            raise
        print(f"no picture: {error}")
        return
    write_picture(Path(args.picture), picture[:, :, ::-1])
    print(f"picture: {args.picture} (the arrow on the floor points ahead)")


def _arguments(words: list[str]) -> dict[str, str]:
    """Returns the arguments of a xacro by name."""
    arguments = {}
    for word in words:
        name, mark, value = word.partition(":=")
        if not (name and mark):
            raise ConfigError(f"--xacro-arg is {quoted(word)}, must be NAME:=VALUE")
        arguments[name] = value
    return arguments


def _write(description: Path, output: Path, arguments: dict[str, str]) -> Sequence[Guess]:
    """Writes a ``robot.yaml`` with values guessed from a description, and prints the guesses."""
    if output.suffix.lower() not in (".yaml", ".yml"):
        raise ConfigError(f"--output is {quoted(str(output))}, must end in .yaml")
    if output.exists():
        raise ConfigError(f"{output}: already exists; name another file with --output, or remove it")
    derived = derive_file(description, mesh_points(), arguments, needs_drive=False)
    beside = description.is_relative_to(output.parent.absolute())
    urdf = os.path.relpath(description, output.parent.absolute()) if beside else str(description)
    write_file(output, robot_file_text(urdf, arguments, derived))
    print(f"{output}: written")
    _print_guesses(derived.guesses)
    return derived.guesses


def _print_guesses(guesses: Sequence[Guess]) -> None:
    for guess in guesses:
        print(f"guessed {guess}")
