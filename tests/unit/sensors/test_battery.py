"""The charge of a battery."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.robots.sensor_specs import BatterySpec
from gibson_sim.sensors.battery import Battery
from gibson_sim.types import JointStates

# 2 A h at 10 V are 20 W h: 20 W last an hour.
PLAIN = BatterySpec(capacity_ah=2.0, voltage_full=10.0, voltage_empty=10.0, idle_w=20.0)
# The voltage falls from 12 to 8 V: 10 V in the mean, the same energy.
FALLING = BatterySpec(capacity_ah=2.0, voltage_full=12.0, voltage_empty=8.0, idle_w=20.0)


def joints(*work: tuple[float, float]) -> JointStates:
    efforts, velocities = (np.array([w[i] for w in work]) for i in (0, 1))
    return JointStates(tuple(f"j{i}" for i in range(len(work))), 0 * efforts, velocities, efforts)


@pytest.mark.parametrize("spec", [PLAIN, FALLING])
@pytest.mark.parametrize("steps", [1, 100])
def test_battery_is_empty_at_the_computed_time(spec: BatterySpec, steps: int) -> None:
    battery = Battery(spec)
    almost = [battery.drain(20.0, 3599.0 / steps, 0) for _ in range(steps)][-1]
    assert not almost.empty
    assert almost.percentage == pytest.approx(1 / 3600, rel=0.3)
    assert battery.drain(20.0, 1.0 + 1e-6, 0).empty


def test_half_of_a_plain_battery_is_left_after_half_the_time() -> None:
    reading = Battery(PLAIN).drain(20.0, 1800.0, 77)
    assert (reading.percentage, reading.charge_ah, reading.capacity_ah) == pytest.approx((0.5, 1.0, 2.0))
    assert (reading.voltage, reading.current, reading.stamp_ns) == pytest.approx((10.0, -2.0, 77))


def test_voltage_falls_evenly_with_the_charge() -> None:
    # From 100 % to 50 % the voltage is 11 V in the mean: 1 A h * 11 V = 11 W h.
    reading = Battery(FALLING).drain(11.0, 3600.0, 0)
    assert (reading.percentage, reading.voltage, reading.current) == pytest.approx((0.5, 10.0, -1.1))


def test_full_battery_is_full() -> None:
    reading = Battery(FALLING).drain(0.0, 1.0, 0)
    assert (reading.percentage, reading.voltage, reading.current, reading.low) == (1.0, 12.0, 0.0, False)


def test_empty_battery_gives_no_current_and_stays_empty() -> None:
    battery = Battery(FALLING)
    battery.drain(20.0, 7200.0, 0)
    reading = battery.drain(20.0, 10.0, 0)
    assert (reading.empty, reading.low, reading.percentage, reading.current, reading.voltage) == (True, True, 0.0, 0.0, 8.0)


def test_battery_is_low_below_the_warning_level() -> None:
    battery = Battery(PLAIN)
    assert not battery.drain(20.0, 2879.0, 0).low  # 20.03 %
    assert battery.drain(20.0, 2.0, 0).low  # 19.97 %


def test_start_charge_counts_and_comes_back_with_a_reset() -> None:
    battery = Battery(BatterySpec(capacity_ah=2.0, voltage_full=12.0, voltage_empty=8.0, start=0.25))
    assert battery.drain(0.0, 1.0, 0).percentage == pytest.approx(0.25)
    battery.drain(20.0, 100.0, 0)
    battery.reset()
    assert battery.drain(0.0, 1.0, 0).percentage == pytest.approx(0.25)


def test_robot_at_rest_takes_its_idle_power() -> None:
    assert Battery(PLAIN).power(joints((0.0, 0.0))) == 20.0
    assert Battery(PLAIN).power(joints()) == 20.0


def test_motors_take_their_work_over_their_efficiency_and_braking_gives_nothing_back() -> None:
    # 0.3 N m at 10 rad/s are 3 W; the other wheel brakes.
    battery = Battery(BatterySpec(idle_w=5.0, efficiency=0.6))
    assert battery.power(joints((0.3, 10.0), (0.3, -10.0))) == pytest.approx(5.0 + 3.0 / 0.6)
    assert battery.power(joints((-0.3, -10.0), (0.0, 10.0))) == pytest.approx(5.0 + 3.0 / 0.6)


def test_torque_at_rest_takes_power_too() -> None:
    assert Battery(BatterySpec(idle_w=5.0, torque_w=4.0)).power(joints((0.5, 0.0), (-0.25, 0.0))) == pytest.approx(8.0)
