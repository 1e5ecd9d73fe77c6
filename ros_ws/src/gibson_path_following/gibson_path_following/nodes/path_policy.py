"""``path_policy``: drives the robot along a recorded path by its images."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from rclpy._rclpy_pybind11 import RCLError
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Joy
from std_msgs.msg import String

from gibson_path_following.errors import PathFollowingError, quoted
from gibson_path_following.nodes import conversions
from gibson_path_following.nodes.camera_input import CameraInput
from gibson_path_following.nodes.parameters import declared
from gibson_path_following.nodes.path_localiser import PlacePublisher
from gibson_path_following.nodes.running import run_node
from gibson_path_following.options import PolicyOptions, check_camera, check_start
from gibson_path_following.paths.path_folder import load_path
from gibson_path_following.policies.backends import make_policy
from gibson_path_following.policies.follower import FollowerSettings, PathFollower
from gibson_path_following.types import STOP, RecordedPath, Velocity, View

JOY_TIMEOUT_S = 0.5
"""Age of the newest ``joy`` from which the dead man's switch counts as released, seconds."""
_STOP_TIMEOUT = Duration(seconds=0.5)
"""Time that the last stop may take to arrive at reliable subscribers."""
_REST_NS = 1_000_000_000
"""Time for which stops are sent after the end of the path, ns; then other nodes may drive."""


