"""Mappings of YAML files, for scenes, robots, cameras and randomisation rules. Every error is one line that names file and key."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gibson_sim.errors import GibsonSimError, SceneError, TextError
from gibson_sim.quoting import quoted
from gibson_sim.reading import read_yaml_file
from gibson_sim.types import Vec3

ROS_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""Pattern of names that ROS accepts in topics and frames."""
_LEAST_SIMILARITY = 0.5
"""Minimum similarity, 0 to 1, of a known key that is suggested for an unknown one."""


def read_yaml_map(path: Path, known: tuple[str, ...] | None = None, error: type[GibsonSimError] = SceneError) -> YamlMap:
    """Returns the mapping in a YAML file, empty for an empty file; the other arguments are those of ``YamlMap``.

    Raises:
        GibsonSimError: an ``error``: the file cannot be read, or does not contain a mapping.
    """
    try:
        document = read_yaml_file(path)
    except OSError as e:
        raise error(f"{path}: cannot be read: {e.strerror or e}") from e
    except TextError as e:
        raise error(f"{path}: {e}").with_public(e.public) from e
    return YamlMap({} if document is None else document, str(path), known, error)


class YamlMap:
    """A mapping of a YAML file, whose values are checked when they are accessed.

    Args:
        content: content of the mapping.
        where: file and location in it, for messages.
        known: allowed keys; None = ``check_keys`` is called later.
        error: type of the errors that this mapping and nested ones raise.
    """

    def __init__(
        self, content: Any, where: str, known: tuple[str, ...] | None = None, error: type[GibsonSimError] = SceneError
    ) -> None:
        self.where, self._error = where, error
        if not isinstance(content, Mapping):
            if known is None:
                raise error(f"{where}: must be a list of 'key: value' lines, is {type(content).__name__}")
            raise error(f"{where}: is {quoted(content)}, must be a mapping with {', '.join(known)}")
        self.values: Mapping[str, Any] = content
        if known is not None:
            self.check_keys(known)

    def check_keys(self, known: tuple[str, ...]) -> None:
        """Raises an error at the first key that is not ``known``, with the most similar known key."""
        for key in self.values:
            if key not in known:
                near = difflib.get_close_matches(str(key), known, n=1, cutoff=_LEAST_SIMILARITY)
                hint = f"did you mean {quoted(near[0])}? " if near else ""
                raise self._error(f"{self.where}: key {quoted(key)} is unknown; {hint}known: {', '.join(known)}")

    def has(self, key: str) -> bool:
        """Returns whether the key exists and has a value."""
        return self.values.get(key) is not None

    def value(self, key: str, default: Any = None) -> Any:
        """Returns the unchecked value of a key."""
        return self.values.get(key, default)

    def within(self, content: Any, place: str, known: tuple[str, ...] | None = None) -> YamlMap:
        """Returns a nested mapping, such as an item of a list; ``place``: its location in this one, for messages."""
        return YamlMap(content, f"{self.where}: {place}", known, self._error)

    def section(self, key: str) -> YamlMap | None:
        """Returns the mapping under a key; None = the key has no value."""
        return self.within(self.values[key], key) if self.has(key) else None

    def items(self, key: str) -> list[Any]:
        """Returns a list, empty if the key has no value."""
        value = self.values.get(key) or []
        if not isinstance(value, list):
            raise self._wrong(key, value, "a list")
        return value

    def text(self, key: str, default: str | None = None) -> str:
        """Returns a text; without a default the key must exist, and its text must not be empty."""
        value = self._required(key) if default is None else self.values.get(key, default)
        if not isinstance(value, str) or (default is None and not value):
            raise self._wrong(key, value, "text")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Returns a Boolean."""
        value = self.values.get(key, default)
        if not isinstance(value, bool):
            raise self._wrong(key, value, "true or false")
        return value

    def number(self, key: str, default: float | None = None, low: float = -math.inf, high: float = math.inf) -> float:
        """Returns a finite number within limits; without a default the key must exist."""
        return self._number(key, self._required(key) if default is None else self.values.get(key, default), low, high)

    def numbers(self, keys: tuple[str, ...]) -> dict[str, float]:
        """Returns the finite numbers of those of ``keys`` that exist."""
        return {key: self.number(key) for key in keys if key in self.values}

    def integers(self, keys: tuple[str, ...]) -> dict[str, int]:
        """Returns the whole numbers of those of ``keys`` that exist."""
        out = {}
        for key, value in self.numbers(keys).items():
            if value != int(value):
                raise self._wrong(key, value, "a whole number")
            out[key] = int(value)
        return out

    def floats(self, key: str, count: int | None = None, low: float = -math.inf, high: float = math.inf) -> tuple[float, ...]:
        """Returns a list of ``count`` finite numbers within limits, None = any count; the key must exist."""
        value = self.values.get(key)
        if not isinstance(value, list) or count not in (None, len(value)):
            raise self._wrong(key, value, "a list of numbers" if count is None else f"a list of {count} numbers")
        return tuple(self._number(key, item, low, high) for item in value)

    def vec3(self, key: str, default: Vec3 | None = None, low: float = -math.inf, high: float = math.inf) -> Vec3:
        """Returns three finite numbers within limits; without a default the key must exist."""
        if default is not None and not self.has(key):
            return default
        x, y, z = self.floats(key, 3, low, high)
        return (x, y, z)

    def direction(self, key: str, default: Vec3) -> Vec3:
        """Returns three finite numbers that are not all zero."""
        value = self.vec3(key, default)
        if not any(value):
            raise self._error(f"{self.where}: {key} is {list(value)}, must not be zero").with_public(f"{key} must not be zero")
        return value

    def _required(self, key: str) -> Any:
        if key not in self.values:
            raise self._error(f"{self.where}: {key} is missing")
        return self.values[key]

    def _number(self, key: str, value: Any, low: float, high: float) -> float:
        valid = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        if not valid or not low <= value <= high:
            limits = "" if low == -math.inf and high == math.inf else f", from {low:g} to {high:g}"
            raise self._wrong(key, value, f"a finite number{limits}")
        return float(value)

    def _wrong(self, key: str, value: Any, required: str) -> GibsonSimError:
        """Returns the error for an invalid value; its public message contains only the requirement."""
        return self._error(f"{self.where}: {key} is {quoted(value)}, must be {required}").with_public(f"{key} must be {required}")
