"""``gibson-sim scene fetch``: downloads a public scene from its origin, after the user accepts its licence, and imports it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.quiet import quiet
from gibson_sim.errors import ConfigError


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "fetch", help="download a public scene from its origin and import it; without a name: list the known scenes"
    )
    parser.add_argument("name", nargs="?", default="", metavar="NAME", help="name or file of a recipe")
    parser.add_argument("--output", type=Path, metavar="DIR", help="new folder for the scene (default: ./NAME)")
    parser.add_argument("--yes", action="store_true", help="accept the licence and the size without a prompt")
    parser.set_defaults(run=_run)


@quiet()
def _run(args: argparse.Namespace) -> ExitCode:
    from gibson_sim.bags.progress import progress_bar
    from gibson_sim_tools.importing.fetching.fetch import fetch_scene
    from gibson_sim_tools.importing.fetching.recipes import known_recipes, load_recipe

    if not args.name:
        for name in known_recipes():
            recipe = load_recipe(name)
            print(f"{name:<20} {recipe.bytes / 1e6:6.1f} MB  {recipe.licence:<10} {recipe.title}")
        return ExitCode.OK
    recipe = load_recipe(args.name)
    print(recipe.text(), flush=True)
    if not (args.yes or _accepted()):
        return ExitCode.ERROR
    with progress_bar(f"downloading {recipe.name}") as advance:
        imported = fetch_scene(recipe, args.output or Path(recipe.name), advance)
    for warning in imported.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(imported.file)
    return ExitCode.OK


def _accepted() -> bool:
    """Asks the user to accept the licence; returns whether they do.

    Raises:
        ConfigError: standard input is not a terminal.
    """
    if not sys.stdin.isatty():
        raise ConfigError("no terminal to accept the licence in: run it in a terminal, or add --yes if you accept it")
    return input("download it under this licence? [y/N] ").strip().lower() in ("y", "yes")
