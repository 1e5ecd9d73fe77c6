"""The trial node: sets up a run of a trial, sends the goal to the stack under test, and ends the run at a reproducible tick.

It uses only public interfaces: it spawns and moves entities with simulation_interfaces, and communicates with the stack by its topics,
services and actions. The rules by which a run ends are in ``gibson_sim.trials.execution.monitor``. In lockstep the goal is sent before the
first tick if the stack gets ready while time stands still, and the run ends at a tick that this node does not report as done, so that no step
follows.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from simulation_interfaces.msg import SimulationState
from std_msgs.msg import String

from gibson_msgs.msg import Input, Scene
from gibson_sim.client_config import TrialConfig
from gibson_sim.errors import ConfigError, EnvironmentProblemError, GibsonSimError
from gibson_sim.processes.descendants import any_runs, marked, siblings
from gibson_sim.processes.job_folder import note_in_job
from gibson_sim.quoting import quoted
from gibson_sim.reading import read_file
from gibson_sim.ros import conversions
from gibson_sim.ros.client.simulation_client import SimulationClient, move_request, spawn_request, state_request
from gibson_sim.ros.lockstep.lockstep_client import LockstepParticipant
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node, write_summary
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.recording.raw_subscriptions import recording_profile
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.discovery import is_fully_matched
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class, service_class
from gibson_sim.standard.openings import joint_openings
from gibson_sim.standard.requests import CHANGING_REQUESTS
from gibson_sim.trials.execution.monitor import Decision, RunMonitor
from gibson_sim.trials.execution.node_settings import POSE_TYPE
from gibson_sim.trials.execution.trial_node import CLOCK, IMAGES, MARKER, PROGRESS, TrialInput, TrialReport
from gibson_sim.trials.execution.walking import PERIOD_TICKS, person_pose, person_urdf
from gibson_sim.trials.foreign_calls import JournalEntry
from gibson_sim.trials.json_values import json_values, restored
from gibson_sim.trials.records import PAUSE, REFUSED_GOAL, PlanarPose
from gibson_sim.types import NS_PER_S, WORLD_FRAME, Pose

SIMULATOR_NODES = frozenset({"physics", "render", "record", "_record_intake", "trial"})
"""Names of the nodes of a trial that do not belong to the stack."""
STANDSTILL_S = 3.0
"""Timeout for the readiness of the stack while time stands still, from when the goal can be sent, s of wall time; then time starts to pass,
since the sensors of the stack may need it."""
SETTLED_S = 0.3
"""Time without new topics after which a stack counts as discovered, s of wall time."""
IDLE_CHECKS = 5
"""Number of consecutive checks, ``_POLL_S`` apart and without a tick between them, at which no process of the stack ran, after which a stack
that has reported its end counts as idle."""
_ANSWER_S = 20.0
"""Minimum timeout for a response of the simulation, s of wall time."""
_MATCHED_S = 0.5
"""Time in which the stack discovers the publishers of images, s of wall time."""
_ACKNOWLEDGED_S = 1.0
"""Timeout for the acknowledgement of a message, s of wall time."""
_POLL_S = 0.1
"""Period of the checks of the ROS graph and of processes, s of wall time."""
_PROGRESS_S = 0.5
"""Period of progress reports, s of wall time."""
_UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""Name of a node of which only endpoints have been discovered yet."""
_MAX_TIME_CALLS, _MAX_CALL_BYTES = 20, 1000
"""Largest number of reported requests that changed how time passes, and largest size of each, bytes."""
_MAX_CALLERS = 10
"""Largest number of nodes that are noted as callers of one service."""
CALL_TOPICS = {
    name: tuple((f"rq/{path}Request", False) for path in paths)
    for name, paths in {
        **{name: (name,) for name in (*CHANGING_REQUESTS, "step_simulation")},
        "simulate_steps": ("simulate_steps/_action/send_goal",),
        "set_parameters": ("physics/set_parameters", "physics/set_parameters_atomically"),
    }.items()
} | {names.OBJECT_JOINT_COMMAND: ((f"/{names.OBJECT_JOINT_COMMAND}", True),), PAUSE: (("rq/record/pauseRequest", False),)}
"""Each of ``CONTROLS``, and the service that pauses the recorder -> topics on which its requests arrive, each with whether ROS mangles its
name in DDS."""
_ACTIVE = 3
"""Value of lifecycle_msgs/State.PRIMARY_STATE_ACTIVE."""
_SUCCEEDED = 4
"""Value of action_msgs/GoalStatus.STATUS_SUCCEEDED."""


