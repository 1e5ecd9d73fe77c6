"""``gibson-sim scene scan`` and ``gibson-sim scene fuse``: simulates a scanner, and fuses posed RGB-D into a mesh."""

from __future__ import annotations

import argparse
import math
import shlex
import sys
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.progress import progress_bar
from gibson_sim.cli.options import add_settings, given, settings_from_args
from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.report_file import write_json
from gibson_sim.errors import ConfigError
from gibson_sim_tools.scanning.settings import (
    AS_READ,
    AUTO,
    CAMERA_CONVENTIONS,
    PRESETS,
    Defects,
    FuseSettings,
    ScanCamera,
    TourSettings,
)

_LEVEL_DEG = 0.5
"""Tilt below which a floor counts as level, degrees."""
_PARTS: dict[str, type[Any]] = {"route": TourSettings, "camera": ScanCamera, "defects": Defects}


def add_parser(subparsers: Any) -> None:
    """Adds the sub-commands."""
    _add_scan(subparsers)
    _add_fuse(subparsers)


def _add_scan(subparsers: Any) -> None:
    parser = subparsers.add_parser(
        "scan",
        help="scan a scene: posed RGB-D images with the errors of real scanners",
        description="Moves a camera rig through the fewest stations that cover the scene, and writes colour images, depth images and "
        "poses. The same command resumes an interrupted scan.",
    )
    parser.add_argument("scene", help="name, folder or file of a scene")
    parser.add_argument(
        "--output", required=True, metavar="DIR", help="folder for the scan: new, empty, or with the same scan, interrupted"
    )
    parser.add_argument(
        "--preset",
        default="kinect",
        choices=tuple(PRESETS),
        help="defects and rig; options override it (default: kinect)",
    )
    for title, part in _PARTS.items():
        add_settings(parser.add_argument_group(title), part, _names(part))
    parser.set_defaults(run=_scan)


def _add_fuse(subparsers: Any) -> None:
    parser = subparsers.add_parser(
        "fuse",
        help="fuse posed RGB-D (Gibson Sim scans; Open3D, 7-Scenes and TUM folders) into a mesh with vertex colours",
        description="Needs Open3D: pip install 'gibson_sim_tools[scanning]'.",
    )
    parser.add_argument("folder", metavar="DIR", help="folder of posed RGB-D; the layout is detected")
    parser.add_argument("--output", required=True, metavar="FILE", help="the mesh, .ply")
    add_camera_options(parser)
    parser.add_argument(
        "--pose-convention",
        choices=(AS_READ, AUTO, *CAMERA_CONVENTIONS),
        default=AS_READ,
        help="convention of the poses: as-read = that of the layout; auto = the one for which neighbouring depth images agree; or a name",
    )
    parser.add_argument("--compare", metavar="SCENE", help="compare the mesh with this scene, the original of the scan")
    parser.add_argument("--report", metavar="FILE", help="write the comparison as JSON")
    add_settings(parser, FuseSettings, _names(FuseSettings))
    parser.set_defaults(run=_fuse)


def add_camera_options(parser: argparse._ActionsContainer) -> None:
    """Adds the options that override what a folder of posed RGB-D says of its camera, which ``camera_overrides`` reads."""
    parser.add_argument(
        "--intrinsics", metavar="FX,FY,CX,CY", help="intrinsics of the camera, pixels; override those of a folder of posed RGB-D"
    )
    parser.add_argument(
        "--depth-scale", type=float, metavar="X", help="units of the depth images per metre; overrides that of the folder"
    )


def camera_overrides(args: argparse.Namespace) -> dict[str, Any]:
    """Returns the options of ``add_camera_options`` as arguments of ``open_posed_rgbd`` and ``open_photographs``.

    Raises:
        ConfigError: the intrinsics are not four numbers, or the scale is not above 0.
    """
    if args.depth_scale is not None and not 0.0 < args.depth_scale < math.inf:
        raise ConfigError(f"--depth-scale {args.depth_scale:g}: must be a number above 0, such as 1000 for depths in millimetres")
    return {"focal": _parse_intrinsics(args.intrinsics), "depth_scale": args.depth_scale}


def _scan(args: argparse.Namespace) -> ExitCode:
    # Lazy imports: the other sub-commands need neither OpenGL nor physics.
    from gibson_sim.render.cache import default_folder
    from gibson_sim.scenes.load import load_scene
    from gibson_sim_tools.scanning.capture import ScanSettings, scan

    tour, camera, defects = (_merged_settings(part, args) for part in _PARTS.values())
    folder = Path(args.output)
    with progress_bar(f"scanning {args.scene}") as progress:
        plan = scan(
            load_scene(args.scene), folder, ScanSettings(tour, camera, defects), cache=default_folder(), progress=progress
        )
    images = len(plan.views) * len(tour.pitches)
    print(
        f"{folder}: {images} images from {len(plan.views)} views, {plan.stations} stations; "
        f"they cover {100.0 * plan.coverage:.1f} % of the surface that is visible from free positions"
    )
    return ExitCode.OK


