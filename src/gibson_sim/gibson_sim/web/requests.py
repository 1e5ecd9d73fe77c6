"""Requests of a page: one JSON object per message, validated before use."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Literal

from gibson_sim.client_config import TASK_NAMES
from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import quoted

MAX_BYTES = 4096
"""Largest length of a page's message, characters."""
MAX_VIDEOS = 16
"""Largest number of videos of one page."""
MAX_TEXT = 512
"""Largest length of a name or a URI, characters."""
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

TimeAction = Literal["play", "pause", "step", "reset"]
BASELINES = ("none", "scripted", "careful", "random")


class PageRequestError(GibsonSimError):
    """A message of a page is not a valid request; the error is sent to the page."""


@dataclass(frozen=True, slots=True)
class Watch:
    """Sets the videos that the page shows; none while it is hidden."""

    topics: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Shown:
    """Acknowledges an image of a video; the page is ready for the next."""

    topic: str


@dataclass(frozen=True, slots=True)
class Drive:
    """Velocities in the robot's base frame, m/s and rad/s; valid for ``dead_man.DEADLINE_S``."""

    linear: float
    lateral: float
    angular: float
    robot: str = ""
    """Namespace of the robot; empty = the robot without a namespace, or the first by name."""


@dataclass(frozen=True, slots=True)
class Goal:
    """A pose on the map, metres and radians: a navigation goal, or an initial pose estimate."""

    kind: Literal["goal", "initial_pose"]
    x: float
    y: float
    yaw: float
    robot: str = ""
    """Namespace of the robot, as for ``Drive``."""
    z: float = 0.0
    """Height of the floor that the page shows, metres."""


@dataclass(frozen=True, slots=True)
class Time:
    """Plays, pauses, steps or resets the simulation."""

    action: TimeAction
    steps: int = 1


@dataclass(frozen=True, slots=True)
class Rate:
    """Ratio of simulation time to wall time; 0 = as fast as possible."""

    value: float


@dataclass(frozen=True, slots=True)
class Spawn:
    """Spawns an object of the catalogue on the floor, metres and radians."""

    uri: str
    x: float
    y: float
    yaw: float
    z: float = 0.0
    """Height of the floor that the page shows, metres."""


@dataclass(frozen=True, slots=True)
class Move:
    """Moves an entity to another pose on the floor, metres and radians."""

    name: str
    x: float
    y: float
    yaw: float
    z: float = 0.0
    """Height of the floor that the page shows, metres."""


@dataclass(frozen=True, slots=True)
class Delete:
    """Removes an entity."""

    name: str


@dataclass(frozen=True, slots=True)
class Plot:
    """Sets the curves that the page plots."""

    curves: tuple[tuple[str, str], ...]
    """Topic and field of each."""


@dataclass(frozen=True, slots=True)
class Fields:
    """Requests the numeric fields of a topic's messages."""

    topic: str


@dataclass(frozen=True, slots=True)
class Open:
    """Opens or closes a door or a drawer."""

    joint: str
    """``<body>/<joint>``."""
    opening: float
    """Opening, 0 = closed, 1 = fully open."""


@dataclass(frozen=True, slots=True)
class MoveJoint:
    """Moves a joint of a robot to a position."""

    robot: str
    """Namespace of the robot, as for ``Drive``."""
    joint: str
    position: float
    """Position, rad or m."""


@dataclass(frozen=True, slots=True)
class Record:
    """Starts a recording in a folder chosen by the server, or ends it."""

    action: Literal["start", "stop"]
    images: bool = False


@dataclass(frozen=True, slots=True)
class RunTask:
    """Sets up an episode of a task, starts the next one, or ends the task."""

    action: Literal["start", "next", "stop"]
    task: str = TASK_NAMES[0]
    baseline: str = BASELINES[0]
    """Baseline that drives the robot; none = the page or another node drives."""
    seed: int = 0


Request = Watch | Shown | Drive | Goal | Time | Rate | Spawn | Move | Delete | Plot | Fields | Open | MoveJoint | Record | RunTask


def parse_request(message: str) -> Request:
    """Parses the request in a page's message.

    Raises:
        PageRequestError: the message is not a valid request; names the key, the value and the allowed values.
    """
    if len(message) > MAX_BYTES:
        raise PageRequestError(f"a message has {len(message)} characters, at most {MAX_BYTES} are allowed")
    try:
        values = json.loads(message)
    except (ValueError, RecursionError) as error:
        raise PageRequestError(f"a message is not JSON: {quoted(message)}") from error
    if not isinstance(values, dict):
        raise PageRequestError(f"a message is {quoted(message)}, must be a JSON object")
    fields = _Fields(values)
    kind = fields.choice("type", tuple(_READERS))
    request: Request = _READERS[kind](fields)
    return request


