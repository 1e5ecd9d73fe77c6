"""Tasks as Gymnasium environments. Importing this module registers them: ``gymnasium.make("GibsonSim/PointGoal-v0")``.

No other module imports Gymnasium, which is optional: ``pip install 'gibson_sim[gym]'``.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.robots.load import load_robot
from gibson_sim.tasks.controls import Controls
from gibson_sim.tasks.distance import DrivingDistance
from gibson_sim.tasks.episode import item_body
from gibson_sim.tasks.observing import full_state, own_state
from gibson_sim.tasks.pictures import FARTHEST_DEPTH, TaskCamera
from gibson_sim.tasks.registry import TASKS, task_of
from gibson_sim.tasks.run import CONTROL_HZ, STEP_HZ, TaskRun

ObservationArrays = NDArray[np.float32] | dict[str, NDArray[Any]]
OBSERVATIONS = ("state", "rgbd")
AUTORESETS = {
    "next_step": AutoresetMode.NEXT_STEP,
    "same_step": AutoresetMode.SAME_STEP,
    "disabled": AutoresetMode.DISABLED,
}
"""Autoreset modes of vector environments, by name."""
NAMESPACE, VERSION = "GibsonSim", 0
SUCCESS_REWARD, STEP_REWARD, COLLISION_REWARD, CONTACT_REWARD = 10.0, -0.01, -0.1, -0.05
"""Rewards for success, for each step, for each new contact with a static obstacle, and for each step that ends in contact with one. They are
added to the progress in the step: the decrease of the path length to the goal, metres, or of the task's own measure."""
_HIGHEST_SEED = 2**31


class TaskEnvironment(gymnasium.Env[ObservationArrays, NDArray[np.float32]]):
    """One robot with one task.

    An action is an array of numbers from -1 to 1: forward speed and yaw rate as fractions of the drive's limits (but see ``reverse``); with
    an arm also the speed of each joint, and the gripper: above 0 it closes and holds, else it opens. docs/tasks.md describes the
    observations.

    Scene, physics and renderer are loaded at the first ``reset``, so environments can be created in one process and used in another.

    Args:
        task: name of the task.
        observation: ``state``, or ``rgbd`` for images and proprioception.
        scene: name or path of a scene, or ``arena``; empty = the task's default.
        robot: name or path of a robot; empty = the task's default.
        size: width and height of the images, pixels.
        control_hz: actions per second of simulation time.
        step_hz: physics steps per second of simulation time.
        reverse: largest reverse speed as a fraction of the forward speed limit, 0 to 1; the range of speeds is mapped to -1 to 1.
        device: EGL device for rendering, as listed by ``gibson-sim doctor``; None = the first GPU that works, else software.
        render_mode: ``rgb_array`` = ``render`` returns the robot's camera image beside a top view; None = no pictures.

    Raises:
        ConfigError: an argument is out of range or unknown.
        RobotError: the robot does not exist or cannot be loaded.
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
        reverse: float = 1.0,
        device: int | str | None = None,
        render_mode: str | None = None,
    ) -> None:
        if observation not in OBSERVATIONS:
            raise ConfigError(f"observation is {observation!r}, must be one of {', '.join(OBSERVATIONS)}")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ConfigError(f"render_mode is {render_mode!r}, must be rgb_array or None")
        self._task, self._observation = task_of(task), observation
        self._make = {"scene": scene, "robot": robot, "control_hz": control_hz, "step_hz": step_hz, "device": device}
        self._size, self.render_mode = (int(size[0]), int(size[1])), render_mode
        self.metadata = {**self.metadata, "render_fps": control_hz}
        self._controls = Controls(load_robot(robot or self._task.robot), 1.0 / control_hz, reverse)
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

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObservationArrays, dict[str, Any]]:
        """Begins the episode of ``seed``, or of a seed sampled from the environment's generator.

        Raises:
            SceneError: the scene has no room for the task.
        """
        super().reset(seed=seed)
        if self._run is None:
            self._run = TaskRun(self._task, **self._make)  # type: ignore[arg-type]
        run = self._run
        run.reset(int(self.np_random.integers(_HIGHEST_SEED)) if seed is None else seed)
        self._classes = tuple(item_body(item).semantic_class for item in run.episode.items)
        self._controls.begin(run.observation)
        self._driving_distance = self._path_to_goal()
        self._remaining_distance = self._remaining()
        self._collisions = 0
        return self._observe(), {"seed": run.episode.seed, "goal": run.episode.goal.text}

    def step(self, action: NDArray[np.float32]) -> tuple[ObservationArrays, float, bool, bool, dict[str, Any]]:
        """Applies an action for one control period; ``info`` has the metrics of the episode so far, including SPL if the task defines it."""
        run = self._running()
        last_remaining = self._remaining_distance
        run.step(self._controls.action(action, run.observation))
        metrics, self._remaining_distance = run.metrics, self._remaining()
        progress, new_collisions = last_remaining - self._remaining_distance, metrics.collisions - self._collisions
        self._collisions = metrics.collisions
        reward = progress + STEP_REWARD + COLLISION_REWARD * new_collisions
        reward += CONTACT_REWARD * run.touching + SUCCESS_REWARD * run.succeeded
        info = {
            "success": metrics.success,
            "path_length": metrics.path_length,
            "collisions": metrics.collisions,
            "pushed": metrics.pushed,
            "goal_distance": metrics.goal_distance,
            "time": metrics.time,
        }
        # NaN does not equal itself, so Gymnasium's environment checker, which compares two runs, would fail.
        if not math.isnan(metrics.spl):
            info["spl"] = metrics.spl
        return self._observe(), float(reward), run.succeeded, run.over and not run.succeeded, info

    def render(self) -> NDArray[np.uint8] | None:
        """Returns the robot's camera image beside a top view, (256, 512, 3); None without a render mode."""
        return None if self.render_mode is None else self._task_camera().camera_and_top_view(256)

    def close(self) -> None:
        """Frees engine and renderer; a second call does nothing."""
        run, self._run, self._camera = self._run, None, None
        if run is not None:
            run.close()

    def _observe(self) -> ObservationArrays:
        run, layout = self._running(), self._controls.layout
        if self._observation == "state":
            path = self._driving_distance
            direction = (0.0, 0.0) if path is None else path.direction(run.observation.xy)
            return full_state(layout, run.episode, run.observation, self._classes, self._rays, direction)
        rgb, depth = self._task_camera().rgbd()
        return {"rgb": rgb, "depth": depth, "state": own_state(layout, run.episode, run.observation)}

    def _path_to_goal(self) -> DrivingDistance | None:
        run = self._running()
        goal = run.episode.goal.position
        return None if goal is None or not self._task.rewards_by_path else DrivingDistance(run.ground, goal[:2])

    def _remaining(self) -> float:
        """Returns the measure from which rewards derive: the length of the path to the goal, or the task's own measure."""
        run = self._running()
        return run.remaining if self._driving_distance is None else self._driving_distance(run.observation.xy)

    def _rays(self, origins: NDArray[np.float64], directions: NDArray[np.float64], longest: float) -> NDArray[np.float64]:
        run = self._running()
        return run.world.cast_rays(origins, directions, longest, ignore=run.robot.name)

    def _task_camera(self) -> TaskCamera:
        if self._camera is None:
            self._camera = TaskCamera(self._running(), self._size)
        return self._camera

    def _running(self) -> TaskRun:
        if self._run is None:
            raise ConfigError("no episode has begun; call reset() first")
        return self._run


