"""Speed of tasks: environment steps per second, the duration of their stages, and the cost of loose objects in a home.

Several processes are measured with Gymnasium's vector environments, which training uses; without Gymnasium they are left out.
"""

from __future__ import annotations

import importlib.util
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.maps.free_poses import random_free_poses
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.tasks.controls import Controls
from gibson_sim.tasks.episode import Item, item_body
from gibson_sim.tasks.ground import ground_of
from gibson_sim.tasks.observing import full_state
from gibson_sim.tasks.pictures import TaskCamera
from gibson_sim.tasks.registry import TASKS, task_of
from gibson_sim.tasks.run import CONTROL_HZ, STEP_HZ, TaskRun
from gibson_sim_bench import timing
from gibson_sim_bench.reports.render import table
from gibson_sim_bench.ros import PerformanceTarget, without_nan

OBSERVATIONS = ("state", "rgbd")
WARM_UP = 10
"""Steps of the warm-up, which do not count."""
LOOSE_MODELS = (
    "box_small",
    "book_a",
    "bottle_water",
    "can_soda",
    "mug",
    "toy_ball",
    "fruit_apple",
    "box_cereal",
    "basket",
    "stool",
)
LOOSE_OBJECTS, REST_S, MOVING_S = 50, 4.0, 2.0
"""Number of loose objects; simulation time for them to come to rest, seconds; measured simulation time, seconds."""
REAL_TIME, REAL_TIME_RGBD = 10.0, 3.0
"""Targets for two cores without a GPU: real-time factor without images, and with 256x256 RGB-D."""


@dataclass(frozen=True, slots=True)
class TaskPlan:
    """Tasks and number of measurements."""

    tasks: tuple[str, ...] = tuple(TASKS)
    observations: tuple[str, ...] = OBSERVATIONS
    processes: tuple[int, ...] = (1, 2)
    scene: str = ""
    """Scene of all tasks; empty = the default of each task."""
    steps: int = 200
    size: int = 256
    """Width and height of images, pixels."""
    loose_scene: str = "flat"
    """Scene with loose objects; empty = not measured."""


@dataclass(frozen=True, slots=True)
class TaskRow:
    """One task with one kind of observation in a number of processes."""

    task: str
    scene: str
    observation: str
    processes: int
    steps_per_s: float
    """Median rate, 1/s, of all processes together."""
    physics_ms: float
    """Median time of physics per step; this and the following are NaN for several processes."""
    judge_ms: float
    """Median time of state, contacts, metrics and success per step."""
    observe_ms: float
    """Median time of the observation per step: the array, or the images."""
    reset_ms: float
    """Median time of a reset."""

    @property
    def real_time(self) -> float:
        """Real-time factor."""
        return self.steps_per_s / CONTROL_HZ


@dataclass(frozen=True, slots=True)
class LooseRow:
    """Physics of a home with a robot and loose objects."""

    scene: str
    things: int
    """Number of loose objects."""
    what: str
    """Their motion: ``none``, ``at rest`` or ``moving``."""
    real_time: float
    """Real-time factor."""