class PathPolicyNode(LifecycleNode):
    """Follows a recorded path by the images. It stops when the robot is lost, when images are missing or old, at the end, and when it is deactivated.

    A lifecycle node: configure loads the path, activate drives, deactivate stops. With ``autostart`` it does both by itself.

    Parameters: the fields of ``gibson_path_following.options.PolicyOptions``.

    Subscribes, while active:
        the topics of ``image_topics`` (sensor_msgs/Image; sensor_msgs/CompressedImage for names that end in /compressed), and camera_info
            (sensor_msgs/CameraInfo) beside them.
        joy (sensor_msgs/Joy), with ``deadman_button``.

    Publishes:
        cmd_vel (geometry_msgs/Twist, or TwistStamped with ``stamped``): with each view, and ``watchdog_hz`` times a second of ROS time.
        path/state (std_msgs/String, latched): waiting (for the first image), localising (by the first images), following, lost,
            searching (lost, and rotating in place), stale (the newest image is too old), finished, held (the dead man's switch),
            failed (the policy could not use the newest view; the log says why) or inactive. The robot moves in following and
            searching alone.
        path/index, path/confidence (std_msgs/Float32), path/lost (std_msgs/Bool): with each view; /diagnostics once a second.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Reads the parameters. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            PathFollowingError: a parameter or, with ``autostart``, the path cannot be used.
        """
        super().__init__("path_policy", **kwargs)
        self._options = declared(self, PolicyOptions)
        self.exit_code: int | None = None
        self._path: RecordedPath | None = None
        self._follower: PathFollower | None = None
        self._places: PlacePublisher | None = None
        self._input: CameraInput | None = None
        self._joy: Any = None
        self._joy_ns: int | None = None
        """When the dead man's switch was last held, ns; None = it is released."""
        self._ended_ns: int | None = None
        self._failed = False
        """Whether the policy could not use the newest view."""
        self._state = ""
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._state_pub = self.create_publisher(String, "path/state", latched)
        self._cmd_pub = self.create_publisher(TwistStamped if self._options.stamped else Twist, "cmd_vel", 1)
        self._timer: Any = None
        # rclpy raises at a transition that the state does not have, which would end the node without an answer.
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        if not self._options.autostart:
            self._report("inactive")
        else:
            self._load()
            done = TransitionCallbackReturn.SUCCESS
            if self.trigger_configure() != done or self.trigger_activate() != done:
                raise PathFollowingError("path_policy cannot be activated; the lines above say why")

    def _load(self) -> None:
        """Loads path and policy.

        Raises:
            PathFollowingError: they cannot be used.
        """
        o = self._options
        path = load_path(o.path)
        check_start(o.start, len(path.nodes))
        check_camera(path.camera, o)
        policy, localiser = make_policy(o.backend, path, o.max_linear, o.max_angular, o.camera_ahead)
        settings = FollowerSettings(
            stale_after=o.stale_after, latency=o.latency, max_linear=o.max_linear, max_angular=o.max_angular,
            start=o.start if o.start >= 0.0 else None, search=o.search,
        )  # fmt: skip
        self._path, self._follower = path, PathFollower(path, policy, settings, localiser)
        self._places = PlacePublisher(self, len(path.nodes))

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Loads the path, unless that is done."""
        try:
            if self._follower is None:
                self._load()
        except PathFollowingError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begins to drive, at the start of the path."""
        path, follower, o = self._path, self._follower, self._options
        assert path is not None and follower is not None
        follower.reset()
        self._joy_ns = self._ended_ns = None
        self._failed = False
        height, width = path.nodes[0].view[0].shape[:2]
        self._input = CameraInput(
            self, o, path.camera, (width, height), path.hfov, self._on_view, self._on_jump, max_age=o.stale_after
        )
        if o.deadman_button >= 0:
            self._joy = self.create_subscription(Joy, "joy", self._on_joy, 10)
        self._timer = self.create_timer(1.0 / o.watchdog_hz, self._on_timer)  # in the robot's time: of use_sim_time too
        self.get_logger().info(f"path {o.path}: {len(path.nodes)} nodes, {path.length:.2f} m; backend {o.backend}")
        self._report(follower.state)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stops the robot."""
        self._halt()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forgets the path."""
        self._path = self._follower = self._places = None
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stops the robot."""
        self._halt()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stops the robot after a transition that failed unexpectedly."""
        self._halt()
        self._path = self._follower = self._places = None
        self.get_logger().error(f"the transition from {state.label} failed; configure and activate path_policy again")
        return super().on_error(state)

    def _on_change_state(self, request: Any, response: Any) -> Any:
        """Refuses a transition that the present state does not have."""
        state = self._state_machine.current_state[1]
        try:
            return self._change_state(request, response)
        except RCLError:
            labels = {number: label for number, label, *_ in self._state_machine.transition_graph}
            label = request.transition.label or labels.get(request.transition.id, request.transition.id)
            known = ", ".join(sorted({label for _, label, *_ in self._state_machine.available_transitions})) or "none"
            self.get_logger().error(f"transition {quoted(label)} is not possible while path_policy is {state}; possible: {known}")
            response.success = False
            return response

    def _halt(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        if self._joy is not None:
            self.destroy_subscription(self._joy)
            self._joy = None
        if self._input is not None:
            self._input.close()
            self._input = None
            self._send(STOP)
        self._report("inactive")

    def _on_joy(self, msg: Any) -> None:
        button = self._options.deadman_button
        held = button < len(msg.buttons) and bool(msg.buttons[button])
        self._joy_ns = self._now_ns() if held else None
        if not held:
            self._on_timer()

    def _may_drive(self) -> bool:
        if self._options.deadman_button < 0:
            return True
        return self._joy_ns is not None and 0 <= self._now_ns() - self._joy_ns <= JOY_TIMEOUT_S * conversions.NS_PER_S

    def _on_view(self, stamp_ns: int, view: View) -> None:
        follower, places = self._follower, self._places
        assert follower is not None and places is not None
        arrived_ns = self._now_ns()
        try:
            follower.observe(stamp_ns, view, arrived_ns)
        except PathFollowingError as error:
            # The previous command must not stay in effect while the policy fails.
            self._failed = True
            self._command(STOP, stamp_ns)
            self.get_logger().error(str(error), throttle_duration_sec=5.0)
            return
        self._failed = False
        now_ns = self._now_ns()
        velocity = follower.tick(now_ns)  # a slow policy may have needed so long that the view is stale
        if follower.state == "stale":
            self.get_logger().warning(
                f"{self._options.backend} needed {(now_ns - arrived_ns) / conversions.NS_PER_S:.1f} s for a view, after which it was "
                f"{(now_ns - stamp_ns) / conversions.NS_PER_S:.1f} s old: this machine is too slow for stale_after {self._options.stale_after:g} s",
                throttle_duration_sec=5.0,
            )
        places.publish(stamp_ns, follower.place, follower.state)
        self._command(velocity, stamp_ns)

    def _on_jump(self) -> None:
        assert self._follower is not None
        self.get_logger().warning("stamps have gone back: following anew from the start of the path")
        self._follower.reset()
        self._joy_ns = self._ended_ns = None

    def _on_timer(self) -> None:
        assert self._follower is not None
        now_ns = self._now_ns()
        self._command(self._follower.tick(now_ns), now_ns)

    def _command(self, velocity: Velocity, now_ns: int) -> None:
        """Publishes a velocity, or a stop if the policy failed or the dead man's switch is released."""
        follower = self._follower
        assert follower is not None
        if follower.state == "finished":
            self._finish(now_ns)
            return
        if self._failed:
            self._report("failed")
            self._send(follower.hold(now_ns))
            return
        if not self._may_drive():
            self._report("held")
            self._send(follower.hold(now_ns))
            return
        self._report(follower.state)
        self._send(velocity)

    def _finish(self, now_ns: int) -> None:
        """Sends stops for a while after the end of the path, then nothing."""
        self._ended_ns = now_ns if self._ended_ns is None else self._ended_ns
        self._report("finished")
        if now_ns - self._ended_ns <= _REST_NS:
            self._send(STOP)
        elif self._options.exit_at_end:
            self.exit_code = 0

    def _send(self, velocity: Velocity) -> None:
        self._cmd_pub.publish(
            conversions.twist_msg(velocity, self._now_ns(), self._options.base_frame, stamped=self._options.stamped)
        )

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _report(self, state: str) -> None:
        if state != self._state:
            self._state = state
            self._state_pub.publish(String(data=state))
            self.get_logger().info(f"state: {state}")

    def stop(self) -> None:
        """Stops the robot; returns when the stop has arrived."""
        self._halt()
        self._cmd_pub.wait_for_all_acked(_STOP_TIMEOUT)  # the process may end at once


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(PathPolicyNode, PolicyOptions, args)


if __name__ == "__main__":
    main()
