"""TSDF fusion of posed RGB-D with Open3D, where it is installed."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gibson_sim.cli.main import main
from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.scanning.comparison import compare
from gibson_sim_tools.scanning.fusion import distances_to_mesh, fuse, fuse_scan, selected_frames
from gibson_sim_tools.scanning.layouts import open_posed_rgbd
from gibson_sim_tools.scanning.posed_images import ScanError, depth_units
from gibson_sim_tools.scanning.settings import FuseSettings
from gibson_sim_tools.scanning.trajectories import write_trajectory_log

SETTINGS = FuseSettings(voxel=0.04, min_weight=1.0, min_part=0.0)
SCENE = (
    "name: board\nfloor_z: 0.0\nobjects:\n  - {name: board, box: [4, 4, 0.2], pose: {xyz: [0, 0, -0.1]}, color: [1, 0.2, 0.2]}\n"
)


@pytest.fixture(autouse=True)
def _open3d() -> None:
    try:
        import open3d  # noqa: F401
    except ImportError as error:
        message = f"SKIPPED: Open3D is not here ({error}); pip install 'gibson_sim_tools[scanning]'"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)


@pytest.fixture
def board(tmp_path):
    """Three views of a level board at z = 0 from above, slanted by 20 degrees to either side."""
    width, height, focal = 96, 72, 70.0
    (tmp_path / "color").mkdir()
    (tmp_path / "depth").mkdir()
    poses = []
    for k, tilt in enumerate(np.radians([-20.0, 0.0, 20.0])):
        c, s = np.cos(tilt), np.sin(tilt)
        T = np.eye(4)
        T[:3, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.diag([1.0, -1.0, -1.0])
        T[:3, 3] = 0.1 * k, 0.0, 1.0
        u, v = np.meshgrid(np.arange(width), np.arange(height))
        ray = np.stack([(u - 47.5) / focal, (v - 35.5) / focal, np.ones(u.shape)], axis=-1) @ T[:3, :3].T
        cv2.imwrite(str(tmp_path / "depth" / f"{k}.png"), depth_units((-1.0 / ray[..., 2]).astype(np.float32), 1000.0))
        cv2.imwrite(str(tmp_path / "color" / f"{k}.png"), np.full((height, width, 3), (51, 51, 255), np.uint8))
        poses.append(T)
    write_trajectory_log(tmp_path / "trajectory.log", poses)
    intrinsics = {"width": width, "height": height, "intrinsic_matrix": [focal, 0, 0, 0, focal, 0, 47.5, 35.5, 1]}
    (tmp_path / "intrinsic.json").write_text(json.dumps(intrinsics))
    return open_posed_rgbd(tmp_path)


def test_a_board_is_fused_where_it_is_and_in_its_colour(board):
    mesh = fuse(board, SETTINGS)
    assert np.abs(mesh.vertices[:, 2]).max() < 0.012
    assert abs(float(np.median(mesh.vertices[:, 2]))) < 0.001
    off = np.abs(mesh.colors.astype(int) - (255, 51, 51)).max(axis=1)
    assert np.percentile(off, 98) <= 2  # at the rim colours are mixed with nothing
    assert mesh.doubled_area_vectors()[:, 2].min() >= 0.0
    assert mesh.area > 1.0


def test_depth_only_frames_do_not_change_colors(board):
    picture = np.full((72, 96, 3), (255, 51, 51), np.uint8)
    cv2.imwrite(str(board.folder / "color" / "2.png"), picture)  # blue
    full, mesh = fuse(board, SETTINGS), fuse_scan(board, SETTINGS, depth_only=[2]).mesh
    assert (full.colors[:, 2] > 60).any()
    # The surface is that of all three, in the colour of two.
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), np.ptp(full.vertices, axis=0), atol=1e-4)
    assert mesh.area == pytest.approx(full.area, rel=1e-3) and mesh.area > 1.05 * fuse(board.subset([0, 1]), SETTINGS).area
    assert mesh.colors[:, 2].max() <= 53


def test_a_depth_image_with_hardly_a_valid_pixel_is_left_out(board):
    depth = np.zeros((72, 96), np.uint16)
    depth[1, 1] = depth[30, 41] = 1000  # between the pixels at which Open3D looks for voxels
    cv2.imwrite(str(board.folder / "depth" / "2.png"), depth)
    assert fuse(board, SETTINGS).area == pytest.approx(fuse(board.subset([0, 1]), SETTINGS).area, rel=1e-4)


def test_voxels_of_too_few_images_become_holes(board):
    assert fuse(board, replace(SETTINGS, min_weight=3.0)).area < 0.8 * fuse(board, SETTINGS).area
    with pytest.raises(ScanError, match="--min-weight"):
        fuse(board, replace(SETTINGS, min_weight=50.0))


def test_the_message_counts_the_frames_of_the_stride(board, tmp_path, capsys):
    words = ["scene", "fuse", str(board.folder), "--output", str(tmp_path / "a.ply"), "--report", str(tmp_path / "a.json")]
    with pytest.raises(SystemExit) as ended:
        main([*words, "--voxel", "0.04", "--min-weight", "1", "--min-part", "0", "--stride", "2"])
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert (
        "from 2 of 3 frames (open3d)" in out and "1 plane with" in out and "no level surface faces up" in out
    )  # cameras look straight down
    report = json.loads((tmp_path / "a.json").read_text())
    assert report["frames"] == 2 and report["voxel_m"] == 0.04 and report["snap"]["max_mm"] <= 20.0
    assert list(selected_frames(board, replace(SETTINGS, stride=2))) == [0, 2]


def test_far_depths_are_left_out(board):
    with pytest.raises(ScanError, match="--depth-max"):
        fuse(board, replace(SETTINGS, depth_max=0.5))


def test_a_mesh_can_be_simplified(board):
    full = fuse(board, SETTINGS)
    less = fuse(board, replace(SETTINGS, triangles=60))
    assert len(less.triangles) <= 60 < len(full.triangles)
    assert less.area == pytest.approx(full.area, rel=0.05)


def test_a_mesh_is_measured_against_its_scene(board, tmp_path):
    (tmp_path / "scene.yaml").write_text(SCENE)
    found = compare(fuse(board, SETTINGS), board, load_scene(tmp_path), distances_to_mesh)
    assert found.mesh_to_scene.median_mm < 1.0
    assert found.covered > 0.94  # a voxel along the rim is missing
    assert 0.05 < found.shown < 0.4  # a part of the upper side
