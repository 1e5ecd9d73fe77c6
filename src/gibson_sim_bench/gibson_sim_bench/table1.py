"""The paper's table in this process: physics, sensors and images, one after the other, each stage timed; and rendering only.

Protocol: a differential-drive robot of a TurtleBot's size with one camera, field of view 90 degrees; physics steps of 1/240 s; random
velocity commands, ten per second of simulation time, from one seed; warm-up frames, which do not count. A frame is complete when all its
outputs are in host memory, or in synchronized tensors.
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
from gibson_sim.render.draw.effects import Average
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.render.filling.hole_filling import HoleFilling
from gibson_sim.render.readback.frames import Readback, TargetImage
from gibson_sim.render.renderer import MeshFiles, Renderer, RenderOptions
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import DrawnScene, drawn_scene
from gibson_sim.types import OUTPUTS, CameraSpec, Frame, SceneState
from gibson_sim_bench import timing
from gibson_sim_bench.loop import Loop
from gibson_sim_bench.own_renderer import STILL, pose_of
from gibson_sim_bench.protocol import BLOCK, FOV_Y_DEG, PARTS, RENDERING_MODES, RENDERING_ONLY, ROBOT, WARM_UP, Table1Plan
from gibson_sim_bench.reports.paper import MODE_GROUPS, PHYSICS_SIZE, RENDERING_SIZE, Mode
from gibson_sim_bench.rows import BULLET, COPY, HOST, IN_PROCESS, OPENGL, TENSOR, Table1, Table1Row, lockstep_row, row_of
from gibson_sim_bench.scenes.bench_scenes import bench_scene, camera_path
from gibson_sim_bench.tensors import synchronize


@dataclass(frozen=True, slots=True)
class LockstepRunner:
    """Runs simulations in lockstep, whose ticks are interleaved with the frames in this process."""

    start: Callable[[int, Sequence[Mode]], AbstractContextManager[Callable[[int, int], Sequence[float]]]]
    """Starts a simulation: (substeps, modes) -> context manager of a function that makes ticks of one mode: (index of the mode, count) ->
    seconds of each tick; empty = failed."""
    message_ms: Mapping[str, Mapping[str, float]]
    """Milliseconds of the messages, measured alone, by mode and stage."""


def measure(
    plan: Table1Plan, robot: Path, progress: Callable[[str], None] = lambda line: None, lockstep: LockstepRunner | None = None
) -> Table1:
    """Returns the measurements in this process, and those in lockstep that are interleaved with them.

    Args:
        plan: what to measure.
        robot: file of the robot, as ``write_robot`` writes it.
        progress: called with one line of progress.
        lockstep: runs the rows in lockstep; None = no such rows.

    Raises:
        GibsonSimError: a scene cannot be loaded, or there is no OpenGL device.
    """
    began = timing.facts()
    rows: list[Table1Row] = []
    with ExitStack() as stack:
        loop = Loop(plan.scene, robot, 1)
        stack.callback(loop.close)
        scene = drawn_scene(loop.world.scene, loop.world.links)
        pair = RendererPair(scene, plan.device, None, stack)
        if IN_PROCESS in plan.parts:
            for substeps, modes in ((k, group) for k in plan.substeps for group in MODE_GROUPS):
                with ExitStack() as running:
                    ticks = running.enter_context(lockstep.start(substeps, modes)) if lockstep else None
                    for index, mode in enumerate(modes):
                        progress(f"{'in process and in lockstep' if ticks else 'in process'}: {mode.name}, {substeps} substeps")
                        lockstep_ticks = partial(ticks, index) if ticks else None
                        rows += _with_physics(
                            plan, robot, substeps, mode, pair, lockstep_ticks, lockstep.message_ms[mode.name] if lockstep else {}
                        )
        info, tensors_on = pair.plain.info, pair.plain.tensors_on
    for name in plan.scan_scenes if RENDERING_ONLY in plan.parts else ():
        progress(f"rendering only: {name}")
        rows += _rendering_only(plan, name)
    facts = replace(began, gpu=str(info["renderer"]), driver=str(info["version"]))
    in_order = sorted(rows, key=lambda row: PARTS.index(row.way))
    return Table1(facts, f"{ROBOT}, {FOV_Y_DEG:g} degrees", tensors_on, tuple(in_order))


class RendererPair:
    """Two renderers of a scene: one unmodified, one whose OpenGL calls are timed; hole filling is timed in both."""

    def __init__(self, scene: DrawnScene, device: int | str | None, roots: list[Path] | None, stack: ExitStack) -> None:
        meshes, options = MeshFiles(allowed_roots=roots, cache=default_folder()), RenderOptions(device=device)
        self.plain = stack.enter_context(Renderer(scene, meshes, options))
        self.clock: Clock = stack.enter_context(_opengl_calls())
        self._timed = stack.enter_context(Renderer(scene, meshes, options))
        self._readback = Readback(self._timed.context)
        self._finish = GL.Gl(self._timed.context).glFinish
        self._fill = stack.enter_context(timed_hole_filling(self._finish))
        self.triangles = int(self.plain.info["triangles"])

    def render_in_stages(self, state: SceneState, camera: CameraSpec) -> tuple[Frame, dict[str, float]]:
        """Returns a frame, and the milliseconds of rendering, hole filling, readback, and of the OpenGL calls in the first two."""
        self.clock.pop_ms()
        self._fill.pop_ms()
        began = time.perf_counter_ns()
        values: dict[str, float] = {}
        frames: list[Frame] = []

        def read(target: RenderTarget, shots: list[TargetImage], _: list[int]) -> None:
            self._finish()
            drawn = time.perf_counter_ns()
            values[OPENGL], filling = self.clock.pop_ms(), self._fill.pop_ms()
            frames.extend(self._readback.frames(target, shots))
            values["draw"], values["read back"] = (drawn - began) / 1e6 - filling, (time.perf_counter_ns() - drawn) / 1e6
            values.update({"fill": filling} if camera.fill else {})

        self._timed.draw(state, [camera], None, read)
        (frame,) = frames
        return frame, values


@contextmanager
def timed_hole_filling(finish: Callable[[], None]) -> Iterator[Clock]:
    """Times hole filling inside the block; ``finish`` completes OpenGL's work before it, which it would wait for, and that of its own."""
    clock, original = Clock(), HoleFilling.fill

    def finished(self: HoleFilling, target: RenderTarget, image: TargetImage, average: Average | None = None) -> None:
        original(self, target, image, average)
        finish()

    timed = clock.timed(finished)

    def fill(self: HoleFilling, target: RenderTarget, image: TargetImage, average: Average | None = None) -> None:
        finish()
        timed(self, target, image, average)

    HoleFilling.fill = fill  # type: ignore[method-assign]
    try:
        yield clock
    finally:
        HoleFilling.fill = original  # type: ignore[method-assign]


