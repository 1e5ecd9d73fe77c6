"""The environment that the node processes need, set here and nowhere else."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path

from gibson_sim.errors import EnvironmentProblemError
from gibson_sim.resources import find_config

PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
PARENT_VARIABLE = "GIBSON_SIM_PARENT_PID"
RMW = "rmw_fastrtps_cpp"


def ros_variables(environment: Mapping[str, str]) -> dict[str, str]:
    """Returns the variables that a ROS process should have beside ``environment`` so that large images arrive whole."""
    wanted = {}
    if PROFILE_VARIABLE not in environment:
        wanted[PROFILE_VARIABLE] = str(dds_profile())
    return wanted


def dds_profile() -> Path:
    """Returns the Fast DDS profile with a shared-memory segment for large images."""
    return find_config("fastdds.xml")


def node_environment(
    environment: Mapping[str, str] | None = None, *, domain_id: int | None = None, here_alone: bool = False
) -> dict[str, str]:
    """Returns the whole environment for a node process.

    Args:
        environment: to begin with; None = that of this process.
        domain_id: of ROS; None = as the environment says.
        here_alone: talk with processes on this machine alone, unless the environment says with whom.

    Raises:
        EnvironmentProblemError: the given environment cannot work.
    """
    base = dict(os.environ if environment is None else environment)
    if in_wheels() and base.get("RMW_IMPLEMENTATION", RMW) != RMW:
        raise EnvironmentProblemError(
            f"RMW_IMPLEMENTATION is {base['RMW_IMPLEMENTATION']!r}, but ROS from pip has {RMW} alone: unset it"
        )
    base.update(ros_variables(base))
    base["PYTHONUNBUFFERED"] = "1"
    base[PARENT_VARIABLE] = str(os.getpid())
    base.setdefault("RCUTILS_CONSOLE_OUTPUT_FORMAT", "{severity} {message}")
    base.setdefault("RCUTILS_COLORIZED_OUTPUT", "0")
    if here_alone:
        base.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if domain_id is not None:
        base["ROS_DOMAIN_ID"] = str(domain_id)
    return base


def in_wheels() -> bool:
    """Returns whether rclpy comes from pip in this environment, not from a ROS installation."""
    return (Path(sys.prefix) / "share" / "rclpy").is_dir() or not os.environ.get("AMENT_PREFIX_PATH")


def domain_of(environment: Mapping[str, str]) -> int:
    """Returns the ROS domain.

    Raises:
        EnvironmentProblemError: ROS_DOMAIN_ID is not a number from 0 to 232.
    """
    text = environment.get("ROS_DOMAIN_ID", "") or "0"
    if not text.isdigit() or int(text) > 232:
        raise EnvironmentProblemError(f"ROS_DOMAIN_ID is {text!r}, must be a whole number from 0 to 232")
    return int(text)


def require_nodes() -> None:
    """Checks that the packages of the nodes are there, without loading them.

    Raises:
        EnvironmentProblemError: naming what is missing and the remedy.
    """
    from importlib.util import find_spec

    missing = [name for name in ("rclpy", "gibson_msgs", "pybullet", "moderngl") if find_spec(name) is None]
    if missing:
        raise EnvironmentProblemError(
            f"this Python ({sys.executable}) has no {', '.join(missing)}: run `make setup` and use .venv/bin/gibson-sim, "
            "or source your ROS workspace"
        )
