"""The drive of one robot in the engine: motors of wheels and steering, the servo of a base on rollers, odometry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from gibson_sim.description.rigid_groups import rigid_groups
from gibson_sim.description.urdf import UrdfModel
from gibson_sim.geometry.transforms import matrix_from_quat
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.robots.drives import BaseServo, Drive, PlanarVelocity
from gibson_sim.robots.drives.wheel_odometry import WheelOdometry
from gibson_sim.robots.joints.control import ARRIVED, servo_speed
from gibson_sim.types import NS_PER_S

_SETTLING = 0.1
"""Part of its error by which a servo corrects itself in a step."""
_FLOOR = 0.5
"""Wheels stand on what is flatter than 60 degrees; pressing against a wall gives no grip."""
_G = 9.81
"""m/s^2: no slope takes more speed than this."""


class DriveInWorld:
    """Tells the motors of one body what its drive wants, and counts what its wheels turn."""

    def __init__(self, drive: Drive, one: BodyInWorld, odometry: WheelOdometry) -> None:
        """Starts at rest.

        Args:
            drive: Its kinematics.
            one: Has been loaded, with all joints at 0.
            odometry: Of this drive; it counts what the wheels turn.
        """
        self._drive, self._one = drive, one
        self.wheel_odometry = odometry
        """Where the wheels say that the base is."""
        self._wheels = [one.body.joint_indices[joint.name] for joint in drive.wheels]
        self._steering = [one.body.joint_indices[joint.name] for joint in drive.steering]
        self._read = self._wheels + self._steering
        self._wheel_signs = [joint.sign for joint in drive.wheels]
        self._steering_signs = [joint.sign for joint in drive.steering]
        self._torques = [drive.wheel_torque] * len(self._wheels)
        self._angles = [0.0] * len(self._wheels)
        self._speeds: list[float] | None = None
        self._steered = [0.0] * len(self._steering)
        """Where the steering joints were last seen."""
        self._wanted = self._steered
        self._holds = False
        self._servo = None if drive.servo is None else _Servo(drive.servo, one, frozenset(self._wheels))

    def actuate(self, bullet: Bullet, wanted: PlanarVelocity, dt: float) -> None:
        """Sets the motors for the next step, which lasts ``dt`` seconds."""
        drive, body = self._drive, self._one.body
        targets = drive.targets(wanted, dt)
        if self._servo is not None:
            self._servo.push(bullet, drive.base_velocity, dt)
        if self._steering:
            self._steer(bullet, [angle * sign for angle, sign in zip(targets.angles, self._steering_signs, strict=True)], dt)
        speeds = [speed * sign for speed, sign in zip(targets.speeds, self._wheel_signs, strict=True)]
        if speeds == self._speeds:
            return
        self._speeds = speeds
        if any(speeds):
            bullet.drive_joints(body, self._wheels, speeds, self._torques)
        else:
            # A motor that holds speed 0 lets the wheel creep by the solver's residual, 0.1 m in an hour.
            bullet.hold_joints(body, self._wheels, self._angles, self._torques)

    def _steer(self, bullet: Bullet, wanted: list[float], dt: float) -> None:
        """Lets the steering joints follow ``wanted``, radians, and hold it when they are there."""
        body, torques, before = self._one.body, [self._drive.steering_torque] * len(wanted), self._wanted
        self._wanted = wanted
        if wanted == before and max(abs(w - s) for w, s in zip(wanted, self._steered, strict=True)) < ARRIVED:
            if not self._holds:
                bullet.hold_joints(body, self._steering, wanted, torques)
            self._holds = True
            return
        self._holds = False
        step_ns = round(dt * NS_PER_S)
        speeds = [servo_speed(b, w, s, step_ns, math.inf) for b, w, s in zip(before, wanted, self._steered, strict=True)]
        bullet.drive_joints(body, self._steering, speeds, torques)

    def read(self, bullet: Bullet, stamp_ns: int, dt: float) -> None:
        """Adds what the wheels turned in the last step, of ``dt`` seconds, to the odometry; ``stamp_ns`` decides its noise."""
        read = bullet.joint_angles(self._one.body, self._read)
        angles, self._steered = read[: len(self._wheels)], read[len(self._wheels) :]
        rolled = [(now - before) * sign for now, before, sign in zip(angles, self._angles, self._wheel_signs, strict=True)]
        increments = self._drive.encoder_turns(rolled)
        self._angles = angles
        steering = [angle * sign for angle, sign in zip(self._steered, self._steering_signs, strict=True)]
        self.wheel_odometry.add(increments, steering, stamp_ns, dt)


class _Servo:
    """Moves a base at the wanted velocity with what force the floor lends its wheels, as if rollers touched it."""

    def __init__(self, servo: BaseServo, one: BodyInWorld, wheels: frozenset[int]) -> None:
        self._servo, self._one, self._wheels = servo, one, wheels
        self._mass, self._inertia = mass_and_inertia(one.model)
        self._lost = [0.0, 0.0]
        """What slopes take of the speed within a step, m/s, to be given in advance: else a robot that stands would creep down."""

    def push(self, bullet: Bullet, velocity: PlanarVelocity, dt: float) -> None:
        """Changes the base's velocity in its plane, in the next step at most by what friction allows."""
        pose, linear, angular = self._one.root_state(bullet)
        R_world_base = matrix_from_quat(pose.quat_xyzw)
        speed, spin = linear @ R_world_base, angular @ R_world_base
        touching = (contact for contact in bullet.contacts(self._one.body) if contact.link in self._wheels)
        load = sum(contact.force for contact in touching if contact.normal[2] > _FLOOR)
        grip = self._servo.traction * load * dt
        change = [velocity.linear - float(speed[0]), velocity.lateral - float(speed[1])]
        for i in range(2):
            self._lost[i] = min(max(self._lost[i] + _SETTLING * change[i], -_G * dt), _G * dt)
            change[i] += self._lost[i]
        size, most = math.hypot(*change), grip / self._mass
        part = 1.0 if size <= most else most / size
        most_spin = grip * self._servo.reach / self._inertia
        speed += (change[0] * part, change[1] * part, 0.0)
        spin[2] += min(max(velocity.angular - float(spin[2]), -most_spin), most_spin)
        bullet.set_velocity(self._one.body, pose.quat_xyzw, R_world_base @ speed, R_world_base @ spin)


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


def without_friction(model: UrdfModel, joints: Sequence[str]) -> UrdfModel:
    """Returns the model whose links below ``joints`` slide on everything."""
    parents = {joint.child: joint.parent for joint in model.joints}
    smooth = {model.joint(name).child for name in joints}
    links = []
    for link in model.links:  # parents come first
        if parents.get(link.name) in smooth:
            smooth.add(link.name)
        links.append(replace(link, friction=0.0) if link.name in smooth else link)
    return replace(model, links=tuple(links))
