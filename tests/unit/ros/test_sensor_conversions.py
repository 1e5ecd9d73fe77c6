"""Messages of IMUs, lidars of many channels, bumpers and batteries."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

from sensor_msgs.msg import BatteryState, PointField  # noqa: E402

from gibson_sim.ros.conversions.robot import scan_to_msg  # noqa: E402
from gibson_sim.ros.conversions.sensors import battery_to_msg, bumper_to_msgs, imu_to_msg, lidar_cloud_to_msg  # noqa: E402
from gibson_sim.sensors.battery import BatteryReading  # noqa: E402
from gibson_sim.sensors.bumper import BumperReading  # noqa: E402
from gibson_sim.sensors.imu import ImuReading  # noqa: E402
from gibson_sim.sensors.lidar import LidarCloud, Scan  # noqa: E402
from gibson_sim.types import Quat  # noqa: E402

pytestmark = pytest.mark.ros
STAMP_NS = 5_000_000_007


def imu(orientation: Quat | None) -> ImuReading:
    rates, forces = np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 9.0])
    return ImuReading("imu", STAMP_NS, "r/base", rates, forces, orientation, 0.25, 4.0)


def test_imu_keeps_its_values_stamp_and_frame() -> None:
    msg = imu_to_msg(imu((0.5, -0.5, 0.5, -0.5)), "base")
    assert (msg.header.stamp.sec, msg.header.stamp.nanosec, msg.header.frame_id) == (5, 7, "base")
    assert (msg.angular_velocity.x, msg.angular_velocity.y, msg.angular_velocity.z) == (0.1, 0.2, 0.3)
    assert (msg.linear_acceleration.x, msg.linear_acceleration.y, msg.linear_acceleration.z) == (1.0, 2.0, 9.0)
    assert (msg.orientation.x, msg.orientation.y, msg.orientation.z, msg.orientation.w) == (0.5, -0.5, 0.5, -0.5)


def test_imu_covariances_are_those_of_its_noise() -> None:
    msg = imu_to_msg(imu((0.0, 0.0, 0.0, 1.0)), "base")
    assert msg.angular_velocity_covariance.tolist() == [0.25, 0, 0, 0, 0.25, 0, 0, 0, 0.25]
    assert msg.linear_acceleration_covariance.tolist() == [4.0, 0, 0, 0, 4.0, 0, 0, 0, 4.0]
    assert 0.0 < msg.orientation_covariance[0] < 1e-6


def test_orientation_that_is_not_reported_has_minus_one_in_its_covariance() -> None:
    msg = imu_to_msg(imu(None), "base")
    assert msg.orientation_covariance.tolist() == [-1.0] + [0.0] * 8


def test_cloud_holds_points_intensity_and_ring_where_its_fields_say() -> None:
    points = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], dtype=np.float32)
    cloud = LidarCloud(
        "points", STAMP_NS, "r/lidar", points, np.array([0, 300], dtype=np.uint16), np.array([0.0, 7.0], dtype=np.float32)
    )
    msg = lidar_cloud_to_msg(cloud, "lidar")
    assert (msg.header.stamp.nanosec, msg.header.frame_id) == (7, "lidar")
    assert (msg.height, msg.width, msg.point_step, msg.row_step, msg.is_dense, msg.is_bigendian) == (1, 2, 18, 36, True, False)
    f4, u2 = PointField.FLOAT32, PointField.UINT16
    fields = [(f.name, f.offset, f.datatype, f.count) for f in msg.fields]
    assert fields == [("x", 0, f4, 1), ("y", 4, f4, 1), ("z", 8, f4, 1), ("intensity", 12, f4, 1), ("ring", 16, u2, 1)]
    assert struct.unpack("<ffffHffffH", bytes(msg.data)) == (1.0, 2.0, 3.0, 0.0, 0, 4.0, 5.0, 6.0, 7.0, 300)


def test_cloud_without_points_is_a_message_too() -> None:
    empty = np.zeros(0)
    cloud = LidarCloud("points", 0, "r/lidar", np.zeros((0, 3), np.float32), empty.astype(np.uint16), empty.astype(np.float32))
    msg = lidar_cloud_to_msg(cloud, "lidar")
    assert (msg.width, msg.row_step, len(msg.data), len(msg.fields)) == (0, 0, 0, 5)


def test_bumper_is_a_bool_and_a_wrench_with_stamp_and_frame() -> None:
    reading = BumperReading(
        "bumper", STAMP_NS, "r/base", True, ("base",), 5.0, np.array([-5.0, 1.0, 2.0]), np.array([0.1, 0.2, 0.3])
    )
    pressed, wrench = bumper_to_msgs(reading, "base")
    assert pressed.data is True
    assert (wrench.header.stamp.nanosec, wrench.header.frame_id) == (7, "base")
    force, torque = wrench.wrench.force, wrench.wrench.torque
    assert (force.x, force.y, force.z, torque.x, torque.y, torque.z) == (-5.0, 1.0, 2.0, 0.1, 0.2, 0.3)


def test_battery_in_use_is_discharging() -> None:
    msg = battery_to_msg(BatteryReading("battery_state", STAMP_NS, 0.5, 11.0, -2.0, 1.5, 3.0, False))
    assert (msg.voltage, msg.current, msg.charge, msg.capacity, msg.design_capacity, msg.percentage) == (
        11.0,
        -2.0,
        1.5,
        3.0,
        3.0,
        0.5,
    )
    assert msg.power_supply_status == BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    assert msg.present
    assert math.isnan(msg.temperature)
    assert msg.header.stamp.nanosec == 7


def test_empty_battery_gives_nothing_more() -> None:
    msg = battery_to_msg(BatteryReading("battery_state", STAMP_NS, 0.0, 9.0, 0.0, 0.0, 3.0, True))
    assert (msg.percentage, msg.current, msg.power_supply_status) == (0.0, 0.0, BatteryState.POWER_SUPPLY_STATUS_NOT_CHARGING)


@pytest.mark.parametrize(("beams", "fov"), [(360, 2 * math.pi), (271, math.radians(270)), (684, math.radians(240))])
def test_scan_message_has_as_many_ranges_as_its_angles_say(beams: int, fov: float) -> None:
    increment = fov / (beams if fov > 6.28 else beams - 1)
    msg = scan_to_msg(Scan(0, "r/lidar", -0.5, increment, 0.1, 12.0, np.ones(beams, dtype=np.float32)), "lidar", 0.1)
    first, last, step = (np.float32(v) for v in (msg.angle_min, msg.angle_max, msg.angle_increment))
    assert round(float((last - first) / step)) + 1 == len(msg.ranges)
