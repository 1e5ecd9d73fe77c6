"""Converts an action array of numbers from -1 to 1 to an action of a robot. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from gibson_sim.description.urdf import read_urdf
from gibson_sim.errors import CommandError, ConfigError
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.tasks.episode import Action, Observation
from gibson_sim.tasks.observing import ObservationLayout

JOINT_SPEED = 1.0
"""Speed of an arm joint at action 1, rad/s or m/s."""
_TURNS = 4.0 * math.pi
"""Bounds of a continuous joint, radians."""


class Controls:
    """Decodes action arrays of one robot: forward speed and yaw rate; with an arm also the speed of each joint, and the gripper.

    Args:
        robot: the robot; only its first arm is controlled.
        period: control period, seconds.
        reverse: largest reverse speed as a fraction of the forward speed limit, 0 to 1; the range of speeds is mapped to -1 to 1.

    Raises:
        ConfigError: the robot has no drive, or ``reverse`` is out of range.
    """

    def __init__(self, robot: RobotSpec, period: float, reverse: float = 1.0) -> None:
        if not 0.0 <= reverse <= 1.0:
            raise ConfigError(f"reverse is {reverse}, must be 0 (never backwards) to 1 (as fast as forwards)")
        if robot.drive is None:
            raise ConfigError(f"robot {robot.name!r} has no drive; tasks need a robot with a drive")
        self._max_speeds = (robot.drive.max_linear, robot.drive.max_angular)
        self._period, self._reverse = period, reverse
        joints = robot.manipulators[0].joints if robot.manipulators else ()
        self._limits = _limits(robot, joints)
        self.layout = ObservationLayout(joints, tuple(low for low, _ in self._limits), tuple(high for _, high in self._limits))
        """Layout of the observation arrays."""
        self.size = 2 + (len(joints) + 1 if joints else 0)
        """Length of an action array."""
        self._targets: list[float] = []

    def begin(self, obs: Observation) -> None:
        """Begins an episode: the arm holds its current position."""
        self._targets = [obs.joints[name] for name in self.layout.joints]

    def action(self, values: ArrayLike, obs: Observation) -> Action:
        """Returns the action of an array, (``size``,); values are clipped to -1 to 1.

        Raises:
            CommandError: the array has another shape, or contains a value that is not finite.
        """
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (self.size,) or not np.isfinite(array).all():
            raise CommandError(f"action is {array.tolist()}, must be {self.size} finite numbers from -1 to 1")
        linear, angular, *arm = np.clip(array, -1.0, 1.0).tolist()
        forward = 0.5 * ((1.0 + self._reverse) * linear + 1.0 - self._reverse)
        base = Action(forward * self._max_speeds[0], angular * self._max_speeds[1])
        if not arm:
            return base
        step = JOINT_SPEED * self._period
        self._targets = [
            min(max(target + step * speed, low), high)
            for target, speed, (low, high) in zip(self._targets, arm[:-1], self._limits, strict=True)
        ]
        return replace(base, joints=dict(zip(self.layout.joints, self._targets, strict=True)), grasp=arm[-1] > 0.0)


def _limits(robot: RobotSpec, joints: Sequence[str]) -> list[tuple[float, float]]:
    """Returns the limits of joints, radians or metres."""
    if not joints:
        return []
    known = {joint.name: joint for joint in read_urdf(robot.urdf).joints}
    limits = []
    for name in joints:
        joint = known[name]
        unlimited = joint.kind == "continuous" or joint.lower > joint.upper
        limits.append((-_TURNS, _TURNS) if unlimited else (joint.lower, joint.upper))
    return limits


def finger_joints(robot: RobotSpec, grasp: bool | None) -> dict[str, float]:
    """Returns the target positions of the first arm's finger joints, radians or metres; empty for None or without a gripper."""
    gripper = robot.manipulators[0].gripper if robot.manipulators else None
    if gripper is None or grasp is None:
        return {}
    return dict.fromkeys(gripper.joints, gripper.closed if grasp else gripper.open)
