"""The physics node: owner of time and of the scene."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.timer import Timer

from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import ConfigError
from gibson_sim.maps.placement import populate
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.resources import find_config
from gibson_sim.ros.lockstep.digest_publisher import DigestPublisher
from gibson_sim.ros.lockstep.image_gate import ImageGate
from gibson_sim.ros.lockstep.journal import Journal
from gibson_sim.ros.lockstep.lockstep_gate import LockstepGate
from gibson_sim.ros.lockstep.pacing import Pacer
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node, write_summary
from gibson_sim.ros.nodes.only_simulation import OnlySimulation
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.nodes.physics_stats import PhysicsStats
from gibson_sim.ros.services.simulation_services import SimulationServices
from gibson_sim.ros.topics import names
from gibson_sim.ros.topics.matching import wait_for_others, wait_until_received
from gibson_sim.ros.topics.robot_interface import RobotInterface
from gibson_sim.ros.topics.run_info import publish_run_info
from gibson_sim.ros.topics.stamped_commands import StampedCommands
from gibson_sim.ros.topics.tick_publisher import TickPublisher
from gibson_sim.ros.topics.unreceived import UnreceivedPublishers
from gibson_sim.ros.topics.world_interface import WorldInterface
from gibson_sim.scenes.randomise import load_rules
from gibson_sim.standard.job_folder import LOADED, note_in_job
from gibson_sim.standard.simulator import Simulator
from gibson_sim.standard.states import SimulationState
from gibson_sim.types import NS_PER_S

_MOST_TICKS_OF_LOCKSTEP = 64
"""Ticks that nobody answers to, made in one turn."""


class PhysicsNode(Node):
    """Steps the world and publishes all of a step with one stamp.

    Parameters: the fields of ``gibson_sim.config.PhysicsConfig``; ``rate`` may be changed while it runs.

    Publishes:
        real_time_factor (std_msgs/Float64): simulation time over wall time, once a second of wall time.
        /diagnostics (diagnostic_msgs/DiagnosticArray): what ``PhysicsStats`` knows, once a second of wall time.
        run_info (gibson_msgs/RunInfo, latched): settings and surroundings.
        tick_digest (gibson_msgs/TickDigest), with ``digests``: numbers of all that a tick holds.
        And what ``TickPublisher`` and ``Journal`` list.

    Subscribes, with ``lockstep``, to what ``LockstepGate`` lists; with ``rate`` 0, to what ``ImageGate`` lists.

    Services: those of ``SimulationServices``, the standard simulation_interfaces.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Loads the scene. ``kwargs`` go to ``rclpy.node.Node`` (``parameter_overrides`` in tests).

        Raises:
            GibsonSimError: a setting, the scene or a robot cannot be used, or another simulation runs in this domain.
        """
        super().__init__("physics", **kwargs)
        self._alone: OnlySimulation | None = None
        self._simulator: Simulator | None = None
        self._stamped: StampedCommands | None = None
        self._standard: SimulationServices | None = None
        self._config = config = config_from_parameters(self, PhysicsConfig, changeable=("rate",))
        self.add_on_set_parameters_callback(self._on_parameters)
        scene = populate(config.scene, config.robot, config.start, sdf_lamps=config.sdf_lamps, robot_tf=config.robot_tf)
        rules = load_rules(find_config(config.randomise, "randomisation")) if config.randomise else None
        self._alone = OnlySimulation(self)
        self._alone.claim()
        self._simulator = Simulator(scene, config)
        ticks_at_once = _MOST_TICKS_OF_LOCKSTEP if config.lockstep else 1
        self._pacer = Pacer(config.step_hz, config.rate, burst=ticks_at_once * config.step_hz // config.publish_hz)
        self._stamped = StampedCommands(self) if config.cmd_vel_type == "both" else None
        self._unreceived = UnreceivedPublishers(self, self._stamped)
        self._journal = Journal(self, self._simulator, self._on_input)
        self._digests = DigestPublisher(self) if config.digests else None
        self._world_topics = WorldInterface(self, config, rules)
        self._robots: dict[str, RobotInterface] = {}
        self._ticks = TickPublisher(self, config, self._simulator, self._robots, self._world_topics, self._digests)
        self._gate: LockstepGate | None = None
        if config.lockstep:
            self._ticks.gate = self._gate = LockstepGate(self, config, self._on_tick_done, self._ticks.publish_again)
        self._images: ImageGate | None = None
        if config.image_timeout and not config.lockstep:
            self._ticks.images = self._images = ImageGate(
                self, config.image_timeout, self._on_tick_done, self._ticks.publish_again
            )
            self._images.switch(config.rate == 0.0)
        self._stats = PhysicsStats(self, config, self._simulator, self._pacer, self._journal, self._gate)
        self._seen: tuple[PhysicsWorld | None, int] = (None, -1)
        self._seen_epoch = -1
        self._timer: Timer | None = None
        self._done = False
        self._standard = SimulationServices(self, self.simulator, config.service_prefix, self._journal.note, config.lockstep)
        self._follow_changes()
        if self._gate is not None:
            self._gate.listen(self._stamped)
        note_in_job(LOADED, "\n".join(camera.name for camera in self._world_topics.cameras))
        spec = self.simulator.scene
        self._run_info = publish_run_info(self, "physics", config, self._stamp_ns, scene_digest=spec.content_hash)
        places = "; ".join(f"{r.name} at {r.start.position[0]:.2f},{r.start.position[1]:.2f}" for r in spec.robots)
        self.get_logger().info(
            f"scene {spec.name}: {len(spec.visuals)} visuals, {len(spec.collisions)} collision shapes; {places or 'no robot'}"
        )

    @property
    def simulator(self) -> Simulator:
        """World and state; it is there from the end of the constructor to ``close``."""
        assert self._simulator is not None, "the node is closed"
        return self._simulator

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Takes another pace while the simulation runs."""
        for parameter in parameters:
            if parameter.name == "rate":
                try:
                    self._config = replace(self._config, rate=parameter.value)
                except ConfigError as error:
                    return SetParametersResult(successful=False, reason=str(error))
                self._pacer.set_rate(self._config.rate)
                if self._images is not None:
                    self._images.switch(self._config.rate == 0.0)
                self._set_timer()
        return SetParametersResult(successful=True)

    # What changed

    def _follow_changes(self) -> None:
        """Publishes what changed since the last look: resets, robots that came or went, the scene."""
        simulator = self.simulator
        world, revision = simulator.world, simulator.scene.revision
        if self._seen != (world, revision):
            self._enter(world, new=self._seen[0] is not world)
            self._seen = (world, revision)
        if simulator.epoch != self._seen_epoch:
            self._seen_epoch = simulator.epoch
            self._begin_epoch()

    def _enter(self, world: PhysicsWorld | None, *, new: bool) -> None:
        """Gives every robot its topics, takes back those of robots that are gone, and publishes the scene."""
        if new:
            self._ticks.forget()
        kept = set() if world is None or new else {robot.name for robot in world.scene.robots}
        for name in [name for name in self._robots if name not in kept]:
            self._robots.pop(name).close()
        if world is None:
            return
        for robot in world.scene.robots:
            if robot.name not in self._robots:
                self._robots[robot.name] = RobotInterface(self, self._stamped, robot, world, self._config, self._on_input)
                self._robots[robot.name].reset(world.step_count)
        self._world_topics.publish_scene(world)
        if new:
            self._world_topics.publish_map(world)

    def _begin_epoch(self) -> None:
        """Forgets what belongs to the time before a reset, and says so to everybody."""
        simulator = self.simulator
        world = simulator.world
        self._pacer.restart()
        self._ticks.forget()
        if self._gate is not None:
            self._gate.restart()
        if self._images is not None:
            self._images.restart()
        if self._digests is not None:
            self._digests.forget()
        steps, stamp_ns = (world.step_count, world.stamp_ns) if world is not None else (0, 0)
        for robot in self._robots.values():
            robot.reset(steps)
        reset = simulator.last_reset
        self._world_topics.publish_epoch(simulator.epoch, stamp_ns, reset.scope, rewound=reset.rewound)
        if reset.rewound:
            self._ticks.publish_clock(stamp_ns)
        self._stats.restart(stamp_ns)

    # Time

    def spin(self, *beside: Node) -> int:
        """Makes time until the context ends, ``duration`` has passed or a client ends it; returns the exit code.

        Args:
            beside: nodes that work in the same process.
        """
        executor = make_executor()
        for node in (self, *beside):
            executor.add_node(node)
        self._wait_for_subscribers(executor)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        if self._gate is not None and self._stamped is not None:
            self._stamped.wake = partial(executor.create_task, self._on_tick_done)
        self._set_timer()
        self.create_timer(1.0, self._report, clock=steady)
        assert self._alone is not None, "it was claimed in the constructor"
        self._alone.watch()
        self.create_timer(1.0, self._world_topics.give_way, clock=steady)
        self.create_timer(1.0, self._unreceived.look, clock=steady)
        self._stats.restart(self._stamp_ns)
        while is_running() and not self._done:
            executor.spin_once(timeout_sec=0.5)
            if self._images is not None and not self._images.is_open:
                self._turn()  # the timer rests, so that renderers have the processor; the timeout may have passed
            if self._gate is not None:
                if self._gate.failure is not None:
                    raise self._gate.failure
                if self._gate.core.is_open and not self._config.rate:
                    self._turn()  # a request may have set time going
        self._end_last_tick(executor)
        return 0

    def _end_last_tick(self, executor: Executor) -> None:
        """Says when time ended; waits until all have done the last tick, where ``duration`` ended the run, and have what was published."""
        self._ticks.end_clock(self._stamp_ns)
        gate = self._gate
        while gate is not None and gate.core.stamp_ns is not None and not gate.may_go():
            if gate.failure is not None:
                raise gate.failure
            if self.simulator.quitting or not is_running():
                break
            executor.spin_once(timeout_sec=0.1)
        while self._images is not None and not self._images.may_go() and is_running() and not self.simulator.quitting:
            executor.spin_once(timeout_sec=0.1)
        wait_until_received(*self.publishers)

    def _set_timer(self) -> None:
        """Wakes the loop as often as time has to pass at the present rate."""
        if self._timer is not None:
            self.destroy_timer(self._timer)
        rate = self._config.rate
        period = min(1.0 / (self._config.clock_hz * rate), 0.01) if rate else 1e-5
        if self._gate is not None and not rate:
            period = 0.02  # what it waits for wakes it; turning meanwhile would take the processor from those
        self._timer = self.create_timer(period, self._turn, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _turn(self) -> None:
        """Makes the steps that are due now, as far as lockstep and images let it."""
        if self._done:
            return
        simulator, now_ns, gate, images = self.simulator, time.monotonic_ns(), self._gate, self._images
        if gate is not None and self._stamped is not None:
            for topic in self._stamped.arrived():
                gate.core.receive(topic.lstrip("/"), now_ns)
        if (gate is None or gate.may_go()) and (images is None or images.may_go()):
            # Not while a tick waits: a renderer that has the next scene already could not draw it.
            self._follow_changes()
            self._take_planned()
            left = simulator.steps_due(self._pacer.due(now_ns))
            left = self._pipeline(now_ns, left) if self._config.pipelined else self._make_steps(now_ns, left)
            if left and simulator.state is SimulationState.PLAYING:
                self._pacer.give_back(left)
        if images is not None and self._timer is not None and images.is_open == self._timer.is_canceled():
            (self._timer.reset if images.is_open else self._timer.cancel)()
        self._done = self._done or (self._standard is not None and self._standard.quit_is_answered)

    def _make_steps(self, now_ns: int, left: int) -> int:
        """Makes steps and publishes what is due at them, until a tick waits for others; returns how many of ``left`` are left."""
        while left and not self._done:
            for robot in self._robots.values():
                robot.latch_commands()
            self._step(now_ns)
            world = self.simulator.world
            assert world is not None
            self._ticks.publish(world)
            self._end_step(world.stamp_ns)
            left -= 1
            if (self._gate is not None and not self._gate.core.is_open) or (
                self._images is not None and not self._images.is_open
            ):
                break
            if self._take_planned():
                break
        return left

    def _pipeline(self, now_ns: int, left: int) -> int:
        """Publishes the tick that was made while the others did the one before, and makes the next one while they do this one.

        The commands that answer a tick are obeyed not in the next tick, which is made already, but in the one after it.
        """
        gate, world = self._gate, self.simulator.world
        assert gate is not None, "the settings allow a pipeline in lockstep alone"
        while world is not None and not self._done:
            if self._ticks.holds_tick:
                if not gate.core.is_open:
                    break
                # Before it is published: an answer to it must not slip in.
                for robot in self._robots.values():
                    robot.latch_commands()
                self._ticks.release(world)
                self._end_step(world.stamp_ns)
            if not left or self._done:
                break
            while left and not self._ticks.holds_tick:
                self._step(now_ns)
                self._ticks.hold(world)
                left -= 1
        return left

    def _on_tick_done(self) -> None:
        """Makes the next tick now, not when the timer says so."""
        if self._timer is not None and not self._done:
            self._turn()

    def _on_input(self, topic: str) -> None:
        """Takes note that a command arrived, which lockstep may have waited for."""
        if self._gate is not None:
            self._gate.receive(topic)

    def _take_planned(self) -> bool:
        """Obeys what was planned for the next step. In lockstep only once a tick is done: until then, not all of it may be there.

        Returns:
            Whether a request was among it, after which no step may be due: it may have stopped time, or taken the world away.
        """
        requested = False
        while planned := self._journal.due():
            for name, message in planned:
                robot = next((robot for robot in self._robots.values() if name in robot.command_topics), None)
                try:
                    if robot is not None:
                        robot.receive(name, message)
                    elif self._standard is not None:
                        requested = True
                        self._standard.repeat(name, message)
                except ConfigError as error:
                    self.get_logger().warning(f"a planned input is left out: {error}")
            self._follow_changes()
        return requested

    def _step(self, now_ns: int) -> None:
        """Makes one step."""
        world = self.simulator.world
        assert world is not None, "steps are due in a world alone"
        self._stats.begin_step(now_ns, world.stamp_ns)
        for robot in self._robots.values():
            robot.apply_commands(world, self._journal)
        self.simulator.step()

    def _end_step(self, stamp_ns: int) -> None:
        """Takes note that a step was published, with which ``duration`` may have passed."""
        self._stats.end_step(stamp_ns)
        self._done = bool(self._config.duration) and stamp_ns >= self._config.duration * NS_PER_S

    @property
    def _stamp_ns(self) -> int:
        world = self.simulator.world
        return 0 if world is None else world.stamp_ns

    def _wait_for_subscribers(self, executor: Executor) -> None:
        """Holds time until those hear each other who are in ``wait_for``, so that none misses the start."""
        wanted, cameras = self._config.wanted_subscribers(), self._world_topics.cameras
        images = [names.camera_topics(camera.name)[output] for camera in cameras for output in camera.outputs]
        wanted.update(dict.fromkeys(images, wanted.pop("cameras", 0)))
        wanted.update(dict.fromkeys((robot.truth_topic for robot in self._robots.values()), wanted.pop("robots", 0)))
        commanders = wanted.pop("commands", 0)
        heard = {
            f"publishers of {robot.robot.name}'s cmd_vel ({commanders})": partial(robot.is_commanded_by, commanders)
            for robot in self._robots.values()
        }
        wait_for_others(self, executor, wanted, heard)

    def _report(self) -> None:
        self._stats.publish(self._stamp_ns, self._config.rate, self._robots.values())

    def close(self) -> None:
        """Writes the summary and frees the world."""
        if self._standard is not None:
            self._standard.close()
            self._standard = None
        if self._stamped is not None:
            self._stamped.close()
            self._stamped = None
        if self._simulator is not None:
            write_summary(self._config.summary_path, self._stats.summary(self._robots.values()))
            self._simulator.close()
            self._simulator = None
        if self._alone is not None:
            self._alone.close()


def main(args: list[str] | None = None) -> None:
    """Runs the physics node."""
    run_node(PhysicsNode, args)


if __name__ == "__main__":
    main()
