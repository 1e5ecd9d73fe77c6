"""The arms of all robots in a world: grippers, tools, Cartesian servos, and the collisions of their robots.

    world.arms.grasp(robot, arm)             grasps the object in reach, by the rules of ``robots.joints.grasping``: returns a GraspState
    world.arms.release(robot, arm)           releases it
    world.arms.grasp_state(robot, arm)       the held object, and the force
    world.arms.move_gripper(robot, opening)  0 = closed, 1 = open; closing grasps and opening releases, as with any command to its joints
    world.arms.tool_pose(robot, arm)         T_world_tool
    world.arms.solve_arm(robot, target)      joint positions of the arm for a tool pose T_world_tool: a ChainSolution
    world.arms.servo(robot, ToolTwist(...))  moves the tool at a velocity until the timeout of ``ServoSettings``

``arm`` is a name from the robot's file; if empty or omitted, it is the robot's first arm. The topics of ``docs/manipulation.md`` do the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gibson_sim.errors import CommandError, RobotError
from gibson_sim.geometry.transforms import matrix_from_quat
from gibson_sim.physics.attachments import Attachments
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.engine_types import EngineContact
from gibson_sim.physics.grasper import Grasper
from gibson_sim.physics.link_poses import link_pose
from gibson_sim.physics.proximity import Proximity
from gibson_sim.physics.robot import RobotInWorld
from gibson_sim.quoting import quoted
from gibson_sim.robots.collision_count import STANDING_HEIGHT, STANDING_NORMAL, CollisionCount, CollisionCounter
from gibson_sim.robots.joints.commands import JointCommand, JointPositions, JointTrajectory, JointVelocities
from gibson_sim.robots.joints.grasping import GraspSettings, GraspState, gripper_move
from gibson_sim.robots.joints.kinematics import ChainSolution
from gibson_sim.robots.joints.servo import F64, ServoSettings, ToolTwist, limited_twist, servo_speeds
from gibson_sim.robots.spec import GripperSpec, ManipulatorSpec
from gibson_sim.types import NS_PER_S, Pose, SceneState

_PERIOD_NS = NS_PER_S // 100
"""Period at which the joint velocities are computed, simulation time, ns."""


@dataclass(slots=True)
class _RobotArms:
    """The arms of one robot."""

    robot: RobotInWorld
    graspers: dict[str, Grasper]
    """Graspers by arm name; arms without a gripper are missing."""
    servos: dict[str, _ToolServo]
    """Servos by arm name."""
    hands: frozenset[int]
    """Engine indices of the links whose contacts do not count as collisions."""
    base_height: float
    """Height of the base frame above the inertial frame of the root link, metres, with the robot upright."""
    counter: CollisionCounter | None
    """Counter of the robot's collisions; None = collisions are not counted."""


