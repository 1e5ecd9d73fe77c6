"""Checks a finished plan. It shares only the geometry of rooms (``rooms``, ``floor_grid``) with the planner."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gibson_sim_tools.making.building import MATERIALS, Building, Piece, Storey, Wall
from gibson_sim_tools.making.catalogue import CATALOGUE
from gibson_sim_tools.making.planning.floor_grid import FloorGrid
from gibson_sim_tools.making.planning.objects import SIZES, body_box, is_door
from gibson_sim_tools.making.planning.planner import LANDING, ROBOT_RADIUS, blocked_floor, flight_rect
from gibson_sim_tools.making.planning.rectangles import Box, Rect, rotated_bounds
from gibson_sim_tools.making.planning.rooms import RoomView, cells_of, room_view

_MIN_CORRIDOR_WIDTH = 1.1
_MIN_DOOR_WIDTH = 0.8
_TOLERANCE = 2e-3
"""Tolerance of positions, m."""
_LAMP_KINDS = ("ceiling_lamp", "pendant_lamp", "panel_lamp", "floor_lamp", "desk_lamp")
_HEAD_HEIGHT = 2.0


def check_building(building: Building) -> list[str]:
    """Returns one line for each fault of a plan; empty = no faults."""
    faults = [*_check_names(building), *_check_walls(building), *_check_overlaps(building), *_check_lamps(building)]
    for number, storey in enumerate(building.storeys):
        views = {room.name: room_view(storey, room, blocked_floor(building, number)) for room in storey.rooms}
        faults += _check_rooms(views)
        faults += _check_placement(building, number, views)
        faults += _check_doors_and_windows(building, number, views)
        faults += _check_bodies(building, number, storey)
        faults += _check_reachability(building, number, views)
    return faults


def piece_box(piece: Piece) -> Box:
    """Returns the axis-aligned bounding box of a piece, in the frame of the scene, shrunk by the tolerance."""
    rect = rotated_bounds((piece.position[0], piece.position[1]), piece.yaw, piece.size[0], piece.size[1])
    return Box(
        rect.grown(-_TOLERANCE / 2), piece.position[2] + _TOLERANCE / 2, piece.position[2] + piece.size[2] - _TOLERANCE / 2
    )


def _lies_flat(piece: Piece) -> bool:
    """Returns whether a piece lies flat on the floor, as a rug does."""
    return CATALOGUE[piece.kind].stands == "lies"


def _check_names(building: Building) -> Iterator[str]:
    """Yields duplicate and unknown names."""
    for category, names in (
        ("piece", [p.name for p in building.pieces]),
        ("body", [b.name for b in building.bodies]),
        ("room", [r.name for s in building.storeys for r in s.rooms]),
        ("start", [s.name for s in building.starts]),
    ):
        yield from (f"{category} name {name!r} is used twice" for name in sorted({n for n in names if names.count(n) > 1}))
    yield from (f"{p.name}: kind {p.kind!r} is unknown" for p in building.pieces if p.kind not in CATALOGUE)
    yield from (f"{b.name}: model {b.model!r} is unknown" for b in building.bodies if not is_door(b) and b.model not in SIZES)
    for room in (r for s in building.storeys for r in s.rooms):
        yield from (
            f"{room.name}: material {m!r} is unknown" for m in (room.floor, room.walls, room.ceiling) if m not in MATERIALS
        )


def _check_walls(building: Building) -> Iterator[str]:
    """Yields gaps in the shell and openings that do not fit."""
    for storey in building.storeys:
        ends = [p for w in storey.walls for p in (w.start, w.end)]
        yield from (
            f"wall {w.start}-{w.end}: nothing joins its end {p}"
            for w in storey.walls
            for p in (w.start, w.end)
            if ends.count(p) < 2
        )
        for room in storey.rooms:
            perimeter = sum(math.dist(a, b) for a, b in zip(room.corners, [*room.corners[1:], room.corners[0]], strict=True))
            wall_length = sum(math.dist(w.start, w.end) for w in storey.walls if room.name in (w.left, w.right))
            if abs(perimeter - wall_length) > 1e-3:
                yield f"{room.name}: {wall_length:.2f} m of walls for {perimeter:.2f} m of outline"
        yield from (line for wall in storey.walls for line in _check_openings(wall, storey))


def _check_openings(wall: Wall, storey: Storey) -> Iterator[str]:
    """Yields openings that extend beyond their wall, overlap, or have an invalid size."""
    length, last_end = math.dist(wall.start, wall.end), 0.1
    for opening in sorted(wall.openings, key=lambda o: o.middle):
        description = f"{opening.kind} between {wall.left or 'outside'} and {wall.right or 'outside'}"
        if opening.middle - opening.width / 2 < last_end or opening.middle + opening.width / 2 > length - 0.1:
            yield f"{description} extends beyond its wall or meets another opening"
        if opening.sill + opening.height > storey.height - 0.05:
            yield f"{description} is higher than the ceiling"
        if opening.kind != "window" and opening.width < _MIN_DOOR_WIDTH:
            yield f"{description} is {opening.width:.2f} m wide; at least {_MIN_DOOR_WIDTH} m are needed"
        if opening.kind == "window" and wall.left and wall.right:
            yield f"{description}: a window in an inside wall"
        last_end = opening.middle + opening.width / 2 + 0.05


def _check_overlaps(building: Building) -> Iterator[str]:
    """Yields pieces and bodies that overlap."""
    boxes = [(p.name, piece_box(p)) for p in building.pieces if not _lies_flat(p)]
    for body in building.bodies:
        box = body_box(body)
        boxes.append((body.name, Box(box.rect.grown(-_TOLERANCE / 2), box.z0 + _TOLERANCE / 2, box.z1 - _TOLERANCE / 2)))
    boxes.sort(key=lambda entry: entry[1].rect.x0)
    for index, (name, box) in enumerate(boxes):
        for other_name, other in boxes[index + 1 :]:
            if other.rect.x0 > box.rect.x1:
                break
            if box.overlaps(other):
                yield f"{name} and {other_name} overlap"


def _check_lamps(building: Building) -> Iterator[str]:
    """Yields lamps without a light source, light sources without a lamp, and rooms without a ceiling lamp."""
    pieces = [p for p in building.pieces if p.kind in _LAMP_KINDS]
    for lamp in building.lamps:
        if not any(math.dist(p.position[:2], lamp.position[:2]) < 0.05 for p in pieces):
            yield f"the light source at {lamp.position} has no lamp"
    lit_rooms = {p.room for p in pieces if CATALOGUE[p.kind].stands == "ceiling"}
    yield from (f"{room.name} has no ceiling lamp" for s in building.storeys for room in s.rooms if room.name not in lit_rooms)
    for piece in pieces:
        if not any(math.dist(piece.position[:2], lamp.position[:2]) < 0.05 for lamp in building.lamps):
            yield f"{piece.name} has no light source"


def _check_rooms(views: dict[str, RoomView]) -> Iterator[str]:
    """Yields rooms that are too narrow or have no door."""
    for view in views.values():
        width = min(min(c.width, c.depth) for c in view.cells if c.area > 1.0)
        min_width = 1.3 if view.room.kind not in ("corridor", "hall") else _MIN_CORRIDOR_WIDTH
        if view.room.kind not in ("hall",) and width < min_width:
            yield f"{view.room.name} is {width:.2f} m wide; at least {min_width} m are needed"
        if not view.gates:
            yield f"{view.room.name} has no door"


def _check_placement(building: Building, number: int, views: dict[str, RoomView]) -> Iterator[str]:
    """Yields pieces outside their room, at a wrong height, or too far from a wall."""
    storey = building.storeys[number]
    pieces = [p for p in building.pieces if p.storey == number]
    for piece in pieces:
        view, box, stands = views[piece.room], piece_box(piece), CATALOGUE[piece.kind].stands
        if piece.kind != "railing" and not view.holds(box.rect):
            yield f"{piece.name} extends beyond {piece.room}"
        lift = piece.position[2] - storey.floor_z
        if lift + piece.size[2] > storey.height + _TOLERANCE:
            yield f"{piece.name} is higher than the ceiling"
        if stands in ("wall", "free", "corner", "lies") and abs(lift) > _TOLERANCE:
            yield f"{piece.name} is {lift:.3f} m above the floor"
        if stands == "ceiling" and abs(lift + piece.size[2] - storey.height) > _TOLERANCE:
            yield f"{piece.name} does not reach the ceiling"
        if stands == "table" and not any(_supports(p, piece.position, box.rect) for p in pieces):
            yield f"{piece.name} rests on nothing"
        if stands in ("hangs", "wall") and not _has_wall_behind(piece, view, pieces):
            yield f"{piece.name} has no wall behind it"


def _supports(piece: Piece, position: tuple[float, float, float], rect: Rect) -> bool:
    """Returns whether a footprint at a position is entirely on top of a piece."""
    on_top = abs(piece.position[2] + piece.size[2] - position[2]) < _TOLERANCE
    top = piece_box(piece).rect.grown(_TOLERANCE)
    return on_top and rect.overlap_area(top) >= rect.area - 1e-6


def _has_wall_behind(piece: Piece, view: RoomView, others: list[Piece]) -> bool:
    """Returns whether a piece has a wall behind it; also true for sofas, which may be free-standing, and for desks with a partition behind."""
    back = (
        piece.position[0] - math.cos(piece.yaw) * piece.size[0] / 2,
        piece.position[1] - math.sin(piece.yaw) * piece.size[0] / 2,
    )
    for face in view.sides:
        along = (back[0] - face.start[0]) * face.along[0] + (back[1] - face.start[1]) * face.along[1]
        distance = (back[0] - face.start[0]) * face.normal[0] + (back[1] - face.start[1]) * face.normal[1]
        yaw_error = abs(math.remainder(face.yaw - piece.yaw, 2 * math.pi))
        if face.low - 0.01 <= along <= face.high + 0.01 and -0.01 < distance < 0.25 and yaw_error < 0.01:
            return True
    partitions = (p for p in others if p.kind == "partition")
    return piece.kind == "sofa" or (piece.kind == "desk" and any(math.dist(p.position, piece.position) < 0.7 for p in partitions))


def _check_doors_and_windows(building: Building, number: int, views: dict[str, RoomView]) -> Iterator[str]:
    """Yields obstacles in front of doors, windows and the ends of stairs."""
    floor_z = building.storeys[number].floor_z
    obstacles = [(p.name, piece_box(p)) for p in building.pieces if p.storey == number and not _lies_flat(p)]
    obstacles += [
        (b.name, body_box(b)) for b in building.bodies if not is_door(b) and _storey_of(building, b.position[2]) == number
    ]
    for view in views.values():
        for name, box in obstacles:
            for gate in view.gates:
                if box.z0 - floor_z < _HEAD_HEIGHT and any(zone.overlaps(box.rect) for zone in gate.zones):
                    yield f"{name} blocks the {gate.opening.kind} from {view.room.name} to {gate.other_room or 'outside'}"
            for window in view.windows:
                low, high = floor_z + window.opening.sill + 0.03, floor_z + window.opening.sill + window.opening.height
                if (
                    box.z1 > low
                    and box.z0 < high
                    and window.zone.overlaps(box.rect)
                    and not (box.z1 - box.z0 < 0.35 and box.z0 > floor_z + 0.6)
                ):
                    yield f"{name} blocks a window of {view.room.name}"
    for stair in building.stairs:
        length = (stair.steps - 1) * stair.tread
        top = (stair.foot[0] + math.cos(stair.yaw) * length, stair.foot[1] + math.sin(stair.yaw) * length)
        ends = {stair.storey: (stair.foot, stair.yaw), stair.storey + 1: (top, stair.yaw + math.pi)}
        if number in ends:
            zone = flight_rect(*ends[number], stair.width, 0.0, LANDING)
            yield from (
                f"{name} blocks the end of a stair"
                for name, box in obstacles
                if box.z0 - floor_z < _HEAD_HEIGHT and zone.overlaps(box.rect)
            )


def _storey_of(building: Building, z: float) -> int:
    """Returns the index of the storey at a height."""
    return max(n for n, s in enumerate(building.storeys) if n == 0 or s.floor_z <= z + 0.01)


def _check_bodies(building: Building, number: int, storey: Storey) -> Iterator[str]:
    """Yields bodies that float or are outside all rooms."""
    pieces = [p for p in building.pieces if p.storey == number and CATALOGUE[p.kind].stands != "lies"]
    cells = {room.name: cells_of(room.corners) for room in storey.rooms}
    for body in building.bodies:
        if is_door(body) or _storey_of(building, body.position[2]) != number:
            continue
        rect = body_box(body).rect
        if not any(sum(rect.overlap_area(c) for c in cs) >= rect.area - 1e-5 for cs in cells.values()):
            yield f"{body.name} is outside all rooms"
        if abs(body.position[2] - storey.floor_z) > _TOLERANCE and not any(_supports(p, body.position, rect) for p in pieces):
            yield f"{body.name} floats"


def _check_reachability(building: Building, number: int, views: dict[str, RoomView]) -> Iterator[str]:
    """Yields rooms without a wide path between their doors, and places that a robot cannot reach."""
    static_grid = FloorGrid(building, number, views, with_bodies=False)
    wide_regions = static_grid.regions(0.35)
    for view in views.values():
        gate_regions = {static_grid.region_near(wide_regions, gate.point, 0.2) for gate in view.gates}
        if 0 in gate_regions or len(gate_regions) > 1:
            yield f"{view.room.name}: no path of 0.7 m width between its doors"
    full_grid = FloorGrid(building, number, views, with_bodies=True)
    regions = full_grid.regions(ROBOT_RADIUS)
    places = [(s.name, (s.position[0], s.position[1])) for s in building.starts if _storey_of(building, s.position[2]) == number]
    places += [(f"a door of {view.room.name}", gate.point) for view in views.values() for gate in view.gates]
    places += [("the foot of the stair", s.foot) for s in building.stairs if s.storey == number]
    region_of_place = {name: full_grid.region_near(regions, point, 0.3 if name not in views else 0.06) for name, point in places}
    main = max(set(region_of_place.values()), key=list(region_of_place.values()).count) if region_of_place else 0
    yield from (
        f"{name} cannot be reached by a robot" for name, region in region_of_place.items() if region == 0 or region != main
    )
    yield from (f"{name} has no start" for name in views if name not in region_of_place)
