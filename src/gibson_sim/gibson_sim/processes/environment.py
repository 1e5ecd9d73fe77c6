"""The environment of node processes: ROS domain, reach, and variables for ROS from pip. Changes no variable of this process."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Mapping, MutableMapping
from importlib.util import find_spec
from pathlib import Path

from gibson_sim.errors import EnvironmentProblemError
from gibson_sim.processes.node_process import PARENT_VARIABLE
from gibson_sim.reach import RMW_VARIABLE, apply_reach

RMW = "rmw_fastrtps_cpp"
_WHEELS_READY = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""Variable by which the ROS wheels mark that the library path is set."""
SECURITY_VARIABLE, ENCLAVE_VARIABLE = "ROS_SECURITY_ENABLE", "ROS_SECURITY_ENCLAVE_OVERRIDE"


def require_nodes() -> None:
    """Checks that the packages of the nodes are installed, without importing them.

    Raises:
        EnvironmentProblemError: a package is missing; the message names it and the remedy.
    """
    missing = [name for name in ("rclpy", "gibson_msgs", "pybullet", "moderngl") if find_spec(name) is None]
    if missing:
        raise EnvironmentProblemError(
            f"this Python ({sys.executable}) has no {', '.join(missing)}: run `make setup` and use .venv/bin/gibson-sim, "
            "or pip install 'gibson_sim[ros]', or source your ROS workspace"
        )


def node_environment(
    environment: Mapping[str, str] | None = None, *, domain_id: int | None = None, reach: str | None = None
) -> dict[str, str]:
    """Returns the full environment for a node process.

    Args:
        environment: base environment; None = that of this process.
        domain_id: ROS domain; None = that of the environment.
        reach: machines that can reach the node, see ``gibson_sim.reach``; None = from the environment, else ``local``.

    Raises:
        GibsonSimError: the nodes cannot work in the environment.
    """
    base = dict(os.environ if environment is None else environment)
    if in_wheels() and base.get(RMW_VARIABLE, RMW) != RMW:
        raise EnvironmentProblemError(f"{RMW_VARIABLE} is {base[RMW_VARIABLE]!r}, but ROS from pip has only {RMW}: unset it")
    if in_wheels() and base.get(SECURITY_VARIABLE, "").lower() == "true":
        raise EnvironmentProblemError(
            f"{SECURITY_VARIABLE} is {base[SECURITY_VARIABLE]!r}, but ROS from pip cannot encrypt (its Fast DDS has no security plugins): "
            "use a ROS installation (docs/security.md), or unset it and let --reach local keep other machines out"
        )
    _check_loopback()
    apply_reach(base, reach)
    _drop_foreign_library_path(base)
    base["PYTHONUNBUFFERED"] = "1"
    base[PARENT_VARIABLE] = str(os.getpid())
    base.setdefault("RCUTILS_CONSOLE_OUTPUT_FORMAT", "{severity} {message}")
    base.setdefault("RCUTILS_COLORIZED_OUTPUT", "0")
    if domain_id is not None:
        base["ROS_DOMAIN_ID"] = str(domain_id)
    return base


def _drop_foreign_library_path(environment: MutableMapping[str, str]) -> None:
    """Removes the library path that ROS from pip in another Python environment, the parent of this process, has set.

    Every Python with ROS from pip sets the path once for itself and its children and marks this in a variable: children of another
    environment would see the mark and not find their libraries.
    """
    folders = environment.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    if in_wheels() and environment.get(_WHEELS_READY) and str(Path(sys.prefix) / "lib") not in folders:
        del environment[_WHEELS_READY]
        environment.pop("LD_LIBRARY_PATH", None)


def _check_loopback() -> None:
    """Raises EnvironmentProblemError if the processes of this machine cannot discover each other."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("127.0.0.1", 9))  # sends nothing
        except OSError as error:
            raise EnvironmentProblemError(
                f"127.0.0.1 cannot be reached ({error.strerror}), which the nodes need for discovery: `ip link set lo up`, or give the "
                "container a network"
            ) from error


def enclave_variables(environment: Mapping[str, str], node: str) -> dict[str, str]:
    """Returns the variable of a node's SROS2 enclave, ``/gibson_sim/<node>``; empty if SROS2 is off or an enclave is already set."""
    secure = environment.get(SECURITY_VARIABLE, "").lower() == "true" and not environment.get(ENCLAVE_VARIABLE)
    return {ENCLAVE_VARIABLE: f"/gibson_sim/{node}"} if secure else {}


def in_wheels() -> bool:
    """Returns whether rclpy in this environment comes from pip rather than from a ROS installation."""
    return (Path(sys.prefix) / "share" / "rclpy").is_dir() or not os.environ.get("AMENT_PREFIX_PATH")


def domain_of(environment: Mapping[str, str]) -> int:
    """Returns the ROS domain id of an environment.

    Raises:
        EnvironmentProblemError: ROS_DOMAIN_ID is not a number from 0 to 231; the 232nd has too few ports.
    """
    text = environment.get("ROS_DOMAIN_ID", "") or "0"
    if not text.isdigit() or int(text) > 231:
        raise EnvironmentProblemError(f"ROS_DOMAIN_ID is {text!r}, must be a whole number from 0 to 231")
    return int(text)
