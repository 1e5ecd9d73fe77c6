"""Cost of lockstep: the same ticks without ROS, with both nodes in one process, and with each node in its own process.

``InProcessTicks`` makes ticks in this process; ``gibson_sim_bench.cli.lockstep`` starts the other configurations. Their blocks are
interleaved, since the speed of a machine may double within a minute.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from gibson_sim_bench.loop import Loop
from gibson_sim_bench.protocol import TICK_WARM_UP
from gibson_sim_bench.ros import PerformanceTarget, Size, Spread, spread, without_nan

MIN_TICKS_PER_S, MAX_SPLIT = 1000.0, 0.20
"""Targets for two cores: rate of ticks with one physics step without images, 1/s; overhead of separate processes with images, a fraction."""
BLOCKS = 10
"""Blocks of each configuration, after one of warm-up."""
ONE_PROCESS, LOCKSTEP, PIPELINED = CONFIGURATIONS = ("one_process", "lockstep", "pipelined")
"""Configurations with ROS: both nodes in one process, each in its own, each in its own and pipelined."""


@dataclass(frozen=True, slots=True)
class LockstepPlan:
    """Scene and number of measurements."""

    scene: str = "flat"
    substeps: int = 1
    """Physics steps per tick."""
    ticks: int = 2000
    """Ticks without images."""
    image_ticks: int = 200
    """Ticks with images, one set per tick."""
    sizes: tuple[Size, ...] = (Size(256, 256), Size(640, 480))

    @classmethod
    def quick(cls) -> LockstepPlan:
        """Returns a plan of about a minute."""
        return cls(ticks=500, image_ticks=60)


@dataclass(frozen=True, slots=True)
class LockstepCase:
    """Milliseconds per tick, with RGB and depth of a size or without images."""

    size: Size | None
    physics: Spread
    """Physics steps, all poses and due sensors, without ROS."""
    draw: Spread
    """Rendering, without ROS; NaN without images."""
    without_ros: Spread
    """Physics and rendering, one after the other."""
    one_process: Spread
    """Tick to tick, both nodes in one process; a controller in another process answers each tick and subscribes to the images. NaN
    without images, where there is only one node."""
    lockstep: Spread
    """As ``one_process``, with each node in its own process."""
    pipelined: Spread
    """As ``lockstep``, while physics already steps towards the next tick."""

    @property
    def split(self) -> tuple[float, float]:
        """Overhead of separate processes in lockstep and pipelined, as a fraction of ``one_process``; NaN without images."""
        return self.lockstep.median / self.one_process.median - 1.0, self.pipelined.median / self.one_process.median - 1.0

    @property
    def ros(self) -> float:
        """Overhead of ROS in lockstep (messages, processes, controller), as a fraction of ``without_ros``."""
        return self.lockstep.median / self.without_ros.median - 1.0


@dataclass(frozen=True, slots=True)
class LockstepReport:
    """The measurements, with the machine."""

    date: str
    version: str
    machine: str
    cores: int
    load: float
    scene: str
    cases: tuple[LockstepCase, ...] = ()
    left_out: tuple[str, ...] = ()
    substeps: int = 1

    def as_json(self) -> dict[str, Any]:
        """Returns the report as JSON types; NaN becomes null."""
        found = asdict(self)
        for case, values in zip(self.cases, found["cases"], strict=True):
            values["ticks_per_s"] = {"lockstep": rate_of(case.lockstep), "pipelined": rate_of(case.pipelined)}
            values["split"] = dict(zip(("lockstep", "pipelined"), case.split, strict=True))
            values["ros"] = case.ros
        cleaned: dict[str, Any] = without_nan(found)
        return cleaned


@dataclass(slots=True)
class TickTimes:
    """Milliseconds of each tick that counts, without ROS and in each configuration with ROS."""

    physics: list[float] = field(default_factory=list)
    draw: list[float] = field(default_factory=list)
    """Empty without images."""
    with_ros: dict[str, list[float]] = field(default_factory=dict)
    """Tick to tick, by configuration."""

    @property
    def without_ros(self) -> list[float]:
        """Physics and rendering."""
        return [sum(parts) for parts in zip(self.physics, self.draw, strict=True)] if self.draw else self.physics


class InProcessTicks:
    """Makes ticks in this process, without ROS. A context manager.

    Args:
        scene: name or path of the scene.
        robot: file of the robot, which has one camera.
        size: size of the images of that camera; None = no images.
        substeps: physics steps per tick.
    """

    def __init__(self, scene: str, robot: Path, size: Size | None, substeps: int = 1) -> None:
        self._loop = Loop(scene, robot, substeps)
        self._loop.settle()
        simulation = self._loop.simulation
        self._cameras = [replace(camera, outputs=("rgb", "depth")) for camera in simulation.cameras[:1]]
        self._renderer = None if size is None else simulation.renderer

    def __enter__(self) -> InProcessTicks:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._loop.close()

    def make_block(self, ticks: int, times: TickTimes) -> None:
        """Makes ``ticks`` ticks after the warm-up, and appends their durations to ``times``."""
        for tick in range(ticks + TICK_WARM_UP):
            began = time.perf_counter_ns()
            self._loop.step()
            state = self._loop.read()
            stepped = time.perf_counter_ns()
            if self._renderer is not None:
                self._renderer.render(state, self._cameras)
            if tick >= TICK_WARM_UP:
                times.physics.append((stepped - began) / 1e6)
                if self._renderer is not None:
                    times.draw.append((time.perf_counter_ns() - stepped) / 1e6)


def measure_interleaved(
    in_process: InProcessTicks, with_ros: Mapping[str, Callable[[int], Sequence[int]]], ticks: int
) -> TickTimes:
    """Returns the durations of about ``ticks`` ticks of each configuration, in interleaved blocks.

    Args:
        in_process: makes the ticks without ROS.
        with_ros: by configuration, a function that makes ``n`` ticks and returns their times, preceded by that of the previous tick, nanoseconds.
        ticks: number of ticks of each configuration.
    """
    times, size = TickTimes(with_ros={name: [] for name in with_ros}), max(1, ticks // BLOCKS)
    for block in range(1 + BLOCKS):
        in_process.make_block(size, times if block else TickTimes())
        for name, make in with_ros.items():
            durations_ms = np.diff(np.asarray(make(size + TICK_WARM_UP), dtype=np.float64))[TICK_WARM_UP:] / 1e6
            times.with_ros[name] += durations_ms.tolist() if block else []
    return times


def rate_of(ticks: Spread) -> float:
    """Returns ticks per second."""
    return 1e3 / ticks.median


def case_of(size: Size | None, times: TickTimes) -> LockstepCase:
    """Returns the statistics of measured durations; ``CONFIGURATIONS`` are those with ROS."""
    with_ros = {name: spread(times.with_ros.get(name, ())) for name in CONFIGURATIONS}
    return LockstepCase(size, spread(times.physics), spread(times.draw), spread(times.without_ros), **with_ros)


def targets(cases: Sequence[LockstepCase], substeps: int = 1) -> list[PerformanceTarget]:
    """Returns the targets that the cases cover; the one without images holds for one physics step per tick."""
    found = []
    for case in cases:
        if case.size is None and substeps > 1:
            continue
        configurations = ("", case.lockstep), (", pipelined", case.pipelined)
        for (suffix, ticks), overhead in zip(configurations, case.split, strict=True):
            if case.size is None:
                rate = rate_of(ticks)
                found.append(
                    PerformanceTarget(
                        f"ticks without images{suffix}",
                        f"> {MIN_TICKS_PER_S:,.0f}/s",
                        f"{rate:,.0f}/s",
                        "",
                        rate > MIN_TICKS_PER_S,
                    )
                )
            else:
                what = f"overhead of separate processes, {case.size} RGB + depth{suffix}"
                found.append(
                    PerformanceTarget(what, f"< {100 * MAX_SPLIT:.0f} %", f"{100 * overhead:.0f} %", "", overhead < MAX_SPLIT)
                )
    return found
