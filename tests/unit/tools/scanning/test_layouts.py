"""Folders of posed RGB-D in every layout, and the errors for incomplete ones."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim_tools.scanning.layouts import LAYOUTS, open_posed_rgbd
from gibson_sim_tools.scanning.posed_images import ScanError
from gibson_sim_tools.scanning.trajectories import write_stamped_poses, write_trajectory_log

WIDTH, HEIGHT = 12, 8
INTRINSICS = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": [10.0, 0, 0, 0, 11.0, 0, 5.5, 3.5, 1]}
POSES = np.stack([np.eye(4) + np.array([[0, 0, 0, k], [0] * 4, [0, 0, 0, 0.5], [0] * 4]) for k in range(3)])


def write_color(path: Path, number: int = 0) -> None:
    """Red, lighter from frame to frame."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    image[:, :, 2] = 100 + 10 * number
    cv2.imwrite(str(path), image)


def write_depth(path: Path, units: int = 1500) -> None:
    """One depth everywhere, but for a pixel of 0 and one of 65535."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.full((HEIGHT, WIDTH), units, dtype=np.uint16)
    image[0, 0], image[0, 1] = 0, 65535
    cv2.imwrite(str(path), image)


def open3d_folder(folder: Path, *, log: str = "trajectory.log", color: str = "image") -> Path:
    for k in range(3):
        write_color(folder / color / f"{k:05d}.png", k)
        write_depth(folder / "depth" / f"{k:05d}.png")
    (folder / log).parent.mkdir(exist_ok=True)
    write_trajectory_log(folder / log, POSES)
    (folder / "camera_intrinsic.json").write_text(json.dumps(INTRINSICS))
    return folder


def seven_scenes_folder(folder: Path) -> Path:
    for k in range(3):
        write_color(folder / f"frame-{k:06d}.color.png", k)
        write_depth(folder / f"frame-{k:06d}.depth.png")
        rows = "\t\n".join("\t ".join(f"{value:.7e}" for value in row) for row in POSES[k])
        (folder / f"frame-{k:06d}.pose.txt").write_text(rows + "\t\n")
    return folder


def tum_folder(folder: Path) -> Path:
    """Depth comes 5 ms after the colours; the true poses 10 times as often, each 0.1 m on; the last colours have no depth."""
    folder.mkdir(exist_ok=True)
    for k in range(3):
        write_color(folder / "rgb" / f"{k}.png", k)
        write_depth(folder / "depth" / f"{k}.png", 7500)
    (folder / "rgb.txt").write_text("# timestamp filename\n" + "".join(f"{100 + k / 10:.6f} rgb/{k % 3}.png\n" for k in range(4)))
    (folder / "depth.txt").write_text("".join(f"{100.005 + k / 10:.6f} depth/{k}.png\n" for k in range(3)))
    poses = np.repeat(np.eye(4)[None], 40, axis=0)
    poses[:, 0, 3] = np.arange(40) / 10
    write_stamped_poses(folder / "groundtruth.txt", 100 + np.arange(40) / 100, poses)
    return folder


def our_folder(folder: Path) -> Path:
    for k in range(3):
        write_color(folder / "color" / f"{k:06d}.jpg", k)
        write_depth(folder / "depth" / f"{k:06d}.png")
    write_stamped_poses(folder / "poses.txt", range(3), POSES)
    (folder / "intrinsic.json").write_text(json.dumps(INTRINSICS))
    (folder / "scan.json").write_text(json.dumps({"format": "gibson_sim scan", "frames": 3}))
    return folder


FOCAL = (10.0, 11.0, 5.5, 3.5)


@pytest.mark.parametrize(
    ("make", "layout"),
    [(open3d_folder, "open3d"), (seven_scenes_folder, "7-scenes"), (tum_folder, "tum"), (our_folder, "gibson_sim")],
)
def test_a_layout_is_found_and_gives_images_metres_and_poses(make, layout, tmp_path):
    rgbd = open_posed_rgbd(make(tmp_path / "set"), focal=FOCAL)
    assert (rgbd.layout, len(rgbd), rgbd.intrinsics.matrix[0].tolist()) == (layout, 3, [10.0, 0.0, 5.5])
    frames = list(rgbd)
    assert [f.number for f in frames] == [0, 1, 2]
    assert frames[2].rgb.shape == (HEIGHT, WIDTH, 3)
    assert frames[2].rgb[4, 6].astype(float) == pytest.approx((120, 0, 0), abs=3)
    assert frames[1].depth[4, 6] == pytest.approx(1.5)
    assert np.isnan(frames[1].depth[0, :2]).all() and np.isfinite(frames[1].depth[1:]).all()
    assert [f.T_world_camera[0, 3] for f in frames] == pytest.approx([0.0, 1.0, 2.0])


def test_an_unknown_layout_is_refused_with_the_known_ones(tmp_path):
    with pytest.raises(ScanError) as error:
        open_posed_rgbd(tmp_path)
    assert all(layout.name in str(error.value) for layout in LAYOUTS)


def test_a_folder_of_sets_names_them(tmp_path):
    seven_scenes_folder(tmp_path / "seq-01")
    with pytest.raises(ScanError, match="seq-01"):
        open_posed_rgbd(tmp_path)


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "x").write_text("")
    with pytest.raises(ScanError, match="is not a folder"):
        open_posed_rgbd(tmp_path / "x")


@pytest.mark.parametrize("log", ["scene/trajectory.log", "test_scene/trajectory.log"])
def test_open3d_may_keep_its_trajectory_in_a_folder(log, tmp_path):
    assert len(open_posed_rgbd(open3d_folder(tmp_path / "set", log=log, color="rgb"))) == 3


def test_intrinsics_of_the_folder_are_by_columns(tmp_path):
    intrinsics = open_posed_rgbd(open3d_folder(tmp_path / "set")).intrinsics
    assert (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy) == FOCAL


ROS_YAML = """image_width: 12
image_height: 8
camera_matrix: {rows: 3, cols: 3, data: [10.0, 0.0, 5.5, 0.0, 11.0, 3.5, 0.0, 0.0, 1.0]}
"""
SCANNET = """m_depthWidth = 12
m_calibrationColorIntrinsic = 99 0 5 0 0 99 5 0 0 0 1 0 0 0 0 1
m_calibrationDepthIntrinsic = 10 0 5.5 0 0 11 3.5 0 0 0 1 0 0 0 0 1
"""


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("camera-intrinsics.txt", " 1.0e+01 0 5.5 \n 0 11 3.5\n0 0 1\n"),
        ("camera.txt", "# Kinect\nfx: 10\nfy: 11\ncx: 5.5\ncy: 3.5\n"),
        ("kinect_params.txt", "fx=10, fy=11, cx=5.5, cy=3.5"),
        ("intrinsics.txt", "12 8 10 11 5.5 3.5"),
        (
            "calibration.yml",
            "%YAML:1.0\n---\ncameraMatrix: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n  data: [10., 0., 5.5, 0., 11., 3.5, 0., 0., 1.]\n",
        ),
        ("intrinsic/intrinsic_depth.txt", "10 0 5.5 0\n0 11 3.5 0\n0 0 1 0\n0 0 0 1\n"),
        ("calibration.txt", "# fx fy cx cy\n10, 11, 5.5, 3.5\n"),
        ("camera.json", '{"fx": 10, "fy": 11, "cx": 5.5, "cy": 3.5}'),
        ("intrinsics.json", '{"width": 12, "height": 8, "intrinsic_matrix": [[10, 0, 5.5], [0, 11, 3.5], [0, 0, 1]]}'),
        ("camera_info.yaml", ROS_YAML),
        ("_info.txt", SCANNET),
    ],
)
def test_intrinsics_are_read_in_the_formats_that_sets_have_them_in(tmp_path, name, text):
    folder = open3d_folder(tmp_path / "set")
    (folder / "camera_intrinsic.json").unlink()
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text(text)
    rgbd = open_posed_rgbd(folder)
    assert (rgbd.intrinsics.fx, rgbd.intrinsics.fy, rgbd.intrinsics.cx, rgbd.intrinsics.cy) == FOCAL
    assert name == "intrinsics.json" or any(f"intrinsics are those of {name}" in w for w in rgbd.warnings)


def test_a_file_that_may_hold_intrinsics_and_is_not_read_is_named(tmp_path):
    folder = seven_scenes_folder(tmp_path / "set")
    for path in folder.glob("frame-*.png"):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), cv2.resize(image, (640, 480), interpolation=cv2.INTER_NEAREST))
    (folder / "camera.txt").write_text("a Kinect, I think\n")
    (folder / "calibration.yaml").write_text("camera_matrix: [1000, 0, 900, 0, 1000, 500, 0, 0, 1]\n")
    rgbd = open_posed_rgbd(folder)
    said = "\n".join(rgbd.warnings)
    assert "camera.txt is not read: no intrinsics are in it" in said
    assert "calibration.yaml is not read: its middle is at 900, 500 pixels, outside an image of 640x480" in said
    assert "took those of the 7-scenes camera" in said


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"width": 12, "height": 8, "intrinsic_matrix": [1, 2]}', '{"intrinsic_matrix": "x"}']
)
def test_an_open3d_intrinsics_file_without_intrinsics_is_an_error(tmp_path, text):
    folder = open3d_folder(tmp_path / "set")
    (folder / "camera_intrinsic.json").write_text(text)
    with pytest.raises(ScanError, match=r"camera_intrinsic\.json"):
        open_posed_rgbd(folder)


def test_a_file_that_is_not_read_is_named_where_the_size_does_not_fit(tmp_path):
    folder = open3d_folder(tmp_path / "set")
    (folder / "camera_intrinsic.json").unlink()
    (folder / "camera.txt").write_text("a nice camera")
    with pytest.raises(
        ScanError, match=r"the intrinsics are for 640x480; give those.*; .*camera\.txt is not read: no intrinsics are in it"
    ):
        open_posed_rgbd(folder)


def test_assumed_intrinsics_are_refused_for_another_size(tmp_path):
    folder = open3d_folder(tmp_path / "set")
    (folder / "camera_intrinsic.json").unlink()
    with pytest.raises(ScanError, match="12x8 pixels, the intrinsics are for 640x480"):
        open_posed_rgbd(folder)


def test_the_depth_scale_can_be_given(tmp_path):
    assert open_posed_rgbd(open3d_folder(tmp_path / "set"), depth_scale=5000.0)[0].depth[4, 4] == pytest.approx(0.3)


def test_open3d_without_poses_names_the_searched_files(tmp_path):
    folder = open3d_folder(tmp_path / "set")
    (folder / "trajectory.log").unlink()
    with pytest.raises(ScanError, match=r"no poses; looked for trajectory\.log"):
        open_posed_rgbd(folder)


def test_other_counts_are_named(tmp_path):
    folder = open3d_folder(tmp_path / "set")
    (folder / "depth" / "00001.png").unlink()
    with pytest.raises(ScanError, match="3 colour images, 2 depth images and 3 poses"):
        open_posed_rgbd(folder)


def test_seven_scenes_names_the_frame_without_a_pose(tmp_path):
    folder = seven_scenes_folder(tmp_path / "set")
    (folder / "frame-000001.pose.txt").unlink()
    with pytest.raises(ScanError, match="frame 1 has no pose"):
        open_posed_rgbd(folder, focal=FOCAL)


@pytest.mark.parametrize(("values", "why"), [("nan", "NaN"), ("2 0 0 0", "rigid"), ("one 0 0 0", "four numbers")])
def test_an_invalid_pose_is_refused(values, why, tmp_path):
    folder = seven_scenes_folder(tmp_path / "set")
    row = values if " " in values else " ".join([values] * 4)
    (folder / "frame-000002.pose.txt").write_text(f"{row}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    with pytest.raises(ScanError, match=why):
        open_posed_rgbd(folder, focal=FOCAL)


def test_tum_takes_the_pose_at_the_time_of_the_colours(tmp_path):
    folder = tum_folder(tmp_path / "set")
    text = (folder / "rgb.txt").read_text().replace("100.100000", "100.105000")
    (folder / "rgb.txt").write_text(text)
    assert open_posed_rgbd(folder, focal=FOCAL).poses[1, 0, 3] == pytest.approx(1.05)


def test_tum_leaves_out_frames_without_a_pose_and_reports_them(tmp_path):
    folder = tum_folder(tmp_path / "set")
    lines = (folder / "groundtruth.txt").read_text().splitlines()
    (folder / "groundtruth.txt").write_text("\n".join(lines[:15]) + "\n")
    rgbd = open_posed_rgbd(folder, focal=FOCAL)
    assert len(rgbd) == 2
    assert any("1 of 3 pairs" in warning for warning in rgbd.warnings)


@pytest.mark.parametrize("order", ["100.0 rgb/0.png 100.005 depth/0.png", "100.005 depth/0.png 100.0 rgb/0.png"])
def test_tum_associations_come_in_either_order(order, tmp_path):
    folder = tum_folder(tmp_path / "set")
    (folder / "associations.txt").write_text(order + "\n")
    items = open_posed_rgbd(folder, focal=FOCAL).photographs.items
    assert [(f.file.name, f.file.parent.name, f.depth.parent.name) for f in items] == [("0.png", "rgb", "depth")]


def test_tum_clocks_that_differ_are_named(tmp_path):
    folder = tum_folder(tmp_path / "set")
    write_stamped_poses(folder / "groundtruth.txt", [5.0, 6.0], POSES[:2])
    with pytest.raises(ScanError, match="of the same clock"):
        open_posed_rgbd(folder, focal=FOCAL)


def test_a_list_may_not_lead_out_of_its_folder(tmp_path):
    folder = tum_folder(tmp_path / "set")
    (folder / "rgb.txt").write_text("100.0 ../../secret.png\n")
    with pytest.raises(ScanError, match="outside the folder"):
        open_posed_rgbd(folder, focal=FOCAL)


def test_an_interrupted_scan_says_how_to_finish_it(tmp_path):
    folder = our_folder(tmp_path / "set")
    (folder / "depth" / "000002.png").unlink()
    with pytest.raises(ScanError, match="interrupted"):
        open_posed_rgbd(folder)


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda p: p.write_bytes(p.read_bytes()[:60]), "interrupted"),
        (lambda p: cv2.imwrite(str(p), np.zeros((HEIGHT, WIDTH), np.uint8)), "16 bit"),
        (lambda p: cv2.imwrite(str(p), np.ones((4, 4), np.uint16)), "has 4x4 pixels"),
        (lambda p: p.unlink(), "cannot be read"),
    ],
)
def test_an_invalid_depth_image_is_refused_when_it_is_read(spoil, why, tmp_path):
    rgbd = open_posed_rgbd(open3d_folder(tmp_path / "set"))
    spoil(rgbd.photographs.items[1].depth)
    assert rgbd[0].number == 0
    with pytest.raises(ScanError, match=why):
        rgbd[1]


def test_the_real_living_room_is_read(data_dir):
    rgbd = open_posed_rgbd(data_dir / "open3d_livingroom1_rgbd")
    assert (rgbd.layout, len(rgbd), rgbd.intrinsics.fx) == ("open3d", 211, 525.0)
    frame = rgbd[0]
    assert frame.rgb.shape == (480, 640, 3)
    assert 1.0 < float(np.nanmedian(frame.depth)) < 3.0
    assert np.allclose(frame.T_world_camera, np.eye(4))


def test_intrinsics_of_larger_images_are_refused_with_the_likely_size(tmp_path):
    folder = open3d_folder(tmp_path / "set")
    (folder / "camera_intrinsic.json").unlink()
    (folder / "camera.txt").write_text("20 22 11.5 7.5\n")
    with pytest.raises(
        ScanError, match=r"camera.txt: the principal point is at 11.5, 7.5 pixels, .* of images of 24x16\? Give those of 12x8"
    ):
        open_posed_rgbd(folder)
    assert open_posed_rgbd(folder, focal=(10.0, 11.0, 5.5, 3.5)).intrinsics.fx == 10.0


@pytest.mark.parametrize(
    ("removed", "message"),
    [
        ("depth/00001.png", "frame 00001 has a colour image, but no depth image"),
        ("image/00002.png", "frame 00002 has a depth image, but no colour image"),
    ],
)
def test_the_first_frame_without_a_file_is_named(tmp_path, removed, message):
    folder = open3d_folder(tmp_path / "set")
    (folder / removed).unlink()
    with pytest.raises(ScanError, match=f"there must be as many of each: {message}"):
        open_posed_rgbd(folder)


def test_the_first_frame_without_a_pose_is_named(tmp_path):
    folder = open3d_folder(tmp_path / "set")
    write_trajectory_log(folder / "trajectory.log", POSES[:2])
    with pytest.raises(ScanError, match=r"the poses end before 00002\.png"):
        open_posed_rgbd(folder)
    write_trajectory_log(folder / "trajectory.log", POSES[[0, 1, 2, 2]])
    with pytest.raises(ScanError, match="there is no image for pose 3"):
        open_posed_rgbd(folder)


def test_a_folder_of_photographs_is_named_with_the_command_that_reads_it(tmp_path):
    (tmp_path / "transforms.json").write_text("{}")
    with pytest.raises(ScanError, match=r"is a folder of photographs \(nerfstudio\), .* `gibson-sim scene import` fuses"):
        open_posed_rgbd(tmp_path)
