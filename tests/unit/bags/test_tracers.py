"""Programs that trace the colours of a re-rendered bag: found by entry points, refused in one line."""

from __future__ import annotations

import importlib.util
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.bags import tracers
from gibson_sim.client_config import RenderBagConfig
from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.scenes.spec import DrawnScene, LightSpec
from gibson_sim.types import CameraSpec, Frame, SceneState
from gibson_sim_tools.tracing.bags import CyclesColors


class _Opened:
    def __init__(self, python: str, samples: int) -> None:
        self.settings = python, samples


def test_a_tracer_is_opened_with_its_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("mine", f"{__name__}:_Opened", tracers.GROUP)
    monkeypatch.setattr(EntryPoint, "load", lambda self: _Opened)
    monkeypatch.setattr(tracers, "entry_points", lambda group: (point,))
    opened = tracers.open_tracer("mine", "", 16)
    assert opened.settings == (sys.executable, 16)  # type: ignore[attr-defined]
    assert tracers.open_tracer("mine", "/blender/python", 16).settings[0] == "/blender/python"  # type: ignore[attr-defined]


def test_an_unknown_tracer_is_refused_with_those_that_are_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracers, "entry_points", lambda group: (EntryPoint("mine", "a:b", group),))
    with pytest.raises(ConfigError, match=r"setting 'tracer' is 'yours', must be a program that is installed: mine"):
        tracers.open_tracer("yours", "", 16)
    monkeypatch.setattr(tracers, "entry_points", lambda group: ())
    with pytest.raises(ConfigError, match="cycles comes with the package gibson_sim_tools"):
        tracers.open_tracer("cycles", "", 16)


def test_the_tools_describe_their_tracer_in_their_metadata() -> None:
    text = (Path(__file__).parents[3] / "src" / "gibson_sim_tools" / "setup.py").read_text()
    assert f'"{tracers.GROUP}": ["cycles = {CyclesColors.__module__}:{CyclesColors.__name__}"]' in text


@pytest.mark.parametrize("changed", [{"lights": "evening.yaml"}, {"randomise": "colours"}])
def test_other_lights_and_traced_colours_exclude_each_other(changed: dict[str, str]) -> None:
    with pytest.raises(ConfigError, match="do not change traced colours"):
        RenderBagConfig(tracer="cycles", **changed)


def test_cycles_needs_a_python_with_blender() -> None:
    with pytest.raises(SceneError, match="/no/such/python: cannot be run"):
        CyclesColors("/no/such/python", 16)


def test_blender_traces_a_scene_that_no_plan_made_with_its_own_light(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("SKIPPED: no Blender in this Python: pip install bpy")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    light = LightSpec(sun=0.0, ambient=0.0, background=(0.2, 0.4, 0.6))
    colors = CyclesColors(sys.executable, 4)
    colors.load(DrawnScene("empty", 1, "", (), (), (), light), SceneState.still(), lambda state, cameras: [])
    frame = Frame(CameraSpec("eye", "", width=16, height=12), 0, np.eye(4))
    assert (colors.colors(SceneState.still(), frame) == (51, 102, 153)).all()
    colors.close()