class TrialNode(Node):
    """Executes one run of a trial.

    Parameters: the fields of ``gibson_sim.client_config.TrialConfig``.

    Subscribes:
        ground_truth/odom (nav_msgs/Odometry): the ticks, and the pose of the robot. scene (gibson_msgs/Scene, latched): cameras.
        time_control (gibson_msgs/Input): what other nodes change about time.
        The topics by which the stack reports its readiness and its status (std_msgs/String).

    Publishes:
        The initial pose (geometry_msgs/PoseWithCovarianceStamped) and the goal (geometry_msgs/PoseStamped), both latched, once each.
        object_joint_command (sensor_msgs/JointState): closes doors.

    Calls:
        spawn_entity, set_entity_state, set_simulation_state; the service or action of the stack for the goal, and ``get_state`` of its node.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Reads the given. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            ConfigError: the goal does not fit the type of the service or action.
            EnvironmentProblemError: a message type of the stack is not installed.
        """
        super().__init__("trial", **kwargs)
        self._config = config_from_parameters(self, TrialConfig)
        self._input = given = restored(TrialInput, json.loads(read_file(Path(self._config.input))))
        self._monitor = RunMonitor(given)
        self._report = TrialReport()
        self._decision: Decision | None = None
        self._start_s = self._last_tick_s = time.monotonic()
        self._is_playing = self._ready = False
        self._ticks = 0
        self._idle_checks, self._checked_s = 0, 0.0
        """Number of consecutive checks at which no process of the stack ran, and monotonic time of the last check, s."""
        self._busy: set[int] = set()
        """IDs of the other processes of the run that ran at each of these checks: they may not have received the last answer of the stack."""
        self._reported_s = 0.0
        """Monotonic time of the last progress report, s."""
        self._watched_s = 0.0
        """Monotonic time at which the clients of the services of the simulation were last looked up, s."""
        self._graph: tuple[set[str], float] = (set(), self._start_s)
        """All discovered names, and monotonic time since which they have not changed, s."""
        self._scene: Any = None
        self._doors: dict[str, float] | None = None
        """Joint of a door to close -> its closed position, rad or m; None = not known yet."""
        self._ready_topic = _ReadyTopic(self, given.ready.topic) if given.ready.topic else None
        self._executor = make_executor()
        self._executor.add_node(self)
        self._make_interfaces()
        self._goal = _goal_of(self, given, self._monitor)
        self._initial_pub = self._publisher(PoseWithCovarianceStamped, given.initial_pose.topic)
        self._initial_sent = False
        self._lockstep = LockstepParticipant(self) if given.lockstep else None

    def _make_interfaces(self) -> None:
        given = self._input
        self.create_subscription(Odometry, names.GROUND_TRUTH, self._on_truth, qos.STATE)
        self.create_subscription(Scene, names.SCENE, self._on_scene, qos.LATCHED)
        self.create_subscription(Input, names.TIME_CONTROL, self._on_time_control, qos.INPUTS)
        if given.status.topic:
            self.create_subscription(String, given.status.topic, lambda msg: self._monitor.receive_status(msg.data), qos.COMMAND)
        if given.run.closed_doors:
            self._door_pub = self.create_publisher(JointState, names.OBJECT_JOINT_COMMAND, qos.LATCHED)
            kind = _class_of(message_class, "control_msgs/msg/DynamicJointState")
            self.create_subscription(kind, names.OBJECT_JOINT_STATES, self._on_joints, qos.LATCHED)
        self._simulation = SimulationClient(
            self, lambda condition, awaited: self._wait(condition, str(awaited)), names_service=True
        )
        for service in ("spawn_entity", "set_entity_state", "set_simulation_state"):
            self._simulation.prepare(service)
        node = given.ready.node
        self._lifecycle = (
            self.create_client(_class_of(service_class, "lifecycle_msgs/srv/GetState"), f"{node}/get_state") if node else None
        )
        self._lifecycle_future: Any = None
        self._was_active = False

    def _publisher(self, kind: Any, topic: str) -> Publisher | None:
        return self.create_publisher(kind, topic, qos.LATCHED) if topic else None

    def spin(self) -> int:
        """Executes the run; returns 0.

        Raises:
            GibsonSimError: the simulation refuses a request that the run needs.
        """
        self._set_up()
        self._wait_until_ready()
        while is_running() and self._decision is None:
            self._executor.spin_once(timeout_sec=0.1)
            self._report_progress()
            if self._lockstep is not None and self._decision is None:
                silence_s = time.monotonic() - self._last_tick_s
                if silence_s > self._input.limits.silence or (self._monitor.end_was_reported and self._is_idle(silence_s)):
                    self._decision = self._monitor.silence(silence_s)
        return 0

    def _is_idle(self, silence_s: float) -> bool:
        """Returns whether time waits for a stack that is idle; ending the run while the stack is only slow would not be reproducible."""
        now_s = time.monotonic()
        if silence_s < _POLL_S:
            self._idle_checks = 0
        elif now_s - self._checked_s >= _POLL_S:
            self._checked_s = now_s
            if self._idle_checks == 0:
                self._busy = set(siblings())
            self._busy = {process_id for process_id in self._busy if any_runs([process_id])}
            self._idle_checks = 0 if any_runs(marked(self._input.marker, MARKER)) else self._idle_checks + 1
        return self._idle_checks >= IDLE_CHECKS and not self._busy

    # Before the first tick

    def _set_up(self) -> None:
        """Spawns objects and people, and closes doors, while time stands still."""
        run = self._input.run
        for thing in run.things:
            self._spawn_at(thing.name, thing.object, "", thing.pose, thing.z)
        for person in run.people:
            self._spawn_at(person.name, "", person_urdf(person), person_pose(person, 0.0), 0.0)
        if run.closed_doors:
            self._wait(lambda: self._doors is not None, "message on object_joint_states")
            assert self._doors is not None
            self._wait(
                lambda: _has_subscriber(self, self._door_pub.topic_name, among={"physics"}), "simulation that closes doors"
            )
            self._door_pub.publish(JointState(name=list(self._doors), position=list(self._doors.values())))
            _wait_for_acknowledgement(self._door_pub)

    def _spawn_at(self, name: str, uri: str, text: str, pose: PlanarPose, z: float) -> None:
        self._simulation.ask("spawn_entity", spawn_request(conversions.pose_to_msg(_pose(pose, z)), name, uri, text))

    def _on_joints(self, msg: Any) -> None:
        bodies = self._input.run.closed_doors
        openings = joint_openings(conversions.joint_values(msg))
        self._doors = {name: joint.closed for name, joint in openings.items() if name.partition("/")[0] in bodies}

    def _wait_until_ready(self) -> None:
        """Waits until the stack is ready, and sends its initial pose and its goal; time stands still meanwhile if possible."""
        limit_s = self._input.ready.within
        available_s = math.inf
        while is_running() and self._decision is None:
            missing = self._missing()
            if not missing:
                self._on_ready()
                return
            now_s = time.monotonic()
            if now_s - self._start_s > limit_s:
                text = f"after {limit_s:g} s of wall time there is {' and '.join(missing)}"
                self._decision = Decision("never ready", text, self._monitor.now_ns)
                return
            available_s = min(available_s, now_s) if self._goal.is_available() else math.inf
            if now_s - available_s > STANDSTILL_S and not self._is_playing:
                self._play()
            self._spin_until(lambda: False, _POLL_S)
            self._report_progress()

    def _missing(self) -> list[str]:
        """Returns descriptions of what the stack still lacks; sends the initial pose as soon as possible, since the rest may depend on it."""
        ready, missing = self._input.ready, []
        if not self._is_settled():
            missing.append("no stable ROS graph")
        if not self._goal.is_available():
            missing.append(f"no {self._goal.description}")
        elif not missing:
            if not self._input.goal_from_ns:
                self._send_initial_pose()
            self._request_images()
        if self._ready_topic is not None and not self._ready_topic.is_met():
            missing.append(f"no message on {quoted(ready.topic)}")
        if ready.service and not self._has_service(ready.service):
            missing.append(f"no service {quoted(ready.service)}")
        if self._lifecycle is not None and not self._is_active():
            missing.append(f"no active node {quoted(ready.node)}")
        return missing

    def _is_settled(self) -> bool:
        """Returns whether discovery has settled: no new topic, and no new receiver of the goal or the initial pose for ``SETTLED_S``."""
        present, now_s = {name for name, _ in self.get_topic_names_and_types()}, time.monotonic()
        present |= {"goal"} if self._goal.is_available() else set()
        present |= {"initial pose"} if self._has_initial_pose_subscriber() else set()
        previous, since_s = self._graph
        self._graph = (present, since_s if present == previous else now_s)
        return now_s - self._graph[1] >= SETTLED_S

    def _has_initial_pose_subscriber(self) -> bool:
        """Returns whether the stack subscribes to an initial pose."""
        return self._initial_pub is not None and _has_subscriber(self, self._initial_pub.topic_name)

    def _send_initial_pose(self) -> None:
        publisher = self._initial_pub
        if self._initial_sent or publisher is None or not self._has_initial_pose_subscriber():
            return
        self._initial_sent = True
        run, spec = self._input.run, self._input.initial_pose
        x, y, yaw = _composed(run.start, run.initial_error)
        message = PoseWithCovarianceStamped(header=conversions.header_to_msg(max(0, self._monitor.now_ns), WORLD_FRAME))
        message.pose.pose = conversions.pose_to_msg(_pose((x, y, yaw)))
        covariance = [0.0] * 36
        covariance[0] = covariance[7] = spec.sigma_xy**2
        covariance[35] = math.radians(spec.sigma_yaw_deg) ** 2
        message.pose.covariance = covariance
        publisher.publish(message)
        _wait_for_acknowledgement(publisher)

    def _has_service(self, name: str) -> bool:
        return self.resolve_service_name(name) in {service for service, _ in self.get_service_names_and_types()}

    def _is_active(self) -> bool:
        """Returns whether the lifecycle node has reported that it is active; requests its state repeatedly until then."""
        client: Any = self._lifecycle
        future = self._lifecycle_future
        if future is not None and future.done():
            self._lifecycle_future = None
            self._was_active = future.exception() is None and future.result().current_state.id == _ACTIVE
        if not self._was_active and self._lifecycle_future is None and client.service_is_ready():
            self._lifecycle_future = client.call_async(client.srv_type.Request())
        return self._was_active

    def _on_ready(self) -> None:
        """Sends the goal now if time stands still and the goal has no earliest time; otherwise a later tick sends it."""
        self._ready = True
        if self._input.goal_from_ns:
            self._play()
        elif not self._is_playing:
            self._monitor.give_goal(0)
            self._goal.send(0)
            self._spin_until(self._goal.is_accepted, STANDSTILL_S)
            self._play()

    def _play(self) -> None:
        """Starts the simulation."""
        self._simulation.ask("set_simulation_state", state_request(SimulationState.STATE_PLAYING))
        self._is_playing = True
        self._last_tick_s = time.monotonic()

    # Images

    def _on_scene(self, msg: Any) -> None:
        self._scene = msg

    def _request_images(self) -> None:
        """Requests a render node if the stack subscribes to images of cameras, and waits until it publishes and has joined lockstep."""
        if self._scene is None or self._is_playing:
            return
        subscribed = [
            topic
            for camera in self._scene.cameras
            for topic in names.image_topics(camera.name, camera.outputs)
            if _has_subscriber(self, self.resolve_topic_name(topic))
        ]
        if not subscribed:
            return
        note_in_job(IMAGES, "")
        self._wait(lambda: all(self.count_publishers(topic) for topic in subscribed), f"publisher of {subscribed[0]}")
        if self._lockstep is not None:
            tick_done = self.resolve_topic_name(names.TICK_DONE)
            self._wait(
                lambda: any(p.node_name == "render" for p in self.get_publishers_info_by_topic(tick_done)),
                "render node in lockstep",
            )
        self._spin_until(lambda: False, _MATCHED_S)

    # Ticks

    def _on_truth(self, msg: Any) -> None:
        now_s, stamp_ns = time.monotonic(), conversions.time_from_msg(msg.header.stamp)
        self._report.began_s = self._report.began_s or now_s
        self._report.ended_s = self._last_tick_s = now_s
        if self._decision is not None:
            return
        if self._ready and self._monitor.goal_ns < 0 and stamp_ns >= self._input.goal_from_ns:
            self._send_initial_pose()
            self._monitor.give_goal(stamp_ns)
            self._goal.send(stamp_ns)
        p, q, v = msg.pose.pose.position, msg.pose.pose.orientation, msg.twist.twist
        yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
        self._decision = self._monitor.tick(stamp_ns, (p.x, p.y, yaw), math.hypot(v.linear.x, v.linear.y), v.angular.z)
        if self._decision is not None:
            return  # in lockstep, time stands still from now on
        self._ticks += 1
        if self._input.run.people and self._ticks % PERIOD_TICKS == 0:
            self._move_people(stamp_ns, partial(self._tick_done, msg.header.stamp))
        else:
            self._tick_done(msg.header.stamp)

    def _on_time_control(self, msg: Any) -> None:
        """Ends the run if another node has changed how time passes without a right to: in a paused simulation no tick would end it."""
        stamp_ns = conversions.time_from_msg(msg.header.stamp)
        entry = JournalEntry(stamp_ns, msg.step, msg.name, bytes(msg.data))
        if len(self._report.time_calls) < _MAX_TIME_CALLS and len(entry.data) <= _MAX_CALL_BYTES:
            self._report.time_calls.append([entry.stamp_ns, entry.step, entry.name, entry.data.hex()])
        if self._decision is None and entry.kind not in self._input.allowed_calls:
            self._decision = Decision("simulation failed", f"foreign call: another node called {entry.description}", stamp_ns)

    def _tick_done(self, stamp: Any) -> None:
        if self._lockstep is not None:
            self._lockstep.tick_done(stamp)

    def _move_people(self, stamp_ns: int, on_end: Callable[[], None]) -> None:
        """Moves all people to their poses at a stamp, and calls ``on_end`` once the simulation has responded to all requests."""
        people = self._input.run.people
        pending = set(range(len(people)))

        def on_response(number: int, _: Any) -> None:
            pending.discard(number)
            if not pending:
                on_end()

        for number, person in enumerate(people):
            pose = conversions.pose_to_msg(_pose(person_pose(person, stamp_ns / NS_PER_S)))
            request = move_request(person.name, pose, at_rest=False)
            self._simulation.begin("set_entity_state", request, partial(on_response, number))

    # Waiting

    def _wait(self, condition: Callable[[], bool], awaited: str) -> None:
        limit_s = max(_ANSWER_S, self._input.ready.within)
        if not self._spin_until(condition, limit_s):
            if not is_running():
                raise KeyboardInterrupt
            raise GibsonSimError(f"waited {limit_s:g} s for the {awaited}")

    def _spin_until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Spins until a condition holds, or for ``timeout_s`` of wall time; returns whether the condition holds."""
        deadline_s = time.monotonic() + timeout_s
        while is_running() and not condition():
            remaining_s = deadline_s - time.monotonic()
            if remaining_s <= 0.0:
                return False
            self._executor.spin_once(timeout_sec=min(0.02, remaining_s))
        return condition()

    def _watch_callers(self) -> None:
        """Notes which other nodes can change the world or its time, or pause the recording: a request does not say who sent it."""
        callers = self._report.callers
        for name, topics in CALL_TOPICS.items():
            known = callers.get(name, [])
            for topic, is_mangled in topics:
                for info in self.get_publishers_info_by_topic(topic, no_mangle=not is_mangled):
                    node = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
                    is_other = info.node_name not in SIMULATOR_NODES and info.node_name != _UNKNOWN_NODE
                    if is_other and node not in known and len(known) < _MAX_CALLERS:
                        known = callers.setdefault(name, known)
                        known.append(node)

    def _report_progress(self) -> None:
        now_s = time.monotonic()
        if now_s - self._watched_s > _POLL_S:
            self._watched_s = now_s
            self._watch_callers()
        if now_s - self._reported_s > _PROGRESS_S:
            self._reported_s = now_s
            note_in_job(PROGRESS, self._monitor.progress)
            note_in_job(CLOCK, str(self._monitor.now_ns))

    def close(self) -> None:
        """Writes the report. The node does not leave lockstep, so that time stands still until the simulation ends."""
        if is_running():
            self._watch_callers()
        report, decision, monitor = self._report, self._decision, self._monitor
        if decision is not None:
            report.end, report.detail, report.decided_ns = decision.end, decision.detail, decision.decided_ns
        report.goal_ns, report.end_ns, report.status = monitor.goal_ns, monitor.now_ns, monitor.status
        write_summary(self._config.output, json_values(report))
        self._executor.shutdown(timeout_sec=1.0)


class _ReadyTopic:
    """Waits for the first message on a topic of any type."""

    def __init__(self, node: Node, topic: str) -> None:
        self._node, self._topic = node, topic
        self._subscribed = self._received = False

    def is_met(self) -> bool:
        """Returns whether a message has arrived; subscribes once the topic has a publisher."""
        publishers = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(self._topic))
        if not self._subscribed and publishers:
            self._subscribed = True
            kind = publishers[0].topic_type
            self._node.create_subscription(
                _class_of(message_class, kind), self._topic, self._on_message, recording_profile(publishers, kind), raw=True
            )
        return self._received

    def _on_message(self, _: bytes) -> None:
        self._received = True


class _TopicGoal:
    """Sends the goal on a topic."""

    def __init__(self, node: Node, topic: str, message: Callable[[int], PoseStamped]) -> None:
        self._node, self._message = node, message
        self._publisher = node.create_publisher(PoseStamped, topic, qos.LATCHED)
        self.description = f"subscriber of {self._publisher.topic_name}, on which the goal is given (key stack.goal)"

    def is_available(self) -> bool:
        """Returns whether the stack subscribes to the topic, and is matched."""
        return _has_subscriber(self._node, self._publisher.topic_name) and is_fully_matched(self._node, self._publisher)

    def send(self, stamp_ns: int) -> None:
        """Publishes the goal, and waits until it is acknowledged."""
        self._publisher.publish(self._message(stamp_ns))
        _wait_for_acknowledgement(self._publisher)

    def is_accepted(self) -> bool:
        """Returns True: a topic has no response."""
        return True


class _ServiceGoal:
    """Sends the goal in the request of a service."""

    def __init__(self, node: Node, kind: Any, name: str, fill: Callable[[Any, int], Any]) -> None:
        self._client, self._fill, self._kind = node.create_client(kind, name), fill, kind
        self._future: Any = None
        self.description = f"service {self._client.srv_name}"

    def is_available(self) -> bool:
        """Returns whether the service is available."""
        return bool(self._client.service_is_ready())

    def send(self, stamp_ns: int) -> None:
        """Sends the request."""
        self._future = self._client.call_async(self._fill(self._kind.Request(), stamp_ns))

    def is_accepted(self) -> bool:
        """Returns whether the service has responded."""
        return self._future is not None and bool(self._future.done())


class _ActionGoal:
    """Sends the goal to an action, whose result ends the run."""

    def __init__(self, node: Node, kind: Any, name: str, fill: Callable[[Any, int], Any], monitor: RunMonitor) -> None:
        self._client, self._fill, self._kind, self._monitor = ActionClient(node, kind, name), fill, kind, monitor
        self._responded = False
        self.description = f"action {node.resolve_service_name(name)}"

    def is_available(self) -> bool:
        """Returns whether the action is available."""
        return bool(self._client.server_is_ready())

    def send(self, stamp_ns: int) -> None:
        """Sends the goal."""
        future = self._client.send_goal_async(self._fill(self._kind.Goal(), stamp_ns))
        future.add_done_callback(self._on_response)

    def is_accepted(self) -> bool:
        """Returns whether the action server has accepted or rejected the goal."""
        return self._responded

    def _on_response(self, future: Any) -> None:
        self._responded = True
        handle = future.result()
        if not handle.accepted:
            self._monitor.receive_result(False, REFUSED_GOAL)
            return
        handle.get_result_async().add_done_callback(self._on_result)

    def _on_result(self, future: Any) -> None:
        status = future.result().status
        texts = {_SUCCEEDED: "succeeded", 5: "was cancelled", 6: "was aborted"}
        self._monitor.receive_result(status == _SUCCEEDED, texts.get(status, f"ended with status {status}"))


def _goal_of(node: Node, given: TrialInput, monitor: RunMonitor) -> _TopicGoal | _ServiceGoal | _ActionGoal:
    """Returns the sender of the goal.

    Raises:
        GibsonSimError: the type is not installed, or the field is not a PoseStamped.
    """

    def message(stamp_ns: int) -> PoseStamped:
        msg = PoseStamped(header=conversions.header_to_msg(stamp_ns, WORLD_FRAME))
        msg.pose = conversions.pose_to_msg(_pose(given.run.goal))
        return msg

    spec = given.goal
    if given.goal_topic:
        return _TopicGoal(node, given.goal_topic, message)
    kind = _class_of(service_class, spec.type)

    def fill(request: Any, stamp_ns: int) -> Any:
        setattr(request, spec.field, message(stamp_ns))
        return request

    part = kind.Goal if spec.kind == "action" else kind.Request
    if part.get_fields_and_field_types().get(spec.field) != POSE_TYPE:
        fields = ", ".join(f"{name} ({type_})" for name, type_ in part.get_fields_and_field_types().items())
        raise ConfigError(
            f"stack.goal.field is {quoted(spec.field)}, must be a field of type {POSE_TYPE} of {spec.type}, which has "
            f"{fields or 'none'}"
        )
    if spec.kind == "service":
        return _ServiceGoal(node, kind, spec.name, fill)
    return _ActionGoal(node, kind, spec.name, fill, monitor)


def _class_of(find: Callable[[str], Any], type_name: str) -> Any:
    """Returns the class of a type.

    Raises:
        EnvironmentProblemError: the type is not installed.
    """
    try:
        return find(type_name)
    except UNKNOWN as error:
        raise EnvironmentProblemError(
            f"type {quoted(type_name)} is not installed here: install its package, or source the ROS workspace that has it"
        ) from error


def _has_subscriber(node: Node, topic: str, among: Iterable[str] = ()) -> bool:
    """Returns whether a node that is not of the simulator subscribes to a topic; with ``among``, whether one of these nodes does."""
    subscribers = {info.node_name for info in node.get_subscriptions_info_by_topic(topic)}
    return bool(subscribers & set(among)) if among else bool(subscribers - SIMULATOR_NODES)


def _wait_for_acknowledgement(publisher: Publisher) -> None:
    """Blocks until all subscribers have acknowledged a message, at most ``_ACKNOWLEDGED_S``."""
    publisher.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGED_S))


def _pose(pose: PlanarPose, z: float = 0.0) -> Pose:
    return Pose((pose[0], pose[1], z), (0.0, 0.0, math.sin(pose[2] / 2.0), math.cos(pose[2] / 2.0)))


def _composed(pose: PlanarPose, change: PlanarPose) -> PlanarPose:
    """Returns the composition of a pose (x, y in m, yaw in rad) with a change in its own frame."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose[0] + c * change[0] - s * change[1], pose[1] + s * change[0] + c * change[1], pose[2] + change[2]


def main(args: list[str] | None = None) -> None:
    """Runs the trial node."""
    run_node(TrialNode, args)


if __name__ == "__main__":
    main()
