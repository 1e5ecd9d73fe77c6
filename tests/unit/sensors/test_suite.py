"""Readings that are due at a step, and those of a whole suite of sensors."""

from __future__ import annotations

import logging
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError, PhysicsError
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.sensor_specs import BatterySpec, BumperSpec, ImuSpec, Lidar3DSpec, LidarSpec, SensorSpecs
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.sensors.schedule import is_due
from gibson_sim.sensors.suite import Measurements, SensorSuite
from gibson_sim.types import NS_PER_S, Contact, JointStates, SceneState

STEP_HZ, PUBLISH_HZ = 240, 60
GRAVITY = (0.0, 0.0, -9.81)
ALL = SensorSpecs(
    lidars=(LidarSpec("r/base", beams=8, range_noise=0.1), LidarSpec("r/base", beams=4, name="scan_2", rate_hz=5.0)),
    lidars_3d=(Lidar3DSpec("r/base", channels=2, samples=4, rate_hz=5.0),),
    imus=(ImuSpec("r/base", accel_noise=0.1),),
    bumpers=(BumperSpec("r/base"),),
    battery=BatterySpec(capacity_ah=1.0, voltage_full=10.0, voltage_empty=10.0, idle_w=36.0),
)


class FakeWorld:
    """A robot at rest, 2 m from everything, pushed from the front; counts its calls."""

    def __init__(self) -> None:
        self.step, self.calls, self.broken = 0, 0, False

    def state_of(self, name: str) -> SceneState:
        assert name == "r"
        self.calls += 1
        if self.broken:
            raise PhysicsError("the world is closed")
        return SceneState(
            stamp(self.step), self.step, 1, ("r/base",), np.zeros((1, 3)), np.array([[0.0, 0, 0, 1]]), np.zeros((1, 6))
        )

    def cast_rays(self, origins: np.ndarray, directions: np.ndarray, range_max: float, ignore: str | None = None) -> np.ndarray:
        self.calls += 1
        return np.full(len(origins), 2.0)

    def contacts(self, name: str) -> tuple[Contact, ...]:
        self.calls += 1
        return (Contact("r", "base", "wall", "", (0.2, 0.0, 0.1), (-1.0, 0.0, 0.0), 3.0),)

    def joint_states(self, robot: str) -> JointStates:
        self.calls += 1
        return JointStates((), np.zeros(0), np.zeros(0), np.zeros(0))


def stamp(step: int) -> int:
    return step * NS_PER_S // STEP_HZ


@pytest.fixture
def robot(root: Path) -> RobotSpec:
    return replace(load_robot(root / "config/robots/gibson_bot", name="r"), sensors=ALL)


def run(suite: SensorSuite, world: FakeWorld, first: int, last: int) -> dict[int, Measurements]:
    """Returns the measurements of these steps, both ends included, that are not empty."""
    found = {}
    for step in range(first, last + 1):
        world.step = step
        got = suite.measure(world, step, stamp(step))
        assert got.stamp_ns == stamp(step)
        if any(getattr(got, f.name) for f in fields(got) if f.name != "stamp_ns"):
            found[step] = got
    return found


def test_lidars_and_bumpers_measure_when_their_rate_is_due_on_published_ticks(robot: RobotSpec) -> None:
    found = run(SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), FakeWorld(), 0, 480)
    # 10, 5, 5 and 30 Hz of 60 ticks: every 6th, 12th and 2nd tick, of 4 steps each.
    assert [s for s, got in found.items() if "scan" in [scan.name for scan in got.scans]] == list(range(24, 481, 24))
    assert [s for s, got in found.items() if "scan_2" in [scan.name for scan in got.scans]] == list(range(48, 481, 48))
    assert [s for s, got in found.items() if got.clouds] == list(range(48, 481, 48))
    assert [s for s, got in found.items() if got.bumpers] == list(range(8, 481, 8))


def test_imu_and_battery_measure_at_steps(robot: RobotSpec) -> None:
    found = run(SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), FakeWorld(), 0, 480)
    # 100 Hz of 240 steps: at 2.4, 4.8, 7.2, 9.6, 12 ...
    assert [s for s, got in found.items() if got.imus][:6] == [3, 5, 8, 10, 12, 15]
    assert len([s for s, got in found.items() if got.imus]) == 200
    assert [s for s, got in found.items() if got.batteries] == [240, 480]


@pytest.mark.parametrize("rate_hz", [0.3, 1.0, 7.0, 29.97, 60.0, 100.0, 239.9, 240.0, 1000.0])
def test_every_sensor_is_due_when_the_schedule_says_so(robot: RobotSpec, rate_hz: float) -> None:
    sensors = SensorSpecs(imus=(ImuSpec("r/base", rate_hz=rate_hz),), bumpers=(BumperSpec("r/base", rate_hz=rate_hz),))
    found = run(SensorSuite(replace(robot, sensors=sensors), STEP_HZ, PUBLISH_HZ, GRAVITY), FakeWorld(), 0, 1500)
    assert [s for s, got in found.items() if got.imus] == [s for s in range(1501) if is_due(s, rate_hz, STEP_HZ)]
    ticks = [4 * tick for tick in range(376) if is_due(tick, rate_hz, PUBLISH_HZ)]
    assert [s for s, got in found.items() if got.bumpers] == ticks


