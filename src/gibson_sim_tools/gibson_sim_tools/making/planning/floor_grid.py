"""Rasterises the floor of a storey to an occupancy grid, and finds the regions in which a disc can move."""

from __future__ import annotations

import math
from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.making.building import Building, Point
from gibson_sim_tools.making.catalogue import CATALOGUE
from gibson_sim_tools.making.planning.objects import body_box, is_door, leaf_corners
from gibson_sim_tools.making.planning.rectangles import Rect, bounding_rect, rotated_bounds
from gibson_sim_tools.making.planning.rooms import RoomView

_CELL_SIZE = 0.025
"""Cell size, m."""
_HEAD_HEIGHT = 2.0
"""Height from which furniture is not an obstacle, m."""


class FloorGrid:
    """Free floor of one storey, doorways included.

    Args:
        building: the plan.
        number: index of the storey.
        views: views of its rooms, by name.
        with_bodies: whether door leaves and loose objects on the floor are obstacles.
    """

    def __init__(self, building: Building, number: int, views: dict[str, RoomView], *, with_bodies: bool) -> None:
        bounds = bounding_rect(c for view in views.values() for c in view.room.corners).grown(0.5)
        self._x0, self._y0 = bounds.x0, bounds.y0
        self.free = np.zeros((math.ceil(bounds.depth / _CELL_SIZE), math.ceil(bounds.width / _CELL_SIZE)), np.uint8)
        for view in views.values():
            for cell in view.cells:
                self._paint(cell, 1)
            for gate in view.gates:
                if gate.other_room:
                    thickness, opening = gate.face.wall.thickness, gate.opening
                    self._paint(
                        gate.face.rect(
                            opening.middle - opening.width / 2, opening.middle + opening.width / 2, -thickness - 0.02, 0.02
                        ),
                        1,
                    )
        floor_z = building.storeys[number].floor_z
        ceiling = floor_z + building.storeys[number].height
        for piece in building.pieces:
            if piece.storey == number and CATALOGUE[piece.kind].stands != "lies" and piece.position[2] - floor_z < _HEAD_HEIGHT:
                self._paint(rotated_bounds((piece.position[0], piece.position[1]), piece.yaw, piece.size[0], piece.size[1]), 0)
        for body in building.bodies if with_bodies else ():
            if not floor_z - 0.01 < body.position[2] < ceiling:
                continue
            if is_door(body):
                corners = np.array([self._cell_coordinates(p) for p in leaf_corners(body)])
                cv2.fillConvexPoly(self.free, np.round(corners).astype(np.int32), 0)
            elif body.position[2] - floor_z < 0.01:
                self._paint(body_box(body).rect, 0)

    def regions(self, radius: float) -> NDArray[np.int32]:
        """Labels the connected regions in which the centre of a disc can move, (rows, columns); 0 = the disc does not fit. ``radius``: m."""
        distances = cv2.distanceTransform(self.free, cv2.DIST_L2, 5) * _CELL_SIZE - _CELL_SIZE / 2
        _, labels = cv2.connectedComponents((distances >= radius).astype(np.uint8), connectivity=4)
        return np.asarray(labels, np.int32)

    def most_open(self, cells: Iterable[Rect], radius: float) -> Point | None:
        """Returns the point in ``cells`` and in the largest region with the largest clearance; None without such a point."""
        distances = cv2.distanceTransform(self.free, cv2.DIST_L2, 5) * _CELL_SIZE - _CELL_SIZE / 2
        regions = self.regions(radius)
        largest = int(np.argmax(np.bincount(regions[regions > 0]))) if regions.any() else 0
        is_candidate = np.zeros_like(self.free)
        for cell in cells:
            is_candidate[self._slices(cell)] = 1
        score = np.where((is_candidate == 1) & (regions == largest), distances, 0.0) if largest else np.zeros_like(distances)
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        if score[row, column] < radius:
            return None
        return (self._x0 + (float(column) + 0.5) * _CELL_SIZE, self._y0 + (float(row) + 0.5) * _CELL_SIZE)

    def region_near(self, regions: NDArray[np.int32], point: Point, radius: float) -> int:
        """Returns the label of the largest region within ``radius`` (m) of a point; 0 = none."""
        near = regions[self._slices(Rect(point[0], point[1], point[0], point[1]).grown(radius))]
        values, counts = np.unique(near[near > 0], return_counts=True)
        return int(values[np.argmax(counts)]) if values.size else 0

    def _cell_coordinates(self, point: Point) -> tuple[float, float]:
        """Returns the fractional column and row of a point."""
        return ((point[0] - self._x0) / _CELL_SIZE - 0.5, (point[1] - self._y0) / _CELL_SIZE - 0.5)

    def _slices(self, rect: Rect) -> tuple[slice, slice]:
        """Returns the cells whose centres lie in a rectangle."""
        (left, low), (right, high) = self._cell_coordinates((rect.x0, rect.y0)), self._cell_coordinates((rect.x1, rect.y1))
        return (
            slice(max(0, math.ceil(low - 1e-6)), max(0, math.floor(high + 1e-6) + 1)),
            slice(max(0, math.ceil(left - 1e-6)), max(0, math.floor(right + 1e-6) + 1)),
        )

    def _paint(self, rect: Rect, value: int) -> None:
        """Sets the cells whose centres lie in a rectangle."""
        self.free[self._slices(rect)] = value
