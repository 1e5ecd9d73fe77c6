"""Finds pieces of free floor that only a gap in the scan separates."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim.maps.floor_map import FloorMap

Bools = NDArray[np.bool_]

REACH = 1.0
"""Distance to scanned floor within which unscanned cells may be floor, metres."""
_LEAST = 0.3
"""Least area of a reported piece, square metres."""


def islands(floor: FloorMap, radius: float) -> tuple[float, ...]:
    """Returns the areas, m^2, of the pieces of free floor that would be connected if the unscanned cells between them were floor.

    Args:
        floor: map of the floor.
        radius: of the robot, metres.

    Returns:
        The largest piece first, then the pieces that gaps separate from it; empty if there are none.
    """
    places = floor.inflate(radius)
    labels, count = ndimage.label(places)
    if count < 2:
        return ()
    areas = np.bincount(labels.ravel(), minlength=count + 1) * floor.resolution**2
    areas[0] = 0.0
    largest = int(areas.argmax())
    unknown = ~(floor.floor | floor.occupied)
    near = ndimage.distance_transform_edt(~floor.free) * floor.resolution <= REACH
    open_ = np.pad(floor.free | (unknown & near), 1, constant_values=False)
    clearance = ndimage.distance_transform_edt(open_)[1:-1, 1:-1] * floor.resolution
    joined, _ = ndimage.label(places | (clearance >= radius + floor.resolution * math.sqrt(0.5)))
    home = joined[labels == largest][0]
    cut_off = [k for k in range(1, count + 1) if k != largest and areas[k] >= _LEAST and (joined[labels == k] == home).any()]
    return tuple(float(areas[k]) for k in [largest, *sorted(cut_off, key=lambda k: -areas[k])]) if cut_off else ()
