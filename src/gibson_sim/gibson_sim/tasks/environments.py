"""Tasks as Gymnasium environments. Importing this registers them: ``gymnasium.make("GibsonSim/PointGoal-v0")``.

The only file that imports Gymnasium, which is optional: ``pip install gibson_sim[gym]``.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.scenes.robot_files import load_robot
from gibson_sim.tasks.controls import Controls
from gibson_sim.tasks.episode import item_body
from gibson_sim.tasks.observing import full_state, own_state
from gibson_sim.tasks.pictures import FARTHEST_DEPTH, TaskCamera
from gibson_sim.tasks.registry import TASKS, task_of
from gibson_sim.tasks.run import CONTROL_HZ, STEP_HZ, TaskRun

Observation = NDArray[np.float32] | dict[str, NDArray[Any]]
OBSERVATIONS = ("state", "rgbd")
NAMESPACE, VERSION = "GibsonSim", 0
SUCCESS_REWARD, STEP_REWARD, COLLISION_REWARD = 10.0, -0.01, -0.1
"""Beside the metres (or radians) by which the goal came nearer."""
_HIGHEST_SEED = 2**31


class TaskEnvironment(gymnasium.Env[Observation, NDArray[np.float32]]):
    """One robot at one task.

    An action is an array of numbers from -1 to 1: forward speed and yaw rate as parts of the fastest; with an arm also how fast each of
    its joints goes, and the hand: above 0 it closes and holds, else it opens. For observations see docs/tasks.md.

    Nothing heavy is loaded before the first ``reset``, so that environments can be made in one process and used in others.

    Args:
        task: name of the task.
        observation: ``state``, or ``rgbd`` for pictures and what the robot feels of itself.
        scene: name or path of a scene, or ``arena``; empty = the task's own.
        robot: name or path of a robot; empty = the task's own.
        size: width and height of pictures, pixels.
        control_hz: actions a second of simulation time.
        step_hz: physics steps a second.
        device: EGL device that draws, as ``gibson-sim doctor`` lists them; None = a GPU if there is one.
        render_mode: ``rgb_array`` = ``render`` returns the robot's own view with one from above beside it; None = no pictures.

    Raises:
        ConfigError: an argument is impossible.
        RobotError: there is no such robot.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}  # noqa: RUF012

    def __init__(
        self,
        task: str,
        *,
        observation: str = "state",
        scene: str = "",
        robot: str = "",
        size: tuple[int, int] = (128, 128),
        control_hz: int = CONTROL_HZ,
        step_hz: int = STEP_HZ,
        device: int | str | None = None,
        render_mode: str | None = None,
    ) -> None:
        if observation not in OBSERVATIONS:
            raise ConfigError(f"observation is {observation!r}, must be one of {', '.join(OBSERVATIONS)}")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ConfigError(f"render_mode is {render_mode!r}, must be rgb_array or None")
        self._task, self._observation = task_of(task), observation
        self._make = {"scene": scene, "robot": robot, "control_hz": control_hz, "step_hz": step_hz}
        self._size, self._device, self.render_mode = (int(size[0]), int(size[1])), device, render_mode
        self.metadata = {**self.metadata, "render_fps": control_hz}
        self._controls = Controls(load_robot(robot or self._task.robot), 1.0 / control_hz)
        self.action_space = spaces.Box(-1.0, 1.0, (self._controls.size,), dtype=np.float32)
        self.observation_space = self._space()
        self._run: TaskRun | None = None
        self._camera: TaskCamera | None = None

    def _space(self) -> spaces.Space[Any]:
        layout = self._controls.layout
        if self._observation == "state":
            return spaces.Box(*layout.state(), dtype=np.float32)
        width, height = self._size
        return spaces.Dict(
            {
                "rgb": spaces.Box(0, 255, (height, width, 3), dtype=np.uint8),
                "depth": spaces.Box(0.0, FARTHEST_DEPTH, (height, width, 1), dtype=np.float32),
                "state": spaces.Box(*layout.own(), dtype=np.float32),
            }
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode: that of ``seed``, else of one drawn from the environment's own generator.

        Raises:
            SceneError: the scene has no room for the task.
        """
        super().reset(seed=seed)
        if self._run is None:
            self._run = TaskRun(self._task, **self._make)  # type: ignore[arg-type]
        run = self._run
        run.reset(int(self.np_random.integers(_HIGHEST_SEED)) if seed is None else seed)
        self._classes = tuple(item_body(item).semantic_class for item in run.episode.items)
        self._controls.begin(run.view)
        self._collisions = 0
        return self._observe(), {"seed": run.episode.seed, "goal": run.episode.goal.text}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Obeys an action for one period of control; info has the metrics of the episode until now, SPL where the task has one."""
        run = self._running()
        before = run.remaining
        run.step(self._controls.action(action, run.view))
        metrics = run.metrics
        nearer, collided = before - run.remaining, metrics.collisions - self._collisions
        self._collisions = metrics.collisions
        reward = nearer + STEP_REWARD + COLLISION_REWARD * collided + SUCCESS_REWARD * run.succeeded
        info = {
            "success": metrics.success,
            "path_length": metrics.path_length,
            "collisions": metrics.collisions,
            "pushed": metrics.pushed,
            "goal_distance": metrics.goal_distance,
            "time": metrics.time,
        }
        # NaN does not equal itself: the check of Gymnasium, which compares two runs, would not pass.
        if not math.isnan(metrics.spl):
            info["spl"] = metrics.spl
        return self._observe(), float(reward), run.succeeded, run.over and not run.succeeded, info

    def render(self) -> NDArray[np.uint8] | None:
        """Returns the robot's view with one from above beside it, (256, 512, 3); None without a render mode."""
        return None if self.render_mode is None else self._eyes().both(256)

    def close(self) -> None:
        """Frees engine and renderer; a second call does nothing."""
        for part in (self._camera, self._run):
            if part is not None:
                part.close()
        self._camera, self._run = None, None

    def _observe(self) -> Observation:
        run, layout = self._running(), self._controls.layout
        if self._observation == "state":
            return full_state(layout, run.episode, run.view, self._classes, self._rays)
        rgb, depth = self._eyes().rgbd()
        return {"rgb": rgb, "depth": depth, "state": own_state(layout, run.episode, run.view)}

    def _rays(self, origins: NDArray[np.float64], directions: NDArray[np.float64], longest: float) -> NDArray[np.float64]:
        run = self._running()
        return run.world.cast_rays(origins, directions, longest, ignore=run.robot.name)

    def _eyes(self) -> TaskCamera:
        if self._camera is None:
            self._camera = TaskCamera(self._running(), self._size, self._device)
        return self._camera

    def _running(self) -> TaskRun:
        if self._run is None:
            raise ConfigError("no episode has begun; call reset() first")
        return self._run


def in_processes(count: int, task: str, **options: Any) -> AsyncVectorEnv:
    """Returns environments of a task side by side, each in a process of its own that is made afresh; options as ``TaskEnvironment`` has."""
    return AsyncVectorEnv([lambda: TaskEnvironment(task, **options)] * count, context="spawn")


def register() -> None:
    """Registers all tasks with Gymnasium; a second call does nothing."""
    for name, task in TASKS.items():
        identity = f"{NAMESPACE}/{task.environment}-v{VERSION}"
        if identity not in gymnasium.registry:
            gymnasium.register(identity, entry_point=f"{__name__}:{TaskEnvironment.__name__}", kwargs={"task": name})


register()
