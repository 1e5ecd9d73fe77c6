"""Arguments of ``sim.launch.py`` and parameters of its nodes, derived from the settings of the nodes. Independent of the launch package.

Every setting of a node is an argument. Only given arguments are passed to a node, and they override ``params_file``; the other settings
are read from that file, else they have their defaults.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import Field, dataclass, field
from pathlib import Path
from typing import Any

from gibson_sim.cli.commands.params import allowed
from gibson_sim.cli.names import check_names
from gibson_sim.client_config import FoxgloveConfig, WebConfig
from gibson_sim.config import PhysicsConfig, RenderConfig
from gibson_sim.errors import ConfigError, TextError
from gibson_sim.quoting import quoted
from gibson_sim.reach import REACHES
from gibson_sim.reading import read_yaml_file
from gibson_sim.resources import find_config
from gibson_sim.settings import Settings, Value, make_settings, nearest, setting_fields, setting_values

CONFIGS: dict[str, type[Any]] = {"physics": PhysicsConfig, "render": RenderConfig}
"""Node that the launch file starts -> settings class."""
VIEWERS: dict[str, type[Any]] = {"web": WebConfig, "foxglove": FoxgloveConfig}
"""Node that it starts if the argument of that name is true -> settings class; the arguments are ``<node>_<setting>``."""
PAGE_VIEWS = "follow,top"
"""Default views of a simulation with a page; they are rendered only while a page shows them."""
RVIZ, RVIZ_FILE = "rviz", "sim.rviz"
_SECTION = "ros__parameters"
_BOOLEANS = {"true": True, "1": True, "yes": True, "on": True, "false": False, "0": False, "no": False, "off": False}
_RCLPY = ("use_sim_time", "start_type_description_service")
"""Parameters of every rclpy node."""


@dataclass(frozen=True)
class Argument:
    """An argument of the launch file."""

    name: str
    default: str
    """Default value, as text."""
    description: str
    """Description and allowed values."""
    choices: tuple[str, ...] = ()
    """All allowed values; empty = too many to list."""


@dataclass(frozen=True)
class _Setting:
    """The setting of an argument."""

    node: str
    field: Field[Any]


def _settings() -> dict[str, _Setting]:
    """Returns argument name -> setting; names that several nodes have are prefixed with the name of the node."""
    names = [f.name for cls in CONFIGS.values() for f in setting_fields(cls)]
    return {
        f.name if names.count(f.name) == 1 else f"{node}_{f.name}": _Setting(node, f)
        for node, cls in CONFIGS.items()
        for f in setting_fields(cls)
    } | {f"{node}_{f.name}": _Setting(node, f) for node, cls in VIEWERS.items() for f in setting_fields(cls)}


_SETTINGS = _settings()
_OWN = (
    Argument(
        "params_file",
        "",
        "YAML file with parameters of the nodes, in sections `physics`, `render` or `/**`; arguments override it",
    ),
    Argument(
        "namespace",
        "",
        "Namespace of all nodes, prefixed to all topics and services except /clock, /tf, /tf_static and /diagnostics",
    ),
    Argument("render", "true", "Start the render node too; false = physics only, without images. Allowed: true, false"),
    Argument(
        "use_sim_time",
        "false",
        "Stamp the log of the render node with simulation time. Images always have it, and the physics node sets it. Allowed: true, false",
    ),
    Argument(
        "reach",
        "",
        "Who can reach the nodes: local = processes of this machine only, subnet = all machines of the network; empty = local, "
        "unless variables of ROS or Fast DDS in the environment decide",
        ("", *REACHES),
    ),
    Argument("web", "false", "Serve a page for any browser; its address is printed. Allowed: true, false"),
    Argument(
        "foxglove", "false", "Serve the Foxglove WebSocket protocol (needs `pip install foxglove-sdk`). Allowed: true, false"
    ),
    Argument(RVIZ, "false", "Start RViz, which must be installed (ros-jazzy-rviz2). Allowed: true, false"),
    Argument("rviz_config", "", "File of RViz; empty = config/sim.rviz of this package"),
    Argument(
        "rviz_frame",
        "",
        "Fixed frame of RViz; empty = map if `publish_map_tf` is true, else odom: use map with AMCL, SLAM or another localiser",
    ),
)
"""Arguments that are not settings."""


def arguments() -> tuple[Argument, ...]:
    """Returns all arguments of the launch file in the order in which it lists them."""
    return (*_OWN, *(_argument(name, setting) for name, setting in _SETTINGS.items()))


def _argument(name: str, setting: _Setting) -> Argument:
    f = setting.field
    choices = f.metadata["choices"]  # launch lists them itself
    limits = "" if choices else "true, false" if isinstance(f.default, bool) else allowed(f)
    sentence = f"{f.metadata['doc']}. Allowed: {limits}" if limits else f.metadata["doc"]
    return Argument(name, _text(f.default), f"{sentence} ({setting.node} node)", choices)


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


@dataclass(frozen=True)
class NodeStart:
    """A node to start."""

    node: str
    """Name of the node; the program is ``<node>_node``."""
    parameters: dict[str, Value] = field(default_factory=dict)
    """Given and derived parameters."""


@dataclass(frozen=True)
class LaunchPlan:
    """The nodes that the launch file starts."""

    namespace: str
    params_file: Path | None
    """Absolute path of the parameter file; None = none."""
    nodes: tuple[NodeStart, ...]
    reach: str | None = None
    """Reach of the nodes; None = that of the environment."""
    sections: Any = None
    """Content of the parameter file."""
    rviz: tuple[str, ...] | None = None
    """Arguments of rviz2; None = not started."""

    def overriding(self, start: NodeStart) -> str:
        """Returns the text of a parameter file that overrides ``params_file`` when it is loaded after it.

        ROS applies the sections of all files in the order of their first appearance, so ``/**`` of a later file does not override ``physics``
        of an earlier one; therefore every section of that file is repeated.
        """
        values = {_SECTION: start.parameters}
        return json.dumps({**_with_values(self.sections or {}, values), "/**": values}, indent=1) + "\n"


def plan(given: Mapping[str, str]) -> LaunchPlan:
    """Returns the nodes that the launch file starts.

    Args:
        given: given arguments as text; unknown ones are ignored, except ``ros_namespace``, the namespace in which launch files start nodes.

    Raises:
        GibsonSimError: a value in an argument or in ``params_file`` is not allowed, or refers to an object that does not exist.
    """
    values: dict[str, dict[str, Value]] = {node: {} for node in (*CONFIGS, *VIEWERS)}
    for name, setting in _SETTINGS.items():
        if name in given:
            values[setting.node][setting.field.name] = _value(name, given[name], type(setting.field.default))
    namespace = given.get("namespace", "").strip("/")
    within = [part for part in f"{given.get('ros_namespace', '')}/{namespace}".split("/") if part]
    file = Path(os.path.expanduser(given["params_file"])).absolute() if given.get("params_file") else None
    sections = _read(file) if file else {}
    starts = []
    enabled = {name: _value(name, given.get(name, "false"), bool) for name in (*VIEWERS, RVIZ)}
    with_render = enabled["render"] = bool(_value("render", given.get("render", "true"), bool))
    settings: dict[str, dict[str, Value]] = {}
    for node, cls in {**CONFIGS, **VIEWERS}.items():
        if not enabled.get(node, True):
            continue
        read = _node_settings(file, sections, [*within, node])
        if node == "physics" and with_render and values[node].get("lockstep"):
            # Name the renderer, so that time waits until it has joined.
            values[node].setdefault("participants", read.get("participants", "/".join([*within, "render"])))
        if node == "physics" and enabled["web"] and with_render and "views" not in read:
            values[node].setdefault("views", PAGE_VIEWS)
        settings[node] = {**read, **values[node]}
        try:
            config = make_settings(cls, settings[node])
        except ConfigError as error:
            raise ConfigError(f"{file}: {error}" if _is_invalid(cls, read) else str(error)) from error
        check_names(config)
        checked = setting_values(config)
        parameters = {name: checked[name] for name in values[node]}
        if node == "render" and "use_sim_time" in given:
            parameters["use_sim_time"] = _value("use_sim_time", given["use_sim_time"], bool)
        starts.append(NodeStart(node, parameters))
    rviz = None
    if enabled[RVIZ]:
        file_of_rviz = find_config(given.get("rviz_config") or RVIZ_FILE)
        frame = given.get("rviz_frame") or ("map" if settings["physics"].get("publish_map_tf") else "odom")
        rviz = ("-d", str(file_of_rviz), "-f", frame)
    return LaunchPlan(namespace, file, tuple(starts), given.get("reach") or None, sections, rviz)


def misspelt(names: list[str]) -> list[str]:
    """Returns a warning for each of ``names`` that is similar to an argument but unknown, which launch ignores silently."""
    known = [argument.name for argument in arguments()]
    hints = ((name, nearest(name, known)) for name in names if name not in known)
    return [f"argument {quoted(name)} is unknown and changes nothing; {hint}" for name, hint in hints if hint]


def _value(name: str, text: str, kind: type[Any]) -> Value:
    """Converts the text of an argument."""
    if kind is str:
        return text
    if kind is bool:
        if text.lower() not in _BOOLEANS:
            raise ConfigError(f"argument {quoted(name)} is {quoted(text)}, must be true or false")
        return _BOOLEANS[text.lower()]
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
    """Returns the content of a parameter file: sections, possibly nested in namespaces."""
    try:
        tree = read_yaml_file(file)
    except TextError as error:
        raise ConfigError(f"params_file {file}: {error}") from error
    except OSError as error:
        raise ConfigError(f"params_file {file}: cannot be read: {error.strerror}") from error
    if not isinstance(tree, Mapping) or not list(_sections(tree)):
        raise ConfigError(f"params_file {file}: has no parameters; it must be like `/**: {{{_SECTION}: {{seed: 1}}}}`")
    return dict(tree)


def _sections(tree: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yields (name including namespaces, content) of each section."""
    for key, value in tree.items():
        if key == _SECTION:
            yield prefix, value
        elif isinstance(value, Mapping):
            yield from _sections(value, f"{prefix}/{str(key).strip('/')}")


def _with_values(tree: Mapping[Any, Any], values: dict[str, Any]) -> dict[str, Any]:
    """Returns the sections with other values."""
    return {
        str(key): values if _SECTION in value else _with_values(value, values)
        for key, value in tree.items()
        if isinstance(value, Mapping)
    }


def _node_settings(file: Path | None, tree: Mapping[Any, Any], name: list[str]) -> dict[str, Value]:
    """Returns the settings of a node in a file; ``name``: namespaces and name of the node."""
    node = name[-1]
    known = [f.name for f in setting_fields({**CONFIGS, **VIEWERS}[node])]
    settings: dict[str, Value] = {}
    for section, values in _sections(tree):
        if not _matches(section.strip("/").split("/"), name):
            continue
        if not isinstance(values, Mapping):
            raise ConfigError(f"params_file {file}: {section.strip('/')}: {_SECTION} must be a list of 'name: value' lines")
        for key, value in values.items():
            if key in known:
                settings[key] = value
            elif node in section and key not in _RCLPY and not str(key).startswith("qos_overrides"):
                hint = nearest(str(key), known)
                raise ConfigError(
                    f"params_file {file}: {section.strip('/')} has no parameter {quoted(str(key))}{f'; {hint}' if hint else ''}"
                )
    return settings


def _matches(pattern: list[str], name: list[str]) -> bool:
    """Returns whether the name of a section matches a node: ``*`` matches one part of its name, ``**`` any number of parts."""
    if not pattern or not name:
        return not name and all(part == "**" for part in pattern)
    if pattern[0] == "**":
        return _matches(pattern[1:], name) or _matches(pattern, name[1:])
    return pattern[0] in ("*", name[0]) and _matches(pattern[1:], name[1:])


def _is_invalid(cls: type[Settings], read: Mapping[str, Value]) -> bool:
    """Returns whether the settings of a file are invalid without the arguments."""
    try:
        make_settings(cls, read)
    except ConfigError:
        return True
    return False
