"""Scaling of time and memory with triangles, resolution, cameras, bodies, robots, environments per process, and processes; the report on it.

Every case runs in its own process, so that its memory can be measured.
"""

from __future__ import annotations

import logging
import math
import multiprocessing
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from gibson_sim import interrupts
from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.maps.free_poses import random_free_poses
from gibson_sim.maps.placement import populate
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import MeshFiles, Renderer
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import SceneSpec, drawn_scene
from gibson_sim.simulation import Simulation
from gibson_sim.tasks.episode import Item, item_body
from gibson_sim.tasks.ground import ground_of
from gibson_sim.types import CameraSpec
from gibson_sim_bench import timing
from gibson_sim_bench.memory import resident_mb
from gibson_sim_bench.own_renderer import STILL, pose_of
from gibson_sim_bench.reports.render import table
from gibson_sim_bench.ros import without_nan
from gibson_sim_bench.scenes.bench_scenes import bench_scene, camera_path
from gibson_sim_bench.tasks import LOOSE_MODELS
from gibson_sim_bench.timing import FIVE, Facts

STEP_HZ = 240
SCENE, ROBOT = "arena", "gibson_bot"
ROOMS = "rooms:100k"
SIZE = 256
"""Width and height of images unless resolution is the varied quantity, pixels."""
REST_S = 2.0
"""Simulation time for bodies to come to rest, seconds."""


@dataclass(frozen=True, slots=True)
class ScalingKind:
    """A varied quantity and its values."""

    name: str
    values: tuple[int, ...]
    quick: tuple[int, ...]
    what: str
    """The timed operation, for the report."""


KINDS = (
    ScalingKind("triangles", (20_000, 100_000, 500_000, 1_000_000), (20_000, 100_000), "an image of 256x256, five outputs"),
    ScalingKind("resolution", (128, 256, 512, 1024), (128, 256), "an image of N x N pixels, five outputs, 100 k triangles"),
    ScalingKind("cameras", (1, 4, 16, 64), (1, 4), "N images of 128x128, RGB and depth, 100 k triangles"),
    ScalingKind(
        "bodies", (0, 10, 30, 100), (0, 10), "a physics step with N loose objects at rest and one robot, and all link poses"
    ),
    ScalingKind("robots", (1, 2, 4, 8), (1, 2), "a physics step with N driving robots, and all link poses"),
    ScalingKind(
        "environments", (1, 2, 4), (1, 2), "a step of each environment in one process: four physics steps, 256x256 RGB and depth"
    ),
    ScalingKind("processes", (1, 2, 4), (1, 2), "the same step in each of N processes with one environment"),
)


@dataclass(frozen=True, slots=True)
class ScalingRow:
    """One case."""

    kind: str
    value: int
    ms: float
    """Median duration, milliseconds; for environments and processes, of one step of all of them."""
    per_s: float
    """Rate, 1/s; for environments and processes, of all steps together."""
    mb: float
    """Resident memory of all processes of the case, MB."""


