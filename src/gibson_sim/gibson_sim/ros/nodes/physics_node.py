"""The physics node: owns simulation time and the scene."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.timer import Timer

from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import ConfigError
from gibson_sim.maps.placement import populate
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.processes.job_folder import LOADED, PAGE, READY, note_in_job, note_of_job
from gibson_sim.resources import find_config
from gibson_sim.ros.lockstep.digest_publisher import DigestPublisher
from gibson_sim.ros.lockstep.image_gate import ImageGate
from gibson_sim.ros.lockstep.journal import Journal
from gibson_sim.ros.lockstep.lockstep_gate import LockstepGate
from gibson_sim.ros.lockstep.pacing import Pacer
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node, write_summary
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.nodes.physics_stats import PhysicsStats, loaded_note
from gibson_sim.ros.nodes.single_simulation_guard import SingleSimulationGuard
from gibson_sim.ros.services.simulation_services import SimulationServices
from gibson_sim.ros.topics import names
from gibson_sim.ros.topics.discovery import wait_for_peers, wait_until_acknowledged
from gibson_sim.ros.topics.incompatible_publishers import IncompatiblePublishers
from gibson_sim.ros.topics.object_joints import ObjectJoints
from gibson_sim.ros.topics.robot_interface import RobotInterface
from gibson_sim.ros.topics.run_info import publish_run_info
from gibson_sim.ros.topics.stamped_commands import StampedCommands
from gibson_sim.ros.topics.tick_publisher import TickPublisher
from gibson_sim.ros.topics.world_interface import WorldInterface
from gibson_sim.scenes.randomise import load_rules
from gibson_sim.standard.simulator import Simulator
from gibson_sim.standard.states import SimulationState
from gibson_sim.types import NS_PER_S

_LOCKSTEP_TICKS_AT_ONCE = 64
"""Maximum number of ticks without a pending participant in one iteration of the loop."""


class PhysicsNode(Node):
    """Steps the world and publishes all data of a step with one stamp.

    Parameters: the fields of ``gibson_sim.config.PhysicsConfig``; ``rate`` may be changed at run time.

    Publishes:
        real_time_factor (std_msgs/Float64): simulation time over wall time, once a second of wall time.
        /diagnostics (diagnostic_msgs/DiagnosticArray): the statistics of ``PhysicsStats``, once a second of wall time.
        run_info (gibson_msgs/RunInfo, latched): settings and environment.
        tick_digest (gibson_msgs/TickDigest), with ``digests``: digests of all data of a tick.
        The topics of ``TickPublisher`` and ``Journal``.

    Subscribes, with ``lockstep``, to the topics of ``LockstepGate``; with ``rate`` 0, to those of ``ImageGate``.

    Services: those of ``SimulationServices``, the standard simulation_interfaces.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Loads the scene. ``kwargs`` go to ``rclpy.node.Node`` (``parameter_overrides`` in tests).

        Raises:
            GibsonSimError: a setting, the scene or a robot cannot be used, or another simulation runs in this domain.
        """
        super().__init__("physics", **kwargs)
        self._guard: SingleSimulationGuard | None = None
        self._simulator: Simulator | None = None
        self._stamped: StampedCommands | None = None
        self._sim_services: SimulationServices | None = None
        self._config = config = config_from_parameters(self, PhysicsConfig, changeable=("rate",))
        self.add_on_set_parameters_callback(self._on_parameters)
        world = config.world
        scene = populate(world.scene, world.robot, world.start, sdf_lamps=world.sdf_lamps, robot_tf=world.robot_tf)
        rules = load_rules(find_config(world.randomise, "randomisation")) if world.randomise else None
        self._guard = SingleSimulationGuard(self)
        self._guard.acquire()
        self._simulator = Simulator(scene, config)
        ticks_at_once = _LOCKSTEP_TICKS_AT_ONCE if config.sync.lockstep else 1
        self._pacer = Pacer(config.time.step_hz, config.time.rate, burst=ticks_at_once * config.time.steps_per_tick)
        self._stamped = StampedCommands(self) if config.commands.cmd_vel_type == "both" else None
        self._incompatible = IncompatiblePublishers(self, self._stamped)
        self._journal = Journal(self, self._simulator, self._on_command_received)
        self._digests = DigestPublisher(self) if config.topics.digests else None
        self._world_topics = WorldInterface(self, config, rules)
        self._robots: dict[str, RobotInterface] = {}
        self._objects = ObjectJoints(self, config.time.publish_hz, self._on_command_received)
        self._gate: LockstepGate | None = None
        self._images: ImageGate | None = None
        if config.sync.lockstep:
            self._gate = LockstepGate(self, config.sync, self._on_gate_open, self._publish_again, self._is_command)
        elif config.sync.image_timeout:
            self._images = ImageGate(self, config.sync.image_timeout, self._on_gate_open, self._publish_again)
        self._ticks = TickPublisher(
            self,
            config,
            self._simulator,
            self._robots,
            self._world_topics,
            self._objects,
            self._digests,
            self._gate,
            self._images,
        )
        if self._images is not None:
            self._images.enable(config.time.rate == 0.0)
        self._stats = PhysicsStats(self, config.time.step_hz, self._simulator, self._pacer, self._journal, self._gate)
        self._published: tuple[PhysicsWorld | None, int] = (None, -1)
        """World and scene revision that were published last."""
        self._published_epoch = -1
        self._timer: Timer | None = None
        self._done = self._announced = False
        self._publish_changes()
        if self._gate is not None:
            self._gate.subscribe(self._stamped)
        # After all other subscriptions, as run_info after all other publishers: DDS announces either in the order of their creation, so
        # that a program which discovers both knows the whole node.
        self._sim_services = SimulationServices(
            self, self.simulator, config.topics.service_prefix, self._journal, config.sync.lockstep
        )
        note_in_job(LOADED, loaded_note(self.simulator.scene, self._world_topics.cameras))
        spec = self.simulator.scene
        self._run_info = publish_run_info(self, "physics", config, self._stamp_ns, scene_digest=spec.content_hash)
        starts = ", ".join(f"{r.name} at x {r.start.position[0]:.2f} m, y {r.start.position[1]:.2f} m" for r in spec.robots)
        self.get_logger().info(f"scene {spec.name} is ready: {starts or 'no robot'}")

    @property
    def simulator(self) -> Simulator:
        """Simulator of the world; available until ``close``."""
        assert self._simulator is not None, "the node is closed"
        return self._simulator

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Applies a change of ``rate`` at run time."""
        for parameter in parameters:
            if parameter.name == "rate":
                try:
                    self._config = replace(self._config, time=replace(self._config.time, rate=parameter.value))
                except ConfigError as error:
                    return SetParametersResult(successful=False, reason=str(error))
                self._pacer.set_rate(self._config.time.rate)
                if self._images is not None:
                    self._images.enable(self._config.time.rate == 0.0)
                self._set_timer()
                request = SetParameters.Request(parameters=[parameter.to_parameter_msg()])
                self._journal.entry(self.resolve_service_name("~/set_parameters"), request, timing_only=True)()
        return SetParametersResult(successful=True)

    # Changes of the scene

    def _publish_changes(self) -> None:
        """Publishes all changes since the last call: resets, added and removed robots, the scene."""
        simulator = self.simulator
        world, revision = simulator.world, simulator.scene.revision
        if self._published != (world, revision):
            self._publish_scene(world, new=self._published[0] is not world)
            self._published = (world, revision)
        if simulator.epoch != self._published_epoch:
            self._published_epoch = simulator.epoch
            self._begin_epoch()

    def _publish_scene(self, world: PhysicsWorld | None, *, new: bool) -> None:
        """Creates the topics of added robots, destroys those of removed robots, and publishes the scene."""
        if new:
            self._ticks.discard_held()
        kept = set() if world is None or new else {robot.name for robot in world.scene.robots}
        for name in [name for name in self._robots if name not in kept]:
            robot_topics = self._robots.pop(name)
            self._stats.remove_robot(robot_topics)
            robot_topics.close()
        if world is None:
            self._world_topics.withdraw_maps()
            return
        self._stats.begin_scene(world.scene.name)
        for robot in world.scene.robots:
            if robot.name not in self._robots:
                self._robots[robot.name] = RobotInterface(
                    self, self._stamped, robot, world, self._config, self._on_command_received
                )
                self._robots[robot.name].reset(world.step_count)
        self._world_topics.publish_scene(world)
        self._objects.publish(world)
        if self._gate is not None:
            self._gate.discover()  # before the map, which takes a while: discovery continues meanwhile
        if new:
            self._world_topics.publish_map(world)

    def _begin_epoch(self) -> None:
        """Discards the state of the previous epoch, and publishes the reset."""
        simulator = self.simulator
        world = simulator.world
        self._pacer.restart()
        self._ticks.discard_held()
        if self._gate is not None:
            self._gate.reset()
        if self._images is not None:
            self._images.reset()
        if self._digests is not None:
            self._digests.clear()
        steps, stamp_ns = (world.step_count, world.stamp_ns) if world is not None else (0, 0)
        for robot in self._robots.values():
            robot.reset(steps)
        self._objects.reset()
        reset = simulator.last_reset
        self._world_topics.publish_epoch(simulator.epoch, stamp_ns, reset.scope, rewound=reset.rewound)
        if reset.rewound:
            self._ticks.update_clock(stamp_ns)
        self._stats.restart(stamp_ns)

    # Time

    def spin(self, *others: Node) -> int:
        """Steps the simulation until the context ends, ``duration`` has passed or a client ends it; returns the exit code.

        Args:
            others: other nodes to spin in the same executor.

        Raises:
            LockstepError: a participant has timed out, and ``on_timeout`` is stop.
        """
        executor = make_executor()
        for node in (self, *others):
            executor.add_node(node)
        if self._stamped is not None:
            self._stamped.start(executor)
        self._wait_for_subscribers(executor)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._set_timer()
        self.create_timer(1.0, self._report, clock=steady)
        assert self._guard is not None, "it was acquired in the constructor"
        self._guard.watch()
        self.create_timer(1.0, self._world_topics.update_map, clock=steady)
        self.create_timer(1.0, self._incompatible.check, clock=steady)
        self._stats.restart(self._stamp_ns)
        while is_running() and not self._done:
            executor.spin_once(timeout_sec=0.5)
            if self._images is not None and not self._images.is_open:
                self._iterate()  # the timer is off, which leaves the CPU to renderers; the timeout may have passed
            if self._gate is not None:
                if self._gate.failure is not None:
                    raise self._gate.failure
                if self._gate.core.is_open and not self._config.time.rate:
                    self._iterate()  # a request may have started time
        self._end_last_tick(executor)
        return 0

    def _end_last_tick(self, executor: Executor) -> None:
        """Publishes the last /clock; waits until participants have finished the last tick, and subscribers have acknowledged it."""
        self._ticks.update_clock(self._stamp_ns)
        gate = self._gate
        while gate is not None and gate.core.stamp_ns is not None and not gate.may_step():
            if gate.failure is not None:
                raise gate.failure
            if self.simulator.quitting or not is_running():
                break
            executor.spin_once(timeout_sec=0.1)
        while self._images is not None and not self._images.may_step() and is_running() and not self.simulator.quitting:
            executor.spin_once(timeout_sec=0.1)
        wait_until_acknowledged(*self.publishers)

    def _set_timer(self) -> None:
        """Sets the timer of the loop for the present rate."""
        if self._timer is not None:
            self.destroy_timer(self._timer)
        rate = self._config.time.rate
        period = min(1.0 / (self._config.time.clock_hz * rate), 0.01) if rate else 1e-5
        if self._gate is not None and not rate:
            period = 0.02  # the gate wakes the loop when it opens; a shorter period would take CPU time from the participants
        self._timer = self.create_timer(period, self._iterate, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _iterate(self) -> None:
        """Executes the steps that are due now, as far as the gates allow."""
        if self._done:
            return
        simulator, now_ns, gate, images = self.simulator, time.monotonic_ns(), self._gate, self._images
        if not self._announced and (gate is None or not gate.core.missing):
            self._announced = True
            note_in_job(READY, "")
        if (gate is None or gate.may_step()) and (images is None or images.may_step()):
            # Not while a tick waits: a renderer that already has the next scene could not draw the tick.
            self._publish_changes()
            self._apply_scheduled()
            due = simulator.steps_due(self._pacer.due(now_ns))
            remaining = self._execute_pipelined(now_ns, due) if self._config.sync.pipelined else self._execute_steps(now_ns, due)
            if remaining and simulator.state is SimulationState.PLAYING:
                self._pacer.return_unused(remaining)
        if images is not None and self._timer is not None and images.is_open == self._timer.is_canceled():
            (self._timer.reset if images.is_open else self._timer.cancel)()
        self._done = self._done or (self._sim_services is not None and self._sim_services.quit_is_answered)

    def _execute_steps(self, now_ns: int, remaining: int) -> int:
        """Executes steps and publishes their data, until a gate closes; returns the number of steps that remain."""
        while remaining and not self._done:
            self._latch_commands()
            self._step(now_ns)
            world = self.simulator.world
            assert world is not None
            self._ticks.publish(world)
            self._end_step(world.stamp_ns)
            remaining -= 1
            if (self._gate is not None and not self._gate.core.is_open) or (
                self._images is not None and not self._images.is_open
            ):
                break
            if self._apply_scheduled():
                break
        return remaining

    def _execute_pipelined(self, now_ns: int, remaining: int) -> int:
        """Publishes the held tick and executes the next one, while participants process the published one.

        Commands that answer a tick are therefore applied not in the next tick, which was executed already, but in the one after it. Returns
        the number of steps that remain.
        """
        gate, world = self._gate, self.simulator.world
        assert gate is not None, "the settings allow pipelining only in lockstep"
        while world is not None and not self._done:
            if self._ticks.holds_tick:
                if not gate.core.is_open:
                    break
                # Before the tick is published: answers to it are for a later tick.
                self._latch_commands()
                self._ticks.release(world)
                self._end_step(world.stamp_ns)
            if not remaining or self._done:
                break
            while remaining and not self._ticks.holds_tick:
                self._step(now_ns)
                self._ticks.hold(world)
                remaining -= 1
        return remaining

    def _on_gate_open(self) -> None:
        """Executes the next tick now, without waiting for the timer."""
        if self._timer is not None and not self._done:
            self._iterate()

    def _publish_again(self, whole_tick: bool) -> None:
        """Republishes the scene state, or the whole present tick, for a node that a gate waits for."""
        self._ticks.publish_again(whole_tick)

    def _on_command_received(self, topic: str) -> None:
        """Reports the arrival of a command to the lockstep gate, which may wait for it."""
        if self._gate is not None:
            self._gate.receive_command(topic)

    @property
    def _receivers(self) -> tuple[RobotInterface | ObjectJoints, ...]:
        return (*self._robots.values(), self._objects)

    def _is_command(self, topic: str) -> bool:
        return any(topic in receiver.command_topics for receiver in self._receivers)

    def _apply_scheduled(self) -> bool:
        """Applies the inputs scheduled for the next step. In lockstep it is called once a tick is done: only then have all arrived.

        Returns:
            Whether any of them was a request: it may have stopped time or unloaded the world, so that no more steps are due.
        """
        requested = False
        while scheduled := self._journal.pop_due():
            for name, message in scheduled:
                receiver = next((candidate for candidate in self._receivers if name in candidate.command_topics), None)
                try:
                    if receiver is not None:
                        receiver.receive_command(name, message)
                    elif self._sim_services is not None:
                        requested = True
                        self._sim_services.replay(name, message)
                except ConfigError as error:
                    self.get_logger().warning(f"a scheduled input is ignored: {error}")
            self._publish_changes()
        return requested

    def _latch_commands(self) -> None:
        for robot in self._robots.values():
            robot.latch_commands()
        self._objects.latch_commands()

    def _step(self, now_ns: int) -> None:
        """Executes one step."""
        world = self.simulator.world
        assert world is not None, "steps are due only with a world"
        self._stats.begin_step(now_ns, world.stamp_ns)
        for robot in self._robots.values():
            robot.apply_commands(world, self._journal)
        self._objects.apply_commands(world, self._journal)
        self.simulator.step()

    def _end_step(self, stamp_ns: int) -> None:
        """Counts a published step, and ends the run once ``duration`` has passed."""
        self._stats.end_step(stamp_ns)
        self._done = bool(self._config.time.duration) and stamp_ns >= self._config.time.duration * NS_PER_S

    @property
    def _stamp_ns(self) -> int:
        world = self.simulator.world
        return 0 if world is None else world.stamp_ns

    def _wait_for_subscribers(self, executor: Executor) -> None:
        """Waits until the nodes of ``wait_for`` are matched, so that none misses the start."""
        subscribers, cameras = dict(self._config.sync.required_subscribers), self._world_topics.cameras
        images = [names.camera_topics(camera.name)[output] for camera in cameras for output in camera.outputs]
        subscribers.update(dict.fromkeys(images, subscribers.pop("cameras", 0)))
        page = subscribers.pop("page", 0)
        subscribers.update(dict.fromkeys((robot.truth_topic for robot in self._robots.values()), subscribers.pop("robots", 0)))
        count = subscribers.pop("commands", 0)
        conditions: dict[str, Callable[[], bool]] = {
            f"publishers of {robot.robot.name}'s cmd_vel ({count})": partial(robot.has_commanders, count)
            for robot in self._robots.values()
        }
        if page:
            conditions["the live page"] = lambda: note_of_job(PAGE) is not None
        wait_for_peers(self, executor, subscribers, conditions, *(() if self._gate is None else (self._gate.discover,)))

    def _report(self) -> None:
        self._stats.publish(self._stamp_ns, self._config.time.rate, self._robots.values())

    def close(self) -> None:
        """Writes the summary and frees the world."""
        if self._sim_services is not None:
            self._sim_services.close()
            self._sim_services = None
        if self._stamped is not None:
            self._stamped.close()
            self._stamped = None
        if self._simulator is not None:
            write_summary(self._config.topics.summary_path, self._stats.summary(self._robots.values()))
            self._simulator.close()
            self._simulator = None
        if self._guard is not None:
            self._guard.close()


def main(args: list[str] | None = None) -> None:
    """Runs the physics node."""
    run_node(PhysicsNode, args)


if __name__ == "__main__":
    main()
