"""Records of trials as JSON: one format for all of their files, and for what travels to worker processes and nodes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

T = TypeVar("T")


def json_values(value: Any) -> Any:
    """Returns a value as JSON values: records become mappings, tuples lists, paths text, and NaN and infinities null."""
    if is_dataclass(value):
        return {field.name: json_values(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(name): json_values(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_values(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)


def json_text(value: Any) -> str:
    """Returns a value as the text of a JSON file; see ``json_values``."""
    return json.dumps(json_values(value), indent=1, allow_nan=False) + "\n"


def restored(kind: type[T], values: Any) -> T:
    """Returns the record that ``json_values`` converted, from its values.

    Args:
        kind: a dataclass whose fields are JSON values, paths, tuples, mappings and such records.
        values: mapping of its fields; those with a default may be missing.

    Raises:
        TypeError: a field is missing or unknown, or values have another structure.
        ValueError: a tuple has another length.
    """
    record: T = _restored(kind, values)
    return record


def _restored(kind: Any, value: Any) -> Any:
    if isinstance(kind, type) and is_dataclass(kind):
        if not isinstance(value, Mapping):
            raise TypeError(f"{kind.__name__} is {type(value).__name__}, must be a mapping")
        hints = _hints(kind)
        return kind(**{name: _restored(hints.get(name), item) for name, item in value.items()})
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        (inner,) = (argument for argument in arguments if argument is not NoneType)
        return None if value is None else _restored(inner, value)
    if origin is tuple:
        kinds = arguments[:1] * len(value) if arguments[-1] is Ellipsis else arguments
        return tuple(_restored(inner, item) for inner, item in zip(kinds, value, strict=True))
    return Path(value) if kind is Path else value


@lru_cache(maxsize=64)
def _hints(kind: type) -> dict[str, Any]:
    """Returns the types of a dataclass's fields."""
    return get_type_hints(kind)
