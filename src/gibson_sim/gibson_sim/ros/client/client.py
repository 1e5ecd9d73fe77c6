"""A client of one simulation for tests and scripts, which blocks while time passes. It spins only in the thread that calls it.

In lockstep it is a participant: time passes only within its calls, tick by tick. A call sees all messages up to the present tick and none
later, except that images of the present tick are delivered with the next one. The same calls in the same order therefore return the same
values.
"""

from __future__ import annotations

import math
import time
import warnings
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from simulation_interfaces.msg import SimulationState

from gibson_msgs.msg import CollisionCount, Contacts, TickDigest
from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import quoted
from gibson_sim.ros import conversions
from gibson_sim.ros.client.answers import AnswerRule, parse_rule
from gibson_sim.ros.client.collisions import Collision, CollisionLog
from gibson_sim.ros.client.simulation_client import (
    Awaited,
    SimulationClient,
    flat_pose,
    is_success,
    refusal_text,
    standard_service,
)
from gibson_sim.ros.lockstep.lockstep_client import LockstepParticipant
from gibson_sim.ros.nodes.node_main import make_executor
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class, type_name_of
from gibson_sim.settings import nearest
from gibson_sim.standard.openings import JointOpening, joint_openings
from gibson_sim.types import NS_PER_S, WORLD_FRAME

__tracebackhide__ = True
"""pytest shows the line of the test, not those of this module; ``--full-trace`` shows all."""
START_S = 120.0
"""Timeout for the services of a starting simulation, s of wall time: a large scene takes long to load."""
STALL_S = 30.0
"""Timeout for the next tick, s of wall time."""
ANSWER_S = 60.0
"""Timeout for the response of a service, s of wall time."""
DISCOVERY_S = 10.0
"""Timeout for the discovery of a topic, a service or a subscriber, s of wall time."""
_SETTLED_S = 2.0
"""Timeout for the first message of a new subscription, s of wall time: it may have been published before the subscription was matched."""
_PHYSICS = "physics"
"""Name of the simulation's physics node."""
_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo")
_LARGE = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/PointCloud2")
MAX_MESSAGES, MAX_LARGE_MESSAGES = 100_000, 200
"""Maximum number of messages that are kept of a topic, the newest ones; the second for images and point clouds."""


@dataclass(frozen=True, slots=True)
class RobotPose:
    """A pose in the map frame, m and rad."""

    x: float
    y: float
    z: float
    yaw: float
    """Heading about the vertical, -pi to pi."""

    def distance_to(self, x: float, y: float) -> float:
        """Returns the horizontal distance to a point, m."""
        return math.hypot(self.x - x, self.y - y)

    def __str__(self) -> str:
        return f"x {self.x:.2f} m, y {self.y:.2f} m, yaw {round(math.degrees(self.yaw))} deg"


@dataclass(frozen=True, slots=True)
class _Tick:
    stamp_ns: int
    epoch: int
    topics: frozenset[str]
    """Topics that the physics node published at it; resolved names."""


@dataclass(slots=True)
class _SubscribedTopic:
    """A topic that the client subscribes to."""

    handle: Any
    messages: deque[Any]
    held: deque[Any]
    """Images that arrived before the tick with which they are delivered."""
    is_image: bool
    last_ns: int = -1
    """Stamp of the last message, simulation time, ns."""
    is_matched: bool = False
    """Whether a message has arrived, or the wait for the first one has timed out."""


@dataclass(slots=True)
class _FollowedProgram:
    """A program whose answers the ticks wait for."""

    rule: AnswerRule
    topic: str
    has_ended: Callable[[], bool]
    is_command: bool
    """Whether its answers are commands to the simulation: a tick then ends when the simulation has received them, too."""
    handle: Any = None


