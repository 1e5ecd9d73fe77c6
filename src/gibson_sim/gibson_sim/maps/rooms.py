"""Segments the map of a floor into rooms and doors: a door is a narrow passage between two open areas.

The segmentation is a watershed transform of the distance to the nearest obstacle: regions that grow from the most open points meet where
passages are narrowest. Pure and deterministic.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim.maps.floor_map import FloorMap

WIDEST_DOOR = 1.0
"""Maximum width of a door, metres: a wider passage joins both sides to one room."""
NARROWEST_DOOR = 0.4
"""Minimum width of a door, metres: a narrower passage is a gap beside furniture."""
SMALLEST_ROOM = 2.0
"""Minimum area of a room, square metres."""
_MAX_CELLS = 400_000
"""Maximum number of free cells of a map in which rooms are segmented, since region growing is a Python loop."""
_NEIGHBOURS = ((0, 1), (1, 0), (0, -1), (-1, 0))


@dataclass(frozen=True, slots=True)
class Room:
    """A part of the floor whose only exits are doors."""

    center: tuple[float, float]
    """Point farthest from obstacles, world metres."""
    low: tuple[float, float]
    """Lower left corner of the bounding rectangle of its floor, world metres."""
    high: tuple[float, float]
    """Upper right corner of the bounding rectangle of its floor, world metres."""
    area: float
    """Area of free floor, square metres."""


@dataclass(frozen=True, slots=True)
class Door:
    """A narrow passage between two rooms."""

    center: tuple[float, float]
    """Centre of the passage, world metres."""
    yaw: float
    """Direction from the first room to the second, radians, world frame."""
    width: float
    """Width of free floor, metres."""
    rooms: tuple[int, int]
    """Indices of the first and the second room."""


def find_rooms(floor: FloorMap) -> tuple[tuple[Room, ...], tuple[Door, ...]]:
    """Returns the rooms, sorted by x and y, and the doors between them; empty for a map with more than 400,000 free cells."""
    if np.count_nonzero(floor.free) > _MAX_CELLS:
        return (), ()
    open_places, _ = ndimage.label(floor.distance_to_obstacle > WIDEST_DOOR / 2)
    labels = _watershed(floor.distance_to_obstacle, np.asarray(open_places, dtype=np.int64))
    labels = _joined(labels, passages(labels))
    areas = np.bincount(labels.ravel()) * floor.resolution**2
    boxes = ndimage.find_objects(labels)
    rooms = {
        label: _room(floor, labels, label, boxes[label - 1], float(areas[label]))
        for label in map(int, np.flatnonzero(areas >= SMALLEST_ROOM))
        if label
    }
    order = sorted(rooms, key=lambda label: rooms[label].center)
    number = {int(label): i for i, label in enumerate(order)}
    doors = []
    for (first, second), pieces in passages(labels).items():
        if first in number and second in number:
            first, second = sorted((first, second), key=number.__getitem__)
            doors += [door_at(floor, labels, cells, (first, second), (number[first], number[second])) for cells in pieces]
    wide = [door for door in doors if door.width >= NARROWEST_DOOR]
    return tuple(rooms[label] for label in order), tuple(sorted(wide, key=lambda door: (door.rooms, door.center)))


def _room(floor: FloorMap, labels: NDArray[np.int64], label: int, box: tuple[slice, slice], area: float) -> Room:
    """Returns the room of a label in ``labels`` (H, W); ``box``: its rows and columns, ``area``: square metres."""
    cells = np.argwhere(labels[box] == label) + np.array((box[0].start, box[1].start))
    half = floor.resolution / 2
    centers = floor.centers(cells)
    best = int(floor.distance_to_obstacle[tuple(cells.T)].argmax())
    (x, y), low, high = centers[best], centers.min(axis=0) - half, centers.max(axis=0) + half
    return Room((float(x), float(y)), (float(low[0]), float(low[1])), (float(high[0]), float(high[1])), area)


def _watershed(clearance: NDArray[np.float64], labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns labels (H, W) grown over all cells with a clearance above 0, always into the adjacent unlabelled cell with the largest clearance."""
    out = np.array(labels)
    rows, columns = out.shape
    heap = [(-float(clearance[r, c]), int(r), int(c)) for r, c in np.argwhere(_edge(out))]
    heapq.heapify(heap)
    while heap:
        _, row, column = heapq.heappop(heap)
        for down, right in _NEIGHBOURS:
            r, c = row + down, column + right
            if 0 <= r < rows and 0 <= c < columns and not out[r, c] and clearance[r, c] > 0.0:
                out[r, c] = out[row, column]
                heapq.heappush(heap, (-float(clearance[r, c]), r, c))
    return out


def _edge(labels: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Returns a mask (H, W) of the labelled cells that are adjacent to an unlabelled one."""
    return np.asarray((labels > 0) & (ndimage.minimum_filter(labels, size=3, mode="nearest") == 0))


def passages(labels: NDArray[np.int64]) -> dict[tuple[int, int], list[NDArray[np.int64]]]:
    """Returns the passages between labels (H, W): pair of labels, the lower one first -> cells (N, 2) of each connected border segment."""
    borders: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for down, right in ((0, 1), (1, 0)):
        a = labels[: labels.shape[0] - down, : labels.shape[1] - right]
        b = labels[down:, right:]
        for row, column in np.argwhere((a != b) & (a > 0) & (b > 0)):
            first, second = sorted((int(a[row, column]), int(b[row, column])))
            borders.setdefault((first, second), []).append((int(row), int(column)))
    out = {}
    for pair, cells in borders.items():
        at = np.array(cells)
        first_cell = at.min(axis=0)
        mask = np.zeros(at.max(axis=0) - first_cell + 1, dtype=bool)
        mask[tuple((at - first_cell).T)] = True
        pieces, count = ndimage.label(mask, structure=np.ones((3, 3)))
        out[pair] = [np.argwhere(pieces == piece) + first_cell for piece in range(1, count + 1)]
    return out


def _joined(labels: NDArray[np.int64], between: dict[tuple[int, int], list[NDArray[np.int64]]]) -> NDArray[np.int64]:
    """Returns the labels (H, W), with regions merged that are connected by several passages: they are separated by furniture, not by a wall."""
    joined = np.arange(int(labels.max()) + 1)
    for (first, second), pieces in sorted(between.items()):
        if len(pieces) > 1:
            joined[joined == joined[second]] = joined[first]
    return np.asarray(joined[labels])


def door_at(
    floor: FloorMap, labels: NDArray[np.int64], cells: NDArray[np.int64], sides: tuple[int, int], rooms: tuple[int, int]
) -> Door:
    """Returns the door whose threshold is ``cells`` (N, 2), as row and column.

    Args:
        floor: the map.
        labels: (H, W), label of each cell.
        cells: cells of the passage, as returned by ``passages``.
        sides: the two labels.
        rooms: indices of their rooms.
    """
    clearance = floor.distance_to_obstacle[tuple(cells.T)]
    row, column = (int(i) for i in cells[int(clearance.argmax())])
    x, y = floor.centers(np.array([row, column]))
    # The yaw is the direction from the centroid of the near floor of one room to that of the other.
    reach = math.ceil(WIDEST_DOOR / floor.resolution)
    near = labels[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1]
    first_side, second_side = (np.argwhere(near == side).mean(axis=0) for side in sides)
    yaw = math.atan2(second_side[0] - first_side[0], second_side[1] - first_side[1])
    return Door((float(x), float(y)), yaw, 2.0 * float(clearance.max()), rooms)
