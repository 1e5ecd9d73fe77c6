"""Specifications of a robot's sensors other than cameras: pure values. All noise is off by default.

``name`` is the topic, relative to the robot's namespace; ``link`` is ``<body>/<link>``.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.types import check_seed

TOPIC = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")
"""Pattern of valid relative ROS topic names."""
MAX_RAYS = 1_000_000
"""Maximum number of rays of one scan."""
TURN = 2.0 * math.pi
"""One revolution, radians."""


@dataclass(frozen=True, slots=True)
class LidarSpec:
    """A planar lidar: evenly spaced rays about the link's z axis, counter-clockwise, all cast at the same time."""

    link: str
    """Link ``<body>/<link>`` from whose origin the rays are cast."""
    beams: int = 360
    range_min: float = 0.12
    """Minimum range, metres; nearer returns are reported as -inf (REP 117)."""
    range_max: float = 12.0
    """Maximum range, metres; farther returns, and no return, are reported as +inf (REP 117)."""
    rate_hz: float = 10.0
    name: str = "scan"
    angle_min: float = 0.0
    """Direction of the first ray, radians from the link's x axis."""
    fov: float = TURN
    """Angle from the first ray to the last, radians, in (0, 2 pi]; for a full revolution the last ray is one step before the first."""
    range_noise: float = 0.0
    """Standard deviation of a range, independent of the distance, metres."""
    resolution: float = 0.0
    """Range resolution: ranges are multiples of it, metres; 0 = exact."""
    dropout: float = 0.0
    """Probability that a ray does not return, 0 to 1."""
    seed: int = 0
    range_noise_ratio: float = 0.0
    """Standard deviation of a range as a fraction of it, in addition to ``range_noise``; 0.01 = 1 % of the distance."""
    range_scale: float = 0.0
    """Standard deviation of the scale factor of this device around 1, sampled once for each seed."""

    def __post_init__(self) -> None:
        what = _name(self.name, self.link)
        _ranging(what, self)
        if not 1 <= self.beams <= MAX_RAYS:
            raise ConfigError(f"{what}: beams is {self.beams}, must be 1 to {MAX_RAYS}")
        if not 0.0 < self.fov <= TURN + 1e-9:
            raise ConfigError(f"{what}: fov is {self.fov:g} rad, must be in (0, 2 pi]; was it given in degrees?")
        if not abs(self.angle_min) <= TURN:
            raise ConfigError(f"{what}: angle_min is {self.angle_min:g} rad, must be -2 pi to 2 pi; was it given in degrees?")
        if self.beams < 2 and not self.is_full_turn:
            raise ConfigError(f"{what}: beams is {self.beams}, must be 2 or more to span a field of view")

    @property
    def is_full_turn(self) -> bool:
        """Whether the rays span a full revolution."""
        return self.fov >= TURN - 1e-9

    @property
    def angle_increment(self) -> float:
        """Angle between adjacent rays, radians."""
        return TURN / self.beams if self.is_full_turn else self.fov / (self.beams - 1)


@dataclass(frozen=True, slots=True)
class Lidar3DSpec:
    """A spinning multi-channel lidar; all rays of a revolution are cast at the same time."""

    link: str
    """Link ``<body>/<link>`` from whose origin the rays are cast."""
    name: str = "lidar/points"
    channels: int = 16
    """Number of rings, evenly spaced between the two elevations."""
    samples: int = 720
    """Number of rays per ring in one revolution, the first along the link's x axis, then counter-clockwise."""
    elevation_min: float = math.radians(-15.0)
    """Elevation of the lowest ring above the link's x-y plane, radians."""
    elevation_max: float = math.radians(15.0)
    """Elevation of the highest ring, radians; a single channel is in the middle."""
    range_min: float = 0.3
    """Minimum range, metres; nearer returns yield no point."""
    range_max: float = 100.0
    """Maximum range, metres; farther returns yield no point."""
    rate_hz: float = 10.0
    range_noise: float = 0.0
    """Standard deviation of a range, independent of the distance, metres."""
    resolution: float = 0.0
    """Range resolution: ranges are multiples of it, metres; 0 = exact."""
    dropout: float = 0.0
    """Probability that a ray does not return, 0 to 1."""
    seed: int = 0
    range_noise_ratio: float = 0.0
    """Standard deviation of a range as a fraction of it, in addition to ``range_noise``; 0.01 = 1 % of the distance."""
    range_scale: float = 0.0
    """Standard deviation of the scale factor of this device around 1, sampled once for each seed."""

    def __post_init__(self) -> None:
        what = _name(self.name, self.link)
        _ranging(what, self)
        if not (1 <= self.channels <= 65_535 and self.samples >= 1 and self.channels * self.samples <= MAX_RAYS):
            raise ConfigError(
                f"{what}: channels is {self.channels} and samples {self.samples}, must be 1 or more, at most {MAX_RAYS} rays together"
            )
        if not -math.pi / 2 <= self.elevation_min <= self.elevation_max <= math.pi / 2:
            raise ConfigError(
                f"{what}: elevation_min is {self.elevation_min:g} and elevation_max {self.elevation_max:g} rad, must be "
                "-pi/2 <= elevation_min <= elevation_max <= pi/2; were they given in degrees?"
            )


