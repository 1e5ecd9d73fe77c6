"""The topics of cameras: formats, stamps and frames; drawing on demand; scenes that change. No physics: states are made here."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.simulation import PATIENCE_S, require, wait_until

require("rclpy", "gibson_msgs")

import rclpy  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from rclpy.duration import Duration  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data  # noqa: E402
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2  # noqa: E402

from gibson_msgs.msg import Scene, SceneState  # noqa: E402
from gibson_sim.description.shapes import Shape, VisualSpec  # noqa: E402
from gibson_sim.errors import ConfigError, GibsonSimError, GraphicsUnavailableError  # noqa: E402
from gibson_sim.render.context import open_context  # noqa: E402
from gibson_sim.resources import find_robot  # noqa: E402
from gibson_sim.robots.load import load_robot  # noqa: E402
from gibson_sim.ros import conversions  # noqa: E402
from gibson_sim.ros.nodes import node_main  # noqa: E402
from gibson_sim.ros.nodes.render_node import RenderNode  # noqa: E402
from gibson_sim.ros.nodes.snapshot_node import SnapshotNode  # noqa: E402
from gibson_sim.ros.topics import qos  # noqa: E402
from gibson_sim.scenes.spec import DrawnScene, LightSpec, SplatsSpec  # noqa: E402
from gibson_sim.sensors.image_codecs import encode_color  # noqa: E402
from gibson_sim.types import OUTPUTS, CameraSpec, Pose, SceneState as State, Vec3  # noqa: E402
from render.drawing import AHEAD  # noqa: E402
from support.filler_networks import network_that_fails_with_holes  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.egl]

TICK_NS = 100_000_000
RED = (1.0, 0.0, 0.0, 1.0)
BLUE = (0.0, 0.0, 1.0, 1.0)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DARK = LightSpec(background=(0.0, 0.0, 0.0))
EYE = CameraSpec("eye", "", AHEAD, 64, 48, rate_hz=10.0, outputs=OUTPUTS)
"""At the origin, looking along +x, ten images a second."""
LABELS = conversions.label_info_type()


@pytest.fixture(scope="module", autouse=True)
def _egl() -> None:
    try:
        open_context().close()
    except GraphicsUnavailableError as error:
        pytest.skip(f"SKIPPED: {error}")


def _box(name: str, position: Vec3, color: Any = RED, link: str = "", label: str = "") -> VisualSpec:
    return VisualSpec(name, link, Shape("box", (0.2, 2.0, 2.0)), Pose(position), color, label)


WALL = _box("wall", (2.1, 1.0, 0.0), RED, label="wall")
"""Fills the left half of the picture (+y is left), its front 2 m away."""


def _scene(*cameras: CameraSpec, visuals: tuple[VisualSpec, ...] = (WALL,), revision: int = 1) -> DrawnScene:
    links = tuple(dict.fromkeys(v.link for v in visuals if v.link))
    return DrawnScene("test", revision, "", links, visuals, cameras, DARK)


class Rig:
    """Render nodes, and a node that plays the physics node and the user, all in one thread."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        self.context.init()
        self.user = Node("user", context=self.context, use_global_arguments=False)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.user)
        self._scenes = self.user.create_publisher(Scene, "scene", qos.LATCHED)
        self._states = self.user.create_publisher(SceneState, "scene_state", qos.STATE)
        self.renders: list[RenderNode] = []
        self._others: list[Node] = []
        self.stamp_ns = 0
        self.scene = _scene()

    def render(self, *arguments: str, **parameters: Any) -> RenderNode:
        overrides = [Parameter(name, value=value) for name, value in {"cache": "none", **parameters}.items()]
        node = RenderNode(
            context=self.context, use_global_arguments=False, cli_args=["--ros-args", *arguments] if arguments else None,
            parameter_overrides=overrides,
        )  # fmt: skip
        self.renders.append(node)
        self._executor.add_node(node)
        return node

    def add(self, node: Node) -> None:
        self._others.append(node)
        self._executor.add_node(node)

    def remove(self, node: Node) -> None:
        """Spins a node no longer."""
        self._executor.remove_node(node)

    def is_delivered(self) -> bool:
        """Waits until all states are in the queues of the render nodes; returns whether they are."""
        return bool(self._states.wait_for_all_acked(Duration(seconds=PATIENCE_S)))

    def load(self, scene: DrawnScene, *, ready: bool = True) -> None:
        """Sends a scene and, if requested, waits until all render nodes subscribe to its states."""
        self.scene = scene
        self._scenes.publish(conversions.scene_to_msg(scene, self.stamp_ns))
        if ready:
            self.spin_until(lambda: self._states.get_subscription_count() == len(self.renders), "render nodes that are ready")

    def collect(self, message_type: Any, topic: str, profile: Any = 50) -> list[Any]:
        messages: list[Any] = []
        self.user.create_subscription(message_type, topic, messages.append, profile)
        return messages

    def tick(self, positions: dict[str, Vec3] | None = None) -> int:
        """Sends the next state, at which all cameras are due; returns its stamp."""
        self.stamp_ns += TICK_NS
        links = self.scene.links
        places = np.array([(positions or {}).get(link, (3.0, 0.0, 0.0)) for link in links]).reshape(-1, 3)
        state = State(
            self.stamp_ns, 0, self.scene.revision, links, places, np.tile((0.0, 0.0, 0.0, 1.0), (len(links), 1)), np.zeros((len(links), 6))
        )  # fmt: skip
        self._states.publish(conversions.scene_state_to_msg(state, tuple(range(len(self.scene.cameras)))))
        return self.stamp_ns

    def spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.02)

    def spin_until(
        self, condition: Callable[[], bool], what: str, *, ticking: bool = False, positions: dict[str, Vec3] | None = None
    ) -> None:
        def done() -> bool:
            if ticking:
                self.tick(positions)
            for _ in range(3):
                self.spin()
            return condition()

        wait_until(done, what)

    def tick_until(self, condition: Callable[[], bool], what: str, positions: dict[str, Vec3] | None = None) -> None:
        self.spin_until(condition, what, ticking=True, positions=positions)

    def drawn_after(self, ticks: int) -> dict[str, Any]:
        """Returns the summary of the first render node after some more ticks, seen by it for sure."""
        infos = self.collect(CameraInfo, f"{self.scene.cameras[0].name}/camera_info")
        self.tick_until(lambda: len(infos) >= ticks, "camera_info")
        return self.renders[0].summary()

    def close(self) -> None:
        self._executor.shutdown()
        for node in (*self.renders, *self._others, self.user):
            if isinstance(node, RenderNode):
                node.close()
            node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def rig(ros_domain: int) -> Iterator[Rig]:
    made = Rig()
    yield made
    made.close()


