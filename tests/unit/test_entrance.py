"""The Python API: the names of ``import gibson_sim``, and the packages that it does not load."""

from __future__ import annotations

import inspect
import pydoc
import subprocess
import sys
from pathlib import Path

import pytest

import gibson_sim as gs


@pytest.mark.parametrize("name", gs.__all__)
def test_every_public_name_exists_and_is_documented(name: str) -> None:
    value = getattr(gs, name)
    assert name in dir(gs)
    if inspect.isclass(value) or inspect.isroutine(value):
        assert inspect.getdoc(value), f"{name} has no docstring"
    if inspect.isclass(value):
        members = [
            m
            for m in vars(value)
            if not m.startswith("_") and (callable(getattr(value, m)) or isinstance(vars(value)[m], property))
        ]
        undocumented = [m for m in members if not inspect.getdoc(getattr(value, m))]
        assert undocumented == [], f"{name}: {undocumented}"


def test_names_of_the_types_are_those_that_are_loaded() -> None:
    assert sorted(gs._MODULE_OF_NAME) == sorted(gs.__all__)
    with pytest.raises(AttributeError, match="has no attribute 'Simulaton'; did you mean 'Simulation'"):
        getattr(gs, "Simulaton")  # noqa: B009


def test_help_begins_with_an_overview() -> None:
    text = pydoc.plain(pydoc.render_doc(gs))
    assert text.index("with gs.Simulation(") < text.index("PACKAGE CONTENTS")


def test_a_scene_is_loaded_and_named_without_physics_or_pictures() -> None:
    command = """import sys, gibson_sim as gs
assert 'linden_flat' in gs.list_scenes() and 'gibson_bot' in gs.list_robots()
gs.load_scene('flat'), gs.load_robot('gibson_bot'), gs.Pose(), gs.SceneState.still()
print([m for m in ('pybullet', 'moderngl', 'rclpy', 'torch') if m in sys.modules])
gs.Simulation('flat').close()
print([m for m in ('moderngl', 'rclpy', 'torch') if m in sys.modules])"""
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[]", "[]"]


def test_a_folder_of_the_same_name_in_the_working_directory_is_not_imported(tmp_path: Path) -> None:
    # As in the folder that a clone is in.
    (tmp_path / "gibson_sim").mkdir()
    command = [sys.executable, "-c", "import gibson_sim as gs; print(gs.list_scenes())"]
    found = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "linden_flat" in found.stdout, found.stderr
