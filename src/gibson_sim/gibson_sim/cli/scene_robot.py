"""``gibson-sim scene robot``: shows a robot alone, and makes the meshes of our mobile manipulator."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2

from gibson_sim.cli.exit_codes import ExitCode
from gibson_sim.errors import GibsonSimError
from gibson_sim.robots.load import load_robot


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser("robot", help="check a robot and draw it alone; make the meshes of arm_bot")
    parser.add_argument("robot", help="the name of a robot, a robot.yaml, or a folder with one")
    parser.add_argument("--picture", default="", metavar="FILE", help="draw it: a PNG or a JPEG")
    parser.add_argument("--pose", default="", metavar="NAME", help="one of its named poses (default: as it starts)")
    parser.add_argument("--size", type=int, default=640, metavar="PX", help="edge of the picture (default: 640)")
    parser.add_argument(
        "--yaw-deg", type=float, default=-35.0, metavar="DEG", help="seen from here; 0 = from ahead (default: -35)"
    )
    parser.add_argument(
        "--make-meshes", action="store_true", help="first write meshes/ in the folder of its URDF anew (arm_bot alone)"
    )
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> ExitCode:
    robot = load_robot(args.robot)
    if args.make_meshes:
        # Loaded here: the other sub-commands need none of it.
        from gibson_sim.making.robots.arm_bot import write_arm_bot

        if robot.urdf.stem != "arm_bot":
            raise GibsonSimError(f"--make-meshes is for arm_bot; the meshes of {args.robot} are not made here")
        write_arm_bot(robot.urdf.parent / "meshes")
    drive = "none" if robot.drive is None else robot.drive.kind
    print(f"{robot.urdf}: {len(robot.links)} links, {len(robot.moving_joints)} joints that move, drive: {drive}")
    for arm in robot.manipulators:
        print(f"manipulator {arm.name}: {', '.join(arm.joints)} -> {arm.tip_link}")
    for pose in robot.named_poses:
        print(f"pose {pose.name}: {', '.join(f'{name} {at:g}' for name, at in pose.joints)}")
    if args.picture:
        from gibson_sim.making.robots.picture import robot_picture

        path = Path(args.picture)
        picture = robot_picture(robot, args.pose, width=args.size, height=args.size, yaw_deg=args.yaw_deg)
        path.parent.mkdir(parents=True, exist_ok=True)
        options = [cv2.IMWRITE_JPEG_QUALITY, 88] if path.suffix.lower() in (".jpg", ".jpeg") else []
        if not cv2.imwrite(str(path), picture[:, :, ::-1], options):
            raise GibsonSimError(f"{path} cannot be written: is the folder writable, and does the name end in .png or .jpg?")
        print(path)
    return ExitCode.OK
