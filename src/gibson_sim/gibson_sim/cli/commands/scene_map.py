"""``gibson-sim scene map``: writes maps of a scene's floors."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim.cli.parser import ExitCode
from gibson_sim.errors import ConfigError

if TYPE_CHECKING:
    from gibson_sim.maps.floor_map import FloorMap
    from gibson_sim.maps.traversability import RobotSize

_FOR_PICTURES = ("output", "floor", "resolution", "no_bodies")
_OUTPUT, _RESOLUTION = Path("maps"), 0.05


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "map", help="write maps of all floors: for Nav2, in Gibson's layout, and as images; or into a scene's own folder",
        description="Writes map_N.pgm and map_N.yaml (Nav2), floor_trav_N.png and floors.txt (Gibson) and map_N.png for each floor N. "
        "With --write: floor_trav_N.png, floors.txt and free_poses.csv, into the folder of the scene.",
    )  # fmt: skip
    parser.add_argument("scene", metavar="SCENE", help="name, folder or file of a scene")
    parser.add_argument("--write", action="store_true", help="write the maps and free poses of a finished scene into its folder")
    parser.add_argument("--output", type=Path, metavar="DIR", help=f"folder for the files (default: {_OUTPUT})")
    parser.add_argument("--floor", type=int, metavar="N", help="only this floor, 0 = the lowest (default: all)")
    parser.add_argument("--radius", type=float, metavar="M", help="radius of the robot (default: 0.3; --write: 0.22)")
    parser.add_argument("--height", type=float, metavar="M", help="height of the robot (default: 0.5; --write: 1.5)")
    parser.add_argument("--step", type=float, metavar="M", help="highest step that the robot climbs (default: 0.03)")
    parser.add_argument("--slope", type=float, metavar="DEG", help="steepest slope that the robot climbs (default: 20)")
    parser.add_argument("--resolution", type=float, metavar="M", help=f"cell size (default: {_RESOLUTION}; --write: 0.02)")
    parser.add_argument("--no-bodies", action="store_true", default=None, help="leave out movable bodies, including doors")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> ExitCode:
    # Imported here, since no other sub-command needs it.
    from gibson_sim.maps.traversability import RobotSize

    if args.write:
        return _write(args)
    return _export(args, _robot(args, RobotSize()))


def _robot(args: argparse.Namespace, usual: RobotSize) -> RobotSize:
    """Returns the robot size in the options, with ``usual`` as default."""
    slope = None if args.slope is None else math.radians(args.slope)
    given = {"radius": args.radius, "height": args.height, "step": args.step, "slope": slope}
    return replace(usual, **{name: value for name, value in given.items() if value is not None})


def _write(args: argparse.Namespace) -> ExitCode:
    from gibson_sim.maps.scene_files import USUAL_ROBOT, write_scene_files
    from gibson_sim.resources import find_scene
    from gibson_sim.scenes.load import description_file

    given = [name for name in _FOR_PICTURES if getattr(args, name) is not None]
    unused = [f"--{name.replace('_', '-')}" for name in given]
    if unused:
        raise ConfigError(f"{', '.join(unused)}: not with --write, which writes all floors, with bodies, into the scene's folder")
    for path in write_scene_files(description_file(find_scene(args.scene)).parent, _robot(args, USUAL_ROBOT)):
        print(path)
    return ExitCode.OK


def _export(args: argparse.Namespace, robot: RobotSize) -> ExitCode:
    from gibson_sim.maps.export import write_gibson_maps, write_nav2_map, write_picture
    from gibson_sim.maps.traversability import floor_maps, scene_floors
    from gibson_sim.scenes.load import load_scene

    output = args.output or _OUTPUT
    resolution = _RESOLUTION if args.resolution is None else args.resolution
    if not 0.005 <= resolution <= 1.0:
        raise ConfigError(f"--resolution is {resolution:g}, must be from 0.005 to 1 m")
    scene = load_scene(args.scene)
    heights = scene_floors(scene)
    if args.floor is not None and not 0 <= args.floor < len(heights):
        listed = ", ".join(f"{number} at {z:g} m" for number, z in enumerate(heights))
        raise ConfigError(f"--floor is {args.floor}; the floors of {scene.name} are {listed}")
    chosen = range(len(heights)) if args.floor is None else [args.floor]
    floors = floor_maps(scene, robot, resolution=resolution, floors=[heights[n] for n in chosen], bodies=not args.no_bodies)
    for number, floor in zip(chosen, floors, strict=True):
        write_nav2_map(floor, output / f"map_{number}")
        write_picture(floor, output / f"map_{number}.png", robot.radius)
    _print(chosen, floors, robot.radius)
    if args.floor is None:
        write_gibson_maps(floors, output)
    print(output)
    return ExitCode.OK


def _print(numbers: Sequence[int], floors: Sequence[FloorMap], radius: float) -> None:
    print(f"{'floor':>5} {'height':>8} {'free':>9} {'for the robot':>14} {'largest area':>13}")
    for number, floor in zip(numbers, floors, strict=True):
        cell = floor.resolution**2
        areas = (floor.free.sum() * cell, floor.inflate(radius).sum() * cell)
        region = floor.largest_free_region(radius).sum() * cell
        print(f"{number:>5} {floor.floor_z:>6.2f} m {areas[0]:>5.1f} m^2 {areas[1]:>10.1f} m^2 {region:>9.1f} m^2")
