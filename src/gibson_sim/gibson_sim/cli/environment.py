"""Options of ROS domain and reach; ``processes.environment`` creates and checks the environment of nodes."""

from __future__ import annotations

import argparse
import socket

from gibson_sim.errors import EnvironmentProblemError
from gibson_sim.processes.environment import (
    RMW as RMW,
    domain_of as domain_of,
    enclave_variables as enclave_variables,
    in_wheels as in_wheels,
    node_environment as node_environment,
    require_nodes as require_nodes,
)
from gibson_sim.reach import REACHES


def add_network(parser: argparse._ActionsContainer) -> None:
    """Adds the options of ROS domain and reach for ``environment_of``."""
    add_domain(parser)
    parser.add_argument(
        "--reach",
        choices=REACHES,
        help="who can reach the nodes: processes of this machine only, or all machines of the network (default: local, unless "
        "variables of ROS or Fast DDS in the environment decide)",
    )


def add_domain(parser: argparse._ActionsContainer) -> None:
    """Adds the option of the ROS domain."""
    parser.add_argument("--domain-id", type=int, metavar="N", help="ROS domain (default: $ROS_DOMAIN_ID, or 0)")


def environment_of(args: argparse.Namespace) -> dict[str, str]:
    """Returns the full environment for the nodes of a command with the options of ``add_network``.

    Raises:
        GibsonSimError: the nodes cannot run in the environment.
    """
    environment = node_environment(domain_id=args.domain_id, reach=args.reach)
    domain_of(environment)
    return environment


def require_foxglove() -> None:
    """Checks that the Foxglove SDK is installed, without importing it.

    Raises:
        EnvironmentProblemError: it is not installed; the message names the remedy.
    """
    from importlib.util import find_spec

    if find_spec("foxglove") is None:
        raise EnvironmentProblemError(
            "--foxglove needs the Python package foxglove-sdk, which is not installed: `pip install foxglove-sdk`"
        )


def is_free(host: str, port: int) -> bool:
    """Returns whether a server can listen on a TCP port."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return False
    return True
