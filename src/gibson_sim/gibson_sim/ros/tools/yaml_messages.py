"""Converts messages to YAML text, as ``ros2 topic echo`` prints it, and YAML values to messages, as for ``ros2 service call``."""

from __future__ import annotations

import array
import datetime
import difflib
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import quoted

SHORT = 128
"""Maximum number of printed elements of an array or characters of a string; the rest is ``...``, unless ``whole`` is set."""
_ARRAY = re.compile(r"(?:sequence<(?P<of>[^,>]+)(?:, (?P<bound>\d+))?>|(?P<item>.+)\[(?P<size>\d+)\])$")
_INTEGER = re.compile(r"(?P<unsigned>u)?int(?P<bits>8|16|32|64)")
_FLOATS = ("float", "double", "float32", "float64")
_TEXTS = ("string", "wstring")


class MessageValueError(GibsonSimError):
    """A value does not fit a field of a message."""


def yaml_text(message: Any, *, whole: bool = False, inline: bool = False) -> str:
    """Returns a message as YAML, one field per line.

    Args:
        message: any message, request or response.
        whole: print whole arrays and strings.
        inline: print each array of numbers or strings in one line.
    """
    return "".join(f"{line}\n" for line in _lines(message, "", whole, inline))


def field_of(message: Any, path: str) -> Any:
    """Returns a field, such as ``pose.pose.position.x`` or ``transforms[0]``.

    Raises:
        MessageValueError: the field does not exist; the message names the existing ones.
    """
    value = message
    for part in re.findall(r"[^.\[\]]+", path):
        if part.isdigit():
            if int(part) >= len(value):
                raise MessageValueError(f"{path}: index {part} is out of range, there are {len(value)} elements")
            value = value[int(part)]
            continue
        fields = value.get_fields_and_field_types() if hasattr(value, "get_fields_and_field_types") else {}
        if part not in fields:
            raise MessageValueError(f"{path}: field {quoted(part)} does not exist; known: {', '.join(fields) or 'none'}")
        value = getattr(value, part)
    return value


def value_text(value: Any, *, whole: bool = False) -> str:
    """Returns the value of one field as YAML."""
    return yaml_text(value, whole=whole) if hasattr(value, "get_fields_and_field_types") else f"{_scalar(_plain(value), whole)}\n"


def fill(message: Any, values: Any, prefix: str = "") -> Any:
    """Sets fields of a message from YAML values, and returns the message.

    Args:
        message: message to change; fields that are not in ``values`` keep their values.
        values: mapping of field names to values, as parsed from YAML.
        prefix: path of the message with a trailing dot, for error messages.

    Raises:
        MessageValueError: a field does not exist, or its value has another type.
    """
    types = message.get_fields_and_field_types()
    if values in (None, ""):
        return message
    if not isinstance(values, dict):
        raise MessageValueError(
            f"{prefix.removesuffix('.') or 'the message'} is {quoted(values)}, must be a mapping with {', '.join(types) or 'no fields'}"
        )
    for name, value in values.items():
        if name not in types:
            matches = difflib.get_close_matches(str(name), types, n=1)
            hint = f"did you mean {matches[0]!r}? " if matches else ""
            raise MessageValueError(f"{prefix}{name}: this field does not exist; {hint}known: {', '.join(types) or 'none'}")
        path = f"{prefix}{name}"
        try:
            setattr(message, name, _converted(value, types[name], getattr(message, name), path))
        except ValueError as error:
            raise MessageValueError(f"{path} is {quoted(value)}, must be {_allowed(types[name], value)}") from error
    return message


def _allowed(type_name: str, value: Any) -> str:
    """Returns which values a field of a type may have; ``value`` is the one that does not fit."""
    text = f"of type {type_name}"
    if integer := _INTEGER.fullmatch(type_name):
        low, high = _limits(integer)
        return f"{text}: {low} to {high}"
    if type_name == "octet":
        return f"{text}: 0 to 255"
    if type_name == "boolean":
        return f"{text}: true or false"
    if type_name.startswith(_TEXTS) and isinstance(value, bool | int | float | datetime.date):
        as_text = ("yes" if value else "no") if isinstance(value, bool) else str(value)
        return f"{text}: put it in quotes, as in '{as_text}'"
    return text


