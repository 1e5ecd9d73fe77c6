"""Environment steps per second for reinforcement learning: N processes, or N environments in one process with one batched renderer.

The rate with one renderer is an upper bound: all cameras are rendered in the scene state of the first environment, each at the
pose that it has in its own environment. Loose objects of the other environments are neither loaded nor rendered; what remains is the work of every
batched renderer.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose, pose_from_matrix
from gibson_sim.tasks.controls import Controls
from gibson_sim.tasks.observing import own_state
from gibson_sim.tasks.pictures import FARTHEST_DEPTH, TaskCamera
from gibson_sim.tasks.registry import task_of
from gibson_sim.tasks.run import CONTROL_HZ, STEP_HZ, TaskRun
from gibson_sim.types import CameraSpec
from gibson_sim_bench import timing
from gibson_sim_bench.reports.render import table
from gibson_sim_bench.ros import without_nan
from gibson_sim_bench.tasks import OBSERVATIONS

PROCESSES, ONE_RENDERER = "a process each", "one process, one renderer"
EPISODE = 100
"""Steps after which all environments are reset, as during training; the resets count."""


@dataclass(frozen=True, slots=True)
class LearningPlan:
    """Cases of the measurement, and their duration."""

    task: str = "point-goal"
    scene: str = ""
    """Name or path of the scene; empty = the default of the task."""
    observations: tuple[str, ...] = OBSERVATIONS
    environments: tuple[int, ...] = (1, 2, 4, 8)
    batched: bool = True
    """Whether to measure also one renderer for all environments."""
    seconds: float = 20.0
    """Wall time of each case, seconds."""
    size: int = 128
    """Width and height of images, pixels."""
    control_hz: int = CONTROL_HZ
    step_hz: int = STEP_HZ


@dataclass(frozen=True, slots=True)
class LearningRow:
    """A number of environments in one configuration."""

    way: str
    """Configuration: ``PROCESSES`` or ``ONE_RENDERER``."""
    observation: str
    environments: int
    steps_per_s: float
    """Steps per second of all environments together, resets included."""
    processor_ms: float
    """Processor time of a step of one environment, all threads and processes, milliseconds. It depends little on other load."""


@dataclass(frozen=True, slots=True)
class LearningReport:
    """The measurements, with the machine."""

    date: str
    version: str
    machine: str
    cores: int
    load: float
    plan: LearningPlan
    rows: tuple[LearningRow, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Returns the report as JSON types."""
        found: dict[str, Any] = without_nan(asdict(self))
        return found


def measure(plan: LearningPlan, progress: Callable[[str], None] = lambda line: None) -> LearningReport:
    """Returns the measurements.

    Args:
        plan: cases and their duration.
        progress: called with one line of progress.

    Raises:
        ConfigError: a value of the plan is not allowed.
        GibsonSimError: Gymnasium is not installed, or a task cannot run.
    """
    task_of(plan.task)
    unknown = [name for name in plan.observations if name not in OBSERVATIONS]
    if unknown or min(plan.environments) < 1 or plan.seconds <= 0.0:
        raise ConfigError(
            f"observations are {list(plan.observations)}, environments {list(plan.environments)} and seconds {plan.seconds:g}, "
            "must be of state, rgbd, 1 or more, and above 0"
        )
    if importlib.util.find_spec("gymnasium") is None:
        raise GibsonSimError("environments need Gymnasium: pip install 'gibson_sim[gym]'")
    rows: list[LearningRow] = []
    facts = (timing.now(), timing.version(), timing.machine(), timing.cores(), timing.load())
    for observation in plan.observations:
        for count in plan.environments:
            progress(f"{observation}, {count}: {PROCESSES}")
            rows.append(_processes(plan, observation, count))
            if plan.batched and observation == "rgbd":
                progress(f"{observation}, {count}: {ONE_RENDERER}")
                rows.append(_one_renderer(plan, count))
    return LearningReport(*facts, plan=plan, rows=tuple(rows))


def _processes(plan: LearningPlan, observation: str, count: int) -> LearningRow:
    from gibson_sim.tasks.environments import in_processes

    envs = in_processes(
        count,
        plan.task,
        observation=observation,
        scene=plan.scene,
        size=(plan.size, plan.size),
        control_hz=plan.control_hz,
        step_hz=plan.step_hz,
    )
    try:
        envs.action_space.seed(0)

        def cpu_s() -> float:
            return time.process_time() + sum(timing.process_cpu_s(process.pid) for process in envs.processes)

        return _row(
            plan, PROCESSES, observation, count, envs.reset, lambda: envs.step(envs.action_space.sample()), cpu_s
        )  # fmt: skip
    finally:
        envs.close()


