"""Posed photographs of third-party programs: COLMAP, nerfstudio, Polycam, Record3D."""

from __future__ import annotations

import json
import struct

import cv2
import numpy as np
import pytest

from gibson_sim_tools.photographs.layouts import open_photographs
from gibson_sim_tools.scanning.posed_images import ScanError

# The camera is at x = 1, y = 2, z = 3, and looks along -x of the world with z up.
T_WORLD_CAMERA = np.array([[0.0, 0.0, -1.0, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, -1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0]])
QUAT_WXYZ = (0.5, 0.5, 0.5, -0.5)
"""Rotation of T_camera_world, as COLMAP writes it: x' = y, y' = -z, z' = -x."""
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


def test_colmap_text_models_hold_world_to_camera_poses_and_pixel_centres_at_halves(folder):
    colmap_text(folder)
    found = open_photographs(folder)
    assert found.layout == "colmap" and [item.file.name for item in found.items] == ["a.png", "b.png"]
    np.testing.assert_allclose(found.poses[0], T_WORLD_CAMERA, atol=1e-12)
    k = found.intrinsics(0)
    assert (k.width, k.height, k.fx, k.fy, k.cx, k.cy) == (60, 40, 50.0, 51.0, 29.5, 19.5)
    assert found.image(0)[20, 30].tolist() == [255, 0, 0]


def test_colmap_binary_models_equal_text_models(folder):
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
    with pytest.raises(ScanError, match="truncated"):
        open_photographs(folder)


def test_nerfstudios_cameras_look_along_minus_z(folder):
    frames = [
        {"file_path": f"images/{name}", "transform_matrix": (T_WORLD_CAMERA @ np.diag([1, -1, -1, 1])).tolist()}
        for name in ("a.png", "b")
    ]
    values = {"w": 60, "h": 40, "fl_x": 50, "fl_y": 51, "cx": 30, "cy": 20, "k1": 0.1, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(values))
    found = open_photographs(folder, longest_side=30)
    np.testing.assert_allclose(found.poses[0], T_WORLD_CAMERA, atol=1e-12)
    assert found.items[0].camera.distortion == (0.1, 0.0, 0.0, 0.0, 0.0)
    # Half the size: the middle of the picture stays its middle.
    k = found.intrinsics(0)
    assert (k.width, k.height, k.fx, k.cx, k.cy) == (30, 20, 25.0, 14.5, 9.5)
    assert found.items[1].file.name == "b.png" and found.image(1).shape == (20, 30, 3)


def test_photographs_without_poses_are_refused_with_the_programs_that_compute_them(folder):
    with pytest.raises(ScanError, match="no poses; COLMAP finds them"):
        open_photographs(folder)


def test_errors_name_the_value(folder):
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
        open_photographs(folder).image(0)


def test_nerfstudio_frames_may_have_their_own_cameras_depths_and_nan_poses(folder):
    cv2.imwrite(str(folder / "d.png"), np.full((20, 30), 500, np.uint16))
    matrix = (T_WORLD_CAMERA @ np.diag([1, -1, -1, 1])).tolist()
    lost = [[float("nan")] * 4] * 4
    frames = [
        {"file_path": "images/a.png", "transform_matrix": matrix, "fl_x": 70, "depth_file_path": "d.png"},
        {"file_path": "images/b.png", "transform_matrix": lost},
        {"file_path": "images/b.png", "transform_matrix": matrix},
    ]
    values = {"w": 60, "h": 40, "fl_x": 50, "fl_y": 50, "depth_unit_scale_factor": 0.01, "frames": frames}
    values["applied_transform"] = np.eye(4)[[1, 2, 0]].tolist()
    (folder / "transforms.json").write_text(json.dumps(values))
    found = open_photographs(folder)
    assert [found.intrinsics(k).fx for k in (0, 1)] == [70.0, 50.0] and found.applied_transform[0].tolist() == [
        0.0,
        1.0,
        0.0,
        0.0,
    ]
    assert "1 of 3 poses hold a NaN or an infinity, first that of b.png" in found.warnings[0]
    # 500 hundredths of a metre; the depth image has half as many pixels a side.
    depth = found.depth(0)
    assert depth.shape == (40, 60) and (depth == 5.0).all() and found.depth(1) is None
    (folder / "transforms.json").write_text(json.dumps({**values, "frames": frames[1:2]}))
    with pytest.raises(ScanError, match="all 1 poses hold a NaN"):
        open_photographs(folder)


