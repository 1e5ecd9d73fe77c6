"""Fits values of the ``robot.yaml`` that bring a simulated robot closer to a real one. Pure.

Effects of the simulation itself (transport of commands, contact of wheels) are in its own recording too. Delays and ratios are therefore
not set to those of the real recording, but changed by the difference of the two. A value changes only if the recordings determine
it, and if it differs from the present one by more than ``CERTAINTY`` standard deviations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gibson_sim.bags.comparison.identify import Estimate
from gibson_sim.bags.comparison.measure import Measurements
from gibson_sim.robots.drive_spec import AckermannSpec, DifferentialSpec, DriveSpec
from gibson_sim.robots.sensor_specs import ImuSpec, LidarSpec, WheelOdometrySpec
from gibson_sim.robots.spec import RobotSpec

CERTAINTY = 3.0
"""Minimum difference from the current value, standard deviations, for a change: among thirty values, hardly one differs by so much by chance."""
_LEAST = {
    "gyro_noise": 1e-6, "gyro_bias": 1e-5, "gyro_bias_walk": 1e-7, "accel_noise": 1e-6, "accel_bias": 1e-5, "accel_bias_walk": 1e-7,
    "range_noise": 1e-5,
}  # fmt: skip
"""Minimum significant difference of these keys, in their units: a simulated robot at rest moves by as much, 32-bit ranges are as coarse."""
_THREE_AXES = 1.0 / math.sqrt(6.0)
"""Relative standard deviation of the root mean square of three normally distributed values."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One value of the file."""

    section: str
    """Section of the file, such as ``drive``."""
    key: str
    index: int
    """Index of the sensor in the section; 0 if there is only one."""
    old: float
    new: float
    unit: str
    deviation: float
    """Standard deviation of ``new``; 0 = the messages contain it, infinite = the recordings do not determine it."""
    because: str
    """Source of the value, as text."""
    alone: bool = True
    """Whether the value changes independently; else ``paired`` determines whether the value and its counterpart change together."""
    paired: bool = False

    @property
    def name(self) -> str:
        """E.g. ``drive.command_delay``."""
        return f"{self.section}.{self.key}"

    @property
    def uncertainty(self) -> float:
        """Uncertainty of ``new``: smaller differences are not significant."""
        return CERTAINTY * self.deviation

    @property
    def verdict(self) -> str:
        """The change of the value, or why it stays, in words."""
        unit = f" {self.unit}" if self.unit else ""
        if self.changes:
            return f"{self.name}: {self.old:.4g} → {self.new:.4g}{unit}" + (
                f" ± {self.uncertainty:.2g}" if self.deviation else ""
            )
        if math.isinf(self.deviation):
            return f"{self.name}: {self.old:.4g}{unit}, unchanged: the recordings do not determine it"
        return f"{self.name}: {self.old:.4g}{unit}, unchanged: fitted {self.new:.4g} ± {max(self.uncertainty, 1e-3 * abs(self.new)):.2g}"

    @property
    def changes(self) -> bool:
        """Whether the new value differs from the old one by more than its uncertainty, 1 in 1000 and the smallest significant difference."""
        difference = abs(self.new - self.old)
        if not self.alone:
            return self.paired
        return difference > max(self.uncertainty, 1e-3 * max(abs(self.old), abs(self.new)), _LEAST.get(self.key, 1e-12))


def fitted_parameters(real: Measurements, sim: Measurements, robot: RobotSpec) -> tuple[Parameter, ...]:
    """Returns the values that the recordings determine, whether they change or not.

    Args:
        real: Recording of the real robot.
        sim: Recording of the simulated ``robot``.
        robot: The simulated robot.
    """
    parameters: list[Parameter] = []
    if robot.drive is not None:
        parameters += _drive(real, sim, robot.drive)
        parameters += _odometry(real, sim, robot)
    parameters += _imu(real, robot)
    parameters += _lidar(real, sim, robot)
    return tuple(parameters)


def _ratio(a: Estimate | None, b: Estimate | None) -> tuple[float, float] | None:
    """Returns a / b and its standard deviation; None = one is missing."""
    if a is None or b is None or b.value == 0.0:
        return None
    ratio = a.value / b.value
    return ratio, abs(ratio) * math.hypot(a.deviation / a.value if a.value else 0.0, b.deviation / b.value)


