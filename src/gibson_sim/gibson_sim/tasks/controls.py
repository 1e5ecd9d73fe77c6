"""From an array of numbers between -1 and 1 to what a robot does. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from gibson_sim.description.urdf import read_urdf
from gibson_sim.errors import CommandError, ConfigError
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.tasks.episode import Action, View
from gibson_sim.tasks.observing import Layout

JOINT_SPEED = 1.0
"""Radians (or metres) a second of a joint of the arm at 1."""
_TURNS = 4.0 * math.pi
"""Bounds of a joint that turns for ever, radians."""


class Controls:
    """What an array of actions means for one robot: forward speed, yaw rate; with an arm also the speed of each joint, and the hand.

    Args:
        robot: which; of its arms, the first.
        period: seconds between two actions.

    Raises:
        ConfigError: the robot cannot drive.
    """

    def __init__(self, robot: RobotSpec, period: float) -> None:
        if robot.drive is None:
            raise ConfigError(f"robot {robot.name!r} has no drive; tasks need one that moves")
        self._fastest = (robot.drive.max_linear, robot.drive.max_angular)
        self._period = period
        joints = robot.manipulators[0].joints if robot.manipulators else ()
        self._limits = _limits(robot, joints)
        self.layout = Layout(joints, tuple(low for low, _ in self._limits), tuple(high for _, high in self._limits))
        """Of observations."""
        self.size = 2 + (len(joints) + 1 if joints else 0)
        """How many numbers an action has."""
        self._told: list[float] = []

    def begin(self, view: View) -> None:
        """Begins an episode: the arm is to be where it is."""
        self._told = [view.joints[name] for name in self.layout.joints]

    def action(self, values: ArrayLike, view: View) -> Action:
        """Returns what an array (``size``,) asks for; numbers beyond -1 and 1 are clipped.

        Raises:
            CommandError: its shape is another, or it holds a NaN.
        """
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (self.size,) or not np.isfinite(array).all():
            raise CommandError(f"action is {array.tolist()}, must be {self.size} finite numbers from -1 to 1")
        linear, angular, *arm = np.clip(array, -1.0, 1.0).tolist()
        base = Action(linear * self._fastest[0], angular * self._fastest[1])
        if not arm:
            return base
        step = JOINT_SPEED * self._period
        self._told = [
            min(max(told + step * part, low), high)
            for told, part, (low, high) in zip(self._told, arm[:-1], self._limits, strict=True)
        ]
        return replace(base, joints=dict(zip(self.layout.joints, self._told, strict=True)), grasp=arm[-1] > 0.0)


def _limits(robot: RobotSpec, joints: Sequence[str]) -> list[tuple[float, float]]:
    """Returns the limits of joints, radians or metres."""
    if not joints:
        return []
    known = {joint.name: joint for joint in read_urdf(robot.urdf).joints}
    found = []
    for name in joints:
        joint = known[name]
        turns = joint.kind == "continuous" or joint.lower > joint.upper
        found.append((-_TURNS, _TURNS) if turns else (joint.lower, joint.upper))
    return found


def finger_joints(robot: RobotSpec, grasp: bool | None) -> dict[str, float]:
    """Returns where the fingers of a robot's first arm shall be, radians or metres: closed, open, or, for None, nothing."""
    gripper = robot.manipulators[0].gripper if robot.manipulators else None
    if gripper is None or grasp is None:
        return {}
    return dict.fromkeys(gripper.joints, gripper.closed if grasp else gripper.open)
