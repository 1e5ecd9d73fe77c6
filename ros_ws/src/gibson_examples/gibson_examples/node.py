"""The navigation node: localises the robot on a map and drives it to goals. A thin layer over the other modules of this package."""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import fields
from typing import Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from gibson_examples import conversions
from gibson_examples.costmap import Costmap, CostmapSettings
from gibson_examples.errors import NavigationError, TransformError, TransformNotYetError
from gibson_examples.geometry import F64, Pose2D, format_pose, parse_pose, planar
from gibson_examples.localisation import FilterSettings, Localiser, scan_points
from gibson_examples.navigator import Navigator
from gibson_examples.pure_pursuit import STOP, PursuitSettings, Velocity
from gibson_examples.settings import NavigationSettings
from gibson_examples.transforms import NS_PER_S, TransformBuffer

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SENSOR_TIMEOUT_S = 0.6
"""Age of the last scan or odometry, in the robot's time, from which the node stops the robot, seconds."""
_NEVER = 1 << 62


class NavigateNode(Node):
    """Localises the robot, plans paths and follows them.

    Messages drive everything, not timers: a scan updates the localisation, a transform odom -> base triggers a command. The node
    therefore behaves the same at any rate of the simulation, and pauses with it.

    A command at time t depends on scans before t, never on one of t: that may arrive before or after the transform of t. With every scan
    answered by a pose and every period by a command before time goes on, a drive repeats to the bit.

    Parameters: the fields of ``gibson_examples.settings.NavigationSettings``.

    Subscribes:
        map (nav_msgs/OccupancyGrid, latched), scan (sensor_msgs/LaserScan), odom (nav_msgs/Odometry), /tf, /tf_static.
        initialpose (geometry_msgs/PoseWithCovarianceStamped), goal_pose (geometry_msgs/PoseStamped): in the map frame.

    Publishes:
        cmd_vel (geometry_msgs/Twist, or TwistStamped with ``stamped``): while there is a goal that is neither reached nor failed; 0
            before the robot is localised.
        plan (nav_msgs/Path), pose (geometry_msgs/PoseWithCovarianceStamped), /tf: map -> odom.
        navigation/status (std_msgs/String, latched): ``<state> <goal>[: <why>]``; the state is waiting, driving, recovering,
            reached or failed, the goal is x,y,yaw_deg.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Reads the parameters. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            SettingError: a parameter cannot be used.
        """
        super().__init__("navigate", **kwargs)
        # Any type is accepted here, so that the settings reject a wrong one with their own message.
        any_type = ParameterDescriptor(dynamic_typing=True, read_only=True)
        values = {f.name: self.declare_parameter(f.name, f.default, any_type).value for f in fields(NavigationSettings)}
        self._settings = s = NavigationSettings(**values)
        self._pursuit = PursuitSettings(max_linear=s.max_linear, max_angular=s.max_angular)
        self._tf = TransformBuffer()
        self._localiser: Localiser | None = None
        self._costmap: Costmap | None = None
        self._navigator: Navigator | None = None
        self._initial = parse_pose(s.initial_pose, "parameter initial_pose") if s.initial_pose else None
        self._initial_sigma = (s.initial_sigma_xy, math.radians(s.initial_sigma_yaw_deg))
        self._goal = parse_pose(s.goal, "parameter goal") if s.goal else None
        self._scans: deque[Any] = deque(maxlen=10)
        """Scans that wait for the transforms of their time: on a busy machine /tf arrives later."""
        self._newest_scan_ns = self._scanned_ns = self._odometry_ns = -_NEVER
        self._commanded_ns: int | None = None
        """Time of the last command, or of the goal if that is newer: the next command is due a period after it."""
        self._period_ns = int(NS_PER_S / s.control_hz)
        self._status = ""
        """Last status published."""
        self._planned: Any = None
        """Last path published."""
        self.exit_code: int | None = None
        """Set when ``exit_at_goal`` ends the node."""
        self._make_publishers()
        self._make_subscriptions()
        self._report("waiting for the map")

    def _make_publishers(self) -> None:
        self._cmd_pub = self.create_publisher(TwistStamped if self._settings.stamped else Twist, "cmd_vel", 1)
        self._plan_pub = self.create_publisher(Path, "plan", LATCHED)
        self._pose_pub = self.create_publisher(PoseWithCovarianceStamped, "pose", 10)
        self._tf_pub = self.create_publisher(TFMessage, "/tf", 100)
        self._status_pub = self.create_publisher(String, "navigation/status", LATCHED)

    def _make_subscriptions(self) -> None:
        """Subscribes. Of messages that wait, the executor takes those of the first subscription first: poses and goals before what uses them."""
        latched = QoSProfile(depth=100, durability=LATCHED.durability)
        self.create_subscription(PoseWithCovarianceStamped, "initialpose", self._on_initial_pose, 10)
        self.create_subscription(PoseStamped, "goal_pose", self._on_goal, 10)
        self.create_subscription(OccupancyGrid, "map", self._on_map, LATCHED)
        self.create_subscription(TFMessage, "/tf_static", self._on_tf_static, latched)
        self.create_subscription(Odometry, "odom", self._on_odometry, 1)
        # A short queue: on a busy machine, a command from the newest transform matters more than one from each old transform.
        self.create_subscription(TFMessage, "/tf", self._on_tf, 10)
        self.create_subscription(LaserScan, "scan", self._on_scan, qos_profile_sensor_data)

    def _on_map(self, msg: Any) -> None:
        try:
            grid = conversions.grid_from(msg)
        except NavigationError as error:
            self.get_logger().error(str(error))
            return
        s, before, drove = self._settings, self._localiser, self._navigator
        if before is not None and before.map_from_odom is not None:
            self._initial = before.map_from_odom @ self._odom_pose(None)
        self._localiser = Localiser(grid, FilterSettings(particles=s.particles), s.seed)
        self._costmap = Costmap(grid, CostmapSettings(robot_radius=s.robot_radius))
        self._navigator = Navigator(self._costmap, pursuit=self._pursuit)
        if self._goal is not None and (drove is None or drove.active):
            self._navigator.set_goal(self._goal)
        self.get_logger().info(f"map of {grid.shape[1]} x {grid.shape[0]} cells of {grid.resolution:g} m")
        self._control()
        self._localise()

    def _on_initial_pose(self, msg: Any) -> None:
        try:
            self._check_frame(msg, "initialpose")
            self._initial = conversions.pose_from(msg.pose.pose)
        except NavigationError as error:
            self.get_logger().error(str(error))
            return
        variance = msg.pose.covariance
        if variance[0] > 0.0 and variance[35] > 0.0:
            self._initial_sigma = (math.sqrt(max(variance[0], variance[7])), math.sqrt(variance[35]))

    def _on_goal(self, msg: Any) -> None:
        try:
            self._check_frame(msg, "goal_pose")
            self._goal = conversions.pose_from(msg.pose)
        except NavigationError as error:
            self.get_logger().error(str(error))
            return
        self._commanded_ns = self._tf.newest_ns(self._settings.base_frame)
        if self._navigator is not None:
            self._navigator.set_goal(self._goal)

    def _check_frame(self, msg: Any, what: str) -> None:
        if msg.header.frame_id not in ("", self._settings.map_frame):
            raise NavigationError(
                f"{what} is in frame {msg.header.frame_id!r}, must be in {self._settings.map_frame!r}; it is ignored"
            )

    def _on_tf_static(self, msg: Any) -> None:
        for t in msg.transforms:
            self._tf.set_static(t.header.frame_id, t.child_frame_id, *conversions.translation_and_quat(t.transform))
        self._localise()

    def _on_tf(self, msg: Any) -> None:
        s, moved = self._settings, False
        for t in msg.transforms:
            if t.header.frame_id == s.map_frame:  # this node publishes that one
                continue
            ns, child = conversions.stamp_ns(t.header.stamp), t.child_frame_id
            if child == s.base_frame:
                moved = True
                if ns < (self._tf.newest_ns(child) or 0):
                    self._reset()
            self._tf.add(ns, t.header.frame_id, child, *conversions.translation_and_quat(t.transform))
        if moved:
            self._control()
        self._localise()

    def _on_odometry(self, msg: Any) -> None:
        self._odometry_ns = conversions.stamp_ns(msg.header.stamp)

    def _on_scan(self, msg: Any) -> None:
        ns = conversions.stamp_ns(msg.header.stamp)
        if ns < self._newest_scan_ns:
            self._reset()
        self._newest_scan_ns = ns
        self._scans.append(msg)
        self._localise()

    def _odom_pose(self, ns: int | None) -> Pose2D:
        """Returns T_odom_base at a time; None = the newest."""
        return planar(self._tf.lookup(self._settings.odom_frame, self._settings.base_frame, ns))

    def _localise(self) -> None:
        """Processes the newest scan whose transforms are known, and drops older scans."""
        if self._localiser is None or self._costmap is None:
            return
        s = self._settings
        for i in reversed(range(len(self._scans))):
            scan = self._scans[i]
            ns = conversions.stamp_ns(scan.header.stamp)
            try:
                odom = self._odom_pose(ns)
                base_from_scan = self._tf.lookup(s.base_frame, scan.header.frame_id, ns)
            except TransformNotYetError:
                continue
            except TransformError as error:
                self.get_logger().warning(f"scan dropped: {error}", throttle_duration_sec=5.0)
                scan = None
            for _ in range(i + 1):
                self._scans.popleft()
            if scan is not None:
                self._process_scan(self._localiser, self._costmap, scan, ns, odom, base_from_scan)
            return

    def _process_scan(
        self, localiser: Localiser, costmap: Costmap, scan: Any, ns: int, odom: Pose2D, base_from_scan: F64
    ) -> None:
        """Updates localisation and costmap with a scan; T_odom_base ``odom`` and T_base_scan (4, 4) are those of its stamp."""
        self._scanned_ns = ns
        if self._initial is not None:
            localiser.initialise(self._initial, *self._initial_sigma, odom)
            self._initial = None
        ends, hits = scan_points(scan.ranges, scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
        ends = ends @ base_from_scan[:2, :2].T + base_from_scan[:2, 3]
        localiser.update(odom, ends[hits])
        if localiser.map_from_odom is None:
            self._report("waiting for initialpose")
            return
        pose = localiser.map_from_odom @ odom
        sensor = pose.transform(base_from_scan[None, :2, 3])[0]
        costmap.add_scan(sensor, pose.transform(ends), hits, ns / NS_PER_S)
        self._publish_pose(pose, localiser.map_from_odom, ns)

    def _reset(self) -> None:
        """Discards the localisation after time has jumped back: the simulation was reset, and the odometry with it."""
        self.get_logger().warning("time has jumped back: the robot must be localised again")
        self._scans.clear()
        self._tf.forget_moving()
        self._newest_scan_ns = self._odometry_ns = self._scanned_ns = -_NEVER
        if self._localiser is not None and self._costmap is not None:
            self._localiser.forget()
            self._costmap.forget_obstacles()
        if self._settings.initial_pose:
            self._initial = parse_pose(self._settings.initial_pose, "parameter initial_pose")

    def _publish_pose(self, pose: Pose2D, map_from_odom: Pose2D, ns: int) -> None:
        assert self._localiser is not None
        s = self._settings
        ahead = ns + int(s.transform_tolerance * NS_PER_S)
        self._tf_pub.publish(TFMessage(transforms=[conversions.transform_msg(map_from_odom, ahead, s.map_frame, s.odom_frame)]))
        self._pose_pub.publish(conversions.pose_with_covariance_msg(pose, self._localiser.covariance, ns, s.map_frame))

    def _control(self) -> None:
        """Publishes the next command if it is due."""
        navigator, ns = self._navigator, self._tf.newest_ns(self._settings.base_frame)
        if ns is None:
            return
        if self._commanded_ns is None or ns < self._commanded_ns:
            # As if the last command had been at a whole period before.
            self._commanded_ns = (ns - 1) // self._period_ns * self._period_ns
        if navigator is None or self._goal is None or ns - self._commanded_ns < self._period_ns:
            return
        self._commanded_ns = ns
        pose = self._pose()
        if pose is None:
            if navigator.active:
                self._send(STOP, ns)
            return
        command = navigator.step(pose, ns / NS_PER_S)
        blind = ns - min(self._scanned_ns, self._odometry_ns) > SENSOR_TIMEOUT_S * NS_PER_S
        if command is not None and blind:
            missing = "scan" if self._scanned_ns < self._odometry_ns else "odometry"
            self.get_logger().warning(f"no {missing} for {SENSOR_TIMEOUT_S:g} s: standing still", throttle_duration_sec=5.0)
            command = STOP
        if command is not None:
            self._send(command, ns)
        self._publish_progress(ns)

    def _pose(self) -> Pose2D | None:
        """Returns T_map_base by the newest odometry; None = the robot is not localised."""
        if self._localiser is None or self._localiser.map_from_odom is None:
            return None
        try:
            return self._localiser.map_from_odom @ self._odom_pose(None)
        except TransformError:
            return None

    def _send(self, command: Velocity, ns: int) -> None:
        s = self._settings
        self._cmd_pub.publish(conversions.twist_msg(command, ns, s.base_frame, stamped=s.stamped))

    def _publish_progress(self, ns: int) -> None:
        """Publishes the plan and the state, each if it has changed."""
        navigator = self._navigator
        assert navigator is not None
        assert self._goal is not None
        path = navigator.path
        if path is not self._planned and len(path):
            self._planned = path
            self._plan_pub.publish(conversions.path_msg(path, ns, self._settings.map_frame))
        reason = f": {navigator.reason}" if navigator.state in ("recovering", "failed") else ""
        self._report(f"{navigator.state} {format_pose(self._goal)}{reason}")
        if self._settings.exit_at_goal and navigator.state in ("reached", "failed"):
            self.exit_code = 0 if navigator.state == "reached" else 1

    def _report(self, status: str) -> None:
        if status != self._status:
            self._status = status
            self._status_pub.publish(String(data=status))
            self.get_logger().info(status)

    def stop(self) -> None:
        """Stops the robot."""
        if self._goal is not None and self._navigator is not None:
            self._send(STOP, self._commanded_ns or 0)


def configure_logging() -> None:
    """Prints the log of the modules without ROS to stderr."""
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
