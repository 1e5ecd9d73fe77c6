"""Transforms to the optical frames of cameras that are added to a recorded run: static ones, and those of views, which move."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

from geometry_msgs.msg import TransformStamped
from rclpy.serialization import deserialize_message
from tf2_msgs.msg import TFMessage

from gibson_sim.bags.reader import BagReader
from gibson_sim.ros import conversions
from gibson_sim.ros.topics import names
from gibson_sim.ros.wire.exact_bytes import exact_bytes
from gibson_sim.ros.wire.fast_publish import FastTf
from gibson_sim.types import WORLD_FRAME, CameraSpec, Pose

TF_TYPE = "tf2_msgs/msg/TFMessage"
_MESSAGES_READ = 100
"""Number of messages of a topic that are read to find its frames."""


class CameraTransforms:
    """Adds the transform of each camera to the first message on the ``tf_static`` topic whose tree has the camera's link.

    Args:
        bag: bag of the recorded run.
        cameras: added cameras.
        copied: topics that are copied to the new bag.
    """

    def __init__(self, bag: BagReader, cameras: Sequence[CameraSpec], copied: Sequence[str]) -> None:
        self._added: dict[str, list[TransformStamped]] = {}
        topics = [t for t, info in bag.topics().items() if info.type_name == TF_TYPE and t in copied]
        statics = [topic for topic in topics if topic.endswith("tf_static")]
        if not cameras or not statics:
            return
        frames = {topic: _frames(bag, topic) for topic in topics}
        for camera in cameras:
            for static in statics:
                tree = frames[static] | frames.get(static.removesuffix("_static"), set())
                parent = _parent(camera, static, tree)
                if parent and camera.optical_frame not in tree:
                    transform = conversions.transform_to_msg(0, parent, camera.optical_frame, camera.pose)
                    self._added.setdefault(static, []).append(transform)
                if parent:
                    break

    def completed(self, topic: str, data: bytes) -> bytes:
        """Returns the serialized message with the added transforms, for the first message of a topic; otherwise the same bytes."""
        added = self._added.pop(topic, None)
        if added is None:
            return data
        message = deserialize_message(data, TFMessage)
        message.transforms = [*message.transforms, *added]
        return exact_bytes(message)


class ViewTransforms:
    """Creates the messages on ``/tf`` for views."""

    def __init__(self) -> None:
        self._frames: tuple[str, ...] = ()
        self._tf = FastTf(())

    def message(self, cameras: Sequence[CameraSpec], poses: Sequence[Pose], stamp_ns: int) -> bytes:
        """Returns the serialized message with T_world_optical of each camera, from ``poses``."""
        frames = tuple(camera.optical_frame for camera in cameras)
        if frames != self._frames:
            self._frames, self._tf = frames, FastTf([(WORLD_FRAME, frame) for frame in frames])
        return self._tf.serialize(stamp_ns, [(*pose.position, *pose.quat_xyzw) for pose in poses])


def _parent(camera: CameraSpec, topic: str, frames: set[str]) -> str:
    """Returns the parent frame of a camera in the tree of a topic; empty = the topic is not that of its robot, or lacks its link."""
    if not camera.link:
        return WORLD_FRAME
    namespace = topic.strip("/").rpartition("/")[0]
    if namespace and namespace != camera.link.partition("/")[0]:
        return ""
    return next((frame for frame in (camera.link, names.link_name(camera.link)) if frame in frames), "")


def _frames(bag: BagReader, topic: str) -> set[str]:
    """Returns the frames in the first messages of a topic."""
    frames: set[str] = set()
    for _, _, msg in islice(bag.messages([topic]), _MESSAGES_READ):
        for transform in msg.transforms:
            frames |= {transform.header.frame_id, transform.child_frame_id}
    return frames
