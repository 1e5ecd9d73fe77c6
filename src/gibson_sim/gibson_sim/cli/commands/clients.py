"""``gibson-sim drive``, ``record``, ``snapshot`` and ``web``: replace this process by a node that connects to a running simulation."""

from __future__ import annotations

import argparse
from dataclasses import fields
from typing import Any

from gibson_sim.cli.environment import add_network, environment_of, require_foxglove, require_nodes
from gibson_sim.cli.options import add_settings, settings_from_args
from gibson_sim.cli.ports import check_port
from gibson_sim.cli.processes import become
from gibson_sim.client_config import DRIVES, DriveConfig, FoxgloveConfig, RecordConfig, SnapshotConfig, WebConfig
from gibson_sim.errors import ConfigError
from gibson_sim.processes.node_process import node_arguments


def add_parser(subparsers: Any) -> None:
    """Adds the four sub-commands."""
    drive = subparsers.add_parser("drive", help="drive the robot of a running simulation: tour, script or keyboard")
    drive.add_argument("drive", nargs="?", default="keyboard", help=f"{', '.join(DRIVES)}, or a file (default: keyboard)")
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

    web = subparsers.add_parser(
        "web", help="serve a page for any browser: live images, map and 3-D view; drive, click goals, control time"
    )
    add_settings(web, WebConfig, ("host", "port", "token", "folder"))
    web.add_argument(
        "--foxglove",
        action="store_true",
        help="serve the Foxglove WebSocket protocol instead of the page (needs `pip install foxglove-sdk`); default port: 8765",
    )
    add_settings(web, FoxgloveConfig, ("commands",))
    web.set_defaults(run=_web)
    for parser in (drive, record, snapshot, web):
        add_network(parser)


def _web(args: argparse.Namespace) -> int:
    """Serves the page, or the Foxglove WebSocket protocol."""
    if not args.foxglove:
        if args.commands is not None:
            raise ConfigError("--commands and --no-commands are for --foxglove: add it, or leave them out")
        check_web_port(args)
        return _become("web", WebConfig, args)
    if args.token is not None:
        raise ConfigError("--token is of the page: the Foxglove protocol has no password; leave it out, or --foxglove")
    require_foxglove()
    check_web_port(args)
    return _become("foxglove", FoxgloveConfig, args)


def check_web_port(args: argparse.Namespace) -> None:
    """Checks the port of the page or of the Foxglove server.

    Raises:
        ConfigError: it cannot be used.
    """
    default = FoxgloveConfig() if args.foxglove else WebConfig()
    check_port("--port", args.host or default.host, default.port if args.port is None else args.port)


def _become(name: str, cls: type[Any], args: argparse.Namespace) -> int:
    """Replaces this process by the node, so that it owns the terminal, the signals and the exit code."""
    require_nodes()
    config = settings_from_args(cls, args)
    environment = environment_of(args)
    become(f"{name}_node", node_arguments(config), environment)
