"""One robot in the engine: its drive, and the joints of its arms."""

from __future__ import annotations

from collections.abc import Iterable

from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.drive import DriveInWorld, without_friction
from gibson_sim.robots.drives import active_command, make_drive
from gibson_sim.robots.joint_commands import JointCommand, JointTrajectory
from gibson_sim.robots.joint_control import JointControl
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.robots.urdf import UrdfJoint, read_urdf
from gibson_sim.robots.wheel_noise import OdometryNoise
from gibson_sim.types import NS_PER_S, VelocityCommand

_HOLD_EFFORT = 100.0
"""N m or N: moves and holds a joint whose URDF gives no effort."""


class RobotInWorld(BodyInWorld):
    """One robot in the engine, and what it was told."""

    sleeps = False

    def __init__(self, bullet: Bullet, spec: RobotSpec, seed: int = 0) -> None:
        self.spec, self._seed = spec, seed
        model = read_urdf(spec.urdf)
        self._driven: tuple[str, ...] = ()
        if spec.drive is not None:
            drive = make_drive(spec.drive)
            self._driven = tuple(joint.name for joint in (*drive.wheels, *drive.steering))
            if drive.servo is not None:
                model = without_friction(model, [joint.name for joint in drive.wheels])
        self._motors = tuple(joint for joint in model.joints if joint.name not in self._driven and _has_motor(joint))
        """What ``command_joints`` moves."""
        self._efforts = {joint.name: joint.effort or _HOLD_EFFORT for joint in self._motors}
        super().__init__(bullet, spec.name, model, spec.start)

    def load(self, bullet: Bullet) -> None:
        """Puts the robot at its start, at rest."""
        super().load(bullet)
        bullet.let_rays_pass(self.body, self.name)
        self.command: VelocityCommand | None = None
        self.drive: DriveInWorld | None = None
        if self.spec.drive is not None:
            drive = make_drive(self.spec.drive)
            noise = OdometryNoise(
                self.spec.sensors.wheel_odometry, self.name, self._seed, left=[wheel.is_left for wheel in drive.wheels]
            )
            self.drive = DriveInWorld(drive, self, None if noise.exact else noise)
        self._joints = JointControl(self._motors, self._driven)
        self._step_start_ns = 0

    def _hold_joints(self, bullet: Bullet) -> None:
        """Motors hold every joint but those of the drive at 0, or at the limit next to it; continuous ones turn freely."""
        for joint in self._motors:
            if joint.kind != "continuous":
                start = min(max(0.0, joint.lower), joint.upper) if joint.lower <= joint.upper else 0.0
                self._hold(bullet, {joint.name: start})

    def command_joints(self, bullet: Bullet, command: JointCommand, now_ns: int) -> None:
        """Obeys ``command`` from the next step on; joints that it does not name go on as they were told.

        Raises:
            CommandError: an unknown joint, a number beyond a limit, a trajectory that is over; nothing has changed then.
        """
        positions: dict[str, float] = {}
        velocities: dict[str, float] = {}
        names = self._joints.names
        if names:
            reading = bullet.joint_reading(self.body, self._indices(names))
            positions = dict(zip(names, reading.positions.tolist(), strict=True))
            velocities = dict(zip(names, reading.velocities.tolist(), strict=True))
        self._joints.command(command, now_ns, positions, velocities)

    def forget_commands(self, bullet: Bullet, now_ns: int) -> None:
        """Stands still, until it is told something new."""
        self.command = None
        if self._joints.names:
            self.command_joints(bullet, JointTrajectory((), ()), now_ns)

    def actuate(self, bullet: Bullet, now_ns: int, timeout_ns: int, dt: float) -> None:
        """Sets the motors for the step that begins at ``now_ns``."""
        self._step_start_ns = now_ns
        if self.drive is not None:
            self.drive.actuate(bullet, active_command(self.command, now_ns, timeout_ns), dt)
        names = self._joints.active
        if names:
            positions = dict(zip(names, bullet.joint_angles(self.body, self._indices(names)), strict=True))
            targets = self._joints.step(now_ns, round(dt * NS_PER_S), positions)
            if targets.speeds:
                efforts = [self._efforts[name] for name in targets.speeds]
                bullet.drive_joints(self.body, self._indices(targets.speeds), list(targets.speeds.values()), efforts)
            if targets.held:
                self._hold(bullet, targets.held)

    def read_wheels(self, bullet: Bullet, dt: float) -> None:
        """Adds what the wheels turned in the last step to the odometry."""
        if self.drive is not None:
            self.drive.read(bullet, self._step_start_ns, dt)

    def _hold(self, bullet: Bullet, positions: dict[str, float]) -> None:
        efforts = [self._efforts[name] for name in positions]
        bullet.hold_joints(self.body, self._indices(positions), list(positions.values()), efforts)

    def _indices(self, names: Iterable[str]) -> list[int]:
        return [self.body.joint_indices[name] for name in names]


def _has_motor(joint: UrdfJoint) -> bool:
    """Returns whether a joint obeys commands: a continuous one that the URDF gives neither effort nor speed is a caster."""
    return joint.kind in ("revolute", "prismatic") or (joint.kind == "continuous" and max(joint.effort, joint.velocity) > 0.0)