@dataclass(frozen=True, slots=True)
class TaskReport:
    """The measurements, with the machine."""

    date: str
    version: str
    machine: str
    cores: int
    load: float
    step_hz: int = STEP_HZ
    control_hz: int = CONTROL_HZ
    size: int = 256
    rows: tuple[TaskRow, ...] = ()
    loose: tuple[LooseRow, ...] = ()
    left_out: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Returns the report as JSON types; NaN becomes null."""
        found: dict[str, Any] = without_nan(asdict(self))
        return found


def measure(plan: TaskPlan, progress: Callable[[str], None] = lambda line: None) -> TaskReport:
    """Returns the measurements; a case that fails is left out, and the report says why.

    Args:
        plan: tasks and number of measurements.
        progress: called with one line of progress.

    Raises:
        ConfigError: a task or an observation does not exist.
    """
    unknown = [name for name in plan.observations if name not in OBSERVATIONS]
    if unknown or plan.steps < 1:
        raise ConfigError(
            f"observations are {list(plan.observations)} and steps {plan.steps}, must be of state, rgbd, and 1 or more"
        )
    report = TaskReport(timing.now(), timing.version(), timing.machine(), timing.cores(), timing.load(), size=plan.size)
    rows: list[TaskRow] = []
    left_out: list[str] = []
    cases = [(task_of(t).name, o, n) for t in plan.tasks for o in plan.observations for n in plan.processes]
    for name, observation, processes in cases:
        progress(f"{name}, {observation}, {processes} process{'' if processes == 1 else 'es'}")
        try:
            rows.append(
                _in_this_process(plan, name, observation) if processes == 1 else _in_processes(plan, name, observation, processes)
            )
        except GibsonSimError as error:
            left_out.append(f"{name}, {observation}, {processes}: {error}")
    loose: tuple[LooseRow, ...] = ()
    if plan.loose_scene:
        progress(f"{LOOSE_OBJECTS} loose objects in {plan.loose_scene}")
        loose = loose_object_speed(plan.loose_scene)
    return replace(report, rows=tuple(rows), loose=loose, left_out=tuple(left_out))


def _in_this_process(plan: TaskPlan, name: str, observation: str) -> TaskRow:
    """Returns the row of a case in this process, with its stages, under random actions."""
    rng = np.random.default_rng(0)
    with TaskRun(task_of(name), scene=plan.scene) as run:
        controls = Controls(run.robot, 1.0 / CONTROL_HZ)
        resets: list[float] = []

        def begin() -> None:
            began = time.perf_counter()
            controls.begin(run.reset(len(resets)))
            resets.append(time.perf_counter() - began)

        begin()
        camera = TaskCamera(run, (plan.size, plan.size)) if observation == "rgbd" else None
        stages: list[tuple[float, float, float]] = []
        for _ in range(plan.steps + WARM_UP):
            if run.over:
                begin()
            action = controls.action(rng.uniform(-1.0, 1.0, controls.size), run.observation)
            stages.append(_stages(run, lambda: run.step(action), lambda: _observe(run, controls, camera)))  # noqa: B023
    counted = np.array(stages[WARM_UP:])
    physics, judge, observe = (1e3 * np.median(counted, axis=0)).tolist()
    rate = 1.0 / float(np.median(counted.sum(axis=1)))
    return TaskRow(name, run.ground.scene.name, observation, 1, rate, physics, judge, observe, 1e3 * float(np.median(resets)))


def _stages(run: TaskRun, step: Callable[[], Any], observe: Callable[[], Any]) -> tuple[float, float, float]:
    """Makes a step and an observation; returns the seconds of physics, of the rest of the step, and of the observation."""
    physics = 0.0
    whole_step = run.world.step

    def timed(steps: int = 1) -> None:
        nonlocal physics
        began = time.perf_counter()
        whole_step(steps)
        physics += time.perf_counter() - began

    run.world.step = timed  # type: ignore[method-assign]
    try:
        first = time.perf_counter()
        step()
        second = time.perf_counter()
        observe()
        return physics, second - first - physics, time.perf_counter() - second
    finally:
        del run.world.step


def _observe(run: TaskRun, controls: Controls, camera: TaskCamera | None) -> Any:
    if camera is not None:
        return camera.rgbd()
    classes = tuple(item_body(item).semantic_class for item in run.episode.items)

    def rays(origins: Any, directions: Any, longest: float) -> Any:
        return run.world.cast_rays(origins, directions, longest, ignore=run.robot.name)

    return full_state(controls.layout, run.episode, run.observation, classes, rays, (0.0, 0.0))


def _in_processes(plan: TaskPlan, name: str, observation: str, processes: int) -> TaskRow:
    """Returns the row of a case in Gymnasium's vector environment."""
    if importlib.util.find_spec("gymnasium") is None:
        raise GibsonSimError("several processes need Gymnasium: pip install 'gibson_sim[gym]'")
    from gibson_sim.tasks.environments import in_processes

    envs = in_processes(processes, name, observation=observation, scene=plan.scene, size=(plan.size, plan.size))
    try:
        envs.reset(seed=0)
        envs.action_space.seed(0)
        seconds = []
        for _ in range(plan.steps // processes + WARM_UP):
            actions = envs.action_space.sample()
            began = time.perf_counter()
            envs.step(actions)
            seconds.append(time.perf_counter() - began)
    finally:
        envs.close()
    rate = processes / float(np.median(seconds[WARM_UP:]))
    return TaskRow(name, plan.scene or task_of(name).scene, observation, processes, rate, *([math.nan] * 4))


def loose_object_speed(scene: str, robot: str = "gibson_bot") -> tuple[LooseRow, ...]:
    """Returns the speed of physics with one robot, with ``LOOSE_OBJECTS`` objects at rest, and with all of them rolling and sliding."""
    ground = ground_of(scene, robot)
    rng = np.random.default_rng(0)
    poses = random_free_poses(ground.floor, LOOSE_OBJECTS + 1, rng, clearance=0.1, spacing=0.35)
    items = [Item(f"loose_{k + 1}", LOOSE_MODELS[k % len(LOOSE_MODELS)], pose) for k, pose in enumerate(poses[1:])]
    robot_spec = replace(ground.robot, start=poses[0])
    rows = []
    for count, what in ((0, "none"), (LOOSE_OBJECTS, "at rest"), (LOOSE_OBJECTS, "moving")):
        filled: SceneSpec = replace(
            ground.scene, robots=(robot_spec,), bodies=(*ground.scene.bodies, *(item_body(item) for item in items[:count]))
        )
        with PhysicsWorld(filled, step_hz=STEP_HZ) as world:
            world.step(round(REST_S * STEP_HZ))
            rows.append(LooseRow(scene, count, what, _real_time(world, items[:count] if what == "moving" else [], rng)))
    return tuple(rows)


def _real_time(world: PhysicsWorld, moved: Sequence[Item], rng: np.random.Generator) -> float:
    """Returns the real-time factor of physics; the velocities of ``moved`` are set anew twice per second of simulation time."""
    elapsed = 0.0
    for _ in range(round(2 * MOVING_S)):
        for item in moved:
            angle = float(rng.uniform(-math.pi, math.pi))
            level = pose_from_xyz_rpy(world.body_pose(item.name).position)
            world.set_state(item.name, level, (0.8 * math.cos(angle), 0.8 * math.sin(angle), 0.5), (0.0, 0.0, 2.0))
        began = time.perf_counter()
        for _ in range(STEP_HZ // 2):
            world.step()
        elapsed += time.perf_counter() - began
    return MOVING_S / elapsed


def targets(report: TaskReport) -> list[PerformanceTarget]:
    """Returns the targets that the report covers."""
    found = []
    for observation, required in (("state", REAL_TIME), ("rgbd", REAL_TIME_RGBD)):
        rows = [row for row in report.rows if row.observation == observation]
        if rows:
            best = max(row.real_time for row in rows)
            slowest = min(max(row.real_time for row in rows if row.task == task) for task in {row.task for row in rows})
            what = "without images" if observation == "state" else f"with {report.size}x{report.size} RGB-D"
            found.append(
                PerformanceTarget(
                    f"real-time factor {what}",
                    f">= {required:g}",
                    f"{slowest:.1f} (fastest task {best:.1f})",
                    "",
                    slowest >= required,
                )
            )
    return found


def report_text(report: TaskReport, *, markdown: bool = False) -> str:
    """Returns the whole report, plain for the terminal or as Markdown."""
    lines = [
        f"{report.machine}; {report.cores} cores usable, load {report.load:g}; Gibson Sim {report.version}; {report.date[:10]}.",
        f"{report.step_hz // report.control_hz} physics steps of 1/{report.step_hz} s for each environment step; random actions; medians.",
        *(f"Left out: {line}" for line in report.left_out),
    ]
    parts = ["\n".join(f"- {line}" if markdown else line for line in lines)]
    if report.rows:
        head = (
            "task",
            "scene",
            "observation",
            "processes",
            "steps/s",
            "x real time",
            "physics ms",
            "judge ms",
            "observe ms",
            "reset ms",
        )
        body = [
            (
                *(r.task, r.scene, r.observation, str(r.processes), f"{r.steps_per_s:.1f}", f"{r.real_time:.1f}"),
                *(_ms(stage) for stage in (r.physics_ms, r.judge_ms, r.observe_ms, r.reset_ms)),
            )
            for r in report.rows
        ]
        parts.append(table(head, body, markdown, left=(0, 1, 2)))
    if report.loose:
        body = [(r.scene, str(r.things), r.what, f"{r.real_time:.1f}") for r in report.loose]
        parts.append(table(("scene", "loose objects", "motion", "x real time"), body, markdown, left=(0, 2)))
    reached = [(t.what, t.wanted, t.measured, "met" if t.met else "MISSED") for t in targets(report)]
    if reached:
        parts += ["Targets for two cores:", table(("measurement", "target", "measured", ""), reached, markdown, left=(0, 1, 3))]
    return "\n\n".join(parts)


def _ms(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}"
