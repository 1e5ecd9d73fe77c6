"""The rig on its route, and the files of scans, by hand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim_tools.scanning.capture import intrinsics_of, mounts
from gibson_sim_tools.scanning.intrinsics_files import find_intrinsics, write_intrinsics
from gibson_sim_tools.scanning.posed_images import (
    CameraModel,
    Intrinsics,
    Photograph,
    Photographs,
    PosedRgbd,
    ScanError,
    check_pose,
    depth_units,
    metres,
)
from gibson_sim_tools.scanning.route import RigView, StationPaths, short_tour
from gibson_sim_tools.scanning.settings import ScanCamera, TourSettings
from gibson_sim_tools.scanning.stations import Station, StoreyFloor, nearest_at_horizon
from gibson_sim_tools.scanning.trajectories import associate, parse_numbers, pose_at, read_lines


def test_an_earlier_pose_of_a_moving_rig_lies_behind() -> None:
    view = RigView(1.0, 2.0, 3.0, 1.5, 0.0, 0.0, math.pi / 2, velocity_x=0.4, velocity_y=-0.2, yaw_rate=math.pi)
    assert view.T_world_rig[:3, 3].tolist() == [2.0, 3.0, 1.5]
    assert view.T_world_rig[:3, 0] == pytest.approx([0.0, 1.0, 0.0])  # x, forward, points along y of the world
    before = view.earlier(0.5)
    assert before[:3, 3] == pytest.approx([1.8, 3.1, 1.5]) and before[:3, 0] == pytest.approx([1.0, 0.0, 0.0])


def test_a_tour_takes_the_nearest_first_and_leaves_what_cannot_be_reached_for_the_end() -> None:
    x = np.array([0.0, 3.0, 1.0, 2.0])
    lengths = np.abs(x[:, None] - x)
    assert short_tour(lengths) == [0, 2, 3, 1]
    lengths[:, 2] = lengths[2] = np.inf
    assert short_tour(lengths) == [0, 3, 1, 2]
    assert short_tour(np.zeros((1, 1))) == [0]


def test_paths_between_stations_are_those_of_the_grid() -> None:
    floor = np.ones((20, 20), dtype=bool)
    floor_map = FloorMap(0.1, (0.0, 0.0), np.zeros_like(floor), floor)
    stations = [Station(0, x, 0.55, 1.0) for x in (0.55, 1.55)]
    paths = StationPaths(StoreyFloor(floor_map, 0.0, floor), stations)
    assert paths.lengths == pytest.approx(np.array([[0.0, 1.0], [1.0, 0.0]]), abs=1e-6)
    points = paths.points(0, 1)
    assert points[0] == pytest.approx([0.55, 0.55]) and points[-1] == pytest.approx([1.55, 0.55])
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() == pytest.approx(1.0)


def test_only_obstacles_near_the_horizon_count() -> None:
    panorama = np.full((8, 16), 5.0, dtype=np.float32)
    panorama[0], panorama[7] = 0.1, 0.2  # ceiling and floor
    panorama[4, 3] = 1.5
    assert nearest_at_horizon(panorama) == 1.5


def test_cameras_of_a_rig_look_up_for_a_positive_pitch() -> None:
    level, up = mounts(TourSettings(pitches_deg="0,30"))
    assert level[:3, 2] == pytest.approx([1.0, 0.0, 0.0])  # z of the optical frame looks along x of the rig
    assert level[:3, 0] == pytest.approx([0.0, -1.0, 0.0])  # x, to the right
    assert up[:3, 2] == pytest.approx([math.cos(math.pi / 6), 0.0, 0.5])


def test_intrinsics_follow_from_the_field_of_view() -> None:
    found = intrinsics_of(ScanCamera(width=640, height=480, fov_y_deg=90.0))
    assert (found.fx, found.fy, found.cx, found.cy) == pytest.approx((240.0, 240.0, 319.5, 239.5))
    assert found.matrix.tolist() == [[found.fx, 0.0, 319.5], [0.0, found.fy, 239.5], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize(("text", "angles"), [("-35,0,35", (-35.0, 0.0, 35.0)), ("10", (10.0,)), (" 1, 2 ", (1.0, 2.0))])
def test_pitches_are_a_list_of_angles(text: str, angles: tuple[float, ...]) -> None:
    assert TourSettings(pitches_deg=text).pitches == angles


@pytest.mark.parametrize("text", ["", "a", "91", "-90,nan", ",".join(["0"] * 17)])
def test_other_pitches_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="must be 1 to 16 angles"):
        TourSettings(pitches_deg=text)


def test_depths_become_millimetres_and_back() -> None:
    depth = np.array([[1.2344, 65.534, 70.0], [np.nan, np.inf, -1.0]], dtype=np.float32)
    units = depth_units(depth, 1000.0)
    assert units.tolist() == [[1234, 65534, 0], [0, 0, 0]]
    back = metres(np.array([[1234, 0, 65535]], dtype=np.uint16), 1000.0)
    assert back[0, 0] == pytest.approx(1.234) and np.isnan(back[0, 1:]).all()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ((0, 3, np.nan), "a NaN or an infinity"),
        ((0, 0, 1.1), r"not perpendicular unit vectors: they are off by 0\.21"),
        ((2, 2, -1.0), "not a rigid transform .its determinant is -1: it mirrors"),
        ((slice(0, 3), slice(0, 3), 2.0 * np.eye(3)), "its rotation is scaled by 2; divide its nine numbers by that"),
        ((3, 3, 2.0), "its last row must be 0 0 0 1"),
    ],
)
def test_a_pose_must_be_a_rigid_transform(change: tuple[Any, Any, Any], why: str) -> None:
    check_pose("x", np.eye(4))
    pose = np.eye(4)
    pose[change[:2]] = change[2]
    with pytest.raises(ScanError, match=f"^x: .*{why}"):
        check_pose("x", pose)


def test_frames_are_read_by_number_with_their_colours_in_order(tmp_path: Path) -> None:
    images = []
    for number in range(2):
        color, depth = tmp_path / f"{number}.png", tmp_path / f"{number}d.png"
        cv2.imwrite(str(color), np.full((3, 4, 3), (1, 2, 100 + number), dtype=np.uint8))
        cv2.imwrite(str(depth), np.full((3, 4), 500, dtype=np.uint16))
        images.append((color, depth))

    def opened(width: int, depth_scale: float) -> PosedRgbd:
        intrinsics = Intrinsics(width, 3, 10, 10, 1.5, 1.0)
        items = tuple(Photograph(color, CameraModel(intrinsics), np.eye(4), depth, depth_scale) for color, depth in images)
        return PosedRgbd(Photographs(tmp_path, "own", items), intrinsics)

    rgbd = opened(4, 1000.0)
    assert len(rgbd) == 2 and [f.number for f in rgbd] == [0, 1] and rgbd[-1].number == 1
    assert rgbd[1].rgb[0, 0].tolist() == [101, 2, 1] and rgbd[1].depth[0, 0] == 0.5
    with pytest.raises(ScanError, match="has 4x3 pixels, the intrinsics are for 5x3"):
        _ = opened(5, 1000.0)[0]
    with pytest.raises(ScanError, match="depth scale is 0"):
        opened(4, 0.0)


def test_intrinsics_are_read_as_they_were_written(tmp_path: Path) -> None:
    written = Intrinsics(640, 480, 500.5, 501.5, 320.25, 239.75)
    write_intrinsics(tmp_path / "intrinsic.json", written)
    assert find_intrinsics(tmp_path, 1, 1) == (written, "intrinsic.json", ())
    assert find_intrinsics(tmp_path / "color", 1, 1) == (None, "", ())


def test_lines_leave_out_comments_and_keep_their_numbers(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("# head\n\n 1 2 \n#x\n3\n")
    assert read_lines(path) == [(3, "1 2"), (5, "3")]
    assert parse_numbers(path, 3, ["1", "2"], 2, "two") == [1.0, 2.0]
    with pytest.raises(ScanError, match=r"a\.txt:5: '3' must be two numbers"):
        parse_numbers(path, 5, ["3"], 2, "two numbers")


def test_stamps_are_associated_in_the_order_of_time() -> None:
    assert associate([2.0, 1.0, 0.0], [0.01, 1.01, 9.0], 0.02).tolist() == [[2, 0], [1, 1]]
    assert associate([], [1.0], 0.02).tolist() == []


def test_a_pose_before_the_first_is_the_first_within_the_tolerance() -> None:
    poses = np.stack([np.eye(4)] * 2)
    assert pose_at(np.array([1.0, 2.0]), poses, 0.985, 0.02) is not None
    assert pose_at(np.array([1.0, 2.0]), poses, 0.97, 0.02) is None
