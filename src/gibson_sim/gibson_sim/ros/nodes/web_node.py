"""The web node: serves the live page, which shows and drives the robots of a ROS domain by standard topics and services alone."""

from __future__ import annotations

import math
import secrets
import sys
import time
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue
from typing import Any

import cv2
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from simulation_interfaces.srv import GetEntitiesStates, GetNamedPoses, GetSimulationState, GetSpawnables
from tf2_msgs.msg import TFMessage

from gibson_sim.bags.stamps import stamp_ns
from gibson_sim.client_config import WebConfig
from gibson_sim.errors import GibsonSimError
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose
from gibson_sim.quoting import quoted
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node, started_by_launcher
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.topics import names
from gibson_sim.ros.web.scene_stream import SceneStream
from gibson_sim.ros.web.simulation_client import STATES, SimulationClient, flat_pose
from gibson_sim.ros.web.transform_tree import TransformTree
from gibson_sim.ros.web.video_subscriptions import VideoSubscriptions, image_topics, label_of
from gibson_sim.standard.job_folder import PAGE, note_in_job
from gibson_sim.types import NS_PER_S, WORLD_FRAME, Pose
from gibson_sim.web.requests import Drive, Goal, Request, Spawn
from gibson_sim.web.server import LOOPBACK, PageServer
from gibson_sim.web.videos import SCENE

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_MANY = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_LATCHED_MANY = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_MOST_POINTS = 400
"""Points of a scan and of a path that a page gets."""
_FAST_S, _SLOW_S = 0.1, 1.0
"""Seconds of wall time between poses, and between looks at the graph, the entities and the state."""
_ODOMETRY = "nav_msgs/msg/Odometry"
_GAP_S = 2.0
"""Seconds after which a diagnosis is old."""


