"""What lockstep costs: the same ticks without ROS, with both nodes in one process, and in processes that wait for each other.

``Alone`` makes ticks in this process; the others are what ``gibson_sim_bench.cli.lockstep`` starts. All make ticks in turns, a block at a time: the
machine that is measured may be twice as fast a minute later.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.spec import drawn_scene
from gibson_sim_bench.loop import Loop
from gibson_sim_bench.protocol import TICK_WARM_UP
from gibson_sim_bench.ros import Size, Spread, Target, spread, without_nan

TICKS_PER_S, SPLIT = 1000.0, 0.20
"""Targets for two cores: ticks of one physics step without images, and what the split into processes may add where images are drawn."""
BLOCKS = 10
"""So often each side has its turn, after a first one that does not count."""
ONE_PROCESS, LOCKSTEP, PIPELINED = WAYS = ("one_process", "lockstep", "pipelined")
"""Ways with ROS: both nodes in one process, each in its own, the same in a pipeline."""


@dataclass(frozen=True, slots=True)
class LockstepPlan:
    """How much to measure."""

    scene: str = "flat"
    substeps: int = 1
    """Physics steps a tick."""
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
    """Milliseconds a tick, with RGB and depth of a size or without images; all in turns with each other."""

    size: Size | None
    physics: Spread
    """A step, all poses, what is due of the sensors; without ROS."""
    draw: Spread
    """NaN without images."""
    without_ros: Spread
    """Physics and drawing, one after the other."""
    one_process: Spread
    """From tick to tick, both nodes in one process, with a controller in another that answers every tick, and listens to the images. NaN
    without images: there is one node then."""
    lockstep: Spread
    """As ``one_process``, each node in a process of its own."""
    pipelined: Spread
    """As ``lockstep`` where physics makes the next tick while the others do this one."""

    @property
    def split(self) -> tuple[float, float]:
        """What the split into processes adds in lockstep and in a pipeline, each as a part of one process; NaN without images."""
        return self.lockstep.median / self.one_process.median - 1.0, self.pipelined.median / self.one_process.median - 1.0

    @property
    def ros(self) -> float:
        """What ROS adds in lockstep, messages, processes and controller together, as a part of what it takes without."""
        return self.lockstep.median / self.without_ros.median - 1.0


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
    substeps: int = 1

    def as_json(self) -> dict[str, Any]:
        """Returns the report as JSON's types; what was not measured is null."""
        found = asdict(self)
        for case, values in zip(self.cases, found["cases"], strict=True):
            values["ticks_per_s"] = {"lockstep": rate_of(case.lockstep), "pipelined": rate_of(case.pipelined)}
            values["split"] = dict(zip(("lockstep", "pipelined"), case.split, strict=True))
            values["ros"] = case.ros
        cleaned: dict[str, Any] = without_nan(found)
        return cleaned


@dataclass(slots=True)
class Turns:
    """Milliseconds of each tick that counts: without ROS, and of what has turns with it."""

    physics: list[float] = field(default_factory=list)
    draw: list[float] = field(default_factory=list)
    """Empty without images."""
    others: dict[str, list[float]] = field(default_factory=dict)
    """From tick to tick, by the name of the way."""

    @property
    def without_ros(self) -> list[float]:
        """Physics and drawing."""
        return [sum(parts) for parts in zip(self.physics, self.draw, strict=True)] if self.draw else self.physics


class Alone:
    """Makes ticks in this process. A context manager.

    Args:
        scene: what to load.
        robot: its file; it has one camera.
        size: of the images of that camera; None = nothing is drawn.
        substeps: physics steps a tick.
    """

    def __init__(self, scene: str, robot: Path, size: Size | None, substeps: int = 1) -> None:
        self._loop = Loop(scene, robot, substeps)
        self._loop.settle()
        drawn = drawn_scene(self._loop.world.scene, self._loop.world.links)
        self._cameras = [replace(camera, outputs=("rgb", "depth")) for camera in drawn.cameras[:1]]
        self._renderer = None if size is None else Renderer(drawn, cache=default_folder())

    def __enter__(self) -> Alone:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._renderer is not None:
            self._renderer.close()
        self._loop.close()

    def block(self, ticks: int, turns: Turns) -> None:
        """Makes ticks, and adds the times of those that count to ``turns``."""
        for tick in range(ticks + TICK_WARM_UP):
            began = time.perf_counter_ns()
            self._loop.step()
            state = self._loop.read()
            stepped = time.perf_counter_ns()
            if self._renderer is not None:
                self._renderer.render(state, self._cameras)
            if tick >= TICK_WARM_UP:
                turns.physics.append((stepped - began) / 1e6)
                if self._renderer is not None:
                    turns.draw.append((time.perf_counter_ns() - stepped) / 1e6)


def in_turns(alone: Alone, others: Mapping[str, Callable[[int], Sequence[int]]], ticks: int) -> Turns:
    """Returns the times of about ``ticks`` ticks of each side.

    Args:
        alone: one side.
        others: by the names of the ways, what makes so many ticks, and returns when each came, and the one before the first; nanoseconds.
        ticks: of each side.
    """
    turns, size = Turns(others={name: [] for name in others}), max(1, ticks // BLOCKS)
    for block in range(1 + BLOCKS):
        alone.block(size, turns if block else Turns())
        for name, make in others.items():
            took = np.diff(np.asarray(make(size + TICK_WARM_UP), dtype=np.float64))[TICK_WARM_UP:] / 1e6
            turns.others[name] += took.tolist() if block else []
    return turns


def rate_of(ticks: Spread) -> float:
    """Returns ticks a second."""
    return 1e3 / ticks.median


def case_of(size: Size | None, turns: Turns) -> Case:
    """Returns a case from what was measured of all ways, which ``WAYS`` names."""
    others = {way: spread(turns.others.get(way, ())) for way in WAYS}
    return Case(size, spread(turns.physics), spread(turns.draw), spread(turns.without_ros), **others)


def targets(cases: Sequence[Case], substeps: int = 1) -> list[Target]:
    """Returns the targets that the cases say something about; that of ticks without images is one of single physics steps."""
    found = []
    for case in cases:
        if case.size is None and substeps > 1:
            continue
        ways = ("", case.lockstep), (", in a pipeline", case.pipelined)
        for (way, ticks), added in zip(ways, case.split, strict=True):
            if case.size is None:
                rate = rate_of(ticks)
                found.append(
                    Target(f"ticks without images{way}", f"> {TICKS_PER_S:,.0f}/s", f"{rate:,.0f}/s", "", rate > TICKS_PER_S)
                )
            else:
                what = f"what the processes add at {case.size} RGB + depth{way}"
                found.append(Target(what, f"< {100 * SPLIT:.0f} %", f"{100 * added:.0f} %", "", added < SPLIT))
    return found
