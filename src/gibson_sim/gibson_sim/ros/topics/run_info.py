"""Publishes a node's settings and environment on a latched topic, so that a bag contains all data needed to repeat the run."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import yaml
from rclpy.node import Node

from gibson_msgs.msg import RunInfo
from gibson_sim import __version__
from gibson_sim.processes.processor import processor
from gibson_sim.ros import conversions
from gibson_sim.ros.topics import names, qos
from gibson_sim.settings import setting_values

_PACKAGES = ("numpy", "pybullet", "moderngl", "rclpy")
_PATHS = ("scene", "robot")
"""Settings that may be relative paths, which are published as absolute paths."""


def publish_run_info(node: Node, kind: str, config: Any, stamp_ns: int, **facts: Any) -> Any:
    """Publishes the settings and the environment of a node.

    Args:
        node: node that publishes.
        kind: physics or render.
        config: settings of the node, a dataclass.
        stamp_ns: simulation time, ns.
        facts: other properties of the environment that results may depend on.

    Returns:
        The publisher, which the caller must keep alive.
    """
    publisher = node.create_publisher(RunInfo, names.RUN_INFO, qos.RUN_INFO)
    settings = {name: _absolute(name, value) for name, value in setting_values(config).items()}
    environment = {
        "machine": platform.machine(),
        "processor": processor(),
        "system": platform.platform(),
        "python": platform.python_version(),
        **{name: version for name in _PACKAGES if (version := _version(name))},
        **facts,
    }
    publisher.publish(
        RunInfo(
            header=conversions.header_to_msg(stamp_ns, ""),
            kind=kind,
            node=node.get_fully_qualified_name(),
            version=__version__,
            settings=yaml.safe_dump(settings, sort_keys=False),
            platform=yaml.safe_dump(environment, sort_keys=False),
        )
    )
    return publisher


def _absolute(name: str, value: Any) -> Any:
    """Returns a setting; a path that exists becomes absolute."""
    if name in _PATHS and value and ("/" in value or Path(value).suffix) and Path(value).exists():
        return str(Path(value).resolve())
    return value


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""
