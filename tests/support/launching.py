"""Stand-ins for the packages launch and launch_ros, which pip does not have: they note what a launch file says, and start nothing."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest


@dataclass(eq=False)
class Said:
    """An action, an event or a handler: its kind and what it was made with."""

    kind: str
    given: tuple[Any, ...]
    options: dict[str, Any]


@dataclass
class Context:
    """What launch hands to functions: the arguments on the command line, and all that have a value."""

    argv: list[str] = field(default_factory=list)
    launch_configurations: dict[str, str] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)
    is_shutdown: bool = False


@dataclass(frozen=True)
class Exit:
    """A process ended."""

    action: Said
    returncode: int


class LaunchFile:
    """A launch file that has been loaded."""

    def __init__(self, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.warnings: list[str] = []
        for name, kinds in _KINDS.items():
            module = ModuleType(name)
            for kind in kinds:
                setattr(module, kind, _maker(kind))
            monkeypatch.setitem(sys.modules, name, module)
        logger = type("Logger", (), {"warning": lambda _, text: self.warnings.append(text)})()
        setattr(sys.modules["launch"], "logging", type("logging", (), {"get_logger": staticmethod(lambda _: logger)}))  # noqa: B010
        spec = importlib.util.spec_from_file_location("launch_file", path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        self.actions: Sequence[Said] = module.generate_launch_description().given[0]

    def of_kind(self, kind: str) -> list[Said]:
        """Returns the actions of a kind."""
        return [action for action in self.actions if action.kind == kind]

    def start(self, *argv: str) -> list[Said]:
        """Returns what the first function of the file starts where these arguments were given, as name:=value."""
        given = dict(text.split(":=", 1) for text in argv)
        assert self.actions[0].kind == "OpaqueFunction", "later, arguments that nobody gave have their default value"
        function: Callable[[Context], list[Said]] = self.actions[0].options["function"]
        return function(Context(list(argv), given))


def _maker(kind: str) -> Callable[..., Said]:
    return lambda *given, **options: Said(kind, given, options)


_KINDS = {
    "launch": ("LaunchDescription",),
    "launch.actions": (
        "DeclareLaunchArgument",
        "EmitEvent",
        "IncludeLaunchDescription",
        "LogInfo",
        "OpaqueFunction",
        "RegisterEventHandler",
    ),
    "launch.conditions": ("IfCondition",),
    "launch.event_handlers": ("OnProcessExit",),
    "launch.events": ("Shutdown",),
    "launch.launch_description_sources": ("PythonLaunchDescriptionSource",),
    "launch.substitutions": ("EqualsSubstitution", "LaunchConfiguration", "NotEqualsSubstitution"),
    "launch_ros": (),
    "launch_ros.actions": ("Node", "SetRemap"),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
}