def _drive(real: Measurements, sim: Measurements, drive: DriveSpec) -> Iterator[Parameter]:
    a, b = real.fit, sim.fit
    if a is None or b is None:
        return
    extra_delay = a.delay.value - b.delay.value
    yield Parameter(
        "drive", "command_delay", 0, drive.command_delay, min(max(drive.command_delay + extra_delay, 0.0), 10.0), "s",
        math.hypot(a.delay.deviation, b.delay.deviation), f"odometry follows cmd_vel {1e3 * extra_delay:+.0f} ms later than in the simulation",
    )  # fmt: skip
    limits = [("max_linear_acceleration", "m/s²", drive.max_linear_acceleration, a.linear_acceleration, b.linear_acceleration)]
    if not isinstance(drive, AckermannSpec):
        turning = drive.max_angular_acceleration
        limits.append(("max_angular_acceleration", "rad/s²", turning, a.angular_acceleration, b.angular_acceleration))
    for key, unit, old, of_real, of_sim in limits:
        ratio = _ratio(of_real, of_sim)
        if ratio is not None:
            yield Parameter("drive", key, 0, old, old * ratio[0], unit, old * ratio[1], "slope of the velocity after a step")
    kinds = [("slip", drive.slip, _truth_gain(real, "forward"), _truth_gain(sim, "forward"))]
    if not isinstance(drive, AckermannSpec):
        kinds.append(("turn_slip", drive.turn_slip, _truth_gain(real, "turn"), _truth_gain(sim, "turn")))
    for key, old, of_real, of_sim in kinds:
        ratio = _ratio(of_real, of_sim)
        if ratio is not None:
            new = 1.0 - (1.0 - old) * ratio[0]
            yield Parameter("drive", key, 0, old, min(max(new, -0.5), 0.9), "", ratio[1], "true motion over the one commanded")


def _truth_gain(measured: Measurements, kind: str) -> Estimate | None:
    """Returns the ratio of true to commanded velocity: odometry to commands, divided by odometry to truth."""
    fit, drift = measured.fit, measured.drift
    if fit is None or drift is None:
        return None
    scales = drift.scales
    if kind == "forward":
        gain, scale = fit.linear_gain, Estimate(scales.forward, scales.forward_deviation)
    else:
        gain, scale = fit.angular_gain, Estimate(scales.turn, scales.turn_deviation)
    if gain is None or math.isnan(scale.value) or scale.value == 0.0:
        return None
    ratio = gain.value / scale.value
    return Estimate(ratio, math.hypot(gain.deviation / scale.value, ratio * scale.deviation / scale.value))


def _odometry_gains(measured: Measurements, wheels: WheelOdometrySpec) -> tuple[Estimate | None, Estimate | None]:
    """Returns the ratios of odometry to commands, forward and yaw; odometry's random errors do not average out over a short path."""
    fit = measured.fit
    assert fit is not None
    path, turned = (float(np.trapezoid(np.abs(values), fit.t)) for values in (fit.linear, fit.angular))
    alphas = [max(getattr(wheels, f"alpha{i}"), getattr(measured.alphas, f"alpha{i}", 0.0)) for i in range(1, 5)]
    forward = math.sqrt(alphas[2] * path + alphas[3] * turned) / path if path else 0.0
    turn = math.sqrt(alphas[0] * turned + alphas[1] * path) / turned if turned else 0.0
    first, second = (
        None if gain is None else Estimate(gain.value, math.hypot(gain.deviation, random * gain.value))
        for gain, random in ((fit.linear_gain, forward), (fit.angular_gain, turn))
    )
    return first, second


