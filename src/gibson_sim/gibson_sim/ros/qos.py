"""Quality of service of every topic.

Sensor data is published reliable (REP 2003): a reliable reader never matches a best-effort writer, while a best-effort
reader matches both.
"""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _profile(depth: int, *, latched: bool = False) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


SENSOR = _profile(5)
"""Images, scans: few in flight, since each is large and a late one is worth little."""
STATE = _profile(10)
"""Odometry, joint states, diagnostics, scene state."""
TF = _profile(100)
CLOCK = _profile(10)
COMMAND = _profile(1)
LATCHED = _profile(1, latched=True)
"""Late joiners get the last message: scene, static transforms, robot description."""
