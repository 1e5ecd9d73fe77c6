"""Reads stamps from CDR bytes and determines the period of a series of stamps. Independent of the libraries that read bags."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import RecordError
from gibson_sim.types import NS_PER_S

_STAMP_BYTES = 8


def stamp_ns(data: bytes, at: int = 4) -> int:
    """Returns the stamp in a message's CDR bytes, nanoseconds.

    Args:
        data: the message.
        at: offset of the stamp; 4 if the type begins with a Header or a Time.

    Raises:
        RecordError: the message is shorter than its stamp requires.
    """
    if len(data) < at + _STAMP_BYTES:
        raise RecordError(
            f"a message of {len(data)} bytes ends before its stamp, which needs {at + _STAMP_BYTES}: "
            "it is damaged, or not of the type that the bag gives its topic"
        )
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, at)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def time_from_msg(msg: Any) -> int:
    """Returns the time in a ``builtin_interfaces/Time``, nanoseconds; of rclpy or as decoded from a bag."""
    return int(msg.sec) * NS_PER_S + int(msg.nanosec)


def nominal_period_ns(stamps: NDArray[np.int64]) -> float:
    """Returns the period of increasing stamps (N,), nanoseconds, robust against gaps; 0.0 for fewer than two stamps."""
    steps = np.diff(stamps)
    steps = steps[steps > 0]
    if not len(steps):
        return 0.0
    # Ticks quantise the stamps (33, 33, 50 ms), so the median is not the period; a lost frame doubles a step.
    return float(steps[steps <= 1.6 * np.median(steps)].mean())
