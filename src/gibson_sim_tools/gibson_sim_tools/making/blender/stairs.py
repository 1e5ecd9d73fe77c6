"""Models stairs and the edges of the opening above them. NumPy only."""

from __future__ import annotations

import numpy as np

from gibson_sim_tools.making.blender.appearances import surface_of
from gibson_sim_tools.making.blender.shapes import ObjectBuilder, pose_matrix
from gibson_sim_tools.making.building import Stair


def stair(s: ObjectBuilder, flight: Stair, low: float, high: float) -> None:
    """Adds a closed flight of steps with handrails. ``low``, ``high``: heights of both floors, m."""
    rise, half = (high - low) / flight.steps, flight.width / 2
    wood, white = surface_of("wood_oak"), surface_of("wood_white")
    first, boxes = len(s.parts), len(s.boxes)
    for k in range(flight.steps - 1):
        x, z = k * flight.tread, (k + 1) * rise
        s.box((x, -half, 0), (x + flight.tread + 0.001, half, z - 0.035), white, 0, "-z +z +x")
        s.box((x - 0.02, -half, z - 0.035), (x + flight.tread, half, z), wood, 0.008, "-z +x")
        s.collide((x, -half, 0), (x + flight.tread, half, z))
    count = flight.steps - 1
    for side in (-1, 1):
        y = side * (half - 0.045)
        for k in range(0, count, 1):
            x, z = (k + 0.5) * flight.tread, (k + 1) * rise
            s.box((x - 0.01, y - 0.01, z), (x + 0.01, y + 0.01, z + 0.88), white, 0, "-z +z")
        ends = [(0.5 * flight.tread, y, rise + 0.9), ((count - 0.5) * flight.tread, y, count * rise + 0.9)]
        s.tube(ends, 0.024, wood, 10)
    matrix = pose_matrix((*flight.foot, low), flight.yaw)
    s.transform(first, matrix)
    for k in range(boxes, len(s.boxes)):
        corners = [matrix[:3, :3] @ c + matrix[:3, 3] for c in s.boxes[k]]
        s.boxes[k] = (np.minimum(*corners), np.maximum(*corners))


def slab_edges(s: ObjectBuilder, flight: Stair, low: float, high: float) -> None:
    """Adds the sides of the opening, from the ceiling below to the floor above."""
    points = np.asarray(flight.hole, dtype=float)
    for a, b in zip(points, np.roll(points, -1, axis=0), strict=True):
        s.quad([(*b, low), (*a, low), (*a, high), (*b, high)], surface_of("plaster_white"))
