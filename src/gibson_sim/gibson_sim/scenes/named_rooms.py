"""Rooms that a scene names, on the map of their floor: the best place in each for a robot, and the passages between them. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim.scenes.floor_map import FloorMap
from gibson_sim.scenes.room_spec import RoomSpec
from gibson_sim.scenes.rooms import NARROWEST_DOOR, Door, door_at, passages

_WALL = 0.4
"""Metres: the thickest wall between two outlines."""


@dataclass(frozen=True, slots=True)
class RoomPlace:
    """A room that a robot fits into."""

    room: RoomSpec
    place: tuple[float, float]
    """Where a robot stands well: far from things and from the outline, world metres."""
    area: float
    """Square metres of free floor."""
    reachable: bool
    """Whether the way there from the largest part of the floor is wide enough for the robot."""


class NamedRooms:
    """The named rooms of one floor.

    Args:
        rooms: those of this floor.
        floor: its map.
    """

    def __init__(self, rooms: Sequence[RoomSpec], floor: FloorMap) -> None:
        self._rooms, self._floor = rooms, floor
        self._inside: NDArray[np.int64] = np.zeros(floor.shape, dtype=np.int64)
        cells = np.argwhere(floor.free) if rooms else np.zeros((0, 2), dtype=np.int64)
        centers = floor.centers(cells)
        for number, room in reversed(list(enumerate(rooms, start=1))):
            self._inside[tuple(cells[room.contains(centers)].T)] = number
        self._labels = self._grown()

    def _grown(self) -> NDArray[np.int64]:
        """Returns (H, W): number of the room of each free cell, 0 = none; those in doorways between outlines belong to the nearest."""
        if not self._inside.any():
            return self._inside
        distance, nearest = ndimage.distance_transform_edt(self._inside == 0, self._floor.resolution, return_indices=True)
        near = self._inside[tuple(nearest)]
        return np.where(self._floor.free & (distance <= _WALL / 2 + self._floor.resolution), near, 0)

    def places(self, radius: float) -> list[RoomPlace]:
        """Returns one place for each room that a disc of ``radius`` metres fits into, in the order of the rooms."""
        fits = self._floor.inflate(radius)
        reachable = self._floor.largest_free_region(radius)
        out = []
        for number, room in enumerate(self._rooms, start=1):
            inside = self._inside == number
            cells = np.argwhere(inside & reachable)
            is_reachable = len(cells) > 0
            if not is_reachable:
                cells = np.argwhere(inside & fits)
            if not len(cells):
                continue
            # An outline may be no wall: a place on it is in both rooms.
            within = ndimage.distance_transform_edt(np.pad(room.contains(self._centers()), 1), self._floor.resolution)[1:-1, 1:-1]
            best = cells[int(np.minimum(within, self._floor.distance_to_obstacle)[tuple(cells.T)].argmax())]
            x, y = self._floor.centers(best)
            area = float(np.count_nonzero(inside)) * self._floor.resolution**2
            out.append(RoomPlace(room, (float(x), float(y)), area, is_reachable))
        return out

    def doors(self) -> list[Door]:
        """Returns the passages between the rooms, whose numbers are indices of ``rooms``; wide ones are open sides."""
        out = []
        for (first, second), pieces in passages(self._labels).items():
            for cells in pieces:
                door = door_at(self._floor, self._labels, cells, (first, second), (first - 1, second - 1))
                # Gaps beside furniture, and the inside of hollow walls, are none.
                if door.width >= NARROWEST_DOOR - self._floor.resolution:
                    span = np.ptp(cells, axis=0)
                    width = float(np.hypot(*(span + (span > 0)))) * self._floor.resolution
                    out.append(replace(door, width=max(width, door.width)))
        return sorted(out, key=lambda door: (door.rooms, door.center))

    def room_at(self, xy: tuple[float, float]) -> RoomSpec | None:
        """Returns the room of a place, world metres, or None."""
        row, column = (int(i) for i in self._floor.cells(np.array(xy)))
        rows, columns = self._floor.shape
        number = int(self._labels[row, column]) if 0 <= row < rows and 0 <= column < columns else 0
        return self._rooms[number - 1] if number else None

    def _centers(self) -> NDArray[np.float64]:
        rows, columns = self._floor.shape
        return self._floor.centers(np.stack(np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"), axis=-1))