def _odometry(real: Measurements, sim: Measurements, robot: RobotSpec) -> Iterator[Parameter]:
    a, b, wheels = real.fit, sim.fit, robot.sensors.wheel_odometry
    if a is None or b is None or robot.drive is None:
        return
    forward, turn = (_ratio(*pair) for pair in zip(_odometry_gains(real, wheels), _odometry_gains(sim, wheels), strict=True))
    if forward is not None:
        mean = (wheels.left_radius_factor + wheels.right_radius_factor) / 2
        difference = wheels.right_radius_factor - wheels.left_radius_factor
        new_mean, half = mean * forward[0], _half_difference(real, sim, robot.drive, difference)
        because = "speed by odometry over commanded speed; left and right by the veer"
        # Changing only one would make the robot veer, so both change together, because of their mean or of their difference.
        parts = ((mean, new_mean, forward[1]), (difference / 2, half.value, half.deviation))
        changes = any(abs(new - old) > max(CERTAINTY * deviation, 1e-3) for old, new, deviation in parts)
        for key, old, new in (
            ("left_radius_factor", wheels.left_radius_factor, new_mean - half.value),
            ("right_radius_factor", wheels.right_radius_factor, new_mean + half.value),
        ):
            deviation = math.hypot(forward[1], half.deviation)
            yield Parameter(
                "wheel_odometry", key, 0, old, min(max(new, 0.5), 2.0), "", deviation, because, alone=False, paired=changes
            )
        if turn is not None:
            ratio = forward[0] / turn[0]
            new = min(max(wheels.separation_factor * ratio, 0.5), 2.0)
            deviation = ratio * math.hypot(forward[1], turn[1])
            because = "forward speed over yaw rate by odometry, each over its command"
            yield Parameter("wheel_odometry", "separation_factor", 0, wheels.separation_factor, new, "", deviation, because)
    if real.ticks is not None:
        ticks = _ticks(wheels.encoder_ticks, real.ticks, sim.ticks)
        because = "noise of the speed by odometry at constant speed"
        yield Parameter("wheel_odometry", "encoder_ticks", 0, wheels.encoder_ticks, ticks.value, "", ticks.deviation, because)
    if real.alphas is not None:
        for key in ("alpha1", "alpha2", "alpha3", "alpha4"):
            of_real, of_sim = (_alpha(side, key) for side in (real, sim))
            old = getattr(wheels, key)
            estimate = of_real if of_sim is None or of_real is None else _without_sim_excess(old, of_real, of_sim)
            if estimate is not None:
                because = "spread of odometry's errors over segments of the drive"
                yield Parameter("wheel_odometry", key, 0, old, max(estimate.value, 0.0), "", estimate.deviation, because)


def _alpha(measured: Measurements, key: str) -> Estimate | None:
    alphas = measured.alphas
    # ``uncertainty`` is that of the square root.
    return None if alphas is None else Estimate(getattr(alphas, key), 2.0 * alphas.uncertainty * getattr(alphas, key))


def _without_sim_excess(old: float, real: Estimate, sim: Estimate) -> Estimate:
    """Returns a variance or rate minus the excess over ``old`` in the recording of a simulated robot configured with ``old``."""
    excess = sim.value - old
    return Estimate(real.value - excess, math.hypot(real.deviation, sim.deviation, excess))


def _ticks(old: float, real: Estimate, sim: Estimate | None) -> Estimate:
    """Returns the ticks of an encoder without the noise of simulated odometry beyond that of its ``old`` ticks (0 = exact)."""
    # The variance of the noise is proportional to the square of the size of a tick.
    variances = [
        Estimate(estimate.value**-2, 2.0 * estimate.deviation / estimate.value**3)
        for estimate in (real, sim)
        if estimate is not None
    ]
    exact = 1.0 / old**2 if old else 0.0
    variance = variances[0] if sim is None else _without_sim_excess(exact, *variances)
    if variance.value <= variance.deviation:
        return Estimate(real.value, math.inf)
    ticks = variance.value**-0.5
    # Determined by the size of a tick, hence the relative uncertainty of the coarser of both.
    return Estimate(ticks, 0.5 * ticks**2 * max(ticks, old) * variance.deviation)


def _half_difference(real: Measurements, sim: Measurements, drive: DriveSpec, old: float) -> Estimate:
    """Returns half the difference of the right and the left radius factor, from the veer of odometry while the robot drives straight."""
    if not isinstance(drive, DifferentialSpec) or real.drift is None or sim.drift is None:
        return Estimate(old / 2, 0.0)
    a, b = real.drift.scales, sim.drift.scales
    deviation = math.hypot(a.veer_deviation, b.veer_deviation) * drive.wheel_separation / 2
    return Estimate((old + (a.veer - b.veer) * drive.wheel_separation) / 2, deviation)


