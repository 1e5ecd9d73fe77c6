"""``gibson-sim scene import`` for a folder of photographs: a progress bar and a report for each stage."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from gibson_sim.bags.progress import progress_bar
from gibson_sim.cli.options import add_settings, settings_from_args
from gibson_sim.cli.parser import ExitCode
from gibson_sim.config import parse_fill
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim_tools.cli.scan import add_camera_options, camera_overrides
from gibson_sim_tools.from_photographs.settings import PhotographSettings
from gibson_sim_tools.scanning.settings import AS_READ, AUTO, CAMERA_CONVENTIONS
from gibson_sim_tools.texturing.settings import POSE_CONVENTIONS

PHOTOGRAPH_OPTIONS = (
    "mesh",
    "fuse",
    "pose_convention",
    "intrinsics",
    "depth_scale",
    *(f.name for f in fields(PhotographSettings)),
)
"""Names of the options that only imports from photographs have."""
_INDENT = "    "


def add_photograph_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of an import from photographs."""
    group = parser.add_argument_group("folder of photographs")
    group.add_argument(
        "--mesh",
        type=Path,
        metavar="FILE",
        help="texture this mesh (default: the one in the folder, else one is fused from depth)",
    )
    group.add_argument("--fuse", action="store_true", help="fuse a mesh from depth, even if the folder contains one")
    group.add_argument(
        "--pose-convention",
        choices=(AS_READ, AUTO, *POSE_CONVENTIONS),
        default=None,
        help="convention of the poses: as-read = that of the layout; auto = the one for which depth images, or photographs on the mesh, agree; "
        f"or a name (default: {AUTO})",
    )
    add_camera_options(group)
    add_settings(group, PhotographSettings, [f.name for f in fields(PhotographSettings)])


def import_photographs(args: argparse.Namespace, scale: float | None) -> ExitCode:
    """Imports a folder of photographs as a scene, or resumes an interrupted import. ``scale``: metres per unit of poses and mesh."""
    # Lazy import: the other sub-commands do not need it.
    from gibson_sim_tools.from_photographs.importing import INTERMEDIATES, SHEET, PhotographImport
    from gibson_sim_tools.from_photographs.inputs import find_inputs, unpack_photographs
    from gibson_sim_tools.from_photographs.stages import StagedJob
    from gibson_sim_tools.importing.checks.gravity import direction

    if args.hold_out is not None and (args.hold_out < 0 or args.hold_out == 1):
        raise ConfigError(f"--hold-out {args.hold_out}: must be 0, or 2 or more, so that some photographs are used")
    fill, with_depth = parse_fill("--fill", args.fill or "")
    if with_depth:
        raise ConfigError(f"--fill {args.fill}: only colours are compared; leave out ',depth'")
    settings = settings_from_args(PhotographSettings, args, fill=fill)
    if args.mesh is not None and args.fuse:
        raise ConfigError("--mesh names a mesh and --fuse creates one: give one of them")
    output = args.output or Path(f"{args.source.resolve().name.removesuffix('.zip')}_scene")
    folder, source = args.source, str(args.source.resolve())
    if not folder.is_dir():
        # The job locks the output folder before anything is written into it.
        with StagedJob(output, source).locked(), progress_bar(f"unpacking {folder.name}"):
            folder = unpack_photographs(folder, output / INTERMEDIATES / "photographs")
    inputs = find_inputs(
        folder, args.mesh, fuse=args.fuse, longest_side=settings.longest_side, excluded=output, **camera_overrides(args)
    )
    convention = args.pose_convention or AUTO
    if inputs.mesh is None and convention not in (AS_READ, AUTO, *CAMERA_CONVENTIONS):
        raise ConfigError(
            f"--pose-convention {convention}: is for photographs with a mesh; without one, give {AS_READ}, {AUTO}, {', '.join(CAMERA_CONVENTIONS)}"
        )
    if settings.hold_out_depth and inputs.mesh is not None:
        raise ConfigError(
            f"--hold-out-depth needs a mesh that is fused from depth, but the mesh is {quoted(str(inputs.mesh))}; leave it out, or give --fuse"
        )
    if scale is not None and any(item.depth is not None for item in inputs.photographs.items):
        raise ConfigError("--unit is for photographs without depth: depth images define the scale; leave it out")
    up = None if args.up_axis is None else direction(args.up_axis, "--up-axis")
    job = PhotographImport(inputs, output, settings, args.name or output.resolve().name, up, scale, convention, source)
    for warning in dict.fromkeys((*inputs.photographs.warnings, *(inputs.rgbd.warnings if inputs.rgbd is not None else ()))):
        print(f"warning: {args.source}: {warning}", file=sys.stderr)
    print(f"{args.source}: " + f"\n{_INDENT}".join(inputs.lines()))
    stages = job.stages()
    try:
        with stage_bars([stage.name for stage in stages], [stage.weight for stage in stages]) as (stage_progress, on_result):
            job.run(stage_progress, on_result)
    except KeyboardInterrupt:
        print("interrupted; the same command resumes", file=sys.stderr)
        raise
    if settings.hold_out:
        print(f"photographs and re-rendered scene: {output / SHEET}")
    print(f"next: gibson-sim run --scene {shlex.quote(str(output))}")
    return ExitCode.OK


@contextmanager
def stage_bars(names: list[str], weights: list[float]) -> Iterator[tuple[Callable[[int], Any], Callable[[Any], None]]]:
    """Yields the callbacks of ``StagedJob.run``: ``stage_progress`` and ``on_result``.

    A terminal shows two bars, for the stage and for the whole import, with the elapsed and the remaining time.
    """
    terminal = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeElapsedColumn(), TextColumn("left:"),
        TimeRemainingColumn(),
    )  # fmt: skip
    total, finished = sum(weights), [0]
    with Progress(*columns, console=terminal, transient=True, refresh_per_second=4, disable=not terminal.is_terminal) as bars:
        all_stages = bars.add_task("all stages", total=total)

        @contextmanager
        def stage_progress(number: int) -> Iterator[Callable[[float], None]]:
            if not terminal.is_terminal:
                print(f"{number + 1}/{len(names)} {names[number]} ...", file=sys.stderr, flush=True)
            stage = bars.add_task(f"{number + 1}/{len(names)} {names[number]}", total=1.0)
            weight_before = sum(weights[:number])

            def advance(part: float) -> None:
                bars.update(stage, completed=part)
                bars.update(all_stages, completed=weight_before + part * weights[number])

            try:
                yield advance
            finally:
                bars.remove_task(stage)

        def on_result(stage: Any) -> None:
            finished[0] += 1
            bars.update(all_stages, completed=sum(weights[: finished[0]]))
            time = "done before" if stage.reused else _time(stage.seconds)
            text = f"{finished[0]}/{len(names)} {stage.name} ({time}): " + f"\n{_INDENT}".join(stage.lines)
            if terminal.is_terminal and sys.stdout.isatty():
                bars.console.print(text, markup=False, soft_wrap=True, highlight=False)  # above the bars
            else:
                print(text, flush=True)

        yield stage_progress, on_result


def _time(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 60.0 else f"{int(seconds) // 60}:{int(seconds) % 60:02d} min"
