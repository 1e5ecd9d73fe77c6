"""Python of the documentation that draws."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.types import CameraSpec

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]


def test_the_example_of_the_renderer_runs_and_its_camera_in_the_world_looks_down(root: Path) -> None:
    (block,) = re.findall(r"^```python\n(.*?)^```", (root / "docs" / "renderer.md").read_text(), re.DOTALL | re.MULTILINE)
    made: dict[str, object] = {}
    exec(compile(block, "docs/renderer.md", "exec"), made)
    frames = made["frames"]
    assert isinstance(frames, (list, tuple))
    assert [frame.camera.name for frame in frames] == ["camera", "ceiling"]
    depth = frames[1].depth
    assert depth.max() == pytest.approx(2.3, abs=0.01), "the floor is 2.3 m below"
    assert np.isfinite(depth).all()


def test_map_is_the_world_in_python_as_in_yaml() -> None:
    assert CameraSpec("eye", "map") == CameraSpec("eye", "")
