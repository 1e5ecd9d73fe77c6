"""The pose convention is detected by the consistency of neighbouring depth images."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.cli.command_line import run
from gibson_sim.geometry.transforms import invert
from gibson_sim_tools.scanning import fusion
from gibson_sim_tools.scanning.layouts import open_posed_rgbd
from gibson_sim_tools.scanning.pose_conventions import detect_convention, reinterpret_poses
from gibson_sim_tools.scanning.posed_rgbd import PosedRgbd, ScanError
from support.photographed_room import COUNT, write_rgbd

F64 = NDArray[np.float64]
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> PosedRgbd:
    return open_posed_rgbd(write_rgbd(tmp_path_factory.mktemp("scan") / "room"))


def found(rgbd: PosedRgbd, convention: str = "as-read") -> tuple[str, str]:
    return detect_convention(rgbd, range(len(rgbd)), 10.0, convention)


@pytest.mark.parametrize("convention", ["as-read", "auto", "opencv"])
def test_correct_poses_stay_as_read(room: PosedRgbd, convention: str) -> None:
    name, text = found(room, convention)
    np.testing.assert_allclose(reinterpret_poses(room.poses, room.layout, name), room.poses)
    assert text == ""


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("opengl", lambda T: T @ OPENGL),
        ("opencv-world-to-camera", invert),
        ("opengl-world-to-camera", lambda T: invert(T @ OPENGL)),
    ],
)
def test_another_convention_is_named_and_used_on_request(room: PosedRgbd, name: str, written: Callable[[F64], F64]) -> None:
    wrong = room.with_poses(np.stack([written(T) for T in room.poses]))
    with pytest.raises(ScanError, match=f"agree if poses are read as {name} .* give --pose-convention {name}, or auto$"):
        found(wrong)
    taken, text = found(wrong, "auto")
    assert taken == name and text.startswith(f"poses are read as {name}: ")
    np.testing.assert_allclose(reinterpret_poses(wrong.poses, wrong.layout, name), room.poses, atol=1e-9)
    assert found(wrong, name) == (name, "")


def test_a_requested_wrong_convention_is_refused(room: PosedRgbd) -> None:
    with pytest.raises(ScanError, match="agree if poses are read as opencv "):
        found(room, "opengl")


def test_poses_that_are_consistent_in_no_convention_stay_as_read(room: PosedRgbd) -> None:
    assert found(room.with_poses(np.roll(room.poses, COUNT // 2 - 1, axis=0)[::-1])) == ("as-read", "")


def test_frames_without_rotation_do_not_distinguish_conventions(room: PosedRgbd) -> None:
    still = room.subset([3, 3, 3])
    assert found(still.with_poses(still.poses @ OPENGL)) == ("as-read", "")
    assert found(room.subset([3])) == ("as-read", "")


def test_scene_fuse_names_the_convention_before_it_fuses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fusion, "open3d", lambda: None)  # which is not reached
    folder = write_rgbd(tmp_path / "scan", np.eye(4))
    lines = (folder / "trajectory.log").read_text().splitlines()
    for k in range(COUNT):
        rows = np.array([line.split() for line in lines[5 * k + 1 : 5 * k + 5]], dtype=float) @ OPENGL
        lines[5 * k + 1 : 5 * k + 5] = [" ".join(map(str, row)) for row in rows]
    (folder / "trajectory.log").write_text("\n".join(lines))
    assert run(["scene", "fuse", str(folder), "--output", str(tmp_path / "a.ply")]) == 1
    assert "give --pose-convention opengl, or auto" in capsys.readouterr().err
