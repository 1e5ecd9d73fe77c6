"""Sensors in a robot.yaml."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.errors import ConfigError, RobotError
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.sensor_specs import (
    BatterySpec,
    BumperSpec,
    ImuSpec,
    Lidar3DSpec,
    LidarSpec,
    SensorSpecs,
    WheelOdometrySpec,
)

URDF = """<robot name="r"><link name="base"/><link name="plate"/><link name="eye"/><link name="arm"/>
<joint name="jp" type="fixed"><parent link="base"/><child link="plate"/></joint>
<joint name="je" type="fixed"><parent link="base"/><child link="eye"/></joint>
<joint name="ja" type="continuous"><parent link="base"/><child link="arm"/></joint></robot>"""
Load = Callable[[str], SensorSpecs]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def _load(text: str) -> SensorSpecs:
        (tmp_path / "r.urdf").write_text(URDF)
        (tmp_path / "robot.yaml").write_text("urdf: r.urdf\nradius: 0.2\nheight: 0.3\n" + text)
        return load_robot(tmp_path, name="bob").sensors

    return _load


def test_robot_without_sensors_has_none(load: Load) -> None:
    assert load("") == SensorSpecs()


def test_defaults_are_those_of_the_specs(load: Load) -> None:
    got = load("lidar: {link: eye}\nlidar_3d: {link: eye}\nimu: {link: plate}\nbumper: {}\nbattery: {}\nwheel_odometry: {}\n")
    assert got == SensorSpecs(
        (LidarSpec("bob/eye"),), (Lidar3DSpec("bob/eye"),), (ImuSpec("bob/plate"),), (BumperSpec("bob/base"),), BatterySpec()
    )


def test_every_key_arrives(load: Load) -> None:
    got = load(
        "lidar: {name: front/scan, link: eye, beams: 91, angle_min_deg: 30, fov_deg: 90, range_min: 0.2, range_max: 8, rate_hz: 5,"
        " range_noise: 0.01, range_noise_ratio: 0.02, range_scale: 0.03, resolution: 0.002, dropout: 0.1, seed: 3}\n"
        "lidar_3d: {name: velodyne, link: eye, channels: 32, samples: 1800, elevation_min_deg: -30, elevation_max_deg: 10, range_min: 1,"
        " range_max: 80, rate_hz: 20, range_noise: 0.03, range_noise_ratio: 0.04, range_scale: 0.05, resolution: 0.004, dropout: 0.2, seed: 4}\n"
        "imu: {name: imu/data_raw, link: plate, rate_hz: 200, gyro_noise: 1, accel_noise: 2, gyro_bias: 3, accel_bias: 4,"
        " gyro_bias_walk: 5, accel_bias_walk: 6, orientation: false, seed: 5}\n"
        "bumper: {name: hit, link: plate, links: [arm], threshold: 7, max_slope_deg: 30, rate_hz: 50}\n"
        "battery: {name: cell, capacity_ah: 1, voltage_full: 4.2, voltage_empty: 3, idle_w: 2, efficiency: 0.5, torque_w: 3, start: 0.5,"
        " warn_below: 0.1, rate_hz: 2}\n"
        "wheel_odometry: {encoder_ticks: 100, left_radius_factor: 1.1, right_radius_factor: 0.9, separation_factor: 1.2, alpha1: 0.1,"
        " alpha2: 0.2, alpha3: 0.3, alpha4: 0.4, seed: 6}\n"
    )
    rad = math.radians
    assert got.lidars == (
        LidarSpec("bob/eye", 91, 0.2, 8.0, 5.0, "front/scan", rad(30), rad(90), 0.01, 0.002, 0.1, 3, 0.02, 0.03),
    )
    assert got.lidars_3d == (
        Lidar3DSpec("bob/eye", "velodyne", 32, 1800, rad(-30), rad(10), 1.0, 80.0, 20.0, 0.03, 0.004, 0.2, 4, 0.04, 0.05),
    )
    assert got.imus == (ImuSpec("bob/plate", "imu/data_raw", 200.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, False, 5),)
    assert got.bumpers == (BumperSpec("bob/plate", ("arm",), "hit", 7.0, rad(30), 50.0),)
    assert got.battery == BatterySpec("cell", 1.0, 4.2, 3.0, 2.0, 0.5, 3.0, 0.5, 0.1, 2.0)
    assert got.wheel_odometry == WheelOdometrySpec(100, 1.1, 0.9, 1.2, 0.1, 0.2, 0.3, 0.4, 6)


def test_list_gives_several_of_a_kind(load: Load) -> None:
    assert load("lidar: [{link: eye}, {link: plate, name: rear}]\n").names == ("scan", "rear")


def test_less_than_a_turn_looks_ahead(load: Load) -> None:
    assert load("lidar: {link: eye, fov_deg: 180}\n").lidars[0].angle_min == pytest.approx(-math.pi / 2)


def test_full_turn_begins_ahead(load: Load) -> None:
    assert load("lidar: {link: eye, fov_deg: 360}\n").lidars[0].angle_min == 0.0


def test_bumper_feels_with_the_rigid_body_that_its_links_belong_to(load: Load) -> None:
    assert load("bumper: {links: [plate, eye, arm]}\n").bumpers[0].links == ("base", "arm")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("lidar: {link: eye, beam: 3}\n", "lidar: key 'beam' is unknown; did you mean 'beams'"),
        ("lidar: {beams: 3}\n", "lidar: link is missing"),
        ("lidar: [{link: eye}, {link: gone}]\n", "gone"),
        ("lidar: [{link: eye}, {link: eye}]\n", "scan is the name of more than one"),
        ("imu: {link: eye, name: scan}\nlidar: {link: eye}\n", "scan is the name of more than one"),
        ("lidar: {link: eye, name: /scan}\n", "the name is a topic"),
        ("imu: {link: eye, orientation: 1}\n", "orientation is 1, must be true or false"),
        ("bumper: {links: base}\n", "links is 'base', must be a list"),
        ("bumper: {links: [gone]}\n", "gone"),
        ("battery: {link: eye}\n", "battery: key 'link' is unknown"),
        ("wheel_odometry: {encoder_ticks: 1.5}\n", "encoder_ticks is 1.5, must be a whole number"),
        ("lidars: {link: eye}\n", "key 'lidars' is unknown; did you mean 'lidar'"),
    ],
)
def test_mistake_is_named(load: Load, text: str, match: str) -> None:
    with pytest.raises(RobotError, match=match):
        load(text)


@pytest.mark.parametrize(
    ("kind", "values", "match"),
    [
        (LidarSpec, {"beams": 0}, "beams is 0, must be 1 to"),
        (LidarSpec, {"fov": 90.0}, "fov is 90 rad.*degrees"),
        (LidarSpec, {"fov": 0.0}, "fov is 0 rad"),
        (LidarSpec, {"fov": 1.0, "beams": 1}, "2 or more"),
        (LidarSpec, {"angle_min": -90.0}, "angle_min is -90 rad.*degrees"),
        (LidarSpec, {"range_min": 3.0, "range_max": 2.0}, "range_min is 3 and range_max 2"),
        (LidarSpec, {"range_max": math.inf}, "finite"),
        (LidarSpec, {"range_noise": -0.1}, "range_noise is -0.1"),
        (LidarSpec, {"range_noise_ratio": 1.0}, "range_noise_ratio is 1, must be 0 to 0.2.*percentage"),
        (Lidar3DSpec, {"range_scale": -0.1}, "range_scale is -0.1, must be 0 to 0.2"),
        (LidarSpec, {"resolution": math.nan}, "resolution is nan"),
        (LidarSpec, {"dropout": 1.1}, "dropout is 1.1, must be 0 to 1"),
        (LidarSpec, {"rate_hz": 0.0}, "rate_hz is 0"),
        (LidarSpec, {"rate_hz": 1e-300}, "rate_hz is 1e-300"),
        (LidarSpec, {"seed": -1}, "seed is -1"),
        (Lidar3DSpec, {"channels": 0}, "channels is 0"),
        (Lidar3DSpec, {"channels": 10_000, "samples": 1000}, "at most 1000000 rays"),
        (Lidar3DSpec, {"elevation_min": -15.0}, "elevation_min is -15.*degrees"),
        (Lidar3DSpec, {"elevation_min": 0.2, "elevation_max": 0.1}, "elevation_min <= elevation_max"),
        (ImuSpec, {"gyro_noise": -1.0}, "gyro_noise is -1"),
        (ImuSpec, {"accel_bias_walk": math.inf}, "accel_bias_walk is inf"),
        (BumperSpec, {"threshold": 0.0}, "threshold is 0 N"),
        (BumperSpec, {"max_slope": 45.0}, "max_slope is 45 rad.*degrees"),
    ],
)
def test_impossible_value_is_refused(kind: type, values: dict[str, Any], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        kind("bob/eye", **values)


@pytest.mark.parametrize(
    ("kind", "values", "match"),
    [
        (BatterySpec, {"capacity_ah": 0.0}, "capacity_ah is 0"),
        (BatterySpec, {"voltage_empty": 13.0}, "voltage_empty is 13 and voltage_full 12.6"),
        (BatterySpec, {"efficiency": 0.0}, "efficiency is 0"),
        (BatterySpec, {"idle_w": -1.0}, "idle_w is -1"),
        (BatterySpec, {"start": 1.5}, "start is 1.5, must be 0 to 1"),
        (WheelOdometrySpec, {"encoder_ticks": -1}, "encoder_ticks is -1"),
        (WheelOdometrySpec, {"separation_factor": 0.0}, "separation_factor is 0, must be 0.5 to 2"),
        (WheelOdometrySpec, {"alpha3": -0.1}, "alpha3 is -0.1"),
    ],
)
def test_impossible_value_of_the_base_is_refused(kind: type, values: dict[str, Any], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        kind(**values)


def noises(spec: Any) -> dict[str, float]:
    """Returns the settings of optional errors, by name."""
    off = ("noise", "scale", "resolution", "dropout", "bias", "walk", "ticks", "alpha")
    return {f.name: getattr(spec, f.name) for f in fields(spec) if any(word in f.name for word in off)}


def test_gibson_bot_measures_exactly(root: Path) -> None:
    sensors = load_robot(root / "config/robots/gibson_bot").sensors
    assert sensors.names == ("scan", "imu", "bumper", "battery_state")
    assert sensors.wheel_odometry == WheelOdometrySpec()
    assert {value for spec in (*sensors.lidars, *sensors.imus) for value in noises(spec).values()} == {0.0}
    assert sensors.lidars[0].beams == 360
    assert (sensors.lidars[0].angle_min, sensors.lidars[0].is_full_turn) == (0.0, True)


def test_gibson_bot_real_is_gibson_bot_with_every_error(root: Path) -> None:
    exact, real = (load_robot(root / "config/robots" / name) for name in ("gibson_bot", "gibson_bot_real"))
    assert real.urdf.samefile(exact.urdf)
    assert real.drive == exact.drive
    assert real.sensors.names == exact.sensors.names
    errors = [noises(spec) for spec in (*real.sensors.lidars, *real.sensors.imus, real.sensors.wheel_odometry)]
    assert all(value > 0.0 for each in errors for value in each.values()), errors
