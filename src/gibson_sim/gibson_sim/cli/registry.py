"""Modules of the sub-commands of ``gibson-sim``: those of this package, and those that other packages add by entry points.

A package adds a command by an entry point of the group ``gibson_sim.commands``, or a command of ``gibson-sim scene`` by one of the group
``gibson_sim.scene_commands``: the name is the command, the value a module with a function ``add_parser(subparsers)``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import entry_points

COMMANDS = {
    "run": "run", "drive": "clients", "record": "clients", "snapshot": "clients", "web": "clients", "bag": "bag", "compare": "compare",
    "completion": "completion", "demo": "demo", "doctor": "doctor", "env": "env", "export": "export", "gallery": "gallery", "mcp": "mcp",
    "params": "params", "render": "render", "replay": "replay", "scene": "scene", "task": "task", "top": "top", "trial": "trial",
    "topic": "ros_tools", "node": "ros_tools", "service": "ros_tools", "param": "ros_tools", "action": "ros_tools",
    "spawn": "ros_tools", "move": "ros_tools", "delete": "ros_tools", "pause": "ros_tools", "play": "ros_tools", "step": "ros_tools",
    "reset": "ros_tools", "load": "ros_tools", "goal": "ros_tools",
}  # fmt: skip
"""Sub-command -> module of this package."""
SCENE_COMMANDS = {"map": "scene_map"}
"""Sub-command of ``gibson-sim scene`` -> module of this package."""
_COMMAND_GROUP, _SCENE_GROUP = "gibson_sim.commands", "gibson_sim.scene_commands"
_OF_TOOLS = (
    "check",
    "collision",
    "fetch",
    "fuse",
    "generate",
    "import",
    "inspect",
    "objects",
    "robot",
    "scan",
    "texture",
    "view",
)
BROUGHT_BY = {("bench",): "gibson_sim_bench", ("learn",): "gibson_sim_learn"} | {
    ("scene", name): "gibson_sim_tools" for name in _OF_TOOLS
}
"""Command -> optional package that provides it."""


def command_modules() -> dict[str, str]:
    """Returns sub-command -> module, for all installed packages."""
    return _with_added(COMMANDS, _COMMAND_GROUP)


def scene_command_modules() -> dict[str, str]:
    """Returns sub-command of ``gibson-sim scene`` -> module, for all installed packages."""
    return _with_added(SCENE_COMMANDS, _SCENE_GROUP)


def not_installed(words: Sequence[str]) -> str:
    """Returns the error text for a command whose package is not installed; empty for other command lines."""
    for command, package in BROUGHT_BY.items():
        known = scene_command_modules if len(command) == 2 else command_modules
        if tuple(words[: len(command)]) == command and command[-1] not in known():
            return (
                f"`gibson-sim {' '.join(command)}` comes with the package {package}, which is not installed; "
                f"pip install {package}, or src/{package} of Gibson Sim's sources"
            )
    return ""


def _with_added(ours: Mapping[str, str], group: str) -> dict[str, str]:
    added = {point.name: point.value for point in entry_points(group=group)}
    return dict(sorted((added | {name: f"gibson_sim.cli.commands.{module}" for name, module in ours.items()}).items()))
