"""What a world offers for arms: grasp, let go, move a tool, ask where it is. ``PhysicsWorld`` has all of this.

    world.grasp(robot, arm)             take hold of what is in reach, by the rules of ``robots.joints.grasping``: returns a GraspState
    world.release(robot, arm)           let go
    world.grasp_state(robot, arm)       what the gripper holds, and the force
    world.move_gripper(robot, opening)  0 = closed, 1 = open; closing grasps and opening lets go, as any command to its joints does
    world.tool_pose(robot, arm)         T_world_tool
    world.solve_arm(robot, target)      joints of the arm that bring the tool to T_world_tool: a ChainSolution
    world.servo(robot, ToolTwist(...))  move the tool at a velocity until a quarter of a second later
    world.collisions(robot)             what the robot ran into: a CollisionCount

``arm`` is a name from the robot's file; left out, it is the robot's first. What these do is what the topics of ``docs/manipulation.md`` do.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

from gibson_sim.errors import CommandError
from gibson_sim.geometry.transforms import invert, matrix_from_pose
from gibson_sim.physics.arms import Arms
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.link_poses import link_pose
from gibson_sim.quoting import quoted
from gibson_sim.robots.collision_count import CollisionCount
from gibson_sim.robots.joints.commands import JointCommand, JointPositions
from gibson_sim.robots.joints.grasping import GraspState
from gibson_sim.robots.joints.kinematics import ChainSolution
from gibson_sim.robots.joints.servo import ToolTwist
from gibson_sim.types import Pose, SceneState


class ArmCommands:
    """Arms of robots in a world."""

    _arms: Arms
    _bullet: Bullet
    step_hz: int

    @property
    @abstractmethod
    def stamp_ns(self) -> int:
        """Simulation time."""

    @abstractmethod
    def state_of(self, name: str) -> SceneState:
        """Returns the poses of at least the links of one robot now."""

    @abstractmethod
    def command_joints(self, name: str, command: JointCommand) -> None:
        """Moves joints."""

    @abstractmethod
    def body_pose(self, name: str) -> Pose:
        """Returns T_world_root of a robot or a body."""

    @abstractmethod
    def _one(self, name: str) -> BodyInWorld:
        """Returns a robot or a body, or raises PhysicsError."""

    def grasp(self, robot: str, arm: str = "", *, target: str = "") -> GraspState:
        """Takes hold of what is in reach, at once; nothing changes where the gripper holds something already.

        assisted: the nearest handle or knob that can move, else the nearest link that can move, within the set distance of the tool.
        sticky: what the hand touches, now or within a second. physical: nothing; the fingers hold by themselves.

        Args:
            robot: Which robot.
            arm: Which arm.
            target: The one robot or body that it may take; empty = any.

        Returns:
            What it holds now; where that is nothing, ``reason`` says why.

        Raises:
            CommandError: there is no such robot, arm, gripper or target.
        """
        grasper = self._arms.grasper(robot, arm)
        grasper.grasp(self.stamp_ns, target)
        return grasper.state()

    def release(self, robot: str, arm: str = "") -> GraspState:
        """Lets go, if it holds anything; CommandError where there is no such robot, arm or gripper."""
        grasper = self._arms.grasper(robot, arm)
        grasper.release()
        return grasper.state()

    def grasp_state(self, robot: str, arm: str = "") -> GraspState:
        """Returns what a gripper holds; CommandError where there is no such robot, arm or gripper."""
        return self._arms.grasper(robot, arm).state()

    def move_gripper(self, robot: str, opening: float, arm: str = "", *, max_effort: float = 0.0) -> None:
        """Moves the fingers together.

        Args:
            robot: Which robot.
            opening: 0 = closed, 1 = open.
            arm: Which arm.
            max_effort: N or N m of each finger; 0 = what the robot's file says.

        Raises:
            CommandError: there is no such robot, arm or gripper, or a number is out of its range.
        """
        spec = self._arms.arm(robot, arm)
        gripper = spec.gripper
        if gripper is None:
            raise CommandError(f"arm {quoted(spec.name)} of robot {quoted(robot)} has no gripper; give it one in its robot.yaml")
        if not 0.0 <= opening <= 1.0:
            raise CommandError(f"opening of a gripper is {opening}, must be 0 (closed) to 1 (open)")
        position = gripper.closed + opening * (gripper.open - gripper.closed)
        efforts = (max_effort or gripper.max_effort,) * len(gripper.joints)
        self.command_joints(robot, JointPositions((position,) * len(gripper.joints), gripper.joints, efforts))

    def joint_setpoints(self, robot: str) -> dict[str, float]:
        """Returns where the joints that follow a trajectory shall be now, radians or metres; those that follow none are left out."""
        one, now_ns = self._one(robot), self.stamp_ns
        names = () if one.motors is None else one.motors.names
        found = {name: one.motors.setpoint(name, now_ns) for name in names if one.motors is not None}
        return {name: position for name, position in found.items() if position is not None}

    def tool_pose(self, robot: str, arm: str = "") -> Pose:
        """Returns T_world_tool; CommandError where there is no such robot or arm."""
        return link_pose(self.state_of(robot), f"{robot}/{self._arms.arm(robot, arm).tip_link}")

    def solve_arm(self, robot: str, target: Pose, arm: str = "", *, orientation: bool = True) -> ChainSolution:
        """Returns the joints of an arm that bring its tool to ``target`` (T_world_tool), the robot standing where it is; nothing moves.

        ``JointPositions(solution.positions, solution.names)`` goes there. What the target leaves free goes towards the pose in which the
        robot starts. Look at ``solution.within(...)``: what cannot be reached has an answer, too, but one with an error.

        Args:
            robot: Which robot.
            target: Where the tool shall be.
            arm: Which arm.
            orientation: Whether that of the target counts.

        Raises:
            CommandError: there is no such robot or arm.
        """
        spec = self._arms.arm(robot, arm)
        return self.solve_chain(
            robot, spec.tip_link, target, joints=spec.joints, rest=self._arms.rest(robot, spec), orientation=orientation
        )

    def solve_chain(
        self,
        name: str,
        link: str,
        target: Pose,
        *,
        joints: Sequence[str] | None = None,
        rest: Mapping[str, float] | None = None,
        orientation: bool = True,
    ) -> ChainSolution:
        """Returns the joints that bring a link to ``target`` (T_world_link), the root standing where it is; nothing moves.

        Args:
            name: A robot or a body.
            link: At the end of the chain.
            target: Where it shall be.
            joints: Those that may move; None = all between the root and the link.
            rest: Where joints shall be as far as the target leaves them free.
            orientation: Whether that of the target counts.

        Raises:
            PhysicsError: there is no such body.
            CommandError: there is no such link or joint, or nothing moves the link.
        """
        one = self._one(name)
        T_root_target = invert(matrix_from_pose(self.body_pose(name))) @ matrix_from_pose(target)
        start = one.joint_positions(self._bullet)
        return one.chain(link, joints).solve(T_root_target, start, rest=rest, orientation=orientation)

    def servo(self, robot: str, twist: ToolTwist, arm: str = "") -> None:
        """Moves a tool at a velocity against the robot's base, from the next step on, until the time-out of ``ServoSettings``.

        Raises:
            CommandError: there is no such robot, arm or frame.
        """
        self._arms.tool_servo(robot, arm).command(twist, self.stamp_ns)

    def collisions(self, robot: str) -> CollisionCount:
        """Returns what a robot ran into since the first such question, or since it was reset; ``robots.collision_count`` says what counts.

        Raises:
            CommandError: there is no such robot.
        """
        return self._arms.collisions(robot, self.step_hz)
