"""Scripts as generators of actions, and arm kinematics for scripts. Pure."""

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
from gibson_sim.tasks.episode import Action, Observation
from gibson_sim.tasks.scripts.driving import Driver, turn_towards
from gibson_sim.types import Pose, Vec3

Steps = Generator[Action, Observation, Observation]
"""Generator that yields actions, receives the observation after each, and returns the last observation."""
JOINT_STEP = 0.12
"""Largest change of a joint target per control period, radians or metres."""
ARRIVED_RAD = 0.04
"""Tolerance of joint targets, radians or metres."""
EXACT_RAD = 0.004
"""Tolerance of joint targets if the tool position must be exact, radians or metres."""
TOOL_SPEED = 0.15
"""Speed of the tool on a straight line, m/s."""
CONTROL_S = 0.1
"""Default control period, seconds."""
POSE_STEPS, POSE_DAMPING = 4, 1e-4
"""Iterations per control period of ``Arm.towards_pose``, and the damping of its pseudo-inverse."""
WORKS_AT = 0.45
"""Height above the floor at which the gripper has good reach with a lowered torso, metres."""
POINT_STEPS, POINT_DAMPING = 3, 1e-3
"""Iterations per control period of ``Arm.towards_point``, and the damping of its pseudo-inverse, m^2."""
PATIENCE_S = 6.0
"""Timeout of a movement, seconds; afterwards the script continues with its next step."""


class Script:
    """A policy that runs a generator of actions; after its end the robot does not move."""

    def __init__(self, steps: Callable[[Observation], Steps]) -> None:
        self._create = steps
        self._steps: Steps | None = None
        self._last = Action()

    def act(self, obs: Observation) -> Action:
        """Returns the next action."""
        try:
            if self._steps is None:
                self._steps = self._create(obs)
                self._last = next(self._steps)
            else:
                self._last = self._steps.send(obs)
        except StopIteration:
            self._last = Action(grasp=self._last.grasp)
        return self._last