@dataclass(frozen=True, slots=True)
class ImuSpec:
    """An IMU: gyroscopes, accelerometers and, by default, an orientation (REP 145)."""

    link: str
    """Link ``<body>/<link>``: the sensor measures at its origin, along its axes."""
    name: str = "imu"
    rate_hz: float = 100.0
    gyro_noise: float = 0.0
    """White noise density, rad/s/sqrt(Hz): the standard deviation of a sample is this times the square root of the rate."""
    accel_noise: float = 0.0
    """White noise density, m/s^2/sqrt(Hz)."""
    gyro_bias: float = 0.0
    """Standard deviation of the bias at the start, rad/s."""
    accel_bias: float = 0.0
    """Standard deviation of the bias at the start, m/s^2."""
    gyro_bias_walk: float = 0.0
    """Random walk of the bias, rad/s/sqrt(s): its standard deviation after t seconds is this times the square root of t."""
    accel_bias_walk: float = 0.0
    """Random walk of the bias, m/s^2/sqrt(s)."""
    orientation: bool = True
    """Whether the (exact) orientation in the world frame is reported."""
    seed: int = 0

    def __post_init__(self) -> None:
        what = _name(self.name, self.link)
        _rate(what, self.rate_hz)
        check_seed(what, self.seed)
        for key in ("gyro_noise", "accel_noise", "gyro_bias", "accel_bias", "gyro_bias_walk", "accel_bias_walk"):
            _not_negative(what, key, getattr(self, key))


@dataclass(frozen=True, slots=True)
class BumperSpec:
    """A bumper: detects lateral contacts; contacts of supporting surfaces and of loads on the robot do not count."""

    link: str
    """Link ``<body>/<link>`` in whose frame the force is reported."""
    links: tuple[str, ...] = ()
    """Sensitive links, without the body name: the first of each rigid group; () = the whole robot."""
    name: str = "bumper"
    threshold: float = 1.0
    """Minimum total force of all contacts that is detected, N, above 0."""
    max_slope: float = math.radians(45.0)
    """Angle to the vertical below which the normal of a contact is that of a floor or a load, radians, in [0, pi/2)."""
    rate_hz: float = 30.0

    def __post_init__(self) -> None:
        what = _name(self.name, self.link)
        _rate(what, self.rate_hz)
        if not (math.isfinite(self.threshold) and self.threshold > 0.0):
            raise ConfigError(f"{what}: threshold is {self.threshold:g} N, must be a finite number above 0")
        if not 0.0 <= self.max_slope < math.pi / 2:
            raise ConfigError(f"{what}: max_slope is {self.max_slope:g} rad, must be in [0, pi/2); was it given in degrees?")


@dataclass(frozen=True, slots=True)
class BatterySpec:
    """A battery whose voltage falls linearly with its charge. It is never recharged, and an empty battery does not stop the robot."""

    name: str = "battery_state"
    capacity_ah: float = 5.2
    """Charge of a full battery, A h."""
    voltage_full: float = 12.6
    """Voltage of a full battery, V."""
    voltage_empty: float = 9.9
    """Voltage of an empty battery, V."""
    idle_w: float = 10.0
    """Power consumption without the motors, W."""
    efficiency: float = 0.6
    """Ratio of the mechanical power of the joints to the power of their motors, in (0, 1]; braking recovers nothing."""
    torque_w: float = 0.0
    """Additional power of the motors at any speed, W per N m."""
    start: float = 1.0
    """Charge at the start, as a fraction of the capacity, 0 to 1."""
    warn_below: float = 0.2
    """Low charge threshold, as a fraction of the capacity, 0 to 1."""
    rate_hz: float = 1.0
    """Reports per second; the motors' power is sampled at the same rate."""

    def __post_init__(self) -> None:
        what = _name(self.name, "")
        _rate(what, self.rate_hz)
        if not (math.isfinite(self.capacity_ah) and self.capacity_ah > 0.0):
            raise ConfigError(f"{what}: capacity_ah is {self.capacity_ah:g}, must be a finite number above 0")
        if not 0.0 < self.voltage_empty <= self.voltage_full < math.inf:
            raise ConfigError(
                f"{what}: voltage_empty is {self.voltage_empty:g} and voltage_full {self.voltage_full:g} V, "
                "must be 0 < voltage_empty <= voltage_full"
            )
        for key in ("idle_w", "torque_w"):
            _not_negative(what, key, getattr(self, key))
        if not 0.0 < self.efficiency <= 1.0:
            raise ConfigError(f"{what}: efficiency is {self.efficiency:g}, must be in (0, 1]")
        for key in ("start", "warn_below"):
            _fraction(what, key, getattr(self, key))


