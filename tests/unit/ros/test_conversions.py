"""Conversions of values to messages and back."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

from geometry_msgs.msg import Twist  # noqa: E402
from hypothesis import given, strategies as st  # noqa: E402

from gibson_sim.description.shapes import Appearance, Pattern, Shape, VisualSpec  # noqa: E402
from gibson_sim.errors import CommandError, SceneError  # noqa: E402
from gibson_sim.ros import conversions as c  # noqa: E402
from gibson_sim.scenes.spec import DrawnScene, LightSpec, PointLight, SplatsSpec  # noqa: E402
from gibson_sim.types import OUTPUTS, CameraSpec, DepthNoise, Frame, ImageEffects, Odometry, Pose, SceneState  # noqa: E402
from support.messages import odometry_to_msg  # noqa: E402

pytestmark = pytest.mark.ros


@given(st.integers(min_value=0, max_value=2**31 * 10**9 - 1))
def test_stamp_round_trip_loses_no_nanosecond(stamp_ns: int) -> None:
    assert c.time_from_msg(c.time_to_msg(stamp_ns)) == stamp_ns


APPEARANCE = Appearance(0.1, 0.7, 1.3, Pattern("checker", 2**40 + 1, ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6)), 0.7), None, 0.3)
LAMP = PointLight((1.1, 2.2, 3.3), (0.9, 0.8, 0.7), 1.7, 12.3, (0.1, 0.2, 0.3), (1.0, 0.0, -0.1), 0.4, 0.6)
LIGHT = LightSpec(
    (0.1, 0.0, -1.0), 0.55, 0.27, (0.5, 0.7, 1.0), (1.0, 0.9, 0.8), True, (LAMP, PointLight((0.0, 0.0, 0.0))), "/a/sky.hdr", 1.2, 0.3,
    False,
)  # fmt: skip


def _scene() -> DrawnScene:
    quarter = math.sqrt(0.5)
    return DrawnScene(
        name="s",
        revision=3,
        content_hash="abc",
        links=("robot/base", "robot/eye"),
        visuals=(
            VisualSpec(
                "wall", "", Shape("mesh", (1.0, 2.0, -1.0), "/a/b.glb"), Pose((1, 2, 3), (0, 0, quarter, quarter)), None, "wall"
            ),
            VisualSpec("body", "robot/base", Shape("cylinder", (0.2, 0.3, 0.0)), Pose(), (0.5, 0.25, 0.125, 1.0), "", APPEARANCE),
            VisualSpec("lid", "robot/base", Shape("box"), appearance=Appearance(metallic=0.1)),
            VisualSpec("finger", "robot/base", Shape("capsule", (0.1, 0.3, 0.0))),
            VisualSpec("egg", "robot/base", Shape("ellipsoid", (0.1, 0.2, 0.3))),
            VisualSpec("tip", "robot/base", Shape("cone", (0.1, 0.3, 0.0))),
        ),
        cameras=(CameraSpec("cam", "robot/eye", Pose((0.1, 0, 0)), 320, 200, 1.0, 0.1, 10.0, 15.0, ("depth",)),),
        light=LIGHT,
    )


def test_scene_round_trip_keeps_everything() -> None:
    assert c.scene_from_msg(c.scene_to_msg(_scene(), 5)) == _scene()


def test_splats_of_a_scene_are_kept() -> None:
    scene = replace(_scene(), splats=SplatsSpec("/a/room.spz", Pose((1.0, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8)), 0.25))
    msg = c.scene_to_msg(scene, 5)
    assert c.scene_from_msg(msg) == scene
    assert list(msg.instances) == list(scene.instances)  # they are none


def test_scene_with_an_index_out_of_range_is_refused() -> None:
    msg = c.scene_to_msg(_scene(), 5)
    msg.visuals[0].link = 9
    with pytest.raises(SceneError, match="link 9 is out of range, there are 2"):
        c.scene_from_msg(msg)


def test_state_round_trip_keeps_rows_in_place() -> None:
    links = ("robot/base", "robot/eye")
    state = SceneState(7_000_000_001, 4, 3, links, np.arange(6.0).reshape(2, 3), np.eye(4)[:2], np.arange(12.0).reshape(2, 6))
    msg = c.scene_state_to_msg(state, (0,))
    assert list(msg.poses) == [0, 1, 2, 1, 0, 0, 0, 3, 4, 5, 0, 1, 0, 0]
    back = c.scene_state_from_msg(msg, links)
    assert (back.stamp_ns, back.step, back.revision, list(msg.due_cameras)) == (7_000_000_001, 4, 3, [0])
    for name in ("positions", "quats_xyzw", "twists"):
        np.testing.assert_array_equal(getattr(back, name), getattr(state, name))


def test_frame_becomes_images_whose_bytes_stamp_and_frame_are_its_own() -> None:
    camera = CameraSpec("cam", "robot/eye", width=3, height=2)
    rgb = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    depth = np.array([[1.5, 2.5, np.inf], [0.25, 4.0, 5.0]], dtype=np.float32)
    msgs = dict(c.frame_to_image_msgs(Frame(camera, 1_500_000_000, np.eye(4), rgb, depth)))
    assert set(msgs) == {"rgb", "depth", "rgb_info", "depth_info"}
    for msg in msgs.values():
        assert (msg.header.stamp.sec, msg.header.stamp.nanosec, msg.header.frame_id) == (1, 500_000_000, "cam_optical_frame")
        assert (msg.height, msg.width) == (2, 3)
    assert (msgs["rgb"].encoding, msgs["rgb"].step, bytes(msgs["rgb"].data)) == ("rgb8", 9, bytes(range(18)))
    assert (msgs["depth"].encoding, msgs["depth"].step) == ("32FC1", 12)
    np.testing.assert_array_equal(c.array_from_image(msgs["depth"]), depth)
    np.testing.assert_array_equal(c.array_from_image(msgs["rgb"]), rgb)


def test_labels_and_normals_become_images_that_read_back_the_same() -> None:
    camera = CameraSpec("cam", "robot/eye", width=3, height=2, outputs=("semantic", "instance", "normal"))
    labels = np.array([[0, 1, 65535], [2, 3, 4]], dtype=np.uint16)
    normals = np.linspace(-1.0, 1.0, 18, dtype=np.float32).reshape(2, 3, 3)
    msgs = dict(
        c.frame_to_image_msgs(Frame(camera, 1, np.eye(4), semantic=labels, instance=labels + np.uint16(0), normal=normals))
    )
    assert set(msgs) == {"semantic", "instance", "normal", "semantic_info", "instance_info", "normal_info"}
    assert (msgs["semantic"].encoding, msgs["semantic"].step) == ("16UC1", 6)
    assert (msgs["normal"].encoding, msgs["normal"].step) == ("32FC3", 36)
    np.testing.assert_array_equal(c.array_from_image(msgs["instance"]), labels)
    np.testing.assert_array_equal(c.array_from_image(msgs["normal"]), normals)


def test_scene_message_names_classes_and_instances_in_the_order_of_their_numbers() -> None:
    msg = c.scene_to_msg(_scene(), 5)
    assert list(msg.semantic_classes) == ["unlabelled", "wall"]
    assert list(msg.instances) == ["", "wall", "robot"]


def test_camera_info_holds_the_intrinsics_of_the_spec() -> None:
    info = c.camera_info_to_msg(CameraSpec("cam", "l", width=640, height=480, fov_y=math.pi / 2), 0)
    np.testing.assert_allclose(info.k, [240, 0, 319.5, 0, 240, 239.5, 0, 0, 1])
    np.testing.assert_allclose(info.p, [240, 0, 319.5, 0, 0, 240, 239.5, 0, 0, 0, 1, 0])


def _calibrated(**changes: Any) -> CameraSpec:
    return CameraSpec("cam", "l", width=640, height=480, matrix=(310.0, 2.0, 320.5, 0.0, 300.0, 241.0, 0.0, 0.0, 1.0), **changes)


def test_camera_info_holds_matrix_and_distortion_as_they_were_given() -> None:
    d = (0.1, -0.2, 0.001, 0.002)
    info = c.camera_info_to_msg(_calibrated(distortion=d), 0)
    assert (info.distortion_model, list(info.d)) == ("plumb_bob", list(d))
    assert list(info.k) == [310, 2, 320.5, 0, 300, 241, 0, 0, 1]
    assert list(info.r) == [1, 0, 0, 0, 1, 0, 0, 0, 1]
    assert list(info.p) == [310, 2, 320.5, 0, 0, 300, 241, 0, 0, 0, 1, 0]


@pytest.mark.parametrize(
    ("changes", "model", "d"),
    [
        ({}, "plumb_bob", [0.0] * 5),
        ({"distortion": (0.1,) * 8}, "rational_polynomial", [0.1] * 8),
        ({"projection": "fisheye"}, "equidistant", [0.0] * 4),
        ({"projection": "fisheye", "distortion": (0.1,) * 4}, "equidistant", [0.1] * 4),
    ],
)
def test_camera_info_names_the_distortion_model(changes: dict[str, Any], model: str, d: list[float]) -> None:
    info = c.camera_info_to_msg(_calibrated(**changes), 0)
    assert (info.distortion_model, list(info.d)) == (model, d)


def test_camera_info_of_the_right_camera_of_a_pair_holds_the_baseline() -> None:
    # Tx = -310 px * 0.06 m.
    assert c.camera_info_to_msg(_calibrated(stereo_baseline=0.06), 0).p[3] == pytest.approx(-18.6)


def test_camera_info_of_an_equirectangular_camera_is_not_a_pinhole_calibration() -> None:
    info = c.camera_info_to_msg(CameraSpec("cam", "l", width=640, height=320, projection="equirectangular"), 0)
    assert (info.width, info.height, info.distortion_model, list(info.d)) == (640, 320, "equirectangular", [])
    assert not np.any([*info.k, *info.r, *info.p])


def test_scene_round_trip_keeps_every_setting_of_every_camera() -> None:
    cameras = (
        _calibrated(
            distortion=(0.1, 0.2, 0.3, 0.4, 0.5),
            samples=4,
            stereo_baseline=0.1,
            outputs=OUTPUTS,
            depth_noise=DepthNoise(**_numbers(DepthNoise)),
            fill="/a folder/net:1.onnx",
            fill_depth=True,
        ),
        CameraSpec("fish", "l", projection="fisheye", fov=3.5, effects=ImageEffects(**_numbers(ImageEffects))),
        CameraSpec("sphere", "l", projection="equirectangular", fill="push_pull"),
    )
    scene = DrawnScene("s", 1, "", ("l",), (), cameras, LightSpec())
    assert c.scene_from_msg(c.scene_to_msg(scene, 5)).cameras == cameras


def _numbers(kind: type) -> dict[str, Any]:
    """Returns values of all fields, none of them the default, near enough to it to be allowed."""
    return {
        f.name: f.default + i + 1 if isinstance(f.default, int) else f.default * 0.5 + 0.01 * (i + 1)
        for i, f in enumerate(fields(kind))
    }


def test_position_and_flow_become_images_that_read_back_the_same() -> None:
    camera = CameraSpec("cam", "robot/eye", width=3, height=2, outputs=("normal_world", "position", "flow"))
    triples = np.linspace(-1.0, 1.0, 18, dtype=np.float32).reshape(2, 3, 3)
    pairs = np.linspace(-5.0, 5.0, 12, dtype=np.float32).reshape(2, 3, 2)
    msgs = dict(c.frame_to_image_msgs(Frame(camera, 1, np.eye(4), normal_world=triples, position=triples * 2, flow=pairs)))
    assert {name: msg.encoding for name, msg in msgs.items() if not name.endswith("_info")} == {
        "normal_world": "32FC3", "position": "32FC3", "flow": "32FC2",
    }  # fmt: skip
    assert msgs["flow"].step == 24
    np.testing.assert_array_equal(c.array_from_image(msgs["normal_world"]), triples)
    np.testing.assert_array_equal(c.array_from_image(msgs["position"]), triples * 2)
    np.testing.assert_array_equal(c.array_from_image(msgs["flow"]), pairs)


def test_odometry_yaw_becomes_a_rotation_about_z() -> None:
    msg = odometry_to_msg(Odometry(1.0, 2.0, math.pi / 2, 0.3, 0.4), 10, "odom", "base_footprint")
    q = msg.pose.pose.orientation
    np.testing.assert_allclose([q.x, q.y, q.z, q.w], [0, 0, math.sqrt(0.5), math.sqrt(0.5)])
    assert (msg.twist.twist.linear.x, msg.twist.twist.angular.z, msg.child_frame_id) == (0.3, 0.4, "base_footprint")
    np.testing.assert_allclose(c.planar_from_odometry(msg), (1.0, 2.0, math.pi / 2, 10))


def test_twist_with_a_nan_is_refused() -> None:
    twist = Twist()
    twist.angular.z = math.nan
    with pytest.raises(CommandError, match="NaN"):
        c.velocity_from_msg(twist, 0)