class Arm:
    """The first arm of a robot, for scripts.

    Args:
        robot: the robot.

    Raises:
        ConfigError: the robot has no arm with a gripper.
    """

    def __init__(self, robot: RobotSpec) -> None:
        spec = robot.manipulators[0] if robot.manipulators else None
        if spec is None or spec.gripper is None:
            raise ConfigError(f"robot {robot.name!r} has no arm with a gripper; choose a robot that has one, such as arm_bot")
        self._fingers = frozenset(spec.gripper.joints)
        self._poses = {pose.name: dict(pose.joints) for pose in robot.named_poses}
        self._tool = f"{robot.name}/{spec.tip_link}"
        model = read_urdf(robot.urdf)
        self._chain = Chain(model, spec.tip_link, spec.joints)
        self.joints, self.fingers = spec.joints, spec.gripper.joints
        """Names of the joints of the arm, and of its fingers."""
        self._limits = {joint.name: (joint.lower, joint.upper) for joint in model.joints if joint.is_bounded}
        slides = {joint.name for joint in model.joints if joint.kind == "prismatic"}
        self._lifts = [name for name in Chain(model, spec.tip_link).names if name in slides and name not in spec.joints]
        self.base_link = robot.base_link

    def tool(self, obs: Observation) -> Pose:
        """Returns T_world_tool."""
        return obs.links[self._tool]

    def named(self, name: str) -> dict[str, float]:
        """Returns the joint positions of a named pose, without the fingers."""
        return {joint: position for joint, position in self._poses[name].items() if joint not in self._fingers}

    def lifted(self, z: float) -> dict[str, float]:
        """Returns positions of the lift joints below the arm, such as a torso, that give the gripper good reach at height ``z``, metres."""
        return {name: min(max(z - WORKS_AT, self._limits[name][0]), self._limits[name][1]) for name in self._lifts}

    def rise(self, obs: Observation, metres: float) -> dict[str, float]:
        """Returns the position of the lift joint below the arm that raises it by ``metres``, or to its limit."""
        return {name: min(obs.joints[name] + metres, self._limits[name][1]) for name in self._lifts[:1]}

    def reaching(
        self,
        obs: Observation,
        point: Vec3,
        rotation: NDArray[np.float64] | None = None,
        *,
        begin: Mapping[str, float] | None = None,
    ) -> dict[str, float] | None:
        """Returns joint positions for a tool pose (inverse kinematics); None = out of reach.

        Args:
            obs: the current observation.
            point: target position of the tool, world frame, metres.
            rotation: (3, 3), axes of the tool as columns, world frame; None = any.
            begin: initial guess of the solver, and positions of the joints below the arm; default = the current positions.
        """
        T_world_tool: Mat4 = np.eye(4)
        T_world_tool[:3, 3] = point
        if rotation is not None:
            T_world_tool[:3, :3] = rotation
        T_base_tool = invert(matrix_from_pose(obs.base)) @ T_world_tool
        start = {**self.named("ready"), **obs.joints, **(begin or {})}
        solution = self._chain.solve(T_base_tool, start, rest=self.named("ready"), orientation=rotation is not None)
        if not solution.within(0.01, 0.05):
            return None
        return dict(zip(solution.names, solution.positions, strict=True))

    def towards_point(
        self, obs: Observation, targets: Mapping[str, float], point: Vec3, rest: Mapping[str, float]
    ) -> dict[str, float]:
        """Returns joint targets, one step from ``targets``, so that the tool approaches a world point in any orientation.

        Targets never jump, so an arm that holds an object keeps its posture; null-space motion approaches the posture ``rest``.
        """
        x, y, z = (invert(matrix_from_pose(obs.base)) @ np.array([*point, 1.0]))[:3].tolist()
        joints = np.array([targets[name] for name in self.joints])
        for _ in range(POINT_STEPS):
            T_base_tool, columns = self._chain.jacobian({**obs.joints, **dict(zip(self.joints, joints, strict=True))})
            jacobian = columns[:3]
            inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + POINT_DAMPING * np.eye(3))
            null_space = np.eye(len(joints)) - inverse @ jacobian
            step = inverse @ (np.array([x, y, z]) - T_base_tool[:3, 3])
            step += 0.1 * null_space @ (np.array([rest[name] for name in self.joints]) - joints)
            joints = joints + np.clip(step, -JOINT_STEP / POINT_STEPS, JOINT_STEP / POINT_STEPS)
        return self._within(dict(zip(self.joints, joints.tolist(), strict=True)))

    def still(self, obs: Observation) -> dict[str, float]:
        """Returns the current positions of the arm joints as targets."""
        return self._within({name: obs.joints[name] for name in self.joints})

    def _within(self, joints: Mapping[str, float]) -> dict[str, float]:
        """Returns joint positions clipped to their limits."""
        limits = {name: self._limits.get(name, (-math.inf, math.inf)) for name in joints}
        return {name: min(max(position, limits[name][0]), limits[name][1]) for name, position in joints.items()}

    def move(
        self,
        obs: Observation,
        joints: Mapping[str, float],
        grasp: bool | None = None,
        pace: float = 1.0,
        tolerance: float = ARRIVED_RAD,
        patience: float = PATIENCE_S,
    ) -> Steps:
        """Moves joints to targets, to within ``tolerance`` radians or metres, while the base does not move."""
        until = obs.time + patience
        targets = {name: obs.joints[name] for name in joints}
        while obs.time < until:
            if all(abs(obs.joints[name] - position) < tolerance for name, position in joints.items()):
                break
            targets = {name: stepped(targets[name], position, JOINT_STEP * pace) for name, position in joints.items()}
            obs = yield Action(joints=targets, grasp=grasp)
        return obs

    def straight(
        self, obs: Observation, point: Vec3, rotation: NDArray[np.float64], grasp: bool | None = None, speed: float = TOOL_SPEED
    ) -> Steps:
        """Moves the tool to a world point along a straight line, as far as it can reach, while the base does not move."""
        begin, end = np.array(self.tool(obs).position), np.array(point)
        count = max(1, math.ceil(float(np.linalg.norm(end - begin)) / (speed * CONTROL_S)))
        targets = {name: obs.joints[name] for name in self.joints}
        for k in range(1, count + 1):
            targets = self.towards_pose(obs, targets, begin + (end - begin) * k / count, rotation)
            obs = yield Action(joints=targets, grasp=grasp)
        targets = self.towards_pose(obs, targets, end, rotation)
        return (yield from self.move(obs, targets, grasp, tolerance=EXACT_RAD))

    def towards_pose(
        self, obs: Observation, targets: Mapping[str, float], point: NDArray[np.float64], rotation: NDArray[np.float64]
    ) -> dict[str, float]:
        """Returns joint targets near ``targets`` that move the tool to, or closer to, a world point with the given axes."""
        T_world_tool: Mat4 = np.eye(4)
        T_world_tool[:3, :3], T_world_tool[:3, 3] = rotation, point
        target = invert(matrix_from_pose(obs.base)) @ T_world_tool
        joints = np.array([targets[name] for name in self.joints])
        lower, upper = np.array([self._limits.get(name, (-math.inf, math.inf)) for name in self.joints]).T
        for _ in range(POSE_STEPS):
            T_base_tool, jacobian = self._chain.jacobian({**obs.joints, **dict(zip(self.joints, joints, strict=True))})
            rotation_error = np.cross(T_base_tool[:3, :3], target[:3, :3], axis=0).sum(axis=1) / 2.0
            error = np.concatenate([target[:3, 3] - T_base_tool[:3, 3], rotation_error])
            step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + POSE_DAMPING * np.eye(6), error)
            joints = np.clip(joints + np.clip(step, -JOINT_STEP, JOINT_STEP), lower, upper)
        return dict(zip(self.joints, joints.tolist(), strict=True))


