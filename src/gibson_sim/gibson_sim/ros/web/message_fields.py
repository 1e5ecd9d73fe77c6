"""Reads the numbers in any message by their paths, such as ``twist.twist.linear.x`` or ``ranges[180]``, and finds their units."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from gibson_sim.ros.wire.message_types import UNKNOWN, message_class

MAX_FIELDS = 600
"""Maximum number of fields of a message that a page lists; others can be typed."""
MAX_ELEMENTS = 64
"""Maximum number of listed elements of one array."""
_STEP = re.compile(r"([a-z][a-z0-9_]*)((?:\[\d{1,7}\])?)", re.ASCII)
_MAX_DEPTH = 12
_TIMES = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")

_METRES = dict.fromkeys(("x", "y", "z"), "m")
_UNITS: dict[str, dict[str, str]] = {
    "builtin_interfaces/Time": {"sec": "s", "nanosec": "ns"},
    "builtin_interfaces/Duration": {"sec": "s", "nanosec": "ns"},
    "geometry_msgs/Accel": {"linear": "m/s²", "angular": "rad/s²"},
    "geometry_msgs/Point": _METRES,
    "geometry_msgs/Point32": _METRES,
    "geometry_msgs/Pose2D": {"x": "m", "y": "m", "theta": "rad"},
    "geometry_msgs/Transform": {"translation": "m"},
    "geometry_msgs/Twist": {"linear": "m/s", "angular": "rad/s"},
    "geometry_msgs/Wrench": {"force": "N", "torque": "N m"},
    "gibson_msgs/Contact": {"force": "N", "distance": "m"},
    "sensor_msgs/BatteryState": {
        "voltage": "V", "current": "A", "charge": "A h", "capacity": "A h", "design_capacity": "A h", "temperature": "°C",
        "cell_voltage": "V", "cell_temperature": "°C",
    },
    "sensor_msgs/FluidPressure": {"fluid_pressure": "Pa"},
    "sensor_msgs/Illuminance": {"illuminance": "lx"},
    "sensor_msgs/Imu": {"linear_acceleration": "m/s²", "angular_velocity": "rad/s"},
    "sensor_msgs/JointState": {"position": "rad or m", "velocity": "rad/s or m/s", "effort": "N m or N"},
    "sensor_msgs/LaserScan": {
        "ranges": "m", "range_min": "m", "range_max": "m", "angle_min": "rad", "angle_max": "rad", "angle_increment": "rad",
        "scan_time": "s", "time_increment": "s",
    },
    "sensor_msgs/MagneticField": {"magnetic_field": "T"},
    "sensor_msgs/NavSatFix": {"latitude": "°", "longitude": "°", "altitude": "m"},
    "sensor_msgs/Range": {"range": "m", "min_range": "m", "max_range": "m", "field_of_view": "rad"},
    "sensor_msgs/Temperature": {"temperature": "°C"},
    "trajectory_msgs/JointTrajectoryPoint": {
        "positions": "rad or m", "velocities": "rad/s or m/s", "accelerations": "rad/s² or m/s²", "effort": "N m or N",
    },
}  # fmt: skip
"""Message type -> field -> unit, from REP 103 and the comments in the definitions.

The unit of a field that holds a message, such as ``Twist.linear``, applies to the numbers in it."""


class NumberField(NamedTuple):
    """One numeric field of a message."""

    path: str
    unit: str
    """Unit; empty = unknown."""
    label: str
    """Name of the element in the message, such as the name of a joint; empty = none."""


Step = tuple[str, int | None]
"""Name of a field, and index of an element of it; None = the field itself."""


def parse_path(path: str) -> tuple[Step, ...]:
    """Returns the steps of a path.

    Raises:
        ValueError: the path is invalid.
    """
    steps: list[Step] = []
    for part in path.split("."):
        match = _STEP.fullmatch(part)
        if match is None or len(steps) >= _MAX_DEPTH:
            raise ValueError(f"{path[:80]!r} is not a field path, such as twist.twist.linear.x or ranges[180]")
        steps.append((match[1], int(match[2][1:-1]) if match[2] else None))
    return tuple(steps)


def number_at(message: Any, steps: tuple[Step, ...]) -> float | None:
    """Returns the number at a path; None = the path does not exist in this message (a short array), or its value is not a number."""
    value = message
    for name, index in steps:
        if not hasattr(value, "get_fields_and_field_types") or name not in value.get_fields_and_field_types():
            return None
        value = getattr(value, name)
        if index is not None:
            if isinstance(value, str) or not hasattr(value, "__len__") or index >= len(value):
                return None
            value = value[index]
    return _number(value)


def number_fields(message: Any) -> list[NumberField]:
    """Returns the numeric fields of a message, up to ``MAX_FIELDS``, and up to ``MAX_ELEMENTS`` of each array."""
    fields: list[NumberField] = []
    for field in _walk(message, "", "", "", 0):
        fields.append(field)
        if len(fields) >= MAX_FIELDS:
            break
    return fields


@lru_cache(maxsize=1024)
def has_numbers(type_name: str) -> bool:
    """Returns whether messages of a type, such as ``nav_msgs/msg/Odometry``, can have numbers other than times."""
    return _has_numbers(type_name, 0)


def _has_numbers(type_name: str, depth: int) -> bool:
    if depth >= _MAX_DEPTH or type_name in _TIMES:
        return False
    try:
        fields = message_class(type_name).get_fields_and_field_types()
    except UNKNOWN:
        return False
    for kind in fields.values():
        element = re.sub(r"^sequence<|(, \d+)?>$|\[\d+\]$", "", kind)
        if "/" in element:
            if _has_numbers(element.replace("/", "/msg/"), depth + 1):
                return True
        elif not element.startswith(("string", "wstring")):
            return True
    return False


def _walk(message: Any, prefix: str, outer: str, label: str, depth: int) -> Iterator[NumberField]:
    if depth >= _MAX_DEPTH:
        return
    fields = message.get_fields_and_field_types()
    type_name = f"{type(message).__module__.partition('.')[0]}/{type(message).__name__}"
    texts = [getattr(message, name) for name, kind in fields.items() if kind.startswith("sequence<string")]
    for name in fields:
        value, path, unit = getattr(message, name), prefix + name, unit_of(type_name, name, outer)
        if hasattr(value, "get_fields_and_field_types"):
            yield from _walk(value, f"{path}.", unit, label, depth + 1)
        elif _number(value) is not None:
            yield NumberField(path, unit, label)
        elif isinstance(value, (list, tuple, array, np.ndarray)):
            names = next((rows for rows in texts if len(rows) == len(value)), None)
            for index, element in enumerate(value[:MAX_ELEMENTS]):
                title = " ".join(filter(None, (label, "" if names is None else str(names[index]))))
                if hasattr(element, "get_fields_and_field_types"):
                    yield from _walk(element, f"{path}[{index}].", unit, title, depth + 1)
                elif _number(element) is not None:
                    yield NumberField(f"{path}[{index}]", unit, title)


def _number(value: Any) -> float | None:
    if isinstance(value, bytes):  # an octet, such as the level of a DiagnosticStatus
        return float(value[0]) if len(value) == 1 else None
    return float(value) if isinstance(value, (bool, int, float, np.number)) else None


def unit_of(type_name: str, field: str, outer: str) -> str:
    """Returns the unit of a field; empty = unknown or none.

    Args:
        type_name: type of the message with the field, such as ``geometry_msgs/Twist``.
        field: name of the field.
        outer: unit of the field that holds the message; empty = none.
    """
    return _UNITS.get(type_name, {}).get(field, outer)
