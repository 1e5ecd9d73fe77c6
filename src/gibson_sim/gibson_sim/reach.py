"""The reach of a simulation: the machines that can see and command it, set by environment variables for DDS profile and discovery range.

``local``: only this machine. Sockets are bound to 127.0.0.1 (``config/fastdds_local.xml``). The discovery range ``LOCALHOST`` is not
sufficient: rmw_fastrtps then listens on all interfaces and accepts any machine that names this one in ``ROS_STATIC_PEERS``.
``subnet``: all machines of the network, the default of ROS (``config/fastdds.xml``).
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from pathlib import Path

from gibson_sim.errors import ConfigError
from gibson_sim.resources import find_config

LOCAL, SUBNET = "local", "subnet"
REACHES = (LOCAL, SUBNET)
PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
RANGE_VARIABLE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
RMW_VARIABLE = "RMW_IMPLEMENTATION"
FAST_DDS = "rmw_fastrtps"
"""Prefix of the RMW implementations based on Fast DDS, such as the default of Jazzy."""
_PROFILES = {LOCAL: "fastdds_local.xml", SUBNET: "fastdds.xml"}
_DISCOVERY_VARIABLES = ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER", "FASTDDS_ENVIRONMENT_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
"""Variables with which a user sets the reach of a process."""


def profile_of(reach: str) -> Path:
    """Returns the Fast DDS profile of a reach; both have a shared-memory segment for large images."""
    return find_config(_PROFILES[reach])


def reach_of(environment: Mapping[str, str], requested: str | None = None) -> str:
    """Returns the reach, ``local`` or ``subnet``; empty if the environment determines it.

    Args:
        environment: environment of the process that starts the simulation.
        requested: the requested reach; None = that of the environment, by default ``local``.
    """
    if requested is not None:
        return requested
    discovery = environment.get(RANGE_VARIABLE, "").upper()
    if _decided_by(environment) or discovery not in ("", "LOCALHOST", "SUBNET"):
        return LOCAL if is_local(environment) else ""
    return SUBNET if discovery == "SUBNET" else LOCAL


def reach_variables(environment: Mapping[str, str], requested: str | None = None) -> dict[str, str]:
    """Returns the variables to set for a reach; variables with an empty value must be unset.

    Args:
        environment: as for ``reach_of``.
        requested: as for ``reach_of``.

    Raises:
        ConfigError: ``requested`` is invalid, or the middleware of the environment does not support it.
    """
    if requested is not None and requested not in REACHES:
        raise ConfigError(f"reach is {requested!r}, must be one of {', '.join(REACHES)}")
    reach = reach_of(environment, requested)
    own_profile = _foreign_profile(environment)
    if not reach:
        return {} if own_profile else {PROFILE_VARIABLE: str(profile_of(SUBNET))}
    if not environment.get(RMW_VARIABLE, FAST_DDS).startswith(FAST_DDS):
        if requested == LOCAL:
            raise ConfigError(
                f"reach local needs Fast DDS, and {RMW_VARIABLE} is {environment[RMW_VARIABLE]!r}: unset it, or restrict that "
                "middleware to the interface `lo` by its own settings (docs/security.md) and leave out reach"
            )
        return {RANGE_VARIABLE: "LOCALHOST"} if reach == LOCAL else {RANGE_VARIABLE: "SUBNET", "ROS_LOCALHOST_ONLY": ""}
    if reach == LOCAL:
        return {
            PROFILE_VARIABLE: str(profile_of(LOCAL)),
            RANGE_VARIABLE: "SYSTEM_DEFAULT",
            "SKIP_DEFAULT_XML_FILE": "1",  # else a profile in the current folder would be used
            "ROS_LOCALHOST_ONLY": "",
            "ROS_SUPER_CLIENT": "",
            **dict.fromkeys(_DISCOVERY_VARIABLES, ""),
        }
    variables = {RANGE_VARIABLE: "SUBNET", "ROS_LOCALHOST_ONLY": ""}
    return variables if own_profile else {PROFILE_VARIABLE: str(profile_of(SUBNET)), **variables}


def apply_reach(environment: MutableMapping[str, str], requested: str | None = None) -> None:
    """Sets and removes the variables of ``reach_variables`` in an environment."""
    for name, value in reach_variables(environment, requested).items():
        if value:
            environment[name] = value
        else:
            environment.pop(name, None)


def describe_reach(environment: Mapping[str, str], option: str = "--reach ") -> str:
    """Returns a line about the reach of processes with an environment that ``reach_variables`` completed.

    Args:
        environment: environment of the processes.
        option: text before the name of a reach in the user's command.
    """
    if is_local(environment):
        return f"reach: processes of this machine alone; `{option}subnet` lets other machines in"
    decided = _decided_by(environment)
    discovery = environment.get(RANGE_VARIABLE, "").upper()
    if not decided and discovery not in ("", "SUBNET"):
        decided = f"{RANGE_VARIABLE}={discovery}"
    if decided:
        return f"reach: as {decided} says; `{option}local` keeps other machines out"
    return f"reach: every machine of this network may see and command it; `{option}local` keeps others out"


def is_local(environment: Mapping[str, str]) -> bool:
    """Returns whether processes with an environment that ``reach_variables`` completed reach this machine alone."""
    profile = environment.get(PROFILE_VARIABLE, "")
    return _is_profile_of(profile, LOCAL) and environment.get(RANGE_VARIABLE, "").upper() == "SYSTEM_DEFAULT"


def _decided_by(environment: Mapping[str, str]) -> str:
    """Returns the first variable that decides the reach, with its value; empty if none does."""
    names = (*_DISCOVERY_VARIABLES, *([PROFILE_VARIABLE] if _foreign_profile(environment) else []))
    return next((f"{name}={environment[name]}" for name in names if environment.get(name)), "")


def _foreign_profile(environment: Mapping[str, str]) -> bool:
    """Returns whether the environment names a profile other than those of this package."""
    profile = environment.get(PROFILE_VARIABLE, "")
    return bool(profile) and not any(_is_profile_of(profile, reach) for reach in REACHES)


def _is_profile_of(profile: str, reach: str) -> bool:
    """Returns whether a profile is that of a reach, also if it is a copy in another installation."""
    own = profile_of(reach)
    try:
        return bool(profile) and (Path(profile).samefile(own) or Path(profile).read_bytes() == own.read_bytes())
    except OSError:
        return False
