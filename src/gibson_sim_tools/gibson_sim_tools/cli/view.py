"""``gibson-sim scene view``: renders a scene to a picture, without a display."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import cv2

from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.quiet import quiet
from gibson_sim.description.omissions import grouped
from gibson_sim.errors import ConfigError
from gibson_sim.picture_files import write_picture
from gibson_sim.scenes.load import load_scene

MAX_VIEWS = 22
"""Maximum number of views at eye height."""


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "view",
        help="write one image: views at eye height from free positions, from above, and the floor map",
        description="Writes one image of a scene: views at eye height from free positions, from above, and the floor map. For several "
        "scenes: one row of views for each.",
    )
    parser.add_argument("scene", metavar="SCENE", nargs="+", help="name, folder or file of a scene")
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help="the picture, .png or .jpg (default: NAME_view.png, after the first scene)"
    )
    parser.add_argument("--views", type=int, default=4, metavar="N", help="views at eye height (default: 4)")
    parser.add_argument(
        "--floor",
        type=int,
        default=None,
        metavar="N",
        help="index of the floor, 0 = the lowest (default: the floor of the start poses); only for one scene",
    )
    parser.add_argument("--width", type=int, default=0, metavar="PX", help="width of the picture (default: 640 pixels per view)")
    parser.set_defaults(run=_run)


@quiet()
def _run(args: argparse.Namespace) -> ExitCode:
    # Lazy import: the other sub-commands do not need OpenGL.
    from gibson_sim_tools.importing.views import contact_sheet, gallery_of_scenes

    if not 1 <= args.views <= MAX_VIEWS:
        raise ConfigError(f"--views is {args.views}, must be 1 to {MAX_VIEWS}")
    scenes = [load_scene(name) for name in args.scene]
    # First: who sees a part of a scene should know that it is not the whole.
    for scene in scenes:
        for line in grouped(scene.warnings):
            print(f"{scene.name}: {line}", file=sys.stderr)
    scene = scenes[0]
    if len(scenes) > 1:
        if args.floor is not None:
            raise ConfigError(
                "--floor is for one scene; for several scenes, all floors are shown: name one scene, or leave --floor out"
            )
        picture = gallery_of_scenes(scenes, args.views)
    else:
        if args.floor is not None and not 0 <= args.floor < len(scene.floors):
            raise ConfigError(f"--floor is {args.floor}, scene {scene.name!r} has floors 0 to {len(scene.floors) - 1}")
        picture = contact_sheet(scene, args.views, floor_z=None if args.floor is None else scene.floors[args.floor])
    if args.width:
        height = round(picture.shape[0] * args.width / picture.shape[1])
        picture = cv2.resize(picture, (args.width, height), interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
    path = args.output or Path(f"{scene.name}_view.png")
    write_picture(path, picture[:, :, ::-1])
    print(path)
    return ExitCode.OK
