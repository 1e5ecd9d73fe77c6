"""An inertial measurement unit, simulated from the pose and velocity of its link (REP 145). Pure.

Accelerometers measure specific force, acceleration minus gravity: +g along z at rest. The acceleration is the change of the link's velocity
since the previous sample, since real sensors report the mean over the sampling interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.robots.noise import NoiseSource
from gibson_sim.robots.sensor_specs import ImuSpec
from gibson_sim.types import NS_PER_S, Quat, SceneState, Vec3

_WHITE, _WALK, _START = 0, 1, 2
"""Purposes of random numbers."""
LEAST_VARIANCE = 1e-9
"""Minimum reported variance: a covariance of 0 means "unknown" in a ROS message, and filters divide by it."""


@dataclass(frozen=True, slots=True, eq=False)
class ImuReading:
    """One sample, in the frame of the link."""

    name: str
    """Name of the sensor."""
    stamp_ns: int
    link: str
    """``<body>/<link>``."""
    angular_velocity: NDArray[np.float64]
    """(3,), rad/s."""
    linear_acceleration: NDArray[np.float64]
    """(3,), specific force, m/s^2: +g along z at rest."""
    orientation_xyzw: Quat | None
    """Exact orientation of the link in the world frame; None = not reported."""
    angular_variance: float
    """Error variance of each component of the angular velocity, noise and bias together, (rad/s)^2."""
    linear_variance: float
    """Error variance of each component of the acceleration, noise and bias together, (m/s^2)^2."""


class Imu:
    """An IMU with its state: the velocity at its last sample, and its biases."""

    def __init__(self, spec: ImuSpec, gravity: Vec3, seed: int = 0) -> None:
        """Starts with initial biases, which are determined by the seeds.

        Args:
            spec: the sensor.
            gravity: gravitational acceleration, world frame, m/s^2.
            seed: seed of the simulation.
        """
        self.spec = spec
        self._specific_force_at_rest: Vec3 = (-gravity[0], -gravity[1], -gravity[2])
        self._noise = NoiseSource(f"{spec.link.partition('/')[0]}/{spec.name}", seed, spec.seed)
        self._densities = np.repeat([spec.gyro_noise, spec.accel_noise], 3)
        self._walks = np.repeat([spec.gyro_bias_walk, spec.accel_bias_walk], 3)
        self._has_walk, self._is_noisy = bool(self._walks.any()), bool(self._densities.any())
        self.reset()

    def reset(self) -> None:
        """Forgets the velocity and restores the initial biases."""
        spec = self.spec
        self._last: tuple[int, Vec3, Quat] | None = None
        self.bias: NDArray[np.float64] = np.repeat([spec.gyro_bias, spec.accel_bias], 3)
        """(6,), biases of the gyroscopes, rad/s, and of the accelerometers, m/s^2."""
        self._random_walk_s = 0.0
        if self.bias.any():
            self.bias *= self._noise.at(0, _START).standard_normal(6)

    @property
    def can_skip_samples(self) -> bool:
        """Whether samples may be skipped: without a random walk of biases, a sample depends only on the last velocity."""
        return not self._has_walk

    def note(self, state: SceneState) -> None:
        """Records the velocity at a skipped sample, so that the next sample is the same as without skipping.

        Raises:
            ConfigError: the link is not in the state.
        """
        row = self._row(state)
        vx, vy, vz = state.twists[row, :3].tolist()
        x, y, z, w = state.quats_xyzw[row].tolist()
        self._last = state.stamp_ns, (vx, vy, vz), (x, y, z, w)

    def _row(self, state: SceneState) -> int:
        if self.spec.link not in state.links:
            raise ConfigError(f"imu on {self.spec.link!r}: the link is not in the scene; its links: {', '.join(state.links)}")
        return state.links.index(self.spec.link)

    def measure(self, state: SceneState) -> ImuReading:
        """Returns a sample; the first one after a reset assumes that the velocity was constant before.

        Raises:
            ConfigError: the link is not in the state, or the state is not later than the previous one.
        """
        spec, row = self.spec, self._row(state)
        x, y, z, w = quat = tuple(state.quats_xyzw[row].tolist())
        vx, vy, vz, *angular = state.twists[row].tolist()
        force, dt = _into_link(quat, self._specific_force_at_rest), 1.0 / spec.rate_hz
        if self._last is not None:
            stamp_ns, (ux, uy, uz), last_quat = self._last
            dt = (state.stamp_ns - stamp_ns) / NS_PER_S
            if dt <= 0.0:
                raise ConfigError(
                    f"imu {spec.name!r}: {state.stamp_ns} ns is not after the last sample, {stamp_ns} ns; reset it first"
                )
            # The mean acceleration is expressed in the axes at the middle of the interval: the axes at its end are rotated by half a step.
            mean = _into_link(_halfway(last_quat, quat), ((vx - ux) / dt, (vy - uy) / dt, (vz - uz) / dt))
            force = (force[0] + mean[0], force[1] + mean[1], force[2] + mean[2])
        self._last = (state.stamp_ns, (vx, vy, vz), quat)
        self._random_walk_s += dt
        measured = np.array([*_into_link(quat, (angular[0], angular[1], angular[2])), *force]) + self._errors(state.stamp_ns, dt)
        return ImuReading(
            name=spec.name,
            stamp_ns=state.stamp_ns,
            link=spec.link,
            angular_velocity=measured[:3],
            linear_acceleration=measured[3:],
            orientation_xyzw=(x, y, z, w) if spec.orientation else None,
            angular_variance=self._variance(spec.gyro_noise, spec.gyro_bias, spec.gyro_bias_walk, dt),
            linear_variance=self._variance(spec.accel_noise, spec.accel_bias, spec.accel_bias_walk, dt),
        )

    def _variance(self, noise: float, bias: float, walk: float, dt: float) -> float:
        """Returns the variance of one component of a sample: white noise averaged over ``dt``, initial bias, and random walk of the bias.

        See IEEE Std 952-1997, annex C; the parameters are those of an Allan deviation plot.
        """
        return max(noise * noise / dt + bias * bias + walk * walk * self._random_walk_s, LEAST_VARIANCE)

    def _errors(self, stamp_ns: int, dt: float) -> NDArray[np.float64]:
        """Returns the errors of (angular velocity, specific force), (6,), ``dt`` seconds after the previous sample."""
        if self._has_walk:
            self.bias = self.bias + self._walks * math.sqrt(dt) * self._noise.at(stamp_ns, _WALK).standard_normal(6)
        if not self._is_noisy:
            return self.bias
        return self.bias + self._densities / math.sqrt(dt) * self._noise.at(stamp_ns, _WHITE).standard_normal(6)


# In plain floats: for three numbers NumPy is ten times slower, and these functions run hundreds of times per second.
def _into_link(quat_xyzw: Quat, vector: Vec3) -> Vec3:
    """Rotates a vector from the world frame to the frame of a link with the given orientation."""
    x, y, z, w = quat_xyzw
    a, b, c = vector
    p, q, r = 2 * (b * z - c * y), 2 * (c * x - a * z), 2 * (a * y - b * x)
    return a + w * p + q * z - r * y, b + w * q + r * x - p * z, c + w * r + p * y - q * x


def _halfway(a: Quat, b: Quat) -> Quat:
    """Returns the unit quaternion halfway between two, (x, y, z, w)."""
    sign = math.copysign(1.0, sum(i * j for i, j in zip(a, b, strict=True)))
    x, y, z, w = (i + sign * j for i, j in zip(a, b, strict=True))
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return (x / norm, y / norm, z / norm, w / norm)