class WebNode(Node):
    """Serves the live page.

    Publishes:
        <robot>/cmd_vel (geometry_msgs/Twist, or TwistStamped where that is all that has subscribers): while a page drives.
        goal_pose (geometry_msgs/PoseStamped), initialpose (geometry_msgs/PoseWithCovarianceStamped): clicks on the map.

    Subscribes:
        images (sensor_msgs/Image, CompressedImage): those that a page watches, while it does.
        map, odom, scan, plan, amcl_pose, /tf, /tf_static, /clock, /diagnostics; scene and scene_state while a page shows the scene in 3-D.

    Services used: those of ``simulation_interfaces``, where a simulation offers them; a real robot has none, and is shown and driven all the same.

    Parameters: the fields of ``gibson_sim.client_config.WebConfig``.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Starts the server. ``kwargs`` go to ``rclpy.node.Node``."""
        super().__init__("web", **kwargs)
        config = config_from_parameters(self, WebConfig)
        self._asked: SimpleQueue[Callable[[], None]] = SimpleQueue()
        """What the server's thread wants to be done here."""
        self._warned: set[str] = set()
        self._tree = TransformTree()
        self._robots: dict[str, _Robot] = {}
        self._known: dict[str, str] = {}
        self._watched: frozenset[str] = frozenset()
        self._clock_ns: int | None = None
        self._began: tuple[float, int] | None = None
        self._factor: float | None = None
        self._state = "connected"
        self._diagnoses: dict[str, tuple[dict[str, Any], float]] = {}
        self._told: dict[str, Any] = {}
        """What pages were told last of what seldom changes."""
        self._floor_z = 0.0
        self._map_version = 0
        self._simulation = SimulationClient(self)
        self._goal = self.create_publisher(PoseStamped, "goal_pose", 1)
        self._estimate = self.create_publisher(PoseWithCovarianceStamped, "initialpose", 1)
        self.subscribe(Clock, names.CLOCK, self._on_clock, _NEWEST, raw=True)
        self.subscribe(OccupancyGrid, names.MAP, self._on_map, _LATCHED)
        self.subscribe(TFMessage, names.TF, self._on_tf, _MANY)
        self.subscribe(TFMessage, names.TF_STATIC, self._on_tf, _LATCHED_MANY)
        self.subscribe(DiagnosticArray, names.DIAGNOSTICS, self._on_diagnostics, _MANY)
        self.subscribe(Path, "plan", self._on_path, _NEWEST)
        self.subscribe(PoseWithCovarianceStamped, "amcl_pose", self._on_estimate, _LATCHED)
        token = "" if config.host in LOOPBACK else config.token or secrets.token_urlsafe(16)
        self._server = PageServer(_Backend(self), config.host, config.port, token)
        self._videos = VideoSubscriptions(self, self._server.show)
        self._scene = SceneStream(self, self._server)
        note_in_job(PAGE, self._server.url)
        if not started_by_launcher():  # which prints it once all is ready
            print(f"look: {self._server.url}", file=sys.stderr, flush=True)

    def spin(self) -> int:
        """Works until the process is asked to end; returns the exit code."""
        executor = make_executor()
        executor.add_node(self)
        fast = slow = 0.0
        while is_running():
            executor.spin_once(timeout_sec=0.02)
            while not self._asked.empty():
                self.guarded("a request of a page", self._asked.get())
            now = time.monotonic()
            if now >= fast:
                fast = now + _FAST_S
                self.guarded("the pose of a robot", self._tell_poses)
            if now >= slow:
                slow = now + _SLOW_S
                self.guarded("the graph", self._look)
        return 0

    def close(self) -> None:
        """Ends the server; a robot that a page drives is stopped."""
        self._server.close()
        while not self._asked.empty():
            self._asked.get()()
        self._server.join()

    def guarded(self, what: str, function: Callable[[], None]) -> None:
        """Calls a function; a message that cannot be shown is left out, with one warning: any node may publish anything, and the page goes on."""
        try:
            function()
        except (GibsonSimError, ValueError, ArithmeticError, cv2.error) as error:
            if what not in self._warned:
                self._warned.add(what)
                self.get_logger().warning(f"{what} cannot be shown: {str(error).splitlines()[0]}")

    def subscribe(self, kind: Any, topic: str, callback: Callable[[Any], None], profile: Any, *, raw: bool = False) -> Any:
        """Subscribes; a message that cannot be shown is left out with one warning for each topic."""
        return self.create_subscription(
            kind, topic, lambda msg: self.guarded(f"a message on {topic}", lambda: callback(msg)), profile, raw=raw
        )

    def do_soon(self, function: Callable[[], None]) -> None:
        """Has a function called in the node's thread; may be called from any."""
        self._asked.put(function)

    # Requests of pages

    def watch(self, topics: frozenset[str]) -> None:
        """Subscribes to the videos that pages watch."""
        self._watched = topics
        self._videos.update(topics, self._known)
        self._scene.update(SCENE in topics)

    def drive(self, command: Drive) -> None:
        """Publishes a velocity command for the first robot."""
        robot = next(iter(self._robots.values()), None)
        if robot is not None:
            robot.drive(command)

    def ask(self, request: Request, answer: Callable[[bool, str], None]) -> None:
        """Does what a page asks for."""
        if isinstance(request, Goal):
            pose = flat_pose(request.x, request.y, 0.0, request.yaw)
            if request.kind == "goal":
                goal = PoseStamped(pose=pose)
                goal.header.frame_id, goal.header.stamp = WORLD_FRAME, self._stamp()
                self._goal.publish(goal)
                heard = self._goal.get_subscription_count()
            else:
                estimate = PoseWithCovarianceStamped()
                estimate.header.frame_id, estimate.header.stamp = WORLD_FRAME, self._stamp()
                estimate.pose.pose = pose
                estimate.pose.covariance[0] = estimate.pose.covariance[7] = 0.25
                estimate.pose.covariance[35] = math.radians(15.0) ** 2
                self._estimate.publish(estimate)
                heard = self._estimate.get_subscription_count()
            topic = "goal_pose" if request.kind == "goal" else "initialpose"
            answer(heard > 0, f"sent to {topic}" if heard else f"{topic} has no subscriber: no navigation stack runs")
        elif isinstance(request, Spawn) and request.uri not in {thing["uri"] for thing in self._told.get("catalogue", ())}:
            answer(False, f"{quoted(request.uri)} is not in the catalogue")
        else:
            self._simulation.ask(request, self._floor_z, partial(self._answered, answer))

    def _answered(self, answer: Callable[[bool, str], None], ok: bool, text: str) -> None:
        """Answers a page, and shows what has become of the simulation without waiting for the next look."""
        answer(ok, text)
        self._simulation.get("get_simulation_state", GetSimulationState.Request(), self._on_new_state)

    def _on_new_state(self, response: Any) -> None:
        self._on_state(response)
        self._tell_status()

    # Messages

    def _on_clock(self, data: bytes) -> None:
        self._clock_ns = stamp_ns(data)

    def _on_map(self, msg: OccupancyGrid) -> None:
        info = msg.info
        if not 0 < info.width * info.height <= 100_000_000 or len(msg.data) != info.width * info.height:
            return
        cells = np.asarray(msg.data, dtype=np.int8).reshape(info.height, info.width)
        pixels = np.full((*cells.shape, 4), (0, 0, 0, 0), dtype=np.uint8)
        pixels[cells >= 0] = (255, 255, 255, 255)
        pixels[cells >= 50] = (60, 50, 45, 255)
        self._map_version += 1
        self._server.serve_blob("map", bytes(cv2.imencode(".png", pixels[::-1])[1]))
        origin = info.origin.position
        self._floor_z = float(origin.z)
        values = {"data": "map", "version": self._map_version, "width": info.width, "height": info.height}
        self._server.tell("map", values | {"resolution": info.resolution, "x": origin.x, "y": origin.y}, keep=True)

    def _on_tf(self, msg: TFMessage) -> None:
        for t in msg.transforms:
            p, q = t.transform.translation, t.transform.rotation
            matrix = matrix_from_pose(Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))
            self._tree.set(t.header.frame_id.lstrip("/"), t.child_frame_id.lstrip("/"), matrix)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in msg.status:
            level = int.from_bytes(status.level, "little") if isinstance(status.level, bytes) else int(status.level)
            values = [[pair.key, pair.value] for pair in status.values]
            self._diagnoses[status.name] = (
                {"name": status.name, "level": level, "message": status.message, "values": values}, now,
            )  # fmt: skip

    def _on_path(self, msg: Path) -> None:
        points = [(p.pose.position.x, p.pose.position.y) for p in msg.poses]
        self._server.tell("path", _finite(_thinned(points)), keep=True)

    def _on_estimate(self, msg: PoseWithCovarianceStamped) -> None:
        p, c = msg.pose.pose.position, msg.pose.covariance
        covariance = np.array([[c[0], c[1]], [c[6], c[7]]])
        if not np.isfinite(covariance).all() or not math.isfinite(p.x + p.y):
            return
        values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
        minor, major = (2.0 * np.sqrt(np.maximum(values, 0.0))).tolist()  # 2 sigma
        angle = math.atan2(axes[1, 1], axes[0, 1])
        self._server.tell("estimate", {"x": p.x, "y": p.y, "major": major, "minor": minor, "angle": angle}, keep=True)

    # What pages are told

    def _tell_poses(self) -> None:
        found: list[dict[str, Any]] = []
        points: list[tuple[float, float]] = []
        for name, robot in self._robots.items():
            self.guarded(f"robot {name or 'robot'}", partial(self._add_robot, name, robot, found, points))
        self._server.tell("robots", found)
        self._server.tell("scan", _finite(points))

    def _add_robot(self, name: str, robot: _Robot, found: list[dict[str, Any]], points: list[tuple[float, float]]) -> None:
        """Adds what a page shows of a robot."""
        T_map_base = robot.pose(self._tree)
        if T_map_base is None:
            return
        values = {
            "x": float(T_map_base[0, 3]),
            "y": float(T_map_base[1, 3]),
            "yaw": math.atan2(T_map_base[1, 0], T_map_base[0, 0]),
            "radius": 0.25,
            "speed": robot.speed,
        }
        if all(map(math.isfinite, values.values())):
            found.append({"name": name or "robot", **values})
            points += robot.scan_points(self._tree, T_map_base)

    def _look(self) -> None:
        """Looks at the graph and asks the simulation how it is."""
        graph = self.get_topic_names_and_types()
        self._update_robots(graph)
        if not self.count_publishers(names.CLOCK):
            self._clock_ns = self._began = self._factor = None  # a simulation has ended; a robot has its own time
        known = dict(image_topics(graph))
        if known != self._known:
            self._known = known
            self._videos.update(self._watched, known)
            self._server.tell("topics", [{"topic": topic, "label": label_of(topic)} for topic in known], keep=True)
        if self._simulation.is_there():
            self._simulation.get("get_simulation_state", GetSimulationState.Request(), self._on_state)
            self._simulation.get("get_entities_states", GetEntitiesStates.Request(), self._on_entities)
            self._simulation.get("get_named_poses", GetNamedPoses.Request(), self._on_places)
            self._simulation.get("get_spawnables", GetSpawnables.Request(), self._on_catalogue)
        else:
            self._state = "connected"
        self._tell_status()

    def _tell_status(self) -> None:
        now = time.monotonic()
        if self._clock_ns is not None:
            if self._began is not None and now > self._began[0]:
                passed = (self._clock_ns - self._began[1]) / NS_PER_S
                self._factor = max(0.0, passed / (now - self._began[0]))
            self._began = (now, self._clock_ns)
        diagnoses = [values for values, at in self._diagnoses.values() if now - at < _GAP_S]
        time_s = None if self._clock_ns is None else self._clock_ns / NS_PER_S
        self._server.tell(
            "status", {"state": self._state, "time": time_s, "factor": self._factor, "diagnostics": diagnoses}, keep=True
        )

    def _update_robots(self, graph: list[tuple[str, list[str]]]) -> None:
        found = {
            name.removesuffix(names.ODOM).strip("/")
            for name, types in graph
            if _ODOMETRY in types and name.endswith("/" + names.ODOM)
        }
        found = {
            name
            for name in found
            if not name.endswith("ground_truth") and self.count_publishers(f"/{name}/{names.ODOM}" if name else f"/{names.ODOM}")
        }
        for name in set(self._robots) - found:
            self._robots.pop(name).close()
        for name in sorted(found - set(self._robots)):
            self._robots[name] = _Robot(self, name)
        for robot in self._robots.values():
            robot.choose_type()

    def _on_state(self, response: Any) -> None:
        self._state = STATES.get(response.state.state, "unknown")

    def _on_entities(self, response: Any) -> None:
        found = []
        for name, state in zip(response.entities, response.states, strict=False):
            p = state.pose.position
            if math.isfinite(p.x + p.y):
                found.append(
                    {"name": name, "x": p.x, "y": p.y, "robot": name in self._robots or name.rpartition("/")[2] == "robot"}
                )
        self._tell_changed("entities", found)

    def _on_places(self, response: Any) -> None:
        places = [{"name": p.name, "x": p.pose.position.x, "y": p.pose.position.y} for p in response.poses]
        self._tell_changed("places", places)

    def _on_catalogue(self, response: Any) -> None:
        things = [{"uri": s.uri, "name": s.uri.rpartition("/")[2]} for s in response.spawnables]
        self._tell_changed("catalogue", sorted(things, key=lambda thing: thing["name"]))

    def _tell_changed(self, kind: str, values: Any) -> None:
        if self._told.get(kind) != values:
            self._told[kind] = values
            self._server.tell(kind, values, keep=True)

    def _stamp(self) -> Any:
        ns = self._clock_ns
        if ns is None:
            return self.get_clock().now().to_msg()
        stamp = Clock().clock
        stamp.sec, stamp.nanosec = divmod(ns, NS_PER_S)
        return stamp


