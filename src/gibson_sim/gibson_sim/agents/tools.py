"""The tools of an agent: a dataclass each, whose docstring describes the tool and whose fields are its arguments. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import Field, dataclass, fields
from typing import Any, ClassVar

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.settings import MAX_TEXT, Arguments, nearest, read_arguments, setting
from gibson_sim.web.requests import MAX_COORDINATE, MAX_SEED, MAX_SPEED, MAX_TURN

MAX_SECONDS = 30.0
"""Longest time that one call simulates, s of simulation time: many agents give up on a call after a minute."""
MAX_WAIT_S = 50.0
"""Longest time that one call waits for a trial, s of wall time."""
_ROBOT = "Name of the robot; empty = the first one"
_TYPES: dict[type, str] = {bool: "boolean", int: "integer", float: "number", str: "string"}


@dataclass(frozen=True)
class Tool(Arguments):
    """Base of the tools."""

    changes: ClassVar[bool] = True
    """Whether the tool changes the simulation or writes files; taking a picture does not, although it may take a few ticks of time."""


def _x() -> Any:
    return setting(0.0, "Position in the map frame, x", unit="m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE)


def _y() -> Any:
    return setting(0.0, "Position in the map frame, y", unit="m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE)


def _yaw() -> Any:
    return setting(0.0, "Heading in the map frame, counter-clockwise, 0 = along x", unit="rad", minimum=-100.0, maximum=100.0)


@dataclass(frozen=True)
class StartSimulation(Tool):
    """Starts a simulation of a scene with robots in a ROS domain of its own; one runs at a time."""

    scene: str = setting("flat", "Scene: a name that list_names lists, or a scene file in a named folder")
    robot: str = setting(
        "gibson_bot",
        "Robot: a name that list_names lists, or a robot file in a named folder; several as left=gibson_bot,right=gibson_bot",
    )
    start: str = setting("", "Start pose x,y,yaw in m and degrees, or the name of a pose of the scene; empty = the scene's own")
    seed: int = setting(0, "Seed of all random values", minimum=0, maximum=MAX_SEED)
    time: str = setting(
        "stepped",
        "stepped = time passes only within calls, as fast as possible, and equal calls give equal results; real = time passes as on a clock, "
        "for a ROS stack that runs beside",
        choices=("stepped", "real"),
    )
    cameras: bool = setting(True, "Whether there are cameras; without them a simulation starts sooner")


@dataclass(frozen=True)
class StopSimulation(Tool):
    """Stops the simulation and a recording of it."""


@dataclass(frozen=True)
class GetState(Tool):
    """Returns the simulation time, the true poses of the robots, their collisions, and whether a recording or a trial runs."""

    changes = False


@dataclass(frozen=True)
class ListNames(Tool):
    """Lists names that other tools take."""

    required = ("kind",)
    changes = False
    kind: str = setting(
        "scenes",
        "What to list; cameras, topics, doors and places are those of the running simulation",
        choices=("scenes", "robots", "objects", "trials", "cameras", "topics", "doors", "places"),
    )


@dataclass(frozen=True)
class GetEntities(Tool):
    """Returns the poses of robots and bodies, nearest to the first robot first."""

    changes = False
    contains: str = setting("", "Text that their names contain; empty = any")
    most: int = setting(50, "Greatest number of entities", minimum=1, maximum=500)


@dataclass(frozen=True)
class GetImage(Tool):
    """Returns the picture of a camera as a PNG, of the present state of the simulation."""

    changes = False
    camera: str = setting(
        "camera", "Camera that list_names lists; view_follow sees the first robot from behind, view_top from above"
    )
    output: str = setting(
        "rgb",
        "rgb = colours; depth = false colours, red is near and blue is far, with the distances as text",
        choices=("rgb", "depth"),
    )
    width: int = setting(640, "Greatest width of the picture", unit="px", minimum=64, maximum=1920)


@dataclass(frozen=True)
class Drive(Tool):
    """Drives a robot with constant velocities for some time, stops it, and returns its pose and collisions."""

    required = ("seconds",)
    linear: float = setting(0.0, "Forward velocity", unit="m/s", minimum=-MAX_SPEED, maximum=MAX_SPEED)
    angular: float = setting(0.0, "Yaw rate, counter-clockwise", unit="rad/s", minimum=-MAX_TURN, maximum=MAX_TURN)
    seconds: float = setting(1.0, "Duration in simulation time", unit="s", minimum=0.01, maximum=MAX_SECONDS)
    lateral: float = setting(
        0.0, "Velocity to the left, for omnidirectional robots", unit="m/s", minimum=-MAX_SPEED, maximum=MAX_SPEED
    )
    robot: str = setting("", _ROBOT)


@dataclass(frozen=True)
class DriveTo(Tool):
    """Drives a robot that can turn in place to a point along the shortest path of the floor map, which has no spawned objects."""

    required = ("x", "y")
    x: float = _x()
    y: float = _y()
    within: float = setting(0.2, "Distance at which the point counts as reached", unit="m", minimum=0.02, maximum=10.0)
    seconds: float = setting(MAX_SECONDS, "Longest duration in simulation time", unit="s", minimum=0.1, maximum=MAX_SECONDS)
    robot: str = setting("", _ROBOT)


@dataclass(frozen=True)
class Step(Tool):
    """Lets time pass; in a paused simulation by whole physics steps, otherwise by whole ticks."""

    required = ("seconds",)
    seconds: float = setting(1.0, "Simulation time", unit="s", minimum=0.001, maximum=MAX_SECONDS)


@dataclass(frozen=True)
class Pause(Tool):
    """Pauses the simulation, or resumes it."""

    paused: bool = setting(True, "true = pause, false = resume")


@dataclass(frozen=True)
class Reset(Tool):
    """Resets time, poses, and spawned and deleted entities to those of the start."""


@dataclass(frozen=True)
class Spawn(Tool):
    """Spawns an object on the floor and returns its name."""

    required = ("model", "x", "y")
    model: str = setting("", "Object or robot that list_names lists, or a URDF, SDF or mesh file in a named folder")
    x: float = _x()
    y: float = _y()
    yaw: float = _yaw()
    name: str = setting("", "Name of the entity; empty = that of the model, with a number if it is taken")


@dataclass(frozen=True)
class Move(Tool):
    """Moves an entity or a robot to a place on the floor, at rest."""

    required = ("name", "x", "y")
    name: str = setting("", "Name of the entity")
    x: float = _x()
    y: float = _y()
    yaw: float = _yaw()


@dataclass(frozen=True)
class Delete(Tool):
    """Removes an entity."""

    required = ("name",)
    name: str = setting("", "Name of the entity")


@dataclass(frozen=True)
class OpenDoor(Tool):
    """Moves a door or drawer to an opening while time passes, and lets go of it."""

    required = ("door",)
    door: str = setting("", "Door that list_names lists, such as front_door/hinge")
    opening: float = setting(1.0, "0 = closed, 1 = fully open", minimum=0.0, maximum=1.0)


@dataclass(frozen=True)
class ReadTopic(Tool):
    """Returns the next message on a ROS topic as YAML, long arrays cut."""

    required = ("topic",)
    changes = False
    topic: str = setting("", "Topic that list_names lists, such as scan or odom")
    seconds: float = setting(5.0, "Longest wait in simulation time", unit="s", minimum=0.01, maximum=MAX_SECONDS)


@dataclass(frozen=True)
class StartRecording(Tool):
    """Records all topics of the simulation into a rosbag2 folder until stop_recording."""

    folder: str = setting("", "New folder in a named folder; empty = recordings/TIME in the first one")
    images: bool = setting(False, "Whether to record images too, compressed")


@dataclass(frozen=True)
class StopRecording(Tool):
    """Ends the recording and returns its folder and size."""


@dataclass(frozen=True)
class RunTrial(Tool):
    """Starts a trial, many judged runs of a robot's stack, in processes of its own, and returns its verdict, or its progress if it takes longer."""

    required = ("file",)
    file: str = setting("", "Trial that list_names lists, or a scenario file (trial.yaml) in a named folder")
    runs: int = setting(0, "Runs in each scene with each robot; 0 = as in the file", minimum=0, maximum=1000)
    folder: str = setting("", "New folder for the results in a named folder; empty = trials/TIME in the first one")
    wait: float = setting(
        MAX_WAIT_S, "Longest wait in wall time; get_trial waits for the rest", unit="s", minimum=0.0, maximum=MAX_WAIT_S
    )


