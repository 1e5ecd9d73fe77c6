"""``path_recorder``: records a path while anything drives the robot."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any, cast

from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Int32
from std_srvs.srv import Trigger

from gibson_path_following.errors import PathFolderError, PathFollowingError
from gibson_path_following.nodes import conversions
from gibson_path_following.nodes.camera_input import CameraInput
from gibson_path_following.nodes.parameters import declared
from gibson_path_following.nodes.running import run_node
from gibson_path_following.options import RecorderOptions
from gibson_path_following.paths.path_folder import MAX_NODES, PathWriter, check_path, expanded, max_nodes, new_folder
from gibson_path_following.paths.recording import PathRecorder, RecorderSettings
from gibson_path_following.types import CameraKind, RecordedPath, View


class PathRecorderNode(Node):
    """Records a path as a folder of images, while any node drives the robot.

    The folder is written when the recording ends: at path_recorder/stop, at Ctrl-C or SIGTERM, when stamps go back (a reset of the
    simulation), or when the path is as long as can be read. Until then the path is in memory alone. A path that cannot be written is kept:
    path_recorder/stop tries again, and the end of the node writes it to a folder beside (NAME-2).

    Parameters: the fields of ``gibson_path_following.options.RecorderOptions``.

    Subscribes:
        the topics of ``image_topics`` (sensor_msgs/Image; sensor_msgs/CompressedImage for names that end in /compressed), and camera_info
            (sensor_msgs/CameraInfo) beside them.
        cmd_vel (geometry_msgs/Twist, or TwistStamped with ``stamped``): commands to the robot, from any node.
        odom (nav_msgs/Odometry), with ``use_odometry``.

    Publishes:
        path_recorder/nodes (std_msgs/Int32): number of nodes, with each new one.

    Services (std_srvs/Trigger):
        path_recorder/start, path_recorder/stop: begins a path; ends it and writes its folder, again if that failed.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Reads the parameters. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            PathFollowingError: a parameter or, with ``autostart``, the folder cannot be used.
        """
        super().__init__("path_recorder", **kwargs)
        self._options = o = declared(self, RecorderOptions)
        self.exit_code: int | None = None
        self._folder = expanded(o.folder)
        self._input: CameraInput | None = None
        self._recorder: PathRecorder | None = None
        self._writer: PathWriter | None = None
        """Has the folder from the start of a recording until its path is written."""
        self._unsaved: tuple[RecordedPath, str] | None = None
        """A path that could not be written, and what to say of it once it is."""
        self._count_pub = self.create_publisher(Int32, "path_recorder/nodes", 10)
        self._reported = 0
        self.create_subscription(TwistStamped if o.stamped else Twist, "cmd_vel", self._on_command, 50)
        if o.use_odometry:
            self.create_subscription(Odometry, "odom", self._on_odometry, qos_profile_sensor_data)
        self.create_service(Trigger, "path_recorder/start", self._on_start)
        self.create_service(Trigger, "path_recorder/stop", self._on_stop)
        if o.autostart:
            self._start()

    def _start(self) -> str:
        """Begins to record; returns what to say.

        Raises:
            PathFollowingError: the folder exists, cannot be written, or another recorder has it.
        """
        o = self._options
        self._writer = PathWriter(self._folder, replace=o.replace)
        hfov = math.radians(o.hfov_deg) if o.hfov_deg > 0.0 else None
        self._input = CameraInput(self, o, cast("CameraKind", o.camera), (o.width, o.height), hfov, self._on_view, self._on_jump)
        self._begin()
        text = f"recording a path for {self._folder}"
        if self._max_nodes < MAX_NODES:
            text += f": at most {self._max_nodes} nodes, by the size of their images"
        self.get_logger().info(text)
        return text

    @property
    def _max_nodes(self) -> int:
        return max_nodes(cast("CameraKind", self._options.camera), self._options.width, self._options.height)

    def _begin(self) -> None:
        o, warn = self._options, self.get_logger().warning
        settings = RecorderSettings(o.spacing, math.radians(o.turn_deg), o.interval, o.use_odometry)
        self._recorder = PathRecorder(cast("CameraKind", o.camera), math.nan, settings, max_nodes=self._max_nodes, warn=warn)
        self._reported = 0

    def _end(self) -> None:
        """Ends the recording, and keeps its path until it is written.

        Raises:
            PathFollowingError: there is no path.
        """
        recorder, camera = self._recorder, self._input
        self._recorder = self._input = None
        if recorder is None or camera is None:
            return
        camera.close()
        path = None
        if camera.hfov is not None:
            recorder.hfov = camera.hfov
            path = recorder.finish()
        if path is None or not path.nodes:
            topics = ", ".join(map(self.resolve_topic_name, self._options.image_topics))
            reason = f"no image could be used: {camera.problem}" if camera.problem else f"no image has come from {topics}"
            raise PathFollowingError(f"no path is written: {reason}")
        if len(path.nodes) < 2:
            raise PathFollowingError(f"no path is written: {recorder.missing()}")
        check_path(path, "no path is written")
        poses = "with poses" if path.nodes[0].pose is not None else "without poses"
        text = "; ".join((f"{len(path.nodes)} nodes {poses}, {path.length:.2f} m", *recorder.remarks(path)))
        self._unsaved = (path, text)

    def _save(self) -> str:
        """Ends the recording and writes the folder; returns what was written. A path that cannot be written is kept.

        Raises:
            PathFollowingError: there is no path, or it cannot be written.
        """
        try:
            self._end()
            if self._unsaved is None or self._writer is None:
                raise PathFollowingError("no path has been recorded; call path_recorder/start first")
            return self._write(self._writer)
        finally:
            if self._unsaved is None:
                self._release()

    def _write(self, writer: PathWriter) -> str:
        assert self._unsaved is not None
        path, text = self._unsaved
        writer.write(path)
        self._unsaved = None
        return f"wrote {writer.folder}: {text}"

    def _write_elsewhere(self) -> str:
        """Writes the path that could not be written beside its folder, or, if nothing can be written there, to that of temporary files."""
        try:
            with PathWriter(new_folder(self._folder)) as writer:
                return self._write(writer)
        except PathFolderError:
            with PathWriter(new_folder(Path(tempfile.gettempdir()) / (self._folder.name or "path"))) as writer:
                return self._write(writer)

    def _release(self) -> None:
        """Gives the folder back, so that another recorder can have it."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _on_view(self, stamp_ns: int, view: View) -> None:
        if self._recorder is not None:
            self._recorder.add_view(stamp_ns, view)
            self._report()

    def _on_jump(self) -> None:
        if self._recorder is not None and self._recorder.nodes < 2:  # the robot has not driven yet
            self._begin()
        elif self._recorder is not None:
            self._end_early("stamps went back")

    def _end_early(self, reason: str) -> None:
        """Ends the recording and writes it, since it cannot go on."""
        try:
            wrote = self._save()
        except PathFollowingError as error:
            kept = f"; {self._kept}" if self._unsaved is not None else ""
            self.get_logger().error(f"the recording has ended, since {reason}: {error}{kept}")
            return
        again = (
            "call path_recorder/start" if self._options.replace else "start the node with another folder, or with replace:=true"
        )
        self.get_logger().warning(f"the recording has ended, since {reason}: {wrote}; to record again, {again}")

    @property
    def _kept(self) -> str:
        return f"the path is kept: call path_recorder/stop to try again, or end the node, which writes {self._folder.name}-2"

    def _on_command(self, msg: Any) -> None:
        if self._recorder is not None:
            self._recorder.add_command(self.get_clock().now().nanoseconds, conversions.velocity_from(msg))

    def _on_odometry(self, msg: Any) -> None:
        if self._recorder is not None:
            self._recorder.add_odometry(conversions.stamp_ns(msg.header.stamp), conversions.pose_from(msg))
            self._report()

    def _report(self) -> None:
        if self._recorder is not None and self._recorder.nodes != self._reported:
            self._reported = self._recorder.nodes
            self._count_pub.publish(Int32(data=self._reported))
        if self._recorder is not None and self._recorder.is_full:
            self._end_early(f"the path is as long as can be read ({self._recorder.nodes} nodes)")

    def _on_start(self, request: Any, response: Any) -> Any:
        if self._input is not None:
            response.success, response.message = False, "a path is being recorded already; call path_recorder/stop first"
            return response
        if self._unsaved is not None:
            response.success, response.message = False, f"the last path is not written yet; {self._kept}"
            return response
        try:
            response.success, response.message = True, self._start()
        except PathFollowingError as error:
            response.success, response.message = False, str(error)
        return response

    def _on_stop(self, request: Any, response: Any) -> Any:
        if self._input is None and self._unsaved is None:
            response.success, response.message = False, "no path is being recorded; call path_recorder/start first"
            return response
        try:
            response.success, response.message = True, self._save()
            self.get_logger().info(response.message)
        except PathFollowingError as error:
            response.success, response.message = False, f"{error}; {self._kept}" if self._unsaved is not None else str(error)
            self.get_logger().error(response.message)
        return response

    def stop(self) -> None:
        """Writes the path that is being recorded, or was not written yet.

        Raises:
            PathFollowingError: there is none, or it was written elsewhere, or cannot be written.
        """
        if self._input is None and self._unsaved is None:
            return
        try:
            print(self._save(), flush=True)
        except PathFolderError as error:
            if self._unsaved is None:
                raise
            # The exit code must say that the folder does not hold this path.
            raise PathFollowingError(f"{error}; {self._write_elsewhere()}") from error
        finally:
            self._release()


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(PathRecorderNode, RecorderOptions, args)


if __name__ == "__main__":
    main()
