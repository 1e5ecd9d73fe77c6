"""All messages of one camera: their topics, the outputs that must be rendered for them, their contents, and their publishers.

The render node publishes them on the topics that have subscribers, and ``render_bag`` writes them to a bag.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from gibson_sim.config import RenderConfig
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.ros import conversions
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.wire.fast_publish import image_to_bytes, restamped
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim.sensors.depth_noise import apply_depth_noise
from gibson_sim.sensors.depth_registration import DepthRegistration, split_for
from gibson_sim.sensors.image_codecs import COMPRESSED_DEPTH_FORMAT, ColorCodec, color_format, encode_color, encode_depth
from gibson_sim.sensors.point_cloud import cloud_of_frame
from gibson_sim.types import CameraSpec, Frame, Output

COMPRESSED, COMPRESSED_DEPTH, POINTS, REGISTERED, REGISTERED_INFO = (
    "compressed", "compressed_depth", "points", "registered", "registered_info",
)  # fmt: skip
"""Kinds of messages, in addition to those of ``names.camera_topics``."""
_LABELS: tuple[Output, ...] = ("semantic", "instance")


class CameraMessages:
    """Creates the messages of a camera.

    Args:
        camera: specification of the camera in the scene.
        config: settings, including the compression of images.
        target: camera that its depth is registered to; None = none.

    Raises:
        ConfigError: its depth cannot be registered to ``target``.
    """

    def __init__(self, camera: CameraSpec, config: RenderConfig, target: CameraSpec | None = None) -> None:
        self.camera, self.target = camera, target
        self._config = config
        self._labels: dict[Output, tuple[str, ...]] = {}
        self._infos: dict[str, bytes] = {}
        self._drawn: dict[frozenset[str], CameraSpec | None] = {}
        self._registration: tuple[bytes, DepthRegistration] | None = None
        if target is not None:
            split_for(camera, target)  # raises now, not at the first image

    def topics(self) -> Iterator[tuple[str, Any, str]]:
        """Yields kind, type and topic of all messages at the camera's rate."""
        camera, topics = self.camera, names.camera_topics(self.camera.name)
        for output in camera.outputs:
            yield output, Image, topics[output]
            yield f"{output}_info", CameraInfo, topics[f"{output}_info"]
        if "rgb" in camera.outputs:
            yield COMPRESSED, CompressedImage, names.compressed_topic(topics["rgb"])
        if "depth" in camera.outputs:
            yield COMPRESSED_DEPTH, CompressedImage, names.compressed_depth_topic(topics["depth"])
            yield POINTS, PointCloud2, names.points_topic(camera.name)
            if self.target is not None:
                image, info = names.registered_depth_topics(camera.name)
                yield REGISTERED, Image, image
                yield REGISTERED_INFO, CameraInfo, info

    def label_topics(self) -> Iterator[tuple[Output, Any, str]]:
        """Yields output, type and topic of the latched messages that name the classes and instances in label images."""
        for output in _LABELS:
            if output in self.camera.outputs:
                yield output, conversions.label_info_type(), names.label_info_topic(self.camera.name, output)

    def to_draw(self, kinds: frozenset[str]) -> CameraSpec | None:
        """Returns the camera with the outputs that these kinds of messages need; None if none of them needs an image.

        The result is the same object for the same kinds, since renderers prepare each camera object once.
        """
        if kinds not in self._drawn:
            self._drawn[kinds] = self._with_outputs_for(kinds)
        return self._drawn[kinds]

    def _with_outputs_for(self, kinds: frozenset[str]) -> CameraSpec | None:
        needed: set[str] = {kind for kind in kinds if kind in self.camera.outputs}
        if COMPRESSED in kinds or POINTS in kinds:
            needed.add("rgb")
        if kinds & {COMPRESSED_DEPTH, POINTS, REGISTERED}:
            needed.add("depth")
        if "depth" in needed and self.camera.depth_noise.hole_angle_deg < 90.0:
            needed.add("normal")  # holes depend on the normals if the camera has them: depth must not depend on the subscribers
        outputs = tuple(output for output in self.camera.outputs if output in needed)
        return replace(self.camera, outputs=outputs) if outputs else None

    def infos(
        self, stamp_ns: int, kinds: frozenset[str], serialize: Callable[[Any], bytes] = serialize_message
    ) -> Iterator[tuple[str, bytes]]:
        """Yields the kind and the bytes of each requested camera_info; only the first of each kind is serialised, later ones are restamped.

        Args:
            stamp_ns: stamp of the image, ns.
            kinds: requested kinds of messages; those that are not camera_info are ignored.
            serialize: ``serialize_message`` of rclpy, or ``exact_bytes``.
        """
        for kind in sorted(kinds):
            if not kind.endswith("_info"):
                continue
            if kind not in self._infos:
                camera = self.target if kind == REGISTERED_INFO and self.target is not None else self.camera
                self._infos[kind] = serialize(conversions.camera_info_to_msg(camera, stamp_ns))
            yield kind, restamped(self._infos[kind], stamp_ns)

    def images(
        self,
        frame: Frame,
        kinds: frozenset[str],
        T_target_camera: Mat4 | None,
        make_image: Callable[..., Any] = conversions.image_to_msg,
    ) -> Iterator[tuple[str, Any]]:
        """Yields the kind and the message of each requested image.

        Args:
            frame: frame with the outputs of ``to_draw``, without depth noise.
            kinds: requested kinds of messages.
            T_target_camera: transform to the optical frame of ``target``, at the frame's stamp; None = registration is not requested.
            make_image: creates a sensor_msgs/Image: ``conversions.image_to_msg``, or ``fast_publish.image_to_bytes``.
        """
        frame = apply_depth_noise(frame, self.camera.depth_noise)
        config, stamp, frame_id = self._config, frame.stamp_ns, self.camera.optical_frame
        yield from conversions.frame_to_image_msgs(frame, kinds & set(self.camera.outputs), make_image)
        if COMPRESSED in kinds and frame.rgb is not None:
            codec: ColorCodec = "png" if config.compressed_format == "png" else "jpeg"
            encoded = encode_color(frame.rgb, codec, jpeg_quality=config.jpeg_quality, png_level=config.png_level)
            yield COMPRESSED, conversions.compressed_to_msg(encoded.tobytes(), color_format(codec), stamp, frame_id)
        if frame.depth is None:
            return
        if COMPRESSED_DEPTH in kinds:
            data = encode_depth(
                frame.depth, depth_max=config.compressed_depth_max, quantization=config.compressed_depth_quantization,
                png_level=config.png_level,
            )  # fmt: skip
            yield COMPRESSED_DEPTH, conversions.compressed_to_msg(data, COMPRESSED_DEPTH_FORMAT, stamp, frame_id)
        if POINTS in kinds:
            yield POINTS, conversions.cloud_to_msg(cloud_of_frame(frame), stamp, frame_id)
        if REGISTERED in kinds and self.target is not None and T_target_camera is not None:
            pixels = self._registration_for(T_target_camera).image(frame.depth)
            yield REGISTERED, make_image(pixels, "32FC1", stamp, self.target.optical_frame)

    def _registration_for(self, T_target_camera: Mat4) -> DepthRegistration:
        """Returns the registration to ``target``; it is reused while the two cameras do not move relative to each other."""
        assert self.target is not None
        key = (T_target_camera.round(9) + 0.0).tobytes()  # + 0.0 turns -0.0 into 0.0, which has other bytes
        if self._registration is None or self._registration[0] != key:
            self._registration = key, DepthRegistration(self.camera, self.target, T_target_camera)
        return self._registration[1]

    def labels(self, scene: DrawnScene, stamp_ns: int) -> Iterator[tuple[Output, Any]]:
        """Yields the output and the message of the label names that have changed since the last call."""
        for output in _LABELS:
            if output not in self.camera.outputs:
                continue
            labels = scene.semantic_classes if output == "semantic" else scene.instances
            if self._labels.get(output) != labels:
                self._labels[output] = labels
                yield output, conversions.label_info_to_msg(labels, stamp_ns, self.camera.optical_frame)


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
