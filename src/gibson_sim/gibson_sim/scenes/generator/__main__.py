"""Writes a scene to a folder."""

from __future__ import annotations

import argparse
from pathlib import Path

from gibson_sim.scenes.generator.flat import make_flat

MAKERS = {"flat": make_flat}


def main(argv: list[str] | None = None) -> None:
    """Runs the generator that is named on the command line."""
    parser = argparse.ArgumentParser(prog="python -m gibson_sim.scenes.generator", description=__doc__)
    parser.add_argument("scene", choices=sorted(MAKERS))
    parser.add_argument("folder", type=Path, help="made if it is not there; files of the same names are replaced")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(argv)
    MAKERS[args.scene](args.folder, args.seed)


if __name__ == "__main__":
    main()
