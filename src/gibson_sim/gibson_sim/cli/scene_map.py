"""``gibson-sim scene map``: maps of a scene's floors for a robot of some size, as files for other programs."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from gibson_sim.cli.exit_codes import ExitCode
from gibson_sim.errors import ConfigError


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "map", help="write maps of all floors: for Nav2, in Gibson's layout, and as pictures",
        description="Writes map_N.pgm and map_N.yaml (Nav2), floor_trav_N.png and floors.txt (Gibson) and map_N.png for each floor N.",
    )  # fmt: skip
    parser.add_argument("scene", metavar="SCENE", help="name, folder or file of a scene")
    parser.add_argument("--output", type=Path, default=Path("maps"), metavar="DIR", help="folder for the files (default: maps)")
    parser.add_argument("--floor", type=int, metavar="N", help="only this floor, 0 = the lowest (default: all)")
    parser.add_argument("--radius", type=float, default=0.3, metavar="M", help="of the robot (default: 0.3)")
    parser.add_argument("--height", type=float, default=0.5, metavar="M", help="of the robot (default: 0.5)")
    parser.add_argument("--step", type=float, default=0.03, metavar="M", help="highest step that it climbs (default: 0.03)")
    parser.add_argument("--slope", type=float, default=20.0, metavar="DEG", help="steepest slope that it climbs (default: 20)")
    parser.add_argument("--resolution", type=float, default=0.05, metavar="M", help="edge of a cell (default: 0.05)")
    parser.add_argument("--no-bodies", action="store_true", help="leave out what can be moved, doors too")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> ExitCode:
    # Loaded here: the other sub-commands need none of it.
    from gibson_sim.scenes.load import load_scene
    from gibson_sim.scenes.maps.export import write_gibson_maps, write_nav2_map, write_picture
    from gibson_sim.scenes.maps.levels import scene_floors
    from gibson_sim.scenes.maps.traversability import RobotSize, floor_maps

    if not 0.005 <= args.resolution <= 1.0:
        raise ConfigError(f"--resolution is {args.resolution:g}, must be from 0.005 to 1 m")
    robot = RobotSize(args.radius, args.height, args.step, math.radians(args.slope))
    scene = load_scene(args.scene)
    heights = scene_floors(scene)
    if args.floor is not None and not 0 <= args.floor < len(heights):
        listed = ", ".join(f"{number} at {z:g} m" for number, z in enumerate(heights))
        raise ConfigError(f"--floor is {args.floor}; the floors of {scene.name} are {listed}")
    chosen = range(len(heights)) if args.floor is None else [args.floor]
    floors = floor_maps(scene, robot, resolution=args.resolution, floors=[heights[n] for n in chosen], bodies=not args.no_bodies)
    print(f"{'floor':>5} {'height':>8} {'free':>9} {'for the robot':>14} {'in one piece':>13}")
    for number, floor in zip(chosen, floors, strict=True):
        write_nav2_map(floor, args.output / f"map_{number}")
        write_picture(floor, args.output / f"map_{number}.png", robot.radius)
        cell = floor.resolution**2
        areas = (floor.free.sum() * cell, floor.inflate(robot.radius).sum() * cell)
        region = floor.largest_free_region(robot.radius).sum() * cell
        print(f"{number:>5} {floor.floor_z:>6.2f} m {areas[0]:>5.1f} m^2 {areas[1]:>10.1f} m^2 {region:>9.1f} m^2")
    if args.floor is None:
        write_gibson_maps(floors, args.output)
    print(args.output)
    return ExitCode.OK