def _fuse(args: argparse.Namespace) -> ExitCode:
    from gibson_sim.scenes.load import load_scene
    from gibson_sim_tools.scanning.comparison import compare
    from gibson_sim_tools.scanning.fusion import distances_to_mesh, fuse_scan, open3d, selected_frames
    from gibson_sim_tools.scanning.layouts import open_posed_rgbd
    from gibson_sim_tools.scanning.pose_conventions import detect_convention, reinterpret_poses
    from gibson_sim_tools.scanning.triangle_mesh import write_ply
    from gibson_sim_tools.view_holes import mesh_view_holes

    output = Path(args.output)
    if output.suffix.lower() != ".ply":
        raise ConfigError(f"--output {output}: must end in .ply")
    if output.exists():
        raise ConfigError(f"--output {output}: already exists; give another name, or delete it first")
    open3d()  # fails early if it is not installed
    rgbd = open_posed_rgbd(Path(args.folder), **camera_overrides(args))
    for warning in rgbd.warnings:
        print(f"gibson-sim: {rgbd.folder}: {warning}", file=sys.stderr)
    scene = load_scene(args.compare) if args.compare else None
    settings = settings_from_args(FuseSettings, args)
    frames = selected_frames(rgbd, settings)
    convention, text = detect_convention(rgbd, frames, settings.depth_max, args.pose_convention)
    rgbd = rgbd.with_poses(reinterpret_poses(rgbd.poses, rgbd.layout, convention))
    if text:
        print(text)
    frame_count = f"{len(frames)} frames" if len(frames) == len(rgbd) else f"{len(frames)} of {len(rgbd)} frames"
    with progress_bar(f"fusing {frame_count} ({rgbd.layout})") as progress:
        fusion = fuse_scan(rgbd, settings, progress)
    mesh, T = fusion.mesh, fusion.T_level_scan
    write_ply(
        output, mesh, [f"T_level_scan {' '.join(f'{c:.9g}' for c in T.ravel())}"] if settings.level and T is not None else []
    )
    print(
        f"{output}: {len(mesh.triangles)} triangles, {len(mesh.vertices)} vertices, {mesh.area:.1f} m2, from {frame_count} ({rgbd.layout})"
    )
    report: dict[str, Any] = {
        "frames": len(frames), "triangles": len(mesh.triangles), "vertices": len(mesh.vertices), "area_m2": mesh.area, "voxel_m": fusion.voxel,
        "T_level_scan": None if T is None else T.tolist(),
    }  # fmt: skip
    if fusion.selected is not None:
        print(fusion.selected.text(settings.memory))
    if fusion.snap is not None:
        print(fusion.snap.text())
        report["snap"] = asdict(fusion.snap)
    print(level_text(T, settings.level))
    if T is not None:
        with progress_bar("measuring holes") as progress:
            holes = mesh_view_holes(mesh.vertices, mesh.triangles, np.eye(4) if settings.level else T, progress)
        print(
            holes.text() if holes else "no position on the floor is free for a robot, so the holes in its views are not measured"
        )
        report["view_holes"] = None if holes is None else {**asdict(holes), "share": holes.share}
    if scene is not None:
        with progress_bar("comparing") as progress:
            result = compare(mesh, rgbd, scene, distances_to_mesh, progress, frames=frames)
        report = {**report, **result.as_dict()}
        for name, d in (("mesh to scene", result.mesh_to_scene), ("scene to mesh", result.scene_to_mesh)):
            print(f"{name}: median {d.median_mm:.1f} mm, mean {d.mean_mm:.1f}, 95 % below {d.p95_mm:.1f}, at most {d.max_mm:.1f}")
        print(
            f"images show {100.0 * result.shown:.1f} % of all solid surfaces; the mesh has {100.0 * result.covered:.1f} % of these within 5 cm"
        )
    print(f"next: `gibson-sim scene check {shlex.quote(str(output))}` reports holes, floor areas that gaps separate, and tilt")
    write_json(Path(args.report) if args.report else None, report)
    return ExitCode.OK


def level_text(T_level_scan: NDArray[np.float64] | None, levelled: bool) -> str:
    """Returns a sentence about the tilt and the height of a scan's floor."""
    if T_level_scan is None:
        return "no level surface faces up, so there is no floor, and holes are not measured"
    tilt = math.degrees(math.acos(min(1.0, float(T_level_scan[2, 2]))))
    # The floor is the plane z = 0 of the level frame; below the origin of the scan it is at -T[2, 3].
    if levelled:
        return f"turned by {tilt:.2f} degrees: z is up and the floor is at z = 0"
    if tilt < _LEVEL_DEG:
        return f"the floor is level to {tilt:.2f} degrees, at z = {-float(T_level_scan[2, 3]) + 0.0:.3f} m"
    return f"the floor is {tilt:.2f} degrees out of level: --level turns the mesh and puts the floor at z = 0"


def _parse_intrinsics(text: str | None) -> tuple[float, float, float, float] | None:
    """Parses ``FX,FY,CX,CY``, pixels; None without the option.

    Raises:
        ConfigError: the text is not four numbers.
    """
    if text is None:
        return None
    try:
        fx, fy, cx, cy = (float(word) for word in text.split(","))
    except ValueError as error:
        raise ConfigError(f"--intrinsics is {text!r}, must be fx,fy,cx,cy: four numbers, pixels") from error
    return fx, fy, cx, cy


def _names(part: type[Any]) -> list[str]:
    return [f.name for f in fields(part)]


def _merged_settings(part: type[Any], args: argparse.Namespace) -> Any:
    """Returns settings from options, else from the preset, else the defaults."""
    names = _names(part)
    preset = {name: value for name, value in PRESETS[args.preset].items() if name in names}
    return part(**{**preset, **given(args, names)})
