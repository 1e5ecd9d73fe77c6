"""``path_localiser``: localises the robot on a recorded path by its images."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.node import Node
from std_msgs.msg import Bool, Float32

from gibson_path_following.errors import PathFollowingError
from gibson_path_following.localisation.localiser import Localiser
from gibson_path_following.localisation.motions import CommandLog, Motion
from gibson_path_following.nodes import conversions
from gibson_path_following.nodes.camera_input import CameraInput
from gibson_path_following.nodes.parameters import declared
from gibson_path_following.nodes.running import run_node
from gibson_path_following.options import LocaliserOptions, check_start
from gibson_path_following.paths.path_folder import load_path
from gibson_path_following.types import Place, View


class PlacePublisher:
    """Publishes the place of the robot on the path."""

    def __init__(self, node: Any, nodes: int) -> None:
        self._node, self._nodes = node, nodes
        self._index = node.create_publisher(Float32, "path/index", 10)
        self._confidence = node.create_publisher(Float32, "path/confidence", 10)
        self._lost = node.create_publisher(Bool, "path/lost", 10)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._diagnosed_ns: int | None = None

    def publish(self, stamp_ns: int, place: Place | None, state: str) -> None:
        """Publishes a place; a diagnosis once a second of the images' time, and when the state changes."""
        if place is not None:
            self._index.publish(Float32(data=place.index))
            self._confidence.publish(Float32(data=place.confidence))
        is_lost = place is None or place.is_lost or state == "lost"
        self._lost.publish(Bool(data=is_lost))
        if self._diagnosed_ns is not None and 0 <= stamp_ns - self._diagnosed_ns < conversions.NS_PER_S:
            return
        self._diagnosed_ns = stamp_ns
        status = DiagnosticStatus(name=f"{self._node.get_name()}: place on the path", hardware_id="")
        status.level = DiagnosticStatus.WARN if is_lost else DiagnosticStatus.OK
        status.message = state
        if place is not None:
            values = {"index": f"{place.index:.2f}", "nodes": str(self._nodes), "confidence": f"{place.confidence:.2f}"}
            status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
        msg = DiagnosticArray(status=[status])
        msg.header.stamp = conversions.time_msg(stamp_ns)
        self._diagnostics.publish(msg)


class PathLocaliserNode(Node):
    """Localises the robot on a recorded path by its images, without driving it.

    Parameters: the fields of ``gibson_path_following.options.LocaliserOptions``.

    Subscribes:
        the topics of ``image_topics`` (sensor_msgs/Image; sensor_msgs/CompressedImage for names that end in /compressed), and camera_info
            (sensor_msgs/CameraInfo) beside them.
        cmd_vel (geometry_msgs/Twist, or TwistStamped with ``stamped``), with ``use_commands``: predict the motion. Without a publisher
            the motion is unknown, and the robot is localised by the images alone.

    Publishes, with each view:
        path/index (std_msgs/Float32): node, with a fraction. path/confidence (std_msgs/Float32): 0 to 1. path/lost (std_msgs/Bool).
        /diagnostics (diagnostic_msgs/DiagnosticArray): once a second.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Reads the parameters and the path. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            PathFollowingError: a parameter or the path cannot be used.
        """
        super().__init__("path_localiser", **kwargs)
        self._options = o = declared(self, LocaliserOptions)
        self.exit_code: int | None = None
        path = load_path(o.path)
        check_start(o.start, len(path.nodes))
        self._localiser = Localiser(path)
        self._log = CommandLog()
        self._localised_ns: int | None = None
        self._publisher = PlacePublisher(self, len(path.nodes))
        height, width = path.nodes[0].view[0].shape[:2]
        self._commands: Any = None
        if o.use_commands:
            self._commands = self.create_subscription(TwistStamped if o.stamped else Twist, "cmd_vel", self._on_command, 50)
        self._reset()
        self._input = CameraInput(self, o, path.camera, (width, height), path.hfov, self._on_view, self._on_jump)

    def _on_jump(self) -> None:
        self.get_logger().warning("stamps have gone back: localising anew")
        self._reset()

    def _reset(self) -> None:
        self._localiser.reset(self._options.start if self._options.start >= 0.0 else None)
        self._log.clear()
        self._localised_ns = None

    def _on_command(self, msg: Any) -> None:
        velocity = conversions.velocity_from(msg)
        if velocity is not None:
            self._log.add(self.get_clock().now().nanoseconds, velocity)

    def _on_view(self, stamp_ns: int, view: View) -> None:
        try:
            place = self._localiser.update(view, self._motion(stamp_ns))
        except PathFollowingError as error:
            self.get_logger().error(str(error), throttle_duration_sec=5.0)
            return
        self._localised_ns = stamp_ns
        self._publisher.publish(stamp_ns, place, "lost" if place.is_lost else "localised")

    def _motion(self, stamp_ns: int) -> Motion | None:
        """Returns the commanded motion since the previous view; None = unknown."""
        if self._commands is None or self._localised_ns is None:
            return None
        if not self.count_publishers(self._commands.topic_name):  # a person may push the robot now
            self._log.clear()
        return self._log.known_motion(self._localised_ns, stamp_ns)

    def stop(self) -> None:
        """Ends the subscriptions."""
        self._input.close()


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(PathLocaliserNode, LocaliserOptions, args)


if __name__ == "__main__":
    main()
