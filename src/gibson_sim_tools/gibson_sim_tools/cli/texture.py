"""``gibson-sim scene texture``: textures a mesh from posed photographs and writes it as a scene."""

from __future__ import annotations

import argparse
import shlex
import sys
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from gibson_sim.bags.progress import progress_bar
from gibson_sim.cli.options import add_settings, settings_from_args
from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.report_file import write_json
from gibson_sim.errors import ConfigError
from gibson_sim_tools.cli.scan import add_camera_options, camera_overrides
from gibson_sim_tools.scanning.settings import AS_READ, AUTO
from gibson_sim_tools.texturing.settings import MOST_PHOTOGRAPHS, POSE_CONVENTIONS, TextureSettings


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "texture",
        help="texture a mesh from posed photographs (Gibson Sim scans; Open3D, 7-Scenes, TUM, COLMAP and nerfstudio folders)",
        description="Writes a scene textured from the photographs. See docs/texturing.md.",
    )
    parser.add_argument("photographs", type=Path, metavar="PHOTOS", help="folder of posed photographs; the layout is detected")
    parser.add_argument("mesh", type=Path, metavar="MESH", help="mesh file, z up, metres, in the frame of the poses")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="new folder for the scene")
    parser.add_argument("--name", default="", help="name of the scene (default: that of the folder)")
    parser.add_argument(
        "--level",
        action="store_true",
        help="rotate the scene so that z is up, and put the floor at z = 0, for scans in the frame of a camera",
    )
    parser.add_argument(
        "--hold-out",
        type=int,
        default=0,
        metavar="N",
        help="hold out every N-th photograph, from the first, and compare it with the re-rendered scene (0 = use all)",
    )
    parser.add_argument(
        "--sheet",
        type=Path,
        metavar="FILE",
        help="with --hold-out: write a contact sheet of photographs and re-rendered scene, .jpg or .png",
    )
    parser.add_argument(
        "--pose-convention",
        choices=(AS_READ, AUTO, *POSE_CONVENTIONS),
        default=AS_READ,
        help="convention of the poses: as-read = that of the layout; auto = the one for which the photographs agree best; or a name",
    )
    add_camera_options(parser)
    parser.add_argument(
        "--unit", metavar="UNIT", help="unit of poses and mesh: a name as in scene import, or metres per unit (default: metres)"
    )
    parser.add_argument(
        "--known-length",
        type=_known_length,
        metavar="MESH,METRES",
        help="instead of --unit: a length in mesh units and the true length in metres, such as 1.37,2.0 for a door",
    )
    parser.add_argument(
        "--most-photographs",
        type=int,
        default=MOST_PHOTOGRAPHS,
        metavar="N",
        help=f"maximum number of photographs; from more, the subset that covers the mesh best is selected (default: {MOST_PHOTOGRAPHS})",
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the report as JSON")
    add_settings(parser, TextureSettings, [f.name for f in fields(TextureSettings)])
    parser.set_defaults(run=_run)


def _known_length(text: str) -> float:
    """Returns metres per mesh unit, from ``MESH,METRES``."""
    try:
        measured, true = (float(word) for word in text.split(","))
    except ValueError:
        measured = true = 0.0
    if not (0.0 < measured < 1e9 and 0.0 < true < 1e9):
        raise argparse.ArgumentTypeError(
            f"{text}: must be two numbers above 0, the length in the mesh and that in metres, such as 1.37,2.0"
        )
    return true / measured


def _run(args: argparse.Namespace) -> ExitCode:
    # Lazy imports: the other sub-commands do not need them.
    from gibson_sim.formats.load_mesh import load_mesh
    from gibson_sim.picture_files import write_picture
    from gibson_sim_tools.cli.importing import unit_m
    from gibson_sim_tools.from_photographs.image_checks import check_photographs
    from gibson_sim_tools.photographs.layouts import open_photographs
    from gibson_sim_tools.scanning.posed_images import ScanError
    from gibson_sim_tools.texturing.conventions import resolve_convention
    from gibson_sim_tools.texturing.evaluation import contact_sheet, evaluate_held_out
    from gibson_sim_tools.texturing.photograph_selection import select_photographs
    from gibson_sim_tools.texturing.surface import MAX_TRIANGLES, check_split, split_count, split_long_edges, surface_from_mesh
    from gibson_sim_tools.texturing.texture import texture_surface
    from gibson_sim_tools.texturing.textured_scene import write_textured_scene

    settings = settings_from_args(TextureSettings, args)
    if args.output.exists() and (not args.output.is_dir() or any(args.output.iterdir())):
        raise ConfigError(f"--output {args.output}: already exists and is not empty; give another folder, or delete it first")
    if args.hold_out < 0 or args.hold_out == 1:
        raise ConfigError(f"--hold-out {args.hold_out}: must be 0, or 2 or more, so that some photographs are used")
    if args.sheet is not None and not args.hold_out:
        raise ConfigError(f"--sheet {args.sheet}: shows held-out photographs; give --hold-out, too, such as --hold-out 10")
    if args.most_photographs < 2:
        raise ConfigError(f"--most-photographs {args.most_photographs}: must be 2 or more")
    if args.known_length is not None and args.unit is not None:
        raise ConfigError("--unit and --known-length both set the scale; give one of them")
    scale = args.known_length or unit_m(args.unit) or 1.0
    photographs = open_photographs(args.photographs, settings.longest_side, **camera_overrides(args))
    for warning in photographs.warnings:
        print(f"gibson-sim: {photographs.folder}: {warning}", file=sys.stderr)
    try:
        surface = surface_from_mesh(load_mesh(args.mesh, [args.mesh.resolve().parent])).scaled(scale)
    except ScanError as error:
        raise ScanError(f"{args.mesh}: {error}") from error
    if split_count(surface, settings.longest_edge) <= MAX_TRIANGLES:
        surface = split_long_edges(surface, settings.longest_edge)
    photographs, text = resolve_convention(surface, photographs.scaled(scale), args.pose_convention)
    if text:
        print(text)
    check_split(surface, settings.longest_edge)
    if len(photographs) > args.most_photographs:
        with progress_bar(f"selecting {args.most_photographs} of {len(photographs)} photographs") as progress:
            photographs = photographs.subset(select_photographs(surface, photographs, args.most_photographs, progress))
    check_photographs(photographs)
    with progress_bar(f"texturing from {len(photographs)} photographs ({photographs.layout})") as progress:
        held_out = range(0, len(photographs), args.hold_out) if args.hold_out else range(0)
        textured = texture_surface(surface, photographs, settings, progress, held_out=held_out)
    file = write_textured_scene(textured, args.output, args.name, level=args.level)
    for line in textured.report.lines():
        print(line)
    metrics = evaluate_held_out(textured, held_out) if args.hold_out else {}
    for name, similarity in metrics.items():
        count = f"{len(held_out)} held-out photograph{'' if len(held_out) == 1 else 's'}"
        print(f"{count}, {name}: PSNR {similarity.psnr:.2f} dB, SSIM {similarity.ssim:.3f}")
    if args.sheet is not None:
        write_picture(args.sheet, contact_sheet(textured, held_out)[:, :, ::-1])
    if metrics and metrics["texture"].warning():
        print(metrics["texture"].warning())
    folder = shlex.quote(str(file.parent))
    print(f"next: gibson-sim scene check {folder}; gibson-sim run --scene {folder}")
    write_json(
        args.report, {**textured.report.as_dict(), "held_out": {name: asdict(similarity) for name, similarity in metrics.items()}}
    )
    return ExitCode.OK