@dataclass(frozen=True, slots=True)
class ScalingReport:
    """The measurements, with the machine."""

    facts: Facts
    rows: tuple[ScalingRow, ...] = ()
    left_out: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Returns the report as JSON types."""
        figures = [{"name": f"{r.kind}: {r.value}", "value": r.per_s, "unit": "1/s", "better": "more"} for r in self.rows]
        figures += [{"name": f"memory, {r.kind}: {r.value}", "value": r.mb, "unit": "MB", "better": "less"} for r in self.rows]
        found: dict[str, Any] = without_nan({"kind": "scaling", **asdict(self), "figures": figures})
        return found


def report_of(read: dict[str, Any]) -> ScalingReport:
    """Returns a report from its JSON."""
    return ScalingReport(Facts(**read["facts"]), tuple(ScalingRow(**row) for row in read["rows"]), tuple(read["left_out"]))


def measure(
    kinds: Sequence[ScalingKind], *, quick: bool = False, progress: Callable[[str], None] = lambda line: None
) -> ScalingReport:
    """Returns the measurements; a case that fails is left out, and the report says why.

    Args:
        kinds: the quantities to vary.
        quick: whether to measure fewer and smaller cases.
        progress: called with one line of progress.
    """
    report = ScalingReport(timing.facts())
    rows: list[ScalingRow] = []
    left_out: list[str] = []
    frames = 12 if quick else 40
    for kind in kinds:
        for value in kind.quick if quick else kind.values:
            progress(f"{kind.name}: {value:,}")
            try:
                rows.append(_in_processes(kind.name, value, frames))
            except GibsonSimError as error:
                left_out.append(f"{kind.name}, {value}: {error}")
    return replace(report, rows=tuple(rows), left_out=tuple(left_out))


def _in_processes(kind: str, value: int, frames: int) -> ScalingRow:
    """Returns the row of a case, measured in its own process, or in ``value`` processes."""
    count = value if kind == "processes" else 1
    # Spawned: a forked process would share this one's memory and OpenGL context.
    with ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), initializer=interrupts.end_silently) as pool:
        with interrupts.held_back():  # Ctrl-C also reaches the children
            jobs = [pool.submit(_case, kind, value, frames) for _ in range(count)]
        found = [job.result() for job in jobs]
    ms = float(np.median([ms for ms, _ in found]))
    steps = count if kind == "processes" else value if kind == "environments" else 1
    return ScalingRow(kind, value, round(ms, 4), round(1e3 * steps / ms, 2), round(sum(mb for _, mb in found), 1))


def _case(kind: str, value: int, frames: int) -> tuple[float, float]:
    """Returns milliseconds and MB of a case, measured in this process."""
    logging.disable(logging.WARNING)
    with ExitStack() as stack:
        if kind in ("triangles", "resolution", "cameras"):
            work = _images(kind, value, frames, stack)
        elif kind in ("bodies", "robots"):
            work = _physics(_with_bodies(value) if kind == "bodies" else _with_robots(value), stack)
        else:
            steps = [_environment(stack) for _ in range(value if kind == "environments" else 1)]
            work = lambda: [step() for step in steps]  # noqa: E731
        seconds = []
        for _ in range(frames + 5):
            began = time.perf_counter()
            work()
            seconds.append(time.perf_counter() - began)
        return 1e3 * float(np.median(seconds[5:])), resident_mb()


def _images(kind: str, value: int, frames: int, stack: ExitStack) -> Callable[[], Any]:
    scene = bench_scene(f"rooms:{value}" if kind == "triangles" else ROOMS)
    spec = load_scene(scene.path)
    renderer = stack.enter_context(
        Renderer(drawn_scene(spec, ()), meshes=MeshFiles(allowed_roots=scene_roots(spec), cache=default_folder()))
    )
    views = value if kind == "cameras" else 1
    size = {"resolution": value, "cameras": 128}.get(kind, SIZE)
    path = [pose_of(T.ravel().tolist()) for T in camera_path(scene, max(frames, views) + 5)]
    base = CameraSpec("eye", "", width=size, height=size, fov_y=math.radians(90.0), near=0.05, far=100.0)
    base = replace(base, outputs=("rgb", "depth") if kind == "cameras" else FIVE)
    frame = iter(range(10**9))

    def work() -> Any:
        k = next(frame)
        cameras = [replace(base, name=f"eye_{v}", pose=path[(k + v * len(path) // views) % len(path)]) for v in range(views)]
        return renderer.render(STILL, cameras)

    return work


def _physics(scene: SceneSpec, stack: ExitStack) -> Callable[[], Any]:
    sim = stack.enter_context(Simulation(scene, None, step_hz=STEP_HZ))
    world = sim.world  # the steps of the world measure no sensors
    world.step(round(REST_S * STEP_HZ))
    for name in sim.robots:
        sim.command(linear=0.1, angular=0.8, robot=name)

    def work() -> Any:
        world.step()
        return world.state()

    return work


def _with_bodies(count: int) -> SceneSpec:
    ground = ground_of(SCENE, ROBOT)
    poses = random_free_poses(ground.floor, count + 1, np.random.default_rng(0), clearance=0.1, spacing=0.25)
    items = [item_body(Item(f"loose_{k}", LOOSE_MODELS[k % len(LOOSE_MODELS)], pose)) for k, pose in enumerate(poses[1:])]
    return replace(ground.scene, robots=(replace(ground.robot, start=poses[0]),), bodies=(*ground.scene.bodies, *items))


def _with_robots(count: int) -> SceneSpec:
    ground = ground_of(SCENE, ROBOT)
    poses = random_free_poses(ground.floor, count, np.random.default_rng(0), clearance=0.3, spacing=0.8)
    robots = ",".join(f"robot_{k}={ROBOT}" for k in range(count))
    scene = populate(SCENE, robots if count > 1 else ROBOT, "")
    return replace(scene, robots=tuple(replace(r, start=pose) for r, pose in zip(scene.robots, poses, strict=True)))


def _environment(stack: ExitStack) -> Callable[[], Any]:
    """Returns a function that makes one step of an environment: the scene ``flat`` with a robot and its camera."""
    sim = stack.enter_context(Simulation("flat", ROBOT, step_hz=STEP_HZ))
    camera = replace(sim.cameras[0], width=SIZE, height=SIZE, outputs=("rgb", "depth"))
    sim.command(linear=0.1, angular=0.8)

    def work() -> Any:
        sim.world.step(4)
        return sim.render(camera)

    return work


def kinds_of(text: str) -> tuple[ScalingKind, ...]:
    """Returns the quantities of a comma-separated list of names; empty = all.

    Raises:
        ConfigError: a name is unknown.
    """
    names = [name for name in text.split(",") if name]
    known = {kind.name: kind for kind in KINDS}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ConfigError(f"--only: {', '.join(unknown)} must be of {', '.join(known)}")
    return tuple(known[name] for name in names) or KINDS


def report_text(report: ScalingReport, *, markdown: bool = False) -> str:
    """Returns the whole report."""
    lines = [report.facts.text, *(f"Left out: {line}" for line in report.left_out)]
    parts = ["\n".join(f"- {line}" if markdown else line for line in lines)]
    for kind in KINDS:
        rows = [(f"{r.value:,}", f"{r.ms:.3g}", f"{r.per_s:,.0f}", f"{r.mb:,.0f}") for r in report.rows if r.kind == kind.name]
        if rows:
            parts += [f"{kind.name.capitalize()}: {kind.what}.", table((kind.name, "ms", "per s", "MB"), rows, markdown, left=())]
    return "\n\n".join(parts)
