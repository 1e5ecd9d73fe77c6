"""Plans a building from its kind and a seed, with a palette of matching floor and wall materials."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gibson_sim.errors import ConfigError
from gibson_sim.types import Vec3
from gibson_sim_tools.making.building import Building, BuildingKind, Piece, Point, Room, Stair, Start, Storey, Wall
from gibson_sim_tools.making.planning.floor_grid import FloorGrid
from gibson_sim_tools.making.planning.furnishing import furnish
from gibson_sim_tools.making.planning.layout import (
    BuildingLayout,
    Flight,
    Level,
    flat_layout,
    house_layout,
    office_layout,
    random_orientation,
    shop_layout,
)
from gibson_sim_tools.making.planning.rectangles import Rect, bounding_rect
from gibson_sim_tools.making.planning.rooms import room_view
from gibson_sim_tools.making.planning.space import FurnishedRoom, Furnishings
from gibson_sim_tools.making.planning.walls import hang_doors, outline, walls_of, with_doors, with_windows

KINDS: Mapping[BuildingKind, Callable[[np.random.Generator], BuildingLayout]] = {
    "flat": flat_layout,
    "house": house_layout,
    "office": office_layout,
    "shop": shop_layout,
}
_ATTEMPTS = 60
"""Maximum number of layouts tried for a building."""
_ROOM_ATTEMPTS = 8
"""Maximum number of furnishings tried for a room."""
_MODELS_WITH_JOINTS = ("cabinet_drawers", "cabinet_doors")
"""Models of furniture with joints; each home contains at least one."""
ROBOT_RADIUS = 0.22
"""Radius of the robot that can reach every room, m."""
LANDING = 0.9
"""Depth of free floor at both ends of a stair, m."""
_WET = ("bathroom", "toilet")
_COOKING = ("kitchen", "kitchenette")
_ENTRY = ("hall", "corridor")


def plan_building(kind: BuildingKind, seed: int, name: str = "") -> Building:
    """Returns the plan of a building; the same kind and seed give the same plan.

    Args:
        kind: kind of building.
        seed: random seed, 0 or more.
        name: name of the building; empty = kind and seed.

    Raises:
        ConfigError: the kind is unknown or the seed is negative.
    """
    if kind not in KINDS:
        raise ConfigError(f"building kind {kind!r} is unknown; known: {', '.join(KINDS)}")
    if seed < 0:
        raise ConfigError(f"seed {seed} is negative; give 0 or more")
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([list(KINDS).index(kind), seed, attempt])
        building = _attempt(kind, seed, name or f"{kind}_{seed}", rng)
        if building is not None:
            return building
    raise ConfigError(f"no {kind} could be planned with seed {seed} in {_ATTEMPTS} attempts; give another seed")


def _attempt(kind: BuildingKind, seed: int, name: str, rng: np.random.Generator) -> Building | None:
    """Returns a plan; None if a door or a required piece of furniture does not fit, or a room cannot be reached."""
    layout = random_orientation(KINDS[kind](rng), rng)
    materials = palette(kind, rng)
    stairs = tuple(_stair(flight) for flight in layout.flights)
    storeys = []
    for number, level in enumerate(layout.levels):
        storey = _plan_storey(layout, number, level, materials, rng)
        if storey is None:
            return None
        storeys.append(storey)
    furnishings = Furnishings(rng)
    for number, storey in enumerate(storeys):
        _add_railings(furnishings, layout, number)
        for room in storey.rooms:
            if not _furnish_room(furnishings, layout, number, storey, room, workplace=kind in ("office", "shop")):
                return None
    if kind in ("flat", "house") and not any(body.model in _MODELS_WITH_JOINTS for body in furnishings.bodies):
        return None
    doors = hang_doors(storeys, rng)
    azimuth, elevation = float(rng.uniform(0.0, 2 * math.pi)), math.radians(float(rng.uniform(28.0, 48.0)))
    sun = (math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation), -math.sin(elevation))
    building = Building(
        name=name,
        kind=kind,
        seed=seed,
        storeys=tuple(storeys),
        pieces=tuple(furnishings.pieces),
        bodies=(*doors, *furnishings.bodies),
        lamps=tuple(furnishings.lamps),
        starts=(),
        stairs=stairs,
        sun_direction=_rounded(sun),
        sun=round(float(rng.uniform(2.5, 4.0)), 2),
        sky=round(float(rng.uniform(0.8, 1.3)), 2),
    )
    starts = _start_poses(building)
    return replace(building, starts=starts) if starts else None


def _rounded(values: Vec3) -> Vec3:
    """Returns a vector rounded to 0.1 mm."""
    return (round(values[0], 4), round(values[1], 4), round(values[2], 4))


def _plan_storey(
    layout: BuildingLayout, number: int, level: Level, materials: _Palette, rng: np.random.Generator
) -> Storey | None:
    """Returns a storey with walls, doors, windows and materials; None if a door does not fit."""
    walls = with_doors(walls_of(level.spaces, layout.partition, level.height), level.links, rng)
    if walls is None:
        return None
    walls = with_windows(walls, level, _blocked_in_layout(layout, number), _front(walls), rng)
    rooms = []
    for space in level.spaces:
        floor, surface = surfaces(materials, space.kind, rng)
        rooms.append(Room(space.name, space.kind, outline(space), floor, surface))
    floor_z = round(number * (level.height + layout.slab), 4)
    return Storey(floor_z, level.height, tuple(rooms), walls)


def _front(walls: tuple[Wall, ...]) -> Rect:
    """Returns a long strip along the wall with the entrance; an empty rectangle without one."""
    doors = [w for w in walls if any(o.kind == "door" for o in w.openings) and "" in (w.left, w.right)]
    if not doors:
        return Rect(0.0, 0.0, 0.0, 0.0)
    line = bounding_rect((doors[0].start, doors[0].end))
    return Rect(line.x0, -1e3, line.x1, 1e3) if line.width == 0 else Rect(-1e3, line.y0, 1e3, line.y1)


def _stair(flight: Flight) -> Stair:
    """Returns the stair of a flight."""
    dx, dy = flight.top[0] - flight.foot[0], flight.top[1] - flight.foot[1]
    h = flight.hole
    hole = ((h.x0, h.y0), (h.x1, h.y0), (h.x1, h.y1), (h.x0, h.y1))
    tread = round(math.hypot(dx, dy) / (flight.steps - 1), 4)
    return Stair(0, flight.foot, round(math.atan2(dy, dx), 6) + 0.0, flight.width, tread, flight.steps, hole)


def flight_rect(foot: Point, yaw: float, width: float, length: float, depth_before: float = 0.0) -> Rect:
    """Returns the footprint of a flight; with ``depth_before``, the floor of this depth in front of it instead."""
    cos, sin = round(math.cos(yaw)), round(math.sin(yaw))
    start, end = (-depth_before, 0.0) if depth_before else (0.0, length)
    return bounding_rect(
        (foot[0] + cos * at - sin * aside, foot[1] + sin * at + cos * aside)
        for at in (start, end)
        for aside in (-width / 2, width / 2)
    )


def _blocked_in_layout(layout: BuildingLayout, number: int) -> tuple[Rect, ...]:
    """Returns the stairs and openings of a storey in a layout, which are not free floor."""
    flights = tuple(bounding_rect((*_edge(f, f.foot), *_edge(f, f.top))) for f in layout.flights if number == 0)
    return flights + tuple(f.hole for f in layout.flights if number == 1)


def _edge(flight: Flight, middle: Point) -> tuple[Point, Point]:
    """Returns both ends of the first or last edge of a flight. ``middle``: its centre."""
    along_y = flight.foot[0] == flight.top[0]
    half = flight.width / 2
    dx, dy = (half, 0.0) if along_y else (0.0, half)
    return (middle[0] - dx, middle[1] - dy), (middle[0] + dx, middle[1] + dy)


def _stair_ends(layout: BuildingLayout, number: int, room: str) -> list[tuple[Point, Rect]]:
    """Returns the feet and tops of stairs in a room: a point that must be reachable, and a zone that stays free."""
    ends = []
    for f in layout.flights:
        yaw = math.atan2(f.top[1] - f.foot[1], f.top[0] - f.foot[0])
        if number == 0 and room == f.lower_room:
            ends.append((_offset_point(f.foot, yaw, -0.45), flight_rect(f.foot, yaw, f.width, 0.0, LANDING)))
        if number == 1 and room == f.upper_room:
            ends.append((_offset_point(f.top, yaw, 0.45), flight_rect(f.top, yaw + math.pi, f.width, 0.0, LANDING)))
    return ends


def _offset_point(point: Point, yaw: float, distance: float) -> Point:
    """Returns the point at a distance in a direction."""
    return (point[0] + math.cos(yaw) * distance, point[1] + math.sin(yaw) * distance)


def _add_railings(furnishings: Furnishings, layout: BuildingLayout, number: int) -> None:
    """Adds a railing along the open long side of each opening in the upper floor."""
    if number != 1:
        return
    level = layout.levels[1]
    for flight in layout.flights:
        hall = next(s for s in level.spaces if s.name == flight.upper_room).rects[0]
        hole, thickness = flight.hole, 0.05
        if flight.foot[0] == flight.top[0]:
            left = hall.x1 - hole.x1 > hole.x0 - hall.x0
            middle, length = (
                ((hole.x1 + thickness / 2) if left else (hole.x0 - thickness / 2), (hole.y0 + hole.y1) / 2),
                hole.depth,
            )
            yaw = 0.0 if left else math.pi
        else:
            low = hall.y1 - hole.y1 > hole.y0 - hall.y0
            middle, length = (
                ((hole.x0 + hole.x1) / 2, (hole.y1 + thickness / 2) if low else (hole.y0 - thickness / 2)),
                hole.width,
            )
            yaw = math.pi / 2 if low else -math.pi / 2
        floor_z = round(level.height + layout.slab, 4)
        position = _rounded((middle[0], middle[1], floor_z))
        size = (thickness, round(length - 0.01, 3), 0.95)
        furnishings.pieces.append(
            Piece(furnishings.name("railing"), "railing", 1, flight.upper_room, position, round(yaw, 6), size)
        )


def _furnish_room(
    furnishings: Furnishings, layout: BuildingLayout, number: int, storey: Storey, room: Room, *, workplace: bool
) -> bool:
    """Furnishes a room in several attempts; returns whether one succeeded."""
    railings = [p for p in furnishings.pieces if p.kind == "railing" and p.room == room.name]
    blocked = [*_blocked_in_layout(layout, number), *(_footprint(p) for p in railings)]
    view = room_view(storey, room, blocked)
    for attempt in range(_ROOM_ATTEMPTS):
        snapshot = furnishings.snapshot()
        furnished = FurnishedRoom(
            view,
            number,
            storey.floor_z,
            storey.height,
            furnishings,
            _stair_ends(layout, number, room.name),
            strict=attempt < _ROOM_ATTEMPTS - 3,
            curtains=attempt < _ROOM_ATTEMPTS - 1,
            workplace=workplace,
        )
        if furnish(furnished):
            return True
        furnishings.restore(snapshot)
    return False


def _footprint(piece: Piece) -> Rect:
    """Returns the footprint of a piece."""
    cos, sin = abs(round(math.cos(piece.yaw))), abs(round(math.sin(piece.yaw)))
    half_x, half_y = (cos * piece.size[0] + sin * piece.size[1]) / 2, (sin * piece.size[0] + cos * piece.size[1]) / 2
    x, y, _ = piece.position
    return Rect(x - half_x, y - half_y, x + half_x, y + half_y)


def _start_poses(building: Building) -> tuple[Start, ...] | None:
    """Returns a start pose in each room, at the largest clearance, facing the centre; None if a robot cannot reach a room."""
    starts = []
    for number, storey in enumerate(building.storeys):
        views = {room.name: room_view(storey, room, blocked_floor(building, number)) for room in storey.rooms}
        grid = FloorGrid(building, number, views, with_bodies=True)
        for view in views.values():
            point = grid.most_open(view.cells, ROBOT_RADIUS)
            if point is None:
                return None
            middle = max(view.cells, key=lambda c: c.area).middle
            yaw = math.atan2(middle[1] - point[1], middle[0] - point[0])
            starts.append(Start(view.room.name, _rounded((point[0], point[1], storey.floor_z)), round(yaw, 3)))
    return tuple(starts)


def blocked_floor(building: Building, number: int) -> tuple[Rect, ...]:
    """Returns the stairs and openings of a storey in a building, which are not free floor."""
    rects = [flight_rect(s.foot, s.yaw, s.width, (s.steps - 1) * s.tread) for s in building.stairs if s.storey == number]
    rects += [bounding_rect(s.hole) for s in building.stairs if s.storey + 1 == number]
    return tuple(rects)


@dataclass(frozen=True, slots=True)
class _Palette:
    """Materials of one building."""

    floor: str
    """Floor material of living rooms and corridors."""
    soft_floor: str
    """Floor material of bedrooms and offices."""
    wet_floor: str
    wet_walls: str
    kitchen_floor: str
    kitchen_walls: str
    store_floor: str
    walls: str
    accents: tuple[str, ...]
    """Wall materials of some rooms."""


def palette(kind: BuildingKind, rng: np.random.Generator) -> _Palette:
    """Samples a palette for a kind of building."""

    def pick(*names: str) -> str:
        return names[int(rng.integers(len(names)))]

    if kind == "shop":
        floor = pick("tile_grey", "terrazzo", "vinyl_grey", "tile_checker", "concrete", "oak_planks")
    elif kind == "office":
        floor = pick("oak_planks", "vinyl_grey", "carpet_grey", "terrazzo", "parquet")
    else:
        floor = pick("oak_planks", "walnut_planks", "pine_planks", "parquet")
    soft = pick("carpet_grey", "carpet_blue", floor) if kind == "office" else pick(floor, floor, "carpet_beige", "carpet_grey")
    wet_floor = pick("tile_grey", "tile_white", "tile_checker", "terrazzo", "marble", "tile_terracotta")
    return _Palette(
        floor=floor,
        soft_floor=soft,
        wet_floor=wet_floor,
        wet_walls=pick("tile_white", "tile_metro", "tile_metro", "tile_grey", "marble"),
        kitchen_floor=pick(
            wet_floor, floor if not floor.startswith("carpet") else "vinyl_grey", "tile_terracotta", "tile_checker", "vinyl_grey"
        ),
        kitchen_walls=pick("plaster_white", "plaster_warm", "plaster_sage", "brick_white"),
        store_floor=pick("concrete", "vinyl_grey"),
        walls=pick("plaster_white", "plaster_white", "plaster_warm", "plaster_grey"),
        accents=tuple(
            pick("plaster_sage", "plaster_blue", "plaster_warm", "plaster_grey", "wallpaper_stripes", "brick_red", "brick_white")
            for _ in range(2)
        ),
    )


def surfaces(colours: _Palette, kind: str, rng: np.random.Generator) -> tuple[str, str]:
    """Samples the materials of floor and walls for a kind of room."""
    if kind in _WET:
        return colours.wet_floor, colours.wet_walls
    if kind in _COOKING:
        return colours.kitchen_floor, colours.kitchen_walls
    if kind == "storage":
        return colours.store_floor, "plaster_white"
    if kind in _ENTRY:
        return colours.floor, colours.walls
    accent = colours.accents[int(rng.integers(len(colours.accents)))] if rng.random() < 0.55 else colours.walls
    if kind in ("bedroom", "office", "open_office", "study", "meeting"):
        return colours.soft_floor, accent if not accent.startswith("brick") else colours.walls
    return colours.floor, accent if kind == "living" else colours.walls
