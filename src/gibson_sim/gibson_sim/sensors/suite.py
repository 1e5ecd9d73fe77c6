"""All sensors of one robot except cameras: their schedule, state and readings. Pure."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.robots.sensor_specs import BumperSpec, Lidar3DSpec, LidarSpec
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.sensors.battery import Battery, BatteryReading
from gibson_sim.sensors.bumper import BumperReading, measure_bumper
from gibson_sim.sensors.imu import Imu, ImuReading
from gibson_sim.sensors.lidar import LidarCloud, Scan, measure_cloud, measure_scan, noise_of
from gibson_sim.types import Contact, JointStates, SceneState, Vec3

logger = logging.getLogger(__name__)


class SensedWorld(Protocol):
    """The part of ``PhysicsWorld`` required by sensors."""

    def state_of(self, name: str, /) -> SceneState:
        """Returns the current poses of at least the links of one body."""

    def cast_rays(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64], range_max: float, ignore: str | None = None, /
    ) -> NDArray[np.float64]:
        """Returns the distance to the first hit of every ray, (N,), metres; +inf = no hit."""

    def contacts(self, name: str, /) -> tuple[Contact, ...]:
        """Returns the contacts of a body with other bodies."""

    def joint_states(self, robot: str, /) -> JointStates:
        """Returns the states of a robot's movable joints."""


_Read = Callable[[SensedWorld, int, int], Any]
"""Measures: (world, step, stamp_ns) -> reading."""


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """Readings of one step; each reading has the name of its sensor."""

    stamp_ns: int
    scans: tuple[Scan, ...] = ()
    clouds: tuple[LidarCloud, ...] = ()
    imus: tuple[ImuReading, ...] = ()
    bumpers: tuple[BumperReading, ...] = ()
    batteries: tuple[BatteryReading, ...] = ()

    def __bool__(self) -> bool:
        """Whether anything was measured."""
        return bool(self.scans or self.clouds or self.imus or self.bumpers or self.batteries)


class SensorSuite:
    """The sensors of one robot.

    Lidars and bumpers measure at the ticks at which the state is published, so that a transform with their stamp exists; IMUs and the
    battery measure at steps. ``schedule.is_due`` defines when each sensor is due.
    """

    def __init__(self, robot: RobotSpec, step_hz: int, publish_hz: int, gravity: Vec3, seed: int = 0) -> None:
        """Creates all sensors in their state at step 0.

        Args:
            robot: robot that carries the sensors.
            step_hz: physics steps per second.
            publish_hz: rate of published states; must divide ``step_hz``.
            gravity: gravitational acceleration, world frame, m/s^2.
            seed: seed of the simulation; with a sensor's seed and name and the stamp it determines every error.

        Raises:
            ConfigError: ``publish_hz`` does not divide ``step_hz``.
        """
        if step_hz % publish_hz:
            raise ConfigError(f"sensors: publish_hz is {publish_hz}, must divide step_hz, which is {step_hz}")
        self._robot, self._step_hz, self._seed = robot, step_hz, seed
        sensors, tick = robot.sensors, step_hz // publish_hz
        self._imus = [Imu(spec, gravity, seed) for spec in sensors.imus]
        self._battery = None if sensors.battery is None else Battery(sensors.battery)
        self._tasks: list[_Task] = [
            *(_Task(s.name, "scans", _Timer(s.rate_hz, step_hz, tick), self._scan(s), can_skip=True) for s in sensors.lidars),
            *(
                _Task(s.name, "clouds", _Timer(s.rate_hz, step_hz, tick), self._cloud(s), can_skip=True)
                for s in sensors.lidars_3d
            ),
            *(_Task(spec.name, "bumpers", _Timer(spec.rate_hz, step_hz, tick), self._bumper(spec)) for spec in sensors.bumpers),
            *(_imu(imu, robot.name, step_hz) for imu in self._imus),
        ]
        if self._battery is not None:
            spec = self._battery.spec
            self._tasks.append(_Task(spec.name, "batteries", _Timer(spec.rate_hz, step_hz, 1), self._drain))
        self.reset()

    def reset(self, step: int = 0) -> None:
        """Restores the initial state of all sensors, after ``step`` steps of the world, and forgets missed readings."""
        self._last_drain = step
        self._charge_reported = "normal"
        for imu in self._imus:
            imu.reset()
        if self._battery is not None:
            self._battery.reset()
        for task in self._tasks:
            task.start(step)
        self._next = min((task.due for task in self._tasks), default=None)

    @property
    def misses(self) -> dict[str, int]:
        """Number of readings missed by each sensor since the last reset."""
        return {task.name: task.misses for task in self._tasks}

    def measure(
        self, world: SensedWorld, step: int, stamp_ns: int, is_requested: Callable[[str], bool] | None = None
    ) -> Measurements:
        """Returns the readings due at ``step``, mostly none; call it after every step of the world.

        Args:
            world: world after ``step`` steps.
            step: steps since loading; call ``reset`` after a jump backwards.
            stamp_ns: stamp of that step.
            is_requested: returns whether the named sensor is requested. It is called for lidars, which take the most time, and for IMUs
                without random walk, whose first sample after a pause is skipped too. None = all sensors are requested.
        """
        if self._next is None or step < self._next:
            return Measurements(stamp_ns)
        readings: dict[str, list[Any]] = {}
        for task in self._tasks:
            if task.due <= step and task.advance(step):
                was_skipped = task.skipped
                task.skipped = task.can_skip and is_requested is not None and not is_requested(task.name)
                if task.skipped:
                    continue
                try:
                    if was_skipped and task.resume is not None:
                        task.resume(world)
                        continue
                    readings.setdefault(task.kind, []).append(task.read(world, step, stamp_ns))
                except GibsonSimError as error:
                    task.miss(self._robot.name, error)
        self._next = min(task.due for task in self._tasks)
        return Measurements(stamp_ns, **{kind: tuple(values) for kind, values in readings.items()})

    def _scan(self, spec: LidarSpec) -> _Read:
        noise = noise_of(self._robot.name, spec, self._seed)
        return lambda world, step, stamp_ns: measure_scan(spec, world.state_of(self._robot.name), world.cast_rays, noise)

    def _cloud(self, spec: Lidar3DSpec) -> _Read:
        noise = noise_of(self._robot.name, spec, self._seed)
        return lambda world, step, stamp_ns: measure_cloud(spec, world.state_of(self._robot.name), world.cast_rays, noise)

    def _bumper(self, spec: BumperSpec) -> _Read:
        name = self._robot.name
        return lambda world, step, stamp_ns: measure_bumper(spec, world.state_of(name), world.contacts(name))

    def _drain(self, world: SensedWorld, step: int, stamp_ns: int) -> BatteryReading:
        assert self._battery is not None
        power = self._battery.power(world.joint_states(self._robot.name))
        reading = self._battery.drain(power, (step - self._last_drain) / self._step_hz, stamp_ns)
        self._last_drain = step
        charge = "empty" if reading.empty else "low" if reading.low else "normal"
        if charge not in ("normal", self._charge_reported):
            logger.warning("battery of robot %r is %s: %.0f %% left", self._robot.name, charge, 100 * reading.percentage)
        self._charge_reported = charge
        return reading