def _imu(real: Measurements, robot: RobotSpec) -> Iterator[Parameter]:
    index = _sensor(robot.sensors.imus, real.recording.topics.get("imu", ""))
    if real.imu is None or index is None:
        return
    imu, spec = real.imu, robot.sensors.imus[index]
    # The relative standard deviation of a variance of n samples is sqrt(2 / n).
    samples = 3.0 * imu.rest_s * imu.rate_hz
    values: list[tuple[str, str, float, float]] = [
        ("gyro_noise", "rad/s/√Hz", imu.gyro.density, 1.5 * imu.gyro.density / math.sqrt(samples)),
        ("accel_noise", "m/s²/√Hz", imu.accel.density, 1.5 * imu.accel.density / math.sqrt(samples)),
        ("gyro_bias", "rad/s", imu.gyro_bias_rms, _bias_deviation(spec.gyro_bias, imu.gyro.density, imu.rest_s)),
        ("accel_bias", "m/s²", imu.accel_bias_rms, _bias_deviation(spec.accel_bias, imu.accel.density, imu.rest_s)),
    ]
    if imu.gyro.walk:
        values.append(("gyro_bias_walk", "rad/s/√s", imu.gyro.walk, imu.gyro.walk_deviation))
    if imu.accel.walk:
        values.append(("accel_bias_walk", "m/s²/√s", imu.accel.walk, imu.accel.walk_deviation))
    for key, unit, new, deviation in values:
        because = "root mean square of the three axes at rest" if key.endswith("bias") else "Allan deviation at rest"
        yield Parameter("imu", key, index, getattr(spec, key), new, unit, deviation, because)
    yield _rate("imu", index, spec.rate_hz, imu.rate_hz)


def _bias_deviation(old: float, density: float, rest_s: float) -> float:
    """Returns the standard deviation of the bias of three axes: of its measurement, and of one robot of a model with spread ``old``."""
    return math.hypot(density / math.sqrt(rest_s), old * _THREE_AXES)


def _lidar(real: Measurements, sim: Measurements, robot: RobotSpec) -> Iterator[Parameter]:
    index, scans = _sensor(robot.sensors.lidars, real.recording.topics.get("scan", "")), real.recording.scans
    if real.lidar is None or scans is None or index is None:
        return
    noise, spec = real.lidar, robot.sensors.lidars[index]
    samples = max(noise.scans * noise.beams, 1)
    if not math.isnan(noise.range_noise):
        deviation = noise.range_noise / math.sqrt(2.0 * samples)
        yield Parameter(
            "lidar", "range_noise", index, spec.range_noise, noise.range_noise, "m", deviation, "each beam against itself at rest"
        )
    if noise.resolution > 0.0:
        yield Parameter(
            "lidar", "resolution", index, spec.resolution, noise.resolution, "m", 0.0, "all ranges are multiples of it"
        )
    dropout = _dropout(real)
    if dropout is not None:
        of_sim = _dropout(sim)
        estimate = dropout if of_sim is None else _without_sim_excess(spec.dropout, dropout, of_sim)
        because = "missing beams between two that return"
        new = min(max(estimate.value, 0.0), 1.0)
        yield Parameter("lidar", "dropout", index, spec.dropout, new, "", estimate.deviation, because)
    for key, old, new, unit in (
        ("beams", float(spec.beams), float(noise.beams), ""),
        ("range_min", spec.range_min, scans.range_min, "m"),
        ("range_max", spec.range_max, scans.range_max, "m"),
    ):
        yield Parameter("lidar", key, index, old, new, unit, 0.0, "values of the messages")
    timing = (real.timing or {}).get(real.recording.topics.get("scan", ""))
    if timing is not None and timing.rate_hz:
        yield _rate("lidar", index, spec.rate_hz, timing.rate_hz)


def _dropout(measured: Measurements) -> Estimate | None:
    """Returns the fraction of beams that do not return; None = not determined."""
    lidar = measured.lidar
    return None if lidar is None or math.isnan(lidar.dropout) else Estimate(lidar.dropout, lidar.dropout_deviation)


def _rate(section: str, index: int, old: float, measured_hz: float) -> Parameter:
    """Returns a rate, rounded to an integer within 1 %."""
    whole = round(measured_hz)
    new = float(whole) if whole and abs(measured_hz - whole) < 0.01 * whole else round(measured_hz, 2)
    return Parameter(section, "rate_hz", index, old, new, "Hz", 0.005 * new, "stamps of the messages")


def _sensor(sensors: Sequence[ImuSpec | LidarSpec], topic: str) -> int | None:
    """Returns the index of the sensor with this topic, else 0; None if there are no sensors."""
    named = [i for i, sensor in enumerate(sensors) if topic.endswith(f"/{sensor.name}")]
    return (named or [0])[0] if sensors else None
