"""The launch file, read without the launch package: what it names must exist."""

from __future__ import annotations

import ast
import re
from dataclasses import fields
from pathlib import Path

from gibson_sim.config import PhysicsConfig


def _launch_file(root: Path) -> str:
    return (root / "src" / "gibson_sim" / "launch" / "sim.launch.py").read_text()


def test_arguments_are_settings_of_the_physics_node_with_their_types_and_defaults(root: Path) -> None:
    tree = ast.parse(_launch_file(root))
    values = {
        t.id: node.value for node in tree.body if isinstance(node, ast.Assign) for t in node.targets if isinstance(t, ast.Name)
    }
    arguments = values["ARGUMENTS"]
    assert isinstance(arguments, ast.Tuple)
    settings = {f.name: f.default for f in fields(PhysicsConfig)}
    for argument in arguments.elts:
        assert isinstance(argument, ast.Tuple)
        name, default, kind, text = argument.elts
        assert isinstance(kind, ast.Name)
        setting = settings[ast.literal_eval(name)]
        assert type(setting).__name__ == kind.id
        assert str(setting).lower() == ast.literal_eval(default)
        assert ast.literal_eval(text)


def test_executables_and_files_that_it_names_exist(root: Path) -> None:
    text = _launch_file(root)
    setup = (root / "src" / "gibson_sim" / "setup.py").read_text()
    for executable in re.findall(r'executable="(\w+)"', text):
        assert f"{executable} = gibson_sim.ros.{executable}:main" in setup
    for name in re.findall(r'os\.path\.join\(config, "([^"]+)"\)', text):
        assert (root / "config" / name).is_file(), name
