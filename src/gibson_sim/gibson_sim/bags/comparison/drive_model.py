"""What the odometry of a robot would say to given commands: the simulator's own drive and odometry, without an engine. Pure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gibson_sim.bags.comparison.recording import F64, Commands
from gibson_sim.bags.comparison.signals import held, stretches
from gibson_sim.robots.drive_spec import AckermannSpec, DriveSpec
from gibson_sim.robots.drives import PlanarVelocity, make_drive
from gibson_sim.robots.sensor_specs import WheelOdometrySpec
from gibson_sim.robots.wheel_noise import OdometryNoise
from gibson_sim.types import NS_PER_S

_SETTLED = 1e-9


def wanted_velocities(commands: Commands, begin: float, end: float, step_hz: int, timeout: float) -> tuple[F64, F64, F64]:
    """Returns the times of physics steps, and the velocities in force at their begin (m/s, rad/s), each (N,).

    Each value is what ``active_command`` gives at that time for the last command.
    """
    t = begin + np.arange(max(0, round((end - begin) * step_hz))) / step_hz
    return t, held(commands.t, commands.linear, t, timeout), held(commands.t, commands.angular, t, timeout)


def with_limits(spec: DriveSpec, linear: float, angular: float) -> DriveSpec:
    """Returns the drive with other acceleration limits (m/s^2, rad/s^2), without delay and slip."""
    if isinstance(spec, AckermannSpec):
        return replace(spec, max_linear_acceleration=linear, command_delay=0.0, slip=0.0)
    return replace(
        spec, max_linear_acceleration=linear, max_angular_acceleration=angular, command_delay=0.0, slip=0.0, turn_slip=0.0
    )


def limited_velocities(spec: DriveSpec, linear: F64, angular: F64, dt: float) -> tuple[F64, F64]:
    """Returns what the drive tells its base at the end of each step, (N,) each, m/s and rad/s; it starts at rest.

    Args:
        spec: The drive.
        linear: (N,), wanted at each step, m/s.
        angular: (N,), rad/s.
        dt: Seconds of a step.
    """
    drive = make_drive(spec)
    out = np.zeros((len(linear), 2))
    velocity, settles = drive.velocity, not isinstance(spec, AckermannSpec) and spec.command_delay == 0.0
    # A car steers on while it stands, a delay holds back what comes. Any other drive that has arrived stays so while the same is wanted.
    changes = np.concatenate([[0], np.flatnonzero((np.diff(linear) != 0) | (np.diff(angular) != 0)) + 1, [len(linear)]])
    for first, past in zip(changes[:-1].tolist(), changes[1:].tolist(), strict=True):
        wanted = PlanarVelocity(
            float(linear[first]) if past > first else 0.0, 0.0, float(angular[first]) if past > first else 0.0
        )
        for i in range(first, past):
            drive.targets(wanted, dt)
            before, velocity = velocity, drive.velocity
            out[i] = velocity.linear, velocity.angular
            if settles and i > first and abs(velocity.linear - before.linear) + abs(velocity.angular - before.angular) < _SETTLED:
                out[i:past] = out[i]
                break
    return out[:, 0], out[:, 1]


def counted_velocities(spec: DriveSpec, odometry: WheelOdometrySpec, linear: F64, angular: F64, step_hz: int) -> tuple[F64, F64]:
    """Returns what odometry says of a base that moves so, (N,) each, m/s and rad/s: each over the last step, as it is published.

    Args:
        spec: The drive; without slip, since wheels count what they roll.
        odometry: Its errors.
        linear: (N,), m/s, at each step.
        angular: (N,), rad/s.
        step_hz: Steps a second.
    """
    drive = make_drive(spec)
    noise = OdometryNoise(odometry, "robot", 0, left=[wheel.is_left for wheel in drive.wheels])
    rows = wheel_rows(spec)
    turns = np.stack([linear, angular], axis=1) @ rows.T / step_hz
    out = np.zeros((len(linear), 2))
    for a, b in stretches(np.any(turns != 0.0, axis=1)):
        for i in range(a, b):
            increments = noise.wheels(turns[i].tolist())
            forward, _, turn = noise.motion(i * NS_PER_S // step_hz, *drive.travel(increments, ()))
            out[i] = forward * step_hz, turn * step_hz
    return out[:, 0], out[:, 1]


def wheel_rows(spec: DriveSpec) -> F64:
    """Returns the (wheels, 2) matrix from (forward m/s, yaw rad/s) of the base to speeds of the driven wheels, rad/s."""
    if isinstance(spec, AckermannSpec):
        return np.array([[1.0, -spec.wheel_separation / 2], [1.0, spec.wheel_separation / 2]]) / spec.wheel_radius
    free = with_limits(spec, 1e9, 1e9)
    rows = []
    for linear, angular in ((1.0, 0.0), (0.0, 1.0)):
        drive = make_drive(replace(free, max_linear=1.0, max_angular=1.0))
        rows.append(drive.targets(PlanarVelocity(linear, 0.0, angular), 1.0).speeds)
    return np.array(rows).T
