"""Reads the sections of a ``robot.yaml`` that describe sensors other than cameras."""

from __future__ import annotations

import math
from typing import Any

from gibson_sim.description.rigid_groups import rigid_groups
from gibson_sim.description.urdf import UrdfModel
from gibson_sim.errors import RobotError
from gibson_sim.formats.yaml_map import YamlMap
from gibson_sim.quoting import quoted
from gibson_sim.robots.sensor_specs import (
    TURN,
    BatterySpec,
    BumperSpec,
    ImuSpec,
    Lidar3DSpec,
    LidarSpec,
    SensorSpecs,
    WheelOdometrySpec,
)

SENSOR_KEYS = ("lidar", "lidar_3d", "imu", "bumper", "battery", "wheel_odometry")
"""Keys of a ``robot.yaml`` that this module reads."""

_RANGING = (
    "range_min", "range_max", "rate_hz", "range_noise", "range_noise_ratio", "range_scale", "resolution", "dropout",
)  # fmt: skip
_IMU = ("rate_hz", "gyro_noise", "accel_noise", "gyro_bias", "accel_bias", "gyro_bias_walk", "accel_bias_walk")
_BATTERY = (
    "capacity_ah", "voltage_full", "voltage_empty", "idle_w", "efficiency", "torque_w", "start", "warn_below", "rate_hz",
)  # fmt: skip
_WHEELS = ("left_radius_factor", "right_radius_factor", "separation_factor", "alpha1", "alpha2", "alpha3", "alpha4")

_OF_WHEELS = ("encoder_ticks", "left_radius_factor", "right_radius_factor")
"""Keys of ``wheel_odometry`` that need wheels."""


def read_sensors(robot: YamlMap, model: UrdfModel, name: str) -> SensorSpecs:
    """Returns the sensors of the robot ``name``.

    Raises:
        RobotError: a key, a link or the type of a value is invalid.
        ConfigError: a value is out of range.
    """
    battery, wheels = robot.section("battery"), robot.section("wheel_odometry")
    drive = robot.section("drive")
    of_wheels = [key for key in _OF_WHEELS if wheels is not None and key in wheels.values]
    if of_wheels and drive is not None and drive.values.get("type") == "planar":
        raise RobotError(
            f"{robot.where}: wheel_odometry: {of_wheels[0]} is of wheels, which a drive of type planar has not; remove it"
        )
    return SensorSpecs(
        lidars=tuple(_lidar(section, model, name) for section in _sections(robot, "lidar")),
        lidars_3d=tuple(_lidar_3d(section, model, name) for section in _sections(robot, "lidar_3d")),
        imus=tuple(_imu(section, model, name) for section in _sections(robot, "imu")),
        bumpers=tuple(_bumper(section, model, name) for section in _sections(robot, "bumper")),
        battery=None if battery is None else BatterySpec(**_values(battery, _BATTERY, texts=("name",))),
        wheel_odometry=WheelOdometrySpec(**({} if wheels is None else _values(wheels, _WHEELS, ("encoder_ticks", "seed")))),
    )


def _sections(robot: YamlMap, key: str) -> list[YamlMap]:
    """Returns the mapping under ``key``, or the mappings in the list under it."""
    value = robot.values.get(key)
    if isinstance(value, list):
        return [robot.within(item, f"{key}[{i}]") for i, item in enumerate(value)]
    section = robot.section(key)
    return [] if section is None else [section]


def _lidar(settings: YamlMap, model: UrdfModel, name: str) -> LidarSpec:
    values = _values(settings, _RANGING, ("beams", "seed"), ("angle_min_deg", "fov_deg"), ("name", "link"))
    # By default, a field of view of less than a revolution is centred on the x axis.
    if "fov" in values and values["fov"] < TURN - 1e-9:
        values.setdefault("angle_min", -values["fov"] / 2)
    return LidarSpec(link=_link(settings, model, name), **values)


def _lidar_3d(settings: YamlMap, model: UrdfModel, name: str) -> Lidar3DSpec:
    whole, angles = ("channels", "samples", "seed"), ("elevation_min_deg", "elevation_max_deg")
    return Lidar3DSpec(link=_link(settings, model, name), **_values(settings, _RANGING, whole, angles, ("name", "link")))


def _imu(settings: YamlMap, model: UrdfModel, name: str) -> ImuSpec:
    values = _values(settings, _IMU, ("seed",), texts=("name", "link"), other=("orientation",))
    orientation = settings.values.get("orientation", True)
    if not isinstance(orientation, bool):
        raise RobotError(f"{settings.where}: orientation is {quoted(orientation)}, must be true or false")
    return ImuSpec(link=_link(settings, model, name), orientation=orientation, **values)


def _bumper(settings: YamlMap, model: UrdfModel, name: str) -> BumperSpec:
    values = _values(settings, ("threshold", "rate_hz"), (), ("max_slope_deg",), ("name", "link"), ("links",))
    links = settings.values.get("links", [])
    if not isinstance(links, list) or not all(isinstance(link, str) for link in links):
        raise RobotError(f"{settings.where}: links is {quoted(links)}, must be a list of names of links")
    # Contacts are reported for the rigid group, not for a link in it.
    first = {member: group.name for group in rigid_groups(model)[0] for member in group.members}
    sensitive = tuple(dict.fromkeys(first[model.link(link).name] for link in links))
    link = model.root if "link" not in settings.values else model.link(settings.text("link")).name
    return BumperSpec(link=f"{name}/{link}", links=sensitive, **values)


def _link(settings: YamlMap, model: UrdfModel, name: str) -> str:
    return f"{name}/{model.link(settings.text('link')).name}"


def _values(
    settings: YamlMap,
    numbers: tuple[str, ...],
    integers: tuple[str, ...] = (),
    degrees: tuple[str, ...] = (),
    texts: tuple[str, ...] = (),
    other: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Returns field name -> value of a specification for the keys in the file; unknown keys are errors.

    Keys that end in ``_deg`` are converted to radians, without the suffix. The caller reads ``link`` and ``other``, which are not in the result.
    """
    settings.check_keys((*texts, *other, *numbers, *integers, *degrees))
    values: dict[str, Any] = {**settings.numbers(numbers), **settings.integers(integers)}
    values.update({key.removesuffix("_deg"): math.radians(angle) for key, angle in settings.numbers(degrees).items()})
    if "name" in settings.values:
        values["name"] = settings.text("name")
    return values
