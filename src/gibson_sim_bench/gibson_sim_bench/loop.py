"""The simulation loop of the benchmarks: physics and sensors of a scene in this process."""

from __future__ import annotations

from pathlib import Path

from gibson_sim.sensors.suite import SensorSuite
from gibson_sim.simulation import Simulation
from gibson_sim.types import SceneState, VelocityCommand
from gibson_sim_bench.protocol import SETTLE_S, STEP_HZ, RandomCommands


class Loop:
    """Physics and sensors of a scene with one robot, stepped by frame. Close it.

    Args:
        scene: name or path of the scene.
        robot: path of the robot's file.
        substeps: physics steps per frame.
    """

    def __init__(self, scene: str, robot: Path, substeps: int) -> None:
        self.simulation = Simulation(scene, robot, step_hz=STEP_HZ)
        self.world = self.simulation.world
        spec = self.simulation.robot.spec
        self._robot, self._substeps = spec.name, substeps
        # `Simulation.step` measures sensors after each physics step; a frame measures them at its end, as the physics node does.
        self._sensors = SensorSuite(spec, STEP_HZ, STEP_HZ // substeps, self.world.scene.gravity)
        self._commands = RandomCommands(substeps)

    def settle(self) -> None:
        """Steps for ``SETTLE_S`` of simulation time, until bodies at rest sleep."""
        self.world.step(round(SETTLE_S * STEP_HZ))

    def step(self) -> None:
        """Makes the physics steps of one frame with the next command."""
        linear, angular = self._commands.next()
        world = self.world
        world.command(self._robot, VelocityCommand((linear, 0.0, 0.0), (0.0, 0.0, angular), world.stamp_ns))
        world.step(self._substeps)

    def read(self) -> SceneState:
        """Returns the scene state after measuring the due sensors, in the order of the physics node."""
        world, name = self.world, self._robot
        world.odometry(name), world.base_twist(name)
        state = world.state()
        self._sensors.measure(world, world.step_count, world.stamp_ns)
        world.joint_states(name)
        return state

    def close(self) -> None:
        """Frees engine and renderer."""
        self.simulation.close()