class Client:
    """Communicates with the simulation of a ROS domain."""

    def __init__(
        self,
        domain_id: int,
        robots: Mapping[str, str],
        *,
        name: str,
        lockstep: bool,
        stamped: bool = False,
        check: Callable[[], None],
        waits_for: Callable[[], str] = str,
    ) -> None:
        """Joins the domain without waiting; see ``connect``.

        Args:
            domain_id: domain ID of the simulation.
            robots: name of each robot -> namespace of its topics, with a trailing slash, or empty.
            name: name of this client's node, and of the participant in lockstep.
            lockstep: whether the simulation is in lockstep and waits for this client.
            stamped: whether robots are commanded by TwistStamped.
            check: raises if the simulation or a process that it needs has ended; called while a call waits.
            waits_for: returns what the simulation reports that it waits for; empty = nothing.
        """
        self._check, self._waits_for, self._lockstep, self._stamped = check, waits_for, lockstep, stamped
        self._context: Any = rclpy.Context()
        self._context.init(domain_id=domain_id)
        self.node: Any = Node(
            name, context=self._context, use_global_arguments=False, start_parameter_services=False, enable_rosout=False
        )
        self._executor: Any = make_executor(context=self._context)
        self._executor.add_node(self.node)
        self._robots = dict(robots)
        self._publishers: dict[str, Any] = {}
        self._subscribed: dict[str, _SubscribedTopic] = {}
        self._followed: list[_FollowedProgram] = []
        self._participant: LockstepParticipant | None = None
        self._ticks: deque[_Tick] = deque()
        self._held: _Tick | None = None
        """The present tick of lockstep, which ends with ``tick_done``."""
        self._sent: list[str] = []
        """Topic of each command since the last tick."""
        self._now_ns, self._epoch, self._is_paused = 0, 0, False
        self._held_since = 0.0
        """Monotonic time at which the client received the present tick, s."""
        self._matched_by = 0.0
        """Monotonic deadline for the first message of a subscription, s."""
        self._events = 0
        """Number of messages received, for ``_drain``."""
        self._truth: dict[str, Any] = {}
        self._moved: set[str] = set()
        """Robots that a request may have moved since their last pose arrived."""
        self._counts: dict[str, CollisionCount] = {}
        """Robot -> its last collision count that is not in the log yet."""
        self._collisions = {robot: CollisionLog(robot) for robot in robots}
        self._contacts: Any = None
        self._map: Any = None
        self.services = SimulationClient(self.node, self._wait_for_call)

    # Start and end

    def connect(self) -> None:
        """Waits until the services of the simulation are ready, and, in lockstep, lets its first tick begin.

        Raises:
            GibsonSimError: the simulation has ended, or does not answer.
        """
        volatile = QoSProfile(depth=1000)
        self.node.create_subscription(TickDigest, names.TICK_DIGEST, self._on_digest, volatile)
        self.node.create_subscription(Contacts, names.CONTACTS, self._on_contacts, volatile)
        self.node.create_subscription(OccupancyGrid, names.MAP, self._on_map, qos.LATCHED)
        for robot, namespace in self._robots.items():
            truth, collisions = f"{namespace}{names.GROUND_TRUTH}", f"{namespace}{names.COLLISIONS}"
            self._subscribe_internally(truth, Odometry, partial(self._on_truth, robot))
            self._subscribe_internally(collisions, CollisionCount, partial(self._on_collisions, robot))
        used = ("get_simulation_state", "spawn_entity", "reset_simulation")
        for service in used:
            self.services.prepare(service)
        self._spin_until(START_S, lambda: all(map(self.services.is_offered, used)), "the simulation to answer")
        if self._lockstep:
            self._participant = LockstepParticipant(self.node)
        if self._initial_state() == SimulationState.STATE_PLAYING:
            self.next_tick(START_S)

    def _initial_state(self) -> int:
        state = self.services.state
        if state == SimulationState.STATE_STOPPED:
            self.set_playing(False)  # a stopped simulation executes no steps
        self._is_paused = state != SimulationState.STATE_PLAYING
        return state

    def _subscribe_internally(self, topic: str, kind: Any, callback: Callable[[Any], None]) -> None:
        """Subscribes to a topic that is published at every tick, for the client's own use."""
        name = self.node.resolve_topic_name(topic)
        subscribed = self._subscribed[f"{name} (internal)"] = _SubscribedTopic(None, deque(maxlen=1), deque(), False)

        def on_message(msg: Any) -> None:
            subscribed.last_ns, subscribed.is_matched = _stamp_ns(msg), True
            self._events += 1
            callback(msg)

        subscribed.handle = self.node.create_subscription(kind, name, on_message, QoSProfile(depth=1000))

    def close(self) -> None:
        """Leaves the domain."""
        if self._context is None:
            return
        if self._participant is not None:
            self._participant.leave()
            self._participant = None
        self._executor.shutdown(timeout_sec=5.0)
        self.node.destroy_node()
        self._context.try_shutdown()
        self._context = None

    def raise_if_ended(self) -> None:
        """Raises if the simulation or a process that it needs has ended."""
        self._check()

    # Time

    @property
    def now(self) -> float:
        """Simulation time since the start or the last reset, s."""
        return self._now_ns / NS_PER_S

    @property
    def is_paused(self) -> bool:
        """Whether time is paused."""
        return self._is_paused

    def next_tick(self, timeout_s: float = STALL_S) -> None:
        """Lets time pass until the next tick was published, and its messages on all subscribed topics have arrived.

        Raises:
            GibsonSimError: time is paused or stands still for ``timeout_s`` of wall time, or a process has ended.
        """
        if self._is_paused:
            raise GibsonSimError("the simulation is paused, so time does not pass: call play(), or step(seconds)")
        self._spin_until(timeout_s, self._end_tick, "the answers of programs")
        self._spin_until(timeout_s, self._begin_tick, "")

    def _end_tick(self) -> bool:
        """Ends the present tick; returns False if a program has not answered it yet."""
        if self._held is None:
            return True
        for followed in [program for program in self._followed if program.has_ended()]:
            self._followed.remove(followed)
            self.node.destroy_subscription(followed.handle)
        for followed in self._followed:
            rule = followed.rule
            # The very first answer may be lost: discovery may be complete in one direction only.
            if not rule.is_answered and (rule.has_answered or time.monotonic() < self._held_since + _SETTLED_S):
                return False
        for followed in self._followed:
            count = followed.rule.end_tick()
            self._sent += [followed.topic] * (count if followed.is_command else 0)
        if self._participant is not None:
            self._participant.tick_done(conversions.time_to_msg(self._held.stamp_ns), self._sent)
        self._sent, self._held = [], None
        return True

    def publishers(self, topic: str) -> frozenset[tuple[int, ...]]:
        """Returns the GIDs of the publishers of a topic that are discovered now."""
        return frozenset(tuple(info.endpoint_gid) for info in self.node.get_publishers_info_by_topic(self.resolve(topic)))

    def has_joined(self, participant: str) -> bool:
        """Returns whether another lockstep participant, a node of that name, has joined; without lockstep, whether there is such a node."""
        if not self._lockstep:
            return participant in self.node.get_node_names()
        return any(info.node_name == participant for info in self.node.get_publishers_info_by_topic(names.TICK_DONE))

    def follow(self, text: str, earlier: frozenset[tuple[int, ...]], has_ended: Callable[[], bool], timeout_s: float) -> None:
        """Waits until a program publishes on the topic of a rule; from then on, each tick waits for its answer, in lockstep.

        Args:
            text: rule, such as ``cmd_vel after scan``.
            earlier: GIDs of the publishers of its topic before the program was started: those of killed programs stay visible for a while.
            has_ended: returns whether the program has ended, which also ends the rule.
            timeout_s: timeout for the discovery of the program, s of wall time.

        Raises:
            GibsonSimError: the rule is invalid, or the program does not publish in time.
        """
        rule = AnswerRule(parsed := parse_rule(text))
        topic = self.resolve(parsed.answer)

        def is_discovered() -> bool:
            infos = [info for info in self.node.get_publishers_info_by_topic(topic) if tuple(info.endpoint_gid) not in earlier]
            return bool(infos) and (not parsed.after or all(self._subscribes(info, parsed.after) for info in infos))

        answers_to = f", in a node that subscribes to {parsed.after}" if parsed.after else ""
        self._spin_until(timeout_s, is_discovered, f"a publisher of {parsed.answer}{answers_to}")
        kind = _message_class(self.node.get_publishers_info_by_topic(topic)[0].topic_type)
        is_command = any(info.node_name == _PHYSICS for info in self.node.get_subscriptions_info_by_topic(topic))
        followed = _FollowedProgram(rule, topic, has_ended, is_command)
        followed.handle = self.node.create_subscription(
            kind, topic, lambda data: rule.receive(), self._profile(topic, 1000), raw=True
        )
        self._settle(lambda: followed.handle.handle.get_publisher_count() > 0)
        self.services.ask("get_simulation_state")
        self._followed.append(followed)

    def _subscribes(self, info: Any, topic: str) -> bool:
        if not info.node_namespace.startswith("/"):
            return False  # the node's name is not known yet
        try:
            subscriptions = self.node.get_subscriber_names_and_types_by_node(info.node_name, info.node_namespace)
        except NodeNameNonExistentError:
            return False
        return self.resolve(topic) in {name for name, _ in subscriptions}

    def _begin_tick(self) -> bool:
        """Makes the next tick the present one if it has arrived completely; returns whether it has."""
        while self._ticks and self._ticks[0].epoch < self._epoch:
            late = self._ticks.popleft()
            if self._participant is not None:  # the simulation publishes the reset once this tick is done
                self._participant.tick_done(conversions.time_to_msg(late.stamp_ns))
        if not self._ticks or (len(self._ticks) == 1 and not self._is_complete(self._ticks[0])):
            return False  # if a later tick has arrived, it is complete: messages arrive in the order of publication
        tick = self._held = self._ticks.popleft()
        self._now_ns, self._epoch, self._held_since = tick.stamp_ns, tick.epoch, time.monotonic()
        topics = {name.lstrip("/") for name in tick.topics} if self._followed else set()
        for followed in self._followed:
            followed.rule.begin_tick(tick.stamp_ns, topics)
        for subscribed in self._subscribed.values():
            while subscribed.held and _stamp_ns(subscribed.held[0]) < tick.stamp_ns:
                subscribed.messages.append(subscribed.held.popleft())
        self._log_collisions()
        return True

    def _is_complete(self, tick: _Tick) -> bool:
        for name, subscribed in self._subscribed.items():
            if not subscribed.is_image and name.partition(" ")[0] in tick.topics and subscribed.last_ns < tick.stamp_ns:
                if subscribed.is_matched or time.monotonic() < self._matched_by:
                    return False
                subscribed.is_matched = True
        return True

    def _spin_until(self, timeout_s: float, condition: Callable[[], bool], awaited: str) -> None:
        """Spins until a condition holds.

        Args:
            timeout_s: timeout, s of wall time.
            condition: returns whether it holds.
            awaited: description of the condition, for the error message; empty = the next tick.

        Raises:
            GibsonSimError: it does not hold in time, or a process has ended.
        """
        start = time.monotonic()
        self._matched_by = start + _SETTLED_S
        while not condition():
            self._executor.spin_once(timeout_sec=0.05)
            self._check()
            if time.monotonic() - start > timeout_s:
                reported = self._waits_for()
                problem = (
                    f"waited {timeout_s:g} s for {awaited}" if awaited else f"simulation time stands still for {timeout_s:g} s"
                )
                raise GibsonSimError(f"{problem}, at {self.now:.3f} s of simulation time{f': {reported}' if reported else ''}")

    def run_until(self, condition: Callable[[], bool], timeout_s: float, awaited: str) -> None:
        """Spins until a condition holds; time passes meanwhile, unless it is paused.

        Args:
            condition: returns whether it holds.
            timeout_s: timeout, s of wall time.
            awaited: description of the condition, for the error message.
        """

        def holds() -> bool:
            if self._held is None:
                self._begin_tick()
            if condition():
                return True
            self._end_tick()
            return False

        if not condition():
            self._end_tick()
            self._spin_until(timeout_s, holds, awaited)
            if self._held is None and not self._is_paused:
                self.next_tick()

    def step(self, steps: int, step_hz: int) -> None:
        """Executes physics steps of ``1 / step_hz`` s in a paused simulation."""
        target_ns = (round(self._now_ns * step_hz / NS_PER_S) + steps) * NS_PER_S // step_hz
        future = self.services.send("step_simulation", standard_service("step_simulation").Request(steps=steps))

        def done() -> bool:
            if self._held is None:
                self._begin_tick()
            if not future.done():
                self._end_tick()
            return bool(future.done())

        self._end_tick()
        self._spin_until(max(ANSWER_S, 0.1 * steps), done, "the steps to be executed")
        self._drain()
        if not is_success("step_simulation", future.result()):
            raise GibsonSimError(refusal_text("step_simulation", future.result()))
        while self._begin_tick():
            pass
        self._now_ns = target_ns  # it may lie between two ticks

    def set_playing(self, playing: bool) -> None:
        """Plays or pauses the simulation."""
        (self.services.play if playing else self.services.pause)()
        self._is_paused = not playing

    def set_rate(self, rate: float) -> None:
        """Sets the rate of simulation time relative to wall time; 0 = as fast as possible."""
        is_set, reason = self.services.set_parameter(_PHYSICS, "rate", rate)
        if not is_set:
            raise GibsonSimError(reason)

    def reset(self) -> None:
        """Resets the simulation, and discards the messages received so far."""
        self.services.reset()
        self._drain()
        self._epoch += 1
        self._now_ns = 0
        self._truth.clear()
        self._counts.clear()
        self._contacts = None
        for log in self._collisions.values():
            log.clear()
        for subscribed in self._subscribed.values():
            subscribed.messages.clear()
            subscribed.held.clear()
            subscribed.last_ns = -1
        for followed in self._followed:
            followed.rule.reset()
        # The simulation publishes the reset once the present tick is done, and then the first tick of the new epoch.
        self._end_tick()
        if not self._is_paused:
            self.next_tick()

    def _drain(self) -> None:
        """Handles all messages that have arrived."""
        idle = 0
        while idle < 3:
            previous = self._events
            self._executor.spin_once(timeout_sec=0.0)
            idle = idle + 1 if self._events == previous else 0

    def _wait_for_call(self, condition: Callable[[], bool], awaited: Awaited) -> None:
        """Spins while a service is called; in lockstep, time stands still meanwhile."""
        if awaited.is_sent:
            self._moved.update(self._truth)
        self._spin_until(ANSWER_S if awaited.is_sent else DISCOVERY_S, condition, f"the {awaited}")

    # Topics

    def topics(self) -> dict[str, str]:
        """Returns topic -> type of all topics that have publishers now."""
        types = {}
        for name, kinds in self.node.get_topic_names_and_types():
            if self.node.count_publishers(name):
                types[name] = str(kinds[0])
        return types

    def subscribe(self, topic: str, kind: Any = None) -> None:
        """Subscribes to a topic; does nothing if it is subscribed to already.

        Args:
            topic: name of the topic, relative or absolute.
            kind: message class; None = that of its publishers, which must exist.

        Raises:
            GibsonSimError: the topic has no publisher, or its type is not installed.
        """
        name = self.node.resolve_topic_name(topic)
        if name in self._subscribed:
            return
        if kind is None:
            if name not in self.topics():
                self._settle(lambda: name in self.topics())
            known = self.topics()
            if name not in known:
                hint = nearest(name, list(known))
                raise GibsonSimError(
                    f"topic {quoted(name)} has no publisher{f'; {hint}' if hint else ''}; give its type if it will have one later"
                )
            kind = _message_class(known[name])
        is_image = type_name_of(kind) in _IMAGES and self._lockstep
        depth = MAX_LARGE_MESSAGES if type_name_of(kind) in _LARGE else MAX_MESSAGES
        subscribed = self._subscribed[name] = _SubscribedTopic(None, deque(maxlen=depth), deque(maxlen=depth), is_image)

        def on_message(msg: Any) -> None:
            subscribed.is_matched = True
            self._events += 1
            if hasattr(msg, "header"):
                subscribed.last_ns = _stamp_ns(msg)
            else:
                subscribed.last_ns = max(subscribed.last_ns, self._now_ns)
            (subscribed.held if is_image else subscribed.messages).append(msg)

        subscribed.handle = self.node.create_subscription(kind, name, on_message, self._profile(name, min(depth, 1000)))
        self._settle(lambda: not self.node.count_publishers(name) or subscribed.handle.handle.get_publisher_count() > 0)
        # A round trip: the simulation has discovered the subscription before it answers.
        self.services.ask("get_simulation_state")

    def _settle(self, condition: Callable[[], bool]) -> None:
        """Spins until a condition holds, or discovery has had ``_SETTLED_S``."""
        deadline = time.monotonic() + _SETTLED_S
        while not condition() and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.02)
            self._check()

    def _profile(self, name: str, depth: int) -> QoSProfile:
        """Returns the strictest QoS profile that is compatible with all publishers of a topic."""
        offered = [info.qos_profile for info in self.node.get_publishers_info_by_topic(name)]
        reliable = bool(offered) and all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered)
        latched = bool(offered) and all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in offered)
        return QoSProfile(
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )

    def resolve(self, topic: str) -> str:
        """Returns the full name of a topic."""
        return str(self.node.resolve_topic_name(topic))

    def is_subscribed(self, topic: str) -> bool:
        """Returns whether ``subscribe`` was called for a topic."""
        return self.resolve(topic) in self._subscribed

    def messages(self, topic: str) -> Sequence[Any]:
        """Returns the messages of a topic since the subscription or the last reset, oldest first."""
        self.subscribe(topic)
        self.catch_up()
        return list(self._subscribed[self.node.resolve_topic_name(topic)].messages)

    def catch_up(self) -> None:
        """Handles the messages that have arrived, if the simulation is not in lockstep."""
        if not self._lockstep:
            self._drain()
            while self._begin_tick():
                pass

    def unsubscribe(self, topic: str) -> None:
        """Ends the subscription of a topic and discards its messages; does nothing if it is not subscribed to."""
        if (subscribed := self._subscribed.pop(self.resolve(topic), None)) is not None:
            self.node.destroy_subscription(subscribed.handle)

    def unsubscribe_all(self) -> None:
        """Ends all subscriptions that ``subscribe`` created."""
        for name in [name for name in self._subscribed if not name.endswith(" (internal)")]:
            self.unsubscribe(name)

    # Doors

    def openings(self) -> tuple[float, dict[str, JointOpening]]:
        """Returns the latest known state of each door and drawer by name, ``<body>/<joint>``, and its time, s; subscribes to it.

        The simulation publishes it at 10 Hz from the first subscription on, and at changes of the scene.
        """
        name = self.resolve(names.OBJECT_JOINT_STATES)
        if name not in self._subscribed and name not in self.topics():
            return math.inf, {}
        self.subscribe(name)
        messages = self._subscribed[name].messages
        self._settle(lambda: bool(messages))  # it is latched
        if not messages:
            return -math.inf, {}
        return _stamp_ns(messages[-1]) / NS_PER_S, joint_openings(conversions.joint_values(messages[-1]))

    def move_joint(self, joint: str, position: float | None) -> None:
        """Commands the position of a joint of a body, rad or m, with the next step; None = it swings freely."""
        values = {"effort": [0.0]} if position is None else {"position": [position]}
        publisher = self._publisher(names.OBJECT_JOINT_COMMAND, JointState)
        publisher.publish(JointState(name=[joint], **values))
        self._sent.append(publisher.topic_name)

    # The robot

    def pose(self, robot: str) -> RobotPose:
        """Returns the true pose of a robot, or of any entity, in the map frame."""
        self.catch_up()
        if robot not in self._truth or robot in self._moved:
            pose = self.services.pose(robot)
            if robot not in self._robots:
                return robot_pose(pose)
            self._truth[robot] = pose
            self._moved.discard(robot)
        return robot_pose(self._truth[robot])

    def last_pose(self, robot: str) -> RobotPose | None:
        """Returns the last pose of a robot that was received, without a request; None = none was."""
        pose = self._truth.get(robot)
        return None if pose is None else robot_pose(pose)

    def collisions(self) -> list[Collision]:
        """Returns the collisions of all robots since the start or the last reset, in order of time."""
        collisions = (collision for log in self._collisions.values() for collision in log.collisions)
        return sorted(collisions, key=lambda collision: collision.time)

    def command(self, robot: str, linear: float, angular: float, lateral: float = 0.0) -> None:
        """Publishes a velocity command, m/s and rad/s, which takes effect with the next step; ``lateral`` is to the left."""
        topic = f"{self._robots[robot]}{names.CMD_VEL}"
        publisher = self._publisher(topic, TwistStamped if self._stamped else Twist)
        message = TwistStamped() if self._stamped else Twist()
        twist = message.twist if self._stamped else message
        if self._stamped:
            message.header.stamp = conversions.time_to_msg(self._now_ns)
        twist.linear.x, twist.linear.y, twist.angular.z = float(linear), float(lateral), float(angular)
        publisher.publish(message)
        self._sent.append(publisher.topic_name)

    def send_goal(self, topic: str, x: float, y: float, yaw: float, timeout_s: float) -> None:
        """Publishes a goal pose in the map frame, m and rad, once the topic has a subscriber; time passes meanwhile."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(PoseStamped, topic, 10)
        publisher = self._publishers[topic]
        self.run_until(lambda: publisher.get_subscription_count() > 0, timeout_s, f"a subscriber of {topic}")
        message = PoseStamped(pose=flat_pose(x, y, 0.0, yaw))
        message.header.frame_id, message.header.stamp = WORLD_FRAME, conversions.time_to_msg(self._now_ns)
        publisher.publish(message)

    def _publisher(self, topic: str, kind: Any) -> Any:
        if topic not in self._publishers:
            publisher = self.node.create_publisher(kind, topic, qos.COMMAND)
            try:
                self._spin_until(DISCOVERY_S, lambda: publisher.get_subscription_count() > 0, f"a subscriber of {topic}")
            except GibsonSimError:
                self.node.destroy_publisher(publisher)
                raise
            self._publishers[topic] = publisher
        return self._publishers[topic]

    def floor(self) -> Any:
        """Returns the nav_msgs/OccupancyGrid of the simulation.

        Raises:
            GibsonSimError: the simulation publishes none.
        """
        self._spin_until(DISCOVERY_S, lambda: self._map is not None, "the floor map on the topic map")
        return self._map

    # Messages

    def _on_digest(self, msg: TickDigest) -> None:
        if f"/{names.SCENE_STATE}" in msg.topics:  # the digest of the physics node, not of a renderer
            self._events += 1
            self._ticks.append(_Tick(_stamp_ns(msg), int(msg.epoch), frozenset(msg.topics)))

    def _on_truth(self, robot: str, msg: Odometry) -> None:
        self._truth[robot] = msg.pose.pose
        self._moved.discard(robot)

    def _on_contacts(self, msg: Contacts) -> None:
        self._contacts = msg

    def _on_collisions(self, robot: str, msg: CollisionCount) -> None:
        self._counts[robot] = msg

    def _log_collisions(self) -> None:
        """Adds the collision counts of a tick to the logs, once its contact points have arrived as well."""
        points = self._contacts.contacts if self._contacts is not None else ()
        for robot, msg in self._counts.items():
            touching = [(p.link_a, p.body_b) for p in points if p.body_a == robot]
            touching += [(p.link_b, p.body_a) for p in points if p.body_b == robot]
            self._collisions[robot].add(_stamp_ns(msg) / NS_PER_S, int(msg.count), (msg.last_link, msg.last_body), touching)
        self._counts.clear()

    def _on_map(self, msg: OccupancyGrid) -> None:
        if self._map is None:  # the first map is the simulation's; a map server or SLAM may publish others
            self._map = msg


def robot_pose(pose: Any) -> RobotPose:
    """Returns a geometry_msgs/Pose as a ``RobotPose``."""
    q = pose.orientation
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return RobotPose(pose.position.x, pose.position.y, pose.position.z, yaw)


def _stamp_ns(msg: Any) -> int:
    return int(conversions.time_from_msg(msg.header.stamp))


def _message_class(name: str) -> Any:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # from the parser that generated messages import
            return message_class(name)
    except UNKNOWN as error:
        raise GibsonSimError(f"the message type {name} is not installed in this environment") from error
