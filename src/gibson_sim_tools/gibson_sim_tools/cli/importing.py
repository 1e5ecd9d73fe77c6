"""``gibson-sim scene import``: imports third-party scenes."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.quiet import quiet
from gibson_sim.errors import ConfigError
from gibson_sim_tools.cli.photographs import PHOTOGRAPH_OPTIONS, add_photograph_options, import_photographs

if TYPE_CHECKING:
    from gibson_sim.formats.mesh import UpAxis
    from gibson_sim.scenes.spec import SceneSpec
    from gibson_sim_tools.importing.importers import ImportOptions


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "import",
        help="import a folder of posed photographs, a Gibson or Replica folder, a Habitat or other mesh, a Gazebo or Drake world, "
        "a USD file, or an archive",
        description="docs/importing.md lists the formats and what is imported of each; docs/your_building.md is about photographs.",
    )
    parser.add_argument("source", type=Path, metavar="SOURCE", help="file, folder or archive (.zip, .tar.gz)")
    parser.add_argument(
        "--output", type=Path, metavar="DIR",
        help="new folder for the scene.yaml and a copy of all files (default: scene.yaml next to the source, without a copy; for photographs: "
        "NAME_scene)",
    )  # fmt: skip
    add_import_options(parser)
    add_photograph_options(parser)
    parser.set_defaults(run=_run)


def add_import_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of an import, which ``import_options`` reads."""
    parser.add_argument("--name", default="", help="name of the scene (default: that of the source)")
    parser.add_argument(
        "--up-axis",
        metavar="UP",
        help="up axis of the file, x, y or z; for a single mesh also -y or a direction, as 0.1,0.3,0.9 (default: from its format or "
        "its floor)",
    )
    parser.add_argument(
        "--unit",
        metavar="UNIT",
        help="unit of the file: m, cm, mm, inch, foot, km, or metres per unit (default: from its format)",
    )
    parser.add_argument("--no-semantics", action="store_true", help="ignore labels; the scene is one object")


def import_options(args: argparse.Namespace) -> ImportOptions:
    """Returns the options of an import.

    Raises:
        ConfigError: the unit or the axis is invalid.
    """
    from gibson_sim_tools.importing.checks.gravity import direction
    from gibson_sim_tools.importing.importers import ImportOptions

    axis: UpAxis | None = args.up_axis if args.up_axis in ("x", "y", "z") else None
    up = direction(args.up_axis, "--up-axis") if args.up_axis is not None and axis is None else None
    return ImportOptions(args.name, axis, up, unit_m(args.unit), not args.no_semantics)


def unit_m(text: str | None) -> float | None:
    """Returns metres per unit, or None without the option.

    Raises:
        ConfigError: the unit is unknown.
    """
    from gibson_sim_tools.importing.checks.gravity import UNITS

    if text is None:
        return None
    if text in UNITS:
        return UNITS[text]
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 1e-6 <= value <= 1e6:
        raise ConfigError(f"--unit {text}: must be one of {', '.join(UNITS)}, or metres per unit, a number from 1e-6 to 1e6")
    return value


@quiet()
def _run(args: argparse.Namespace) -> ExitCode:
    # Lazy imports: the other sub-commands do not read meshes.
    from gibson_sim_tools.from_photographs.inputs import is_photograph_archive, is_photograph_folder
    from gibson_sim_tools.importing.checks.facts import scene_facts
    from gibson_sim_tools.importing.importers import import_scene
    from gibson_sim_tools.photographs.layouts import check_no_bag, unposed_text

    if is_photograph_folder(args.source) or is_photograph_archive(args.source):
        return import_photographs(args, unit_m(args.unit))
    check_no_bag(args.source)
    unposed = unposed_text(args.source)
    photograph_options = [
        f"--{name.replace('_', '-')}" for name in PHOTOGRAPH_OPTIONS if getattr(args, name) not in (None, False)
    ]
    if photograph_options:
        verb, pronoun = ("is", "it") if len(photograph_options) == 1 else ("are", "them")
        given = ", ".join(photograph_options)
        raise ConfigError(
            f"{given}: {verb} for photographs with poses, but the {unposed}; or leave {pronoun} out to import the mesh alone"
            if unposed
            else f"{given}: {verb} for a folder of photographs, which {args.source} is not; leave {pronoun} out"
        )
    options = import_options(args)
    imported = import_scene(args.source, args.output, options)
    for warning in imported.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if unposed and not _uses_images(imported.scene):
        print(f"warning: {unposed}", file=sys.stderr)
    print(f"{imported.file}: from a {imported.kind}")
    print(scene_facts(imported.scene).text())
    folder = shlex.quote(str(imported.file.parent))
    print(f"next: gibson-sim scene check {folder}; gibson-sim run --scene {folder}")
    return ExitCode.OK


def _uses_images(scene: SceneSpec) -> bool:
    """Returns whether the meshes of a scene have textures, which images beside them may be."""
    from gibson_sim_tools.importing.checks.facts import scene_geometry, texture_facts

    return bool(texture_facts([mesh for _, mesh in scene_geometry(scene).meshes]))