def _stamp(message: Any) -> int:
    return int(conversions.time_from_msg(message.header.stamp))


def test_all_topics_of_a_camera_carry_one_stamp_and_its_frame(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE))
    topics: dict[str, list[Any]] = {}
    for output in OUTPUTS:
        folder = "eye" if output == "rgb" else f"eye/{output}"
        topics[f"{folder}/image_raw"] = rig.collect(Image, f"{folder}/image_raw")
        topics[f"{folder}/camera_info"] = rig.collect(CameraInfo, f"{folder}/camera_info")
    topics["compressed"] = rig.collect(CompressedImage, "eye/image_raw/compressed")
    topics["compressedDepth"] = rig.collect(CompressedImage, "eye/depth/image_raw/compressedDepth")
    topics["points"] = rig.collect(PointCloud2, "eye/depth/points")

    def common() -> set[int]:
        return set.intersection(*({_stamp(m) for m in messages} for messages in topics.values()))

    rig.tick_until(lambda: bool(common()), "a stamp that all topics have")
    assert all(stamp % TICK_NS == 0 for messages in topics.values() for stamp in map(_stamp, messages))
    assert {m.header.frame_id for messages in topics.values() for m in messages} == {"eye_optical_frame"}
    encodings = {topic: messages[0].encoding for topic, messages in topics.items() if topic.endswith("image_raw")}
    assert encodings["eye/image_raw"] == "rgb8"
    assert encodings["eye/depth/image_raw"] == "32FC1"
    assert encodings["eye/semantic/image_raw"] == encodings["eye/instance/image_raw"] == "16UC1"


