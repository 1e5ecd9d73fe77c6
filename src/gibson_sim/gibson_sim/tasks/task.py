"""The interface of tasks and policies. Pure."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Protocol

import numpy as np

from gibson_sim.tasks.episode import Action, Episode, Observation
from gibson_sim.tasks.ground import Ground

BASELINES = ("scripted", "random", "none")
"""Policies that need no training; ``none`` does not move."""


class Policy(Protocol):
    """Chooses the actions of a robot."""

    def act(self, obs: Observation) -> Action:
        """Returns the next action."""


class Task(ABC):
    """A kind of task: generates episodes and evaluates them."""

    name: ClassVar[str]
    """Name on the command line, words joined by ``-``."""
    environment: ClassVar[str]
    """Name in ``gymnasium.make("GibsonSim/<environment>-v0")``."""
    about: ClassVar[str]
    """Description, one line."""
    scene: ClassVar[str] = "flat"
    """Default scene."""
    robot: ClassVar[str] = "gibson_bot"
    """Default robot."""
    baselines: ClassVar[tuple[str, ...]] = BASELINES
    rewards_by_path: ClassVar[bool] = False
    """Whether rewards derive from the length of the shortest path to the goal's position instead of ``remaining``: for driving tasks."""

    @abstractmethod
    def generate(self, seed: int, ground: Ground) -> Episode:
        """Returns the episode of a seed.

        Raises:
            SceneError: the scene has no room for the task.
        """

    def remaining(self, episode: Episode, obs: Observation, ground: Ground) -> float:
        """Returns the remaining distance to the goal, 0 = reached; by default the distance to its position, metres."""
        assert episode.goal.position is not None
        return obs.distance_to(episode.goal.position)

    def succeeded(self, episode: Episode, obs: Observation, ground: Ground) -> bool:
        """Returns whether the goal is reached; by default whether the base is within the goal's radius."""
        assert episode.goal.position is not None
        return obs.distance_to(episode.goal.position) <= episode.goal.radius

    @abstractmethod
    def scripted(self, episode: Episode, ground: Ground) -> Policy:
        """Returns the scripted baseline for an episode."""

    def policy(self, baseline: str, episode: Episode, ground: Ground) -> Policy:
        """Returns a baseline for an episode: ``scripted``, ``random`` or ``none``."""
        if baseline == "scripted":
            return self.scripted(episode, ground)
        return RandomDrivePolicy(ground, generator(self, episode.seed, 1)) if baseline == "random" else _IdlePolicy()


def generator(task: Task, seed: int, part: int = 0) -> np.random.Generator:
    """Returns a random generator of an episode; generators with different ``part`` are independent."""
    return np.random.default_rng([seed, part, *task.name.encode()])


class RandomDrivePolicy:
    """Samples a random velocity every 0.5 to 2 s; the arm does not move."""

    def __init__(self, ground: Ground, rng: np.random.Generator) -> None:
        drive = ground.robot.drive
        assert drive is not None
        self._max_speeds, self._rng = (drive.max_linear, drive.max_angular), rng
        self._until, self._action = 0.0, Action()

    def act(self, obs: Observation) -> Action:
        """Returns the current action."""
        if obs.time >= self._until:
            linear, angular = self._rng.uniform((-0.3, -0.7), (1.0, 0.7))
            self._action = Action(linear * self._max_speeds[0], angular * self._max_speeds[1])
            self._until = obs.time + float(self._rng.uniform(0.5, 2.0))
        return self._action


class _IdlePolicy:
    def act(self, obs: Observation) -> Action:
        return Action()