def pointing(ahead: ArrayLike, across: ArrayLike) -> NDArray[np.float64]:
    """Returns the axes of a tool, (3, 3), world frame, that points along ``ahead`` (3,) and whose fingers move along ``across`` (3,)."""
    x, y = np.asarray(ahead, dtype=np.float64), np.asarray(across, dtype=np.float64)
    x = x / np.linalg.norm(x)
    y = y - x * (x @ y)
    y = y / np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def stepped(current: float, target: float, step: float) -> float:
    """Returns ``current`` moved towards ``target`` by at most ``step``."""
    return current + max(-step, min(step, target - current))


def wait(obs: Observation, seconds: float, action: Action) -> Steps:
    """Repeats one action for ``seconds``."""
    until = obs.time + seconds
    while obs.time < until:
        obs = yield action
    return obs


def drive(obs: Observation, driver: Driver, grasp: bool | None = None, longest: float = 60.0, *, waits: bool = True) -> Steps:
    """Runs a driver until it has arrived; if no path exists, waits for one, or gives up with ``waits=False``."""
    until = obs.time + longest
    while not driver.done(obs) and obs.time < until and (waits or not driver.blocked):
        action = driver.act(obs)
        obs = yield Action(action.linear, action.angular, grasp=grasp)
    return obs


def face(obs: Observation, yaw: float, tolerance: float = 0.02) -> Steps:
    """Turns the base to a heading, radians."""
    until = obs.time + PATIENCE_S
    while abs(math.remainder(yaw - obs.yaw, 2.0 * math.pi)) > tolerance and obs.time < until:
        obs = yield Action(angular=turn_towards(obs, yaw))
    return obs


def creep(obs: Observation, metres: float, speed: float = 0.15, grasp: bool | None = None) -> Steps:
    """Drives straight ahead by ``metres``, backwards if negative."""
    begin, until = obs.xy, obs.time + abs(metres) / speed + 2.0
    while math.dist(obs.xy, begin) < abs(metres) and obs.time < until:
        obs = yield Action(linear=math.copysign(speed, metres), grasp=grasp)
    return obs
