"""``gibson-sim drive``, ``record`` and ``snapshot``: one node in place of this process, beside a simulation that runs."""

from __future__ import annotations

import argparse
from dataclasses import fields
from typing import Any

from gibson_sim.cli.environment import add_network, environment_of, require_nodes
from gibson_sim.cli.options import add_settings, node_arguments, settings_from_args
from gibson_sim.cli.processes import become
from gibson_sim.client_config import DriveConfig, RecordConfig, SnapshotConfig


def add_parser(subparsers: Any) -> None:
    """Adds the three sub-commands."""
    drive = subparsers.add_parser("drive", help="drive the robot of a running simulation: tour, script or keyboard")
    drive.add_argument(
        "drive", nargs="?", default="keyboard", help="tour, forward, square, spin, keyboard, or a file (default: keyboard)"
    )
    add_settings(drive, DriveConfig, ("scene", "robot", "length", "linear", "angular", "stamped", "timeout"))
    drive.set_defaults(run=lambda args: _become("drive", DriveConfig, args))

    record = subparsers.add_parser("record", help="record topics of a running simulation into a rosbag2 bag")
    record.add_argument("output", metavar="DIR", help="folder of the bag; it must not exist")
    add_settings(record, RecordConfig, tuple(f.name for f in fields(RecordConfig) if f.name not in ("output", "summary_path")))
    record.set_defaults(run=lambda args: _become("record", RecordConfig, args))

    snapshot = subparsers.add_parser("snapshot", help="write one PNG of each image of every camera of a running simulation")
    snapshot.add_argument("output", nargs="?", default=".", metavar="DIR", help="folder for the PNG files (default: here)")
    add_settings(snapshot, SnapshotConfig, ("timeout",))
    snapshot.set_defaults(run=lambda args: _become("snapshot", SnapshotConfig, args))
    for parser in (drive, record, snapshot):
        add_network(parser)


def _become(name: str, cls: type[Any], args: argparse.Namespace) -> int:
    """Replaces this process by the node, which so gets the terminal, its signals and its exit code."""
    require_nodes()
    config = settings_from_args(cls, args)
    environment = environment_of(args)
    become(f"{name}_node", node_arguments(config), environment)
