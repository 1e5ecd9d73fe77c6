"""Finds pieces of free floor that are separated only by a gap in the scan."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim.maps.floor_map import FloorMap

Bools = NDArray[np.bool_]

REACH = 1.0
"""Distance to scanned floor within which unscanned cells may be floor, m."""
_MIN_AREA = 0.3
"""Minimum area of a reported piece, m^2."""


def islands(floor: FloorMap, radius: float) -> tuple[float, ...]:
    """Returns the areas, m^2, of the pieces of free floor that would be connected if the unscanned cells between them were floor.

    Args:
        floor: map of the floor.
        radius: radius of the robot, metres.

    Returns:
        The largest piece first, then the pieces that gaps separate from it; empty without such pieces.
    """
    free_cells = floor.inflate(radius)
    labels, count = ndimage.label(free_cells)
    if count < 2:
        return ()
    areas = np.bincount(labels.ravel(), minlength=count + 1) * floor.resolution**2
    areas[0] = 0.0
    largest = int(areas.argmax())
    unknown = ~(floor.floor | floor.occupied)
    is_near_scan = ndimage.distance_transform_edt(~floor.free) * floor.resolution <= REACH
    passable = np.pad(floor.free | (unknown & is_near_scan), 1, constant_values=False)
    clearance = ndimage.distance_transform_edt(passable)[1:-1, 1:-1] * floor.resolution
    joined_labels, _ = ndimage.label(free_cells | (clearance >= radius + floor.resolution * math.sqrt(0.5)))
    main_label = joined_labels[labels == largest][0]
    cut_off = [
        k
        for k in range(1, count + 1)
        if k != largest and areas[k] >= _MIN_AREA and (joined_labels[labels == k] == main_label).any()
    ]
    return tuple(float(areas[k]) for k in [largest, *sorted(cut_off, key=lambda k: -areas[k])]) if cut_off else ()
