"""Runs a task in this process, without ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import TracebackType

from gibson_sim.errors import ConfigError
from gibson_sim.robots.joints.commands import JointPositions
from gibson_sim.simulation import Simulation
from gibson_sim.tasks.controls import finger_joints
from gibson_sim.tasks.episode import Action, Episode, Observation, item_body, observation_of
from gibson_sim.tasks.ground import Ground, ground_of
from gibson_sim.tasks.metrics import Meter, Metrics, touch_direction, touched_by
from gibson_sim.tasks.task import Task
from gibson_sim.types import VelocityCommand

STEP_HZ, CONTROL_HZ = 240, 10
"""Physics steps, and actions, per second of simulation time."""
SETTLE_S = 0.3
"""Simulation time before the first observation, for bodies to come to rest, seconds."""


class TaskRun:
    """Runs episodes of one task. Equal seeds and actions give bit-identical observations. Close it, or use it in a ``with`` statement.

    Args:
        task: the task.
        scene: name or path of the scene; empty = the task's default.
        robot: name or path of the robot; empty = the task's default.
        step_hz: physics steps per second.
        control_hz: actions per second; must divide ``step_hz``.
        device: EGL device for rendering, see ``Simulation``.

    Raises:
        GibsonSimError: the scene or the robot cannot be loaded.
    """

    def __init__(
        self,
        task: Task,
        *,
        scene: str = "",
        robot: str = "",
        step_hz: int = STEP_HZ,
        control_hz: int = CONTROL_HZ,
        device: int | str | None = None,
    ) -> None:
        if control_hz < 1 or step_hz % control_hz:
            raise ConfigError(f"control_hz is {control_hz}, must divide step_hz, which is {step_hz}")
        self.task = task
        self.ground: Ground = ground_of(scene or task.scene, robot or task.robot)
        self._substeps = step_hz // control_hz
        self.robot = self.ground.robot
        self.simulation = Simulation(self.ground.scene, None, step_hz=step_hz, cmd_vel_timeout=1.0, device=device)
        """Physics, and the renderer of ``TaskCamera``. Do not call ``simulation.reset``: ``TaskRun.reset`` repopulates ``world``."""
        self.world = self.simulation.world
        self._episode: Episode | None = None
        self._begin_ns = 0

    @property
    def episode(self) -> Episode:
        """Current episode."""
        if self._episode is None:
            raise ConfigError("no episode has begun; call reset(seed) first")
        return self._episode

    def reset(self, seed: int) -> Observation:
        """Begins the episode of a seed and returns its first observation.

        Raises:
            SceneError: the scene has no room for the task.
        """
        episode = self.task.generate(seed, self.ground)
        world = self.world
        scene_bodies = (body for body in self.ground.scene.bodies if body.name not in episode.removed)
        items = (item_body(item) for item in episode.items)
        world.repopulate([replace(self.robot, start=episode.start)], [*scene_bodies, *items])
        world.set_step_count(0)
        world.step(round(SETTLE_S * world.step_hz))
        self._episode, self._begin_ns = episode, world.stamp_ns
        self._moving = frozenset(world.names)
        self.observation = self._observe()
        self._meter = Meter(episode, self.observation)
        self.succeeded, self.over = False, False
        self.remaining = self.task.remaining(episode, self.observation, self.ground)
        return self.observation

    def step(self, action: Action) -> Observation:
        """Applies an action for one control period, returns the next observation, and updates ``succeeded`` and ``over``."""
        episode, world, name = self.episode, self.world, self.robot.name
        world.command(name, VelocityCommand((action.linear, 0.0, 0.0), (0.0, 0.0, action.angular), world.stamp_ns))
        joints = {**action.joints, **finger_joints(self.robot, action.grasp)}
        if joints:
            world.command_joints(name, JointPositions(tuple(joints.values()), tuple(joints)))
        if action.grasp is not None and action.grasp != bool(self.observation.held):
            world.arms.grasp(name) if action.grasp else world.arms.release(name)
        world.step(self._substeps)
        observation, contacts = self._observe(), world.contacts(name)
        touch = touch_direction(name, contacts, observation.yaw, (observation.held,))
        self.observation = replace(observation, touch=touch)
        self._meter.update(self.observation, touched_by(name, contacts, self._moving))
        self.remaining = self.task.remaining(episode, self.observation, self.ground)
        self.succeeded = self.succeeded or self.task.succeeded(episode, self.observation, self.ground)
        self.over = self.succeeded or self.observation.time >= episode.time_limit - 1e-9
        return self.observation

    @property
    def touching(self) -> bool:
        """Whether the robot touches a static obstacle other than the floor."""
        return self._meter.touching

    @property
    def metrics(self) -> Metrics:
        """Metrics of the episode so far."""
        return self._meter.metrics(self.observation, success=self.succeeded, goal_distance=self.remaining)

    def _observe(self) -> Observation:
        world, robot = self.world, self.robot
        joints, held = {}, ""
        if robot.manipulators:
            reading = world.joint_states(robot.name)
            joints = dict(zip(reading.names, reading.positions.tolist(), strict=True))
            state = world.arms.grasp_state(robot.name)
            held = state.body if state.holding else ""
        return observation_of(world.state(), robot.name, robot.base_link, self._begin_ns, joints=joints, held=held)

    def close(self) -> None:
        """Frees engine and renderer; a second call does nothing."""
        self.simulation.close()

    def __enter__(self) -> TaskRun:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def run_episode(run: TaskRun, seed: int, baseline: str, watch: Callable[[Observation], None] | None = None) -> Metrics:
    """Runs the episode of a seed with a baseline and returns its metrics.

    Args:
        run: the task.
        seed: seed of the episode.
        baseline: one of the task's baselines.
        watch: called with every observation.

    Raises:
        SceneError: the scene has no room for the task.
    """
    obs = run.reset(seed)
    policy = run.task.policy(baseline, run.episode, run.ground)
    while not run.over:
        if watch is not None:
            watch(obs)
        obs = run.step(policy.act(obs))
    return run.metrics
