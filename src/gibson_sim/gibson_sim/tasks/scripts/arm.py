"""What scripted baselines with an arm share: scripts as generators, and where the arm's joints must be. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.description.urdf import read_urdf
from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import Mat4, invert, matrix_from_pose
from gibson_sim.robots.joints.kinematics import Chain
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.tasks.episode import Action, View
from gibson_sim.tasks.scripts.driving import Driver, turn_towards
from gibson_sim.types import Pose, Vec3

Steps = Generator[Action, View, View]
"""Gives an action, gets the view after it; returns the last view."""
JOINT_STEP = 0.12
"""Radians (or metres, a fifth of it) that a joint is told to go in one period of control."""
ARRIVED_RAD = 0.04
"""A joint is where it shall be, radians and metres."""
EXACT_RAD = 0.004
"""The same, where a hand has to be exactly there."""
TOOL_SPEED = 0.15
"""Metres a second on a straight line."""
CONTROL_S = 0.1
"""Seconds between two actions, as a rule."""
NEARER, NEARER_DAMPING = 4, 1e-4
"""Steps by which an arm comes nearer to a point in one period of control, and what damps them."""
WORKS_AT = 0.45
"""Metres above the floor where the hand of an arm works well whose torso is down."""
LEANS, LEAN_DAMPING = 3, 1e-3
"""Steps of an arm that leans in one period of control, and what damps them, m^2."""
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
        spec = robot.manipulators[0] if robot.manipulators else None
        if spec is None or spec.gripper is None:
            raise ConfigError(f"robot {robot.name!r} has no arm with a gripper; choose one that has, such as arm_bot")
        self._fingers = frozenset(spec.gripper.joints)
        self._poses = {pose.name: dict(pose.joints) for pose in robot.named_poses}
        self._tool = f"{robot.name}/{spec.tip_link}"
        model = read_urdf(robot.urdf)
        self._chain = Chain(model, spec.tip_link, spec.joints)
        self.joints, self.fingers = spec.joints, spec.gripper.joints
        """Joints of the arm, and of its fingers."""
        self._limits = {joint.name: (joint.lower, joint.upper) for joint in model.joints if joint.is_bounded}
        slides = {joint.name for joint in model.joints if joint.kind == "prismatic"}
        self._lifts = [name for name in Chain(model, spec.tip_link).names if name in slides and name not in spec.joints]
        self.base_link = robot.base_link

    def tool(self, view: View) -> Pose:
        """Returns T_world_tool."""
        return view.links[self._tool]

    def named(self, name: str) -> dict[str, float]:
        """Returns the joints of a pose, without the fingers."""
        return {joint: position for joint, position in self._poses[name].items() if joint not in self._fingers}

    def lifted(self, z: float) -> dict[str, float]:
        """Returns the joints below the arm, such as a torso that lifts, that bring it to where its hand works well at height ``z``."""
        return {name: min(max(z - WORKS_AT, self._limits[name][0]), self._limits[name][1]) for name in self._lifts}

    def rise(self, view: View, metres: float) -> dict[str, float]:
        """Returns the joints below the arm that raise it by so much, or by as much as they can."""
        return {name: min(view.joints[name] + metres, self._limits[name][1]) for name in self._lifts[:1]}

    def reaching(
        self, view: View, point: Vec3, rotation: NDArray[np.float64] | None = None, *, begin: Mapping[str, float] | None = None
    ) -> dict[str, float] | None:
        """Returns the joints that bring the tool to a world point, with its axes as the columns of ``rotation``; None = it is out of reach.

        Args:
            view: what is known now.
            point: where the tool shall be.
            rotation: (3, 3), world axes; None = any.
            begin: joints from which they are looked for, and those that bear the arm; those that are not named are where they are now.
        """
        T_world_tool: Mat4 = np.eye(4)
        T_world_tool[:3, 3] = point
        if rotation is not None:
            T_world_tool[:3, :3] = rotation
        T_base_tool = invert(matrix_from_pose(view.base)) @ T_world_tool
        start = {**self.named("ready"), **view.joints, **(begin or {})}
        solution = self._chain.solve(T_base_tool, start, rest=self.named("ready"), orientation=rotation is not None)
        if not solution.within(0.01, 0.05):
            return None
        return dict(zip(solution.names, solution.positions, strict=True))

    def leaning(self, view: View, told: Mapping[str, float], point: Vec3, rest: Mapping[str, float]) -> dict[str, float]:
        """Returns the joints of the arm a little on from ``told``, so that the tool comes nearer to a world point; any way round.

        They never jump: an arm that holds something keeps its shape, and goes back to that of ``rest`` as far as the point leaves it free.
        """
        x, y, z = (invert(matrix_from_pose(view.base)) @ np.array([*point, 1.0]))[:3].tolist()
        joints = np.array([told[name] for name in self.joints])
        for _ in range(LEANS):
            T_base_tool, columns = self._chain.jacobian({**view.joints, **dict(zip(self.joints, joints, strict=True))})
            jacobian = columns[:3]
            inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + LEAN_DAMPING * np.eye(3))
            free = np.eye(len(joints)) - inverse @ jacobian
            step = inverse @ (np.array([x, y, z]) - T_base_tool[:3, 3])
            step += 0.1 * free @ (np.array([rest[name] for name in self.joints]) - joints)
            joints = joints + np.clip(step, -JOINT_STEP / LEANS, JOINT_STEP / LEANS)
        return self._within(dict(zip(self.joints, joints.tolist(), strict=True)))

    def still(self, view: View) -> dict[str, float]:
        """Returns the joints of the arm where they are now."""
        return self._within({name: view.joints[name] for name in self.joints})

    def _within(self, joints: Mapping[str, float]) -> dict[str, float]:
        """Returns the joints, each no farther than its limit."""
        limits = {name: self._limits.get(name, (-math.inf, math.inf)) for name in joints}
        return {name: min(max(position, limits[name][0]), limits[name][1]) for name, position in joints.items()}

    def move(
        self,
        view: View,
        joints: Mapping[str, float],
        grasp: bool | None = None,
        pace: float = 1.0,
        tolerance: float = ARRIVED_RAD,
        patience: float = PATIENCE_S,
    ) -> Steps:
        """Moves joints to where they shall be, to within ``tolerance`` radians or metres, the base standing still."""
        until = view.time + patience
        told = {name: view.joints[name] for name in joints}
        while view.time < until:
            if all(abs(view.joints[name] - position) < tolerance for name, position in joints.items()):
                break
            told = {name: stepped(told[name], position, JOINT_STEP * pace) for name, position in joints.items()}
            view = yield Action(joints=told, grasp=grasp)
        return view

    def straight(
        self, view: View, point: Vec3, rotation: NDArray[np.float64], grasp: bool | None = None, speed: float = TOOL_SPEED
    ) -> Steps:
        """Moves the tool to a world point on a straight line, the base standing still; what is out of reach is left out."""
        begin, end = np.array(self.tool(view).position), np.array(point)
        count = max(1, math.ceil(float(np.linalg.norm(end - begin)) / (speed * CONTROL_S)))
        told = {name: view.joints[name] for name in self.joints}
        for k in range(1, count + 1):
            told = self.nearer(view, told, begin + (end - begin) * k / count, rotation)
            view = yield Action(joints=told, grasp=grasp)
        told = self.nearer(view, told, end, rotation)
        return (yield from self.move(view, told, grasp, tolerance=EXACT_RAD))

    def nearer(
        self, view: View, told: Mapping[str, float], point: NDArray[np.float64], rotation: NDArray[np.float64]
    ) -> dict[str, float]:
        """Returns the joints of the arm near ``told`` that bring the tool to a world point with given axes, or near to it."""
        T_world_tool: Mat4 = np.eye(4)
        T_world_tool[:3, :3], T_world_tool[:3, 3] = rotation, point
        target = invert(matrix_from_pose(view.base)) @ T_world_tool
        joints = np.array([told[name] for name in self.joints])
        lower, upper = np.array([self._limits.get(name, (-math.inf, math.inf)) for name in self.joints]).T
        for _ in range(NEARER):
            T_base_tool, jacobian = self._chain.jacobian({**view.joints, **dict(zip(self.joints, joints, strict=True))})
            turn = np.cross(T_base_tool[:3, :3], target[:3, :3], axis=0).sum(axis=1) / 2.0
            error = np.concatenate([target[:3, 3] - T_base_tool[:3, 3], turn])
            step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + NEARER_DAMPING * np.eye(6), error)
            joints = np.clip(joints + np.clip(step, -JOINT_STEP, JOINT_STEP), lower, upper)
        return dict(zip(self.joints, joints.tolist(), strict=True))


def pointing(ahead: ArrayLike, across: ArrayLike) -> NDArray[np.float64]:
    """Returns the axes of a tool, (3, 3), world frame, that points to ``ahead`` (3,) and whose fingers move along ``across`` (3,)."""
    x, y = np.asarray(ahead, dtype=np.float64), np.asarray(across, dtype=np.float64)
    x = x / np.linalg.norm(x)
    y = y - x * (x @ y)
    y = y / np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def stepped(now: float, wanted: float, step: float) -> float:
    """Returns a number nearer to what is wanted by at most ``step``."""
    return now + max(-step, min(step, wanted - now))


def wait(view: View, seconds: float, action: Action) -> Steps:
    """Does one thing for a while."""
    until = view.time + seconds
    while view.time < until:
        view = yield action
    return view


def drive(view: View, driver: Driver, grasp: bool | None = None, longest: float = 60.0, *, waits: bool = True) -> Steps:
    """Lets a driver drive until it is there; where there is no way it waits for one, or gives up."""
    until = view.time + longest
    while not driver.done(view) and view.time < until and (waits or not driver.blocked):
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
