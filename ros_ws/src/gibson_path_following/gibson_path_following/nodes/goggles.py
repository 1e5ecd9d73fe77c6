"""``goggles``: adapts a camera's images to the appearance of the simulator, in which the networks of a robot were trained."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from gibson_path_following.errors import PathFollowingError
from gibson_path_following.goggles import load_reference, make_goggles
from gibson_path_following.nodes import conversions
from gibson_path_following.nodes.image_watch import ImageWatch
from gibson_path_following.nodes.parameters import declared
from gibson_path_following.nodes.running import run_node
from gibson_path_following.options import GogglesOptions

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Images that arrive while one is processed are dropped, but for the newest."""
_RELIABLE = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
"""As camera drivers publish (REP 2003): subscribers with either reliability receive the images."""


class GogglesNode(Node):
    """Adapts each image to the appearance of the simulator; stamp, frame and size stay the same.

    Parameters: the fields of ``gibson_path_following.options.GogglesOptions``.

    Subscribes:
        camera/image_raw (sensor_msgs/Image), or ``image_topic``; camera/camera_info beside it.

    Publishes:
        goggles/image_raw (sensor_msgs/Image, rgb8) and goggles/camera_info as it came, reliable: give ``path_policy`` the parameter
        image_topics: [goggles/image_raw].
    """

    def __init__(self, **kwargs: Any) -> None:
        """Reads the parameters and loads the network. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            PathFollowingError: a parameter, or a file that it names, cannot be used.
        """
        super().__init__("goggles", **kwargs)
        o = declared(self, GogglesOptions)
        self.exit_code: int | None = None
        self._goggles = make_goggles(o.mode, o.model, None if o.mode == "learned" else load_reference(o.reference))
        self._topic, self._is_compressed = o.image_topic, o.image_topic.endswith("/compressed")
        self._images = self.create_publisher(Image, "goggles/image_raw", _RELIABLE)
        self._infos = self.create_publisher(CameraInfo, "goggles/camera_info", _RELIABLE)
        beside = o.image_topic.removesuffix("/compressed").rpartition("/")[0]
        info = f"{beside}/camera_info" if beside else "camera_info"
        self.create_subscription(CameraInfo, info, self._infos.publish, qos_profile_sensor_data)
        self._watch = ImageWatch(self, [o.image_topic], "parameter image_topic")
        self.create_subscription(CompressedImage if self._is_compressed else Image, o.image_topic, self._on_image, _NEWEST)

    def _on_image(self, msg: Any) -> None:
        self._watch.note(self._topic, conversions.stamp_ns(msg.header.stamp))
        try:
            rgb = conversions.rgb_of_compressed(msg) if self._is_compressed else conversions.rgb_of_image(msg)
            adapted = self._goggles(rgb)
        except PathFollowingError as error:
            self.get_logger().error(f"{self._topic}: {error}", throttle_duration_sec=5.0)
            return
        height, width = adapted.shape[:2]
        out = Image(height=height, width=width, encoding="rgb8", step=3 * width)
        out.header, out.data = msg.header, adapted.tobytes()
        self._images.publish(out)

    def stop(self) -> None:
        """Ends the warnings."""
        self._watch.close()


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(GogglesNode, GogglesOptions, args)


if __name__ == "__main__":
    main()