def _with_physics(
    plan: Table1Plan,
    robot: Path,
    substeps: int,
    mode: Mode,
    pair: RendererPair,
    lockstep_ticks: Callable[[int], Sequence[float]] | None,
    message_ms: Mapping[str, float],
) -> Iterable[Table1Row]:
    """Yields the rows of a mode: to the host, in lockstep if ``lockstep_ticks`` is given, and to tensors for the fewest substeps."""
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
            current = state()
            if camera is not None:
                pair.plain.render(current, [camera])

        def to_tensors() -> None:
            assert camera is not None
            synchronize(pair.plain.render_tensors(state(), [camera]))

        common: dict[str, Any] = {"way": IN_PROCESS, "mode": mode.name, "scene": plan.scene, "triangles": pair.triangles}
        common |= {"width": PHYSICS_SIZE[0], "height": PHYSICS_SIZE[1], "substeps": substeps}
        with calls_of(pybullet, "stepSimulation") as engine:
            stages_timer = FrameStages(loop, camera, pair, engine)
            times, ticks = measure_interleaved(to_host, stages_timer.measure, frames, warm_up, lockstep_ticks)
        stages, bounds = stages_timer.result()
        row = row_of(times, to=HOST, stages=stages, bounds=bounds, **common)
        yield row
        if ticks:
            yield lockstep_row(ticks, row, message_ms)
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


