"""``gibson-sim bench``: reproducible measurements."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gibson_sim.cli.report_file import add_report_options, parse_device, parse_size, print_progress, require_device, write_json
from gibson_sim.config import DETAIL_PX
from gibson_sim.errors import ConfigError
from gibson_sim.types import OUTPUTS
from gibson_sim_bench.cli import (
    compare as bench_compare,
    learning as bench_learning,
    lockstep as bench_lockstep,
    peers as bench_peers,
    realism as bench_realism,
    report as bench_report,
    ros as bench_ros,
    scaling as bench_scaling,
    soak as bench_soak,
    table1 as bench_table1,
    table2 as bench_table2,
    tasks as bench_tasks,
    tensors as bench_tensors,
    web as bench_web,
)

_SCENES = "rooms:100k,rooms:500k,rooms:1m"
_SIZES = "256x256,640x480,1024x1024"
_OUTPUTS = ("rgb", "rgb,depth", "rgb,depth,semantic,instance,normal")


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser("bench", help="measure rendering, physics, tasks and ROS on this machine")
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    for module in (bench_table1, bench_table2, bench_peers, bench_scaling, bench_soak, bench_report, bench_compare):
        module.add_parser(kinds)
    _add_render(kinds)
    for module in (bench_realism, bench_tensors, bench_ros, bench_lockstep, bench_tasks, bench_learning, bench_web):
        module.add_parser(kinds)


def _add_render(kinds: Any) -> None:
    parser = kinds.add_parser("render", help="images per second of the renderer by scene, size and outputs")
    parser.add_argument(
        "--scenes",
        nargs="+",
        default=[_SCENES],
        metavar="SCENE",
        help=f"rooms:N for generated rooms with N triangles, or names, folders or files of scenes (default: {_SCENES})",
    )
    parser.add_argument("--sizes", nargs="+", default=[_SIZES], metavar="WxH", help=f"image sizes, pixels (default: {_SIZES})")
    parser.add_argument(
        "--outputs",
        nargs="+",
        default=list(_OUTPUTS),
        metavar="A,B",
        help=f"sets of outputs, each measured (default: {' '.join(_OUTPUTS)})",
    )
    parser.add_argument("--frames", type=int, default=60, help="images of each case (default: 60)")
    parser.add_argument(
        "--detail-px",
        default=f"{DETAIL_PX:g}",
        metavar="PX",
        help=f"tolerance of the level-of-detail selection, pixels; several, such as 1,0, are each measured (default: {DETAIL_PX:g})",
    )
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write the first image of every case to DIR")
    parser.add_argument(
        "--growth", action="store_true", help="also print the time per image of the largest rooms relative to the smallest"
    )
    parser.add_argument(
        "--device", help="EGL device: its number or UUID, as `gibson-sim doctor` lists them (default: a GPU if there is one)"
    )
    add_report_options(parser)
    parser.set_defaults(run=run_render)


def run_render(args: argparse.Namespace) -> int:
    """Prints the report, and writes the JSON file if one is named."""
    plan = plan_of(args)
    require_device(plan.device)
    from gibson_sim_bench.render import measure
    from gibson_sim_bench.reports.render import report_text

    report = measure(plan, progress=print_progress)
    print(report_text(report, markdown=args.markdown, show_growth=args.growth))
    write_json(args.json, report.as_json())
    return 0


def plan_of(args: argparse.Namespace) -> Any:
    """Returns the ``RenderPlan`` of the options.

    Raises:
        ConfigError: an option is invalid.
    """
    from gibson_sim_bench.render import RenderPlan

    if args.frames < 1:
        raise ConfigError(f"--frames is {args.frames}, must be 1 or more")
    return RenderPlan(
        scenes=tuple(_words(args.scenes)),
        sizes=tuple(parse_size(text) for text in _words(args.sizes)),
        outputs=tuple(_outputs(text) for text in args.outputs),
        frames=args.frames,
        detail_px=tuple(_number("--detail-px", text) for text in _words([args.detail_px])),
        device=parse_device(args.device),
        images=args.pictures,
    )


def _words(texts: list[str]) -> list[str]:
    return [word for text in texts for word in text.split(",") if word]


def _outputs(text: str) -> tuple[Any, ...]:
    names = tuple(_words([text]))
    unknown = [name for name in names if name not in OUTPUTS]
    if unknown or not names:
        raise ConfigError(f"--outputs: {text!r} must be one or more of {', '.join(OUTPUTS)}, joined by commas")
    return names


def _number(option: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < float("inf"):
        raise ConfigError(f"{option}: {text!r} must be a number, 0 or more")
    return value
