from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import ConfigError, GibsonSimError, RobotError
from gibson_sim.geometry.transforms import invert, matrix_from_pose, pose_from_xyz_rpy, transform_points
from gibson_sim.maps.floor_extent import extent_of_drawn, extent_of_triangles
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.load_views import load_camera_file, read_views
from gibson_sim.scenes.spec import DrawnScene, LightSpec, drawn_scene
from gibson_sim.scenes.views import FloorExtent, Follow, Orbit, Top, Views
from gibson_sim.types import NS_PER_S, CameraSpec, Pose, SceneState
from support.scenes import write_house

LINKS = ("left/base", "left/wheel", "right/base", "door/leaf")
FLOOR = FloorExtent((-1.0, 0.0), (5.0, 3.0), 0.5)
CAMERA = CameraSpec("eye", "eye", width=400, height=300)


def _scene(*cameras: CameraSpec, links: tuple[str, ...] = LINKS) -> DrawnScene:
    return DrawnScene("yard", 1, "", links, (), cameras, LightSpec())


def _state(stamp_ns: int = 0, **poses: Pose) -> SceneState:
    """Returns a state with the first links of bodies at given poses."""
    rows = [poses.get(link.partition("/")[0], Pose()) for link in LINKS]
    positions, quats = np.array([p.position for p in rows]), np.array([p.quat_xyzw for p in rows])
    return SceneState(stamp_ns, 0, 1, LINKS, positions, quats, np.zeros((len(rows), 6)))


def _views(text: str, scene: DrawnScene | None = None) -> Views:
    return Views(read_views(text, (400, 300), 10.0), scene or _scene(), "left", lambda: FLOOR)


def _pixel(camera: CameraSpec, pose: Pose, point: tuple[float, float, float]) -> tuple[float, float]:
    x, y, z = transform_points(invert(matrix_from_pose(pose)), [point])[0]
    u, v, w = camera.intrinsics() @ (x, y, z)
    assert z > 0.0
    return float(u / w), float(v / w)


def test_a_chase_camera_is_behind_and_above_the_robot_and_centres_it() -> None:
    view = Follow(distance=2.0, height=1.5, look_at=0.5)
    pose = view.camera_pose(pose_from_xyz_rpy((1.0, 2.0, 0.1), (0.0, 0.0, math.pi / 2)), 0)
    assert pose.position == pytest.approx((1.0, 0.0, 1.6))
    assert _pixel(CAMERA, pose, (1.0, 2.0, 0.6)) == pytest.approx((199.5, 149.5))
    u, v = _pixel(CAMERA, pose, (1.3, 2.0, 0.9))
    assert u > 199.5 and v < 149.5, "right of the robot is on the right, and what is higher is above"


def test_a_chase_camera_of_a_tipping_robot_stays_level() -> None:
    tipped = matrix_from_pose(Follow().camera_pose(pose_from_xyz_rpy((0.0, 0.0, 0.0), (0.4, -0.6, 0.3)), 0))
    assert tipped[2, 0] == pytest.approx(0.0, abs=1e-12)
    assert tipped[0, 3] == pytest.approx(-1.8 * math.cos(math.atan2(tipped[1, 3], tipped[0, 3]) + math.pi))


def test_a_chase_camera_hides_objects_in_between_but_never_the_floor() -> None:
    view = Follow()
    _, near = view.resolve(CAMERA, lambda: FLOOR)
    pose = view.camera_pose(Pose(), 0)
    lowest = np.linalg.inv(CAMERA.intrinsics()) @ (199.5, 299.0, 1.0)
    down = matrix_from_pose(pose)[:3, :3] @ lowest
    assert 1.0 < near < pose.position[2] / -down[2], "along the axis, up to the floor in the lowest row"
    assert near < math.hypot(1.8, 1.2) - 0.5


