"""A recorded run is rendered again: images equal those of the renderer at the recorded states, with their stamps."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import is_dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from gibson_sim.bags.export import export_bag  # noqa: E402
from gibson_sim.bags.reader import BagReader, image_to_array  # noqa: E402
from gibson_sim.bags.stamps import time_from_msg  # noqa: E402
from gibson_sim.bags.writer import BagWriter, TopicQos  # noqa: E402
from gibson_sim.cli.command_line import run  # noqa: E402
from gibson_sim.client_config import RenderBagConfig  # noqa: E402
from gibson_sim.config import RenderConfig  # noqa: E402
from gibson_sim.description.shapes import Appearance, Shape, VisualSpec  # noqa: E402
from gibson_sim.errors import ConfigError, SceneNotFoundError  # noqa: E402
from gibson_sim.geometry.transforms import pose_from_xyz_rpy  # noqa: E402
from gibson_sim.render.renderer import Renderer  # noqa: E402
from gibson_sim.ros import conversions  # noqa: E402
from gibson_sim.ros.recording.render_bag import render_bag  # noqa: E402
from gibson_sim.ros.wire.exact_bytes import exact_bytes  # noqa: E402
from gibson_sim.ros.wire.fast_publish import image_to_bytes  # noqa: E402
from gibson_sim.ros.wire.message_types import type_name_of  # noqa: E402
from gibson_sim.scenes.spec import DrawnScene, LightSpec  # noqa: E402
from gibson_sim.types import OUTPUTS, CameraSpec, Frame, SceneState  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.egl]
RENDER = RenderConfig(cache="none")
EYE = """cameras:
  - {name: eye, link: robot/base, pose: {xyz: [0.1, 0, 0.3], rpy_deg: [0, 10, 5]}, width: 64, height: 48, rate_hz: 20,
     outputs: [rgb, depth, semantic, instance, normal, normal_world, position, flow, hole]}
"""


def _scene(revision: int, *boxes: VisualSpec) -> DrawnScene:
    own = CameraSpec("own", "robot/base", pose_from_xyz_rpy((0.0, 0.0, 0.2), (-1.5, 0.0, -1.5)), 32, 24, rate_hz=30.0)
    floor = VisualSpec("floor", "", Shape("box", (20.0, 20.0, 0.1)), semantic_class="floor")
    return DrawnScene("yard", revision, "", ("robot/base",), (floor, *boxes), (own,), LightSpec())


def _box(x: float) -> VisualSpec:
    return VisualSpec(f"box {x}", "", Shape("box", (0.5, 0.5, 1.0)), pose_from_xyz_rpy((x, 0.3, 0.5)), semantic_class="box")


def _state(tick: int, revision: int) -> SceneState:
    pose = pose_from_xyz_rpy((0.01 * tick, 0.003 * tick, 0.05), (0.0, 0.0, 0.02 * tick))
    return SceneState(
        tick * 10**9 // 60,
        tick,
        revision,
        ("robot/base",),
        np.array([pose.position]),
        np.array([pose.quat_xyzw]),
        np.zeros((1, 6)),
    )


SCENES = {1: _scene(1, _box(2.0)), 2: _scene(2, _box(2.0), _box(3.0))}
STATES = [_state(tick, 1 if tick < 8 else 2) for tick in range(1, 13)]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a bag of 12 states without a single image; at the eighth a box has come."""
    folder = tmp_path_factory.mktemp("drive") / "bag"
    with BagWriter(folder, reserve_bytes=0) as bag:
        bag.add_topic("/scene", "gibson_msgs/msg/Scene", TopicQos.latched())
        bag.add_topic("/scene_state", "gibson_msgs/msg/SceneState")
        bag.add_topic("/tf_static", "tf2_msgs/msg/TFMessage", TopicQos.latched())
        bag.add_topic("/odom", "nav_msgs/msg/Odometry")
        transform = conversions.transform_to_msg(0, "base", "wheel", pose_from_xyz_rpy())
        bag.write("/tf_static", serialize_message(TFMessage(transforms=[transform])), 0, 0)
        for state in STATES:
            if state.step in (1, 8):
                bag.write(
                    "/scene",
                    serialize_message(conversions.scene_to_msg(SCENES[state.revision], state.stamp_ns)),
                    state.stamp_ns,
                    0,
                )
            message = conversions.scene_state_to_msg(state, (0,) if state.step % 2 == 0 else ())
            bag.write("/scene_state", serialize_message(message), state.stamp_ns, state.stamp_ns)
            bag.write("/odom", b"\x00\x01\x00\x00as it came", state.stamp_ns, state.stamp_ns)
    return folder


