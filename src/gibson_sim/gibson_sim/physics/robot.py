"""One robot in the engine: its drive and the joints of its arms."""

from __future__ import annotations

from gibson_sim.description.urdf import read_urdf
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.drive import DriveInWorld, without_friction
from gibson_sim.physics.joint_motors import JointMotors
from gibson_sim.robots.drive_spec import PlanarSpec
from gibson_sim.robots.drives import active_command, make_drive
from gibson_sim.robots.drives.wheel_odometry import WheelOdometry
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.types import VelocityCommand


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
