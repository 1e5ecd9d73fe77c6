"""One robot in the engine: its motors, its wheels, the frames of its links."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import Mat4, quat_from_matrix
from gibson_sim.physics.bullet import Bullet, BulletBody, cross, right_multiplication, turn
from gibson_sim.robots.differential_drive import PlanarVelocity, WheelOdometry, active_command, limit_velocity, wheel_speeds
from gibson_sim.robots.drive_spec import DriveSpec
from gibson_sim.robots.rigid import RigidGroup, physics_urdf, rigid_groups
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.robots.urdf import UrdfModel, read_urdf
from gibson_sim.types import VelocityCommand

_HOLD_EFFORT = 100.0
"""N m or N: holds a joint whose URDF gives no effort."""


@dataclass(slots=True)
class _Drive:
    """Motors of a differential drive."""

    spec: DriveSpec
    joints: tuple[int, int]
    velocity: PlanarVelocity = field(default_factory=PlanarVelocity)
    """What the motors were told last."""
    speeds: tuple[float, float] | None = None
    angles: tuple[float, float] = (0.0, 0.0)


class RobotInWorld:
    """One robot in the engine, and what it was told."""

    def __init__(self, bullet: Bullet, spec: RobotSpec) -> None:
        self.spec = spec
        self._model: UrdfModel = read_urdf(spec.urdf)
        self._groups, group_warnings = rigid_groups(self._model)
        self.warnings = (*self._model.warnings, *group_warnings)
        self._urdf = physics_urdf(self._model, self._groups)
        self.load(bullet)
        self._rows, self._offsets, self._turns = self._link_table()

    def load(self, bullet: Bullet) -> None:
        """Puts the robot at its start, at rest."""
        self.body: BulletBody = bullet.load_urdf(self._urdf, self.spec.start, self.spec.name)
        self.command: VelocityCommand | None = None
        self.drive: _Drive | None = None
        self.odometry: WheelOdometry | None = None
        wheels: tuple[str, ...] = ()
        if self.spec.drive is not None:
            wheels = (self.spec.drive.left_joint, self.spec.drive.right_joint)
            left, right = (self.body.joint_indices[self._model.joint(name).name] for name in wheels)
            self.drive = _Drive(self.spec.drive, (left, right))
            self.odometry = WheelOdometry(self.spec.drive)
        for joint in self._model.joints:
            if joint.kind in ("revolute", "prismatic") and joint.name not in wheels:
                bullet.hold_joints(self.body, (self.body.joint_indices[joint.name],), (0.0,), (joint.effort or _HOLD_EFFORT,))

    def actuate(self, bullet: Bullet, now_ns: int, timeout_ns: int, dt: float) -> None:
        """Sets the motors for the step that begins at ``now_ns``."""
        drive = self.drive
        assert drive is not None
        wanted = active_command(self.command, now_ns, timeout_ns)
        drive.velocity = limit_velocity(drive.velocity, wanted, drive.spec, dt)
        left, right = wheel_speeds(*drive.velocity, drive.spec)
        speeds = (left * drive.spec.left_sign, right * drive.spec.right_sign)
        if speeds == drive.speeds:
            return
        drive.speeds = speeds
        torques = (drive.spec.max_wheel_torque,) * 2
        if speeds == (0.0, 0.0):
            # A motor that holds speed 0 lets the wheel creep by the solver's residual, 0.1 m in an hour.
            bullet.hold_joints(self.body, drive.joints, drive.angles, torques)
        else:
            bullet.drive_joints(self.body, drive.joints, speeds, torques)

    def read_wheels(self, bullet: Bullet, dt: float) -> None:
        """Adds what the wheels turned in the last step to the odometry."""
        drive, odometry = self.drive, self.odometry
        assert drive is not None and odometry is not None
        left, right = bullet.joint_angles(self.body, drive.joints)
        odometry.update((left - drive.angles[0]) * drive.spec.left_sign, (right - drive.angles[1]) * drive.spec.right_sign, dt)
        drive.angles = (left, right)

    def link_states(self, bullet: Bullet) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Returns positions (N, 3), quaternions (N, 4) and twists (N, 6) of all links, world frame, in the order of the spec."""
        groups = bullet.link_states(self.body)
        rows = self._rows
        group_quats, angular = groups.quats_xyzw[rows], groups.angular[rows]
        offsets = turn(group_quats, self._offsets)
        quats = np.matmul(self._turns, group_quats[:, :, None])[:, :, 0]
        linear = groups.linear[rows] + cross(angular, offsets)
        return groups.positions[rows] + offsets, quats, np.concatenate([linear, angular], axis=1)

    def _link_table(self) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
        """Returns, for every link of the spec, the row of its rigid group in the engine and T_group_link.

        T_group_link comes as a position, (3,), and as the matrix, (4, 4), that multiplies a quaternion from the right.
        """
        home: dict[str, tuple[RigidGroup, Mat4]] = {
            link: (group, T_group_link) for group in self._groups for link, T_group_link in group.members.items()
        }
        rows, offsets, turns = [], [], []
        for link in self.spec.links:
            group, T_group_link = home[self._model.link(link).name]
            rows.append(0 if group.joint is None else 1 + self.body.joint_indices[group.joint.name])
            offsets.append(T_group_link[:3, 3])
            turns.append(right_multiplication(quat_from_matrix(T_group_link[:3, :3])))
        return np.array(rows, dtype=np.intp), np.array(offsets), np.array(turns)
