"""``camera_faults``: passes on a camera's images with faults, to try what a robot does when its camera fails."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from gibson_path_following.nodes import conversions
from gibson_path_following.nodes.image_watch import ImageWatch
from gibson_path_following.nodes.parameters import declared
from gibson_path_following.nodes.running import run_node
from gibson_path_following.options import FaultOptions
from gibson_path_following.policies.faults import CameraFaults, FaultSettings
from gibson_path_following.types import STOP

_TOPIC = "camera/image_raw"


class CameraFaultsNode(Node):
    """Passes on images that are covered, missing or late; stamps stay as they are.

    Parameters: the fields of ``gibson_path_following.options.FaultOptions``.

    Subscribes:
        camera/image_raw (sensor_msgs/Image), camera/camera_info.
        cmd_vel (geometry_msgs/Twist, or TwistStamped with ``stamped``): the lens is covered a time after the first motion.

    Publishes:
        faulty/image_raw, faulty/camera_info: give ``path_policy`` the parameter image_topics: [faulty/image_raw].
    """

    def __init__(self, **kwargs: Any) -> None:
        """Reads the parameters. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            SettingError: a parameter cannot be used.
        """
        super().__init__("camera_faults", **kwargs)
        o = declared(self, FaultOptions)
        self.exit_code: int | None = None
        self._faults: CameraFaults[Any] = CameraFaults(FaultSettings(o.cover_after, o.cover, o.drop, o.delay))
        self._was_covered = False
        self._watch = ImageWatch(self, {_TOPIC: Image}, f"the remapping of {_TOPIC}")
        self._images = self.create_publisher(Image, "faulty/image_raw", qos_profile_sensor_data)
        self._infos = self.create_publisher(CameraInfo, "faulty/camera_info", qos_profile_sensor_data)
        self.create_subscription(CameraInfo, "camera/camera_info", self._infos.publish, qos_profile_sensor_data)
        self.create_subscription(Image, _TOPIC, self._on_image, qos_profile_sensor_data)
        self.create_subscription(TwistStamped if o.stamped else Twist, "cmd_vel", self._on_command, 10)

    def _on_command(self, msg: Any) -> None:
        if conversions.velocity_from(msg) not in (None, STOP):
            self._faults.move(self.get_clock().now().nanoseconds)

    def _on_image(self, msg: Any) -> None:
        stamp_ns = conversions.stamp_ns(msg.header.stamp)
        self._watch.note(_TOPIC, stamp_ns)
        for image, is_covered in self._faults.add(stamp_ns, msg):
            if is_covered != self._was_covered:
                self._was_covered = is_covered
                self.get_logger().info("the lens is covered" if is_covered else "the lens is free again")
            if is_covered:
                image.data = bytes(len(image.data))
            self._images.publish(image)

    def stop(self) -> None:
        """Ends the warnings."""
        self._watch.close()


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(CameraFaultsNode, FaultOptions, args)


if __name__ == "__main__":
    main()