def test_an_orbit_takes_its_period_and_repeats_to_the_bit() -> None:
    view = Orbit(period=8.0, distance=2.0, height=1.0, look_at=0.0)
    at = [view.camera_pose(pose_from_xyz_rpy((1.0, 1.0, 0.0), (0.0, 0.0, 2.0)), s * NS_PER_S) for s in (0, 2, 10)]
    assert at[0].position == pytest.approx((3.0, 1.0, 1.0)) and at[1].position == pytest.approx((1.0, 3.0, 1.0))
    assert at[1] == at[2]
    backwards = Orbit(period=-8.0, distance=2.0, height=1.0).camera_pose(Pose(), 2 * NS_PER_S)
    assert backwards.position == pytest.approx((0.0, -2.0, 1.0))


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 30.0])
def test_a_view_from_the_top_shows_the_whole_floor_and_cuts_it_open(yaw_deg: float) -> None:
    path, near = Top(yaw=math.radians(yaw_deg)).resolve(CAMERA, lambda: FLOOR)
    pose = path.camera_pose(Pose(), 0)
    assert pose.position[2] - near == pytest.approx(FLOOR.z + 2.1)
    corners = [_pixel(CAMERA, pose, (x, y, FLOOR.z + 2.1)) for x in (-1.0, 5.0) for y in (0.0, 3.0)]
    assert all(0.0 <= u <= 399.0 and 0.0 <= v <= 299.0 for u, v in corners)
    assert max(u for u, _ in corners) > 380.0 or max(v for _, v in corners) > 280.0, "and hardly more than it"


def test_up_in_a_view_from_the_top_is_the_worlds_y() -> None:
    pose = Top().resolve(CAMERA, lambda: FLOOR)[0].camera_pose(Pose(), 0)
    assert _pixel(CAMERA, pose, (2.0, 2.5, 0.5))[1] < 149.5 < _pixel(CAMERA, pose, (4.0, 1.5, 0.5))[0]


def test_a_view_from_above_a_robot_goes_with_it_and_shows_its_span() -> None:
    path, _ = Top(target="robot", span=4.0, cut=1.0).resolve(CAMERA, lambda: FLOOR)
    pose = path.camera_pose(pose_from_xyz_rpy((1.0, 2.0, 0.0), (0.0, 0.0, 1.0)), 0)
    assert _pixel(CAMERA, pose, (-1.0, 2.0, 1.0)) == pytest.approx((-0.5, 149.5))


def test_views_are_links_of_their_own_behind_those_of_bodies() -> None:
    views = _views("follow,top:door,orbit:right", _scene(CameraSpec("left/camera", "left/base")))
    names = ("view_follow", "view_top_door", "view_orbit_right")
    assert views.scene.links == (*LINKS, *names)
    assert [(c.name, c.width, c.rate_hz) for c in views.scene.cameras[1:]] == [(name, 400, 10.0) for name in names]
    state = _state(left=pose_from_xyz_rpy((3.0, 0.0, 0.0)), right=pose_from_xyz_rpy((0.0, 7.0, 0.0)))
    extended = views.extended(state)
    assert extended.links == views.scene.links and state.links == LINKS
    assert (extended.positions[:4] == state.positions).all()
    assert extended.positions[4:] == pytest.approx(
        np.array([[1.2, 0.0, 1.5], [0.0, 0.0, extended.positions[5, 2]], [2.2, 7.0, 1.8]])
    )


def test_a_view_may_go_with_a_single_link() -> None:
    assert not _views("top:left/wheel").absent
    assert _views("top:left/wheel").cameras[0].name == "view_top_left_wheel"


def test_a_view_without_its_target_is_left_out_with_the_reason() -> None:
    views = _views("follow:right,top", _scene(links=("left/base",)))
    assert [camera.name for camera in views.cameras] == ["view_top"]
    assert views.absent == {"view_follow_right": "view 'view_follow_right': there is no body 'right'; it can follow: left"}


def test_a_view_does_not_take_the_name_of_a_camera() -> None:
    assert (
        "already has a camera of this name"
        in _views("follow", _scene(CameraSpec("view_follow", "left/base"))).absent["view_follow"]
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fly", "view 'fly' is not known; give follow, orbit, top"),
        ("follow:", "view 'follow:' is not known"),
        ("top,top", "names must be unique"),
        ("nowhere.yaml", "cannot be read"),
    ],
)
def test_an_invalid_list_is_refused_with_a_reason(text: str, words: str) -> None:
    with pytest.raises(GibsonSimError, match=words):
        read_views(text)