def _imu(imu: Imu, robot: str, step_hz: int) -> _Task:
    return _Task(
        imu.spec.name, "imus", _Timer(imu.spec.rate_hz, step_hz, 1),
        read=lambda world, step, stamp_ns: imu.measure(world.state_of(robot)),
        can_skip=imu.can_skip_samples, resume=lambda world: imu.note(world.state_of(robot)),
    )  # fmt: skip


class _Timer:
    """The steps at which a sensor is due, in integer arithmetic: equal to ``schedule.is_due`` at every tick."""

    def __init__(self, rate_hz: float, step_hz: int, steps_per_tick: int) -> None:
        tick_hz = Fraction(step_hz, steps_per_tick)
        ratio = min(Fraction(rate_hz).limit_denominator(1000) / tick_hz, Fraction(1))
        self._up, self._down, self._steps = ratio.numerator, ratio.denominator, steps_per_tick

    def count(self, step: int) -> int:
        """Returns the number of times the sensor was due up to ``step``, inclusive."""
        return step // self._steps * self._up // self._down

    def step_of(self, count: int) -> int:
        """Returns the step at which the sensor is due for the ``count``-th time."""
        return -(-count * self._down // self._up) * self._steps


class _Task:
    """A sensor and the step at which it is due next.

    Args:
        name: name of the sensor.
        kind: field of ``Measurements``.
        timer: steps at which the sensor is due.
        read: measures.
        can_skip: whether the sensor is skipped while it is not requested.
        resume: called instead of ``read`` for the first reading after skipping; None = ``read`` is called.
    """

    def __init__(
        self,
        name: str,
        kind: str,
        timer: _Timer,
        read: _Read,
        *,
        can_skip: bool = False,
        resume: Callable[[SensedWorld], None] | None = None,
    ) -> None:
        self.name, self.kind, self.read, self.can_skip, self.resume = name, kind, read, can_skip, resume
        self._timer = timer
        self.start(0)

    def start(self, step: int) -> None:
        self._count = self._timer.count(step)
        self.due = self._timer.step_of(self._count + 1)
        self.misses = 0
        self.skipped = False

    def advance(self, step: int) -> bool:
        """Returns whether the sensor is due at ``step``; advances ``due``, and counts readings due before ``step`` as missed."""
        count = self._timer.count(step)
        is_due = self._timer.step_of(count) == step
        self.misses += count - self._count - is_due
        self._count = count
        self.due = self._timer.step_of(count + 1)
        return is_due

    def miss(self, robot: str, error: GibsonSimError) -> None:
        if not self.misses:
            logger.warning("sensor %r of robot %r measures nothing: %s", self.name, robot, error)
        self.misses += 1
