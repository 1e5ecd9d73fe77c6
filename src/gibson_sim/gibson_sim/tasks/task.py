"""What every task says of itself. Pure: a seed and a ground go in, an episode comes out; a view goes in, a verdict comes out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Protocol

import numpy as np

from gibson_sim.tasks.episode import Action, Episode, View
from gibson_sim.tasks.ground import Ground

BASELINES = ("scripted", "random", "none")
"""Who can do a task without having learnt it; ``none`` stands still."""


class Policy(Protocol):
    """Does a task."""

    def act(self, view: View) -> Action:
        """Returns what to do next."""


class Task(ABC):
    """A kind of episode."""

    name: ClassVar[str]
    """As on the command line, words joined by ``-``."""
    environment: ClassVar[str]
    """As in ``gymnasium.make("GibsonSim/<environment>-v0")``."""
    about: ClassVar[str]
    """One line."""
    scene: ClassVar[str] = "flat"
    """Where it takes place unless asked otherwise."""
    robot: ClassVar[str] = "gibson_bot"
    """Who does it unless asked otherwise."""
    baselines: ClassVar[tuple[str, ...]] = BASELINES

    @abstractmethod
    def generate(self, seed: int, ground: Ground) -> Episode:
        """Returns the episode of a seed.

        Raises:
            SceneError: the scene has no room for it.
        """

    def remaining(self, episode: Episode, view: View, ground: Ground) -> float:
        """Returns how far the goal is, 0 = reached: metres to its place, unless a task says otherwise. Rewards come from it."""
        assert episode.goal.position is not None
        return view.distance_to(episode.goal.position)

    def succeeded(self, episode: Episode, view: View, ground: Ground) -> bool:
        """Returns whether the goal is reached: the base is within its radius, unless a task says otherwise."""
        assert episode.goal.position is not None
        return view.distance_to(episode.goal.position) <= episode.goal.radius

    @abstractmethod
    def scripted(self, episode: Episode, ground: Ground) -> Policy:
        """Returns who does it by a script."""

    def policy(self, baseline: str, episode: Episode, ground: Ground) -> Policy:
        """Returns who does an episode: ``scripted``, ``random`` or ``none``."""
        if baseline == "scripted":
            return self.scripted(episode, ground)
        return Wanderer(ground, generator(self, episode.seed, 1)) if baseline == "random" else _Idle()


def generator(task: Task, seed: int, part: int = 0) -> np.random.Generator:
    """Returns where chance comes from in an episode; parts are independent of each other."""
    return np.random.default_rng([seed, part, *task.name.encode()])


class Wanderer:
    """Drives and turns at random, each for a second or so; the arm stays as it is."""

    def __init__(self, ground: Ground, rng: np.random.Generator) -> None:
        drive = ground.robot.drive
        assert drive is not None
        self._fastest, self._rng = (drive.max_linear, drive.max_angular), rng
        self._until, self._action = 0.0, Action()

    def act(self, view: View) -> Action:
        """Returns the action of this second."""
        if view.time >= self._until:
            linear, angular = self._rng.uniform((-0.3, -0.7), (1.0, 0.7))
            self._action = Action(linear * self._fastest[0], angular * self._fastest[1])
            self._until = view.time + float(self._rng.uniform(0.5, 2.0))
        return self._action


class _Idle:
    def act(self, view: View) -> Action:
        return Action()
