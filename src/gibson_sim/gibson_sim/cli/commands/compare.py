"""``gibson-sim compare``: compares the bags of a real and a simulated robot, and fits the robot.yaml."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from gibson_sim import __version__
from gibson_sim.bags.folders import check_bag
from gibson_sim.cli.parser import ExitCode
from gibson_sim.errors import ConfigError
from gibson_sim.writing import write_file


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "compare", help="compare a real robot's bag with a simulated robot's, and fit the robot.yaml to it"
    )
    parser.add_argument("real", type=Path, metavar="REAL", help="folder of the real robot's bag, from any ROS 2")
    parser.add_argument(
        "sim", type=Path, metavar="SIM", help="folder of a simulated bag of --robot, ideally with the same commands"
    )
    parser.add_argument(
        "--robot",
        default="gibson_bot",
        metavar="NAME",
        help="the simulated robot: name, folder or robot.yaml (default: gibson_bot)",
    )
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a page with tables and plots; needs matplotlib")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all metrics")
    parser.add_argument(
        "--fit", action="store_true", help="write a copy of the robot.yaml with parameters fitted to the real bag"
    )
    parser.add_argument("--output", type=Path, default=None, metavar="FILE", help="file that --fit writes (default: fitted.yaml)")
    parser.add_argument(
        "--topic", action="append", default=[], metavar="ROLE=/TOPIC",
        help="topic of cmd_vel, odom, truth, imu, scan, map or image, if not the usual one; real:ROLE=/TOPIC or sim:ROLE=/TOPIC: for that bag only",
    )  # fmt: skip
    parser.add_argument(
        "--align", choices=("auto", "map", "start"), default="auto",
        help="how poses are aligned: in the map, or relative to the start of each (default: the map, if both have it)",
    )  # fmt: skip
    parser.add_argument(
        "--cmd-vel-timeout", type=float, default=0.5, metavar="S", help="command timeout of the real robot (default: 0.5)"
    )
    parser.add_argument(
        "--gravity", type=float, default=9.81, metavar="M/S2", help="gravity at the real robot's location (default: 9.81)"
    )
    parser.add_argument(
        "--step-hz", type=int, default=240, metavar="HZ", help="physics steps per second of the simulated run (default: 240)"
    )
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> ExitCode:
    for folder in (args.real, args.sim):  # check both first, since reading a bag takes long
        check_bag(folder)
    # Imported here, since the other sub-commands do not need SciPy.
    from gibson_sim.bags.comparison.compare import compare
    from gibson_sim.bags.comparison.load import load_recording
    from gibson_sim.bags.comparison.measure import Assumptions
    from gibson_sim.bags.comparison.page import figures, text_table
    from gibson_sim.bags.comparison.robot_file import robot_file, write_fitted
    from gibson_sim.bags.comparison.topics import topic_options
    from gibson_sim.bags.digest_comparison import comparison_line
    from gibson_sim.bags.plots.style import require_matplotlib
    from gibson_sim.bags.replaying import read_digests
    from gibson_sim.robots.load import load_robot

    if args.output is not None and not args.fit:
        raise ConfigError(f"--output {args.output} needs --fit, which writes it: add --fit, or leave --output out")
    if args.html is not None:
        require_matplotlib("an HTML report", ", or leave out --html")
    topics, robot = topic_options(args.topic), load_robot(args.robot)
    assumptions = Assumptions(args.gravity, args.cmd_vel_timeout, args.step_hz)
    real, sim = (load_recording(folder, topics[side]) for folder, side in ((args.real, "real"), (args.sim, "sim")))
    comparison = compare(real, sim, robot, assumptions, args.align)
    if line := comparison_line(read_digests(args.real), read_digests(args.sim)):
        comparison = replace(comparison, notes=(*comparison.notes, line))
    print(text_table(comparison))
    for note in comparison.notes:
        print(f"note: {note}")
    if args.json is not None:
        _write(args.json, json.dumps(figures(comparison), indent=2) + "\n")
    if args.html is not None:
        _write(args.html, _page(comparison, args.robot))
    if args.fit:
        changed = [one for one in comparison.parameters if one.changes]
        output = write_fitted(robot_file(args.robot), changed, args.output or Path("fitted.yaml"))
        for one in sorted(comparison.parameters, key=lambda parameter: not parameter.changes):
            if one.changes or one.deviation:  # do not print values from messages that the file already has
                print(one.verdict)
        print(f"wrote {output}: {len(changed)} values changed; try it with `gibson-sim run --robot {output}`")
    return ExitCode.OK


def _page(comparison: Any, robot: str) -> str:
    from gibson_sim.bags.comparison.page import page
    from gibson_sim.bags.comparison.plots import draw_plots

    return page(comparison, draw_plots(comparison), robot, f"made by gibson-sim {__version__} compare")


def _write(path: Path, text: str) -> None:
    write_file(path, text)
    print(f"wrote {path}")