def measure_interleaved(
    frame: Callable[[], Any],
    staged_frame: Callable[[], Any],
    count: int,
    warm_up: int,
    other_frames: Callable[[int], Sequence[float]] | None = None,
) -> tuple[list[float], list[float]]:
    """Returns the durations of ``count`` calls of ``frame``, and of ``other_frames``; blocks of both and of ``staged_frame`` are interleaved.

    Load on the machine then affects the frames and their limits alike.

    Args:
        frame: makes a frame.
        staged_frame: makes a frame whose stages are timed separately.
        count: number of calls of ``frame`` that count.
        warm_up: number of calls before them.
        other_frames: makes ``n`` frames in another configuration, and returns the duration of each, seconds.
    """
    found, others = seconds_of(frame, 0, warm_up), list[float]()
    if other_frames is not None:
        other_frames(warm_up)
    while len(found) < count:
        for _ in range(BLOCK // 3 + 1):
            staged_frame()
        block = min(BLOCK, count - len(found))
        found += seconds_of(frame, block, 1)
        if other_frames is not None:
            others += other_frames(block)
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
            frame, parts = self._pair.render_in_stages(state, self._camera)
            values |= parts
            self._bytes = bytes_of(frame)
        self._found.append(values)

    def result(self) -> tuple[dict[str, float], dict[str, float]]:
        """Returns the median milliseconds of each stage, and of each part measured alone."""
        counted = self._found[2:] or self._found
        found = {name: float(np.median([values[name] for values in counted])) for name in counted[0]}
        return split_bounds({**found, **({COPY: copy_ms(self._bytes)} if self._bytes else {})})


def split_bounds(values: Mapping[str, float]) -> tuple[dict[str, float], dict[str, float]]:
    """Returns the stages and the parts measured alone, rounded."""
    alone = (BULLET, OPENGL, COPY)
    rounded = {name: round(value, 5) for name, value in values.items()}
    return {n: v for n, v in rounded.items() if n not in alone}, {n: v for n, v in rounded.items() if n in alone}


def bytes_of(frame: Frame) -> int:
    """Returns the size of the images of a frame, bytes."""
    return sum(image.nbytes for output in OUTPUTS if (image := getattr(frame, output)) is not None)


def _rendering_only(plan: Table1Plan, name: str) -> Iterable[Table1Row]:
    """Yields the rows of rendering a scene along a fixed camera path, without physics."""
    scene = bench_scene(name)
    spec = load_scene(scene.path)
    width, height = RENDERING_SIZE
    path = [pose_of(T.ravel().tolist()) for T in camera_path(scene, plan.frames)]
    for mode in RENDERING_MODES:
        with ExitStack() as stack:
            pair = RendererPair(drawn_scene(spec, ()), plan.device, list(scene_roots(spec)), stack)
            fov_y = math.radians(FOV_Y_DEG)
            cameras = [
                CameraSpec("eye", "", pose, width, height, fov_y, near=0.05, far=100.0, outputs=mode.outputs, fill=mode.fill)
                for pose in path
            ]
            staged = iter(cameras * 2)
            upcoming = iter(cameras[:WARM_UP] + cameras * 2)
            found: list[tuple[Frame, dict[str, float]]] = []
            times, _ = measure_interleaved(
                lambda: pair.plain.render(STILL, [next(upcoming)]),  # noqa: B023
                lambda: found.append(pair.render_in_stages(STILL, next(staged))),  # noqa: B023
                len(cameras),
                len(cameras[:WARM_UP]),
            )
            middle = {name: float(np.median([values[name] for _, values in found[2:]])) for name in found[0][1]}
            stages, bounds = split_bounds({**middle, COPY: copy_ms(bytes_of(found[0][0]))})
            common: dict[str, Any] = {"way": IN_PROCESS, "mode": mode.name, "scene": name, "triangles": pair.triangles}
            common |= {"width": width, "height": height, "substeps": 0, "bounds": bounds}
            yield row_of(times, to=HOST, stages=stages, **common)
            upcoming = iter(cameras[:WARM_UP] + cameras)

            def tensors() -> None:
                synchronize(pair.plain.render_tensors(STILL, [next(upcoming)]))  # noqa: B023

            yield row_of(seconds_of(tensors, len(cameras), len(cameras[:WARM_UP])), to=TENSOR, **common)


@dataclass(slots=True)
class Clock:
    """Accumulates time."""

    ns: int = 0

    def pop_ms(self) -> float:
        """Returns the accumulated milliseconds, and resets them to 0."""
        elapsed, self.ns = self.ns / 1e6, 0
        return elapsed

    def timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Returns a wrapper of a function that adds the duration of each call."""

        def call(*arguments: Any, **named: Any) -> Any:
            began = time.perf_counter_ns()
            try:
                return function(*arguments, **named)
            finally:
                self.ns += time.perf_counter_ns() - began

        return call


@contextmanager
def calls_of(owner: Any, name: str) -> Iterator[Clock]:
    """Times all calls of ``owner.name`` inside the block."""
    clock, original = Clock(), getattr(owner, name)
    setattr(owner, name, clock.timed(original))
    try:
        yield clock
    finally:
        setattr(owner, name, original)


@contextmanager
def _opengl_calls() -> Iterator[Clock]:
    """Times all OpenGL calls of the renderers that are created inside the block, also after it."""
    clock, original = Clock(), GL.Gl

    class Timed(original):  # type: ignore[misc, valid-type]
        def __getattr__(self, name: str) -> Callable[..., Any]:
            function = clock.timed(super().__getattr__(name))
            setattr(self, name, function)
            return function

    GL.Gl = Timed  # type: ignore[misc]
    try:
        yield clock
    finally:
        GL.Gl = original  # type: ignore[misc]


def copy_ms(size_bytes: int, times: int = 50) -> float:
    """Returns the median time of copying ``size_bytes``, milliseconds: a lower bound of the readback of a frame."""
    source, target = np.ones(max(1, size_bytes), dtype=np.uint8), np.empty(max(1, size_bytes), dtype=np.uint8)
    found = []
    for _ in range(times):
        began = time.perf_counter_ns()
        np.copyto(target, source)
        found.append((time.perf_counter_ns() - began) / 1e6)
    return float(np.median(found))
