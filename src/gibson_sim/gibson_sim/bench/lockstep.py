"""What lockstep costs: the same ticks in one process, and in processes that wait for each other.

``alone`` measures the parts and the whole in this process; the other side is what ``cli.bench_lockstep`` starts.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from gibson_sim.bench.ros import Size, Spread, Target, spread, without_nan
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.placement import populate
from gibson_sim.scenes.spec import drawn_scene
from gibson_sim.sensors.suite import SensorSuite
from gibson_sim.types import Frame, SceneState, VelocityCommand

STEP_HZ = 240
"""Physics steps, and ticks, in a second of simulation time: one step a tick."""
TICKS_PER_S, OVERHEAD = 1000.0, 0.20
"""Targets for two cores: ticks without images, and what the split into processes may add where images are drawn."""
WARM_UP = 20
"""Ticks that do not count."""


@dataclass(frozen=True, slots=True)
class LockstepPlan:
    """How much to measure."""

    scene: str = "flat"
    ticks: int = 2000
    """Without images."""
    image_ticks: int = 200
    """With images: one at every tick."""
    sizes: tuple[Size, ...] = (Size(256, 256), Size(640, 480))

    @classmethod
    def quick(cls) -> LockstepPlan:
        """Returns a plan that takes a minute."""
        return cls(ticks=500, image_ticks=60)


@dataclass(frozen=True, slots=True)
class Case:
    """Milliseconds a tick, with RGB and depth of a size or without images."""

    size: Size | None
    physics: Spread
    """A step, all poses, what is due of the sensors; in one process."""
    draw: Spread
    """NaN without images."""
    one_process: Spread
    """Physics and drawing, one after the other."""
    lockstep: Spread
    """From tick to tick, with a controller in a process of its own that answers every one, and listens to the images."""

    pipelined: Spread
    """The same where physics makes the next tick while the others do this one."""

    def overhead(self, ticks: Spread) -> float:
        """Returns what the processes add, as a part of one process; ``ticks``: one of the two ways."""
        return ticks.median / self.one_process.median - 1.0


@dataclass(frozen=True, slots=True)
class LockstepReport:
    """All that was measured, and where."""

    date: str
    version: str
    machine: str
    cores: int
    load: float
    scene: str
    cases: tuple[Case, ...] = ()
    left_out: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Returns the report as JSON's types; what was not measured is null."""
        found = asdict(self)
        for case, values in zip(self.cases, found["cases"], strict=True):
            values["ticks_per_s"] = {"lockstep": rate_of(case.lockstep), "pipelined": rate_of(case.pipelined)}
            values["overhead"] = {"lockstep": case.overhead(case.lockstep), "pipelined": case.overhead(case.pipelined)}
        cleaned: dict[str, Any] = without_nan(found)
        return cleaned


def alone(scene_name: str, robot: str, size: Size | None, ticks: int) -> tuple[Spread, Spread, Spread]:
    """Returns milliseconds a tick of physics, drawing and both, in this process.

    Args:
        scene_name: what to load.
        robot: its file; it has one camera.
        size: of the images of that camera; None = nothing is drawn.
        ticks: how many are counted.
    """
    scene = populate(scene_name, robot, "")
    with PhysicsWorld(scene, step_hz=STEP_HZ) as world:
        spec = scene.robots[0]
        sensors = SensorSuite(spec, STEP_HZ, STEP_HZ, scene.gravity)
        drawn = drawn_scene(world.scene, world.links)
        renderer = None if size is None else Renderer(drawn, cache=default_folder())
        cameras = [replace(camera, outputs=("rgb", "depth")) for camera in drawn.cameras[:1]]

        def physics() -> SceneState:
            world.command(spec.name, VelocityCommand((0.3, 0.0, 0.0), (0.0, 0.0, 0.5), world.stamp_ns))
            world.step()
            sensors.measure(world, world.step_count, world.stamp_ns)
            world.odometry(spec.name), world.base_twist(spec.name), world.joint_states(spec.name)
            return world.state()

        def draw(state: SceneState) -> list[Frame]:
            return [] if renderer is None else renderer.render(state, cameras)

        try:
            whole = _times(lambda: draw(physics()), ticks)
            state = world.state()
            return _times(physics, ticks), _times(lambda: draw(state), ticks if renderer else 0), whole
        finally:
            if renderer is not None:
                renderer.close()


def _times(work: Callable[[], Any], count: int) -> Spread:
    """Returns how long ``work`` takes, milliseconds."""
    found = []
    for _ in range(count + WARM_UP if count else 0):
        started = time.perf_counter_ns()
        work()
        found.append((time.perf_counter_ns() - started) / 1e6)
    return spread(found[WARM_UP:])


def rate_of(ticks: Spread) -> float:
    """Returns ticks a second."""
    return 1e3 / ticks.median


def case_of(size: Size | None, parts: tuple[Spread, Spread, Spread], heard: dict[str, Any], pipelined: dict[str, Any]) -> Case:
    """Returns a case from what was measured in one process, and from what the controller heard: ``tick_ns``, its ticks' times."""
    return Case(size, *parts, _between_ticks(heard), _between_ticks(pipelined))


def _between_ticks(heard: dict[str, Any]) -> Spread:
    times = np.diff(np.asarray(heard["tick_ns"], dtype=np.float64)) / 1e6
    return spread(times.tolist())


def targets(cases: Sequence[Case]) -> list[Target]:
    """Returns the targets that the cases say something about."""
    found = []
    for case in cases:
        for way, ticks in (("", case.lockstep), (", in a pipeline", case.pipelined)):
            if case.size is None:
                rate = rate_of(ticks)
                found.append(
                    Target(f"ticks without images{way}", f"> {TICKS_PER_S:,.0f}/s", f"{rate:,.0f}/s", "", rate > TICKS_PER_S)
                )
            else:
                what, added = f"what the processes add at {case.size} RGB + depth{way}", case.overhead(ticks)
                found.append(Target(what, f"< {100 * OVERHEAD:.0f} %", f"{100 * added:.0f} %", "", added < OVERHEAD))
    return found
