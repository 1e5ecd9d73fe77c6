"""Rooms and doors of a floor, found in its map: a door is where the way between two wide places is narrow.

Water that rises from the most open places meets where the passages are narrowest (a watershed of the distance to the nearest obstacle).
Pure and deterministic.
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
"""Metres: wider passages join what they connect to one room."""
NARROWEST_DOOR = 0.4
"""Metres: a narrower passage is a gap beside furniture."""
SMALLEST_ROOM = 2.0
"""Square metres."""
_MOST_CELLS = 400_000
_STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0))


@dataclass(frozen=True, slots=True)
class Room:
    """A part of the floor that can be left through doors alone."""

    center: tuple[float, float]
    """Its most open place, world metres."""
    low: tuple[float, float]
    """Of the smallest rectangle about its floor, world metres."""
    high: tuple[float, float]
    area: float
    """Square metres of free floor."""


@dataclass(frozen=True, slots=True)
class Door:
    """A narrow passage between two rooms."""

    center: tuple[float, float]
    """World metres."""
    yaw: float
    """Radians: the way from the first room to the second."""
    width: float
    """Metres of free floor."""
    rooms: tuple[int, int]
    """Indices of the rooms."""


def find_rooms(floor: FloorMap) -> tuple[tuple[Room, ...], tuple[Door, ...]]:
    """Returns the rooms, from small x and y on, and the doors between them; none of a map with too many free cells."""
    if np.count_nonzero(floor.free) > _MOST_CELLS:
        return (), ()
    open_places, _ = ndimage.label(floor.distance_to_obstacle > WIDEST_DOOR / 2)
    labels = _flood(floor.distance_to_obstacle, np.asarray(open_places, dtype=np.int64))
    labels = _merged(labels, passages(labels))
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
    cells = np.argwhere(labels[box] == label) + np.array((box[0].start, box[1].start))
    half = floor.resolution / 2
    centers = floor.centers(cells)
    best = int(floor.distance_to_obstacle[tuple(cells.T)].argmax())
    (x, y), low, high = centers[best], centers.min(axis=0) - half, centers.max(axis=0) + half
    return Room((float(x), float(y)), (float(low[0]), float(low[1])), (float(high[0]), float(high[1])), area)


def _flood(clearance: NDArray[np.float64], labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the labels, grown over all cells with some clearance: always on to the most open cell beside a labelled one."""
    out = np.array(labels)
    rows, columns = out.shape
    heap = [(-float(clearance[r, c]), int(r), int(c)) for r, c in np.argwhere(_edge(out))]
    heapq.heapify(heap)
    while heap:
        _, row, column = heapq.heappop(heap)
        for down, right in _STEPS:
            r, c = row + down, column + right
            if 0 <= r < rows and 0 <= c < columns and not out[r, c] and clearance[r, c] > 0.0:
                out[r, c] = out[row, column]
                heapq.heappush(heap, (-float(clearance[r, c]), r, c))
    return out


def _edge(labels: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Returns (H, W): labelled cells beside one without a label."""
    return np.asarray((labels > 0) & (ndimage.minimum_filter(labels, size=3, mode="nearest") == 0))


def passages(labels: NDArray[np.int64]) -> dict[tuple[int, int], list[NDArray[np.int64]]]:
    """Returns where two labels meet: for every pair, the lower one first, the cells (N, 2) of each passage between them."""
    borders: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for down, right in ((0, 1), (1, 0)):
        a = labels[: labels.shape[0] - down, : labels.shape[1] - right]
        b = labels[down:, right:]
        for row, column in np.argwhere((a != b) & (a > 0) & (b > 0)):
            first, second = sorted((int(a[row, column]), int(b[row, column])))
            borders.setdefault((first, second), []).append((int(row), int(column)))
    passages = {}
    for pair, cells in borders.items():
        at = np.array(cells)
        first_cell = at.min(axis=0)
        mask = np.zeros(at.max(axis=0) - first_cell + 1, dtype=bool)
        mask[tuple((at - first_cell).T)] = True
        pieces, count = ndimage.label(mask, structure=np.ones((3, 3)))
        passages[pair] = [np.argwhere(pieces == piece) + first_cell for piece in range(1, count + 1)]
    return passages


def _merged(labels: NDArray[np.int64], passages: dict[tuple[int, int], list[NDArray[np.int64]]]) -> NDArray[np.int64]:
    """Returns the labels, one for what has several passages between its parts: furniture stands there, no wall."""
    name = np.arange(int(labels.max()) + 1)
    for (first, second), pieces in sorted(passages.items()):
        if len(pieces) > 1:
            name[name == name[second]] = name[first]
    return np.asarray(name[labels])


def door_at(
    floor: FloorMap, labels: NDArray[np.int64], cells: NDArray[np.int64], sides: tuple[int, int], rooms: tuple[int, int]
) -> Door:
    """Returns the door whose threshold is ``cells`` (N, 2), between two labels."""
    clearance = floor.distance_to_obstacle[tuple(cells.T)]
    row, column = (int(i) for i in cells[int(clearance.argmax())])
    x, y = floor.centers(np.array([row, column]))
    # The way through: from the middle of the near floor of one room to that of the other.
    reach = math.ceil(WIDEST_DOOR / floor.resolution)
    near = labels[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1]
    here, there = (np.argwhere(near == side).mean(axis=0) for side in sides)
    yaw = math.atan2(there[0] - here[0], there[1] - here[1])
    return Door((float(x), float(y)), yaw, 2.0 * float(clearance.max()), rooms)
