"""Views as the physics node publishes them: in the scene, in its states and on /tf."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

from rclpy.serialization import deserialize_message  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from gibson_msgs.msg import Scene, SceneState  # noqa: E402
from gibson_sim.config import PhysicsConfig  # noqa: E402
from gibson_sim.errors import ConfigError  # noqa: E402
from gibson_sim.maps.placement import populate  # noqa: E402
from gibson_sim.physics.world import PhysicsWorld  # noqa: E402
from gibson_sim.ros import conversions  # noqa: E402
from gibson_sim.ros.topics.world_interface import WorldInterface  # noqa: E402

pytestmark = pytest.mark.ros


class _Node:
    """Keeps what is published on each topic."""

    def __init__(self) -> None:
        self.sent: dict[str, list[Any]] = {}

    def create_publisher(self, kind: type[Any], topic: str, *args: Any, **kwargs: Any) -> Any:
        sent = self.sent.setdefault(topic, [])

        class Publisher:
            @staticmethod
            def publish(message: Any) -> None:
                sent.append(deserialize_message(message, kind) if isinstance(message, bytes) else message)

        return Publisher


@pytest.fixture(scope="module")
def world() -> Iterator[PhysicsWorld]:
    with PhysicsWorld(populate("flat", "left=gibson_bot,right=gibson_bot", "1.0,4.7,0;6.4,3.3,90")) as made:
        yield made


def test_views_stand_in_scene_and_state_and_on_tf_with_one_stamp(world: PhysicsWorld) -> None:
    node = _Node()
    config = PhysicsConfig.of(views="follow,follow:right,top,orbit", view_rate=30.0, camera_rate=15.0, camera_outputs="depth")
    topics = WorldInterface(node, config, None)  # type: ignore[arg-type]
    topics.publish_scene(world)
    world.step()
    due = [topics.cameras[i] for i in topics.due(2)]
    topics.publish_state(world.state(), topics.due(2), 0, 1)
    (scene,), (state,), (tf,) = node.sent["scene"], node.sent["scene_state"], node.sent["/tf"]
    assert isinstance(scene, Scene) and isinstance(state, SceneState) and isinstance(tf, TFMessage)
    names = ["view_follow", "view_follow_right", "view_top", "view_orbit"]
    assert scene.links[-4:] == names and [camera.name for camera in due] == names
    assert all((list(camera.outputs), camera.rate) == (["rgb"], 30.0) for camera in scene.cameras[-4:])
    assert all((list(camera.outputs), camera.rate) == (["depth"], 15.0) for camera in scene.cameras[:-4])
    assert [t.child_frame_id for t in tf.transforms] == [f"{name}_optical_frame" for name in names]
    poses = np.array(state.poses).reshape(-1, 7)[-4:]
    for transform, pose in zip(tf.transforms, poses, strict=True):
        place = transform.transform.translation
        assert (place.x, place.y, place.z) == tuple(pose[:3])
        assert transform.header.stamp == state.header.stamp and transform.header.frame_id == "map"
    assert poses[0, :2] == pytest.approx((1.0 - 1.8, 4.7), abs=0.01)
    assert poses[1, :2] == pytest.approx((6.4, 3.3 - 1.8), abs=0.01)
    assert conversions.scene_from_msg(scene).cameras[-1].link == "view_orbit"


def test_an_unknown_robot_is_refused_with_the_known_ones(world: PhysicsWorld) -> None:
    topics = WorldInterface(_Node(), PhysicsConfig.of(views="follow:middle"), None)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="there is no body 'middle'; it can follow: left, right"):
        topics.publish_scene(world)


def test_a_view_is_removed_and_added_with_its_target(world: PhysicsWorld, caplog: pytest.LogCaptureFixture) -> None:
    node = _Node()
    topics = WorldInterface(node, PhysicsConfig.of(views="top,follow:right"), None)  # type: ignore[arg-type]
    right = world.scene.robots[1]
    for change in (lambda: None, lambda: world.remove("right"), lambda: world.add(right)):
        change()
        topics.publish_scene(world)
        world.step()
        topics.publish_state(world.state(), topics.due(1), 0, 1)
    views = ["view_top", "view_follow_right"]
    assert [scene.links[-2:] == views for scene in node.sent["scene"]] == [True, False, True]
    assert [len(tf.transforms) for tf in node.sent["/tf"]] == [2, 1, 2]
    for scene, state in zip(node.sent["scene"], node.sent["scene_state"], strict=True):
        assert (len(state.poses), state.revision) == (7 * len(scene.links), scene.revision)
    assert caplog.text.count("there is no body 'right'") == 1
