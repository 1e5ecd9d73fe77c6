"""Converts measurements of IMUs, 3-D lidars, bumpers and batteries, and point clouds of depth cameras. Planar scans are in ``robot``."""

from __future__ import annotations

import math
from array import array

import numpy as np
from geometry_msgs.msg import WrenchStamped
from numpy.typing import NDArray
from sensor_msgs.msg import BatteryState, Imu, PointCloud2, PointField
from std_msgs.msg import Bool

from gibson_sim.ros.conversions.basics import header_to_msg, vector_to_msg
from gibson_sim.sensors.battery import BatteryReading
from gibson_sim.sensors.bumper import BumperReading
from gibson_sim.sensors.imu import LEAST_VARIANCE, ImuReading
from gibson_sim.sensors.lidar import LidarCloud

LIDAR_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2")])
"""Layout of a point of a lidar cloud: 18 bytes without padding."""
_FIELD_TYPES = {np.dtype("<f4"): PointField.FLOAT32, np.dtype("<u2"): PointField.UINT16}


def imu_to_msg(reading: ImuReading, frame_id: str) -> Imu:
    """Returns an IMU message by REP 145: the acceleration includes gravity, and the first covariance of an unreported quantity is -1."""
    msg = Imu(header=header_to_msg(reading.stamp_ns, frame_id))
    msg.angular_velocity = vector_to_msg(reading.angular_velocity)
    msg.linear_acceleration = vector_to_msg(reading.linear_acceleration)
    msg.angular_velocity_covariance = _isotropic(reading.angular_variance)
    msg.linear_acceleration_covariance = _isotropic(reading.linear_variance)
    if reading.orientation_xyzw is None:
        msg.orientation_covariance = np.array([-1.0] + [0.0] * 8)
        return msg
    q = msg.orientation
    q.x, q.y, q.z, q.w = reading.orientation_xyzw
    msg.orientation_covariance = _isotropic(LEAST_VARIANCE)
    return msg


def lidar_cloud_to_msg(cloud: LidarCloud, frame_id: str) -> PointCloud2:
    """Returns an unorganised cloud without invalid points: x, y, z (m), intensity, ring."""
    points = np.empty(len(cloud.points), dtype=LIDAR_POINT)
    for column, axis in enumerate("xyz"):
        points[axis] = cloud.points[:, column]
    points["intensity"], points["ring"] = cloud.intensity, cloud.ring
    msg = PointCloud2(header=header_to_msg(cloud.stamp_ns, frame_id))
    msg.height, msg.width = 1, len(points)
    msg.fields = [
        PointField(name=name, offset=offset, datatype=_FIELD_TYPES[kind], count=1)
        for name, (kind, offset, *_) in (LIDAR_POINT.fields or {}).items()
    ]
    msg.is_bigendian, msg.is_dense = False, True
    msg.point_step, msg.row_step = points.itemsize, points.nbytes
    msg.data = array("B", points.tobytes())
    return msg


def cloud_to_msg(cloud: NDArray[np.void], stamp_ns: int, frame_id: str) -> PointCloud2:
    """Returns an organised cloud.

    Args:
        cloud: structured array (H, W), C-contiguous, with four-byte fields; all are declared as float32, also ``rgb``, as PCL and RViz expect.
        stamp_ns: stamp of the depth image, ns.
        frame_id: frame of the points.
    """
    height, width = cloud.shape
    data = array("B")
    data.frombytes(np.ascontiguousarray(cloud).view(np.uint8).data)
    msg = PointCloud2(header=header_to_msg(stamp_ns, frame_id), height=height, width=width)
    msg.fields = [
        PointField(name=name, offset=int(field[1]), datatype=PointField.FLOAT32, count=1)
        for name, field in (cloud.dtype.fields or {}).items()
    ]
    msg.is_bigendian = False
    msg.point_step, msg.row_step = cloud.dtype.itemsize, cloud.dtype.itemsize * width
    msg.is_dense = False  # points without depth are NaN
    msg.data = data
    return msg


def bumper_to_msgs(reading: BumperReading, frame_id: str) -> tuple[Bool, WrenchStamped]:
    """Returns whether the bumper is pressed, and the total force (N) and torque (N m) in ``frame_id``, about its origin."""
    wrench = WrenchStamped(header=header_to_msg(reading.stamp_ns, frame_id))
    wrench.wrench.force = vector_to_msg(reading.force)
    wrench.wrench.torque = vector_to_msg(reading.torque)
    return Bool(data=reading.pressed), wrench


def battery_to_msg(reading: BatteryReading, frame_id: str = "") -> BatteryState:
    """Returns the state of a battery: discharging, or not charging if it is empty. Unmeasured quantities are NaN."""
    msg = BatteryState(header=header_to_msg(reading.stamp_ns, frame_id))
    msg.voltage, msg.current, msg.charge = reading.voltage, reading.current, reading.charge_ah
    msg.capacity = msg.design_capacity = reading.capacity_ah
    msg.percentage = reading.percentage
    msg.temperature = math.nan
    status = BatteryState.POWER_SUPPLY_STATUS_NOT_CHARGING if reading.empty else BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    msg.power_supply_status = status
    msg.power_supply_health = BatteryState.POWER_SUPPLY_HEALTH_GOOD
    msg.power_supply_technology = BatteryState.POWER_SUPPLY_TECHNOLOGY_LION
    msg.present = True
    return msg


def _isotropic(variance: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance])
