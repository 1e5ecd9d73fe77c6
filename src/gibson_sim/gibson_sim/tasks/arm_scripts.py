"""What scripted baselines with an arm share: scripts as generators, and where the arm's joints must be. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import Mat4, invert, matrix_from_pose
from gibson_sim.physics.kinematics import Chain
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.robots.urdf import read_urdf
from gibson_sim.tasks.driving import Driver, turn_towards
from gibson_sim.tasks.episode import Action, View
from gibson_sim.types import Pose, Vec3

Steps = Generator[Action, View, View]
"""Gives an action, gets the view after it; returns the last view."""
JOINT_STEP = 0.12
"""Radians (or metres, a fifth of it) that a joint is told to go in one period of control."""
ARRIVED_RAD = 0.04
"""A joint is where it shall be, radians and metres."""
PATIENCE_S = 6.0
"""A movement that takes longer is given up; what comes next shows whether it mattered."""


class Script:
    """A policy that follows steps; when they are over, the robot stands still."""

    def __init__(self, steps: Callable[[View], Steps]) -> None:
        self._make = steps
        self._steps: Steps | None = None
        self._last = Action()

    def act(self, view: View) -> Action:
        """Returns what to do next."""
        try:
            if self._steps is None:
                self._steps = self._make(view)
                self._last = next(self._steps)
            else:
                self._last = self._steps.send(view)
        except StopIteration:
            self._last = Action(grasp=self._last.grasp)
        return self._last


class Arm:
    """The first arm of a robot, for scripts.

    Args:
        robot: which.

    Raises:
        ConfigError: it has no arm with a gripper.
    """

    def __init__(self, robot: RobotSpec) -> None:
        if not robot.manipulators or robot.manipulators[0].gripper is None:
            raise ConfigError(f"robot {robot.name!r} has no arm with a gripper; choose one that has, such as arm_bot")
        spec = robot.manipulators[0]
        self._fingers = frozenset(spec.gripper.joints if spec.gripper else ())
        self._poses = {pose.name: dict(pose.joints) for pose in robot.named_poses}
        self._tool = f"{robot.name}/{spec.tip_link}"
        self._chain = Chain(read_urdf(robot.urdf), spec.tip_link, spec.joints)
        self.base_link = robot.base_link

    def tool(self, view: View) -> Pose:
        """Returns T_world_tool."""
        return view.links[self._tool]

    def named(self, name: str) -> dict[str, float]:
        """Returns the joints of a pose, without the fingers."""
        return {joint: position for joint, position in self._poses[name].items() if joint not in self._fingers}

    def reaching(self, view: View, point: Vec3, rotation: NDArray[np.float64] | None = None) -> dict[str, float] | None:
        """Returns the joints that bring the tool to a world point, with its axes as the columns of ``rotation``; None = it is out of reach."""
        T_world_tool: Mat4 = np.eye(4)
        T_world_tool[:3, 3] = point
        if rotation is not None:
            T_world_tool[:3, :3] = rotation
        T_base_tool = invert(matrix_from_pose(view.base)) @ T_world_tool
        start = {**self.named("ready"), **view.joints}
        solution = self._chain.solve(T_base_tool, start, rest=self.named("ready"), orientation=rotation is not None)
        if not solution.within(0.01, 0.05):
            return None
        return dict(zip(solution.names, solution.positions, strict=True))

    def move(self, view: View, joints: Mapping[str, float], grasp: bool | None = None, pace: float = 1.0) -> Steps:
        """Moves joints to where they shall be, the base standing still."""
        until = view.time + PATIENCE_S
        told = {name: view.joints[name] for name in joints}
        while view.time < until:
            if all(abs(view.joints[name] - position) < ARRIVED_RAD for name, position in joints.items()):
                break
            told = {name: stepped(told[name], position, JOINT_STEP * pace) for name, position in joints.items()}
            view = yield Action(joints=told, grasp=grasp)
        return view


def stepped(now: float, wanted: float, step: float) -> float:
    """Returns a number nearer to what is wanted by at most ``step``."""
    return now + max(-step, min(step, wanted - now))


def wait(view: View, seconds: float, action: Action) -> Steps:
    """Does one thing for a while."""
    until = view.time + seconds
    while view.time < until:
        view = yield action
    return view


def drive(view: View, driver: Driver, grasp: bool | None = None, longest: float = 60.0) -> Steps:
    """Lets a driver drive until it is there."""
    until = view.time + longest
    while not driver.done(view) and view.time < until:
        action = driver.act(view)
        view = yield Action(action.linear, action.angular, grasp=grasp)
    return view


def face(view: View, yaw: float, tolerance: float = 0.02) -> Steps:
    """Turns the base to a heading, radians."""
    until = view.time + PATIENCE_S
    while abs(math.remainder(yaw - view.yaw, 2.0 * math.pi)) > tolerance and view.time < until:
        view = yield Action(angular=turn_towards(view, yaw))
    return view


def creep(view: View, metres: float, speed: float = 0.15, grasp: bool | None = None) -> Steps:
    """Drives straight on, or, for negative metres, back."""
    begin, until = view.xy, view.time + abs(metres) / speed + 2.0
    while math.dist(view.xy, begin) < abs(metres) and view.time < until:
        view = yield Action(linear=math.copysign(speed, metres), grasp=grasp)
    return view
