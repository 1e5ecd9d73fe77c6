"""One robot in the engine: its drive and the joints of its arms.

The drive: wheel and steering motors, the servo of a base on rollers, wheel odometry.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from gibson_sim.description.rigid_groups import rigid_groups
from gibson_sim.description.urdf import UrdfModel, read_urdf
from gibson_sim.geometry.transforms import matrix_from_quat
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.joint_motors import JointMotors
from gibson_sim.robots.drive_spec import PlanarSpec
from gibson_sim.robots.drives import BaseServo, Drive, PlanarVelocity, active_command, make_drive
from gibson_sim.robots.drives.wheel_odometry import WheelOdometry
from gibson_sim.robots.joints.control import ARRIVED, servo_speed
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.types import NS_PER_S, VelocityCommand

_SETTLING = 0.1
"""Fraction of the error that a servo corrects in a step."""
_FLOOR = 0.5
"""Minimum vertical component of the normal of a floor, 60 degrees: walls give wheels no traction."""
_G = 9.81
"""Largest acceleration on a slope, m/s^2."""


class RobotInWorld(BodyInWorld):
    """One robot in the engine, and its velocity command."""

    sleeps = False

    def __init__(self, bullet: Bullet, spec: RobotSpec, seed: int = 0) -> None:
        self.spec, self._seed = spec, seed
        model = read_urdf(spec.urdf)
        self._driven: tuple[str, ...] = ()
        if spec.drive is not None:
            drive = make_drive(spec.drive)
            self._driven = tuple(joint.name for joint in (*drive.wheels, *drive.steering))
            if isinstance(spec.drive, PlanarSpec):
                model = without_friction(model, spec.drive.free_wheels, base=True)
            elif drive.servo is not None:
                model = without_friction(model, [joint.name for joint in drive.wheels])
        self._motorised = tuple(joint for joint in model.joints if joint.name not in self._driven and joint.has_motor)
        """Joints that accept ``command_joints``."""
        super().__init__(bullet, spec.name, model, spec.start, static=spec.fixed_base, concave=False, joints=spec.joints)

    def load(self, bullet: Bullet) -> None:
        """Loads the robot at its start, at rest, without commands and with zero odometry."""
        super().load(bullet)
        bullet.let_rays_ignore(self.engine_body, self.name)
        self.command: VelocityCommand | None = None
        self.drive: DriveInWorld | None = None
        if self.spec.drive is not None:
            drive = make_drive(self.spec.drive)
            odometry = WheelOdometry(drive, self.spec.sensors.wheel_odometry, self.name, self._seed)
            self.drive = DriveInWorld(drive, self, odometry)
        self._step_start_ns = 0

    def _set_up_motors(self, bullet: Bullet) -> None:
        """Holds the joints at their initial positions; joints of the drive, and continuous joints outside of arms, rotate freely."""
        grippers = [arm.gripper for arm in self.spec.manipulators if arm.gripper is not None]
        efforts = {joint: gripper.max_effort for gripper in grippers for joint in gripper.joints}
        motors = JointMotors(self.engine_body, self._motorised, self._driven, efforts)
        held = {*self._start_joints, *(name for arm in self.spec.manipulators for name in arm.joints)}
        for joint in self._motorised:
            if joint.kind != "continuous" or joint.name in held:
                motors.hold(bullet, {joint.name: self._start_joints.get(joint.name, 0.0)})
        self.motors = motors

    def forget_commands(self, bullet: Bullet, now_ns: int) -> None:
        """Stops the robot until the next command."""
        self.command = None
        super().forget_commands(bullet, now_ns)

    def actuate(self, bullet: Bullet, now_ns: int, timeout_ns: int, dt: float) -> None:
        """Sets the motors for the step that begins at ``now_ns``."""
        self._step_start_ns = now_ns
        if self.drive is not None:
            self.drive.actuate(bullet, active_command(self.command, now_ns, timeout_ns), dt)
        self.actuate_joints(bullet, now_ns, dt)

    def read_wheels(self, bullet: Bullet, dt: float) -> None:
        """Adds the rotation of the wheels in the last step to the odometry."""
        if self.drive is not None:
            self.drive.read(bullet, self._step_start_ns, dt)


class DriveInWorld:
    """Controls the wheel and steering motors of one body, and integrates its odometry."""

    def __init__(self, drive: Drive, body: BodyInWorld, odometry: WheelOdometry) -> None:
        """Starts at rest.

        Args:
            drive: Kinematics of the drive.
            body: The body, loaded, with all joints at 0.
            odometry: Wheel odometry of this drive.
        """
        self._drive, self._body = drive, body
        self.wheel_odometry = odometry
        self._wheels = [body.engine_body.joint_indices[joint.name] for joint in drive.wheels]
        self._steering = [body.engine_body.joint_indices[joint.name] for joint in drive.steering]
        self._joints = self._wheels + self._steering
        """Engine indices of the joints."""
        self._wheel_signs = [joint.sign for joint in drive.wheels]
        self._steering_signs = [joint.sign for joint in drive.steering]
        self._torques = [drive.wheel_torque] * len(self._wheels)
        self._angles = [0.0] * len(self._wheels)
        """Angles of the wheel joints after the last step, radians."""
        self._speeds: list[float] | None = None
        """Target velocities of the wheel joints, rad/s; None = not set yet."""
        self._steered = [0.0] * len(self._steering)
        """Angles of the steering joints after the last step, radians."""
        self._steering_targets = self._steered
        self._holds_steering = False
        self._servo = None if drive.servo is None else _Servo(drive.servo, body, frozenset(self._wheels) or None)

    def actuate(self, bullet: Bullet, commanded: PlanarVelocity, dt: float) -> None:
        """Sets the motors for the next step, which lasts ``dt`` seconds."""
        drive, body = self._drive, self._body.engine_body
        targets = drive.targets(commanded, dt)
        if self._servo is not None:
            self._servo.push(bullet, drive.base_velocity, dt)
        if self._steering:
            self._steer(bullet, [angle * sign for angle, sign in zip(targets.angles, self._steering_signs, strict=True)], dt)
        if not self._wheels:
            return
        speeds = [speed * sign for speed, sign in zip(targets.speeds, self._wheel_signs, strict=True)]
        if speeds == self._speeds:
            return
        self._speeds = speeds
        if any(speeds):
            bullet.drive_joints(body, self._wheels, speeds, self._torques)
        else:
            # With target velocity 0, the wheels would creep by the solver's residual, 0.1 m per hour.
            bullet.hold_joints(body, self._wheels, self._angles, self._torques)

    def _steer(self, bullet: Bullet, angles: list[float], dt: float) -> None:
        """Moves the steering joints to ``angles``, radians, and holds them there."""
        body, torques = self._body.engine_body, [self._drive.steering_torque] * len(angles)
        last_targets, self._steering_targets = self._steering_targets, angles
        if angles == last_targets and max(abs(a - s) for a, s in zip(angles, self._steered, strict=True)) < ARRIVED:
            if not self._holds_steering:
                bullet.hold_joints(body, self._steering, angles, torques)
            self._holds_steering = True
            return
        self._holds_steering = False
        step_ns = round(dt * NS_PER_S)
        speeds = [servo_speed(b, a, s, step_ns, math.inf) for b, a, s in zip(last_targets, angles, self._steered, strict=True)]
        bullet.drive_joints(body, self._steering, speeds, torques)

    def read(self, bullet: Bullet, stamp_ns: int, dt: float) -> None:
        """Adds the rotation of the wheels in the last step, of ``dt`` seconds, to the odometry; ``stamp_ns`` determines its noise."""
        if not self._wheels:
            self.wheel_odometry.add(self._drive.encoder_turns(self._moved(bullet, dt)), (), stamp_ns, dt)
            return
        positions = bullet.joint_angles(self._body.engine_body, self._joints)
        angles, self._steered = positions[: len(self._wheels)], positions[len(self._wheels) :]
        rotations = [(new - old) * sign for new, old, sign in zip(angles, self._angles, self._wheel_signs, strict=True)]
        increments = self._drive.encoder_turns(rotations)
        self._angles = angles
        steering = [angle * sign for angle, sign in zip(self._steered, self._steering_signs, strict=True)]
        self.wheel_odometry.add(increments, steering, stamp_ns, dt)

    def _moved(self, bullet: Bullet, dt: float) -> tuple[float, float, float]:
        """Returns the motion of the base in the last step: forward, left (m), rotation (rad)."""
        pose, linear, angular = self._body.root_state(bullet)
        R_world_base = matrix_from_quat(pose.quat_xyzw)
        turn = float(angular @ R_world_base[:, 2]) * dt
        x, y = float(linear @ R_world_base[:, 0]) * dt, float(linear @ R_world_base[:, 1]) * dt
        cos, sin = math.cos(turn / 2), math.sin(turn / 2)  # the mean heading of the step is half a turn behind the present one
        return x * cos - y * sin, x * sin + y * cos, turn


class _Servo:
    """Moves a base at a velocity with at most the force that friction of its wheels allows, as if they had rollers."""

    def __init__(self, servo: BaseServo, body: BodyInWorld, wheels: frozenset[int] | None) -> None:
        self._servo, self._body = servo, body
        self._wheels = wheels
        """Engine indices of the links whose load gives traction; None = all."""
        self._mass, self._inertia = mass_and_inertia(body.model)
        self._lever_arm = servo.lever_arm or math.sqrt(self._inertia / self._mass)
        self._slope_loss = [0.0, 0.0]
        """Velocity lost on a slope per step, (x, y) m/s, compensated in advance: without it, a robot at rest would creep downhill."""

    def push(self, bullet: Bullet, velocity: PlanarVelocity, dt: float) -> None:
        """Changes the base's velocity in its plane in the next step, limited by friction."""
        pose, linear, angular = self._body.root_state(bullet)
        R_world_base = matrix_from_quat(pose.quat_xyzw)
        speed, spin = linear @ R_world_base, angular @ R_world_base
        contacts = bullet.contacts(self._body.engine_body)
        touching = contacts if self._wheels is None else [contact for contact in contacts if contact.link in self._wheels]
        load = sum(contact.force for contact in touching if contact.normal[2] > _FLOOR)
        grip = self._servo.traction * load * dt
        change = [velocity.linear - float(speed[0]), velocity.lateral - float(speed[1])]
        for i in range(2):
            self._slope_loss[i] = min(max(self._slope_loss[i] + _SETTLING * change[i], -_G * dt), _G * dt)
            change[i] += self._slope_loss[i]
        size, limit = math.hypot(*change), grip / self._mass
        scale = 1.0 if size <= limit else limit / size
        spin_limit = grip * self._lever_arm / self._inertia
        speed += (change[0] * scale, change[1] * scale, 0.0)
        spin[2] += min(max(velocity.angular - float(spin[2]), -spin_limit), spin_limit)
        bullet.set_velocity(self._body.engine_body, pose.quat_xyzw, R_world_base @ speed, R_world_base @ spin)


def mass_and_inertia(model: UrdfModel) -> tuple[float, float]:
    """Returns the mass (kg) of a body, and its inertia about the z axis of its root (kg m^2), all joints at 0."""
    transforms = model.transforms()
    mass, inertia = 0.0, 0.0
    for group in rigid_groups(model)[0]:
        T_root_group = transforms[group.name]
        x, y, _ = T_root_group[:3, :3] @ group.center + T_root_group[:3, 3]
        up = T_root_group[2, :3]
        mass += group.mass
        inertia += group.mass * float(x * x + y * y) + float(up @ group.inertia @ up)
    return mass, inertia


def without_friction(model: UrdfModel, joints: Sequence[str], *, base: bool = False) -> UrdfModel:
    """Returns the model with friction 0 for the links below ``joints``, and with ``base`` for those fixed to the root."""
    parents = {joint.child: joint.parent for joint in model.joints}
    fixed = model.fixed_to_root() if base else ()
    smooth = {model.joint(name).child for name in joints}
    links = []
    for link in model.links:  # parents come first
        if parents.get(link.name) in smooth:
            smooth.add(link.name)
        links.append(replace(link, friction=0.0) if link.name in smooth or link.name in fixed else link)
    return replace(model, links=tuple(links))
