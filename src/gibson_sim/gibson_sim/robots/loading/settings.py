"""Mappings of YAML files whose every complaint names file and key."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gibson_sim.errors import RobotError, TextError
from gibson_sim.quoting import quoted
from gibson_sim.reading import read_yaml_file
from gibson_sim.types import Vec3

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""Names that ROS can use in topics and frames."""


def read_yaml(path: Path) -> Any:
    """Returns what a YAML file holds; RobotError, one line, where it cannot be read."""
    try:
        return read_yaml_file(path)
    except TextError as error:
        raise RobotError(f"{path}: {error}").telling(error.public) from error
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from error


class Settings:
    """One mapping of the file; every complaint names file and key."""

    def __init__(self, values: Any, where: str) -> None:
        if not isinstance(values, Mapping):
            raise RobotError(f"{where}: must be a list of 'key: value' lines, is {type(values).__name__}")
        self.values, self.where = values, where

    def check_keys(self, known: tuple[str, ...]) -> None:
        """Raises RobotError at the first key that is not ``known``."""
        for key in self.values:
            if key not in known:
                near = difflib.get_close_matches(str(key), known, n=1, cutoff=0.5)
                hint = f"did you mean {quoted(near[0])}?" if near else f"known: {', '.join(known)}"
                raise RobotError(f"{self.where}: key {quoted(key)} is unknown; {hint}")

    def section(self, key: str) -> Settings | None:
        """Returns the mapping under ``key``; None = not given."""
        return Settings(self.values[key], f"{self.where}: {key}") if self.values.get(key) is not None else None

    def text(self, key: str, default: str = "") -> str:
        """Returns a text that is not empty."""
        value = self.values.get(key, default)
        if not isinstance(value, str) or not value:
            raise RobotError(
                f"{self.where}: {key} is {quoted(value)}, must be a text"
                if key in self.values
                else f"{self.where}: {key} is missing"
            )
        return value

    def number(self, key: str) -> float:
        """Returns a finite number."""
        value = self.values[key]
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise RobotError(f"{self.where}: {key} is {quoted(value)}, must be a finite number").telling(
                f"{key} must be a finite number"
            )
        return float(value)

    def numbers(self, keys: tuple[str, ...]) -> dict[str, float]:
        """Returns those of ``keys`` that are given."""
        return {key: self.number(key) for key in keys if key in self.values}

    def integers(self, keys: tuple[str, ...]) -> dict[str, int]:
        """Returns those of ``keys`` that are given."""
        out = {}
        for key in keys:
            if key in self.values:
                value = self.number(key)
                if value != int(value):
                    raise RobotError(f"{self.where}: {key} is {value:g}, must be a whole number").telling(
                        f"{key} must be a whole number"
                    )
                out[key] = int(value)
        return out

    def floats(self, key: str) -> tuple[float, ...]:
        """Returns a list of finite numbers, as many as there are."""
        value = self.values[key]
        if not isinstance(value, list):
            raise RobotError(f"{self.where}: {key} is {quoted(value)}, must be a list of numbers").telling(
                f"{key} must be a list of numbers"
            )
        return tuple(Settings({key: item}, self.where).number(key) for item in value)

    def vector(self, key: str) -> Vec3:
        """Returns three finite numbers; zeros where the key is not given."""
        value = self.values.get(key, [0.0, 0.0, 0.0])
        if not isinstance(value, list) or len(value) != 3:
            raise RobotError(f"{self.where}: {key} is {quoted(value)}, must be three numbers").telling(
                f"{key} must be three numbers"
            )
        x, y, z = (Settings({key: item}, self.where).number(key) for item in value)
        return (x, y, z)
