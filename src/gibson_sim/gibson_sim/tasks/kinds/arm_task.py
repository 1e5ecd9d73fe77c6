"""What tasks with an arm share: where, who, and who does them at random. Pure."""

from __future__ import annotations

import math

import numpy as np

from gibson_sim.description.urdf import read_urdf
from gibson_sim.tasks.episode import Action, Episode, View
from gibson_sim.tasks.ground import Ground
from gibson_sim.tasks.task import Policy, Task, Wanderer, generator
from gibson_sim.types import Vec3

_SECONDS = (0.5, 2.0)
"""How long a random command counts."""


class ArmTask(Task):
    """A task for a robot with an arm."""

    scene = "arena"
    robot = "arm_bot"

    def policy(self, baseline: str, episode: Episode, ground: Ground) -> Policy:
        """Returns who does an episode; ``random`` moves the arm and the hand, too."""
        if baseline == "random":
            return Fumbler(ground, generator(self, episode.seed, 1))
        return super().policy(baseline, episode, ground)


class Fumbler:
    """Drives as a ``Wanderer``, and puts the joints of the first arm anywhere and closes the hand or opens it, for a second or so."""

    def __init__(self, ground: Ground, rng: np.random.Generator) -> None:
        self._drives, self._rng, self._until = Wanderer(ground, rng), rng, 0.0
        arm = ground.robot.manipulators[0]
        known = {joint.name: joint for joint in read_urdf(ground.robot.urdf).joints}
        self._limits = {
            name: (known[name].lower, known[name].upper) if known[name].is_bounded else (-math.pi, math.pi) for name in arm.joints
        }
        self._joints: dict[str, float] = {}
        self._grasp = False

    def act(self, view: View) -> Action:
        """Returns the action of this second."""
        if view.time >= self._until:
            self._joints = {name: float(self._rng.uniform(*limits)) for name, limits in self._limits.items()}
            self._grasp = bool(self._rng.integers(2))
            self._until = view.time + float(self._rng.uniform(*_SECONDS))
        base = self._drives.act(view)
        return Action(base.linear, base.angular, self._joints, self._grasp)


def hand(ground: Ground, view: View) -> Vec3:
    """Returns where the tool of the first arm is, world metres."""
    return view.links[f"{ground.robot.name}/{ground.robot.manipulators[0].tip_link}"].position
