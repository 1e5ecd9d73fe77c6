"""``gibson-sim scene texture``: a textured scene from a mesh and posed photographs."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from gibson_sim.bags.progress import progress_bar
from gibson_sim.cli.options import add_settings, settings_from_args
from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.report_file import write_json
from gibson_sim.errors import ConfigError
from gibson_sim_tools.texturing.settings import TextureSettings


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "texture",
        help="texture a mesh from posed photographs (our scans; Open3D, 7-Scenes, TUM, COLMAP and nerfstudio folders)",
        description="Writes a scene whose textures are parts of the photographs. docs/texturing.md says how.",
    )
    parser.add_argument("photographs", type=Path, metavar="PHOTOS", help="folder of posed photographs; the layout is detected")
    parser.add_argument("mesh", type=Path, metavar="MESH", help="mesh file, z up, metres, in the frame of the poses")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="new folder of the scene")
    parser.add_argument("--name", default="", help="of the scene (default: that of the folder)")
    parser.add_argument(
        "--level",
        action="store_true",
        help="turn the scene so that z is up and the floor is at z = 0, for scans that begin at a camera",
    )
    parser.add_argument(
        "--hold-out",
        type=int,
        default=0,
        metavar="N",
        help="leave out every N-th photograph, from the first on, and compare it with the scene (0 = use all)",
    )
    parser.add_argument(
        "--sheet",
        type=Path,
        metavar="FILE",
        help="with --hold-out: write a picture of photographs beside the scene, .jpg or .png",
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write what was found as JSON")
    add_settings(parser, TextureSettings, [f.name for f in fields(TextureSettings)])
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> ExitCode:
    # Loaded here: the other sub-commands need none of it.
    from gibson_sim.formats.load_mesh import load_mesh
    from gibson_sim.picture_files import write_picture
    from gibson_sim_tools.texturing.measure import contact_sheet, held_out_likeness
    from gibson_sim_tools.texturing.photograph_layouts import open_photographs
    from gibson_sim_tools.texturing.surface import surface_of
    from gibson_sim_tools.texturing.texture import texture
    from gibson_sim_tools.texturing.textured_scene import write_textured_scene

    settings = settings_from_args(TextureSettings, args)
    if args.output.exists() and (not args.output.is_dir() or any(args.output.iterdir())):
        raise ConfigError(f"--output {args.output}: is there already and not empty; give another folder, or delete it first")
    if args.hold_out < 0 or args.hold_out == 1:
        raise ConfigError(f"--hold-out {args.hold_out}: must be 0, or 2 or more, so that photographs are left")
    if args.sheet is not None and not args.hold_out:
        raise ConfigError(
            f"--sheet {args.sheet}: shows photographs that were held out; give --hold-out, too, such as --hold-out 10"
        )
    photographs = open_photographs(args.photographs, settings.longest_side)
    for warning in photographs.warnings:
        print(f"gibson-sim: {photographs.folder}: {warning}", file=sys.stderr)
    surface = surface_of(load_mesh(args.mesh, [args.mesh.resolve().parent]))
    with progress_bar(f"texturing from {len(photographs)} photographs ({photographs.layout})") as progress:
        held_out = range(0, len(photographs), args.hold_out) if args.hold_out else range(0)
        textured = texture(surface, photographs, settings, progress, held_out=held_out)
    file = write_textured_scene(textured, args.output, args.name, level=args.level)
    for line in textured.report.lines():
        print(line)
    likeness = held_out_likeness(textured, held_out) if args.hold_out else {}
    for name, alike in likeness.items():
        print(f"{len(held_out)} photographs that were held out, {name}: PSNR {alike.psnr:.2f} dB, SSIM {alike.ssim:.3f}")
    if args.sheet is not None:
        write_picture(args.sheet, contact_sheet(textured, held_out)[:, :, ::-1])
    print(f"next: gibson-sim scene check {file.parent}; gibson-sim run --scene {file.parent}")
    write_json(args.report, {**textured.report.as_dict(), "held_out": {name: asdict(alike) for name, alike in likeness.items()}})
    return ExitCode.OK