class ArmsInWorld:
    """Arms of the robots currently in the world."""

    def __init__(
        self,
        bullet: Bullet,
        robots: Mapping[str, RobotInWorld],
        bodies: Callable[[], Sequence[BodyInWorld]],
        attachments: Attachments,
        *,
        state_of: Callable[[str], SceneState],
        now_ns: Callable[[], int],
        grasping: GraspSettings,
        servo: ServoSettings,
    ) -> None:
        """Uses a mapping of robots owned by the world; robots may be added and removed.

        Args:
            bullet: The engine.
            robots: Robots by name; the mapping may change.
            bodies: Returns all robots and bodies.
            attachments: Joints between grippers and held objects.
            state_of: Returns the poses of at least the links of one robot, by its name.
            now_ns: Returns the simulation time.
            grasping: Settings of all grippers.
            servo: Settings of all servos.
        """
        self._bullet, self._robots, self._bodies, self._attachments = bullet, robots, bodies, attachments
        self._state_of, self._now_ns = state_of, now_ns
        self._grasping, self._servo = grasping, servo
        self._proximity = Proximity(bullet)
        self._by_robot: dict[str, _RobotArms] = {}
        """Arms by robot name, created at first use."""
        self._counted: set[str] = set()
        """Robots whose collisions are counted, which takes a few percent of a step."""

    def grasp(self, robot: str, arm: str = "", *, target: str = "") -> GraspState:
        """Grasps the object in reach, immediately; has no effect if the gripper already holds an object.

        assisted: the nearest movable handle or knob, else the nearest movable link, within the configured distance of the tool.
        sticky: the object that the hand touches, now or within a second. physical: nothing; the fingers hold by friction.

        Args:
            robot: Name of the robot.
            arm: Name of the arm.
            target: The only robot or body that may be grasped; empty = any.

        Returns:
            The state of the grasp; if nothing is held, ``reason`` explains it.

        Raises:
            CommandError: the robot, arm, gripper or target does not exist.
        """
        grasper = self._grasper(robot, arm)
        grasper.grasp(self._now_ns(), target)
        return grasper.state()

    def release(self, robot: str, arm: str = "") -> GraspState:
        """Releases the held object, if any; raises CommandError if the robot, arm or gripper does not exist."""
        grasper = self._grasper(robot, arm)
        grasper.release()
        return grasper.state()

    def grasp_state(self, robot: str, arm: str = "") -> GraspState:
        """Returns the state of a grasp; raises CommandError if the robot, arm or gripper does not exist."""
        return self._grasper(robot, arm).state()

    def move_gripper(self, robot: str, opening: float, arm: str = "", *, max_effort: float = 0.0) -> None:
        """Moves the fingers together.

        Args:
            robot: Name of the robot.
            opening: 0 = closed, 1 = open.
            arm: Name of the arm.
            max_effort: Limit for each finger, N or N m; 0 = the limit in the robot's file.

        Raises:
            CommandError: the robot, arm or gripper does not exist, or a number is out of range.
        """
        gripper = _gripper(robot, self._spec(robot, arm))
        if not 0.0 <= opening <= 1.0:
            raise CommandError(f"opening of a gripper is {opening}, must be 0 (closed) to 1 (open)")
        position = gripper.closed + opening * (gripper.open - gripper.closed)
        efforts = (max_effort or gripper.max_effort,) * len(gripper.joints)
        self.command_joints(robot, JointPositions((position,) * len(gripper.joints), gripper.joints, efforts))

    def tool_pose(self, robot: str, arm: str = "") -> Pose:
        """Returns T_world_tool; raises CommandError if the robot or arm does not exist."""
        tip = self._spec(robot, arm).tip_link
        return link_pose(self._state_of(robot), f"{robot}/{tip}")

    def solve_arm(self, robot: str, target: Pose, arm: str = "", *, orientation: bool = True) -> ChainSolution:
        """Solves the inverse kinematics of an arm for a tool pose ``target`` (T_world_tool) at the robot's current pose; nothing moves.

        ``JointPositions(solution.positions, solution.names)`` moves the arm to the solution. Redundant joints approach the pose in which
        the robot starts. Check ``solution.within(...)``: the solution for an unreachable target has an error.

        Args:
            robot: Name of the robot.
            target: Target pose of the tool.
            arm: Name of the arm.
            orientation: Whether the orientation of the target counts.

        Raises:
            CommandError: the robot or arm does not exist.
        """
        spec, start = self._spec(robot, arm), dict(self._robots[robot].spec.joints)
        rest = {name: start.get(name, 0.0) for name in spec.joints}
        return self._robots[robot].solve_chain(
            self._bullet, spec.tip_link, target, joints=spec.joints, rest=rest, orientation=orientation
        )

    def servo(self, robot: str, twist: ToolTwist, arm: str = "") -> None:
        """Moves a tool at a velocity relative to the robot's base, from the next step on, until the timeout of ``ServoSettings``.

        Raises:
            CommandError: the robot, arm or frame does not exist.
        """
        self._arms_of(robot).servos[self._spec(robot, arm).name].command(twist, self._now_ns())

    def command_joints(self, robot: str, command: JointCommand) -> None:
        """Moves joints of a robot from the next step on; see ``PhysicsWorld.command_joints``.

        A command that closes a gripper also grasps, one that opens it also releases, and one that names joints of an arm stops its servo.
        """
        arms, now_ns = self._arms_of(robot), self._now_ns()
        arms.robot.command_joints(self._bullet, command, now_ns)
        if not arms.robot.spec.manipulators or arms.robot.motors is None:
            return
        positions = arms.robot.joint_positions(self._bullet)
        commandable = {name: positions[name] for name in arms.robot.motors.names}
        for arm in arms.robot.spec.manipulators:
            if not command.names or set(command.names) & set(arm.joints):
                arms.servos[arm.name].stop()
            if arm.gripper is None:
                continue
            move = gripper_move(arm.gripper, command, commandable)
            if move == "closes":
                arms.graspers[arm.name].grasp(now_ns)
            elif move == "opens":
                arms.graspers[arm.name].release("let go: the gripper opened")

    def collision_count(self, robot: str, step_hz: int) -> CollisionCount:
        """Returns the collisions of a robot since the first call, or since a reset; see ``PhysicsWorld.collisions``."""
        arms = self._arms_of(robot)
        if arms.counter is None:
            self._counted.add(robot)
            arms.counter = CollisionCounter()
        return arms.counter.total(step_hz)

    def touching(self, robot: str) -> tuple[str, ...]:
        """Returns the names of the objects that a robot collided with in the last step; see ``PhysicsWorld.touching``."""
        arms = self._arms_of(robot)
        collisions = self._collisions(arms, self._bullet.contacts(arms.robot.engine_body))
        return tuple(sorted({other for _, other in collisions}))

    # Called by the world

    def before_step(self, now_ns: int, step_ns: int) -> None:
        """Sets the joint velocities of the servos for the step that begins at ``now_ns``."""
        for arms in self._by_robot.values():
            for servo in arms.servos.values():
                servo.before_step(now_ns, step_ns)

    def after_step(self, now_ns: int) -> None:
        """Counts collisions and updates the grippers after the step that ended at ``now_ns``."""
        for arms in self._by_robot.values():
            busy = [grasper for grasper in arms.graspers.values() if grasper.is_busy]
            if not busy and arms.counter is None:
                continue
            contacts = self._bullet.contacts(arms.robot.engine_body)
            if arms.counter is not None:
                arms.counter.add_step(now_ns, self._collisions(arms, contacts))
            for grasper in busy:
                grasper.after_step(now_ns, contacts)

    def remove(self, robot: str) -> None:
        """Forgets a robot that is about to be removed."""
        self._by_robot.pop(robot, None)
        self._counted.discard(robot)

    def reset(self) -> None:
        """Forgets everything except which robots' collisions are counted; call it after all robots are back at their starts."""
        self._by_robot.clear()
        for robot in self._counted:
            self._arms_of(robot)

    def forget_commands(self) -> None:
        """Stops the servos, whose commands have stamps of another time; grippers keep their objects."""
        for arms in self._by_robot.values():
            for servo in arms.servos.values():
                servo.stop()
            for grasper in arms.graspers.values():
                grasper.stop_closing()

    # Inside

    def _spec(self, robot: str, arm: str) -> ManipulatorSpec:
        """Returns an arm, the first one if the name is empty; raises CommandError if it does not exist."""
        try:
            return self._robot(robot).spec.manipulator(arm)
        except RobotError as error:
            raise CommandError(str(error)) from error

    def _grasper(self, robot: str, arm: str) -> Grasper:
        spec = self._spec(robot, arm)
        _gripper(robot, spec)
        return self._arms_of(robot).graspers[spec.name]

    def _robot(self, name: str) -> RobotInWorld:
        if name not in self._robots:
            raise CommandError(f"no robot {quoted(name)} in this world; known: {', '.join(self._robots) or 'none'}")
        return self._robots[name]

    def _arms_of(self, name: str) -> _RobotArms:
        robot = self._robot(name)
        if name not in self._by_robot:
            graspers = {
                arm.name: Grasper(self._bullet, robot, arm, self._attachments, self._proximity, self._bodies, self._grasping)
                for arm in robot.spec.manipulators
                if arm.gripper is not None
            }
            servos = {arm.name: _ToolServo(self._bullet, robot, arm, self._servo) for arm in robot.spec.manipulators}
            hands = frozenset(row for grasper in graspers.values() for row in grasper.rows)
            height = robot.root_state(self._bullet)[0].position[2] - self._bullet.raw_root(robot.engine_body)[2]
            counter = CollisionCounter() if name in self._counted else None
            self._by_robot[name] = _RobotArms(robot, graspers, servos, hands, height, counter)
        return self._by_robot[name]

    def _collisions(self, arms: _RobotArms, contacts: Sequence[EngineContact]) -> dict[tuple[str, str], float]:
        """Returns (link, other) -> force, N, of contacts that count as collisions: not those with the floor, of hands, or with held objects."""
        floor = self._bullet.raw_root(arms.robot.engine_body)[2] + arms.base_height + STANDING_HEIGHT
        out: dict[tuple[str, str], float] = {}
        for contact in contacts:
            if contact.link in arms.hands or (contact.normal[2] > STANDING_NORMAL and contact.position[2] < floor):
                continue
            if any(grasper.held == contact.other for grasper in arms.graspers.values()):
                continue
            key = arms.robot.link_of_row(contact.link), contact.other
            out[key] = max(out.get(key, 0.0), contact.force)
        return out


