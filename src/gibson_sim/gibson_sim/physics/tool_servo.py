"""The Cartesian servo of one arm in the engine: moves its tool at a commanded velocity until the command is stale."""

from __future__ import annotations

import numpy as np

from gibson_sim.errors import CommandError
from gibson_sim.geometry.transforms import matrix_from_quat
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.robot import RobotInWorld
from gibson_sim.quoting import quoted
from gibson_sim.robots.joints.commands import JointTrajectory, JointVelocities
from gibson_sim.robots.joints.servo import F64, ServoSettings, ToolTwist, limited_twist, servo_speeds
from gibson_sim.robots.spec import ManipulatorSpec
from gibson_sim.types import NS_PER_S

_PERIOD_NS = NS_PER_S // 100
"""Period at which the joint velocities are computed, simulation time, ns."""


class ToolServo:
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
