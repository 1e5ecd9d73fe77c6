"""A mapping of a YAML file that complains in one line about what is wrong in it: for scenes, and for rules of randomisation."""

from __future__ import annotations

import difflib
import math
from typing import Any

from gibson_sim.errors import SceneError
from gibson_sim.quoting import quoted
from gibson_sim.types import Vec3


class YamlMap:
    """A mapping of a file that complains about keys and values in one line.

    Args:
        content: what the file has here.
        where: file and place, for messages.
        known: the keys that may stand here.
    """

    def __init__(self, content: Any, where: str, known: tuple[str, ...]) -> None:
        if not isinstance(content, dict):
            raise SceneError(f"{where}: is {quoted(content)}, must be a mapping with {', '.join(known)}")
        for key in content:
            if key not in known:
                near = difflib.get_close_matches(str(key), known, n=1, cutoff=0.0)
                raise SceneError(
                    f"{where}: key {quoted(key)} is unknown, did you mean {quoted(near[0])}? known: {', '.join(known)}"
                )
        self.content: dict[str, Any] = content
        self.where = where

    def has(self, key: str) -> bool:
        """Whether the key is there and has a value."""
        return self.content.get(key) is not None

    def value(self, key: str, default: Any) -> Any:
        """Returns what stands there, unchecked."""
        return self.content.get(key, default)

    def text(self, key: str, default: str) -> str:
        """Returns a text that is not empty."""
        value = self.content.get(key, default)
        if value is None and key == "collision":
            return "none"
        if not isinstance(value, str):
            raise SceneError(f"{self.where}: {key} is {quoted(value)}, must be text").telling(f"{key} must be text")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Returns true or false."""
        value = self.content.get(key, default)
        if not isinstance(value, bool):
            raise SceneError(f"{self.where}: {key} is {quoted(value)}, must be true or false").telling(
                f"{key} must be true or false"
            )
        return value

    def direction(self, key: str, default: Vec3) -> Vec3:
        """Returns three numbers that are not all zero."""
        value = self.vec3(key, default)
        if not any(value):
            raise SceneError(f"{self.where}: {key} is {list(value)}, must not be zero").telling(f"{key} must not be zero")
        return value

    def items(self, key: str) -> list[Any]:
        """Returns a list, empty if the key is not there."""
        value = self.content.get(key) or []
        if not isinstance(value, list):
            raise SceneError(f"{self.where}: {key} is {quoted(value)}, must be a list").telling(f"{key} must be a list")
        return value

    def number(self, key: str, default: float, low: float = -math.inf, high: float = math.inf) -> float:
        """Returns a finite number within limits."""
        return self._checked(key, self.content.get(key, default), low, high)

    def floats(self, key: str, count: int, low: float = -math.inf, high: float = math.inf) -> tuple[float, ...]:
        """Returns ``count`` finite numbers within limits; the key must be there."""
        value = self.content.get(key)
        if not isinstance(value, list) or len(value) != count:
            raise SceneError(f"{self.where}: {key} is {quoted(value)}, must be a list of {count} numbers").telling(
                f"{key} must be a list of {count} numbers"
            )
        return tuple(self._checked(key, v, low, high) for v in value)

    def vec3(self, key: str, default: Vec3 | None = None, low: float = -math.inf, high: float = math.inf) -> Vec3:
        """Returns three finite numbers within limits."""
        if default is not None and not self.has(key):
            return default
        x, y, z = self.floats(key, 3, low, high)
        return (x, y, z)

    def _checked(self, key: str, value: Any, low: float, high: float) -> float:
        good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        if not good or not low <= value <= high:
            limits = "" if low == -math.inf and high == math.inf else f", from {low:g} to {high:g}"
            raise SceneError(f"{self.where}: {key} is {quoted(value)}, must be a finite number{limits}").telling(
                f"{key} must be a finite number{limits}"
            )
        return float(value)
