"""What lockstep costs: the same ticks in one process, and in processes that wait for each other.

``Alone`` makes ticks in this process; the other side is what ``cli.bench_lockstep`` starts. Both make ticks in turns, a block at a time: the
machine that is measured may be twice as fast a minute later.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from types import TracebackType
from typing import Any

import numpy as np

from gibson_sim.bench.ros import Size, Spread, Target, spread, without_nan
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.placement import populate
from gibson_sim.scenes.spec import drawn_scene
from gibson_sim.sensors.suite import SensorSuite
from gibson_sim.types import SceneState, VelocityCommand

STEP_HZ = 240
"""Physics steps, and ticks, in a second of simulation time: one step a tick."""
TICKS_PER_S, OVERHEAD = 1000.0, 0.20
"""Targets for two cores: ticks without images, and what the split into processes may add where images are drawn."""
BLOCKS = 10
"""So often either side has its turn, after a first one that does not count."""
WARM_UP = 3
"""Ticks of each block that do not count."""


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
    """Physics and drawing, one after the other, in turns with ``lockstep``."""
    lockstep: Spread
    """From tick to tick, with a controller in a process of its own that answers every one, and listens to the images."""
    beside_pipeline: Spread
    """As ``one_process``, in turns with ``pipelined``."""
    pipelined: Spread
    """As ``lockstep`` where physics makes the next tick while the others do this one."""

    @property
    def overheads(self) -> tuple[float, float]:
        """What the processes add in lockstep and in a pipeline, each as a part of one process."""
        return self.lockstep.median / self.one_process.median - 1.0, self.pipelined.median / self.beside_pipeline.median - 1.0


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
            values["overhead"] = dict(zip(("lockstep", "pipelined"), case.overheads, strict=True))
        cleaned: dict[str, Any] = without_nan(found)
        return cleaned


@dataclass(slots=True)
class Turns:
    """Milliseconds of each tick that counts: of one process, and of processes in turns with it."""

    physics: list[float] = field(default_factory=list)
    draw: list[float] = field(default_factory=list)
    """Empty without images."""
    processes: list[float] = field(default_factory=list)
    """From tick to tick."""

    @property
    def one_process(self) -> list[float]:
        """Physics and drawing."""
        return [sum(parts) for parts in zip(self.physics, self.draw, strict=True)] if self.draw else self.physics


class Alone:
    """Makes ticks in this process. A context manager.

    Args:
        scene_name: what to load.
        robot: its file; it has one camera.
        size: of the images of that camera; None = nothing is drawn.
    """

    def __init__(self, scene_name: str, robot: str, size: Size | None) -> None:
        scene = populate(scene_name, robot, "")
        self._world, self._spec = PhysicsWorld(scene, step_hz=STEP_HZ), scene.robots[0]
        self._sensors = SensorSuite(self._spec, STEP_HZ, STEP_HZ, scene.gravity)
        drawn = drawn_scene(self._world.scene, self._world.links)
        self._cameras = [replace(camera, outputs=("rgb", "depth")) for camera in drawn.cameras[:1]]
        self._renderer = None if size is None else Renderer(drawn, cache=default_folder())

    def __enter__(self) -> Alone:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._renderer is not None:
            self._renderer.close()
        self._world.close()

    def block(self, ticks: int, turns: Turns) -> None:
        """Makes ticks, and adds the times of those that count to ``turns``."""
        for tick in range(ticks + WARM_UP):
            began = time.perf_counter_ns()
            state = self._step()
            stepped = time.perf_counter_ns()
            if self._renderer is not None:
                self._renderer.render(state, self._cameras)
            if tick >= WARM_UP:
                turns.physics.append((stepped - began) / 1e6)
                if self._renderer is not None:
                    turns.draw.append((time.perf_counter_ns() - stepped) / 1e6)

    def _step(self) -> SceneState:
        world, name = self._world, self._spec.name
        world.command(name, VelocityCommand((0.3, 0.0, 0.0), (0.0, 0.0, 0.5), world.stamp_ns))
        world.step()
        self._sensors.measure(world, world.step_count, world.stamp_ns)
        world.odometry(name), world.base_twist(name), world.joint_states(name)
        return world.state()


def in_turns(alone: Alone, others: Callable[[int], Sequence[int]], ticks: int) -> Turns:
    """Returns the times of about ``ticks`` ticks of either side.

    Args:
        alone: one side.
        others: makes so many ticks of the other side, and returns when each came, and the one before the first; nanoseconds.
        ticks: of each side.
    """
    turns, size = Turns(), max(1, ticks // BLOCKS)
    for block in range(1 + BLOCKS):
        found = Turns() if not block else turns
        alone.block(size, found)
        found.processes += (np.diff(np.asarray(others(size + WARM_UP), dtype=np.float64))[WARM_UP:] / 1e6).tolist()
    return turns


def rate_of(ticks: Spread) -> float:
    """Returns ticks a second."""
    return 1e3 / ticks.median


def case_of(size: Size | None, lockstep: Turns, pipelined: Turns) -> Case:
    """Returns a case from what was measured of both ways."""
    return Case(
        size,
        spread(lockstep.physics),
        spread(lockstep.draw),
        spread(lockstep.one_process),
        spread(lockstep.processes),
        spread(pipelined.one_process),
        spread(pipelined.processes),
    )


def targets(cases: Sequence[Case]) -> list[Target]:
    """Returns the targets that the cases say something about."""
    found = []
    for case in cases:
        ways = ("", case.lockstep), (", in a pipeline", case.pipelined)
        for (way, ticks), added in zip(ways, case.overheads, strict=True):
            if case.size is None:
                rate = rate_of(ticks)
                found.append(
                    Target(f"ticks without images{way}", f"> {TICKS_PER_S:,.0f}/s", f"{rate:,.0f}/s", "", rate > TICKS_PER_S)
                )
            else:
                what = f"what the processes add at {case.size} RGB + depth{way}"
                found.append(Target(what, f"< {100 * OVERHEAD:.0f} %", f"{100 * added:.0f} %", "", added < OVERHEAD))
    return found
