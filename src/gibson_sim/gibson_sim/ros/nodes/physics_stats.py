"""Statistics of the physics node: published once a second, and summarised at the end."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from std_msgs.msg import Float64

from gibson_sim.processes.job_folder import STATUS, note_in_job
from gibson_sim.ros import conversions
from gibson_sim.ros.lockstep.journal import Journal
from gibson_sim.ros.lockstep.lockstep_gate import LockstepGate
from gibson_sim.ros.lockstep.pacing import Pacer
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.robot_interface import RobotInterface
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.standard.simulator import Simulator
from gibson_sim.standard.states import SimulationState
from gibson_sim.types import NS_PER_S, CameraSpec


class PhysicsStats:
    """Measures the real-time factor, and reports it with the counters of the node.

    Publishes:
        real_time_factor (std_msgs/Float64), /diagnostics (diagnostic_msgs/DiagnosticArray).
    """

    def __init__(
        self, node: Node, step_hz: int, simulator: Simulator, pacer: Pacer, journal: Journal, gate: LockstepGate | None
    ) -> None:
        self._step_hz, self._simulator, self._pacer, self._journal, self._gate = step_hz, simulator, pacer, journal, gate
        self._first_step: tuple[int, int] | None = None
        self._last_step, self._last_report = (0, 0), (0, 0)
        self._earlier_ns = 0
        """Total simulation time of earlier epochs by which resets have set time back, ns."""
        self._scene = ""
        """Name of the last scene."""
        self._earlier_commands: dict[str, int] = _commands(())
        """Counters of the robots that were removed."""
        self._factor_pub = node.create_publisher(Float64, names.REAL_TIME_FACTOR, qos.STATE)
        self._diagnostics_pub = node.create_publisher(DiagnosticArray, names.DIAGNOSTICS, qos.STATE)

    def begin_scene(self, name: str) -> None:
        """Records the name of the scene, which the summary names also if it has been unloaded."""
        self._scene = name

    def remove_robot(self, robot: RobotInterface) -> None:
        """Keeps the counters of a robot that is removed."""
        self._earlier_commands = _commands((robot,), self._earlier_commands)

    def begin_step(self, now_ns: int, stamp_ns: int) -> None:
        """Records the start of a step at ``now_ns``, monotonic clock, in a world at ``stamp_ns``."""
        self._first_step = self._first_step or (now_ns, stamp_ns)
        if stamp_ns < self._last_step[1]:  # time was reset
            self._earlier_ns += self._last_step[1] - stamp_ns

    def end_step(self, stamp_ns: int) -> None:
        """Records that a step was executed and published."""
        self._last_step = (time.monotonic_ns(), stamp_ns)

    def restart(self, stamp_ns: int) -> None:
        """Restarts the measurement of the real-time factor at ``stamp_ns``, after time has jumped."""
        self._last_report = (time.monotonic_ns(), stamp_ns)

    def publish(self, stamp_ns: int, rate: float, robots: Iterable[RobotInterface]) -> None:
        """Publishes the real-time factor since the last report, whether it reaches ``rate``, and all counters."""
        wall_ns, robots = time.monotonic_ns(), tuple(robots)
        factor = (stamp_ns - self._last_report[1]) / max(1, wall_ns - self._last_report[0])
        self._last_report = (wall_ns, stamp_ns)
        self._factor_pub.publish(Float64(data=factor))
        simulator = self._simulator
        state = simulator.state.name.lower()
        playing = simulator.state is SimulationState.PLAYING
        behind = playing and bool(rate) and factor < 0.95 * rate
        values = {
            "state": state,
            "real_time_factor": f"{factor:.3f}",
            "simulation_time_s": f"{stamp_ns / NS_PER_S:.3f}",
            "epoch": simulator.epoch,
            "lost_wall_time_s": f"{self._pacer.lost_ns / NS_PER_S:.3f}",
            "entities": len(simulator.world.names) if simulator.world is not None else 0,
            **_commands(robots, self._earlier_commands),
            "missed_measurements": sum(sum(robot.sensors.misses.values()) for robot in robots),
            "late_inputs": self._journal.late,
        }
        if self._gate is not None:
            values["lockstep_waits_for"] = ", ".join(self._gate.core.waits_for) or "none"
            values["lockstep_timeouts"] = self._gate.timeouts
        touches = {robot.robot.name: self._touched(robot.robot.name) for robot in robots}
        for name, bodies in touches.items():
            values[f"{name}_touches"] = ", ".join(bodies) or "nothing"
        self._report_to_launcher(state, factor, stamp_ns / NS_PER_S, touches)
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if behind else DiagnosticStatus.OK,
            name="gibson_sim: physics",
            message="slower than the requested rate" if behind else "on time" if playing else state,
            hardware_id=simulator.scene.name,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        self._diagnostics_pub.publish(DiagnosticArray(header=conversions.header_to_msg(stamp_ns, ""), status=[status]))

    def _touched(self, robot: str) -> tuple[str, ...]:
        """Returns the names of the bodies that a robot touches, except the floor; empty if it is not in the world."""
        world = self._simulator.world
        return () if world is None or robot not in world.names else world.touching(robot)

    def _report_to_launcher(self, state: str, factor: float, time_s: float, touches: dict[str, tuple[str, ...]]) -> None:
        """Reports the status of the simulation to the launcher of this process."""
        core = None if self._gate is None else self._gate.core
        late = ", ".join(core.waits_for) if core is not None and core.waited_ns(time.monotonic_ns()) > NS_PER_S else ""
        values = {"state": state, "real_time_factor": factor, "simulation_time_s": time_s, "touches": touches, "waits_for": late}
        note_in_job(STATUS.format("physics"), json.dumps(values))

    def summary(self, robots: Iterable[RobotInterface]) -> dict[str, Any]:
        """Returns the statistics since the first step."""
        first = self._first_step or self._last_step
        wall_s = (self._last_step[0] - first[0]) / NS_PER_S
        sim_s = (self._last_step[1] + self._earlier_ns - first[1]) / NS_PER_S
        world, robots = self._simulator.world, tuple(robots)
        return {
            "scene": self._scene,
            "simulation_time_s": sim_s,
            "wall_time_s": wall_s,
            "real_time_factor": sim_s / wall_s if wall_s else 0.0,
            "physics_steps": 0 if world is None else world.step_count,
            "step_hz": self._step_hz,
            "lost_wall_time_s": self._pacer.lost_ns / NS_PER_S,
            **_commands(robots, self._earlier_commands),
            "missed_measurements": {robot.robot.name: robot.sensors.misses for robot in robots},
            **({} if self._gate is None else {"lockstep": self._gate.summary()}),
        }


def loaded_note(scene: SceneSpec, cameras: Iterable[CameraSpec]) -> str:
    """Returns the text of the note ``LOADED``, see ``gibson_sim.processes.job_folder``."""
    robots = [{"name": robot.name, "model": robot.urdf.stem, "drives": robot.drive is not None} for robot in scene.robots]
    camera_values = [
        {"name": c.name, "outputs": c.outputs, "width": c.width, "height": c.height, "rate_hz": c.rate_hz} for c in cameras
    ]
    return json.dumps({"scene": scene.name, "robots": robots, "cameras": camera_values})


def _commands(robots: Iterable[RobotInterface], earlier: Mapping[str, int] | None = None) -> dict[str, int]:
    """Returns the number of commands that the robots received, and of those that were refused, added to ``earlier`` ones."""
    counts = [(robot.command_count, robot.refused_commands) for robot in robots]
    sums = {"commands": sum(count for count, _ in counts), "refused_commands": sum(refused for _, refused in counts)}
    return {name: value + (earlier or {}).get(name, 0) for name, value in sums.items()}