@dataclass(frozen=True)
class GetTrial(Tool):
    """Returns the verdict of the trial, or its progress, and stops it on request."""

    wait: float = setting(0.0, "Longest wait for its end in wall time", unit="s", minimum=0.0, maximum=MAX_WAIT_S)
    stop: bool = setting(False, "Whether to stop the trial")


def _snake(name: str) -> str:
    return "".join(f"_{c.lower()}" if c.isupper() else c for c in name).lstrip("_")


TOOLS: dict[str, type[Tool]] = {
    _snake(cls.__name__): cls
    for cls in (
        StartSimulation, StopSimulation, GetState, ListNames, GetEntities, GetImage, Drive, DriveTo, Step, Pause, Reset, Spawn, Move, Delete,
        OpenDoor, ReadTopic, StartRecording, StopRecording, RunTrial, GetTrial,
    )
}  # fmt: skip
"""Name -> tool."""


def description(tool: type[Tool]) -> str:
    """Returns the sentence that describes a tool."""
    return (tool.__doc__ or "").strip()


def input_schema(tool: type[Tool]) -> dict[str, Any]:
    """Returns the JSON schema of the arguments of a tool; their descriptions name the units."""
    return {
        "type": "object",
        "properties": {f.name: _property(tool, f) for f in fields(tool)},
        "required": list(tool.required),
        "additionalProperties": False,
    }


def _property(tool: type[Tool], f: Field[Any]) -> dict[str, Any]:
    values, kind = f.metadata, type(f.default)
    found: dict[str, Any] = {
        "type": _TYPES[kind],
        "description": f"{values['doc']}{', ' if values['unit'] else ''}{values['unit']}",
    }
    if f.name not in tool.required:
        found["default"] = f.default
    if values["choices"]:
        found["enum"] = list(values["choices"])
    elif kind is str:
        found["maxLength"] = MAX_TEXT
    for key in ("minimum", "maximum"):
        if math.isfinite(values[key]):
            found[key] = values[key]
    return found


def parse_call(name: str, given: Mapping[str, Any]) -> Tool:
    """Returns the tool of a call with its arguments.

    Args:
        name: name of the tool.
        given: arguments as JSON values; null = not given.

    Raises:
        ConfigError: the tool or an argument is unknown, missing or not allowed.
    """
    tool = TOOLS.get(name)
    if tool is None:
        hint = nearest(name, list(TOOLS))
        raise ConfigError(f"tool {quoted(name)} is unknown{f'; {hint}' if hint else ''}; known: {', '.join(TOOLS)}")
    return read_arguments(tool, name, given)
