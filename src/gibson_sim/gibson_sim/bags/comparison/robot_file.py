"""Writes a copy of a ``robot.yaml`` with changed values; keeps comments and the order of keys."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.error import YAMLError

from gibson_sim.bags.comparison.parameters import Parameter
from gibson_sim.errors import RobotError
from gibson_sim.robots.load import find_robot_file, load_robot
from gibson_sim.writing import write_file

_WHOLE = ("encoder_ticks", "beams")
"""Keys with integer values."""


def robot_file(robot: str) -> Path:
    """Returns the ``robot.yaml`` of a name, a folder or a file.

    Raises:
        RobotError: the file does not exist.
    """
    load_robot(robot)
    path = find_robot_file(robot)
    if path.suffix not in (".yaml", ".yml"):
        raise RobotError(f"{path}: has no robot.yaml to change; write one: gibson-sim scene robot --new {path.name}")
    return path


def write_fitted(source: Path, parameters: Iterable[Parameter], output: Path) -> Path:
    """Writes ``source`` with the changed parameters, and loads the result to validate it; returns ``output``.

    Args:
        source: A ``robot.yaml``.
        parameters: Fitted parameters; those that do not change are skipped.
        output: File to write; its folder is created.

    Raises:
        RobotError: the file cannot be read, or the result is not a valid robot.
        WriteError: the output cannot be written.
    """
    yaml = YAML()
    yaml.width = 1000
    yaml.indent(mapping=2, sequence=4, offset=2)
    try:
        robot = yaml.load(source.read_text(encoding="utf-8"))
    except (YAMLError, OSError) as error:
        raise RobotError(f"{source}: cannot be read: {' '.join(str(error).split())}") from error
    # The copy may be in any folder.
    robot["urdf"] = str((source.parent / robot["urdf"]).resolve())
    for parameter in parameters:
        if parameter.changes:
            _set(robot, parameter)
    text = io.StringIO()
    yaml.dump(robot, text)
    write_file(output, text.getvalue())
    load_robot(output)
    return output


def _set(robot: Any, parameter: Parameter) -> None:
    section = robot.get(parameter.section)
    if section is None:
        section = robot[parameter.section] = CommentedMap()
    if isinstance(section, list):
        section = section[parameter.index]
    is_given = parameter.key in section
    section[parameter.key] = rounded(parameter)
    comment = f"was {parameter.old:g}" if is_given else f"was not given, which is {parameter.old:g}"
    if isinstance(section, CommentedMap) and not section.fa.flow_style():
        section.yaml_add_eol_comment(f"fitted; {comment}", parameter.key)


def rounded(parameter: Parameter) -> float | int:
    """Returns the new value with four digits, or as an integer."""
    if parameter.key in _WHOLE:
        return round(parameter.new)
    return float(f"{parameter.new:.4g}")
