"""``path_recorder``: records a path while anything drives the robot."""

from __future__ import annotations

import math
from typing import Any, cast

from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Int32
from std_srvs.srv import Trigger

from gibson_path_following.errors import PathFollowingError
from gibson_path_following.nodes import conversions
from gibson_path_following.nodes.camera_input import CameraInput
from gibson_path_following.nodes.parameters import declared
from gibson_path_following.nodes.running import run_node
from gibson_path_following.options import RecorderOptions
from gibson_path_following.path_folder import check_folder, save_path
from gibson_path_following.recording import PathRecorder, RecorderSettings
from gibson_path_following.types import CameraKind, View


class PathRecorderNode(Node):
    """Records a path as a folder of images, while any node drives the robot.

    The folder is written when the recording ends: at path_recorder/stop, at Ctrl-C or SIGTERM, or when stamps go back (a reset of the
    simulation). Until then the path is in memory alone.

    Parameters: the fields of ``gibson_path_following.options.RecorderOptions``.

    Subscribes:
        the topics of ``image_topics`` (sensor_msgs/Image; sensor_msgs/CompressedImage for names that end in /compressed), and camera_info
            (sensor_msgs/CameraInfo) beside them.
        cmd_vel (geometry_msgs/Twist, or TwistStamped with ``stamped``): commands to the robot, from any node.
        odom (nav_msgs/Odometry), with ``use_odometry``.

    Publishes:
        path_recorder/nodes (std_msgs/Int32): number of nodes, with each new one.

    Services (std_srvs/Trigger):
        path_recorder/start, path_recorder/stop: begins a path; ends it and writes its folder.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Reads the parameters. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            PathFollowingError: a parameter or, with ``autostart``, the folder cannot be used.
        """
        super().__init__("path_recorder", **kwargs)
        self._options = o = declared(self, RecorderOptions)
        self.exit_code: int | None = None
        self._input: CameraInput | None = None
        self._recorder: PathRecorder | None = None
        self._count_pub = self.create_publisher(Int32, "path_recorder/nodes", 10)
        self._reported = 0
        self.create_subscription(TwistStamped if o.stamped else Twist, "cmd_vel", self._on_command, 50)
        if o.use_odometry:
            self.create_subscription(Odometry, "odom", self._on_odometry, qos_profile_sensor_data)
        self.create_service(Trigger, "path_recorder/start", self._on_start)
        self.create_service(Trigger, "path_recorder/stop", self._on_stop)
        if o.autostart:
            self._start()

    def _start(self) -> None:
        """Begins to record.

        Raises:
            PathFollowingError: the folder exists.
        """
        o = self._options
        check_folder(o.folder, replace=o.replace)
        hfov = math.radians(o.hfov_deg) if o.hfov_deg > 0.0 else None
        self._input = CameraInput(self, o, cast("CameraKind", o.camera), (o.width, o.height), hfov, self._on_view, self._on_jump)
        self._begin()
        self.get_logger().info(f"recording a path for {o.folder}")

    def _begin(self) -> None:
        o = self._options
        settings = RecorderSettings(o.spacing, math.radians(o.turn_deg), o.interval, o.use_odometry)
        self._recorder, self._reported = PathRecorder(cast("CameraKind", o.camera), math.nan, settings), 0

    def _save(self) -> str:
        """Ends the recording and writes the folder; returns what was written."""
        recorder, camera = self._recorder, self._input
        self._recorder = self._input = None
        if camera is not None:
            camera.close()
        if recorder is None or camera is None or camera.hfov is None:
            raise PathFollowingError(f"no image has come from {', '.join(self._options.image_topics)}: no path is written")
        recorder.hfov = camera.hfov
        path = recorder.finish()
        save_path(path, self._options.folder, replace=self._options.replace)
        poses = "with poses" if path.nodes[0].pose is not None else "without poses"
        return f"wrote {self._options.folder}: {len(path.nodes)} nodes {poses}, {path.length:.2f} m"

    def _on_view(self, stamp_ns: int, view: View) -> None:
        if self._recorder is not None:
            self._recorder.add_view(stamp_ns, view)
            self._report()

    def _on_jump(self) -> None:
        if self._recorder is None or self._recorder.nodes < 2:  # the robot has not driven yet
            self._begin()
            return
        try:
            wrote = self._save()
        except PathFollowingError as error:
            self.get_logger().error(f"the recording has ended, since stamps went back: {error}")
            return
        again = (
            "call path_recorder/start" if self._options.replace else "start the node with another folder, or with replace:=true"
        )
        self.get_logger().warning(f"the recording has ended, since stamps went back: {wrote}; to record again, {again}")

    def _on_command(self, msg: Any) -> None:
        velocity = conversions.velocity_from(msg)
        if self._recorder is not None and velocity is not None:
            self._recorder.add_command(self.get_clock().now().nanoseconds, velocity)

    def _on_odometry(self, msg: Any) -> None:
        pose = conversions.pose_from(msg)
        if self._recorder is not None and pose is not None:
            self._recorder.add_odometry(conversions.stamp_ns(msg.header.stamp), pose)
            self._report()

    def _report(self) -> None:
        if self._recorder is not None and self._recorder.nodes != self._reported:
            self._reported = self._recorder.nodes
            self._count_pub.publish(Int32(data=self._reported))

    def _on_start(self, request: Any, response: Any) -> Any:
        if self._input is not None:
            response.success, response.message = False, "a path is being recorded already; call path_recorder/stop first"
            return response
        try:
            self._start()
            response.success, response.message = True, f"recording a path for {self._options.folder}"
        except PathFollowingError as error:
            response.success, response.message = False, str(error)
        return response

    def _on_stop(self, request: Any, response: Any) -> Any:
        if self._input is None:
            response.success, response.message = False, "no path is being recorded; call path_recorder/start first"
            return response
        try:
            response.success, response.message = True, self._save()
            self.get_logger().info(response.message)
        except PathFollowingError as error:
            response.success, response.message = False, str(error)
            self.get_logger().error(str(error))
        return response

    def stop(self) -> None:
        """Writes the path that is being recorded.

        Raises:
            PathFollowingError: it cannot be written.
        """
        if self._input is not None:
            print(self._save(), flush=True)


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(PathRecorderNode, RecorderOptions, args)


if __name__ == "__main__":
    main()
