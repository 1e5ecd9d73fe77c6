"""What a page may ask for: one JSON object a message, checked here before anything acts on it. Pure."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Literal

from gibson_sim.client_config import TASK_NAMES
from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import quoted

MAX_BYTES = 4096
"""Length of a message of a page."""
MAX_VIDEOS = 16
"""Videos that one page may watch at a time."""
MAX_TEXT = 512
"""Characters of a name or a URI."""
MAX_COORDINATE = 1e6
"""Metres."""
MAX_SPEED, MAX_TURN = 10.0, 20.0
"""m/s and rad/s of a command; the robot's own limits come on top."""
MAX_STEPS = 100_000
MAX_RATE = 1000.0
"""Simulation time over wall time."""
MAX_CURVES = 16
"""Curves that one page may plot at a time."""
MAX_SEED = 2**31 - 1

TimeAction = Literal["play", "pause", "step", "reset"]
BASELINES = ("none", "scripted", "careful", "random")


class PageRequestError(GibsonSimError):
    """A message of a page that is no request; the page is told."""


@dataclass(frozen=True, slots=True)
class Watch:
    """The videos that the page shows from now on; none while it is hidden."""

    topics: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Shown:
    """The page has shown the last image of a video, and is ready for the next."""

    topic: str


@dataclass(frozen=True, slots=True)
class Drive:
    """Velocities in the robot's base frame, m/s and rad/s; they hold for ``drive.DEADLINE_S``."""

    linear: float
    lateral: float
    angular: float
    robot: str = ""
    """Namespace of the robot; empty = the one without a namespace, or the first by name."""


@dataclass(frozen=True, slots=True)
class Goal:
    """A pose on the map, metres and radians: where to go, or where the robot is taken to be."""

    kind: Literal["goal", "initial_pose"]
    x: float
    y: float
    yaw: float
    robot: str = ""
    """As for ``Drive``."""


@dataclass(frozen=True, slots=True)
class Time:
    """Play, pause, make steps, or reset the simulation."""

    action: TimeAction
    steps: int = 1


@dataclass(frozen=True, slots=True)
class Rate:
    """Speed of simulation time against wall time; 0 = as fast as possible."""

    value: float


@dataclass(frozen=True, slots=True)
class Spawn:
    """Puts a thing of the catalogue on the floor, metres and radians."""

    uri: str
    x: float
    y: float
    yaw: float


@dataclass(frozen=True, slots=True)
class Move:
    """Puts an entity elsewhere on the floor, metres and radians."""

    name: str
    x: float
    y: float
    yaw: float


@dataclass(frozen=True, slots=True)
class Delete:
    """Removes an entity."""

    name: str


@dataclass(frozen=True, slots=True)
class Plot:
    """The curves that the page plots from now on."""

    curves: tuple[tuple[str, str], ...]
    """Topic and field of each."""


@dataclass(frozen=True, slots=True)
class Fields:
    """Asks which numbers the messages of a topic have."""

    topic: str


@dataclass(frozen=True, slots=True)
class Open:
    """Opens or closes a door or a drawer."""

    joint: str
    """``<body>/<joint>``."""
    opening: float
    """0 = closed, 1 = as far as it goes."""


@dataclass(frozen=True, slots=True)
class Record:
    """Starts a recording in a folder that the server chooses, or ends it."""

    action: Literal["start", "stop"]
    images: bool = False


@dataclass(frozen=True, slots=True)
class RunTask:
    """Sets an episode of a task up, begins the next one, or ends the task."""

    action: Literal["start", "next", "stop"]
    task: str = TASK_NAMES[0]
    baseline: str = BASELINES[0]
    """Who drives; none = the page, or another node."""
    seed: int = 0


Request = Watch | Shown | Drive | Goal | Time | Rate | Spawn | Move | Delete | Plot | Fields | Open | Record | RunTask


def parse_request(message: str) -> Request:
    """Returns what a page asks for.

    Raises:
        PageRequestError: it is no request of a page: what, which value, what is allowed.
    """
    if len(message) > MAX_BYTES:
        raise PageRequestError(f"a message has {len(message)} characters, at most {MAX_BYTES} are allowed")
    try:
        values = json.loads(message)
    except (ValueError, RecursionError) as error:
        raise PageRequestError(f"a message is no JSON: {quoted(message)}") from error
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
        """Returns a finite number between ``low`` (-limit) and ``limit``."""
        value = self._values.get(key, 0.0)
        least = -limit if low is None else low
        good = isinstance(value, int | float) and not isinstance(value, bool)
        if not good or not least <= value <= limit:  # NaN and infinity are not between them
            raise PageRequestError(f"{key} is {quoted(value)}, must be a number from {least:g} to {limit:g}")
        return float(value)

    def text(self, key: str) -> str:
        """Returns a text that is not empty."""
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
        """Returns true or false; false where it is missing."""
        value = self._values.get(key, False)
        if not isinstance(value, bool):
            raise PageRequestError(f"{key} is {quoted(value)}, must be true or false")
        return value

    def curves(self) -> tuple[tuple[str, str], ...]:
        """Returns pairs of a topic and a field."""
        value = self._values.get("curves")
        good = isinstance(value, list) and len(value) <= MAX_CURVES and all(_is_pair(item) for item in value)
        if not good or not isinstance(value, list):
            raise PageRequestError(
                f"curves is {quoted(value)}, must be a list of at most {MAX_CURVES} pairs of a topic and a field"
            )
        return tuple((topic, path) for topic, path in value)

    def robot(self) -> str:
        """Returns the namespace of a robot; empty where it is missing."""
        return self.text("robot") if self._values.get("robot") else ""

    def choice(self, key: str, known: tuple[str, ...]) -> str:
        """Returns one of the known texts."""
        value = self._values.get(key)
        if value not in known:
            raise PageRequestError(f"{key} is {quoted(value)}, must be one of {', '.join(known)}")
        return str(value)

    def place(self) -> tuple[float, float, float]:
        """Returns x, y and yaw."""
        x, y = (self.number(key, MAX_COORDINATE) for key in ("x", "y"))
        return x, y, self.number("yaw", 100.0)


def _is_pair(item: Any) -> bool:
    return isinstance(item, list) and len(item) == 2 and all(isinstance(t, str) and 0 < len(t) <= MAX_TEXT for t in item)


def _goal(kind: Literal["goal", "initial_pose"], fields: _Fields) -> Goal:
    x, y, yaw = fields.place()
    return Goal(kind, x, y, yaw, fields.robot())


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
    "spawn": lambda f: Spawn(f.text("uri"), *f.place()),
    "move": lambda f: Move(f.text("name"), *f.place()),
    "delete": lambda f: Delete(f.text("name")),
    "plot": lambda f: Plot(f.curves()),
    "fields": lambda f: Fields(f.text("topic")),
    "open": lambda f: Open(f.text("joint"), f.number("opening", 1.0, 0.0)),
    "record": _record,
    "task": _task,
}
