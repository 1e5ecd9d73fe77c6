"""Posed photographs of others: COLMAP's models and nerfstudio's transforms.json."""

from __future__ import annotations

import json
import struct

import cv2
import numpy as np
import pytest

from gibson_sim_tools.scanning.posed_rgbd import ScanError
from gibson_sim_tools.texturing.photograph_layouts import open_photographs

# The camera is at x = 1, y = 2, z = 3, and looks along -x of the world with z up.
T_WORLD_CAMERA = np.array([[0.0, 0.0, -1.0, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, -1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0]])
QUAT_WXYZ = (0.5, 0.5, 0.5, -0.5)
"""Of T_camera_world, as COLMAP writes it: x' = y, y' = -z, z' = -x."""
SHIFT = (-2.0, 3.0, 1.0)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "images").mkdir()
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / "images" / name), np.full((40, 60, 3), (0, 0, 255), np.uint8))
    return tmp_path


def colmap_text(folder, cameras="1 PINHOLE 60 40 50 51 30 20\n"):
    (folder / "sparse" / "0").mkdir(parents=True)
    (folder / "sparse" / "0" / "cameras.txt").write_text("# cameras\n" + cameras)
    pose = " ".join(map(str, (*QUAT_WXYZ, *SHIFT)))
    (folder / "sparse" / "0" / "images.txt").write_text(f"# images\n2 {pose} 1 b.png\n\n1 {pose} 1 a.png\n1.5 2.5 7\n")


def test_colmaps_text_has_its_poses_the_other_way_round_and_pixel_centres_at_halves(folder):
    colmap_text(folder)
    found = open_photographs(folder)
    assert found.layout == "colmap" and [item.file.name for item in found.items] == ["a.png", "b.png"]
    np.testing.assert_allclose(found.poses[0], T_WORLD_CAMERA, atol=1e-12)
    k = found.intrinsics(0)
    assert (k.width, k.height, k.fx, k.fy, k.cx, k.cy) == (60, 40, 50.0, 51.0, 29.5, 19.5)
    assert found.picture(0)[20, 30].tolist() == [255, 0, 0]


def test_colmaps_binary_files_say_the_same(folder):
    model = folder / "sparse"
    model.mkdir()
    (model / "cameras.bin").write_bytes(struct.pack("<QiiQQ4d", 1, 1, 1, 60, 40, 50, 51, 30, 20))
    images = b"".join(
        struct.pack("<I7di", k, *QUAT_WXYZ, *SHIFT, 1) + name + b"\0" + struct.pack("<Q", 2) + bytes(48)
        for k, name in ((2, b"b.png"), (1, b"a.png"))
    )
    (model / "images.bin").write_bytes(struct.pack("<Q", 2) + images)
    found = open_photographs(folder)
    np.testing.assert_allclose(found.poses[1], T_WORLD_CAMERA, atol=1e-12)
    assert [item.file.name for item in found.items] == ["a.png", "b.png"] and found.intrinsics(1).cx == 29.5
    (model / "images.bin").write_bytes((struct.pack("<Q", 2) + images)[:-60])
    with pytest.raises(ScanError, match="cut short"):
        open_photographs(folder)


def test_nerfstudios_cameras_look_along_minus_z(folder):
    frames = [
        {"file_path": f"images/{name}", "transform_matrix": (T_WORLD_CAMERA @ np.diag([1, -1, -1, 1])).tolist()}
        for name in ("a.png", "b")
    ]
    values = {"w": 60, "h": 40, "fl_x": 50, "fl_y": 51, "cx": 30, "cy": 20, "k1": 0.1, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(values))
    found = open_photographs(folder, longest=30)
    np.testing.assert_allclose(found.poses[0], T_WORLD_CAMERA, atol=1e-12)
    assert found.items[0].lens.distortion == (0.1, 0.0, 0.0, 0.0, 0.0)
    # Half the size: the middle of the picture stays its middle.
    k = found.intrinsics(0)
    assert (k.width, k.height, k.fx, k.cx, k.cy) == (30, 20, 25.0, 14.5, 9.5)
    assert found.items[1].file.name == "b.png" and found.picture(1).shape == (20, 30, 3)


def test_photographs_without_poses_are_told_who_finds_them(folder):
    with pytest.raises(ScanError, match="no poses; COLMAP finds them"):
        open_photographs(folder)


def test_what_is_wrong_is_named(folder):
    colmap_text(folder, "1 FOV 60 40 50 51 30 20 0.9\n")
    with pytest.raises(ScanError, match="'FOV' is unknown; known: SIMPLE_PINHOLE"):
        open_photographs(folder)
    (folder / "transforms.json").write_text(
        json.dumps({"frames": [{"file_path": "../x.png", "transform_matrix": np.eye(4).tolist()}]})
    )
    with pytest.raises(ScanError, match="w is None, must be a number"):
        open_photographs(folder)
    (folder / "transforms.json").write_text(
        json.dumps({"w": 6, "h": 4, "fl_x": 5, "frames": [{"file_path": "../x.png", "transform_matrix": np.eye(4).tolist()}]})
    )
    with pytest.raises(ScanError, match="lies outside the folder"):
        open_photographs(folder)


def test_a_photograph_of_another_size_than_its_camera_is_refused(folder):
    colmap_text(folder, "1 PINHOLE 61 40 50 51 30 20\n")
    with pytest.raises(ScanError, match="has 60x40 pixels, its camera 61x40"):
        open_photographs(folder).picture(0)
