"""Units of the fields of common messages, from REP 103 and the comments in their definitions."""

from __future__ import annotations

_METRES = dict.fromkeys(("x", "y", "z"), "m")
_UNITS: dict[str, dict[str, str]] = {
    "builtin_interfaces/Time": {"sec": "s", "nanosec": "ns"},
    "builtin_interfaces/Duration": {"sec": "s", "nanosec": "ns"},
    "geometry_msgs/Accel": {"linear": "m/s²", "angular": "rad/s²"},
    "geometry_msgs/Point": _METRES,
    "geometry_msgs/Point32": _METRES,
    "geometry_msgs/Pose2D": {"x": "m", "y": "m", "theta": "rad"},
    "geometry_msgs/Transform": {"translation": "m"},
    "geometry_msgs/Twist": {"linear": "m/s", "angular": "rad/s"},
    "geometry_msgs/Wrench": {"force": "N", "torque": "N m"},
    "gibson_msgs/Contact": {"force": "N", "distance": "m"},
    "sensor_msgs/BatteryState": {
        "voltage": "V", "current": "A", "charge": "A h", "capacity": "A h", "design_capacity": "A h", "temperature": "°C",
        "cell_voltage": "V", "cell_temperature": "°C",
    },
    "sensor_msgs/FluidPressure": {"fluid_pressure": "Pa"},
    "sensor_msgs/Illuminance": {"illuminance": "lx"},
    "sensor_msgs/Imu": {"linear_acceleration": "m/s²", "angular_velocity": "rad/s"},
    "sensor_msgs/JointState": {"position": "rad or m", "velocity": "rad/s or m/s", "effort": "N m or N"},
    "sensor_msgs/LaserScan": {
        "ranges": "m", "range_min": "m", "range_max": "m", "angle_min": "rad", "angle_max": "rad", "angle_increment": "rad",
        "scan_time": "s", "time_increment": "s",
    },
    "sensor_msgs/MagneticField": {"magnetic_field": "T"},
    "sensor_msgs/NavSatFix": {"latitude": "°", "longitude": "°", "altitude": "m"},
    "sensor_msgs/Range": {"range": "m", "min_range": "m", "max_range": "m", "field_of_view": "rad"},
    "sensor_msgs/Temperature": {"temperature": "°C"},
    "trajectory_msgs/JointTrajectoryPoint": {
        "positions": "rad or m", "velocities": "rad/s or m/s", "accelerations": "rad/s² or m/s²", "effort": "N m or N",
    },
}  # fmt: skip
"""Message type -> field -> unit. The unit of a field that holds a message, such as ``Twist.linear``, applies to the numbers in it."""


def unit_of(type_name: str, field: str, outer: str) -> str:
    """Returns the unit of a field; empty = unknown or none.

    Args:
        type_name: type of the message with the field, such as ``geometry_msgs/Twist``.
        field: name of the field.
        outer: unit of the field that holds the message; empty = none.
    """
    return _UNITS.get(type_name, {}).get(field, outer)
