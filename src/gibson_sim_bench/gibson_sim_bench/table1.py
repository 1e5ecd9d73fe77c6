"""The paper's table in this process: physics, sensors and images, one after the other, each stage timed; and rendering alone.

Protocol: a differential robot of a TurtleBot's size with one camera of 90 degrees; physics steps of 1/240 s; random velocities, ten per
second of simulation time, from one seed; warm-up frames that do not count. A frame is complete when all its outputs are in host memory, or
in tensors that are synchronised.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gibson_sim.physics.engine import pybullet
from gibson_sim.render.cache import default_folder
from gibson_sim.render.context import gl as GL
from gibson_sim.render.draw.hole_filling import HoleFilling
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.render.readback.frames import Readback, TargetImage
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import DrawnScene, drawn_scene
from gibson_sim.types import OUTPUTS, CameraSpec, Frame, SceneState
from gibson_sim_bench import timing
from gibson_sim_bench.clocks import Clock, calls_of, copy_ms, opengl_calls
from gibson_sim_bench.loop import Loop
from gibson_sim_bench.own_renderer import STILL, pose_of
from gibson_sim_bench.protocol import BLOCK, FOV_Y_DEG, HOUSE_MODES, HOUSES_ONLY, ROBOT, WARM_UP, WAYS, Table1Plan
from gibson_sim_bench.reports.paper import HOUSE_SIZE, PHYSICS_SIZE, TOGETHER, Mode
from gibson_sim_bench.rows import BULLET, COPY, HOST, IN_PROCESS, OPENGL, TENSOR, Table1, Table1Row, lockstep_row, row_of
from gibson_sim_bench.scenes.bench_scenes import bench_scene, camera_path
from gibson_sim_bench.tensors import synchronize


@dataclass(frozen=True, slots=True)
class LockstepRunner:
    """Runs simulations in lockstep, whose ticks take turns with the frames in this process."""

    start: Callable[[int, Sequence[Mode]], AbstractContextManager[Callable[[int, int], Sequence[float]]]]
    """Starts a simulation: (substeps, modes) -> context manager of a function that makes ticks of one mode: (index of the mode, count) ->
    seconds of each tick, or nothing if that failed."""
    messages: Mapping[str, Mapping[str, float]]
    """Milliseconds of the messages alone, by mode."""


def measure(
    plan: Table1Plan, robot: Path, tell: Callable[[str], None] = lambda line: None, lockstep: LockstepRunner | None = None
) -> Table1:
    """Returns the measurements in this process, and those in lockstep that take turns with them.

    Args:
        plan: what to measure.
        robot: file of the robot, as ``write_robot`` writes it.
        tell: called with one line of progress.
        lockstep: runs the rows in lockstep; None = no such rows.

    Raises:
        GibsonSimError: a scene cannot be loaded, or nothing here can draw.
    """
    began = timing.facts()
    rows: list[Table1Row] = []
    with ExitStack() as stack:
        loop = Loop(plan.scene, robot, 1)
        stack.callback(loop.close)
        drawn = drawn_scene(loop.world.scene, loop.world.links)
        pair = RendererPair(drawn, plan.device, None, stack)
        if IN_PROCESS in plan.ways:
            for substeps, modes in ((k, together) for k in plan.substeps for together in TOGETHER):
                with ExitStack() as running:
                    ticks = running.enter_context(lockstep.start(substeps, modes)) if lockstep else None
                    for which, mode in enumerate(modes):
                        tell(f"{'in process and in lockstep' if ticks else 'in process'}: {mode.name}, {substeps} substeps")
                        other = partial(ticks, which) if ticks else None
                        rows += _with_physics(
                            plan, robot, substeps, mode, pair, other, lockstep.messages[mode.name] if lockstep else {}
                        )
        info, tensors_on = pair.plain.info, pair.plain.tensors_on
    for house in plan.houses if HOUSES_ONLY in plan.ways else ():
        tell(f"drawing only: {house}")
        rows += _house(plan, house)
    facts = replace(began, gpu=str(info["renderer"]), driver=str(info["version"]))
    in_order = sorted(rows, key=lambda row: WAYS.index(row.way))
    return Table1(facts, f"{ROBOT}, {FOV_Y_DEG:g} degrees", tensors_on, tuple(in_order))


class RendererPair:
    """Two renderers of a scene: one unmodified, one whose OpenGL calls are timed; what fills holes is timed in both."""

    def __init__(self, scene: DrawnScene, device: int | str | None, roots: list[Path] | None, stack: ExitStack) -> None:
        options: dict[str, Any] = {"device": device, "cache": default_folder(), "allowed_roots": roots}
        self.plain = stack.enter_context(Renderer(scene, **options))
        self.clock: Clock = stack.enter_context(opengl_calls())
        self._timed = stack.enter_context(Renderer(scene, **options))
        self._readback = Readback(self._timed.context)
        self._finish = GL.Gl(self._timed.context).glFinish
        self._fill = stack.enter_context(filling(self._finish))
        self.triangles = int(self.plain.info["triangles"])

    def apart(self, state: SceneState, camera: CameraSpec) -> tuple[Frame, dict[str, float]]:
        """Returns a frame, and the milliseconds of drawing, filling, readback, and of the OpenGL calls while drawing and filling."""
        self.clock.pop_ms()
        self._fill.pop_ms()
        began = time.perf_counter_ns()
        ((target, shots, _),) = self._timed.drawn(state, [camera])
        self._finish()
        drawn = time.perf_counter_ns()
        values, filling = {OPENGL: self.clock.pop_ms()}, self._fill.pop_ms()
        (frame,) = self._readback.frames(target, shots)
        values |= {"draw": (drawn - began) / 1e6 - filling, "read back": (time.perf_counter_ns() - drawn) / 1e6}
        return frame, values | ({"fill": filling} if camera.fill else {})


@contextmanager
def filling(finish: Callable[[], None]) -> Iterator[Clock]:
    """Times all filling of holes inside the block; ``finish`` waits for what is drawn before, which filling would wait for."""
    with calls_of(HoleFilling, "fill") as clock:
        timed = HoleFilling.fill

        def fill(self: HoleFilling, target: RenderTarget, image: TargetImage) -> None:
            finish()
            timed(self, target, image)

        HoleFilling.fill = fill  # type: ignore[method-assign]
        yield clock


def _with_physics(
    plan: Table1Plan,
    robot: Path,
    substeps: int,
    mode: Mode,
    pair: RendererPair,
    other: Callable[[int], Sequence[float]] | None,
    messages: Mapping[str, float],
) -> Iterable[Table1Row]:
    """Yields the rows of a mode: to the host, in lockstep if ``other`` makes its ticks, and for the fewest substeps to tensors."""
    loop = Loop(plan.scene, robot, substeps)
    try:
        loop.settle()
        camera = camera_of(loop.world.scene.robots[0].cameras[0], mode)
        frames = plan.frames if mode.outputs else plan.sensor_frames
        warm_up = max(WARM_UP, frames // 10)

        def state() -> SceneState:
            loop.step()
            return loop.read()

        def to_host() -> None:
            here = state()
            if camera is not None:
                pair.plain.render(here, [camera])

        def to_tensors() -> None:
            assert camera is not None
            synchronize(pair.plain.render_tensors(state(), [camera]))

        common: dict[str, Any] = {"way": IN_PROCESS, "mode": mode.name, "scene": plan.scene, "triangles": pair.triangles}
        common |= {"width": PHYSICS_SIZE[0], "height": PHYSICS_SIZE[1], "substeps": substeps}
        with calls_of(pybullet, "stepSimulation") as engine:
            parts = FrameStages(loop, camera, pair, engine)
            times, ticks = in_turns(to_host, parts.measure, frames, warm_up, other)
        stages, bounds = parts.result()
        here = row_of(times, to=HOST, stages=stages, bounds=bounds, **common)
        yield here
        if ticks:
            yield lockstep_row(ticks, here, messages)
        if camera is not None and substeps == min(plan.substeps):
            yield row_of(seconds_of(to_tensors, frames, warm_up), to=TENSOR, bounds=bounds, **common)
    finally:
        loop.close()


def camera_of(camera: CameraSpec, mode: Mode) -> CameraSpec | None:
    """Returns the camera with the outputs of a mode; None if the mode has none."""
    return replace(camera, outputs=mode.outputs, fill=mode.fill) if mode.outputs else None


def seconds_of(work: Callable[[], Any], count: int, warm_up: int) -> list[float]:
    """Returns the duration of each of ``count`` calls, seconds, after ``warm_up`` calls that do not count."""
    found = []
    for _ in range(count + warm_up):
        began = time.perf_counter()
        work()
        found.append(time.perf_counter() - began)
    return found[warm_up:]


def in_turns(
    whole: Callable[[], Any],
    apart: Callable[[], Any],
    count: int,
    warm_up: int,
    other: Callable[[int], Sequence[float]] | None = None,
) -> tuple[list[float], list[float]]:
    """Returns the durations of ``count`` calls of ``whole``, and of ``other``; blocks of both and of ``apart`` take turns.

    Other load on the machine then affects the frames and the limits that they are compared with alike.

    Args:
        whole: makes a frame.
        apart: makes a frame whose parts are measured.
        count: calls of ``whole`` that count.
        warm_up: calls before them.
        other: makes ``n`` frames in another configuration, and returns the duration of each, seconds.
    """
    found, others = seconds_of(whole, 0, warm_up), list[float]()
    if other is not None:
        other(warm_up)
    while len(found) < count:
        for _ in range(BLOCK // 3 + 1):
            apart()
        block = min(BLOCK, count - len(found))
        found += seconds_of(whole, block, 1)
        if other is not None:
            others += other(block)
    return found, others


class FrameStages:
    """Times the stages of a frame, each completed before the next, and the shares of Bullet and OpenGL."""

    def __init__(self, loop: Loop, camera: CameraSpec | None, pair: RendererPair, engine: Clock) -> None:
        self._loop, self._camera, self._pair, self._engine = loop, camera, pair, engine
        self._found: list[dict[str, float]] = []
        self._bytes = 0

    def measure(self) -> None:
        """Makes and times one frame."""
        self._engine.pop_ms()
        began = time.perf_counter_ns()
        self._loop.step()
        stepped = time.perf_counter_ns()
        state = self._loop.read()
        values = {
            "step": (stepped - began) / 1e6,
            "convert": (time.perf_counter_ns() - stepped) / 1e6,
            BULLET: self._engine.pop_ms(),
        }
        if self._camera is not None:
            frame, parts = self._pair.apart(state, self._camera)
            values |= parts
            self._bytes = bytes_of(frame)
        self._found.append(values)

    def result(self) -> tuple[dict[str, float], dict[str, float]]:
        """Returns the median milliseconds of each stage, and of the parts alone."""
        counted = self._found[2:] or self._found
        found = {name: float(np.median([values[name] for values in counted])) for name in counted[0]}
        return parted({**found, **({COPY: copy_ms(self._bytes)} if self._bytes else {})})


def parted(values: Mapping[str, float]) -> tuple[dict[str, float], dict[str, float]]:
    """Returns the stages and the limits, rounded."""
    alone = (BULLET, OPENGL, COPY)
    rounded = {name: round(value, 5) for name, value in values.items()}
    return {n: v for n, v in rounded.items() if n not in alone}, {n: v for n, v in rounded.items() if n in alone}


def bytes_of(frame: Frame) -> int:
    """Returns the size of the images of a frame, bytes."""
    return sum(image.nbytes for output in OUTPUTS if (image := getattr(frame, output)) is not None)


def _house(plan: Table1Plan, name: str) -> Iterable[Table1Row]:
    """Yields the rows of rendering a house along a fixed camera path, without physics."""
    scene = bench_scene(name)
    spec = load_scene(scene.path)
    width, height = HOUSE_SIZE
    path = [pose_of(T.ravel().tolist()) for T in camera_path(scene, plan.frames)]
    for mode in HOUSE_MODES:
        with ExitStack() as stack:
            pair = RendererPair(drawn_scene(spec, ()), plan.device, list(scene_roots(spec)), stack)
            fov_y = math.radians(FOV_Y_DEG)
            cameras = [
                CameraSpec("eye", "", pose, width, height, fov_y, near=0.05, far=100.0, outputs=mode.outputs, fill=mode.fill)
                for pose in path
            ]
            several = iter(cameras * 2)
            every = iter(cameras[:WARM_UP] + cameras * 2)
            found: list[tuple[Frame, dict[str, float]]] = []
            times, _ = in_turns(
                lambda: pair.plain.render(STILL, [next(every)]),  # noqa: B023
                lambda: found.append(pair.apart(STILL, next(several))),  # noqa: B023
                len(cameras),
                len(cameras[:WARM_UP]),
            )
            middle = {name: float(np.median([values[name] for _, values in found[2:]])) for name in found[0][1]}
            stages, bounds = parted({**middle, COPY: copy_ms(bytes_of(found[0][0]))})
            common: dict[str, Any] = {"way": IN_PROCESS, "mode": mode.name, "scene": name, "triangles": pair.triangles}
            common |= {"width": width, "height": height, "substeps": 0, "bounds": bounds}
            yield row_of(times, to=HOST, stages=stages, **common)
            every = iter(cameras[:WARM_UP] + cameras)

            def tensors() -> None:
                synchronize(pair.plain.render_tensors(STILL, [next(every)]))  # noqa: B023

            yield row_of(seconds_of(tensors, len(cameras), len(cameras[:WARM_UP])), to=TENSOR, **common)
