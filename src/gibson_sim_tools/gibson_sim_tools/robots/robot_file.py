"""Generates a ``robot.yaml`` with guessed values, each guess explained in a comment above its key."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from gibson_sim.robots.loading.derive import DerivedRobot

_WIDTH = 120
"""Preferred line width, characters."""


def robot_file_text(urdf: str, arguments: Mapping[str, str], derived: DerivedRobot) -> str:
    """Returns the text of a ``robot.yaml``.

    Args:
        urdf: Path of the URDF or xacro, as written into the file.
        arguments: Arguments of a xacro, by name.
        derived: Guessed values, and the reason for each.
    """
    values: dict[str, Any] = {"urdf": urdf}
    if arguments:
        values["xacro_args"] = dict(arguments)
    values |= derived.values
    comments: dict[str, list[str]] = {}
    for guess in derived.guesses:
        comments.setdefault(guess.key, []).append(f"# guessed {guess}\n")
    parts = ["# Guessed from the description; check it. The keys: docs/robots.md\n"]
    for key, value in values.items():
        parts += comments.pop(key, [])
        # PyYAML puts innermost collections on one line, among them a mapping of one key to a number.
        style = None if isinstance(value, (dict, list)) else False
        parts.append(yaml.safe_dump({key: value}, sort_keys=False, allow_unicode=True, default_flow_style=style, width=_WIDTH))
    # Guesses that set no key, such as a missing drive.
    parts += [line for lines in comments.values() for line in lines]
    return "".join(parts)
