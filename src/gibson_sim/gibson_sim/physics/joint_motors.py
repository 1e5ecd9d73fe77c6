"""The joint motors of one body: convert joint commands to motor setpoints in each step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from gibson_sim.description.urdf import UrdfJoint
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.engine_types import BulletBody
from gibson_sim.robots.joints.commands import JointCommand, JointTrajectory
from gibson_sim.robots.joints.control import JointControl
from gibson_sim.types import NS_PER_S

_HOLD_EFFORT = 100.0
"""Effort limit of a joint whose URDF gives none, N m or N."""


class JointMotors:
    """Motors that execute joint commands within the limits of their joints."""

    def __init__(
        self,
        body: BulletBody,
        joints: Sequence[UrdfJoint],
        others: Sequence[str] = (),
        efforts: Mapping[str, float] | None = None,
    ) -> None:
        """Starts without commands.

        Args:
            body: The body, loaded.
            joints: Joints with motors.
            others: Joints controlled by other components, for error messages.
            efforts: Default effort limits of joints, N m or N, instead of those of the URDF.
        """
        self._body = body
        self._control = JointControl(joints, others)
        self._efforts = {joint.name: joint.effort or _HOLD_EFFORT for joint in joints} | dict(efforts or {})
        self._friction = {joint.name: joint.friction for joint in joints}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints with motors, in the order of the URDF."""
        return self._control.names

    def setpoint(self, name: str, now_ns: int) -> float | None:
        """Returns the setpoint of a joint in its trajectory, radians or metres; None = no trajectory, or a finished one."""
        return self._control.setpoint(name, now_ns)

    @property
    def active(self) -> bool:
        """Whether any setpoint may change in the next step."""
        return bool(self._control.active)

    def command(self, bullet: Bullet, command: JointCommand, now_ns: int) -> None:
        """Applies ``command`` from the next step on; other joints keep their commands.

        Raises:
            CommandError: a joint is unknown, a value exceeds a limit, or the trajectory is over; no command has changed then.
        """
        names = self._control.names
        positions: dict[str, float] = {}
        velocities: dict[str, float] = {}
        if names:
            reading = bullet.joint_reading(self._body, self._indices(names))
            positions = dict(zip(names, reading.positions.tolist(), strict=True))
            velocities = dict(zip(names, reading.velocities.tolist(), strict=True))
        self._control.command(command, now_ns, positions, velocities)

    def stop(self, bullet: Bullet, now_ns: int) -> None:
        """Stops moving joints at their current positions."""
        if self._control.names:
            self.command(bullet, JointTrajectory((), ()), now_ns)

    def actuate(self, bullet: Bullet, now_ns: int, dt: float) -> None:
        """Sets the motors for the step that begins at ``now_ns`` and lasts ``dt`` seconds."""
        names = self._control.active
        if not names:
            return
        bullet.wake(self._body)
        positions = dict(zip(names, bullet.joint_angles(self._body, self._indices(names)), strict=True))
        targets = self._control.step(now_ns, round(dt * NS_PER_S), positions)
        if targets.speeds:
            driven = [self._with_friction(name, speed, targets.efforts.get(name)) for name, speed in targets.speeds.items()]
            bullet.drive_joints(
                self._body, self._indices(targets.speeds), [speed for speed, _ in driven], [effort for _, effort in driven]
            )
        if targets.held:
            self.hold(bullet, targets.held, targets.efforts)

    def hold(self, bullet: Bullet, positions: Mapping[str, float], limits: Mapping[str, float] | None = None) -> None:
        """Holds joints at positions, radians or metres, with the effort limits ``limits`` (N m or N) where given."""
        efforts = [(limits or {}).get(name, self._efforts[name]) for name in positions]
        bullet.hold_joints(self._body, self._indices(positions), list(positions.values()), efforts)

    def _with_friction(self, name: str, speed: float, effort: float | None) -> tuple[float, float]:
        """Returns speed and effort limit of a motor, less the joint's friction if ``effort`` is set; if friction is larger, it holds the joint."""
        if effort is None:
            return speed, self._efforts[name]
        net = effort - self._friction[name]
        return (speed, net) if net > 0.0 else (0.0, -net)

    def _indices(self, names: Iterable[str]) -> list[int]:
        return [self._body.joint_indices[name] for name in names]
