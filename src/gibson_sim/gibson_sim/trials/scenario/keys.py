"""Declares the keys of a scenario file and their limits, for the loader (``load``) and for editors (``schema``).

Names, defaults and meanings are those of the fields in ``spec``.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import ConfigError
from gibson_sim.field_docs import field_docs
from gibson_sim.settings import nearest
from gibson_sim.standard.lockstep import parse_participants
from gibson_sim.standard.requests import CONTROLS
from gibson_sim.trials.scenario.kinds import (
    Choice,
    CommandLine,
    Flag,
    Kind,
    ListOf,
    Location,
    Number,
    OrNone,
    Point,
    Schema,
    Section,
    SettingsOf,
    Span,
    Text,
    Variables,
    key_text,
)  # fmt: skip
from gibson_sim.trials.scenario.spec import (
    GoalInterface,
    InitialPose,
    Limits,
    Obstacles,
    PersonRule,
    Randomisation,
    RateLimit,
    Reached,
    Ready,
    Recording,
    Region,
    Sampling,
    Scenario,
    SpawnRule,
    StackSpec,
    Status,
    Verdicts,
)  # fmt: skip

MAX_RUNS = 10_000
"""Largest number of runs of a trial, all scenes and robots together."""
ALL = "all"
"""Value that stands for all scenes found by name, and for all doors of a scene."""
SET_BY_TRIAL = (
    "scene", "robot", "start", "robot_tf", "start_paused", "seed", "duration", "randomise", "randomise_seed", "service_prefix", "lockstep",
    "participants", "participant_timeout", "on_timeout", "digests", "wait_for", "summary_path",
)  # fmt: skip
"""Settings of the physics node that a scenario file cannot set under ``physics``: the trial sets them from other keys."""
_DRAFT = "https://json-schema.org/draft/2020-12/schema"
_MAX_COORDINATE = 10_000.0
"""Largest coordinate, metres."""
_DAY_S = 86_400.0
"""Length of a day, seconds."""
_ROS_NAME = r"/?(?!.*__)[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*"
_TOPIC = Text("the name of a topic: letters, digits, _ and /, no digit at the beginning of a part", _ROS_NAME)
_NAME = Text("a name or a file")
_RULE = "a rule of lockstep, such as `cmd_vel after odom` or `cmd_vel every 0.05 from goal_pose`"


def _or_none(text: Text) -> Text:
    return Text(f"{text.allowed}; or empty", text.pattern, text.check, empty=True)


def _ros_name(noun: str) -> Text:
    return Text(f"the name of a {noun}: letters, digits, _ and /, no digit at the beginning of a part", _ROS_NAME, empty=True)


def _regex_problem(text: str) -> str:
    try:
        re.compile(text)
    except (re.error, OverflowError, RecursionError) as error:
        return f"is not a regular expression: {error}"
    return ""


def _rule_problem(text: str) -> str:
    """Returns what is wrong with a lockstep rule, which has no name in a scenario; empty = it is valid."""
    try:
        if len(parse_participants(f"stack={text}")) == 1:
            return ""
    except ConfigError:
        pass
    return f"must be {_RULE}; see docs/lockstep.md"


@dataclass(frozen=True, slots=True)
class _Goal:
    """The goal interface: ``task``, or a mapping with one of ``topic``, ``action`` and ``service``."""

    cls: ClassVar[type] = GoalInterface
    interfaces: ClassVar[Mapping[str, Kind]] = {"topic": _TOPIC, "action": _ros_name("action"), "service": _ros_name("service")}
    types: ClassVar[Mapping[str, Text]] = {
        "action": Text("an action type such as nav2_msgs/action/NavigateToPose", r"[a-z][a-z0-9_]*/action/[A-Z][A-Za-z0-9]*"),
        "service": Text("a service type such as my_msgs/srv/SetGoal", r"[a-z][a-z0-9_]*/srv/[A-Z][A-Za-z0-9]*"),
    }
    field: ClassVar[Text] = Text("the name of a field", r"[a-z][a-z0-9_]*")
    task: ClassVar[str] = "task"

    def read(self, value: Any, at: Location) -> GoalInterface | None:
        if value == self.task:
            return GoalInterface("task", "task/goal")
        if not isinstance(value, Mapping):
            at.refuse(value, self.allowed)
            return None
        given = [interface for interface in self.interfaces if interface in value]
        if len(given) != 1:
            at.note(
                f"has {' and '.join(given) or 'none of topic, action and service'}, must have one of topic, action and service"
            )
            return None
        (interface,) = given
        known = (interface,) if interface == "topic" else (interface, "type", "field")
        for key in value:
            if key not in known:
                hint = nearest(str(key), known)
                at.key(key_text(key)).note(f"is not a key here; {f'{hint} ' if hint else ''}known: {', '.join(known)}")
        name = self.interfaces[interface].read(value[interface], at.key(interface))
        if interface == "topic":
            return GoalInterface("topic", name)
        if "type" not in value:
            at.key("type").note(f"is missing, must be {self.types[interface].allowed}")
            return None
        kind = self.types[interface].read(value["type"], at.key("type"))
        field = self.field.read(value.get("field", GoalInterface().field), at.key("field"))
        return GoalInterface("action" if interface == "action" else "service", name, kind, field)

    def schema(self) -> Schema:
        docs = field_docs(GoalInterface)
        forms: list[Schema] = [{"const": self.task, "description": "As for tasks, on task/goal."}]
        for interface, kind in self.interfaces.items():
            properties: Schema = {interface: {"description": f"Name of the {interface}.", **kind.schema()}}
            if interface in self.types:
                properties["type"] = {"description": f"Type of the {interface}.", **self.types[interface].schema()}
                properties["field"] = {"description": docs["field"], **self.field.schema(), "default": GoalInterface().field}
            required = [key for key in properties if key != "field"]
            forms.append({"type": "object", "properties": properties, "required": required, "additionalProperties": False})
        return {"anyOf": forms}

    @property
    def allowed(self) -> str:
        return f"{self.task}, {{topic: ..}}, {{action: .., type: ..}} or {{service: .., type: ..}}"


_REGEX = Text("a regular expression", check=_regex_problem)
_REGIONS = OrNone(
    ListOf(
        Section(Region, {"name": Text("a name"), "corners": ListOf(Point(_MAX_COORDINATE), 1000, 3, allow_single=False)}), 100, 0
    ),
    (),
)
_POSES = ListOf(Text("sampled, the name of a pose, or 'x,y,yaw_deg' in quotes"), 1000)
_ANGLE = Number(0.0, 180.0)

_STACK = Section(StackSpec, {
    "command": CommandLine(1000, shlex.split),
    "environment": Variables(("ROS_DOMAIN_ID",)),
    "folder": Text("a folder"),
    "restart": Choice(("each", "never")),
    "ready": Section(Ready, {
        "topic": _or_none(_TOPIC),
        "service": _ros_name("service"),
        "node": _ros_name("node"),
        "within": Number(0.1, 3600.0),
    }),
    "initial_pose": OrNone(Section(InitialPose, {
        "topic": _or_none(_TOPIC),
        "sigma_xy": Number(0.0, 100.0),
        "sigma_yaw_deg": _ANGLE,
        "error_xy": Number(0.0, 100.0),
        "error_yaw_deg": _ANGLE,
    }), InitialPose(topic="")),
    "goal": _Goal(),
    "status": Section(Status, {"topic": _or_none(_TOPIC), "reached": _REGEX, "failed": _REGEX}),
    "lockstep": ListOf(Text(_RULE, r"[A-Za-z0-9_./-]+\s+(after|every)\s+\S.*", _rule_problem), 20, 0),
    "allowed_calls": ListOf(Choice(CONTROLS), len(CONTROLS), 0),
})  # fmt: skip

_OBSTACLES = Section(Obstacles, {
    "spawn": ListOf(Section(SpawnRule, {
        "object": _NAME,
        "count": Number(1, 100, whole=True),
        "at": Text("path, sampled, the name of a pose, or 'x,y,yaw_deg' in quotes"),
    }, short="object"), 50, 0),
    "closed_doors": ListOf(Text("the name of a body with a door, or all"), 200, 0),
    "people": ListOf(Section(PersonRule, {
        "path": ListOf(Point(_MAX_COORDINATE), 200, 2, allow_single=False),
        "speed": Number(0.01, 10.0),
        "radius": Number(0.05, 2.0),
        "height": Number(0.2, 3.0),
    }), 50, 0),
})  # fmt: skip

_RANDOMISATION = Section(Randomisation, {
    "looks": Text("a file of rules, or a name under config/randomisation; or empty", empty=True),
    "slip": OrNone(Span(-0.5, 0.9)),
    "noise": OrNone(Span(0.0, 100.0)),
    "latency": OrNone(Span(0.0, 10.0)),
    "friction": OrNone(Span(0.0, 10.0)),
    "payload": OrNone(Span(0.0, 1000.0)),
})  # fmt: skip

_VERDICTS = Section(Verdicts, {
    "reached": OrNone(Section(Reached, {"within": Number(0.001, 1000.0), "yaw_within_deg": OrNone(_ANGLE)}, short="within")),
    "collisions": OrNone(Number(0, 1_000_000, whole=True)),
    "clearance": OrNone(Number(0.0, 100.0)),
    "stay_within": _REGIONS,
    "stay_out_of": _REGIONS,
    "path_ratio": OrNone(Number(1.0, 1000.0)),
    "time": OrNone(Number(0.1, _DAY_S)),
    "max_acceleration": OrNone(Number(0.001, 1000.0)),
    "rates": OrNone(ListOf(Section(RateLimit, {"topic": _TOPIC, "least": Number(0.001, 100_000.0)}), 100, 0), ()),
    "alive": OrNone(Flag(), False),
    "predicates": OrNone(ListOf(Text("module:function", r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*"), 100, 0), ()),
})  # fmt: skip

SCENARIO = Section(Scenario, {
    "scenes": ListOf(Text("the name of a scene, a file, or all"), 1000),
    "stack": _STACK,
    "robots": ListOf(Text("the name of a robot, or a file"), 100),
    "runs": Number(1, MAX_RUNS, whole=True),
    "seed": Number(0, 2**53, whole=True),
    "starts": _POSES,
    "goals": _POSES,
    "sampling": Section(Sampling, {"path_length": Span(0.1, _MAX_COORDINATE), "clearance": Number(0.0, 10.0)}),
    "obstacles": _OBSTACLES,
    "randomise": _RANDOMISATION,
    "physics": SettingsOf(PhysicsConfig, SET_BY_TRIAL),
    "limits": Section(Limits, {
        "time": Number(0.1, _DAY_S),
        "wall_time": Number(1.0, 7 * _DAY_S),
        "silence": Number(0.1, 3600.0),
    }),
    "verdicts": _VERDICTS,
    "record": Section(Recording, {"images": Choice(("none", "compressed", "raw")), "keep": Choice(("failed", "all"))}),
})  # fmt: skip
"""The whole file."""


def schema() -> dict[str, Any]:
    """Returns the JSON schema of scenario files, for editors that complete and check YAML."""
    return {
        "$schema": _DRAFT,
        "title": "Scenario file of gibson-sim trial",
        "description": "See docs/trial_file.md.",
        **SCENARIO.schema(),
    }


def schema_text() -> str:
    """Returns the schema as the text of a file: that of ``config/trial.schema.json``."""
    return json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"
