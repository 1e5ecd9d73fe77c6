"""Settings as fields of dataclasses: each with its default, unit, limits and meaning, checked in one way."""

from __future__ import annotations

import math
from dataclasses import Field, field, fields
from typing import Any, ClassVar, Protocol

from gibson_sim.errors import ConfigError

Value = bool | int | float | str


class Settings(Protocol):
    """A frozen dataclass whose fields were made with ``setting``."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


def setting(
    default: Value,
    doc: str,
    *,
    unit: str = "",
    minimum: float = -math.inf,
    maximum: float = math.inf,
    choices: tuple[str, ...] = (),
) -> Any:
    """Returns a dataclass field with its default, meaning, unit and limits; the type of the default is the field's type."""
    return field(
        default=default,
        metadata={"doc": doc, "unit": unit, "minimum": minimum, "maximum": maximum, "choices": choices},
    )


def check_settings(settings: Settings) -> None:
    """Checks type, limits and choices of every field.

    Raises:
        ConfigError: naming the field, its value and what is allowed.
    """
    for f in fields(settings):
        value, what = getattr(settings, f.name), f"setting {f.name!r}"
        wanted = type(f.default)
        if wanted is float and type(value) is int:
            value = float(value)
            object.__setattr__(settings, f.name, value)
        if type(value) is not wanted:
            raise ConfigError(f"{what} is {value!r} ({type(value).__name__}), must be of type {wanted.__name__}")
        if isinstance(value, (int, float)) and not f.metadata["minimum"] <= value <= f.metadata["maximum"]:
            limits = f"{f.metadata['minimum']:g} to {f.metadata['maximum']:g} {f.metadata['unit']}".strip()
            raise ConfigError(f"{what} is {value!r}, must be {limits}")
        if f.metadata["choices"] and value not in f.metadata["choices"]:
            raise ConfigError(f"{what} is {value!r}, must be one of {', '.join(f.metadata['choices'])}")
