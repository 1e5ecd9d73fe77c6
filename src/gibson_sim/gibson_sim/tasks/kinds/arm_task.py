"""Common base of tasks for a robot with an arm: scene, robot and random baseline. Pure."""

from __future__ import annotations

import math

import numpy as np

from gibson_sim.description.urdf import read_urdf
from gibson_sim.tasks.episode import Action, Episode, Observation
from gibson_sim.tasks.ground import Ground
from gibson_sim.tasks.task import Policy, RandomDrivePolicy, Task, generator
from gibson_sim.types import Vec3

_SECONDS = (0.5, 2.0)
"""Minimum and maximum time between random commands, seconds."""


class ArmTask(Task):
    """A task for a robot with an arm."""

    scene = "arena"
    robot = "arm_bot"

    def policy(self, baseline: str, episode: Episode, ground: Ground) -> Policy:
        """Returns a baseline for an episode; ``random`` also moves the arm and the gripper."""
        if baseline == "random":
            return RandomArmPolicy(ground, generator(self, episode.seed, 1))
        return super().policy(baseline, episode, ground)


class RandomArmPolicy:
    """Drives like ``RandomDrivePolicy``; samples random targets for the joints and the gripper of the first arm every 0.5 to 2 s."""

    def __init__(self, ground: Ground, rng: np.random.Generator) -> None:
        self._drives, self._rng, self._until = RandomDrivePolicy(ground, rng), rng, 0.0
        arm = ground.robot.manipulators[0]
        known = {joint.name: joint for joint in read_urdf(ground.robot.urdf).joints}
        self._limits = {
            name: (known[name].lower, known[name].upper) if known[name].is_bounded else (-math.pi, math.pi) for name in arm.joints
        }
        self._joints: dict[str, float] = {}
        self._grasp = False

    def act(self, obs: Observation) -> Action:
        """Returns the current action."""
        if obs.time >= self._until:
            self._joints = {name: float(self._rng.uniform(*limits)) for name, limits in self._limits.items()}
            self._grasp = bool(self._rng.integers(2))
            self._until = obs.time + float(self._rng.uniform(*_SECONDS))
        base = self._drives.act(obs)
        return Action(base.linear, base.angular, self._joints, self._grasp)


def tool_position(ground: Ground, obs: Observation) -> Vec3:
    """Returns the position of the tool of the first arm, world frame, metres."""
    return obs.links[f"{ground.robot.name}/{ground.robot.manipulators[0].tip_link}"].position
