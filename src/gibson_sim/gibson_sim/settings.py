"""Settings as dataclass fields with default, unit, limits and description, and their validation.

Settings of nodes, requests of a page (``web.requests``) and tools of an agent (``agents.tools``) are such dataclasses.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import Field, dataclass, field, fields, is_dataclass
from typing import Any, ClassVar, Literal, Protocol, TypeVar

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted

Value = bool | int | float | str
Names = Literal["", "scene", "robots", "drive", "rules", "views", "file", "participants"]
"""Kind of the name that a text setting contains; "" = none that can be looked up."""


MAX_TEXT = 512
"""Largest length of a text of ``Arguments``, characters."""
_FLOAT_BITS = 1024
"""Size of the smallest integers that no float represents, bits."""


class Settings(Protocol):
    """A frozen dataclass whose fields are created with ``setting``."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


S = TypeVar("S", bound=Settings)


def setting(
    default: Value,
    doc: str,
    *,
    unit: str = "",
    minimum: float = -math.inf,
    maximum: float = math.inf,
    choices: tuple[str, ...] = (),
    names: Names = "",
) -> Any:
    """Returns the dataclass field of a setting, whose type is that of its default.

    Args:
        default: the default value.
        doc: description of the setting, one sentence.
        unit: unit of the value, such as ``m``; empty = none.
        minimum: minimum of a number.
        maximum: maximum of a number.
        choices: allowed values of a text; empty = any.
        names: kind of the name in the text, which the command line validates before it starts processes; an empty text is valid.
    """
    return field(
        default=default,
        metadata={"doc": doc, "unit": unit, "minimum": minimum, "maximum": maximum, "choices": choices, "names": names},
    )


def parts_of(cls: type[Settings]) -> dict[str, type[Settings]]:
    """Returns name -> class of the parts of settings: the fields whose defaults are dataclasses. Settings without parts are one part, ``""``."""
    kinds: dict[str, type[Any]] = {f.name: type(f.default) for f in fields(cls)}
    return {name: kind for name, kind in kinds.items() if is_dataclass(kind)} or {"": cls}


def setting_fields(cls: type[Settings]) -> tuple[Field[Any], ...]:
    """Returns the fields of all settings of a class, part by part."""
    return tuple(f for part in parts_of(cls).values() for f in fields(part))


def setting_values(settings: Settings) -> dict[str, Value]:
    """Returns the values of all settings by name, part by part."""
    parts = [(getattr(settings, name) if name else settings, kind) for name, kind in parts_of(type(settings)).items()]
    return {f.name: getattr(part, f.name) for part, kind in parts for f in fields(kind)}


def make_settings(cls: type[S], values: Mapping[str, Any]) -> S:
    """Returns settings with these values by name, whatever part they are in; the others have their defaults.

    Raises:
        ConfigError: a value is not allowed.
        TypeError: there is no setting of a name.
    """
    rest, parts = dict(values), {}
    for name, kind in parts_of(cls).items():
        if name:
            parts[name] = kind(**{f.name: rest.pop(f.name) for f in fields(kind) if f.name in rest})
    return cls(**rest, **parts)


def check_settings(settings: Settings, kind: str = "setting") -> None:
    """Checks type, limits and choices of every field.

    Args:
        settings: the settings.
        kind: what the error message calls a field.

    Raises:
        ConfigError: a value is not allowed; the message names the field, its value and the allowed values.
    """
    for f in fields(settings):
        value, what = getattr(settings, f.name), f"{kind} {quoted(f.name)}"
        required = type(f.default)
        if required is float and type(value) is int and value.bit_length() < _FLOAT_BITS:
            value = float(value)
            object.__setattr__(settings, f.name, value)
        if type(value) is not required:
            raise ConfigError(f"{what} is {quoted(value)} ({type(value).__name__}), must be of type {required.__name__}")
        if isinstance(value, (int, float)) and not f.metadata["minimum"] <= value <= f.metadata["maximum"]:
            raise ConfigError(f"{what} is {quoted(value)}, must be {limits_of(f)}")
        if f.metadata["choices"] and value not in f.metadata["choices"]:
            hint = nearest(str(value), f.metadata["choices"])
            raise ConfigError(
                f"{what} is {quoted(value)}, must be one of {', '.join(f.metadata['choices'])}{f'; {hint}' if hint else ''}"
            )


@dataclass(frozen=True)
class Arguments:
    """Base of settings whose values come as JSON from outside: texts are printable and at most ``MAX_TEXT`` long."""

    required: ClassVar[tuple[str, ...]] = ()
    """Settings that must be given; a text must not be empty."""

    def __post_init__(self) -> None:
        """Checks all arguments.

        Raises:
            ConfigError: one is not allowed.
        """
        check_settings(self, "argument")


A = TypeVar("A", bound=Arguments)


def read_arguments(cls: type[A], name: str, given: Mapping[str, Any]) -> A:
    """Returns arguments given as JSON values; null = not given, and 2.0 is the whole number 2.

    Args:
        cls: class of the arguments.
        name: what they are for, for messages.
        given: values by name.

    Raises:
        ConfigError: an argument is unknown, missing or not allowed.
    """
    known = {f.name: f for f in fields(cls)}
    values: dict[str, Any] = {}
    for key, value in given.items():
        if key not in known:
            hint, listed = nearest(key, list(known)), ", ".join(known) or "none"
            raise ConfigError(f"argument {quoted(key)} of {name} is unknown{f'; {hint}' if hint else ''}; it has: {listed}")
        if isinstance(value, str) and (len(value) > MAX_TEXT or not value.isprintable()):
            raise ConfigError(f"argument {quoted(key)} is {quoted(value)}, must be at most {MAX_TEXT} printable characters")
        is_whole = type(known[key].default) is int and isinstance(value, float) and value.is_integer()
        if value is not None:
            values[key] = int(value) if is_whole else value
    for key in cls.required:
        if values.get(key, "") == "":
            unit = known[key].metadata["unit"]
            raise ConfigError(
                f"argument {quoted(key)} of {name} is missing: {known[key].metadata['doc']}{f', {unit}' if unit else ''}"
            )
    return cls(**values)


def limits_of(f: Field[Any]) -> str:
    """Returns the limits of a setting with their unit as text; only the unit if there are no limits."""
    low, high, unit = f.metadata["minimum"], f.metadata["maximum"], f.metadata["unit"]
    if math.isinf(low) and math.isinf(high):
        return str(unit)
    limits = f"{low:g} to {high:g}" if not math.isinf(high) else f"{low:g} or more"
    return f"{limits} {unit}".strip()


def nearest(text: str, known: Sequence[str]) -> str:
    """Returns ``did you mean 'x'?`` with the most similar known text; empty if none is similar."""
    matches = difflib.get_close_matches(text, known, n=1, cutoff=0.5)
    return f"did you mean {quoted(matches[0])}?" if matches else ""
