"""``gibson-sim bag``: look at a recorded bag, check it, mend it, make pictures of it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gibson_sim.bags.check import check_bag
from gibson_sim.bags.video import write_contact_sheet
from gibson_sim.bags.writer import repair
from gibson_sim.cli.pictures import write_pictures


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command with its own sub-commands."""
    parser = subparsers.add_parser("bag", help="check a bag, mend one that was cut off, make a video of one")
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    check = actions.add_parser("check", help="counts, rates, stamps and odometry of a bag; exit code 1 if stamps do not agree")
    check.set_defaults(run=_check)
    mend = actions.add_parser("repair", help="make a bag readable that was cut off, by a crash or a full disk")
    mend.set_defaults(run=_repair)
    video = actions.add_parser("video", help="write a video and a contact sheet of RGB and depth")
    video.set_defaults(run=_video)
    sheet = actions.add_parser("sheet", help="write a contact sheet alone")
    sheet.set_defaults(run=_sheet)
    for action in (check, mend, video, sheet):
        action.add_argument("bag", type=Path, metavar="DIR", help="folder of the bag")
    video.add_argument("file", type=Path, metavar="FILE.mp4")
    sheet.add_argument("file", type=Path, metavar="FILE.png")
    sheet.add_argument("--columns", type=int, default=4, help="pictures in a row (default: 4)")
    sheet.add_argument("--rows", type=int, default=4, help="rows of pictures (default: 4)")


def _check(args: argparse.Namespace) -> int:
    report = check_bag(args.bag)
    print(report.text())
    return 0 if report.ok else 1


def _repair(args: argparse.Namespace) -> int:
    print(repair(args.bag))
    return 0


def _video(args: argparse.Namespace) -> int:
    for path in write_pictures(args.bag, args.file):
        print(path)
    return 0


def _sheet(args: argparse.Namespace) -> int:
    print(write_contact_sheet(args.bag, args.file, args.columns, args.rows))
    return 0
