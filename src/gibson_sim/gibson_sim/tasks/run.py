"""A task in a world of physics, in this process: no ROS, no pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import TracebackType

from gibson_sim.errors import ConfigError
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.joints.commands import JointPositions
from gibson_sim.tasks.controls import finger_joints
from gibson_sim.tasks.episode import Action, Episode, View, item_body, view_of
from gibson_sim.tasks.ground import Ground, ground_of
from gibson_sim.tasks.metrics import Meter, Metrics, touched_by
from gibson_sim.tasks.task import Task
from gibson_sim.types import VelocityCommand

STEP_HZ, CONTROL_HZ = 240, 10
"""Physics steps and actions in a second of simulation time."""
SETTLE_S = 0.3
"""Seconds before the first view, in which things come to rest."""


class TaskRun:
    """One robot at one task, episode after episode. Equal seeds and equal actions give bit-equal views.

    Args:
        task: which.
        scene: name or path; empty = the task's own.
        robot: name or path; empty = the task's own.
        step_hz: physics steps a second.
        control_hz: actions a second; must divide ``step_hz``.

    Raises:
        GibsonSimError: scene or robot cannot be used.
    """

    def __init__(
        self, task: Task, *, scene: str = "", robot: str = "", step_hz: int = STEP_HZ, control_hz: int = CONTROL_HZ
    ) -> None:
        if control_hz < 1 or step_hz % control_hz:
            raise ConfigError(f"control_hz is {control_hz}, must divide step_hz, which is {step_hz}")
        self.task = task
        self.ground: Ground = ground_of(scene or task.scene, robot or task.robot)
        self._substeps = step_hz // control_hz
        self.robot = self.ground.robot
        self.world = PhysicsWorld(self.ground.scene, step_hz=step_hz, cmd_vel_timeout=1.0)
        self._episode: Episode | None = None
        self._begin_ns = 0

    @property
    def episode(self) -> Episode:
        """What is being done."""
        if self._episode is None:
            raise ConfigError("no episode has begun; call reset(seed) first")
        return self._episode

    def reset(self, seed: int) -> View:
        """Begins the episode of a seed, and returns what is known at its begin.

        Raises:
            SceneError: the scene has no room for the task.
        """
        episode = self.task.generate(seed, self.ground)
        world = self.world
        own = (body for body in self.ground.scene.bodies if body.name not in episode.removed)
        world.repopulate([replace(self.robot, start=episode.start)], [*own, *(item_body(item) for item in episode.items)])
        world.set_step_count(0)
        world.step(round(SETTLE_S * world.step_hz))
        self._episode, self._begin_ns = episode, world.stamp_ns
        self._moving = frozenset(world.names)
        self.view = self._view()
        self._meter = Meter(episode, self.view)
        self.succeeded, self.over = False, False
        self.remaining = self.task.remaining(episode, self.view, self.ground)
        return self.view

    def step(self, action: Action) -> View:
        """Obeys an action for one period of control, and returns what is known then; ``succeeded`` and ``over`` say whether to go on."""
        episode, world, name = self.episode, self.world, self.robot.name
        world.command(name, VelocityCommand((action.linear, 0.0, 0.0), (0.0, 0.0, action.angular), world.stamp_ns))
        joints = {**action.joints, **finger_joints(self.robot, action.grasp)}
        if joints:
            world.command_joints(name, JointPositions(tuple(joints.values()), tuple(joints)))
        if action.grasp is not None and action.grasp != bool(self.view.held):
            world.grasp(name) if action.grasp else world.release(name)
        world.step(self._substeps)
        self.view = self._view()
        self._meter.note(self.view, touched_by(name, world.contacts(name), self._moving))
        self.remaining = self.task.remaining(episode, self.view, self.ground)
        self.succeeded = self.succeeded or self.task.succeeded(episode, self.view, self.ground)
        self.over = self.succeeded or self.view.time >= episode.time_limit - 1e-9
        return self.view

    @property
    def metrics(self) -> Metrics:
        """How it went until now."""
        return self._meter.metrics(self.view, success=self.succeeded, goal_distance=self.remaining)

    def _view(self) -> View:
        world, robot = self.world, self.robot
        joints, held = {}, ""
        if robot.manipulators:
            reading = world.joint_states(robot.name)
            joints = dict(zip(reading.names, reading.positions.tolist(), strict=True))
            state = world.grasp_state(robot.name)
            held = state.body if state.holding else ""
        return view_of(world.state(), robot.name, robot.base_link, self._begin_ns, joints=joints, held=held)

    def close(self) -> None:
        """Frees the engine; a second call does nothing."""
        self.world.close()

    def __enter__(self) -> TaskRun:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def run_episode(run: TaskRun, seed: int, baseline: str, watch: Callable[[View], None] | None = None) -> Metrics:
    """Lets a baseline do the episode of a seed, and returns how it went.

    Args:
        run: where.
        seed: which.
        baseline: one of the task's.
        watch: is shown every view.

    Raises:
        SceneError: the scene has no room for the task.
    """
    view = run.reset(seed)
    policy = run.task.policy(baseline, run.episode, run.ground)
    while not run.over:
        if watch is not None:
            watch(view)
        view = run.step(policy.act(view))
    return run.metrics
