"""Reading robot.yaml."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.urdf import read_urdf
from gibson_sim.errors import RobotError
from gibson_sim.geometry.transforms import matrix_from_quat, pose_from_xyz_rpy
from gibson_sim.robots.load import find_robot_file, load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.types import DepthNoise, ImageEffects

Load = Callable[..., RobotSpec]
URDF = """<robot name="r"><link name="base"><collision>
<origin xyz="0.1 0 0.2"/><geometry><box size="0.4 0.6 0.2"/></geometry></collision></link>
<link name="l"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
<link name="r"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
<link name="eye"/><link name="eye_optical_frame"/>
<joint name="jl" type="continuous"><parent link="base"/><child link="l"/><origin xyz="0 0.2 0.05"/>
<axis xyz="0 {left_axis} 0"/></joint>
<joint name="jr" type="continuous"><parent link="base"/><child link="r"/><origin xyz="0 -0.2 0.05"/><axis xyz="0 1 0"/></joint>
<joint name="je" type="fixed"><parent link="base"/><child link="eye"/><origin xyz="0 0 0.3"/></joint>
<joint name="jo" type="fixed"><parent link="eye"/><child link="eye_optical_frame"/><origin rpy="-1.5707963 0 -1.5707963"/></joint>
</robot>"""
DRIVE = "drive: {type: differential, left_joint: jl, right_joint: jr}\n"


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def _load(text: str, left_axis: int = 1) -> RobotSpec:
        (tmp_path / "r.urdf").write_text(URDF.format(left_axis=left_axis))
        (tmp_path / "robot.yaml").write_text("urdf: r.urdf\n" + text)
        return load_robot(tmp_path, name="bob")

    return _load


def test_wheels_are_measured_in_the_urdf(load: Load) -> None:
    drive = load(DRIVE).drive
    assert (drive.wheel_radius, drive.wheel_separation) == pytest.approx((0.05, 0.4))


def test_given_wheel_radius_wins(load: Load) -> None:
    assert load("drive: {type: differential, left_joint: jl, right_joint: jr, wheel_radius: 0.06}\n").drive.wheel_radius == 0.06


def test_joint_axis_that_points_right_changes_the_sign(load: Load) -> None:
    drive = load(DRIVE, left_axis=-1).drive
    assert (drive.left_signs, drive.right_signs) == ((-1.0,), (1.0,))


def test_radius_reaches_the_farthest_corner(load: Load) -> None:
    # The box spans x -0.1 to 0.3, y -0.3 to 0.3, up to z 0.3.
    robot = load("")
    assert (robot.radius, robot.height) == pytest.approx((math.hypot(0.3, 0.3), 0.3))


def test_links_carry_the_body_name_where_the_scene_needs_it(load: Load) -> None:
    robot = load("cameras: [{name: cam, link: eye_optical_frame}]\nlidar: {link: eye}\n")
    assert (robot.cameras[0].link, robot.sensors.lidars[0].link) == ("bob/eye_optical_frame", "bob/eye")
    assert robot.links[0] == "base"


def test_fixed_and_moving_joints_are_distinguished(load: Load) -> None:
    robot = load("")
    assert [(parent, child) for parent, child, _ in robot.fixed_transforms] == [("base", "eye"), ("eye", "eye_optical_frame")]
    assert robot.moving_joints == (("jl", "base", "l"), ("jr", "base", "r"))


def test_camera_angles_are_degrees_in_the_file(load: Load) -> None:
    assert load("cameras: [{name: c, link: eye_optical_frame, fov_y_deg: 90}]\n").cameras[0].fov_y == pytest.approx(math.pi / 2)


def test_camera_may_have_the_calibration_of_a_real_one(load: Load) -> None:
    text = "cameras: [{name: c, link: eye, k: {fx: 310, fy: 300, cx: 320.5, cy: 241, skew: 2}, "
    camera = load(text + "distortion_model: plumb_bob, d: [0.1, -0.2, 0.001, 0.002, 0.05]}]\n").cameras[0]
    assert camera.intrinsics().tolist() == [[310.0, 2.0, 320.5], [0.0, 300.0, 241.0], [0.0, 0.0, 1.0]]
    assert (camera.distortion, camera.distortion_model) == ((0.1, -0.2, 0.001, 0.002, 0.05), "plumb_bob")
    rows = load("cameras: [{name: c, link: eye, k: [310, 2, 320.5, 0, 300, 241, 0, 0, 1]}]\n").cameras[0]
    assert rows.matrix == camera.matrix


def test_fisheye_has_its_full_angle_in_degrees(load: Load) -> None:
    text = (
        "cameras: [{name: c, link: eye, projection: fisheye, fov_deg: 220, d: [0.1, 0, 0, 0], distortion_model: equidistant}]\n"
    )
    camera = load(text).cameras[0]
    assert (camera.projection, camera.fov) == ("fisheye", pytest.approx(math.radians(220)))
    assert camera.distortion == (0.1, 0.0, 0.0, 0.0)


def test_holes_are_filled_on_request_and_invented_depth_is_marked(load: Load, tmp_path: Path) -> None:
    camera = load("cameras: [{name: c, link: eye, fill: push_pull, fill_depth: true}]\n").cameras[0]
    assert (camera.fill, camera.fill_depth, camera.outputs) == ("push_pull", True, ("rgb", "depth", "hole"))
    assert load("cameras: [{name: c, link: eye, fill: off}]\n").cameras[0].fill == ""
    assert load("cameras: [{name: c, link: eye}]\n").cameras[0].fill == ""
    camera = load('cameras: [{name: c, link: eye, fill: "learned,depth"}]\n').cameras[0]
    assert (camera.fill, camera.fill_depth) == ("learned", True), "as --camera-fill"


def test_a_network_that_fills_holes_is_found_beside_the_file(load: Load, tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"fill: there is no file '/.*/net\.onnx'; give an ONNX file, or push_pull, learned"):
        load("cameras: [{name: c, link: eye, fill: net.onnx}]\n")
    (tmp_path / "net.onnx").touch()
    for fill in ("net.onnx", str(tmp_path / "net.onnx")):
        assert load(f"cameras: [{{name: c, link: eye, fill: {fill}}}]\n").cameras[0].fill == str(tmp_path / "net.onnx")


def test_camera_effects_and_depth_noise_come_from_their_sections(load: Load) -> None:
    text = "cameras: [{name: c, link: eye, samples: 4, stereo_baseline: 0.06, effects: {exposure_ev: 1, seed: 7}, "
    camera = load(text + "depth_noise: {quadratic: 0.002, hole_fraction: 0.1}}]\n").cameras[0]
    assert (camera.samples, camera.stereo_baseline) == (4, 0.06)
    assert camera.effects == ImageEffects(exposure_ev=1.0, seed=7)
    assert camera.depth_noise == DepthNoise(quadratic=0.002, hole_fraction=0.1)


def test_camera_on_a_plain_link_looks_along_x(load: Load) -> None:
    pose = load("cameras: [{name: c, link: eye}]\n").cameras[0].pose
    assert matrix_from_quat(pose.quat_xyzw) @ [0, 0, 1] == pytest.approx([1, 0, 0], abs=1e-12)
    assert matrix_from_quat(pose.quat_xyzw) @ [0, 1, 0] == pytest.approx([0, 0, -1], abs=1e-12)


def test_camera_pitched_down_looks_down(load: Load) -> None:
    pose = load("cameras: [{name: c, link: eye, pose: {xyz: [0.1, 0.2, 0.3], rpy_deg: [0, 90, 0]}}]\n").cameras[0].pose
    assert pose.position == pytest.approx((0.1, 0.2, 0.3))
    assert matrix_from_quat(pose.quat_xyzw) @ [0, 0, 1] == pytest.approx([0, 0, -1], abs=1e-12)


def test_camera_on_an_optical_link_is_that_link(load: Load) -> None:
    assert load("cameras: [{name: c, link: eye_optical_frame}]\n").cameras[0].pose.quat_xyzw == (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("camera: []\n", "did you mean 'cameras'"),
        ("cameras: [{name: c, link: eye, fovy_deg: 60}]\n", "did you mean 'fov_y_deg'"),
        ("cameras: [{name: c, link: eye, fov_deg: 60}]\n", "fov_deg is for a fisheye camera; a pinhole camera has fov_y_deg"),
        ("cameras: [{name: c, link: eye, projection: fisheye, fov_y_deg: 60}]\n", "a fisheye has fov_deg"),
        ("cameras: [{name: c, link: eye, projection: fish}]\n", "must be one of pinhole, fisheye, equirectangular"),
        ("cameras: [{name: c, link: eye, projection: fisheye, fov_deg: 400}]\n", "fov is 6.98132 rad, must be in (0, 2 pi]"),
        ("cameras: [{name: c, link: eye, k: {fx: 1, fy: 1, cx: 0}}]\n", "cy is missing"),
        ("cameras: [{name: c, link: eye, k: {fx: 1, fy: 1, cx: 0, c_y: 2}}]\n", "did you mean 'cy'"),
        ("cameras: [{name: c, link: eye, k: [1, 2]}]\n", "nine finite numbers"),
        ("cameras: [{name: c, link: eye, k: }]\n", "k is empty"),
        ("cameras: [{name: c, link: eye, k: [1, 0, 0, 0, 1, 0, 0, 0, 1], fov_y_deg: 60}]\n", "leave one out"),
        ("cameras: [{name: c, link: eye, d: [0.1, 0, 0, 0]}]\n", "belong together"),
        ("cameras: [{name: c, link: eye, d: [0.1, 0], distortion_model: plumb_bob}]\n", "d has 2 numbers, plumb_bob has 4 or 5"),
        ("cameras: [{name: c, link: eye, d: [0, 0, 0, 0], distortion_model: equidistant}]\n", "plumb_bob or rational_polynomial"),
        ("cameras: [{name: c, link: eye, d: [0, 0, .inf, 0], distortion_model: plumb_bob}]\n", "finite"),
        ("cameras: [{name: c, link: eye, samples: 3}]\n", "camera 'c': samples is 3, must be 1 or 4"),
        ("cameras: [{name: c, link: eye, effects: {exposure: 2}}]\n", "did you mean 'exposure_ev'"),
        ("cameras: [{name: c, link: eye, depth_noise: {seed: 1.5}}]\n", "whole number"),
        (
            "cameras: [{name: c, link: eye, fill: telea}]\n",
            "cameras[0]: fill is 'telea', must be none, push_pull, learned or the path of an ONNX file",
        ),
        (
            "cameras: [{name: c, link: eye, fill: true}]\n",
            "cameras[0]: fill is True, must be none, push_pull, learned or the path of an ONNX file",
        ),
        ("cameras: [{name: c, link: eye, fill_depth: true}]\n", "fill_depth is set without fill"),
        ("cameras: [{name: c, link: ey}]\n", "no link 'ey'; known: base"),
        ("cameras: [{name: c, link: eye}, {name: c, link: eye}]\n", "names must be unique"),
        ("cameras: [{name: c, link: eye_optical_frame, pose: {}}]\n", "a pose is not allowed"),
        ("cameras: [{name: c, link: eye, width: 1.5}]\n", "whole number"),
        ("cameras: [{name: c, link: eye, fov_y_deg: 200}]\n", "fov_y"),
        ("cameras: [{name: c, link: eye, outputs: [sound]}]\n", "outputs"),
        ("lidar: {link: eye, range_min: 5, range_max: 2}\n", "range_min"),
        ("lidar: {link: eye, beams: .nan}\n", "finite"),
        ("base_link: l\n", "must be the root link"),
        ("drive: {type: tank}\n", "'tank', must be one of differential, skid_steer, omni, ackermann"),
        ("drive: {type: differential, left_joint: jr, right_joint: jl}\n", "swapped"),
        ("drive: {type: differential, left_joint: je, right_joint: jr}\n", "cannot drive"),
        ("drive: {type: differential, left_joint: jl, right_joint: jr, max_linear: -1}\n", "max_linear"),
        ("drive: [\n", "not YAML"),
    ],
)
def test_wrong_setting_is_refused_in_one_line(load: Load, text: str, words: str) -> None:
    with pytest.raises(RobotError) as error:
        load(text)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_body_name_must_be_a_ros_name(root: Path) -> None:
    with pytest.raises(RobotError, match="'my robot'"):
        load_robot(root / "config/robots/gibson_bot", name="my robot")


def test_name_is_looked_up_by_the_given_function(root: Path) -> None:
    folder = root / "config/robots/gibson_bot"
    assert load_robot("any", find=lambda name: folder).urdf == folder / "gibson_bot.urdf"


def test_unknown_name_is_refused() -> None:
    with pytest.raises(RobotError, match="'gibson_bt'"):
        load_robot("gibson_bt")


def test_start_pose_is_kept(root: Path) -> None:
    start = pose_from_xyz_rpy((1.0, 2.0, 3.0), (0.0, 0.0, 1.0))
    assert load_robot(root / "config/robots/gibson_bot", start=start).start == start


def test_gibson_bot_is_what_its_documentation_says(root: Path) -> None:
    robot = load_robot(root / "config/robots/gibson_bot")
    assert (robot.drive.wheel_radius, robot.drive.wheel_separation) == pytest.approx((0.036, 0.23))
    assert robot.radius == pytest.approx(0.175)
    camera = robot.cameras[0]
    assert (camera.name, camera.width, camera.height, camera.rate_hz) == ("camera", 640, 480, 30.0)
    assert all(visual.shape.kind != "mesh" for visual in robot.visuals)
    T_base_camera = read_urdf(robot.urdf).transforms()["camera_optical_frame"]
    assert 0.25 <= T_base_camera[2, 3] <= 0.30
    # Level: forward is along x, and down in the image is down in the world.
    assert T_base_camera[:3, :3] @ np.array([0, 0, 1]) == pytest.approx([1, 0, 0], abs=1e-9)
    assert T_base_camera[:3, :3] @ np.array([0, 1, 0]) == pytest.approx([0, 0, -1], abs=1e-9)


def test_gibson_bot_camera_does_not_see_the_robot(root: Path) -> None:
    robot = load_robot(root / "config/robots/gibson_bot")
    camera = robot.cameras[0]
    transforms = read_urdf(robot.urdf).transforms()
    eye = transforms["camera_optical_frame"][:3, 3]
    slope = math.tan(camera.fov_y / 2)
    for visual in robot.visuals:
        T = transforms[visual.link.partition("/")[2]]
        centre = T[:3, :3] @ np.array(visual.pose.position) + T[:3, 3]
        size = visual.shape.size
        reach = max(size) / 2 if visual.shape.kind == "box" else max(size[0], size[1] / 2)
        # Whatever lies ahead of the lens must lie below the lower edge of the picture.
        ahead = centre[0] + reach - eye[0]
        half_height = {"box": size[2] / 2, "sphere": size[0], "cylinder": size[1] / 2}[visual.shape.kind]
        below = eye[2] - (centre[2] + half_height)
        assert ahead <= 0.05 or below > ahead * slope, visual.name


@pytest.mark.parametrize("name", ["~no_such_user/robot.yaml", "~no_such_user/x", "~no_such_user/a.urdf"])
def test_home_of_an_unknown_user_is_a_path_without_a_robot(name: str) -> None:
    with pytest.raises(RobotError, match=f"no robot at {name}"):
        find_robot_file(name)


def test_a_robot_whose_meshes_are_all_missing_is_reported(tmp_path: Path) -> None:
    mesh = '<geometry><mesh filename="package://nowhere/x.stl"/></geometry>'
    (tmp_path / "r.urdf").write_text(f'<robot name="r"><link name="base"><collision>{mesh}</collision></link></robot>')
    (tmp_path / "robot.yaml").write_text("urdf: r.urdf\n")
    with pytest.raises(
        RobotError, match=r"nothing is left to measure: r.urdf: link 'base': collision: mesh package://nowhere/x.stl does not"
    ):
        load_robot(tmp_path)