def in_processes(count: int, task: str, *, autoreset: str = "next_step", **options: Any) -> AsyncVectorEnv:
    """Returns a vector environment of a task; each environment runs in a spawned process, which keeps its world between episodes.

    ``reset(seed=s)`` begins the episodes of the seeds s, s + 1, ...; each environment samples the seeds of later episodes from its own
    generator. Rasteriser threads share the cores (``LP_NUM_THREADS``, unless it is set). Programs that call this function need
    ``if __name__ == "__main__":``, since spawned processes import them again.

    Args:
        count: number of environments, 1 or more.
        task: name of the task.
        autoreset: ``next_step``: the step after the last one of an episode begins the next episode, ignores its action, and returns
            reward 0; ``same_step``: the last step begins the next episode, and returns the last observation in ``info["final_obs"]``, with
            ``info["final_info"]``; ``disabled``: the caller begins episodes with ``reset(options={"reset_mask": ...})``.
        options: arguments of ``TaskEnvironment``.

    Raises:
        ConfigError: an argument is out of range or unknown.
        RobotError: the robot does not exist or cannot be loaded.
    """
    if count < 1:
        raise ConfigError(f"count is {count}, must be 1 or more environments")
    if autoreset not in AUTORESETS:
        raise ConfigError(f"autoreset is {quoted(autoreset)}, must be one of {', '.join(AUTORESETS)}")
    make = _InProcess(task, options, max(1, len(os.sched_getaffinity(0)) // count))
    return AsyncVectorEnv([make] * count, context="spawn", autoreset_mode=AUTORESETS[autoreset])


@dataclass(frozen=True)
class _InProcess:
    """Factory of the environment of one process of a vector environment."""

    task: str
    options: dict[str, Any]
    threads: int
    """Number of threads of the rasteriser."""

    def __call__(self) -> TaskEnvironment:
        # Gymnasium also creates one in the caller's process, for its spaces; that process keeps its settings.
        if multiprocessing.parent_process() is not None:
            os.environ.setdefault("LP_NUM_THREADS", str(self.threads))
        return TaskEnvironment(self.task, **self.options)


def register() -> None:
    """Registers all tasks with Gymnasium; a second call does nothing."""
    for name, task in TASKS.items():
        identity = f"{NAMESPACE}/{task.environment}-v{VERSION}"
        if identity not in gymnasium.registry:
            gymnasium.register(identity, entry_point=f"{__name__}:{TaskEnvironment.__name__}", kwargs={"task": name})


register()
