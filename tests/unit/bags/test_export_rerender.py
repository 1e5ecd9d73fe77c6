"""States, cameras and copied topics of a rerendered bag."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gibson_sim.bags.reader import BagReader, TopicInfo
from gibson_sim.bags.rerender import CameraSchedule, SceneTopics, scene_topics, topics_to_copy
from gibson_sim.bags.writer import BagWriter, TopicQos
from gibson_sim.errors import RecordError, RobotError
from gibson_sim.robots.loading.cameras import load_cameras
from gibson_sim.ros.recording.render_bag import definitions_of, offered_qos
from gibson_sim.sensors.schedule import is_due
from gibson_sim.types import CameraSpec, SceneState

NS = 1_000_000_000
LINKS = ("robot/base_link", "robot/head", "chair/head")


def _state(tick: int, revision: int = 1) -> SceneState:
    return SceneState(
        tick * NS // 60, tick, revision, ("robot/base",), np.array([[tick / 60.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.0, 1.0]]), np.zeros((1, 6))
    )  # fmt: skip


@pytest.mark.parametrize("rate_hz", [7.0, 25.0, 30.0, 60.0, 100.0])
def test_cameras_are_due_at_the_ticks_of_a_running_simulation(rate_hz: float) -> None:
    camera = CameraSpec("camera", "", rate_hz=rate_hz)
    schedule = CameraSchedule(NS // 60)
    due = [tick for tick in range(1, 200) for _, cameras in schedule.moments(_state(tick), [camera]) if cameras]
    assert due == [tick for tick in range(1, 200) if is_due(tick, rate_hz, 60)]


def test_the_bags_own_cameras_are_due_as_recorded() -> None:
    cameras = [CameraSpec("a", ""), CameraSpec("b", "")]
    assert next(CameraSchedule(1).moments(_state(3), cameras, [1]))[1] == (1,)


def test_interpolated_states_are_at_whole_multiples_of_the_period() -> None:
    schedule = CameraSchedule(NS // 60, interpolate=True)
    camera = CameraSpec("camera", "", rate_hz=100.0)
    found = [
        (state.stamp_ns, state.positions[0, 0])
        for tick in (6, 7, 9)
        for state, due in schedule.moments(_state(tick), [camera])
        if due
    ]
    assert [stamp for stamp, _ in found] == [100_000_000, 110_000_000, 120_000_000, 130_000_000, 140_000_000, 150_000_000]
    assert [x for _, x in found] == pytest.approx([0.1, 0.11, 0.12, 0.13, 0.14, 0.15], abs=1e-8)


def test_nothing_is_interpolated_between_two_scenes() -> None:
    schedule = CameraSchedule(NS // 60, interpolate=True)
    camera = CameraSpec("camera", "", rate_hz=1000.0)
    list(schedule.moments(_state(6), [camera]))
    assert [state.stamp_ns for state, _ in schedule.moments(_state(7, revision=2), [camera])] == [7 * NS // 60]


def test_all_topics_but_images_and_their_derivatives_are_copied() -> None:
    types = {
        "/tf": "tf2_msgs/msg/TFMessage", "/lidar/points": "sensor_msgs/msg/PointCloud2", "/camera/depth/points": "sensor_msgs/msg/PointCloud2",
        "/camera/image_raw": "sensor_msgs/msg/Image", "/camera/camera_info": "sensor_msgs/msg/CameraInfo", "/scene": "gibson_msgs/msg/Scene",
    }  # fmt: skip
    infos = {topic: TopicInfo(topic, name, 1, False, True) for topic, name in types.items()}
    own = SceneTopics("/scene", "/scene_state")
    assert topics_to_copy(infos, "auto", own) == ("/tf", "/lidar/points")
    assert topics_to_copy(infos, "none", own) == ()
    with pytest.raises(RecordError, match="names /tff; the bag has: /tf,"):
        topics_to_copy(infos, "/tf,/tff", own)


def test_a_bag_without_a_scene_names_the_topics_to_record(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/scene_state", "gibson_msgs/msg/SceneState")
        bag.write("/scene_state", messages.text("x"), 1, 1)
    with BagReader(tmp_path / "bag") as reader, pytest.raises(RecordError, match="record /scene and /scene_state as well"):
        scene_topics(reader)


def test_copied_topics_keep_their_definitions_and_quality_of_service(tmp_path: Path) -> None:
    qos = TopicQos(reliability="best_effort", durability="transient_local", depth=3)
    text = "uint8 level\nother_msgs/Part part\n"
    given = {"other_msgs/msg/Thing": text, "other_msgs/msg/Part": "float64 x\n"}
    with BagWriter(tmp_path / "bag", reserve_bytes=0, message_definitions=given) as bag:
        bag.add_topic("/thing", "other_msgs/msg/Thing", qos)
    with BagReader(tmp_path / "bag") as reader:
        assert definitions_of(reader.connections) == given
        assert offered_qos(reader.connections[0]) == qos


@pytest.fixture
def write_cameras(tmp_path: Path) -> Callable[[str], Path]:
    """Returns a function that writes a file with one camera on a given link."""

    def write(link: str) -> Path:
        path = tmp_path / "cameras.yaml"
        path.write_text(f"cameras:\n  - {{name: eye, link: {link}, width: 8, height: 6, outputs: [depth]}}\n")
        return path

    return write


@pytest.mark.parametrize(
    ("link", "found"),
    [("robot/head", "robot/head"), ("base_link", "robot/base_link"), ("map", "")],
    ids=["whole", "short", "world"],
)
def test_cameras_of_a_file_find_their_links(write_cameras: Callable[[str], Path], link: str, found: str) -> None:
    (camera,) = load_cameras(write_cameras(link), LINKS)
    assert (camera.link, camera.outputs) == (found, ("depth",))


def test_an_unknown_link_lists_the_known_ones(write_cameras: Callable[[str], Path]) -> None:
    with pytest.raises(RobotError, match="'nose' is not in the scene; there are: map, robot/base_link, robot/head, chair/head"):
        load_cameras(write_cameras("nose"), LINKS)
    with pytest.raises(RobotError, match="'head' stands for robot/head and chair/head"):
        load_cameras(write_cameras("head"), LINKS)
