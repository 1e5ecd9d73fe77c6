"""``gibson-sim gallery``: renders one image of all outputs, cameras, effects and lights of a scene."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gibson_sim.cli.parser import ExitCode
from gibson_sim.config import DEFAULT_SCENE
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_matrix
from gibson_sim.maps.placement import populate
from gibson_sim.picture_files import write_picture
from gibson_sim.resources import find_config
from gibson_sim.scenes.randomise import load_rules
from gibson_sim.scenes.spec import drawn_scene


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser("gallery", help="write one image of all outputs, cameras, effects and lights of a scene")
    parser.add_argument(
        "scene", nargs="?", default=DEFAULT_SCENE, help=f"name, folder or file of a scene (default: {DEFAULT_SCENE})"
    )
    parser.add_argument("--output", default="gallery.png", metavar="FILE", help="the picture (default: gallery.png)")
    parser.add_argument(
        "--at", default="", metavar="PLACE", help="name of a start pose, or x,y,yaw_deg (default: the scene's first start pose)"
    )
    parser.add_argument("--rules", default="example", metavar="FILE", help="randomisation rules (default: example)")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> ExitCode:
    # Imported here, since the other sub-commands do not need OpenGL.
    from gibson_sim.render.cache import default_folder
    from gibson_sim.sensors.gallery import EYE_HEIGHT, gallery

    scene = populate(args.scene, "gibson_bot", args.at)
    eye = matrix_from_pose(scene.robots[0].start)
    eye[2, 3] += EYE_HEIGHT
    rules = load_rules(find_config(args.rules, "randomisation"))
    picture = gallery(drawn_scene(scene, ()), pose_from_matrix(eye), rules, default_folder())
    path = Path(args.output)
    write_picture(path, picture[:, :, ::-1])
    print(path)
    return ExitCode.OK
