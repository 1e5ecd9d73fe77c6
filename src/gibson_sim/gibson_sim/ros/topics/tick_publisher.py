"""Publishes the data that is due at a step or tick: immediately, or, pipelined, when all participants have finished the previous tick."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

from geometry_msgs.msg import TwistStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMsg

from gibson_msgs.msg import Contacts
from gibson_sim.config import PhysicsConfig
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.ros import conversions
from gibson_sim.ros.lockstep.digest_publisher import DigestPublisher
from gibson_sim.ros.lockstep.image_gate import ImageGate
from gibson_sim.ros.lockstep.lockstep_gate import LockstepGate
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.object_joints import ObjectJoints
from gibson_sim.ros.topics.robot_interface import RobotInterface, RobotTick
from gibson_sim.ros.topics.world_interface import WorldInterface
from gibson_sim.ros.wire.fast_publish import FastClock
from gibson_sim.sensors.schedule import is_due
from gibson_sim.sensors.suite import Measurements
from gibson_sim.standard.lockstep import CAMERAS
from gibson_sim.standard.simulator import Simulator
from gibson_sim.standard.states import SimulationState
from gibson_sim.types import CameraSpec, SceneState

_Measured = Mapping[str, Measurements]
"""Robot -> its measurements."""


class TickPublisher:
    """Publishes the data that is due at the steps of a world.

    Publishes:
        /clock (rosgraph_msgs/Clock) at ``clock_hz``, and at every other step at which a message is published.
        The topics of ``WorldInterface``, ``ObjectJoints``, ``ContactsPublisher`` and, for each robot, ``RobotInterface``.
    """

    def __init__(
        self,
        node: Node,
        config: PhysicsConfig,
        simulator: Simulator,
        robots: Mapping[str, RobotInterface],
        world_topics: WorldInterface,
        objects: ObjectJoints,
        digests: DigestPublisher | None,
        gate: LockstepGate | None,
        images: ImageGate | None,
    ) -> None:
        """Creates the publisher of /clock.

        Args:
            node: the physics node.
            config: settings of the node.
            simulator: simulator of the world.
            robots: robot -> its topics; it may change, and is read at every step.
            world_topics: topics of the world.
            objects: joints of bodies.
            digests: publisher of digests; None = none are published.
            gate: gate to close at every tick; None = no lockstep.
            images: gate to close at every tick with due cameras; None = no such gate.
        """
        self._time, self._simulator, self._robots, self._world_topics = config.time, simulator, robots, world_topics
        self._digests, self._gate, self._images = digests, gate, images
        self._objects, self._contacts = objects, ContactsPublisher(node, config.topics.contacts_rate, config.time.publish_hz)
        self._clock_message = FastClock()
        self._clock_pub = node.create_publisher(ClockMsg, names.CLOCK, **qos.overridable(qos.CLOCK))
        self._clock_ns = 0
        """Stamp of the last /clock, ns."""
        self._held: list[tuple[_Step, _Measured]] = []
        self._last_measured: _Measured = {}
        self._last_ticks: dict[RobotInterface, RobotTick] = {}
        """What each robot published at the last tick."""

    def publish_clock(self, stamp_ns: int) -> None:
        """Publishes /clock."""
        self._clock_ns = stamp_ns
        if self._clock_pub.get_subscription_count():
            self._clock_pub.publish(self._clock_message.serialize(stamp_ns))

    def update_clock(self, stamp_ns: int) -> None:
        """Publishes /clock unless its last message has this stamp, at the end of a run or after time was reset."""
        if stamp_ns != self._clock_ns:
            self.publish_clock(stamp_ns)

    def publish(self, world: PhysicsWorld) -> None:
        """Publishes the data that is due at the present step of the world."""
        step = self._step(world)
        # Inputs of controllers and renderers first, so that they work while the rest is measured and serialized.
        state = None if step.tick is None else self._begin_tick(world, step.tick)
        self._publish_rest(step, self._measure(world), state)

    def hold(self, world: PhysicsWorld) -> None:
        """Takes the measurements that are due at the present step, and keeps them for ``release``."""
        self._held.append((self._step(world), self._measure(world)))

    @property
    def holds_tick(self) -> bool:
        """Whether a held tick is not published yet."""
        return bool(self._held) and self._held[-1][0].tick is not None

    def release(self, world: PhysicsWorld) -> None:
        """Publishes all held steps in order; the world must be at the last one."""
        held, self._held = self._held, []
        for step, measured in held:
            self._publish_rest(step, measured, None if step.tick is None else self._begin_tick(world, step.tick))

    def discard_held(self) -> None:
        """Drops all held steps: the simulation was reset, or its world replaced."""
        self._held.clear()

    def publish_again(self, whole_tick: bool) -> None:
        """Republishes the scene state, or the whole present tick."""
        if whole_tick:
            for name, measured in self._last_measured.items():
                if (robot := self._robots.get(name)) is not None:
                    if (robot_tick := self._last_ticks.get(robot)) is not None:
                        robot_tick.publish_again()
                    robot.publish_sensors(measured)
        self._world_topics.publish_state_again()

    def _step(self, world: PhysicsWorld) -> _Step:
        step, time = world.step_count, self._time
        tick, remainder = divmod(step, time.steps_per_tick)
        requested = self._simulator.state is not SimulationState.PLAYING
        has_clock = requested or is_due(step, time.clock_hz, time.step_hz)
        applied = {name: commands for name, robot in self._robots.items() if (commands := robot.pop_applied())}
        return _Step(world.stamp_ns, None if remainder else tick, has_clock, applied)

    def _measure(self, world: PhysicsWorld) -> _Measured:
        return {name: robot.measure(world, all_sensors=self._digests is not None) for name, robot in self._robots.items()}

    def _begin_tick(self, world: PhysicsWorld, tick: int) -> tuple[SceneState, tuple[CameraSpec, ...]]:
        """Publishes the clock, the states and the odometry of a tick; returns the scene state and the cameras that are due."""
        simulator = self._simulator
        self.publish_clock(world.stamp_ns)
        due = self._world_topics.due(tick)
        # Odometry and transforms first, since controllers need them: a small image follows within a millisecond of the scene state.
        ticks = self._last_ticks = {robot: robot.begin_tick(world) for robot in self._robots.values()}
        # All links are read once, here; the sensors that are due at this step use the same state.
        state = world.state()
        for robot_tick in ticks.values():
            robot_tick.publish_transforms(state)
        self._world_topics.publish_state(state, due, simulator.epoch, simulator.epoch_step)
        for robot_tick in ticks.values():
            robot_tick.publish_states(state, self._digests)
        self._objects.publish(world, tick)
        self._contacts.publish(world, tick)
        if self._images is not None:
            self._images.begin_tick(world.stamp_ns, self._world_topics.cameras, due)
        return state, tuple(self._world_topics.cameras[i] for i in due)

    def _publish_rest(self, step: _Step, measured: _Measured, begun: tuple[SceneState, tuple[CameraSpec, ...]] | None) -> None:
        if begun is None and (step.has_clock or step.applied or any(measured.values())):
            self.publish_clock(step.stamp_ns)
        for name, commands in step.applied.items():
            if name in self._robots:
                self._robots[name].publish_applied(commands)
        for name, measurements in measured.items():
            if measurements and name in self._robots:
                self._robots[name].publish_sensors(measurements, self._digests)
        if begun is not None:
            self._end_tick(*begun, measured)

    def _end_tick(self, state: SceneState, due: tuple[CameraSpec, ...], measured: _Measured) -> None:
        """Publishes the digests. In lockstep, time then waits for the participants."""
        if self._digests is not None:
            self._digests.add(names.SCENE_STATE, state.links, state.positions, state.quats_xyzw, state.twists)
            self._digests.publish(state.stamp_ns, self._simulator.epoch, self._simulator.epoch_step)
        self._last_measured = measured
        if self._gate is not None:
            self._gate.begin_tick(state.stamp_ns, partial(self._topics_of_tick, due, measured))

    def _topics_of_tick(self, due: tuple[CameraSpec, ...], measured: _Measured) -> set[str]:
        """Returns all topics that are published at a tick, including images, without leading slashes."""
        topics = {names.SCENE_STATE, CAMERAS} if due else {names.SCENE_STATE}
        for camera in due:
            camera_topics = names.camera_topics(camera.name)
            topics.update(camera_topics[output] for output in camera.outputs)
        for name, measurements in measured.items():
            topics |= self._robots[name].topics_of_tick(measurements) if name in self._robots else set()
        return topics


class _Step(NamedTuple):
    """An executed step."""

    stamp_ns: int
    tick: int | None
    """Number of the tick at this step; None = the step is not a tick."""
    has_clock: bool
    """Whether /clock is published at it even if no other message is."""
    applied: Mapping[str, Sequence[TwistStamped]]
    """Robot -> velocity commands applied at this step; only robots that have any."""


class ContactsPublisher:
    """Publishes all contact points of the simulation.

    Publishes, while it has subscribers:
        contacts (gibson_msgs/Contacts) at ``contacts_rate``.
    """

    def __init__(self, node: Node, rate_hz: float, publish_hz: int) -> None:
        self._rate_hz, self._publish_hz = min(rate_hz, publish_hz), publish_hz
        self._publisher = node.create_publisher(Contacts, names.CONTACTS, **qos.overridable(qos.STATE))

    def publish(self, world: PhysicsWorld, tick: int) -> None:
        """Publishes the contacts of the last step if they are due at ``tick``, which counts at ``publish_hz``."""
        if self._publisher.get_subscription_count() and is_due(tick, self._rate_hz, self._publish_hz):
            self._publisher.publish(conversions.contacts_to_msg(world.contacts(), world.stamp_ns))
