"""Which values of the ``robot.yaml`` would bring a simulated robot closer to a real one. Pure.

What the simulation has by itself (transport of commands, contact of wheels) is in its own recording too. So delays and ratios are not
set to what the real recording shows, but changed by what the two recordings differ.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from gibson_sim.bags.comparison.identify import Estimate
from gibson_sim.bags.comparison.measure import Measured
from gibson_sim.robots.drive_spec import AckermannSpec, DifferentialSpec, DriveSpec
from gibson_sim.robots.sensor_specs import ImuSpec, LidarSpec
from gibson_sim.robots.spec import RobotSpec


@dataclass(frozen=True, slots=True)
class Parameter:
    """One value of the file."""

    section: str
    """E.g. ``drive``."""
    key: str
    index: int
    """Which of several sensors of the section; 0 where there is one."""
    old: float
    new: float
    unit: str
    deviation: float
    """Standard deviation of ``new``, as far as it is known; NaN = it is not."""
    because: str
    """Where it comes from, for readers."""
    paired: bool = False
    """Whether one that it must fit to changes, so that it changes too."""

    @property
    def name(self) -> str:
        """E.g. ``drive.command_delay``."""
        return f"{self.section}.{self.key}"

    @property
    def changes(self) -> bool:
        """Whether the new value differs from the old one by more than it is uncertain, and by 1 in 1000."""
        difference = abs(self.new - self.old)
        unsure = 0.0 if math.isnan(self.deviation) else 2.0 * self.deviation
        return self.paired or difference > max(unsure, 1e-3 * max(abs(self.old), abs(self.new)), 1e-12)


def fitted_parameters(real: Measured, sim: Measured, robot: RobotSpec) -> tuple[Parameter, ...]:
    """Returns the values that the recordings tell, whether they change or not.

    Args:
        real: The recording to come close to.
        sim: The one of ``robot`` as it is.
        robot: The simulated robot.
    """
    found: list[Parameter] = []
    if robot.drive is not None:
        found += _drive(real, sim, robot.drive)
        found += _odometry(real, sim, robot)
    found += _imu(real, robot)
    found += _lidar(real, robot)
    return tuple(found)


def _ratio(a: Estimate | None, b: Estimate | None) -> tuple[float, float] | None:
    """Returns a / b and its standard deviation; None = one is missing."""
    if a is None or b is None or b.value == 0.0:
        return None
    ratio = a.value / b.value
    return ratio, abs(ratio) * math.hypot(a.deviation / a.value if a.value else 0.0, b.deviation / b.value)


def _drive(real: Measured, sim: Measured, drive: DriveSpec) -> Iterator[Parameter]:
    a, b = real.fit, sim.fit
    if a is None or b is None:
        return
    later = a.delay.value - b.delay.value
    yield Parameter(
        "drive", "command_delay", 0, drive.command_delay, min(max(drive.command_delay + later, 0.0), 10.0), "s",
        math.hypot(a.delay.deviation, b.delay.deviation), f"odometry follows cmd_vel {1e3 * later:+.0f} ms later than in the simulation",
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


def _truth_gain(measured: Measured, kind: str) -> Estimate | None:
    """Returns true velocity over the one commanded: that of odometry over commands, by that of odometry over the truth."""
    fit, of = measured.fit, measured.drift
    if fit is None or of is None:
        return None
    gain, scale = (fit.linear_gain, of.scales.forward) if kind == "forward" else (fit.angular_gain, of.scales.turn)
    if gain is None or math.isnan(scale) or scale == 0.0:
        return None
    return Estimate(gain.value / scale, gain.deviation / abs(scale))


def _odometry(real: Measured, sim: Measured, robot: RobotSpec) -> Iterator[Parameter]:
    a, b, wheels = real.fit, sim.fit, robot.sensors.wheel_odometry
    if a is None or b is None or robot.drive is None:
        return
    forward, turn = _ratio(a.linear_gain, b.linear_gain), _ratio(a.angular_gain, b.angular_gain)
    if forward is not None:
        mean = (wheels.left_radius_factor + wheels.right_radius_factor) / 2 * forward[0]
        half = _half_difference(real, sim, robot.drive, wheels.right_radius_factor - wheels.left_radius_factor)
        because = "speed by odometry over the one commanded; left and right by how it veers"
        sides = [
            Parameter("wheel_odometry", key, 0, old, min(max(new, 0.5), 2.0), "", forward[1], because)
            for key, old, new in (
                ("left_radius_factor", wheels.left_radius_factor, mean - half),
                ("right_radius_factor", wheels.right_radius_factor, mean + half),
            )
        ]
        # One of them alone would make the robot veer.
        yield from (replace(side, paired=any(one.changes for one in sides)) for side in sides)
        if turn is not None:
            ratio = forward[0] / turn[0]
            new = min(max(wheels.separation_factor * ratio, 0.5), 2.0)
            deviation = ratio * math.hypot(forward[1], turn[1])
            because = "forward speed over yaw rate by odometry, each over the one commanded"
            yield Parameter("wheel_odometry", "separation_factor", 0, wheels.separation_factor, new, "", deviation, because)
    if real.ticks is not None:
        because = "noise of the speed by odometry while it moves evenly"
        yield Parameter("wheel_odometry", "encoder_ticks", 0, wheels.encoder_ticks, real.ticks, "", 0.02 * real.ticks, because)
    if real.alphas is not None:
        for key in ("alpha1", "alpha2", "alpha3", "alpha4"):
            new = getattr(real.alphas, key)
            deviation = 2.0 * real.alphas.uncertainty * new
            because = "spread of odometry's errors over pieces of the drive"
            yield Parameter("wheel_odometry", key, 0, getattr(wheels, key), new, "", deviation, because)


def _half_difference(real: Measured, sim: Measured, drive: DriveSpec, old: float) -> float:
    """Returns half of what the right radius factor is above the left one, by how odometry veers while the robot goes straight."""
    if not isinstance(drive, DifferentialSpec) or real.drift is None or sim.drift is None:
        return old / 2
    veer = real.drift.scales.veer - sim.drift.scales.veer
    return (old + veer * drive.wheel_separation) / 2


def _imu(real: Measured, robot: RobotSpec) -> Iterator[Parameter]:
    index = _sensor(robot.sensors.imus, real.recording.topics.get("imu", ""))
    if real.imu is None or index is None:
        return
    imu, spec = real.imu, robot.sensors.imus[index]
    # A variance of n samples is known to its sqrt(2 / n)-th part.
    samples = 3.0 * imu.rest_s * imu.rate_hz
    values: list[tuple[str, str, float, float]] = [
        ("gyro_noise", "rad/s/√Hz", imu.gyro.density, 1.5 * imu.gyro.density / math.sqrt(samples)),
        ("accel_noise", "m/s²/√Hz", imu.accel.density, 1.5 * imu.accel.density / math.sqrt(samples)),
        ("gyro_bias", "rad/s", imu.gyro_bias_rms, imu.gyro.density / math.sqrt(imu.rest_s)),
        ("accel_bias", "m/s²", imu.accel_bias_rms, imu.accel.density / math.sqrt(imu.rest_s)),
    ]
    if imu.gyro.walk:
        values.append(("gyro_bias_walk", "rad/s/√s", imu.gyro.walk, math.nan))
    if imu.accel.walk:
        values.append(("accel_bias_walk", "m/s²/√s", imu.accel.walk, math.nan))
    for key, unit, new, deviation in values:
        because = "root mean square of the three axes at rest" if key.endswith("bias") else "Allan deviation at rest"
        yield Parameter("imu", key, index, getattr(spec, key), new, unit, deviation, because)
    yield _rate("imu", index, spec.rate_hz, imu.rate_hz)


def _lidar(real: Measured, robot: RobotSpec) -> Iterator[Parameter]:
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
            "lidar", "resolution", index, spec.resolution, noise.resolution, "m", math.nan, "all ranges are multiples of it"
        )
    if not math.isnan(noise.dropout):
        deviation = math.sqrt(noise.dropout * (1.0 - noise.dropout) / max(scans.ranges.size, 1))
        because = "beams that do not return between two that do"
        yield Parameter("lidar", "dropout", index, spec.dropout, noise.dropout, "", deviation, because)
    for key, old, new, unit in (
        ("beams", float(spec.beams), float(noise.beams), ""),
        ("range_min", spec.range_min, scans.range_min, "m"),
        ("range_max", spec.range_max, scans.range_max, "m"),
    ):
        yield Parameter("lidar", key, index, old, new, unit, math.nan, "as the messages say")
    timing = (real.timing or {}).get(real.recording.topics.get("scan", ""))
    if timing is not None and timing.rate_hz:
        yield _rate("lidar", index, spec.rate_hz, timing.rate_hz)


def _rate(section: str, index: int, old: float, measured_hz: float) -> Parameter:
    """Returns a rate, whole where it is within 1 per cent of that."""
    whole = round(measured_hz)
    new = float(whole) if whole and abs(measured_hz - whole) < 0.01 * whole else round(measured_hz, 2)
    return Parameter(section, "rate_hz", index, old, new, "Hz", 0.005 * new, "stamps of the messages")


def _sensor(sensors: Sequence[ImuSpec | LidarSpec], topic: str) -> int | None:
    """Returns which sensor has this topic; the first where none has; None where there are none."""
    named = [i for i, sensor in enumerate(sensors) if topic.endswith(f"/{sensor.name}")]
    return (named or [0])[0] if sensors else None
