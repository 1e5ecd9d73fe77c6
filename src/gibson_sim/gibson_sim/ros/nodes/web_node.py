"""The web node: serves the live page, which shows and drives the robots of a ROS domain through standard topics and services only."""

from __future__ import annotations

import secrets
import sys
import time
from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import cv2
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from simulation_interfaces.srv import GetEntitiesStates, GetNamedPoses, GetSimulationState, GetSpawnables
from tf2_msgs.msg import TFMessage

from gibson_sim.bags.stamps import stamp_ns
from gibson_sim.client_config import WebConfig
from gibson_sim.errors import GibsonSimError
from gibson_sim.processes.job_folder import PAGE, note_in_job
from gibson_sim.quoting import quoted
from gibson_sim.resources import FOLDER_TIME
from gibson_sim.ros.client.simulation_client import STATES, SimulationClient
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node, started_by_launcher
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.topics import names
from gibson_sim.ros.web.child_nodes import Recorder
from gibson_sim.ros.web.doors import Doors
from gibson_sim.ros.web.entities import Entities
from gibson_sim.ros.web.floor_maps import FloorMaps
from gibson_sim.ros.web.plot_subscriptions import PlotSubscriptions, plottable
from gibson_sim.ros.web.real_time_factor import RealTimeFactor
from gibson_sim.ros.web.robots import Robot, robots_in
from gibson_sim.ros.web.scene_stream import SceneStream
from gibson_sim.ros.web.simulation_requests import SimulationRequests
from gibson_sim.ros.web.task_view import TaskView
from gibson_sim.ros.web.transform_tree import TransformTree
from gibson_sim.ros.web.video_subscriptions import VideoSubscriptions, image_topics, label_of
from gibson_sim.types import NS_PER_S
from gibson_sim.web.curves import CurveName
from gibson_sim.web.pages import Answer
from gibson_sim.web.recordings import Recordings
from gibson_sim.web.requests import Drive, Fields, Goal, MoveJoint, Open, Plot, Record, Request, RunTask, Spawn
from gibson_sim.web.server import LOOPBACK, PageServer
from gibson_sim.web.videos import SCENE

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_MANY = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_LATCHED_MANY = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_FAST_PERIOD_S, _SLOW_PERIOD_S = 0.1, 1.0
"""Periods at which poses are sent, and the graph, the entities and the state are queried, s of wall time."""
_STALE_S = 2.0
"""Age after which a diagnostic status is dropped, s of wall time."""