def _limits(integer: re.Match[str]) -> tuple[int, int]:
    """Returns the smallest and the largest value of an integer type that matches ``_INTEGER``."""
    bits = int(integer["bits"])
    return (0, 2**bits - 1) if integer["unsigned"] else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def _converted(value: Any, type_name: str, current: Any, path: str) -> Any:
    """Returns a value converted to the type of a field. By default rclpy does not check values, and an invalid one would end the process."""
    match = _ARRAY.match(type_name)
    if match:
        size, bound = match["size"], match["bound"]
        if not isinstance(value, list) or (size and len(value) != int(size)) or (bound and len(value) > int(bound)):
            raise ValueError
        item = match["of"] or match["item"]
        if "/" in item:
            item_class = _class_of(item)
            return [fill(item_class(), element, f"{path}[{k}].") for k, element in enumerate(value)]
        return [_checked(element, item) for element in value]
    if hasattr(current, "get_fields_and_field_types"):
        return fill(current, value, f"{path}.")
    return _checked(value, type_name)


def _checked(value: Any, type_name: str) -> Any:
    """Returns a value of a primitive type, or raises ValueError."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if type_name in _FLOATS and is_number:
        return float(value)
    if type_name == "boolean" and isinstance(value, bool):
        return value
    if type_name.startswith(_TEXTS) and isinstance(value, str):
        return value
    integer = _INTEGER.fullmatch(type_name)
    if type_name == "octet" and isinstance(value, int) and 0 <= value < 256:
        return bytes([value])
    if integer and isinstance(value, int) and not isinstance(value, bool):
        low, high = _limits(integer)
        if low <= value <= high:
            return value
    raise ValueError


def _class_of(type_name: str) -> Any:
    from gibson_sim.ros.wire.message_types import message_class

    package, name = type_name.split("/")
    return message_class(f"{package}/msg/{name}")


def _lines(message: Any, indent: str, whole: bool, inline: bool = False) -> Iterator[str]:
    fields = message.get_fields_and_field_types()
    if not fields:
        yield f"{indent}{{}}"
    for name in fields:
        value = _plain(getattr(message, name))
        if hasattr(value, "get_fields_and_field_types"):
            yield f"{indent}{name}:"
            yield from _lines(value, indent + "  ", whole, inline)
        elif isinstance(value, list) and value and hasattr(value[0], "get_fields_and_field_types"):
            yield f"{indent}{name}:"
            for item in value if whole else value[:SHORT]:
                first, *rest = _lines(item, indent + "  ", whole, inline)
                yield f"{indent}- {first.strip()}"
                yield from rest
            if not whole and len(value) > SHORT:
                yield f"{indent}- '...'"
        elif isinstance(value, list) and value and inline:
            items = [_scalar(item, whole) for item in (value if whole else value[:SHORT])]
            yield f"{indent}{name}: [{', '.join(items)}{'' if whole or len(value) <= SHORT else ', ...'}]"
        elif isinstance(value, list) and value:
            yield f"{indent}{name}:"
            for item in value if whole else value[:SHORT]:
                yield f"{indent}- {_scalar(item, whole)}"
            if not whole and len(value) > SHORT:
                yield f"{indent}- '...'"
        else:
            yield f"{indent}{name}: {_scalar(value, whole)}"


def _plain(value: Any) -> Any:
    """Returns arrays, tuples and bytes as lists or integers, other values unchanged."""
    if isinstance(value, np.ndarray | array.array | tuple):
        return list(value) if isinstance(value, tuple) else value.tolist()
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    return value


def _scalar(value: Any, whole: bool) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return {"nan": ".nan", "inf": ".inf", "-inf": "-.inf"}.get(str(value), str(value))
    if isinstance(value, str):
        text = value if whole or len(value) <= SHORT else value[:SHORT] + "..."
        return text if re.fullmatch(r"[A-Za-z_/][\w/ .-]*", text) else "'" + text.replace("'", "''").replace("\n", "\\n") + "'"
    return str(value)