def _gripper(robot: str, arm: ManipulatorSpec) -> GripperSpec:
    if arm.gripper is None:
        raise CommandError(f"arm {quoted(arm.name)} of robot {quoted(robot)} has no gripper; add one to its robot.yaml")
    return arm.gripper


class _ToolServo:
    """Moves the tool of one arm."""

    def __init__(self, bullet: Bullet, robot: RobotInWorld, arm: ManipulatorSpec, settings: ServoSettings) -> None:
        """Starts without a command.

        Args:
            bullet: The engine.
            robot: The robot, loaded.
            arm: One of its arms.
            settings: Limits and damping of the servo.
        """
        self._bullet, self._robot, self._arm, self._settings = bullet, robot, arm, settings
        self._chain = robot.chain(arm.tip_link, arm.joints)
        joints = [robot.model.joint(name) for name in self._chain.names]
        self._lower = np.array([joint.lower if joint.is_bounded else -np.inf for joint in joints])
        self._upper = np.array([joint.upper if joint.is_bounded else np.inf for joint in joints])
        self._fastest = np.array([joint.velocity or np.inf for joint in joints])
        start = dict(robot.spec.joints)
        self._home = np.array([start.get(name, 0.0) for name in self._chain.names])
        self._twist: ToolTwist | None = None
        self._until_ns = self._next_ns = 0

    def command(self, twist: ToolTwist, now_ns: int) -> None:
        """Applies a velocity from the next step on, until it is stale.

        Raises:
            CommandError: the frame is not a link of the robot.
        """
        if twist.frame and twist.frame not in self._robot.links:
            raise CommandError(
                f"servo of arm {quoted(self._arm.name)}: frame {quoted(twist.frame)} is not a link of robot {quoted(self._robot.name)}; "
                f"use its base, {quoted(self._robot.links[0])}, its tool, {quoted(self._arm.tip_link)}, or another of its links"
            )
        self._twist, self._until_ns = twist, now_ns + round(self._settings.timeout * NS_PER_S)
        self._next_ns = now_ns

    def stop(self) -> None:
        """Drops the command; joints keep their last commands."""
        self._twist = None

    def before_step(self, now_ns: int, step_ns: int) -> None:
        """Sets the joint velocities if an update is due at ``now_ns``; stops the arm if its command is stale."""
        if self._twist is None:
            return
        names = self._chain.names
        if now_ns >= self._until_ns:
            self._twist = None
            self._robot.command_joints(self._bullet, JointTrajectory(names, ()), now_ns)
            return
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + _PERIOD_NS
        positions = self._robot.joint_positions(self._bullet)
        T_root_tip, jacobian = self._chain.jacobian(positions)
        twist = self._in_root_axes(self._twist, T_root_tip)
        speeds = servo_speeds(
            jacobian,
            limited_twist(twist, self._settings),
            np.array([positions[name] for name in names]),
            self._home,
            self._lower,
            self._upper,
            self._fastest,
            max(step_ns, _PERIOD_NS) / NS_PER_S,
            self._settings,
        )
        self._robot.command_joints(self._bullet, JointVelocities(tuple(speeds.tolist()), names), now_ns)

    def _in_root_axes(self, twist: ToolTwist, T_root_tip: F64) -> F64:
        """Returns the twist, (6,), in the axes of the root."""
        vectors = np.array([twist.linear, twist.angular])
        if twist.frame in ("", self._robot.links[0]):
            return vectors.ravel()
        if twist.frame == self._arm.tip_link:
            R_root_frame = T_root_tip[:3, :3]
        else:
            _, quats, _ = self._robot.table.links(self._bullet.raw_states(self._robot.engine_body))
            root, link = (matrix_from_quat(quats[row]) for row in (0, self._robot.links.index(twist.frame)))
            R_root_frame = root.T @ link
        return np.asarray(vectors @ R_root_frame.T).ravel()