class WebNode(Node):
    """Serves the live page.

    Publishes:
        <robot>/cmd_vel (geometry_msgs/Twist, or TwistStamped if all its subscribers use that): while a page drives.
        <robot>/goal_pose (geometry_msgs/PoseStamped), <robot>/initialpose (geometry_msgs/PoseWithCovarianceStamped): clicks on the map.
        <robot>/joint_command (sensor_msgs/JointState): joints that a page moves.
        object_joint_command (sensor_msgs/JointState): doors and drawers that a page opens.

    Subscribes:
        image topics (sensor_msgs/Image, CompressedImage), while a page shows them; any topic, while a page plots it.
        map, floor_N/map, /tf, /tf_static, /clock, /diagnostics, object_joint_states; for each robot odom, ground_truth/odom, scan, plan, amcl_pose,
        robot_description, joint_states, and tf_static if it has a namespace;
        scene and scene_state while a page shows the scene in 3-D; the topics of ``TaskView``.

    On request of a page, it starts a record node and a task node, which end with it.

    Services used: those of ``simulation_interfaces``, if a simulation offers them; real robots, which do not, are shown and driven as well.

    Parameters: the fields of ``gibson_sim.client_config.WebConfig``.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Starts the server. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            GibsonSimError: a setting is invalid, or the server cannot listen on its address.
        """
        super().__init__("web", **kwargs)
        config = config_from_parameters(self, WebConfig)
        self._calls: SimpleQueue[Callable[[], None]] = SimpleQueue()
        """Calls that the server's thread has scheduled in the node's thread."""
        self._warned: set[str] = set()
        self._tree = TransformTree()
        self._robots: dict[str, Robot] = {}
        """Namespace -> robot, sorted: a robot without a namespace is the first."""
        self._image_topics: dict[str, str] = {}
        """Image topic -> type."""
        self._watched: frozenset[str] = frozenset()
        self._clock_ns: int | None = None
        self._factor = RealTimeFactor()
        self._state = "connected"
        self._diagnostics: dict[str, tuple[dict[str, Any], float]] = {}
        self._sent: dict[str, Any] = {}
        """Kind of rarely changing values -> values that pages received last."""
        self._client = SimulationClient(self)
        self._simulation = SimulationRequests(self._client)
        self._recorder, self._recordings = Recorder(), Path(config.folder)
        self.subscribe(Clock, names.CLOCK, self._on_clock, _NEWEST, raw=True)
        self.subscribe(TFMessage, names.TF, self._tree.add, _MANY)
        self.subscribe(TFMessage, names.TF_STATIC, self._tree.add, _LATCHED_MANY)
        self.subscribe(DiagnosticArray, names.DIAGNOSTICS, self._on_diagnostics, _MANY)
        token = "" if config.host in LOOPBACK else config.token or secrets.token_urlsafe(16)
        recordings = Recordings(self._recordings)
        self._server = PageServer(_Backend(self), config.host, config.port, token, recordings=recordings)
        self._videos = VideoSubscriptions(self, self._server.send_image, partial(self._send_if_changed, "problems"))
        self._plots = PlotSubscriptions(self)
        self._doors = Doors(self)
        self._floors = FloorMaps(self, self._server)
        self._entities = Entities(self._client, self._floors.floor_at)
        self._task = TaskView(self, self._client)
        self._scene = SceneStream(self, self._server)
        note_in_job(PAGE, self._server.url)
        if not started_by_launcher():  # the launcher prints it once all nodes are ready
            print(f"look: {self._server.url}", file=sys.stderr, flush=True)

    def spin(self) -> int:
        """Serves until the end of the process is requested; returns the exit code."""
        executor = make_executor()
        executor.add_node(self)
        next_fast = next_slow = 0.0
        while is_running():
            executor.spin_once(timeout_sec=0.02)
            while not self._calls.empty():
                self.guarded("a request of a page", self._calls.get())
            now = time.monotonic()
            if now >= next_fast:
                next_fast = now + _FAST_PERIOD_S
                self.guarded("the robots", self._send_moving)
                self._client.check_pending()
            if now >= next_slow:
                next_slow = now + _SLOW_PERIOD_S
                self.guarded("the graph", self._poll)
        return 0

    def close(self) -> None:
        """Ends the server; stops robots that pages drive, and ends the recording and the task that pages have started."""
        self._server.close()
        while not self._calls.empty():
            self._calls.get()()
        self._task.close()
        self._recorder.close()
        self._server.join()

    def guarded(self, subject: str, function: Callable[[], None]) -> None:
        """Calls a function; if it fails on data that cannot be shown, logs one warning per ``subject``: nodes may publish invalid data."""
        try:
            function()
        except (GibsonSimError, ValueError, ArithmeticError, RecursionError, cv2.error, yaml.YAMLError) as error:
            if subject not in self._warned:
                self._warned.add(subject)
                self.get_logger().warning(f"{subject} cannot be shown: {str(error).splitlines()[0]}")

    def subscribe(self, kind: Any, topic: str, callback: Callable[[Any], None], profile: Any, *, raw: bool = False) -> Any:
        """Subscribes to a topic; skips messages that cannot be shown, with one warning per topic."""
        return self.create_subscription(
            kind, topic, lambda msg: self.guarded(f"a message on {topic}", lambda: callback(msg)), profile, raw=raw
        )

    def call_soon(self, function: Callable[[], None]) -> None:
        """Schedules a call in the node's thread; thread-safe."""
        self._calls.put(function)

    # Requests of pages

    def watch(self, topics: frozenset[str]) -> None:
        """Subscribes to the image topics and the scene that pages show."""
        self._watched = topics
        self._videos.update(topics, self._image_topics)
        self._scene.update(SCENE in topics)

    def drive(self, command: Drive) -> None:
        """Publishes a velocity command."""
        robot = self._robot(command.robot)
        if robot is not None:
            robot.drive(command)

    def plot(self, curves: frozenset[CurveName]) -> None:
        """Subscribes to the topics of the curves that pages plot."""
        self._plots.update(curves)

    def handle_request(self, request: Request, answer: Answer) -> None:
        """Executes a request of a page; ``answer`` is called once it is done."""
        if isinstance(request, Goal):
            answer(*self._send_goal(request))
        elif isinstance(request, Spawn) and request.uri not in {entry["uri"] for entry in self._sent.get("catalogue", ())}:
            answer(False, f"{quoted(request.uri)} is not in the catalogue")
        elif isinstance(request, Plot):
            answer(True, "", (time.monotonic(), self._plots.curves.history(request.curves)))
        elif isinstance(request, Fields):
            self._plots.list_fields(request.topic, answer)
        elif isinstance(request, Open):
            self._doors.open(request, answer)
        elif isinstance(request, MoveJoint):
            robot = self._robot(request.robot)
            answer(
                *(robot.joints.move(request.joint, request.position) if robot is not None else (False, "the domain has no robot"))
            )
        elif isinstance(request, Record):
            self._record(request, answer)
        elif isinstance(request, RunTask):
            self._task.ask(request, answer)
            self._send_if_changed("task", self._task_values())
        else:
            self._simulation.ask(request, partial(self._answered, answer))

    def _send_goal(self, goal: Goal) -> tuple[bool, str]:
        """Publishes a goal or an initial pose; returns whether the page may call it sent, and a text for the page."""
        robot = self._robot(goal.robot)
        if robot is None:
            return False, "the domain has no robot"
        is_sent, text = robot.send(goal)
        pose, floor = robot.page_values(self._tree), self._floors.floor_at(goal.z)
        if is_sent and pose is not None and (its := self._floors.floor_at(pose[0]["z"])) != floor:
            text += f", on floor {floor}; the robot is on floor {its}: navigation in the plane takes only x and y"
        return is_sent, text

    def _robot(self, name: str) -> Robot | None:
        """Returns the robot with a namespace, or the first robot if ``name`` is empty."""
        return self._robots.get(name) if name else next(iter(self._robots.values()), None)

    def _record(self, request: Record, answer: Answer) -> None:
        if request.action == "stop":
            answer(self._recorder.running, "" if self._recorder.running else "no recording runs")
            self._recorder.stop()
        elif self._recorder.running:
            answer(False, "a recording runs already")
        else:
            try:
                folder = self._recordings / datetime.now().strftime(FOLDER_TIME)
                self._recorder.start(images=request.images, folder=folder)
            except (GibsonSimError, OSError) as error:
                answer(False, f"nothing is recorded: {error}")
            else:
                answer(True, f"recording into {folder}")
        self._send_if_changed("recording", self._recorder.page_values())

    def _answered(self, answer: Answer, ok: bool, text: str) -> None:
        """Answers a page, and updates the state of the simulation without waiting for the next poll."""
        answer(ok, text)
        self._simulation.get("get_simulation_state", GetSimulationState.Request(), self._on_new_state)

    def _on_new_state(self, response: Any) -> None:
        self._on_state(response)
        self._send_status()

    # Messages

    def _on_clock(self, data: bytes) -> None:
        self._clock_ns = stamp_ns(data)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in msg.status:
            level = int.from_bytes(status.level, "little") if isinstance(status.level, bytes) else int(status.level)
            values = [[pair.key, pair.value] for pair in status.values]
            self._diagnostics[status.name] = (
                {"name": status.name, "level": level, "message": status.message, "values": values}, now,
            )  # fmt: skip

    # Data for pages

    def _send_moving(self) -> None:
        """Sends poses, scans, paths, estimates, doors and curves to pages."""
        robots: list[dict[str, Any]] = []
        scans: list[dict[str, Any]] = []
        for name, robot in list(self._robots.items()):
            if not robot.is_present:
                self._robots.pop(name).close()  # immediately: another world may have been loaded
                continue
            self.guarded(f"robot {name or 'robot'}", partial(self._add_robot, robot, robots, scans))
        self._server.broadcast("robots", robots, keep=True)
        self._server.broadcast("scan", scans, keep=True)
        floors = {values["namespace"]: values["floor"] for values in robots}
        known = [(floors.get(name, 0), robot) for name, robot in self._robots.items()]  # planners and localisers know no height
        self._send_if_changed("paths", [{"floor": floor, "points": robot.path} for floor, robot in known if robot.path])
        self._send_if_changed(
            "estimates", [{"floor": floor, **robot.estimate} for floor, robot in known if robot.estimate is not None]
        )
        self._send_if_changed("doors", self._doors.page_values(self._entities.places))
        joints = {name: rows for name, robot in self._robots.items() if (rows := robot.joints.page_values())}
        self._send_if_changed("joints", joints)
        self._plots.end_listings()
        if self._plots.curves.names:
            now = time.monotonic()
            self._server.send_samples(now, self._plots.curves.pop_new(now))

    def _add_robot(self, robot: Robot, robots: list[dict[str, Any]], scans: list[dict[str, Any]]) -> None:
        """Appends the values of a robot for pages, and the points of its scan."""
        values = robot.page_values(self._tree)
        if values is not None:
            floor = self._floors.floor_at(values[0]["z"])
            robots.append({**values[0], "floor": floor})
            scans.append({"floor": floor, "points": values[1]})

    def _task_values(self) -> dict[str, Any]:
        """Returns the values of the task for pages, with the floor of its goal."""
        values = self._task.page_values()
        goal = values["goal"]
        return values if goal is None else {**values, "goal": {**goal, "floor": self._floors.floor_at(goal["z"])}}

    def _poll(self) -> None:
        """Queries the graph, and requests the state of the simulation."""
        graph = self.get_topic_names_and_types()
        self._update_robots(graph)
        self._floors.update(graph)
        if not self.count_publishers(names.CLOCK):
            self._clock_ns = None  # the simulation has ended, or there is none
            self._factor.clear()
        topics = dict(image_topics(graph))
        if topics != self._image_topics:
            self._image_topics = topics
            self._videos.update(self._watched, topics)
            self._server.broadcast("topics", [{"topic": topic, "label": label_of(topic)} for topic in topics], keep=True)
        self._plots.types = plottable(graph)
        self._plots.update_subscriptions()
        self._send_if_changed("plottable", list(self._plots.types))
        self._send_if_changed("recording", self._recorder.page_values())
        self._send_if_changed("task", self._task_values())
        if self._client.is_offered("get_simulation_state"):
            self._simulation.get_rate(lambda rate: self._send_if_changed("rate", rate))
            for service, request, on_response in (
                ("get_simulation_state", GetSimulationState.Request(), self._on_state),
                ("get_entities_states", GetEntitiesStates.Request(), self._on_entities),
                ("get_named_poses", GetNamedPoses.Request(), self._on_places),
                ("get_spawnables", GetSpawnables.Request(), self._on_catalogue),
            ):
                self._simulation.get(service, request, partial(self._on_response, service, on_response))
        else:
            self._state = "connected"
            self._entities.clear()
            for kind in ("entities", "places", "rooms", "catalogue"):
                self._send_if_changed(kind, [])
        now = self.stamp()
        self._server.drop_stale_images(now.sec + now.nanosec / NS_PER_S)
        self._send_status()

    def _send_status(self) -> None:
        now = time.monotonic()
        diagnostics = [values for values, at in self._diagnostics.values() if now - at < _STALE_S]
        time_s = None if self._clock_ns is None else self._clock_ns / NS_PER_S
        factor = None if time_s is None else self._factor.add(now, time_s)
        self._server.broadcast(
            "status", {"state": self._state, "time": time_s, "factor": factor, "diagnostics": diagnostics}, keep=True
        )

    def _update_robots(self, graph: list[tuple[str, list[str]]]) -> None:
        for name in sorted(robots_in(graph) - set(self._robots)):
            robot = Robot(self, name)
            if robot.is_present:
                self._robots[name] = robot
                robot.advertise()
            else:
                robot.close()
        self._robots = dict(sorted(self._robots.items()))
        for robot in self._robots.values():
            robot.choose_type()

    def _on_response(self, service: str, on_response: Callable[[Any], None], response: Any) -> None:
        """Handles the response of a service, which may be that of any simulator."""
        self.guarded(f"the response of {service}", partial(on_response, response))

    def _on_state(self, response: Any) -> None:
        self._state = STATES.get(response.state.state, "unknown")

    def _on_entities(self, response: Any) -> None:
        self._send_if_changed("entities", self._entities.values(response, self._robots))

    def _on_places(self, response: Any) -> None:
        places = [
            {"name": place.name, "x": p.x, "y": p.y, "floor": self._floors.floor_at(p.z)}
            for place, p in ((place, place.pose.position) for place in response.poses)
        ]
        self._send_if_changed("places", places)
        self._send_if_changed("rooms", self._entities.rooms(response))

    def _on_catalogue(self, response: Any) -> None:
        entries = [
            {"uri": s.uri, "name": s.uri.rpartition("/")[2], "robot": s.description == "robot"} for s in response.spawnables
        ]
        self._send_if_changed("catalogue", sorted(entries, key=lambda entry: entry["name"]))

    def _send_if_changed(self, kind: str, values: Any) -> None:
        if self._sent.get(kind) != values:
            self._sent[kind] = values
            self._server.broadcast(kind, values, keep=True)

    def stamp(self) -> Any:
        """Returns the present time: simulation time if there is a /clock."""
        ns = self._clock_ns
        if ns is None:
            return self.get_clock().now().to_msg()
        stamp = Clock().clock
        stamp.sec, stamp.nanosec = divmod(ns, NS_PER_S)
        return stamp


class _Backend:
    """Forwards requests of pages to the node's thread."""

    def __init__(self, node: WebNode) -> None:
        self._node = node

    def watch(self, topics: frozenset[str]) -> None:
        self._node.call_soon(partial(self._node.watch, topics))

    def plot(self, curves: frozenset[CurveName]) -> None:
        self._node.call_soon(partial(self._node.plot, curves))

    def drive(self, command: Drive) -> None:
        self._node.call_soon(partial(self._node.drive, command))

    def handle_request(self, request: Request, answer: Answer) -> None:
        self._node.call_soon(partial(self._node.handle_request, request, answer))


def main(args: list[str] | None = None) -> None:
    """Runs the web node."""
    run_node(WebNode, args)


if __name__ == "__main__":
    main()
