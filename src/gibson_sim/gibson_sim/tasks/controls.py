"""From an array of numbers between -1 and 1 to what a robot does. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gibson_sim.errors import CommandError, ConfigError
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.tasks.episode import Action, View
from gibson_sim.tasks.observing import Layout


class Controls:
    """What an array of actions means for one robot: forward speed, yaw rate.

    Args:
        robot: which.
        period: seconds between two actions.

    Raises:
        ConfigError: the robot cannot drive.
    """

    def __init__(self, robot: RobotSpec, period: float) -> None:
        if robot.drive is None:
            raise ConfigError(f"robot {robot.name!r} has no drive; tasks need one that moves")
        self._fastest = (robot.drive.max_linear, robot.drive.max_angular)
        self._period = period
        self.layout = Layout((), (), ())
        """Of observations."""
        self.size = 2
        """How many numbers an action has."""

    def begin(self, view: View) -> None:
        """Begins an episode."""

    def action(self, values: ArrayLike, view: View) -> Action:
        """Returns what an array (``size``,) asks for; numbers beyond -1 and 1 are clipped.

        Raises:
            CommandError: its shape is another, or it holds a NaN.
        """
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (self.size,) or not np.isfinite(array).all():
            raise CommandError(f"action is {array.tolist()}, must be {self.size} finite numbers from -1 to 1")
        linear, angular = np.clip(array, -1.0, 1.0)
        return Action(float(linear) * self._fastest[0], float(angular) * self._fastest[1])


def finger_joints(robot: RobotSpec, grasp: bool | None) -> dict[str, float]:
    """Returns where the fingers of a robot's first arm shall be, radians or metres: closed, open, or, for None, nothing."""
    gripper = robot.manipulators[0].gripper if robot.manipulators else None
    if gripper is None or grasp is None:
        return {}
    return dict.fromkeys(gripper.joints, gripper.closed if grasp else gripper.open)
