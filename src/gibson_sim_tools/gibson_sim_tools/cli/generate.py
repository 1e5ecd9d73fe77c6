"""``gibson-sim scene generate``: generates a home, an office or a shop with Blender."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import Any

from gibson_sim.cli.parser import ExitCode
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import duration_text
from gibson_sim_tools.making.building import QUALITIES
from gibson_sim_tools.making.planning.planner import KINDS

_LISTED_QUALITIES = tuple(name for name in QUALITIES if name != "smallest")


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "generate",
        help="generate a home, an office or a shop: floor plan, furniture, baked light (needs Blender: pip install 'gibson_sim_tools[authoring]')",
        description="Plans a building, models it, bakes its light with Cycles and writes a scene folder. The same kind and seed give the same "
        "building. An interrupted run keeps its finished steps; --resume continues it.",
    )
    parser.add_argument("--kind", choices=tuple(KINDS), default="flat", help="type of building (default: flat)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="random seed, 0 or more (default: 1)")
    parser.add_argument("--name", metavar="NAME", help="name of the scene (default: kind and seed)")
    parser.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="folder for the scene (default: its name); with --shipped: parent folder of the scenes (default: scenes)",
    )
    parser.add_argument(
        "--quality",
        choices=tuple(QUALITIES),
        default="normal",
        metavar="QUALITY",
        help=f"{', '.join(_LISTED_QUALITIES)} (default: normal)",
    )
    parser.add_argument("--resume", action="store_true", help="continue an interrupted run")
    parser.add_argument("--shipped", metavar="NAME", help="generate this built-in scene, or all, instead of kind and seed")
    parser.add_argument(
        "--blender-python", default=sys.executable, metavar="FILE", help="Python interpreter that has bpy (default: this one)"
    )
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> ExitCode:
    from gibson_sim_tools.making.baking import check_blender, make_scene
    from gibson_sim_tools.making.planning.planner import plan_building

    check_blender(args.blender_python)
    for kind, seed, name in _requested_scenes(args):
        folder = _folder(args, name)
        command = f"gibson-sim scene generate --kind {kind} --seed {seed} --name {shlex.quote(name)} --quality {args.quality}"
        make_scene(
            plan_building(kind, seed, name), QUALITIES[args.quality], folder,
            python=args.blender_python, resume=args.resume, command=command, report=_print_progress,
        )  # fmt: skip
        print(f"{folder}: {sum(f.stat().st_size for f in folder.rglob('*') if f.is_file()) / 1e6:.1f} MB")
    return ExitCode.OK


def _requested_scenes(args: argparse.Namespace) -> list[tuple[Any, int, str]]:
    """Returns kind, seed and name of each scene to generate."""
    if not args.shipped:
        return [(args.kind, args.seed, args.name or f"{args.kind}_{args.seed}")]
    from gibson_sim_tools.making.planning.shipped import SHIPPED

    selected = [s for s in SHIPPED if args.shipped in ("all", s.name)]
    if not selected:
        raise ConfigError(f"--shipped {args.shipped}: is unknown; known: all, {', '.join(s.name for s in SHIPPED)}")
    return [(s.kind, s.seed, s.name) for s in selected]


def _folder(args: argparse.Namespace, name: str) -> Path:
    """Returns the folder for a scene.

    Raises:
        ConfigError: it exists and is not a scene.
    """
    from gibson_sim.scenes.scene_yaml import DESCRIPTION

    folder = (args.output or Path("scenes")) / name if args.shipped else args.output or Path(name)
    if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not (folder / DESCRIPTION).is_file())):
        raise ConfigError(f"--output {folder}: already exists and is not a scene; give another folder")
    return folder


def _print_progress(text: str, done: float, left_s: float | None) -> None:
    left = "" if left_s is None else f", {duration_text(left_s)} left"
    print(f"{100 * done:3.0f} %  {text}{left}", flush=True)
