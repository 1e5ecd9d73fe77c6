"""Python examples of the documentation that draw."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import cv2
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


def test_the_tutorial_of_python_runs_from_top_to_bottom(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    page = (root / "docs" / "python.md").read_text()
    made: dict[str, object] = {}
    for number, block in enumerate(re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)):
        exec(compile(block, f"docs/python.md, block {number}", "exec"), made)
    said = capsys.readouterr().out
    # The output that the page shows.
    assert "1.0 <Robot robot: x 1.255 m, y 4.714 m, yaw 5.7 deg>" in said
    assert "(480, 640, 3) uint8" in said
    assert "did you mean 'linden_flat'?" in said
    assert "did you mean 'kitchen'?" in said


@pytest.mark.parametrize(
    "program", ["camera_data_set.py out --images 2", "renderer_alone.py flat picture.png", "gymnasium_rollout.py --episodes 1"]
)
def test_examples_without_ros_run(root: Path, tmp_path: Path, program: str) -> None:
    name, *arguments = program.split()
    if name.startswith("gymnasium"):
        pytest.importorskip("gymnasium", reason="SKIPPED: gymnasium is not installed: pip install gymnasium")
    command = [sys.executable, str(root / "docs" / "examples" / name), *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    made = sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file())
    pictures = [cv2.imread(str(tmp_path / path), cv2.IMREAD_UNCHANGED) for path in made if path.endswith(".png")]
    assert all(picture is not None and picture.std() > 0 for picture in pictures)
    if name.startswith("camera"):
        assert made == [
            "out/000000_depth.png",
            "out/000000_rgb.png",
            "out/000001_depth.png",
            "out/000001_rgb.png",
            "out/poses.csv",
        ]
        assert [(picture.dtype, picture.shape) for picture in pictures[:2]] == [("uint16", (480, 640)), ("uint8", (480, 640, 3))]


def test_examples_are_short(root: Path) -> None:
    programs = (root / "docs" / "examples").glob("*.py")
    lines = {path.name: len(path.read_text().splitlines()) for path in programs if not path.name.startswith(("learn_", "check_"))}
    assert len(lines) == 8
    assert max(lines.values()) < 60, lines


def test_map_is_the_world_in_python_as_in_yaml() -> None:
    assert CameraSpec("eye", "map") == CameraSpec("eye", "")