class _Backend:
    """Hands what pages ask for to the node's thread."""

    def __init__(self, node: WebNode) -> None:
        self._node = node

    def watch(self, topics: frozenset[str]) -> None:
        self._node.do_soon(partial(self._node.watch, topics))

    def drive(self, command: Drive) -> None:
        self._node.do_soon(partial(self._node.drive, command))

    def ask(self, request: Request, answer: Callable[[bool, str], None]) -> None:
        self._node.do_soon(partial(self._node.ask, request, answer))


class _Robot:
    """One robot of the graph: its namespace, what it says of where it is, and its commands."""

    def __init__(self, node: WebNode, name: str) -> None:
        self._node, self._prefix = node, f"/{name}/" if name else "/"
        self._odometry: Odometry | None = None
        self._truth: Odometry | None = None
        self._scan: LaserScan | None = None
        self._stamped = False
        self._publisher: Any = None
        self._subscriptions = [
            node.subscribe(Odometry, self._prefix + names.ODOM, partial(setattr, self, "_odometry"), _NEWEST),
            node.subscribe(Odometry, self._prefix + names.GROUND_TRUTH, partial(setattr, self, "_truth"), _NEWEST),
            node.subscribe(LaserScan, self._prefix + names.SCAN, partial(setattr, self, "_scan"), _NEWEST),
        ]

    def close(self) -> None:
        """Ends its subscriptions."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        if self._publisher is not None:
            self._node.destroy_publisher(self._publisher)

    def choose_type(self) -> None:
        """Sends TwistStamped where all subscribers of the topic of commands want it."""
        wanted = {info.topic_type for info in self._node.get_subscriptions_info_by_topic(self._prefix + names.CMD_VEL)}
        stamped = wanted == {"geometry_msgs/msg/TwistStamped"}
        if stamped != self._stamped and self._publisher is not None:
            self._node.destroy_publisher(self._publisher)
            self._publisher = None
        self._stamped = stamped

    def drive(self, command: Drive) -> None:
        """Publishes a velocity command."""
        if self._publisher is None:
            self._publisher = self._node.create_publisher(
                TwistStamped if self._stamped else Twist, self._prefix + names.CMD_VEL, 10
            )
        msg = TwistStamped() if self._stamped else Twist()
        twist = msg.twist if self._stamped else msg
        twist.linear.x, twist.linear.y, twist.angular.z = command.linear, command.lateral, command.angular
        if self._stamped:
            msg.header.stamp = self._node._stamp()
        self._publisher.publish(msg)

    def pose(self, tree: TransformTree) -> Mat4 | None:
        """Returns T_map_base: by tf where that knows the map, else the simulation's truth, else its odometry."""
        if self._odometry is None:
            return None
        base = self._odometry.child_frame_id
        T_map_base = tree.between(WORLD_FRAME, base)
        if T_map_base is not None:
            return T_map_base
        return _matrix((self._truth or self._odometry).pose.pose)

    @property
    def speed(self) -> float:
        """Speed by its odometry, m/s."""
        return (
            0.0
            if self._odometry is None
            else math.hypot(self._odometry.twist.twist.linear.x, self._odometry.twist.twist.linear.y)
        )

    def scan_points(self, tree: TransformTree, T_map_base: Mat4) -> list[tuple[float, float]]:
        """Returns where the rays of the newest scan end, on the map."""
        scan, odometry = self._scan, self._odometry
        if scan is None or odometry is None or not len(scan.ranges):
            return []
        T_base_scan = tree.between(odometry.child_frame_id, scan.header.frame_id)
        if T_base_scan is None:
            return []
        ranges = np.asarray(scan.ranges, dtype=np.float64)
        step = max(1, len(ranges) // _MOST_POINTS)
        angles = (scan.angle_min + scan.angle_increment * np.arange(len(ranges)))[::step]
        ranges = ranges[::step]
        good = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
        ranges, angles = ranges[good], angles[good]
        points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles), np.zeros_like(ranges), np.ones_like(ranges)])
        placed = (T_map_base @ T_base_scan @ points)[:2].T
        return [(round(x, 3), round(y, 3)) for x, y in placed.tolist()]


def _matrix(pose: Any) -> Mat4:
    p, q = pose.position, pose.orientation
    return matrix_from_pose(Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))


def _thinned(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    return points[:: max(1, len(points) // _MOST_POINTS)]


def _finite(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Returns the points that JSON can hold."""
    return [(x, y) for x, y in points if math.isfinite(x) and math.isfinite(y)]


def main(args: list[str] | None = None) -> None:
    """Runs the web node."""
    run_node(WebNode, args)


if __name__ == "__main__":
    main()
