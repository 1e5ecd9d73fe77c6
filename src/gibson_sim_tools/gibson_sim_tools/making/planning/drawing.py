"""Draws a plan, seen from above, for development of the planner."""

from __future__ import annotations

import math
from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.making.building import Building, Point
from gibson_sim_tools.making.catalogue import CATALOGUE
from gibson_sim_tools.making.planning.objects import SIZES, is_door, leaf_corners
from gibson_sim_tools.making.planning.rectangles import bounding_rect
from gibson_sim_tools.making.planning.rooms import wall_rect

_SCALE = 90.0
"""Pixels per metre."""
_MARGIN = 0.5
"""Margin around the building, m."""
_Colour = tuple[int, int, int]
_FLOORS: dict[str, _Colour] = {
    "oak": (222, 196, 156),
    "walnut": (186, 150, 116),
    "pine": (236, 212, 170),
    "parquet": (212, 180, 134),
    "carpet": (206, 206, 204),
    "tile": (214, 226, 230),
    "concrete": (204, 204, 200),
    "vinyl": (214, 214, 212),
    "marble": (236, 236, 238),
    "terrazzo": (226, 220, 214),
}
_OUTLINE_COLOUR: _Colour = (40, 40, 48)


def draw_plan(building: Building, storey: int) -> NDArray[np.uint8]:
    """Draws a storey, y up, (H, W, 3) uint8 RGB: rooms, walls, doors, windows, furniture with names, bodies, lamps, start poses."""
    return _StoreyDrawing(building, storey).draw()


