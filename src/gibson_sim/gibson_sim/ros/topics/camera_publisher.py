"""Publishes the messages of one camera on the topics that have subscribers."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.publisher import Publisher

from gibson_sim.config import RenderConfig
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.ros.topics import qos
from gibson_sim.ros.topics.camera_messages import REGISTERED, CameraMessages
from gibson_sim.ros.wire.fast_publish import image_to_bytes
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim.types import CameraSpec, Frame, Output

__all__ = ["REGISTERED", "CameraPublisher"]


class CameraPublisher:
    """Publishes the images, camera_info and label names of a camera.

    Args:
        node: node of the publishers.
        camera: specification of the camera in the scene.
        config: settings, including the compression of images.
        target: camera that its depth is registered to; None = none.

    Raises:
        ConfigError: its depth cannot be registered to ``target``, or a QoS override is not allowed.
    """

    def __init__(self, node: Node, camera: CameraSpec, config: RenderConfig, target: CameraSpec | None = None) -> None:
        self.camera, self.target = camera, target
        self._node = node
        self._messages = CameraMessages(camera, config, target)
        self._publishers: dict[str, Publisher] = {}
        self._label_publishers: dict[Output, Publisher] = {}
        for kind, message_type, topic in self._messages.topics():
            self._publishers[kind] = qos.make_publisher(node, message_type, topic, qos.SENSOR)
        for output, message_type, topic in self._messages.label_topics():
            self._label_publishers[output] = qos.make_publisher(node, message_type, topic, qos.LATCHED)

    @property
    def publishers(self) -> tuple[Publisher, ...]:
        """All publishers of the camera."""
        return (*self._publishers.values(), *self._label_publishers.values())

    def subscribed_kinds(self) -> frozenset[str]:
        """Returns the kinds of messages that have subscribers now; takes a few microseconds per topic."""
        return frozenset(kind for kind, publisher in self._publishers.items() if publisher.get_subscription_count())

    def to_draw(self, kinds: frozenset[str]) -> CameraSpec | None:
        """Returns the camera with the outputs that these kinds of messages need; None if none of them needs an image."""
        return self._messages.to_draw(kinds)

    def publish_info(self, stamp_ns: int, kinds: frozenset[str]) -> set[str]:
        """Publishes camera_info of the requested kinds; returns the kinds that were published."""
        published = set()
        for kind, message in self._messages.infos(stamp_ns, kinds):
            self._publishers[kind].publish(message)
            published.add(kind)
        return published

    def publish(self, frame: Frame, kinds: frozenset[str], T_target_camera: Mat4 | None) -> set[str]:
        """Publishes the requested images; returns the kinds that were published.

        Args:
            frame: frame with the outputs of ``to_draw``, without depth noise.
            kinds: requested kinds of messages.
            T_target_camera: transform to the optical frame of ``target``, at the frame's stamp; None = registration is not requested.
        """
        published = set()
        for kind, message in self._messages.images(frame, kinds, T_target_camera, image_to_bytes):
            self._publishers[kind].publish(message)
            published.add(kind)
        return published

    def publish_labels(self, scene: DrawnScene, stamp_ns: int) -> None:
        """Publishes the names of classes and instances that have changed."""
        for output, message in self._messages.labels(scene, stamp_ns):
            self._label_publishers[output].publish(message)

    def close(self) -> None:
        """Destroys the publishers; a second call does nothing."""
        publishers = self.publishers
        self._publishers, self._label_publishers = {}, {}
        for publisher in publishers:
            self._node.destroy_publisher(publisher)