def _one_renderer(plan: LearningPlan, count: int) -> LearningRow:
    rng = np.random.default_rng(0)
    seeds = iter(range(10**9))
    with ExitStack() as stack:
        task = task_of(plan.task)
        runs = [
            stack.enter_context(TaskRun(task, scene=plan.scene, control_hz=plan.control_hz, step_hz=plan.step_hz))
            for _ in range(count)
        ]
        controls = [Controls(run.robot, 1.0 / plan.control_hz) for run in runs]
        camera = TaskCamera(runs[0], (plan.size, plan.size)).camera

        def observe() -> list[Any]:
            images = render_batched(runs, camera)
            return [
                (rgbd, own_state(control.layout, run.episode, run.observation))
                for rgbd, control, run in zip(images, controls, runs, strict=True)
            ]

        def reset() -> None:
            for control, run in zip(controls, runs, strict=True):
                control.begin(run.reset(next(seeds)))
            observe()

        def step() -> None:
            for control, run in zip(controls, runs, strict=True):
                run.step(control.action(rng.uniform(-1.0, 1.0, control.size), run.observation))
            observe()

        return _row(plan, ONE_RENDERER, "rgbd", count, reset, step, time.process_time)


def render_batched(runs: Sequence[TaskRun], camera: CameraSpec) -> list[tuple[NDArray[np.uint8], NDArray[np.float32]]]:
    """Returns RGB (H, W, 3) and depth (H, W, 1), metres, of each run, all rendered in the scene state of the first run and read back at once.

    Args:
        runs: runs of one task.
        camera: camera of the robot; its pose in each run follows the robot of that run.
    """
    first = runs[0]
    T_first_world = np.linalg.inv(_link(first, camera.link))
    T_link_camera = matrix_from_pose(camera.pose)
    cameras = [
        replace(camera, name=f"camera_{k}", pose=pose_from_matrix(T_first_world @ _link(run, camera.link) @ T_link_camera))
        for k, run in enumerate(runs)
    ]
    images = []
    for frame in first.simulation.renderer.render(first.world.state(), cameras):
        assert frame.rgb is not None and frame.depth is not None
        depth = np.nan_to_num(frame.depth, nan=FARTHEST_DEPTH, posinf=FARTHEST_DEPTH, neginf=0.0)
        images.append((frame.rgb, np.clip(depth, 0.0, FARTHEST_DEPTH)[..., None]))
    return images


def _link(run: TaskRun, name: str) -> Mat4:
    """Returns T_world_link in the latest observation."""
    return matrix_from_pose(run.observation.links[name])


def _row(
    plan: LearningPlan,
    configuration: str,
    observation: str,
    count: int,
    reset: Callable[[], Any],
    step: Callable[[], Any],
    cpu_s: Callable[[], float],
) -> LearningRow:
    """Returns the row of a configuration: ``reset`` resets and ``step`` steps all environments, ``cpu_s`` returns their processor time, seconds."""
    reset()
    step()
    steps, elapsed, began, cpu_before = 0, 0.0, time.perf_counter(), cpu_s()
    while elapsed < plan.seconds:
        if steps % EPISODE == 0:
            reset()
        step()
        steps += 1
        elapsed = time.perf_counter() - began
    return LearningRow(configuration, observation, count, steps * count / elapsed, 1e3 * (cpu_s() - cpu_before) / (steps * count))


def report_text(report: LearningReport, *, markdown: bool = False) -> str:
    """Returns the whole report, plain for the terminal or as Markdown."""
    plan = report.plan
    where = f"{plan.task} in {plan.scene}" if plan.scene else plan.task
    lines = [
        f"{report.machine}; {report.cores} cores usable, load {report.load:g}; Gibson Sim {report.version}; {report.date[:10]}.",
        f"{where}; {plan.control_hz} actions and {plan.step_hz} physics steps per second of simulation time; random actions, resets "
        f"after {EPISODE} steps; images {plan.size}x{plan.size}.",
    ]
    head = ("observation", "environments", "configuration", "steps/s", "CPU ms per step")
    body = [
        (row.observation, str(row.environments), row.way, f"{row.steps_per_s:.0f}", f"{row.processor_ms:.2f}")
        for row in report.rows
    ]
    return "\n".join([*(f"- {line}" if markdown else line for line in lines), "", table(head, body, markdown, left=(0, 2))])