@dataclass(frozen=True, slots=True)
class WheelOdometrySpec:
    """Errors of wheel odometry.

    The alphas are those of the odometry model in Thrun, Burgard and Fox, "Probabilistic Robotics" (2005), for motions of 1 m and 1 rad, over which an
    error is a constant fraction of the motion. The errors of longer motions are sums of independent errors (a random walk).
    """

    encoder_ticks: int = 0
    """Encoder ticks per revolution of a wheel; 0 = exact."""
    left_radius_factor: float = 1.0
    """Ratio of the radius of the left wheels in the odometry to their true radius."""
    right_radius_factor: float = 1.0
    separation_factor: float = 1.0
    """Ratio of the wheel separation in the odometry to the true separation."""
    alpha1: float = 0.0
    """Variance of the measured rotation due to rotation, rad^2 per rad."""
    alpha2: float = 0.0
    """Variance of the measured rotation due to translation, rad^2 per m."""
    alpha3: float = 0.0
    """Variance of the measured translation due to translation, m^2 per m."""
    alpha4: float = 0.0
    """Variance of the measured translation due to rotation, m^2 per rad."""
    seed: int = 0

    def __post_init__(self) -> None:
        what = "wheel_odometry"
        check_seed(what, self.seed)
        if not 0 <= self.encoder_ticks <= 100_000_000:
            raise ConfigError(f"{what}: encoder_ticks is {self.encoder_ticks}, must be 0 (exact) to 100000000")
        for key in ("left_radius_factor", "right_radius_factor", "separation_factor"):
            if not 0.5 <= getattr(self, key) <= 2.0:
                raise ConfigError(f"{what}: {key} is {getattr(self, key):g}, must be 0.5 to 2; 1 = no error")
        for key in ("alpha1", "alpha2", "alpha3", "alpha4"):
            _not_negative(what, key, getattr(self, key))


@dataclass(frozen=True, slots=True)
class SensorSpecs:
    """All sensors of a robot other than cameras."""

    lidars: tuple[LidarSpec, ...] = ()
    lidars_3d: tuple[Lidar3DSpec, ...] = ()
    imus: tuple[ImuSpec, ...] = ()
    bumpers: tuple[BumperSpec, ...] = ()
    battery: BatterySpec | None = None
    wheel_odometry: WheelOdometrySpec = field(default_factory=WheelOdometrySpec)

    def __post_init__(self) -> None:
        names = self.names
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ConfigError(f"sensors: {', '.join(twice)} is the name of more than one; names are topics and must be unique")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all sensors."""
        battery = () if self.battery is None else (self.battery,)
        return tuple(spec.name for spec in (*self.lidars, *self.lidars_3d, *self.imus, *self.bumpers, *battery))


def _name(name: str, link: str) -> str:
    """Returns the beginning of error messages; raises ConfigError if the name is not a valid topic."""
    what = f"sensor {quoted(name)} on {quoted(link)}" if link else f"sensor {quoted(name)}"
    if not TOPIC.fullmatch(name):
        raise ConfigError(f"{what}: the name is a topic; use letters, digits, _ and /, a letter first")
    return what


def _ranging(what: str, spec: LidarSpec | Lidar3DSpec) -> None:
    if not 0.0 <= spec.range_min < spec.range_max < math.inf:
        raise ConfigError(
            f"{what}: range_min is {spec.range_min:g} and range_max {spec.range_max:g}, must be 0 <= range_min < range_max, finite"
        )
    _rate(what, spec.rate_hz)
    check_seed(what, spec.seed)
    for key in ("range_noise", "resolution"):
        _not_negative(what, key, getattr(spec, key))
    for key in ("range_noise_ratio", "range_scale"):
        if not 0.0 <= getattr(spec, key) <= 0.2:
            raise ConfigError(
                f"{what}: {key} is {getattr(spec, key):g}, must be 0 to 0.2: a fraction of the distance, not a percentage"
            )
    _fraction(what, "dropout", spec.dropout)


def _rate(what: str, rate_hz: float) -> None:
    if not 0.001 <= rate_hz <= 1000.0:
        raise ConfigError(f"{what}: rate_hz is {rate_hz:g}, must be 0.001 to 1000")


def _not_negative(what: str, key: str, value: float) -> None:
    if not 0.0 <= value < math.inf:
        raise ConfigError(f"{what}: {key} is {value:g}, must be a finite number, 0 or more")


def _fraction(what: str, key: str, value: float) -> None:
    if not 0.0 <= value <= 1.0:
        raise ConfigError(f"{what}: {key} is {value:g}, must be 0 to 1")
