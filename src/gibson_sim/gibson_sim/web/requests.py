"""Requests of a page: one JSON object per message, a dataclass each, validated before use."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gibson_sim.client_config import TASK_NAMES
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.settings import MAX_TEXT, Arguments, nearest, read_arguments, setting

MAX_BYTES = 4096
"""Largest length of a page's message, characters."""
MAX_VIDEOS = 16
"""Largest number of videos of one page."""
MAX_COORDINATE = 1e6
"""Largest coordinate, metres."""
MAX_SPEED, MAX_TURN = 10.0, 20.0
"""Largest velocities of a command, m/s and rad/s; the robot's own limits also apply."""
MAX_STEPS = 100_000
MAX_RATE = 1000.0
"""Largest ratio of simulation time to wall time."""
MAX_CURVES = 16
"""Largest number of curves of one page."""
MAX_SEED = 2**31 - 1
BASELINES = ("none", "scripted", "careful", "random")


def _speed(doc: str) -> Any:
    return setting(0.0, doc, unit="m/s", minimum=-MAX_SPEED, maximum=MAX_SPEED)


def _coordinate(doc: str) -> Any:
    return setting(0.0, doc, unit="m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE)


def _height() -> Any:
    return _coordinate("Height of the floor that the page shows")


def _yaw() -> Any:
    return setting(0.0, "Heading on the map, counter-clockwise", unit="rad", minimum=-100.0, maximum=100.0)


def _robot() -> Any:
    return setting("", "Namespace of the robot; empty = the robot without a namespace, or the first by name")


@dataclass(frozen=True)
class Watch:
    """Sets the videos that the page shows; none while it is hidden."""

    topics: tuple[str, ...]

    @classmethod
    def read(cls, given: Mapping[str, Any]) -> Watch:
        """Returns the request in a message.

        Raises:
            ConfigError: it is not valid.
        """
        topics = given.get("topics")
        if not isinstance(topics, list) or len(topics) > MAX_VIDEOS or not all(_is_text(topic) for topic in topics):
            raise ConfigError(f"argument 'topics' is {quoted(topics)}, must be a list of at most {MAX_VIDEOS} texts")
        return cls(tuple(topics))


@dataclass(frozen=True)
class Shown(Arguments):
    """Acknowledges an image of a video; the page is ready for the next."""

    required = ("topic",)
    topic: str = setting("", "Topic of the image")


@dataclass(frozen=True)
class Drive(Arguments):
    """Velocities in the robot's base frame; valid for ``dead_man.DEADLINE_S``."""

    linear: float = _speed("Forward velocity")
    lateral: float = _speed("Velocity to the left")
    angular: float = setting(0.0, "Yaw rate, counter-clockwise", unit="rad/s", minimum=-MAX_TURN, maximum=MAX_TURN)
    robot: str = _robot()


@dataclass(frozen=True)
class Goal(Arguments):
    """A navigation goal on the map."""

    required = ("x", "y")
    x: float = _coordinate("Position on the map, x")
    y: float = _coordinate("Position on the map, y")
    yaw: float = _yaw()
    robot: str = _robot()
    z: float = _height()


@dataclass(frozen=True)
class InitialPose(Goal):
    """An initial estimate of the robot's pose on the map."""


@dataclass(frozen=True)
class Time(Arguments):
    """Plays, pauses, steps or resets the simulation."""

    required = ("action",)
    action: str = setting("play", "What to do", choices=("play", "pause", "step", "reset"))
    steps: int = setting(1, "Number of physics steps of ``step``", minimum=1, maximum=MAX_STEPS)


@dataclass(frozen=True)
class Rate(Arguments):
    """Sets the speed of the simulation."""

    required = ("value",)
    value: float = setting(0.0, "Ratio of simulation time to wall time; 0 = as fast as possible", minimum=0.0, maximum=MAX_RATE)


@dataclass(frozen=True)
class Spawn(Arguments):
    """Spawns an object of the catalogue on the floor."""

    required = ("uri", "x", "y")
    uri: str = setting("", "Object of the catalogue")
    x: float = _coordinate("Position on the map, x")
    y: float = _coordinate("Position on the map, y")
    yaw: float = _yaw()
    z: float = _height()


@dataclass(frozen=True)
class Move(Arguments):
    """Moves an entity to another pose on the floor."""

    required = ("name", "x", "y")
    name: str = setting("", "Name of the entity")
    x: float = _coordinate("Position on the map, x")
    y: float = _coordinate("Position on the map, y")
    yaw: float = _yaw()
    z: float = _height()


@dataclass(frozen=True)
class Delete(Arguments):
    """Removes an entity."""

    required = ("name",)
    name: str = setting("", "Name of the entity")


@dataclass(frozen=True)
class Plot:
    """Sets the curves that the page plots."""

    curves: tuple[tuple[str, str], ...]
    """Topic and field of each."""

    @classmethod
    def read(cls, given: Mapping[str, Any]) -> Plot:
        """As ``Watch.read``."""
        curves = given.get("curves")
        if not isinstance(curves, list) or len(curves) > MAX_CURVES or not all(_is_pair(curve) for curve in curves):
            raise ConfigError(
                f"argument 'curves' is {quoted(curves)}, must be a list of at most {MAX_CURVES} pairs of a topic and a field"
            )
        return cls(tuple((topic, path) for topic, path in curves))


@dataclass(frozen=True)
class Fields(Arguments):
    """Requests the numeric fields of a topic's messages."""

    required = ("topic",)
    topic: str = setting("", "Topic of the messages")


@dataclass(frozen=True)
class Open(Arguments):
    """Opens or closes a door or a drawer."""

    required = ("joint", "opening")
    joint: str = setting("", "Joint, ``<body>/<joint>``")
    opening: float = setting(0.0, "Opening: 0 = closed, 1 = fully open", minimum=0.0, maximum=1.0)


@dataclass(frozen=True)
class MoveJoint(Arguments):
    """Moves a joint of a robot to a position."""

    required = ("joint", "position")
    robot: str = _robot()
    joint: str = setting("", "Name of the joint")
    position: float = setting(0.0, "Position", unit="rad or m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE)


@dataclass(frozen=True)
class Record(Arguments):
    """Starts a recording in a folder chosen by the server, or ends it."""

    required = ("action",)
    action: str = setting("start", "What to do", choices=("start", "stop"))
    images: bool = setting(False, "Whether images are recorded, too")


@dataclass(frozen=True)
class RunTask(Arguments):
    """Sets up an episode of a task, starts the next one, or ends the task."""

    required = ("action",)
    action: str = setting("start", "What to do", choices=("start", "next", "stop"))
    task: str = setting(TASK_NAMES[0], "Task of ``start``", choices=TASK_NAMES)
    baseline: str = setting(BASELINES[0], "What drives the robot; none = the page or another node", choices=BASELINES)
    seed: int = setting(0, "Seed of the first episode", minimum=0, maximum=MAX_SEED)


Request = Watch | Plot | Arguments
_KINDS: Mapping[str, type[Request]] = {
    "watch": Watch, "shown": Shown, "drive": Drive, "goal": Goal, "initial_pose": InitialPose, "time": Time, "rate": Rate, "spawn": Spawn,
    "move": Move, "delete": Delete, "plot": Plot, "fields": Fields, "open": Open, "joint": MoveJoint, "record": Record, "task": RunTask,
}  # fmt: skip


def parse_request(message: str) -> Request:
    """Parses the request in a page's message.

    Raises:
        ConfigError: the message is not a valid request; names the argument, the value and the allowed values.
    """
    if len(message) > MAX_BYTES:
        raise ConfigError(f"a message has {len(message)} characters, at most {MAX_BYTES} are allowed")
    try:
        values = json.loads(message)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"a message is not JSON: {quoted(message)}") from error
    if not isinstance(values, dict):
        raise ConfigError(f"a message is {quoted(message)}, must be a JSON object")
    name = values.pop("type", None)
    kind = _KINDS.get(name) if isinstance(name, str) else None
    if kind is None:
        hint = nearest(name, list(_KINDS)) if isinstance(name, str) else ""
        raise ConfigError(f"type is {quoted(name)}, must be one of {', '.join(_KINDS)}{f'; {hint}' if hint else ''}")
    return read_arguments(kind, name, values) if issubclass(kind, Arguments) else kind.read(values)


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= MAX_TEXT


def _is_pair(item: Any) -> bool:
    return isinstance(item, list) and len(item) == 2 and all(_is_text(text) and text for text in item)