def test_polycam_poses_are_camera_to_world_in_opengl_convention(tmp_path):
    for name in ("corrected_cameras", "corrected_images", "depth"):
        (tmp_path / "keyframes" / name).mkdir(parents=True)
    opengl = T_WORLD_CAMERA @ np.diag([1, -1, -1, 1])
    values = {f"t_{r}{c}": opengl[r, c] for r in range(3) for c in range(4)}
    values |= {"width": 60, "height": 40, "fx": 50, "fy": 51, "cx": 30, "cy": 20}
    for stem in ("10", "9"):
        (tmp_path / "keyframes" / "corrected_cameras" / f"{stem}.json").write_text(json.dumps(values))
        cv2.imwrite(str(tmp_path / "keyframes" / "corrected_images" / f"{stem}.jpg"), np.zeros((40, 60, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "keyframes" / "depth" / "9.png"), np.full((10, 15), 2500, np.uint16))
    found = open_photographs(tmp_path)
    assert found.layout == "polycam" and [item.file.name for item in found.items] == ["9.jpg", "10.jpg"]
    np.testing.assert_allclose(found.poses[1], T_WORLD_CAMERA, atol=1e-12)
    assert found.intrinsics(0).cx == 29.5 and found.depth(0)[39, 59] == 2.5 and found.depth(1) is None
    del values["t_03"]
    (tmp_path / "keyframes" / "corrected_cameras" / "9.json").write_text(json.dumps(values))
    with pytest.raises(ScanError, match="t_03 is None, must be a number"):
        open_photographs(tmp_path)


def test_record3d_intrinsics_are_column_major_and_quaternions_xyzw(tmp_path):
    (tmp_path / "rgb").mkdir()
    for k in (0, 2, 10):
        cv2.imwrite(str(tmp_path / "rgb" / f"{k}.jpg"), np.zeros((40, 60, 3), np.uint8))
    # A quarter turn about y: the camera, along -z in its frame, looks along -x of the world.
    turned = [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5), 1.0, 2.0, 3.0]
    values = {"w": 60, "h": 40, "K": [50, 0, 0, 0, 51, 0, 30, 20, 1], "poses": [turned, turned, [float("nan")] * 7]}
    (tmp_path / "metadata.json").write_text(json.dumps(values))
    found = open_photographs(tmp_path)
    assert found.layout == "record3d" and [item.file.name for item in found.items] == ["0.jpg", "2.jpg"]
    np.testing.assert_allclose(found.poses[0][:, 2], (-1.0, 0.0, 0.0, 0.0), atol=1e-12)
    assert found.poses[0][:3, 3].tolist() == [1.0, 2.0, 3.0] and "first that of 10.jpg" in found.warnings[0]
    k = found.intrinsics(0)
    assert (k.fx, k.fy, k.cx, k.cy) == (50.0, 51.0, 29.5, 19.5)
    (tmp_path / "metadata.json").write_text(json.dumps({**values, "poses": [turned]}))
    with pytest.raises(ScanError, match="1 poses for 3 photographs"):
        open_photographs(tmp_path)


def test_a_bag_is_refused_with_the_command_that_exports_photographs(tmp_path):
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:")
    with pytest.raises(ScanError, match=r"is a bag; .* gibson-sim export .* --to nerfstudio"):
        open_photographs(tmp_path)


def test_invalid_intrinsics_are_named_with_their_file_and_frame(folder):
    frames = [{"file_path": "images/a.png", "transform_matrix": np.eye(4).tolist()}]
    (folder / "transforms.json").write_text(json.dumps({"w": 60, "h": 40, "fl_x": 0, "fl_y": 50, "frames": frames}))
    with pytest.raises(ScanError, match=r"transforms.json: frame 0: intrinsics: fx, fy, cx, cy are 0, 50, 29.5, 19.5 pixels"):
        open_photographs(folder)
    (folder / "transforms.json").unlink()
    colmap_text(folder, "1 PINHOLE 60 40 0 51 30 20\n")
    with pytest.raises(ScanError, match=r"cameras.txt: intrinsics: fx, fy, cx, cy are 0, 51"):
        open_photographs(folder)


def test_a_line_that_is_not_colmaps_is_named(folder):
    colmap_text(folder, "1 PINHOLE 60\n")
    with pytest.raises(ScanError, match=r"cameras.txt:2: '1 PINHOLE 60' must be camera id, model, width, height and parameters"):
        open_photographs(folder)
    (folder / "sparse/0/cameras.txt").write_text("1 PINHOLE 60 40 50\n")
    with pytest.raises(ScanError, match=r"cameras.txt:1: a camera PINHOLE has 1 parameters, must have 4"):
        open_photographs(folder)
    (folder / "sparse/0/cameras.txt").write_text("1 PINHOLE 60 40 50 51 30 20\n")
    (folder / "sparse/0/images.txt").write_text("# images\n2 0.5 0.5 b.png\n\n")
    with pytest.raises(
        ScanError, match=r"images.txt:2: '2 0.5 0.5 b.png' must be image id, qw qx qy qz, tx ty tz, camera id and file"
    ):
        open_photographs(folder)


def test_a_scaled_or_mirrored_pose_is_named(folder):
    def written(matrix):
        frames = [{"file_path": "images/a.png", "transform_matrix": matrix.tolist()}]
        (folder / "transforms.json").write_text(json.dumps({"w": 60, "h": 40, "fl_x": 50, "fl_y": 50, "frames": frames}))

    written(np.diag([2.0, 2.0, 2.0, 1.0]))
    with pytest.raises(ScanError, match="its rotation is scaled by 2; divide"):
        open_photographs(folder)
    written(np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(ScanError, match="its determinant is -1: it mirrors"):
        open_photographs(folder)