def test_queued_state_is_rendered_before_the_node_ends(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing else would draw the last tick of a run, which its recording would then lack."""
    render = rig.render()
    rig.load(_scene(EYE))
    images = rig.collect(Image, "eye/image_raw")
    rig.tick_until(lambda: bool(images), "an image")
    rig.remove(render)
    stamp = rig.tick()
    assert rig.is_delivered()
    monkeypatch.setattr(node_main, "is_running", lambda: False)
    assert render.spin() == 0
    rig.spin_until(lambda: stamp in map(_stamp, images), "the image of the last state")


def test_subscriber_in_paused_time_receives_one_image_of_the_newest_state(rig: Rig) -> None:
    render = rig.render()
    rig.load(_scene(replace(EYE, outputs=("rgb", "depth"))))
    stamp = rig.tick()
    rig.spin_until(lambda: render._latest is not None, "the state")
    images, infos = rig.collect(Image, "eye/image_raw"), rig.collect(CameraInfo, "eye/camera_info")
    rig.spin_until(lambda: bool(images and infos), "an image without another tick")
    depths = rig.collect(Image, "eye/depth/image_raw")
    rig.spin_until(lambda: bool(depths), "depth, whose subscriber came later still")
    for _ in range(50):
        rig.spin()
    assert [_stamp(m) for m in (*images, *infos, *depths)] == 3 * [stamp]
    rig.tick_until(lambda: len(images) > 3 and len(depths) > 3, "images of later ticks")


@pytest.mark.parametrize(
    ("setting", "image_format", "worst"), [("jpeg", "rgb8; jpeg compressed bgr8", 6), ("png", "rgb8; png compressed bgr8", 0)]
)
def test_compressed_image_decodes_to_the_raw_one(rig: Rig, setting: str, image_format: str, worst: int) -> None:
    rig.render(compressed_format=setting)
    rig.load(_scene(EYE))
    raw, packed = rig.collect(Image, "eye/image_raw"), rig.collect(CompressedImage, "eye/image_raw/compressed")
    rig.tick_until(lambda: bool(raw and packed), "both images")
    assert packed[0].format == image_format
    bgr = cv2.imdecode(np.frombuffer(packed[0].data, np.uint8), cv2.IMREAD_COLOR)
    rgb = conversions.array_from_image(raw[0])
    assert rgb[24, 8, 0] > 60 and rgb[24, 8, 2] < 30, "the wall is red"
    assert np.abs(bgr[:, :, ::-1].astype(int) - rgb)[10:38, 2:20].max() <= worst, "within the wall, away from its edges"


def test_jpeg_quality_follows_its_parameter(rig: Rig) -> None:
    rig.render(jpeg_quality=5)
    rig.load(_scene(EYE))
    raw, packed = rig.collect(Image, "eye/image_raw"), rig.collect(CompressedImage, "eye/image_raw/compressed")
    rig.tick_until(lambda: bool(raw and packed), "both images")
    expected = encode_color(conversions.array_from_image(raw[0]), "jpeg", jpeg_quality=5)
    assert bytes(packed[0].data) == expected.tobytes()


def test_compressed_depth_decodes_to_the_raw_one(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE))
    raw = rig.collect(Image, "eye/depth/image_raw")
    packed = rig.collect(CompressedImage, "eye/depth/image_raw/compressedDepth")
    rig.tick_until(lambda: bool(raw and packed), "both images")
    assert packed[0].format == "32FC1; compressedDepth png"
    data = bytes(packed[0].data)
    kind, a, b = struct.unpack("<iff", data[:12])
    pixels = cv2.imdecode(np.frombuffer(data[12:], np.uint8), cv2.IMREAD_UNCHANGED).astype(float)
    depth = conversions.array_from_image(raw[0])
    seen = np.isfinite(depth)
    assert kind == 0
    assert np.array_equal(pixels > 0, seen)
    assert np.allclose(a / (pixels[seen] - b), depth[seen], atol=0.51 * 4.0 / 10100)


def test_points_are_organised_coloured_and_nan_where_nothing_is(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE))
    clouds = rig.collect(PointCloud2, "eye/depth/points")
    rig.tick_until(lambda: bool(clouds), "a cloud")
    cloud = clouds[0]
    fields = {f.name: (f.offset, f.datatype, f.count) for f in cloud.fields}
    assert fields == {"x": (0, 7, 1), "y": (4, 7, 1), "z": (8, 7, 1), "rgb": (12, 7, 1)}
    assert (cloud.width, cloud.height, cloud.point_step, cloud.row_step) == (64, 48, 16, 1024)
    assert not cloud.is_dense and not cloud.is_bigendian
    points = np.frombuffer(cloud.data, [("xyz", "<f4", 3), ("rgb", "<u4")]).reshape(48, 64)
    k = EYE.intrinsics()
    left = points[10, 20]
    assert left["xyz"] == pytest.approx(((20 - k[0, 2]) / k[0, 0] * 2.0, (10 - k[1, 2]) / k[1, 1] * 2.0, 2.0), abs=1e-4)
    assert left["rgb"] >> 16 > 60 and left["rgb"] & 0xFFFF == 0, "red"
    assert np.isnan(points[10, 50]["xyz"]).all(), "the right half is empty"


def test_depth_of_one_camera_is_registered_to_another(rig: Rig) -> None:
    color = replace(EYE, name="color", outputs=("rgb",), pose=Pose((0.0, -0.5, 0.0), AHEAD.quat_xyzw))
    rig.render(register_depth="eye=color")
    rig.load(_scene(replace(EYE, outputs=("depth",)), color))
    images = rig.collect(Image, "eye/depth_registered/image_raw")
    infos = rig.collect(CameraInfo, "eye/depth_registered/camera_info")
    raw = rig.collect(Image, "eye/depth/image_raw")
    rig.tick_until(lambda: bool(images and infos and raw), "registered depth")
    assert {m.header.frame_id for m in (*images, *infos)} == {"color_optical_frame"}
    assert {_stamp(m) for m in images} <= {_stamp(m) for m in infos} | {_stamp(raw[-1]), rig.stamp_ns}
    before, after = (np.isfinite(conversions.array_from_image(m[0])[24]) for m in (raw, images))
    # The wall's right edge is at y = 0: the other camera, 0.5 m to the right of this one, sees it f 0.5 / 2 pixels to the left.
    moved = EYE.intrinsics()[0, 0] * 0.5 / 2.0
    assert before.nonzero()[0].max() - after.nonzero()[0].max() == pytest.approx(moved, abs=1.0)


def test_images_and_depth_are_filled_and_the_mask_says_where(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(replace(EYE, outputs=("rgb", "depth", "hole"), fill="push_pull", fill_depth=True)))
    topics = {topic: rig.collect(Image, f"eye/{topic}image_raw") for topic in ("", "depth/", "hole/")}
    rig.tick_until(lambda: bool(set.intersection(*({_stamp(m) for m in found} for found in topics.values()))), "one stamp on all")
    colour, depth, hole = (conversions.array_from_image(found[0]) for found in topics.values())
    assert topics["hole/"][0].encoding == "8UC1"
    # The wall fills the left half; on the right there is nothing, which is now as red and as far as the wall.
    assert not hole[10:38, 2:30].any() and (hole[:, 34:] == 1).all()
    assert (colour[24, 34:, 0] > 0).all() and not colour[24, :, 1:].any()
    assert np.allclose(depth[24], 2.0, atol=1e-4)


def test_a_camera_whose_holes_cannot_be_filled_ends_the_node_with_one_line(rig: Rig, tmp_path: Path) -> None:
    network = tmp_path / "network.onnx"
    network.write_bytes(b"GIF89a")
    render = rig.render()
    rig.load(_scene(replace(EYE, fill=str(network))), ready=False)
    rig.spin_until(lambda: render._failure is not None, "the failure")
    with pytest.raises(ConfigError, match=r"^camera 'eye': .*network\.onnx is not an ONNX file, or is truncated"):
        render.spin()


def test_a_network_that_fails_at_a_later_image_costs_the_images_of_its_camera_alone(rig: Rig, tmp_path: Path) -> None:
    network = tmp_path / "network.onnx"
    network.write_bytes(network_that_fails_with_holes(0.75))
    mount = _box("mount", (0.0, 0.0, -50.0), BLUE, link="mount")
    # Half of the image is a hole, and all of it if the mount is far away.
    near, away = {"mount": (0.0, 0.0, 0.0)}, {"mount": (0.0, -100.0, 0.0)}
    render = rig.render()
    filled_camera = replace(EYE, name="filled", link="mount", outputs=("rgb",), fill=str(network))
    rig.load(_scene(EYE, filled_camera, visuals=(WALL, mount)))
    reports = rig.collect(DiagnosticArray, "/diagnostics")
    images, infos = rig.collect(Image, "eye/image_raw"), rig.collect(CameraInfo, "filled/camera_info")
    filled = rig.collect(Image, "filled/image_raw")
    rig.tick_until(lambda: len(images) >= 2 and len(filled) >= 2, "images of both", positions=near)
    last = rig.stamp_ns
    rig.tick_until(lambda: len([m for m in images if _stamp(m) > last]) >= 5, "images of the other camera", positions=away)
    assert not [m for m in (*filled, *infos) if _stamp(m) > last], "an image that failed has neither image nor camera info"
    rig.tick_until(
        lambda: any(m.status[0].level == DiagnosticStatus.ERROR for m in reports), "a report of failed images", positions=away
    )
    count, last = len(filled), rig.stamp_ns
    rig.tick_until(lambda: len(filled) >= count + 2, "images of both again", positions=near)
    summary = render.summary()
    assert summary["failed_images"]["filled"] >= 5 and "eye" not in summary["failed_images"]


def test_a_network_that_fails_at_the_first_image_ends_the_node_and_names_camera_and_size(rig: Rig, tmp_path: Path) -> None:
    network = tmp_path / "network.onnx"
    network.write_bytes(network_that_fails_with_holes(0.25))
    render = rig.render()
    rig.load(_scene(EYE, replace(EYE, name="filled", fill=str(network))), ready=False)
    rig.spin_until(lambda: render._failure is not None, "the failure")
    with pytest.raises(ConfigError, match=r"^holes of camera 'filled', 64x48, are not filled: .*network\.onnx.*NaN"):
        render.spin()


def test_a_camera_that_is_added_later_and_cannot_be_filled_is_reported(rig: Rig, tmp_path: Path) -> None:
    network = tmp_path / "network.onnx"
    network.write_bytes(b"GIF89a")
    render = rig.render()
    rig.load(_scene(EYE))
    reports = rig.collect(DiagnosticArray, "/diagnostics")
    bad = replace(EYE, name="bad", fill=str(network))
    for revision in (2, 3):
        rig.load(_scene(EYE, bad, revision=revision))
        rig.tick_until(lambda: bool(reports) and reports[-1].status[0].level == DiagnosticStatus.ERROR, "a report of the camera")
    assert reports[-1].status[0].message == "no images of bad: see the warnings in the log"
    assert render.summary()["failed_images"] == {"bad": 1}, "it is refused once, not with every change of the scene"
    rig.load(_scene(EYE, revision=4))
    rig.tick_until(lambda: reports[-1].status[0].level == DiagnosticStatus.OK, "a report without the camera")


def test_a_first_scene_that_cannot_be_drawn_ends_the_node_with_one_line(rig: Rig, tmp_path: Path) -> None:
    splats = tmp_path / "splats.ply"
    splats.write_bytes(b"ply\n")
    broken = replace(_scene(EYE), splats=SplatsSpec(str(splats)))
    render = rig.render()
    rig.load(broken, ready=False)
    rig.spin_until(lambda: render._failure is not None, "the failure")
    with pytest.raises(GibsonSimError, match=r"splats\.ply"):
        render.spin()


def test_label_info_is_latched_and_names_every_number(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE))
    rig.tick()
    semantic = rig.collect(LABELS, "eye/semantic/label_info", LATCHED)
    instance = rig.collect(LABELS, "eye/instance/label_info", LATCHED)
    rig.spin_until(lambda: bool(semantic and instance), "label infos")
    numbers = [{c.class_id: c.class_name for c in m[0].class_map} for m in (semantic, instance)]
    assert numbers == [{0: "unlabelled", 1: "wall"}, {0: "", 1: "wall"}]
    assert semantic[0].header.frame_id == "eye_optical_frame"


def test_nothing_is_drawn_for_camera_info_alone(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE))
    summary = rig.drawn_after(5)
    assert (summary["images"], summary["skipped_images"]) == ({}, 0)


def test_only_outputs_with_subscribers_are_drawn(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE))
    depth = rig.collect(Image, "eye/depth/image_raw")
    rig.tick_until(lambda: len(depth) >= 5, "depth images")
    summary = rig.renders[0].summary()
    assert set(summary["outputs"]) == {"eye/depth"}
    assert set(summary["messages"]) == {"eye/depth"}


def test_compressed_images_are_encoded_only_while_they_have_subscribers(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE))
    raw = rig.collect(Image, "eye/image_raw")
    rig.tick_until(lambda: len(raw) >= 3, "images")
    assert "eye/compressed" not in rig.renders[0].summary()["messages"]
    packed: list[Any] = []
    subscription = rig.user.create_subscription(CompressedImage, "eye/image_raw/compressed", packed.append, 10)
    rig.tick_until(lambda: len(packed) >= 3, "compressed images")
    rig.user.destroy_subscription(subscription)
    gone = _Counter(rig, "eye/compressed")
    rig.tick_until(gone.stands_still_for_ten_images, "an end of encoding")


class _Counter:
    """Returns whether a kind of message is still made, while raw images go on."""

    def __init__(self, rig: Rig, kind: str) -> None:
        self._rig, self._kind, self._last = rig, kind, (-1, 0)

    def stands_still_for_ten_images(self) -> bool:
        messages = self._rig.renders[0].summary()["messages"]
        made, images = messages[self._kind], messages["eye/rgb"]
        if made != self._last[0]:
            self._last = (made, images)
        return images - self._last[1] >= 10


def test_images_without_subscribers_are_not_skipped_ones(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE))
    reports = rig.collect(DiagnosticArray, "/diagnostics")
    images: list[Any] = []
    subscription = rig.user.create_subscription(Image, "eye/image_raw", images.append, 10)
    rig.tick_until(lambda: len(images) >= 2, "images")
    rig.user.destroy_subscription(subscription)
    rig.tick_until(lambda: reports[-1:] != [] and reports[-1].status[0].message == "idle: no subscriber of its images", "rest")
    skipped = rig.renders[0].summary()["skipped_images"]
    rig.stamp_ns += 50 * TICK_NS
    again = rig.collect(Image, "eye/image_raw")
    rig.tick_until(lambda: bool(again), "an image")
    assert rig.renders[0].summary()["skipped_images"] - skipped < 50


def test_time_that_jumps_back_skips_nothing_and_images_go_on(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE))
    rig.stamp_ns = 100 * TICK_NS
    images = rig.collect(Image, "eye/image_raw")
    rig.tick_until(lambda: len(images) >= 3, "images")
    rig.stamp_ns = 0
    before = rig.renders[0].summary()["skipped_images"]
    rig.tick_until(lambda: sum(_stamp(m) < 50 * TICK_NS for m in images) >= 3, "images of the new epoch")
    summary = rig.renders[0].summary()
    assert summary["skipped_images"] == before
    assert summary["images_per_simulated_s"]["eye"] == pytest.approx(10.0, rel=0.5)


def test_reliability_of_one_topic_can_be_changed_by_a_parameter(rig: Rig) -> None:
    rig.render(**{"qos_overrides./eye/image_raw.publisher.reliability": "best_effort"})
    rig.load(_scene(EYE))
    images = rig.collect(Image, "eye/image_raw", qos_profile_sensor_data)
    rig.tick_until(lambda: bool(images), "an image")

    def reliability(topic: str) -> ReliabilityPolicy:
        return rig.user.get_publishers_info_by_topic(topic)[0].qos_profile.reliability

    assert reliability("/eye/image_raw") == ReliabilityPolicy.BEST_EFFORT
    assert reliability("/eye/depth/image_raw") == ReliabilityPolicy.RELIABLE


def test_a_reliability_that_does_not_exist_is_named_with_what_is_allowed(rig: Rig) -> None:
    node = rig.render(**{"qos_overrides./eye/image_raw.publisher.reliability": "besteffort"})
    with pytest.raises(ConfigError, match="`besteffort`; allowed: reliability: reliable or best_effort"):
        qos.make_publisher(node, Image, "eye/image_raw", qos.SENSOR)


def test_overrides_of_one_topic_leave_the_shared_profile_alone(rig: Rig) -> None:
    node = rig.render(**{"qos_overrides./eye/image_raw.publisher.depth": 1})
    assert qos.make_publisher(node, Image, "eye/image_raw", qos.SENSOR).qos_profile.depth == 1
    assert qos.SENSOR.depth == 5


def test_two_render_nodes_share_the_cameras(rig: Rig) -> None:
    other = replace(EYE, name="other", outputs=("rgb",))
    rig.render(cameras="eye")
    rig.render("-r", "__node:=render_2", cameras="other")
    rig.load(_scene(EYE, other))
    images = {name: rig.collect(Image, f"{name}/image_raw") for name in ("eye", "other")}
    reports = rig.collect(DiagnosticArray, "/diagnostics")

    def reported() -> set[str]:
        return {status.name for message in reports for status in message.status}

    rig.tick_until(lambda: all(images.values()) and len(reported()) >= 2, "images and reports of both")
    assert reported() == {"gibson_sim: render", "gibson_sim: render_2"}
    assert [set(node.summary()["images"]) for node in rig.renders] == [{"eye"}, {"other"}]


def test_cameras_of_namespaced_robots_have_topics_below_their_name(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(replace(EYE, name="left/camera"), replace(EYE, name="right/camera")))
    left, right = (rig.collect(Image, f"{side}/camera/depth/image_raw") for side in ("left", "right"))
    rig.tick_until(lambda: bool(left and right), "images of both")
    assert left[0].header.frame_id == "left/camera_optical_frame"


def test_a_spawned_body_appears_in_images_until_it_is_deleted(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE))
    images = rig.collect(Image, "eye/image_raw")
    rig.tick_until(lambda: bool(images), "images")
    box = _box("crate", (0.0, -1.2, 0.0), BLUE, link="crate/base")

    def blue() -> bool:
        return bool(conversions.array_from_image(images[-1])[24, 50, 2] > 60)

    assert not blue()
    rig.load(_scene(EYE, visuals=(WALL, box), revision=2))
    rig.tick_until(blue, "a blue crate")
    rig.load(_scene(EYE, revision=3))
    rig.tick_until(lambda: not blue(), "an end of the crate")


def test_a_state_that_comes_before_its_scene_is_drawn_when_that_arrives(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE))
    images = rig.collect(Image, "eye/image_raw")
    rig.tick_until(lambda: bool(images), "images")
    later = _scene(EYE, revision=2)
    rig.scene = later
    early = rig.tick()
    for _ in range(20):
        rig.spin()
    assert early not in map(_stamp, images)
    rig.load(later)
    rig.spin_until(lambda: early in map(_stamp, images), "the early image")


def test_a_state_that_comes_before_the_last_of_two_scenes_is_drawn_when_that_arrives(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE))
    images = rig.collect(Image, "eye/image_raw")
    rig.tick_until(lambda: bool(images), "images")
    between, later = _scene(EYE, revision=2), _scene(EYE, revision=3)
    rig.scene = later
    early = rig.tick()
    for scene in (between, later):
        for _ in range(20):
            rig.spin()
        assert early not in map(_stamp, images)
        rig.load(scene)
    rig.spin_until(lambda: early in map(_stamp, images), "the early image")


def test_a_state_that_waits_behind_one_of_the_old_scene_is_drawn_when_its_scene_arrives(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE))
    images = rig.collect(Image, "eye/image_raw")
    rig.tick_until(lambda: bool(images), "images")
    rig.tick()
    rig.scene = later = _scene(EYE, revision=2)
    early = rig.tick()
    for _ in range(20):
        rig.spin()
    assert early not in map(_stamp, images)
    rig.load(later)
    rig.spin_until(lambda: early in map(_stamp, images), "the early image")


def test_topics_go_with_their_camera(rig: Rig) -> None:
    rig.render()
    rig.load(_scene(EYE, replace(EYE, name="second")))
    rig.spin_until(lambda: bool(rig.user.count_publishers("/second/image_raw")), "topics of the second camera")
    rig.load(_scene(EYE, revision=2))
    rig.spin_until(lambda: not rig.user.count_publishers("/second/image_raw"), "their end")
    assert rig.user.count_publishers("/eye/image_raw") == 1


def test_both_fisheyes_of_the_surround_view_robot_publish(rig: Rig) -> None:
    robot = load_robot(find_robot("gibson_bot_360"))
    cameras = tuple(replace(camera, link="", width=64, height=64) for camera in robot.cameras)
    rig.render()
    behind = _box("behind", (-2.1, 0.0, 0.0), BLUE)
    rig.load(_scene(*cameras, visuals=(WALL, behind)))
    front, back = (rig.collect(Image, f"fisheye_{side}/image_raw") for side in ("front", "back"))
    info = rig.collect(CameraInfo, "fisheye_back/camera_info")
    rig.tick_until(lambda: bool(front and back and info), "images of both")
    red, blue = (np.asarray(conversions.array_from_image(m[0]))[..., k] > 60 for m, k in ((front, 0), (back, 2)))
    assert red.any() and blue[32, 32]
    assert info[0].distortion_model == "equidistant"


def test_snapshots_of_a_namespaced_camera_are_plain_files(rig: Rig, tmp_path: Path) -> None:
    rig.render()
    rig.load(_scene(replace(EYE, name="left/camera", outputs=("rgb", "position"))))
    taking = SnapshotNode(
        context=rig.context, use_global_arguments=False, parameter_overrides=[Parameter("output", value=str(tmp_path))]
    )  # fmt: skip
    rig.add(taking)
    rig.tick_until(lambda: len(list(tmp_path.iterdir())) == 2, "two files")
    assert {path.name for path in tmp_path.iterdir()} == {"left_camera_rgb.png", "left_camera_position.npy"}


def test_a_file_of_another_machine_that_is_missing_here_is_named(rig: Rig) -> None:
    render = rig.render()
    lost = VisualSpec("lost", "", Shape("mesh", mesh="/opt/other/scenes/gone/a.obj"))
    rig.load(_scene(EYE, visuals=(WALL, lost)), ready=False)
    rig.spin_until(lambda: render._failure is not None, "the failure")
    with pytest.raises(GibsonSimError, match=r"/opt/other/scenes/gone/a\.obj is a file on the physics node's machine"):
        render.spin()
