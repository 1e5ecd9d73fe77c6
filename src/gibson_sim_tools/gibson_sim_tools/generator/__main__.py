"""Writes a generated scene to a folder."""

from __future__ import annotations

import argparse
from pathlib import Path

from gibson_sim.maps.scene_files import write_scene_files
from gibson_sim_tools.generator.flat import make_flat
from gibson_sim_tools.generator.rooms import make_rooms

SCENES = ("flat", "rooms")


def main(argv: list[str] | None = None) -> None:
    """Runs the generator named on the command line."""
    parser = argparse.ArgumentParser(prog="python -m gibson_sim_tools.generator", description=__doc__)
    parser.add_argument("scene", choices=SCENES)
    parser.add_argument("folder", type=Path, help="output folder, created if missing; files with the same names are replaced")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--triangles", type=int, default=100_000, help="number of triangles of rooms (default: 100000)")
    args = parser.parse_args(argv)
    if args.scene == "flat":
        make_flat(args.folder, args.seed)
        write_scene_files(args.folder)
    else:
        make_rooms(args.folder, args.seed, args.triangles)


if __name__ == "__main__":
    main()
