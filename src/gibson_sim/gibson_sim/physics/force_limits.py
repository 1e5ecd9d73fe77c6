"""Keeps a force within its limit in every direction, where the engine limits each of three axes alone and all alike. Pure.

The forces that the engine may choose from are a cube about zero, which fits into the sphere of the limit only where it bears 58 % of it
along an axis. So while something pulls hard, a part of the force is given in advance, as it was in the last step, and the cube, now
smaller, stands about that part: it always lies within the sphere, and reaches as far as the pull does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from gibson_sim.types import Vec3

_MOST = 1.04
"""Part of the limit that no force ever exceeds: the corners of the cube, and a little for the solver's rounding below 5 %."""
_STEADY = 0.97
"""Part of the limit that a pull in any direction bears; less and the cube would be larger, and what is given in advance less."""
_GROWTH = 0.05
"""Part of the limit by which an axis may bear more in the next step than in the last one."""


def reach_of(limit: float, borne: Sequence[float]) -> Vec3:
    """Returns how far each axis may be pulled in the next step, N or N m, not negative.

    Args:
        limit: Of the whole, N or N m.
        borne: What the axes bore in the last step.
    """
    x, y, z = (abs(force) for force in borne)
    most = _STEADY * limit
    # The same growth for all three, as far as their sum stays within: (x + growth)^2 + (y + growth)^2 + (z + growth)^2 = most^2.
    total, left = x + y + z, most**2 - x * x - y * y - z * z
    if left < 0.0:
        part = most / math.hypot(x, y, z)
        return part * x, part * y, part * z
    growth = min(_GROWTH * limit, (math.sqrt(total**2 + 3.0 * left) - total) / 3.0)
    return x + growth, y + growth, z + growth


def cube_of(limit: float, reach: Vec3) -> float:
    """Returns half the edge of the largest cube that can stand anywhere within the limit and reach so far, N or N m."""
    left, half = (_MOST * limit) ** 2, 0.0
    for count, axis in zip((3, 2, 1), sorted(reach, reverse=True), strict=True):
        half = math.sqrt(left / count)
        if half >= axis:
            break
        left -= axis**2
    return half


def given_in_advance(borne: Sequence[float], reach: Vec3, half: float) -> Vec3:
    """Returns the middle of the cube, N or N m: 0 along axes along which it reaches far enough about zero."""
    x, y, z = (math.copysign(max(0.0, far - half), force) for far, force in zip(reach, borne, strict=True))
    return x, y, z
