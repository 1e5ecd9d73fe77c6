"""Validates the names in settings (scenes, robots, drives, rules) before processes are started. Imports neither ROS, PyBullet nor OpenGL."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gibson_sim.cli.parser import choice_error
from gibson_sim.config import robots_of
from gibson_sim.errors import ConfigError, SceneError, TextError
from gibson_sim.resources import find_config, find_scene
from gibson_sim.settings import Names, setting_fields, setting_values


def check_names(config: Any) -> None:
    """Checks that the objects that a node's settings name exist.

    Raises:
        GibsonSimError: a named object does not exist or cannot be read.
    """
    values = setting_values(config)
    for f in setting_fields(type(config)):
        value = values[f.name]
        if f.metadata["names"] and isinstance(value, str) and value:
            _CHECKS[f.metadata["names"]](value)


def _check_scene(name: str) -> None:
    """Finds a scene and checks that its description is valid YAML or XML; a full check would take as long as loading the scene."""
    from gibson_sim.reading import parse_xml, read_file, read_yaml_file
    from gibson_sim.scenes.drake_directives import parse_directives
    from gibson_sim.scenes.load import description_file

    path = find_scene(name)
    file = description_file(path)
    try:
        if file.name.lower().endswith((".dmd.yaml", ".dmd.yml")):
            parse_directives(read_file(file))
        elif file.suffix in (".yaml", ".yml"):
            read_yaml_file(file)
        elif file.suffix.lower() in (".sdf", ".world"):
            parse_xml(read_file(file))
    except TextError as error:
        raise SceneError(f"{file}: {error}") from error
    except OSError as error:
        raise SceneError(f"{file}: cannot be read: {error.strerror}") from error


def _check_robots(text: str) -> None:
    """Loads robots like the physics node, several as ``name=robot``; the node reports the warnings."""
    from gibson_sim.cli.quiet import quiet
    from gibson_sim.robots.load import load_robot

    with quiet():
        for name, robot in robots_of(text):
            load_robot(robot, name=name) if name else load_robot(robot)


def _check_drive(name: str) -> None:
    from gibson_sim.client_config import DRIVES
    from gibson_sim.robots.path_tracking import scripted_drive

    if name in DRIVES:
        return
    if not Path(name).exists():
        raise ConfigError(f"drive {choice_error(name, DRIVES)}, or a file")
    scripted_drive(name)


def _check_rules(name: str) -> None:
    find_config(name, "randomisation")


def _check_views(text: str) -> None:
    from gibson_sim.scenes.load_views import read_views

    read_views(text)


def _check_file(name: str) -> None:
    if not Path(os.path.expanduser(name)).is_file():
        raise ConfigError(f"{name}: the file does not exist")


def _check_participants(text: str) -> None:
    from gibson_sim.standard.lockstep import parse_participants

    parse_participants(text)


_CHECKS: dict[Names, Callable[[str], None]] = {
    "scene": _check_scene,
    "robots": _check_robots,
    "drive": _check_drive,
    "rules": _check_rules,
    "views": _check_views,
    "file": _check_file,
    "participants": _check_participants,
}