def test_values_are_those_of_the_world_at_the_stamp_of_the_step(robot: RobotSpec) -> None:
    quiet = replace(ALL, lidars=(LidarSpec("r/base", beams=8),), imus=(ImuSpec("r/base"),))
    got = run(SensorSuite(replace(robot, sensors=quiet), STEP_HZ, PUBLISH_HZ, GRAVITY), FakeWorld(), 1, 240)[240]
    assert got.scans[0].ranges.tolist() == [2.0] * 8
    assert got.clouds[0].points.shape == (8, 3)
    assert got.imus[0].linear_acceleration.tolist() == [0.0, 0.0, 9.81]
    assert got.bumpers[0].pressed
    # 36 W from 10 W h for a second: a thousandth.
    assert got.batteries[0].percentage == pytest.approx(0.999)
    values = (got.scans[0], got.clouds[0], got.imus[0], got.bumpers[0], got.batteries[0])
    assert {value.stamp_ns for value in values} == {NS_PER_S}


def test_battery_loses_the_same_in_every_second(robot: RobotSpec) -> None:
    found = run(SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), FakeWorld(), 1, 3 * STEP_HZ)
    assert [got.batteries[0].percentage for got in found.values() if got.batteries] == pytest.approx([0.999, 0.998, 0.997])


def test_world_is_not_called_when_nothing_is_due(robot: RobotSpec) -> None:
    world = FakeWorld()
    run(SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), world, 0, 2)
    assert world.calls == 0


def test_robot_without_sensors_measures_nothing(robot: RobotSpec) -> None:
    suite = SensorSuite(replace(robot, sensors=SensorSpecs()), STEP_HZ, PUBLISH_HZ, GRAVITY)
    assert run(suite, FakeWorld(), 0, 480) == {}
    assert suite.misses == {}


def numbers(found: dict[int, Measurements]) -> list[list[float]]:
    return [
        [
            *(r for scan in got.scans for r in scan.ranges.tolist()),
            *(a for imu in got.imus for a in imu.linear_acceleration.tolist()),
        ]
        for got in found.values()
    ]


def test_same_seed_gives_the_same_bits_whatever_else_is_measured(robot: RobotSpec) -> None:
    fewer = replace(robot, sensors=SensorSpecs(lidars=ALL.lidars, imus=ALL.imus))
    one, other = (run(SensorSuite(r, STEP_HZ, PUBLISH_HZ, GRAVITY, 7), FakeWorld(), 1, 100) for r in (robot, fewer))
    common = [step for step, got in one.items() if got.scans or got.imus]
    assert numbers({step: one[step] for step in common}) == numbers(other)


def test_lidars_that_are_not_requested_are_skipped_and_later_scans_are_the_same(robot: RobotSpec) -> None:
    all_of_it = run(SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), FakeWorld(), 1, 96)
    suite, world = SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), FakeWorld()
    found = {}
    for step in range(1, 97):
        world.step = step
        requested = ["scan"] if step > 48 else []
        found[step] = suite.measure(world, step, stamp(step), requested.__contains__)
    assert not any(got.scans or got.clouds for step, got in found.items() if step <= 48)
    assert [[scan.name for scan in found[step].scans] for step in (72, 96)] == [["scan"], ["scan"]]
    for step in (72, 96):
        np.testing.assert_array_equal(found[step].scans[0].ranges, all_of_it[step].scans[0].ranges)
        assert found[step].bumpers[0].force.tolist() == all_of_it[step].bumpers[0].force.tolist()
    assert not any(suite.misses.values())


class SpeedingWorld(FakeWorld):
    """A world whose robot accelerates and turns."""

    def state_of(self, name: str) -> SceneState:
        t = self.step / STEP_HZ
        quat, twist = [0.0, 0.0, np.sin(t / 2), np.cos(t / 2)], [t**3, t**2, 0.0, 0.0, 0.0, 1.0]
        return replace(super().state_of(name), quats_xyzw=np.array([quat]), twists=np.array([twist]))


def test_an_imu_that_is_not_requested_is_skipped_and_from_its_second_sample_on_measures_the_same(robot: RobotSpec) -> None:
    all_of_it = run(SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), SpeedingWorld(), 1, 96)
    suite, world = SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), SpeedingWorld()
    requested: list[str] = []
    found = {}
    for step in range(1, 97):
        world.step = step
        requested[:] = ["imu"] if 48 < step <= 72 or step > 80 else []
        found[step] = suite.measure(world, step, stamp(step), requested.__contains__)
    due = [step for step in range(1, 97) if step in all_of_it and all_of_it[step].imus]
    first = [next(step for step in due if step > begin) for begin in (48, 80)]
    measured = [step for step in due if (48 < step <= 72 or step > 80) and step not in first]
    assert [step for step, got in found.items() if got.imus] == measured
    for step in measured:
        assert found[step].imus[0].linear_acceleration.tolist() == all_of_it[step].imus[0].linear_acceleration.tolist()
    assert not any(suite.misses.values())


