"""Physics and sensors of a scene in this process, as the benchmarks drive them."""

from __future__ import annotations

from pathlib import Path

from gibson_sim.maps.placement import populate
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.sensors.suite import SensorSuite
from gibson_sim.types import SceneState, VelocityCommand
from gibson_sim_bench.protocol import SETTLE_S, STEP_HZ, Commands


class Loop:
    """Physics of a scene with the robot, a frame at a time. Close it.

    Args:
        scene: name or path.
        robot: its file.
        substeps: physics steps a frame.
    """

    def __init__(self, scene: str, robot: Path, substeps: int) -> None:
        populated = populate(scene, str(robot), "")
        self.world = PhysicsWorld(populated, step_hz=STEP_HZ)
        self._robot, self._substeps = populated.robots[0].name, substeps
        self._sensors = SensorSuite(populated.robots[0], STEP_HZ, STEP_HZ // substeps, populated.gravity)
        self._commands = Commands(substeps)

    def settle(self) -> None:
        """Lets what lies still fall asleep."""
        self.world.step(round(SETTLE_S * STEP_HZ))

    def step(self) -> None:
        """Obeys the next command for a frame."""
        linear, angular = self._commands.next()
        world = self.world
        world.command(self._robot, VelocityCommand((linear, 0.0, 0.0), (0.0, 0.0, angular), world.stamp_ns))
        world.step(self._substeps)

    def read(self) -> SceneState:
        """Returns the poses of everything, having measured what is due; in the order of the physics node."""
        world, name = self.world, self._robot
        world.odometry(name), world.base_twist(name)
        state = world.state()
        self._sensors.measure(world, world.step_count, world.stamp_ns)
        world.joint_states(name)
        return state

    def close(self) -> None:
        """Frees the engine."""
        self.world.close()
