"""``gibson-sim export``: writes a data set from a bag."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "export",
        help="write the images and poses of a bag as a data set: TUM RGB-D, nerfstudio, LeRobot, or plain files with tables",
        description="Reads bags of the simulation and of real robots; reports at the end what the bag lacks. See docs/datasets.md.",
    )
    parser.add_argument("bag", type=Path, metavar="DIR", help="folder of the bag")
    parser.add_argument("output", type=Path, metavar="OUTDIR", help="folder of the data set; it must not exist, or be empty")
    parser.add_argument("--to", dest="format", required=True, choices=("tum", "nerfstudio", "lerobot", "png"))
    parser.add_argument("--topics", default="", help="image topics, separated by commas (default: all)")
    parser.add_argument(
        "--from", dest="begin", type=float, default=0.0, metavar="S", help="begin S seconds after the start of the bag"
    )
    parser.add_argument(
        "--until", dest="end", type=float, default=0.0, metavar="S", help="end S seconds after the start of the bag"
    )
    parser.add_argument("--every", type=int, default=1, metavar="N", help="export every N-th image of each camera (default: 1)")
    parser.add_argument("--image", default="png", choices=("png", "jpg"), help="format of colour images (default: png)")
    parser.add_argument(
        "--depth", default="png", choices=("png", "npy"), help="16-bit PNG, or exact float32 arrays (default: png)"
    )
    parser.add_argument(
        "--poses", default="auto", choices=("auto", "scene", "tf"),
        help="source of poses: the states of a simulation, or /tf (default: states if there are any)",
    )  # fmt: skip
    parser.add_argument(
        "--fixed-frame", default="", metavar="FRAME", help="frame of poses from /tf (default: map, odom or world)"
    )
    parser.add_argument(
        "--max-difference",
        type=float,
        default=0.02,
        metavar="S",
        help="largest difference between the stamps of the images of one frame, seconds (default: 0.02)",
    )
    parser.add_argument("--fps", type=int, default=0, help="LeRobot: frames per second (default: the rate of the images)")
    parser.add_argument("--task", default="drive", help="LeRobot: description of the task (default: drive)")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    # Imported here, since the other sub-commands do not need image codecs.
    from gibson_sim.bags.export import export_bag
    from gibson_sim.bags.export.job import ExportOptions
    from gibson_sim.bags.progress import progress_bar

    options = ExportOptions(
        topics=tuple(topic.strip() for topic in args.topics.split(",") if topic.strip()),
        begin=args.begin,
        end=args.end,
        every=args.every,
        image=args.image,
        depth=args.depth,
        poses=args.poses,
        fixed_frame=args.fixed_frame,
        max_difference=args.max_difference,
        fps=args.fps,
        task=args.task,
    )
    with progress_bar("exporting") as advance:
        report = export_bag(args.bag, args.format, args.output, options, advance)
    for line in report.lines:
        print(line)
    for note in report.notes:
        print(f"note: {note}", file=sys.stderr)
    return 0