class _StoreyDrawing:
    """Draws one storey."""

    def __init__(self, building: Building, storey: int) -> None:
        self._building = building
        self._number = storey
        self._storey = building.storeys[storey]
        self._bounds = bounding_rect(c for s in building.storeys for r in s.rooms for c in r.corners).grown(_MARGIN)
        shape = (math.ceil(self._bounds.depth * _SCALE), math.ceil(self._bounds.width * _SCALE), 3)
        self._image = np.full(shape, 250, np.uint8)

    def draw(self) -> NDArray[np.uint8]:
        """Draws everything and returns the image."""
        for room in self._storey.rooms:
            self._fill(room.corners, next((c for name, c in _FLOORS.items() if room.floor.startswith(name)), (225, 225, 225)))
        self._stairs()
        self._pieces()
        self._walls()
        self._bodies()
        for room in self._storey.rooms:
            middle = bounding_rect(room.corners).middle
            self._text(f"{room.name} ({room.floor}, {room.walls})", middle, (150, 30, 30), 0.42)
        for start in self._building.starts:
            if self._is_on_storey(start.position[2]):
                point = (start.position[0], start.position[1])
                cv2.circle(self._image, self._pixel(point), 18, (30, 120, 220), 1, cv2.LINE_AA)
                tip = (point[0] + 0.3 * math.cos(start.yaw), point[1] + 0.3 * math.sin(start.yaw))
                cv2.line(self._image, self._pixel(point), self._pixel(tip), (30, 120, 220), 1, cv2.LINE_AA)
        return self._image

    def _is_on_storey(self, z: float) -> bool:
        """Returns whether a height belongs to this storey."""
        return self._storey.floor_z - 0.01 <= z < self._storey.floor_z + self._storey.height

    def _pixel(self, point: Point) -> tuple[int, int]:
        """Returns the pixel, (x, y), of a point."""
        return (round((point[0] - self._bounds.x0) * _SCALE), round((self._bounds.y1 - point[1]) * _SCALE))

    def _fill(self, points: Iterable[Point], colour: _Colour, edge: _Colour | None = None) -> None:
        """Fills a polygon and optionally draws its edge."""
        corners = np.array([self._pixel(p) for p in points], np.int32)
        cv2.fillPoly(self._image, [corners], colour, cv2.LINE_AA)
        if edge:
            cv2.polylines(self._image, [corners], True, edge, 1, cv2.LINE_AA)

    def _text(self, text: str, point: Point, colour: _Colour, size: float) -> None:
        """Writes a text centred on a point."""
        (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
        x, y = self._pixel(point)
        cv2.putText(self._image, text, (x - width // 2, y + height // 2), cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)

    @staticmethod
    def _rotated_rect(middle: Point, yaw: float, depth: float, width: float) -> list[Point]:
        """Returns the corners of a rotated rectangle."""
        cos, sin = math.cos(yaw), math.sin(yaw)
        offsets = ((-depth / 2, -width / 2), (depth / 2, -width / 2), (depth / 2, width / 2), (-depth / 2, width / 2))
        return [(middle[0] + cos * x - sin * y, middle[1] + sin * x + cos * y) for x, y in offsets]

    def _pieces(self) -> None:
        """Draws furniture, the lowest first, with a line along the front of each piece."""
        for piece in sorted(
            (p for p in self._building.pieces if p.storey == self._number), key=lambda p: p.position[2] + p.size[2]
        ):
            middle, stands = (piece.position[0], piece.position[1]), CATALOGUE[piece.kind].stands
            corners = self._rotated_rect(middle, piece.yaw, piece.size[0], piece.size[1])
            if stands == "ceiling":
                cv2.circle(self._image, self._pixel(middle), 7, (230, 170, 20), 2, cv2.LINE_AA)
                continue
            colour = {"lies": (232, 222, 206), "hangs": (190, 170, 220), "table": (170, 190, 170)}.get(stands, (250, 246, 238))
            self._fill(corners, colour, _OUTLINE_COLOUR)
            cv2.line(self._image, self._pixel(corners[1]), self._pixel(corners[2]), (200, 60, 60), 2, cv2.LINE_AA)
            self._text(piece.kind, middle, _OUTLINE_COLOUR, 0.33)

    def _walls(self) -> None:
        """Draws walls and their openings."""
        for wall in self._storey.walls:
            rect = wall_rect(wall)
            self._fill(((rect.x0, rect.y0), (rect.x1, rect.y0), (rect.x1, rect.y1), (rect.x0, rect.y1)), (70, 70, 76))
        for wall in self._storey.walls:
            length = math.dist(wall.start, wall.end)
            along = ((wall.end[0] - wall.start[0]) / length, (wall.end[1] - wall.start[1]) / length)
            for opening in wall.openings:
                middle = (wall.start[0] + along[0] * opening.middle, wall.start[1] + along[1] * opening.middle)
                colour = {"window": (150, 205, 240), "door": (240, 235, 220), "passage": (240, 235, 220)}[opening.kind]
                self._fill(
                    self._rotated_rect(middle, math.atan2(along[1], along[0]), opening.width, wall.thickness + 0.02), colour
                )

    def _stairs(self) -> None:
        """Draws stairs, and the openings above them."""
        for stair in self._building.stairs:
            if stair.storey + 1 == self._number:
                self._fill(stair.hole, (120, 120, 130))
            if stair.storey == self._number:
                for step in range(stair.steps - 1):
                    distance = (step + 0.5) * stair.tread
                    middle = (stair.foot[0] + math.cos(stair.yaw) * distance, stair.foot[1] + math.sin(stair.yaw) * distance)
                    shade = 235 - 6 * step
                    self._fill(
                        self._rotated_rect(middle, stair.yaw, stair.tread, stair.width), (shade, shade, shade), _OUTLINE_COLOUR
                    )

    def _bodies(self) -> None:
        """Draws movable bodies: door leaves in red, others in green."""
        for body in sorted(self._building.bodies, key=lambda b: b.position[2]):
            if not self._is_on_storey(body.position[2]):
                continue
            if is_door(body):
                self._fill(leaf_corners(body), (200, 70, 40))
                continue
            size = SIZES[body.model]
            self._fill(
                self._rotated_rect((body.position[0], body.position[1]), body.yaw, size[0], size[1]),
                (150, 210, 140),
                (30, 110, 40),
            )
            if size[1] > 0.25:
                self._text(body.model, (body.position[0], body.position[1]), (20, 80, 30), 0.3)
