"""The pose convention is detected by the consistency of neighbouring depth images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.cli.command_line import run
from gibson_sim.geometry.transforms import invert
from gibson_sim_tools.scanning import fusion
from gibson_sim_tools.scanning.layouts import open_posed_rgbd
from gibson_sim_tools.scanning.pose_conventions import detect_convention, reinterpret_poses
from gibson_sim_tools.scanning.posed_images import PosedRgbd, ScanError
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


@pytest.mark.parametrize("convention", ["as-read", "auto"])
def test_poses_that_are_consistent_in_no_convention_are_refused(room: PosedRgbd, convention: str) -> None:
    with pytest.raises(
        ScanError, match=r"agree in no convention \(0\.\d\d of the pixels; 0.8 and more are usual\): check the depth scale"
    ):
        found(room.with_poses(np.roll(room.poses, COUNT // 2 - 1, axis=0)[::-1]), convention)


def test_noisy_poses_are_fused_with_a_warning(room: PosedRgbd) -> None:
    poses = room.poses
    poses[:, :3, 3] += np.random.default_rng(0).normal(0.0, 0.07, (COUNT, 3))
    name, text = found(room.with_poses(poses))
    assert name == "as-read" and text.startswith("warning: neighbouring depth images agree poorly (0.")


@pytest.mark.parametrize(("present", "right"), [(5000.0, "1000"), (200.0, "1000"), (100.0, "1000")])
def test_the_right_depth_scale_is_named(room: PosedRgbd, present: float, right: str) -> None:
    photographs = room.photographs
    items = tuple(replace(item, depth_scale=present) for item in photographs.items)
    with pytest.raises(ScanError, match=f"they agree with a depth scale of {right} units per metre instead of {present:g} "):
        found(replace(room, photographs=replace(photographs, items=items)))


def test_poses_in_millimetres_are_named(room: PosedRgbd) -> None:
    poses = room.poses
    poses[:, :3, 3] *= 1000.0
    with pytest.raises(ScanError, match=r"positions of the cameras are in millimetres .* neighbouring cameras are 364 m apart"):
        found(room.with_poses(poses))


def test_depth_images_without_depth_are_named(room: PosedRgbd, tmp_path: Path) -> None:
    file = tmp_path / "empty.png"
    cv2.imwrite(str(file), np.zeros((48, 64), dtype=np.uint16))
    photographs = room.photographs
    empty = replace(room, photographs=replace(photographs, items=tuple(replace(item, depth=file) for item in photographs.items)))
    with pytest.raises(ScanError, match="hold no depth: all pixels of the 11 that were read are 0 or 65535"):
        found(empty)


def test_depths_beyond_the_limit_are_named(room: PosedRgbd) -> None:
    with pytest.raises(ScanError, match=r"most depths are beyond --depth-max 0\.5"):
        detect_convention(room, range(len(room)), 0.5)


def test_frames_in_any_order_are_accepted(room: PosedRgbd) -> None:
    assert found(room.subset([0, 6, 2, 9, 4, 11, 1, 7, 3, 10, 5, 8])) == ("as-read", "")


def test_far_frames_that_disagree_are_a_warning(room: PosedRgbd) -> None:
    # Three times in three places that are metres apart: the frames of a sparse scan.
    apart = room.subset([0, 4, 8])
    poses = apart.poses
    poses[:, 0, 3] += [0.0, 3.0, 6.0]
    poses[:, :3, :3] = poses[0, :3, :3]
    name, text = found(apart.with_poses(poses))
    assert name == "as-read" and "few frames show the same surfaces, or else check" in text


def test_frames_that_look_in_different_directions_are_not_judged(room: PosedRgbd) -> None:
    assert found(room.subset([0, 6])) == ("as-read", "")


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