class _Fields:
    """The values of one message."""

    def __init__(self, values: dict[str, Any]) -> None:
        self._values = values

    def number(self, key: str, limit: float, low: float | None = None) -> float:
        """Returns a finite number from ``low`` (None = -limit) to ``limit``; 0 if the key is missing."""
        value = self._values.get(key, 0.0)
        least = -limit if low is None else low
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not least <= value <= limit:  # false for NaN and infinity
            raise PageRequestError(f"{key} is {quoted(value)}, must be a number from {least:g} to {limit:g}")
        return float(value)

    def text(self, key: str) -> str:
        """Returns a non-empty text."""
        value = self._values.get(key)
        if not isinstance(value, str) or not 0 < len(value) <= MAX_TEXT or not value.isprintable():
            raise PageRequestError(f"{key} is {quoted(value)}, must be a text of 1 to {MAX_TEXT} printable characters")
        return value

    def texts(self, key: str, most: int) -> tuple[str, ...]:
        """Returns a list of texts."""
        value = self._values.get(key)
        if not isinstance(value, list) or len(value) > most or not all(isinstance(t, str) and len(t) <= MAX_TEXT for t in value):
            raise PageRequestError(f"{key} is {quoted(value)}, must be a list of at most {most} texts")
        return tuple(value)

    def flag(self, key: str) -> bool:
        """Returns a boolean; False if the key is missing."""
        value = self._values.get(key, False)
        if not isinstance(value, bool):
            raise PageRequestError(f"{key} is {quoted(value)}, must be true or false")
        return value

    def curves(self) -> tuple[tuple[str, str], ...]:
        """Returns pairs of a topic and a field."""
        value = self._values.get("curves")
        is_valid = isinstance(value, list) and len(value) <= MAX_CURVES and all(_is_pair(item) for item in value)
        if not is_valid or not isinstance(value, list):
            raise PageRequestError(
                f"curves is {quoted(value)}, must be a list of at most {MAX_CURVES} pairs of a topic and a field"
            )
        return tuple((topic, path) for topic, path in value)

    def robot(self) -> str:
        """Returns the namespace of a robot; empty if the key is missing."""
        return self.text("robot") if self._values.get("robot") else ""

    def choice(self, key: str, known: tuple[str, ...]) -> str:
        """Returns one of the known texts."""
        value = self._values.get(key)
        if value not in known:
            raise PageRequestError(f"{key} is {quoted(value)}, must be one of {', '.join(known)}")
        return str(value)

    def pose(self) -> tuple[float, float, float]:
        """Returns x, y (m) and yaw (rad)."""
        x, y = (self.number(key, MAX_COORDINATE) for key in ("x", "y"))
        return x, y, self.number("yaw", 100.0)

    def height(self) -> float:
        """Returns z (m); 0 if the key is missing."""
        return self.number("z", MAX_COORDINATE)


def _is_pair(item: Any) -> bool:
    return isinstance(item, list) and len(item) == 2 and all(isinstance(t, str) and 0 < len(t) <= MAX_TEXT for t in item)


def _goal(kind: Literal["goal", "initial_pose"], fields: _Fields) -> Goal:
    x, y, yaw = fields.pose()
    return Goal(kind, x, y, yaw, fields.robot(), fields.height())


def _task(fields: _Fields) -> RunTask:
    action: Any = fields.choice("action", ("start", "next", "stop"))
    if action != "start":
        return RunTask(action)
    seed = int(fields.number("seed", MAX_SEED, 0.0))
    return RunTask(action, fields.choice("task", TASK_NAMES), fields.choice("baseline", BASELINES), seed)


def _record(fields: _Fields) -> Record:
    action: Any = fields.choice("action", ("start", "stop"))
    return Record(action, fields.flag("images"))


def _time(fields: _Fields) -> Time:
    action: Any = fields.choice("action", ("play", "pause", "step", "reset"))
    return Time(action, int(fields.number("steps", MAX_STEPS, 1.0)) if action == "step" else 1)


def _spawn(fields: _Fields) -> Spawn:
    return Spawn(fields.text("uri"), *fields.pose(), fields.height())


def _move(fields: _Fields) -> Move:
    return Move(fields.text("name"), *fields.pose(), fields.height())


_READERS: dict[str, Any] = {
    "watch": lambda f: Watch(f.texts("topics", MAX_VIDEOS)),
    "shown": lambda f: Shown(f.text("topic")),
    "drive": lambda f: Drive(
        f.number("linear", MAX_SPEED), f.number("lateral", MAX_SPEED), f.number("angular", MAX_TURN), f.robot()
    ),
    "goal": lambda f: _goal("goal", f),
    "initial_pose": lambda f: _goal("initial_pose", f),
    "time": _time,
    "rate": lambda f: Rate(f.number("value", MAX_RATE, 0.0)),
    "spawn": _spawn,
    "move": _move,
    "delete": lambda f: Delete(f.text("name")),
    "plot": lambda f: Plot(f.curves()),
    "fields": lambda f: Fields(f.text("topic")),
    "open": lambda f: Open(f.text("joint"), f.number("opening", 1.0, 0.0)),
    "joint": lambda f: MoveJoint(f.robot(), f.text("joint"), f.number("position", MAX_COORDINATE)),
    "record": _record,
    "task": _task,
}
