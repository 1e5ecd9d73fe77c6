"""``gibson-sim scene inspect`` and ``check``: prints facts about a scene, checks it, and repairs it."""

from __future__ import annotations

import argparse
import json
import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.quiet import quiet
from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.quoting import quoted
from gibson_sim_tools.cli.importing import unit_m

if TYPE_CHECKING:
    from gibson_sim.types import Vec3
    from gibson_sim_tools.importing.checks.check import SceneReport

_MAX_PER_KIND = 3
"""Maximum number of findings of one kind that are printed."""


def add_parser(subparsers: Any) -> None:
    """Adds both sub-commands."""
    inspect = subparsers.add_parser("inspect", help="print facts about a scene: sizes, triangles, textures, floors, classes")
    inspect.set_defaults(run=_inspect)
    check = subparsers.add_parser(
        "check", help="check a scene for problems; exit code 1 if there are any",
        description="Errors and warnings count; notes do not. docs/importing.md explains each finding.",
    )  # fmt: skip
    for parser in (inspect, check):
        parser.add_argument("scene", metavar="SCENE", help="name, folder or file of a scene")
        parser.add_argument("--json", action="store_true", help="as JSON")
    check.add_argument("--fix", action="store_true", help="write a repaired copy to --output and check that")
    check.add_argument("--output", type=Path, metavar="DIR", help="new folder for the repaired copy")
    check.add_argument(
        "--max-texture", type=int, default=8192, metavar="PX", help="--fix: longest side of textures (default: 8192)"
    )
    check.add_argument("--no-level", action="store_true", help="--fix: do not rotate the scene")
    check.add_argument(
        "--up", metavar="UP",
        help="--fix: approximate up direction of the scene, if it cannot be detected: an axis, as y or -y, or a direction, as 0.1,0.3,0.9",
    )  # fmt: skip
    check.add_argument("--unit", metavar="UNIT", help="--fix: unit of the scene: m, cm, mm, inch, foot, km, or metres per unit")
    check.add_argument(
        "--align-splats",
        action="store_true",
        help="register the splats to the mesh: find their pose and scale, and write them into scene.yaml",
    )
    check.set_defaults(run=_check)


@quiet()
def _report(scene: str) -> SceneReport:
    from gibson_sim_tools.importing.checks.check import check_path
    from gibson_sim_tools.importing.sources import SourceKind, identify

    path = Path(os.path.expanduser(scene))
    if path.exists() and "/" in str(path):
        kind = identify(path).kind
        if kind in (SourceKind.GIBSON, SourceKind.REPLICA, SourceKind.USD, SourceKind.ARCHIVE):
            raise SceneError(
                f"{scene}: is a {kind.value}; import it first: gibson-sim scene import {shlex.quote(scene)} --output DIR"
            )
    return check_path(scene)


def _inspect(args: argparse.Namespace) -> ExitCode:
    report = _report(args.scene)
    if report.facts is None:
        print(report.findings[0].line())
        return ExitCode.ERROR
    if args.json:
        print(json.dumps(report.facts.json(), indent=2))
        return ExitCode.OK
    print(report.facts.text())
    _print_lines(report)
    return ExitCode.OK


def _check(args: argparse.Namespace) -> ExitCode:
    if args.fix and args.output is None:
        raise ConfigError("--fix writes a repaired copy: give its folder with --output DIR")
    if not args.fix and (args.output is not None or args.unit is not None or args.up is not None):
        raise ConfigError("--output, --unit and --up are for --fix: add it, or leave them out")
    if args.up is not None and args.no_level:
        raise ConfigError("--up rotates the scene and --no-level keeps its orientation: give one of them")
    if not 64 <= args.max_texture <= 16384:
        raise ConfigError(f"--max-texture is {args.max_texture}, must be 64 to 16384 pixels")
    if args.align_splats and args.fix:
        raise ConfigError(
            "--align-splats changes scene.yaml; --fix writes a copy and aligns its splats if necessary: give one of them"
        )
    scale = unit_m(args.unit)
    up = _up(args.up)
    if args.align_splats:
        _align_splats(args.scene, args.json)
    report = _report(args.scene)
    if not args.fix:
        _print(report, args.json)
        return ExitCode.OK if report.clean else ExitCode.ERROR
    from gibson_sim_tools.importing.checks.fix import FixOptions, fix_scene, has_repairs, left_behind

    fix = FixOptions(scale, args.max_texture, not args.no_level, up)
    if not has_repairs(report, fix):
        _print(report, args.json)
        if not args.json:
            print("nothing to repair; no copy made")
        return ExitCode.OK
    if not args.json:
        _print(report, False)
    file, fixed_report = fix_scene(report, args.output, fix)
    if not args.json:
        unclear = any(finding.what == "up-unclear" for finding in fixed_report.findings)
        print(f"{'the up direction is not clear, so the scene is not rotated' if unclear else 'repaired'}: {file}")
        missing = left_behind(report.scene.root, file.parent) if report.scene is not None else []
        if missing:
            print(
                f"the copy has another frame, so these are left out: {', '.join(missing)}; `gibson-sim scene map {shlex.quote(str(file.parent))} "
                "--write` makes maps and free poses anew"
            )
    _print(fixed_report, args.json)
    return ExitCode.OK if fixed_report.clean else ExitCode.ERROR


@quiet()
def _align_splats(name: str, as_json: bool) -> None:
    """Registers the splats of a scene to its mesh and writes their pose and scale into its scene.yaml."""
    import numpy as np

    from gibson_sim.scenes.load import load_scene
    from gibson_sim.scenes.scene_yaml import DESCRIPTION
    from gibson_sim_tools.importing.checks.facts import scene_geometry
    from gibson_sim_tools.importing.checks.splat_alignment import align_splats
    from gibson_sim_tools.importing.checks.splats import write_visual

    scene = load_scene(name)
    if scene.splats is None:
        raise SceneError(f"scene {quoted(scene.name)} has no splats to align: name their file under visual in its {DESCRIPTION}")
    geometry = scene_geometry(scene)
    aligned = align_splats(scene.splats, geometry.vertices[geometry.triangles], np.random.default_rng(0))
    line = write_visual(scene.root / DESCRIPTION, aligned.spec)
    if not as_json:
        print(f"{aligned.text()}\n{scene.root / DESCRIPTION}: {line}")


def _up(text: str | None) -> Vec3 | None:
    from gibson_sim_tools.importing.checks.gravity import direction

    return None if text is None else direction(text)


def _print(report: SceneReport, as_json: bool) -> None:
    if as_json:
        print(json.dumps(report.json(), indent=2))
        return
    _print_lines(report)
    faults = sum(finding.level != "note" for finding in report.findings)
    fixable = sum(finding.fixable and finding.level != "note" for finding in report.findings)
    name = "" if report.facts is None else f"{report.facts.name}: "
    count = f"{faults} finding" if faults == 1 else f"{faults} findings"
    print(f"{name}{'clean' if report.clean else f'{count}, {fixable} of them repairable by --fix'}")


def _print_lines(report: SceneReport) -> None:
    """Prints findings; of each kind, the first few and the number of the rest."""
    counts: dict[tuple[str, str], int] = {}
    for finding in report.findings:
        kind = (finding.level, finding.what)
        counts[kind] = counts.get(kind, 0) + 1
        if counts[kind] <= _MAX_PER_KIND:
            print(finding.line())
    for (level, what), count in counts.items():
        if count > _MAX_PER_KIND:
            print(f"{level:>7}  {what}: and {count - _MAX_PER_KIND} more of this kind; --json lists them all")