def test_an_imu_that_is_requested_from_the_start_gives_its_first_sample(robot: RobotSpec) -> None:
    suite, world = SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), SpeedingWorld()
    found = {}
    for step in range(1, 25):
        world.step = step
        found[step] = suite.measure(world, step, stamp(step), {"imu"}.__contains__)
    always = run(SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), SpeedingWorld(), 1, 24)
    assert [step for step, got in found.items() if got.imus] == [step for step, got in always.items() if got.imus]


def test_an_imu_with_random_walk_is_never_skipped(robot: RobotSpec) -> None:
    walking = replace(robot, sensors=replace(ALL, imus=(replace(ALL.imus[0], accel_bias_walk=0.01),)))
    suite, world = SensorSuite(walking, STEP_HZ, PUBLISH_HZ, GRAVITY), SpeedingWorld()
    measured = []
    for step in range(1, 97):
        world.step = step
        if suite.measure(world, step, stamp(step), lambda name: False).imus:
            measured.append(step)
    assert measured == [step for step in range(1, 97) if is_due(step, walking.sensors.imus[0].rate_hz, STEP_HZ)]


def test_other_seed_gives_other_errors(robot: RobotSpec) -> None:
    one, other = (numbers(run(SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY, seed), FakeWorld(), 1, 100)) for seed in (7, 8))
    assert not np.isclose(np.concatenate(one), np.concatenate(other)).all()


def test_reset_begins_again_with_the_same_measurements(robot: RobotSpec) -> None:
    suite, world = SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), FakeWorld()
    first = run(suite, world, 1, 300)
    suite.reset()
    again = run(suite, world, 1, 300)
    assert numbers(again) == numbers(first)
    assert again[240].batteries == first[240].batteries


def test_reset_that_keeps_time_goes_on_from_its_step_with_a_full_battery(robot: RobotSpec) -> None:
    suite, world = SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), FakeWorld()
    run(suite, world, 1, 480)
    suite.reset(600)
    found = run(suite, world, 601, 720)
    assert set(suite.misses.values()) == {0}
    # Half a second has passed since the reset.
    assert found[720].batteries[0].percentage == pytest.approx(0.9995)
    assert min(s for s, got in found.items() if got.bumpers) == 608


def test_steps_that_are_left_out_are_counted_as_missed(robot: RobotSpec) -> None:
    suite, world = SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), FakeWorld()
    run(suite, world, 1, 47)
    assert set(suite.misses.values()) == {0}
    # From step 48 to 95: scans at 48 and 72, the slower ones at 48, bumpers every 8 steps, the IMU at 20 of 48 steps.
    found = run(suite, world, 96, 96)
    assert suite.misses == {"scan": 2, "scan_2": 1, "lidar/points": 1, "bumper": 6, "imu": 20, "battery_state": 0}
    assert len(found[96].scans) == 2


def test_sensor_that_fails_is_counted_and_reported_once_and_the_others_go_on(
    robot: RobotSpec, caplog: pytest.LogCaptureFixture
) -> None:
    suite, world = SensorSuite(robot, STEP_HZ, PUBLISH_HZ, GRAVITY), FakeWorld()
    world.broken = True
    with caplog.at_level(logging.WARNING):
        found = run(suite, world, 1, 240)
    assert list(found) == [240]
    assert found[240].batteries
    assert suite.misses == {"scan": 10, "scan_2": 5, "lidar/points": 5, "bumper": 30, "imu": 100, "battery_state": 0}
    assert len([record for record in caplog.records if "'imu' of robot 'r'" in record.message]) == 1


def test_battery_that_runs_low_and_empty_is_reported_once_each(robot: RobotSpec, caplog: pytest.LogCaptureFixture) -> None:
    small = BatterySpec(capacity_ah=0.001, voltage_full=10.0, voltage_empty=10.0, idle_w=10.0)  # 36 J: 3.6 s
    suite = SensorSuite(replace(robot, sensors=SensorSpecs(battery=small)), STEP_HZ, PUBLISH_HZ, GRAVITY)
    with caplog.at_level(logging.WARNING):
        run(suite, FakeWorld(), 1, 6 * STEP_HZ)
    assert [record.message for record in caplog.records] == [
        "battery of robot 'r' is low: 17 % left",
        "battery of robot 'r' is empty: 0 % left",
    ]


def test_publish_rate_that_does_not_divide_the_steps_is_refused(robot: RobotSpec) -> None:
    with pytest.raises(ConfigError, match="publish_hz is 100"):
        SensorSuite(robot, 240, 100, GRAVITY)
