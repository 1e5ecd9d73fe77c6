"""``gibson-sim scene objects``: generates the built-in objects with Blender."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2

from gibson_sim.cli.parser import ExitCode
from gibson_sim.picture_files import write_picture


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "objects", help="generate the built-in objects with Blender: meshes, URDFs and, with --picture, a picture of them"
    )
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="objects to generate (default: all)")
    parser.add_argument("--output", default="scenes/objects", metavar="DIR", help="output folder (default: scenes/objects)")
    parser.add_argument(
        "--blender-python",
        default="",
        metavar="FILE",
        help="Python interpreter with Blender, `pip install bpy` (default: this one)",
    )
    parser.add_argument("--picture", default="", metavar="FILE", help="write a picture of the objects, PNG")
    parser.add_argument("--picture-only", action="store_true", help="only render the objects in --output; does not need Blender")
    parser.add_argument("--table", action="store_true", help="only print a table of sizes, masses and joints")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> ExitCode:
    # Lazy import: the other sub-commands do not need it.
    from gibson_sim_tools.making.objects.catalogue import objects_table
    from gibson_sim_tools.making.objects.program import default_blender_python, make_objects, select_objects

    models, output = select_objects(args.only), Path(args.output)
    if args.table:
        print(objects_table(models))
        return ExitCode.OK
    if not args.picture_only:
        make_objects(args.only, output, args.blender_python or default_blender_python(), print)
    if args.picture or args.picture_only:
        from gibson_sim_tools.making.objects.sheet import sheet

        path = Path(args.picture or "objects.png")
        write_picture(path, sheet(output, models)[:, :, ::-1], (cv2.IMWRITE_PNG_COMPRESSION, 9))
        print(path)
    return ExitCode.OK