@pytest.fixture(scope="module")
def drawn(drive: Path) -> tuple[Path, Path]:
    """Returns the bag drawn with its own camera, and with another one."""
    own, other = drive.parent / "own", drive.parent / "other"
    render_bag(RenderBagConfig(bag=str(drive), output=str(own)), RENDER)
    (drive.parent / "eye.yaml").write_text(EYE)
    render_bag(RenderBagConfig(bag=str(drive), output=str(other), cameras=str(drive.parent / "eye.yaml")), RENDER)
    return own, other


@lru_cache
def _all_messages(bag: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with BagReader(bag) as reader:
        for topic, _, msg in reader.messages([topic for topic in reader.topics() if topic != "/odom"]):
            found.setdefault(topic, []).append(msg)
    return found


def _messages(bag: Path, topic: str) -> list[Any]:
    return _all_messages(bag)[topic]


def _expected(camera: CameraSpec, ticks: list[int]) -> list[Any]:
    """Returns the frames that the renderer draws at ticks, each with the motion since the one before in the same scene."""
    frames: list[Any] = []
    with Renderer(SCENES[1]) as renderer:
        before: SceneState | None = None
        for state in (STATES[tick - 1] for tick in ticks):
            if before is not None and before.revision != state.revision:
                renderer.update(SCENES[state.revision])
                before = None
            frames += renderer.render(state, [camera], before)
            before = state
    return frames


def test_cameras_of_the_bag_are_rendered_at_the_recorded_ticks(drawn: tuple[Path, Path]) -> None:
    ticks = [2, 4, 6, 8, 10, 12]
    images = _messages(drawn[0], "/own/image_raw")
    assert [time_from_msg(m.header.stamp) for m in images] == [STATES[tick - 1].stamp_ns for tick in ticks]
    for message, frame in zip(images, _expected(SCENES[1].cameras[0], ticks), strict=True):
        assert np.array_equal(image_to_array(message), frame.rgb)


def test_a_bag_recorded_when_appearance_was_called_look_is_rendered(tmp_path: Path) -> None:
    """The bytes are those of today; only the definitions in the bag have the old names."""
    texts = {name: Path("src/gibson_msgs/msg", f"{name}.msg").read_text() for name in ("Appearance", "Visual")}
    visual = texts["Visual"].replace("gibson_msgs/Appearance[<=1] appearance", "gibson_msgs/Look[<=1] look")
    assert visual != texts["Visual"]
    definitions = {"gibson_msgs/msg/Look": texts["Appearance"], "gibson_msgs/msg/Visual": visual}
    red = replace(SCENES[1].visuals[1], color=(1.0, 0.0, 0.0, 1.0), appearance=Appearance(hue=1.0 / 3.0))
    scene = replace(SCENES[1], visuals=(SCENES[1].visuals[0], red))
    with BagWriter(tmp_path / "old", message_definitions=definitions, reserve_bytes=0) as bag:
        bag.add_topic("/scene", "gibson_msgs/msg/Scene", TopicQos.latched())
        bag.add_topic("/scene_state", "gibson_msgs/msg/SceneState")
        bag.write("/scene", serialize_message(conversions.scene_to_msg(scene, 0)), 0, 0)
        bag.write("/scene_state", serialize_message(conversions.scene_state_to_msg(STATES[0], (0,))), 1, 1)
    (recorded,) = _messages(tmp_path / "old", "/scene")
    assert recorded.visuals[1].look[0].hue == 1.0 / 3.0
    assert conversions.scene_from_msg(recorded) == scene
    render_bag(RenderBagConfig(bag=str(tmp_path / "old"), output=str(tmp_path / "new")), RENDER)
    (written,) = _messages(tmp_path / "new", "/scene")
    assert written.visuals[1].appearance[0].hue == 1.0 / 3.0
    (image,) = _messages(tmp_path / "new", "/own/image_raw")
    with Renderer(scene) as renderer:
        (frame,) = renderer.render(STATES[0], scene.cameras)
    assert np.array_equal(image_to_array(image), frame.rgb)


def test_all_outputs_of_an_added_camera_equal_those_of_the_renderer(drawn: tuple[Path, Path]) -> None:
    (scene, *_) = _messages(drawn[1], "/scene")
    (camera,) = conversions.scene_from_msg(scene).cameras
    frames = _expected(camera, [3, 6, 9, 12])
    for output in OUTPUTS:
        topic = "/eye/image_raw" if output == "rgb" else f"/eye/{output}/image_raw"
        images = _messages(drawn[1], topic)
        infos = _messages(drawn[1], topic.replace("image_raw", "camera_info"))
        stamps = [time_from_msg(m.header.stamp) for m in images]
        assert stamps == [frame.stamp_ns for frame in frames] == [time_from_msg(m.header.stamp) for m in infos]
        for message, frame in zip(images, frames, strict=True):
            assert np.array_equal(image_to_array(message), getattr(frame, output), equal_nan=output in ("position", "flow")), (
                output
            )


def test_new_bag_contains_the_states_and_all_other_topics(drive: Path, drawn: tuple[Path, Path]) -> None:
    recorded, new = _messages(drive, "/scene_state"), _messages(drawn[1], "/scene_state")
    assert [time_from_msg(m.header.stamp) for m in new] == [time_from_msg(m.header.stamp) for m in recorded]
    assert all(np.abs(a.poses - b.poses).max() < 1e-6 for a, b in zip(recorded, new, strict=True))
    assert [list(m.due_cameras) for m in new] == [[0] if tick in (3, 6, 9, 12) else [] for tick in range(1, 13)]
    with BagReader(drive) as a, BagReader(drawn[1]) as b:
        assert list(a.raw_messages(["/odom"])) == list(b.raw_messages(["/odom"]))
        assert b.topics()["/eye/semantic/label_info"].latched
    (static,) = _messages(drawn[1], "/tf_static")
    assert [(t.header.frame_id, t.child_frame_id) for t in static.transforms] == [
        ("base", "wheel"),
        ("base", "eye_optical_frame"),
    ]


def test_the_new_bag_is_a_data_set(drawn: tuple[Path, Path], tmp_path: Path) -> None:
    report = export_bag(drawn[1], "nerfstudio", tmp_path / "out")
    assert "4 frames of eye" in report.lines[0]


def test_a_part_of_the_run_contains_earlier_latched_messages(drive: Path, tmp_path: Path) -> None:
    job = RenderBagConfig(bag=str(drive), output=str(tmp_path / "part"), begin=0.05, end=0.12, outputs="depth")
    render_bag(job, RENDER)
    assert [time_from_msg(m.header.stamp) for m in _messages(tmp_path / "part", "/own/depth/image_raw")] == [
        STATES[tick - 1].stamp_ns for tick in (4, 6)
    ]
    assert [m.revision for m in _messages(tmp_path / "part", "/scene")] == [1]


def test_a_missing_file_is_named_with_the_setting_that_helps(tmp_path: Path) -> None:
    scene = _scene(1, VisualSpec("table", "", Shape("mesh", mesh="/there/table.glb")))
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/scene", "gibson_msgs/msg/Scene", TopicQos.latched())
        bag.add_topic("/scene_state", "gibson_msgs/msg/SceneState")
        bag.write("/scene", serialize_message(conversions.scene_to_msg(scene, 0)), 0, 0)
        bag.write("/scene_state", serialize_message(conversions.scene_state_to_msg(STATES[0], (0,))), 1, 1)
    with pytest.raises(SceneNotFoundError, match=r"/there/table\.glb .*'asset_roots'"):
        render_bag(RenderBagConfig(bag=str(tmp_path / "bag"), output=str(tmp_path / "out")), RENDER)


class _BlueTracer:
    """Traces everything blue, brighter with each scene."""

    scenes: list[int]
    states: list[int]

    def __init__(self, python: str, samples: int) -> None:
        self.scenes, self.states, self.closed = [], [], False

    def load(self, scene: DrawnScene, state: SceneState, draw: Callable[..., Any]) -> None:
        assert len(draw(state, scene.cameras)) == len(scene.cameras)
        self.scenes.append(scene.revision)

    def colors(self, state: SceneState, frame: Frame) -> np.ndarray[Any, np.dtype[np.uint8]]:
        self.states.append(state.step)
        assert frame.stamp_ns == state.stamp_ns
        return np.full((frame.camera.height, frame.camera.width, 3), (0, 0, self.scenes[-1]), dtype=np.uint8)

    def close(self) -> None:
        self.closed = True


def test_a_tracer_gives_the_colours_and_the_renderer_all_else(
    drive: Path, drawn: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracer = _BlueTracer("", 2)
    monkeypatch.setattr("gibson_sim.ros.recording.render_bag.open_tracer", lambda name, python, samples: tracer)
    folder = tmp_path / "traced"
    render_bag(RenderBagConfig(bag=str(drive), output=str(folder), tracer="blue"), RENDER)
    assert (tracer.scenes, tracer.states, tracer.closed) == ([1, 2], [2, 4, 6, 8, 10, 12], True)
    images, others = (_messages(bag, "/own/image_raw") for bag in (folder, drawn[0]))
    assert [image_to_array(image)[0, 0].tolist() for image in images] == [[0, 0, 1]] * 3 + [[0, 0, 2]] * 3
    assert [time_from_msg(image.header.stamp) for image in images] == [time_from_msg(image.header.stamp) for image in others]
    depths = [[image_to_array(image) for image in _messages(bag, "/own/depth/image_raw")] for bag in (folder, drawn[0])]
    assert all(np.array_equal(a, b) for a, b in zip(*depths, strict=True))


def test_serialised_messages_have_no_trailing_bytes(tmp_path: Path) -> None:
    # No K and no D: empty sequences of float64, for which serialize_message leaves room that nothing fills.
    camera = CameraSpec("around", "", width=8, height=4, projection="equirectangular")
    scene = DrawnScene("yard", 1, "", ("robot/base",), (), (camera, SCENES[1].cameras[0]), LightSpec())
    messages = {"/info": conversions.camera_info_to_msg(camera, 5), "/scene": conversions.scene_to_msg(scene, 5)}
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        for topic, message in messages.items():
            bag.add_topic(topic, type_name_of(type(message)))
            bag.write(topic, exact_bytes(message), 5, 5)
    with BagReader(tmp_path / "bag") as reader:
        found = {topic: msg for topic, _, msg in reader.messages()}
    assert found["/info"].distortion_model == "equirectangular"
    assert conversions.scene_from_msg(found["/scene"]) == scene
    assert deserialize_message(exact_bytes(messages["/scene"]), type(messages["/scene"])) == messages["/scene"]


@pytest.mark.parametrize(
    ("make", "encoding"),
    [(lambda: np.arange(24, dtype=np.uint8).reshape(2, 4, 3), "rgb8"), (lambda: np.ones((3, 5), np.float32), "32FC1")],
)
def test_bytes_of_an_image_are_those_of_its_message(make: Callable[[], Any], encoding: str) -> None:
    for frame_id in ("", "a", "ab", "abc", "abcd"):
        message = conversions.image_to_msg(make(), encoding, 5_000_000_007, frame_id)
        # Not the bytes themselves: DDS leaves what lies between two numbers as it was.
        assert deserialize_message(image_to_bytes(make(), encoding, 5_000_000_007, frame_id), Image) == message


@pytest.fixture(scope="module")
def viewed(drive: Path) -> Path:
    """Returns the bag drawn with its own camera and with views."""
    folder = drive.parent / "viewed"
    job = RenderBagConfig(bag=str(drive), output=str(folder), views="follow,top", view_size="48x32", view_rate=20.0)
    render_bag(job, RENDER)
    return folder


def test_a_view_is_drawn_where_tf_says_beside_the_cameras_of_the_run(viewed: Path, drawn: tuple[Path, Path]) -> None:
    own = [bytes(image.data) for image in _messages(viewed, "/own/image_raw")]
    assert own == [bytes(image.data) for image in _messages(drawn[0], "/own/image_raw")], (
        "the robot sees what it saw without views"
    )
    where = {
        (time_from_msg(transform.header.stamp), transform.child_frame_id): transform.transform.translation
        for message in _messages(viewed, "/tf")
        for transform in message.transforms
    }
    scenes = {message.revision: conversions.scene_from_msg(message) for message in _messages(viewed, "/scene")}
    states = {time_from_msg(message.header.stamp): message for message in _messages(viewed, "/scene_state")}
    images = _messages(viewed, "/view_follow/image_raw")
    assert [time_from_msg(image.header.stamp) for image in images] == [tick * 10**9 // 60 for tick in (3, 6, 9, 12)]
    for image in images:
        message = states[time_from_msg(image.header.stamp)]
        state = conversions.scene_state_from_msg(message, scenes[message.revision].links)
        row = state.links.index("view_follow")
        place = where[time_from_msg(image.header.stamp), image.header.frame_id]
        assert (place.x, place.y, place.z) == tuple(state.positions[row])
        assert np.linalg.norm(state.positions[row][:2] - state.positions[0][:2]) == pytest.approx(1.8)
    with Renderer(scenes[2]) as renderer:
        (frame,) = renderer.render(state, [camera for camera in scenes[2].cameras if camera.name == "view_follow"])
    assert frame.rgb is not None and bytes(images[-1].data) == frame.rgb.tobytes()


def test_a_view_that_the_bag_has_already_is_refused(viewed: Path) -> None:
    with pytest.raises(ConfigError, match="'view_top': the scene already has a camera of this name"):
        render_bag(RenderBagConfig(bag=str(viewed), output=str(viewed.parent / "again"), views="top"), RENDER)


def test_workers_draw_several_bags_as_one_process_draws_each(drive: Path, drawn: tuple[Path, Path], tmp_path: Path) -> None:
    shutil.copytree(drive, tmp_path / "second")
    words = [
        "render",
        str(drive),
        str(tmp_path / "second"),
        "--output",
        str(tmp_path / "new"),
        "--workers",
        "2",
        "--cache",
        "none",
    ]
    assert run([*words, "--cameras", str(drive.parent / "eye.yaml")]) == 0
    for name in ("bag", "second"):
        assert _plain(_all_messages(tmp_path / "new" / name)) == _plain(_all_messages(drawn[1]))


def _plain(value: Any) -> Any:
    """Returns a message with all arrays as bytes, which can be compared; its own bytes have padding that nobody sets."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.tobytes()
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_plain(entry) for entry in value]
    return [_plain(entry) for entry in vars(value).values()] if is_dataclass(value) else value
