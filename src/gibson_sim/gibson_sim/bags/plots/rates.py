"""Determines which topics of a bag are periodic, and the number of their missing messages."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.images.decode import base_topic
from gibson_sim.bags.reader import BagReader, TopicInfo
from gibson_sim.bags.rerender import SCENE_TYPE, STATE_TYPE, state_period_ns
from gibson_sim.bags.stamps import nominal_period_ns
from gibson_sim.sensors.schedule import images_due
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
"""Types sent on events, or by several nodes: none of their messages count as missing. /clock also comes with whatever else is published."""
_EVENT_PACKAGES = ("rcl_interfaces/", "action_msgs/", "lifecycle_msgs/", "trajectory_msgs/", "visualization_msgs/")
_FOREIGN_NS = 24 * 3600 * NS_PER_S
"""Minimum difference between stamps and log times for which they are of different clocks, ns."""
_LEAST_RATE = 1e-3
"""Smallest rate of a sensor, Hz."""
_CAMERA_TOPICS = ("/image_raw", "/camera_info", "/points")
"""Endings of the topics that have a message for each image of a camera."""


def is_event(info: TopicInfo) -> bool:
    """Returns whether the messages of a topic are sent on events, so that none can be missing."""
    return info.latched or info.type_name in _EVENT_TYPES or info.type_name.startswith(_EVENT_PACKAGES)


def is_of_this_clock(stamps: NDArray[np.int64], log_ns: NDArray[np.int64]) -> bool:
    """Returns whether stamps (N,) and log times (N,) use the same clock: /rosout has wall time in a bag of simulation time."""
    return bool(len(stamps)) and abs(int(np.median(stamps)) - int(np.median(log_ns))) < _FOREIGN_NS


def period_of(times: NDArray[np.int64], *, periodic: bool = False) -> float:
    """Returns the period of a series of times (N,), nanoseconds; 0.0 if it is not periodic.

    Args:
        times: times of the messages, nanoseconds.
        periodic: whether the topic is known to be periodic, regardless of missing messages.
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
    """Returns the number of messages missing between the first and the last: a gap of two periods, rounded, = one missing."""
    return int(np.maximum(np.rint(np.diff(times) / period_ns).astype(np.int64) - 1, 0).sum())


def missing_at(times: NDArray[np.int64], rate_hz: float) -> int:
    """Returns the number of messages missing between the first and the last of a camera with a known rate."""
    first, last = int(times.min()), int(times.max())
    return max(0, images_due(first, last, rate_hz) + 1 - len(np.unique(times)))


def camera_rates(bag: BagReader) -> dict[str, float]:
    """Returns prefix of topics, ``/camera/`` for example -> rate, Hz, of each camera of the newest recorded scene.

    Cameras with a higher rate than the recorded states are left out: they are rendered at each state.

    Raises:
        RecordError: the scene cannot be decoded.
    """
    of_type = {info.type_name: name for name, info in bag.topics().items() if info.count}
    if SCENE_TYPE not in of_type or STATE_TYPE not in of_type:
        return {}
    newest = deque(bag.raw_messages([of_type[SCENE_TYPE]]), maxlen=1)
    period_ns = state_period_ns(bag, of_type[STATE_TYPE])
    if not newest or not period_ns:
        return {}
    prefix, highest = of_type[SCENE_TYPE].rpartition("/")[0], 1.01 * NS_PER_S / period_ns
    cameras = getattr(bag.decode(SCENE_TYPE, newest[0][2]), "cameras", ())
    rates = {
        f"{prefix}/{getattr(camera, 'name', '')}/": getattr(camera, "rate", None) for camera in cameras
    }  # the bag defines the type
    return {topics: rate for topics, rate in rates.items() if isinstance(rate, float) and _LEAST_RATE <= rate <= highest}


def camera_rate_of(topic: str, rates: Mapping[str, float]) -> float:
    """Returns the rate of the camera whose images the messages of a topic belong to, Hz; 0.0 if it is unknown."""
    if not base_topic(topic).endswith(_CAMERA_TOPICS):
        return 0.0
    prefixes = [prefix for prefix in rates if topic.startswith(prefix)]
    return rates[max(prefixes, key=len)] if prefixes else 0.0