def test_a_file_sets_every_field_of_a_view(tmp_path: Path) -> None:
    path = tmp_path / "views.yaml"
    path.write_text(
        "cameras:\n"
        "- {name: behind, view: {kind: follow, target: left, distance: 3, yaw_deg: 90}, width: 64, rate_hz: 5, near: 0.2, outputs: [depth]}\n"
        "- {name: round, view: {kind: orbit, center: [1, 2, 0]}}\n"
        "- {name: still, link: map, pose: {xyz: [1, 2, 3], rpy_deg: [0, 0, 0]}, fov_y_deg: 40}\n"
        "- {name: plan, view: top}\n"
    )
    behind, around, still, plan = read_views(str(path), (320, 240), 7.0)
    assert behind.motion == Follow("left", distance=3.0, yaw=math.pi / 2)
    assert (behind.camera.width, behind.camera.height, behind.camera.rate_hz) == (64, 240, 5.0)
    assert (behind.camera.near, behind.near_requested, behind.camera.outputs) == (0.2, True, ("depth",))
    assert around.motion == Orbit("", center=(1.0, 2.0, 0.0)) and around.camera.outputs == ("rgb",)
    pose = still.motion.resolve(still.camera, lambda: FLOOR)[0].camera_pose(Pose(), 0)
    assert pose.position == (1.0, 2.0, 3.0) and matrix_from_pose(pose)[:3, 2] == pytest.approx((1.0, 0.0, 0.0))
    assert plan.motion == Top() and plan.camera.fov_y == pytest.approx(math.radians(30.0))


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("view: {kind: follow, radius: 3}", "key 'radius' is unknown"),
        ("view: {kind: fly}", "kind is 'fly', must be one of follow, orbit, top"),
        ("view: {kind: orbit, period: 0}", "period is 0 s, must be 0.1"),
        ("view: {kind: orbit, target: left, center: [0, 0, 0]}", "give one of the two"),
        ("view: {kind: top, center: [0, 0, 0]}", "center has 3 numbers, must have 2 for kind 'top'"),
        ("view: {kind: follow, distance: 0}", "distance is 0 m"),
        ("view: follow, link: left/base", "a view has no link"),
        ("link: left/base", "a view has the key 'view', or link: map"),
        ("view: follow, width: 0", "image size is 0x480"),
    ],
)
def test_an_invalid_entry_is_refused_with_a_reason(tmp_path: Path, entry: str, words: str) -> None:
    path = tmp_path / "views.yaml"
    path.write_text(f"cameras:\n- {{name: eye, {entry}}}\n")
    with pytest.raises(RobotError, match=words):
        read_views(str(path))


def test_a_file_may_hold_cameras_on_links_and_views(tmp_path: Path) -> None:
    path = tmp_path / "cameras.yaml"
    path.write_text("cameras:\n- {name: eye, link: left/base}\n- {name: behind, view: follow}\n")
    cameras, views = load_camera_file(path, LINKS)
    assert [camera.link for camera in cameras] == ["left/base"] and [view.camera.name for view in views] == ["behind"]


def test_a_fisheye_does_not_look_down_on_a_floor() -> None:
    camera = CameraSpec("eye", "eye", projection="fisheye")
    with pytest.raises(ConfigError, match="a view from the top must be pinhole, its projection is fisheye"):
        Top().resolve(camera, lambda: FLOOR)


@pytest.mark.parametrize("size", ["640", "640x", "0x480", "640x480x3", "axb"])
def test_an_invalid_size_is_refused(size: str) -> None:
    with pytest.raises(ConfigError, match="must be WIDTHxHEIGHT"):
        PhysicsConfig.of(view_size=size)


def test_a_floor_reaches_as_far_as_its_walls_and_not_as_its_lawn() -> None:
    lawn = [(-20.0, -20.0, 0.0), (20.0, -20.0, 0.0), (0.0, 20.0, 0.0)]
    wall = [(0.0, 1.0, 0.0), (4.0, 1.0, 0.0), (4.0, 3.0, 2.5)]
    found = extent_of_triangles(np.array(lawn + wall), [(0, 1, 2), (3, 4, 5)], 0.0)
    assert found.high[0] == pytest.approx(4.0) and found.low[1] > 1.0 and found.high[1] < 3.0
    assert extent_of_triangles(np.array(lawn), [(0, 1, 2)], 0.0).low == (-20.0, -20.0)


@pytest.mark.parametrize(("robot_z", "floor_z"), [(None, 0.0), (0.05, 0.0), (0.8, 0.0), (2.5, 0.0), (2.95, 3.0), (3.1, 3.0)])
def test_a_recorded_house_is_seen_on_the_floor_of_its_robot(robot_z: float | None, floor_z: float, tmp_path: Path) -> None:
    house = drawn_scene(load_scene(write_house(tmp_path)), ())
    assert extent_of_drawn(house, robot_z).z == pytest.approx(floor_z, abs=1e-6)
