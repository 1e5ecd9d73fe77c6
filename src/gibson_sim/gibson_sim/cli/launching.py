"""What ``sim.launch.py`` offers and gives its nodes, without the launch package: arguments and parameters from the nodes' settings.

Every setting of a node is an argument. Only the arguments that somebody gives reach a node, and they win over ``params_file``; all others
are as that file says, else as by default.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import Field, dataclass, field, fields
from pathlib import Path
from typing import Any

from gibson_sim.cli.commands.params import allowed
from gibson_sim.cli.names import check_names
from gibson_sim.config import PhysicsConfig, RenderConfig
from gibson_sim.errors import ConfigError, TextError
from gibson_sim.quoting import quoted
from gibson_sim.reach import REACHES
from gibson_sim.reading import read_yaml_file
from gibson_sim.settings import Value, nearest

CONFIGS: dict[str, type[Any]] = {"physics": PhysicsConfig, "render": RenderConfig}
"""The nodes that the launch file starts, with their settings."""
_SECTION = "ros__parameters"
_SPOKEN = {"true": True, "1": True, "yes": True, "on": True, "false": False, "0": False, "no": False, "off": False}
_RCLPY = ("use_sim_time", "start_type_description_service")
"""Parameters that every node of rclpy has."""


@dataclass(frozen=True)
class Argument:
    """An argument of the launch file."""

    name: str
    default: str
    """As text, as somebody would give it."""
    description: str
    """What it is, and what it may be."""
    choices: tuple[str, ...] = ()
    """All that it may be, to the letter; empty = more than could be listed."""


@dataclass(frozen=True)
class _Setting:
    """A setting that an argument stands for."""

    node: str
    field: Field[Any]


def _settings() -> dict[str, _Setting]:
    """Returns what the arguments stand for, by name; a name that several nodes have gets theirs before it."""
    names = [f.name for cls in CONFIGS.values() for f in fields(cls)]
    return {
        f.name if names.count(f.name) == 1 else f"{node}_{f.name}": _Setting(node, f)
        for node, cls in CONFIGS.items()
        for f in fields(cls)
    }


_SETTINGS = _settings()
_OWN = (
    Argument(
        "params_file",
        "",
        "YAML file with parameters of the nodes, in sections `physics`, `render` or `/**`; arguments win over it",
    ),
    Argument(
        "namespace",
        "",
        "Namespace of both nodes, which stands before all topics and services but /clock, /tf, /tf_static and /diagnostics",
    ),
    Argument("render", "true", "Start the render node too; false = physics alone, no images. Allowed: true, false"),
    Argument(
        "use_sim_time",
        "false",
        "Stamp what the render node logs with simulation time. Images have it anyway, and physics makes it. Allowed: true, false",
    ),
    Argument(
        "reach",
        "",
        "With whom both nodes talk: local = processes of this machine alone, subnet = whoever is on this network; empty = local, "
        "unless variables of ROS or Fast DDS in the environment say with whom",
        ("", *REACHES),
    ),
)
"""Arguments that are no settings."""


def arguments() -> tuple[Argument, ...]:
    """Returns all arguments of the launch file in the order in which it lists them."""
    return (*_OWN, *(_argument(name, setting) for name, setting in _SETTINGS.items()))


def _argument(name: str, setting: _Setting) -> Argument:
    f = setting.field
    choices = f.metadata["choices"]  # launch says itself what these are
    limits = "" if choices else "true, false" if isinstance(f.default, bool) else allowed(f)
    sentence = f"{f.metadata['doc']}. Allowed: {limits}" if limits else f.metadata["doc"]
    return Argument(name, _text(f.default), f"{sentence} ({setting.node} node)", choices)


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


@dataclass(frozen=True)
class NodeStart:
    """How a node is started."""

    node: str
    """Its name, and with ``_node`` behind it that of its program."""
    parameters: dict[str, Value] = field(default_factory=dict)
    """Those that somebody gave, and what follows from them."""


@dataclass(frozen=True)
class Plan:
    """What the launch file starts."""

    namespace: str
    params_file: Path | None
    """Absolute."""
    nodes: tuple[NodeStart, ...]
    reach: str | None = None
    """With whom the nodes talk; None = as the environment says."""
    sections: Any = None
    """What the file holds."""

    def overriding(self, start: NodeStart) -> str:
        """Returns the text of a parameter file that wins over ``params_file`` when it is read after that.

        ROS takes the sections of all files in the order in which each was first named, so ``/**`` of a later file does not win over
        ``physics`` of an earlier one: every section of that file is repeated.
        """
        values = {_SECTION: start.parameters}
        return json.dumps({**_with_values(self.sections or {}, values), "/**": values}, indent=1) + "\n"


def plan(given: Mapping[str, str]) -> Plan:
    """Returns what the launch file starts.

    Args:
        given: the arguments that somebody gave, as text; of others only ``ros_namespace`` counts, in which launch files start nodes.

    Raises:
        GibsonSimError: a value is not allowed or names what is not there, in an argument or in ``params_file``.
    """
    values: dict[str, dict[str, Value]] = {node: {} for node in CONFIGS}
    for name, setting in _SETTINGS.items():
        if name in given:
            values[setting.node][setting.field.name] = _value(name, given[name], type(setting.field.default))
    namespace = given.get("namespace", "").strip("/")
    within = [part for part in f"{given.get('ros_namespace', '')}/{namespace}".split("/") if part]
    file = Path(given["params_file"]).expanduser().absolute() if given.get("params_file") else None
    sections = _read(file) if file else {}
    starts = []
    with_render = _value("render", given.get("render", "true"), bool)
    for node, cls in CONFIGS.items():
        if node == "render" and not with_render:
            continue
        read = _of_node(file, sections, [*within, node])
        if node == "physics" and with_render and values[node].get("lockstep"):
            # Without a name the first ticks would be over before the renderer has joined.
            values[node].setdefault("participants", read.get("participants", "/".join([*within, "render"])))
        try:
            config = cls(**{**read, **values[node]})
        except ConfigError as error:
            raise ConfigError(f"{file}: {error}" if _at_fault(cls, read) else str(error)) from error
        check_names(config)
        parameters = {name: getattr(config, name) for name in values[node]}
        if node == "render" and "use_sim_time" in given:
            parameters["use_sim_time"] = _value("use_sim_time", given["use_sim_time"], bool)
        starts.append(NodeStart(node, parameters))
    return Plan(namespace, file, tuple(starts), given.get("reach") or None, sections)


def misspelt(names: list[str]) -> list[str]:
    """Returns a warning for each of ``names`` that is much like an argument and is none: launch passes over such silently."""
    known = [argument.name for argument in arguments()]
    hints = ((name, nearest(name, known)) for name in names if name not in known)
    return [f"argument {quoted(name)} is unknown and changes nothing; {hint}" for name, hint in hints if hint]


def _value(name: str, text: str, kind: type[Any]) -> Value:
    """Returns the value of an argument that was given as text."""
    if kind is str:
        return text
    if kind is bool:
        if text.lower() not in _SPOKEN:
            raise ConfigError(f"argument {quoted(name)} is {quoted(text)}, must be true or false")
        return _SPOKEN[text.lower()]
    if name == "rate" and text == "max":
        return 0.0
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if math.isnan(number) or (kind is int and not number.is_integer()):
        words = "a whole number" if kind is int else "a number, or max" if name == "rate" else "a number"
        raise ConfigError(f"argument {quoted(name)} is {quoted(text)}, must be {words}")
    return int(number) if kind is int else number


def _read(file: Path) -> dict[str, Any]:
    """Returns what a parameter file holds: sections, maybe within namespaces."""
    try:
        tree = read_yaml_file(file)
    except TextError as error:
        raise ConfigError(f"params_file {file}: {error}") from error
    except OSError as error:
        raise ConfigError(f"params_file {file}: cannot be read: {error.strerror}") from error
    if not isinstance(tree, Mapping) or not list(_sections(tree)):
        raise ConfigError(f"params_file {file}: has no parameters; it must be like `/**: {{{_SECTION}: {{seed: 1}}}}`")
    return dict(tree)


def _sections(tree: Mapping[Any, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the name of each section, with its namespaces, and what it holds."""
    for key, value in tree.items():
        if key == _SECTION:
            yield before, value
        elif isinstance(value, Mapping):
            yield from _sections(value, f"{before}/{str(key).strip('/')}")


def _with_values(tree: Mapping[Any, Any], values: dict[str, Any]) -> dict[str, Any]:
    """Returns the same sections with other values in them."""
    return {
        str(key): values if _SECTION in value else _with_values(value, values)
        for key, value in tree.items()
        if isinstance(value, Mapping)
    }


def _of_node(file: Path | None, tree: Mapping[Any, Any], name: list[str]) -> dict[str, Value]:
    """Returns the settings that a file has for a node; its name has its namespaces before it."""
    node = name[-1]
    known = [f.name for f in fields(CONFIGS[node])]
    found: dict[str, Value] = {}
    for section, values in _sections(tree):
        if not _matches(section.strip("/").split("/"), name):
            continue
        if not isinstance(values, Mapping):
            raise ConfigError(f"params_file {file}: {section.strip('/')}: {_SECTION} must be a list of 'name: value' lines")
        for key, value in values.items():
            if key in known:
                found[key] = value
            elif node in section and key not in _RCLPY and not str(key).startswith("qos_overrides"):
                hint = nearest(str(key), known)
                raise ConfigError(
                    f"params_file {file}: {section.strip('/')} has no parameter {quoted(str(key))}{f'; {hint}' if hint else ''}"
                )
    return found


def _matches(pattern: list[str], name: list[str]) -> bool:
    """Returns whether the name of a section means a node: ``*`` is one part of its name, ``**`` any number of them."""
    if not pattern or not name:
        return not name and all(part == "**" for part in pattern)
    if pattern[0] == "**":
        return _matches(pattern[1:], name) or _matches(pattern, name[1:])
    return pattern[0] in ("*", name[0]) and _matches(pattern[1:], name[1:])


def _at_fault(cls: Callable[..., Any], read: Mapping[str, Value]) -> bool:
    """Returns whether a file's settings are impossible by themselves."""
    try:
        cls(**read)
    except ConfigError:
        return True
    return False
