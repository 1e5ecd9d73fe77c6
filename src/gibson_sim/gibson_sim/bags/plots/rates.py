"""Tells which topics of a bag have a rate, and how many of their messages are missing. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.reader import TopicInfo
from gibson_sim.bags.stamps import nominal_period_ns
from gibson_sim.types import NS_PER_S

_LEAST = 5
"""Minimum number of messages for which a topic can have a rate."""
_REGULAR_SHARE = 0.8
"""Minimum share of intervals within half a period of one period, for a topic with a rate."""
_EVENT_TYPES = (
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "gibson_msgs/msg/Input",
    "gibson_msgs/msg/TickDone",
    "diagnostic_msgs/msg/DiagnosticArray",
    "rosgraph_msgs/msg/Clock",
)
"""Types sent when something happens, or by several nodes: no message of them is missing. /clock also comes with whatever else is published."""
_EVENT_PACKAGES = ("rcl_interfaces/", "action_msgs/", "lifecycle_msgs/", "trajectory_msgs/", "visualization_msgs/")
_FOREIGN_NS = 24 * 3600 * NS_PER_S
"""Minimum difference between stamps and log times for which they are of different clocks, ns."""


def is_event(info: TopicInfo) -> bool:
    """Returns whether the messages of a topic come when something happens, so that none can be missing."""
    return info.latched or info.type_name in _EVENT_TYPES or info.type_name.startswith(_EVENT_PACKAGES)


def is_of_this_clock(stamps: NDArray[np.int64], log_ns: NDArray[np.int64]) -> bool:
    """Returns whether stamps (N,) are of the same clock as the log times (N,): /rosout has wall time in a bag of simulation time."""
    return bool(len(stamps)) and abs(int(np.median(stamps)) - int(np.median(log_ns))) < _FOREIGN_NS


def period_of(times: NDArray[np.int64], *, periodic: bool = False) -> float:
    """Returns the period of a series of times (N,), nanoseconds; 0.0 if they have none.

    Args:
        times: of the messages.
        periodic: whether the topic is known to have a rate, however many messages are missing.
    """
    ordered = np.sort(times)
    period = nominal_period_ns(ordered)
    if periodic:
        return period
    if len(times) < _LEAST:
        return 0.0
    steps = np.diff(ordered)
    regular = np.count_nonzero(np.abs(steps - period) <= 0.6 * period)
    return period if period and regular >= _REGULAR_SHARE * len(steps) else 0.0


def missing_in(times: NDArray[np.int64], period_ns: float) -> int:
    """Returns how many messages are missing between the first and the last: a step is rounded to whole periods, two = one missing."""
    return int(np.maximum(np.rint(np.diff(times) / period_ns).astype(np.int64) - 1, 0).sum())
