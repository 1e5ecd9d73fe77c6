"""The text of a ``robot.yaml`` with guessed values, each guess in a comment above its key."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from gibson_sim.robots.loading.derive import DerivedRobot

_WIDTH = 120
"""Characters of a line, about."""


def robot_file_text(urdf: str, arguments: Mapping[str, str], derived: DerivedRobot) -> str:
    """Returns the text of a ``robot.yaml``.

    Args:
        urdf: The description, as the file names it.
        arguments: Arguments of a xacro: name and value.
        derived: The guesses.
    """
    values: dict[str, Any] = {"urdf": urdf}
    if arguments:
        values["xacro_args"] = dict(arguments)
    values |= derived.values
    said: dict[str, list[str]] = {}
    for guess in derived.guesses:
        said.setdefault(guess.key, []).append(f"# guessed {guess}\n")
    parts = ["# Guessed from the description; check it. The keys: docs/robots.md\n"]
    for key, value in values.items():
        parts += said.pop(key, [])
        # PyYAML puts the innermost collections on one line; a mapping of one key and a number would be such a collection.
        style = None if isinstance(value, (dict, list)) else False
        parts.append(yaml.safe_dump({key: value}, sort_keys=False, allow_unicode=True, default_flow_style=style, width=_WIDTH))
    # Guesses that set no key, such as that there is no drive.
    parts += [line for lines in said.values() for line in lines]
    return "".join(parts)
