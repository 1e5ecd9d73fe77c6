"""Models the shell of a building: walls with openings, floors, ceilings, windows, door frames, stairs. NumPy only.

Walls run along x or y. Inner faces end exactly where they meet, at the room corners inset by half the thickness of the walls.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from gibson_sim.errors import SceneError
from gibson_sim_tools.making.blender.appearances import APPEARANCES, surface_of
from gibson_sim_tools.making.blender.shapes import F64, ObjectBuilder, Surface, pose_matrix
from gibson_sim_tools.making.building import Building, Opening, Point, Room, Stair, Storey, Wall

_SKIRTING_SIZE = (0.012, 0.07)
_MAX_CHART = 6.0
"""Maximum side of a chart, m; longer floors and walls are split."""
_BELOW_GROUND = 0.002
_TILE_PATTERNS = ("tile", "metro", "checker")
_FRAME = 0.055
_TRIM = (0.06, 0.014)
"""Width and thickness of the boards around a door, m."""


@dataclass
class ShellObject:
    """An object of the scene, or a light blocker."""

    name: str
    semantic_class: str
    solid: ObjectBuilder
    exported: bool = True
    """Whether it is part of the scene; False = it only blocks light in the bake."""


def build_shell(building: Building) -> list[ShellObject]:
    """Models walls, floors, ceilings, windows, frames and stairs of a building."""
    objects: list[ShellObject] = []
    for level, storey in enumerate(building.storeys):
        tag = "" if len(building.storeys) == 1 else f"_{level}"
        insets = {room.name: inset(room, storey) for room in storey.rooms}
        rng = np.random.default_rng((building.seed, 11, level))
        holes_in_ceiling = [s.hole for s in building.stairs if s.storey == level]
        holes_in_floor = [s.hole for s in building.stairs if s.storey == level - 1]
        for room in storey.rooms:
            solid = ObjectBuilder(rng)
            _add_level_surface(
                solid, insets[room.name], holes_in_floor, storey.floor_z, surface_of(room.floor, importance=1.5), up=True
            )
            _add_thresholds(solid, room, storey)
            # On the ground floor, robots stand on the ground plane; the floor slightly below it marks the rooms in maps.
            _add_slab_boxes(solid, insets[room.name], holes_in_floor, storey.floor_z - (0.0 if level else _BELOW_GROUND))
            objects.append(ShellObject(f"floor_{room.name}", "floor", solid))
            solid = ObjectBuilder(rng)
            _add_level_surface(
                solid,
                insets[room.name],
                holes_in_ceiling,
                storey.floor_z + storey.height,
                surface_of(room.ceiling, importance=0.5),
                up=False,
            )
            objects.append(ShellObject(f"ceiling_{room.name}", "ceiling", solid))
        rooms = {room.name: room for room in storey.rooms}
        for number, wall in enumerate(storey.walls):
            solid = ObjectBuilder(rng)
            _add_wall(solid, wall, storey, rooms, insets)
            objects.append(ShellObject(f"wall{tag}_{number}", "wall", solid))
            for k, opening in enumerate(wall.openings):
                solid = ObjectBuilder(rng)
                build = window if opening.kind == "window" else door_frame
                build(solid, wall, opening, storey.floor_z)
                if solid.parts:
                    name = "window" if opening.kind == "window" else "door_frame"
                    objects.append(ShellObject(f"{name}{tag}_{number}_{k}", name, solid))
        objects += _door_blockers(storey, rng, level)
    objects += _light_blockers(building)
    for number, flight in enumerate(building.stairs):
        solid = ObjectBuilder(np.random.default_rng((building.seed, 12, number)))
        low, high = building.storeys[flight.storey], building.storeys[flight.storey + 1]
        stair(solid, flight, low.floor_z, high.floor_z)
        slab_edges(solid, flight, low.floor_z + low.height, high.floor_z)
        objects.append(ShellObject(f"stair_{number}", "stairs", solid))
    return objects


def wall_axes(wall: Wall) -> tuple[F64, F64, float]:
    """Returns the direction of a wall, the direction to its left, unit vectors (2,), and its length, m.

    Raises:
        SceneError: the wall runs neither along x nor along y.
    """
    along = np.subtract(wall.end, wall.start)
    length = float(np.linalg.norm(along))
    if length < 1e-6 or np.abs(along).min() > 1e-6:
        raise SceneError(
            f"wall from {wall.start} to {wall.end}: must run along x or along y, and be longer than 0; change the plan"
        )
    u = along / length
    return u, np.array([-u[1], u[0]]), length


def inset(room: Room, storey: Storey) -> F64:
    """Returns the corners, (N, 2), m, of the inner faces of a room's walls."""
    corners = np.asarray(room.corners, dtype=float)
    next_corners = np.roll(corners, -1, axis=0)
    offsets = []
    for a, b in zip(corners, next_corners, strict=True):
        u = (b - a) / np.linalg.norm(b - a)
        offsets.append((np.array([-u[1], u[0]]), _half_thickness(room, storey, a, b)))
    result = []
    for k, corner in enumerate(corners):
        (n0, h0), (n1, h1) = offsets[k - 1], offsets[k]
        straight = abs(float(n0 @ n1)) > 0.5
        result.append(corner + n1 * h1 if straight else corner + n0 * h0 + n1 * h1)
    return np.array(result)


def _half_thickness(room: Room, storey: Storey, a: F64, b: F64) -> float:
    middle = (a + b) / 2
    for wall in storey.walls:
        if room.name not in (wall.left, wall.right):
            continue
        u, n, length = wall_axes(wall)
        offset = middle - np.asarray(wall.start)
        if abs(float(offset @ n)) < 1e-3 and abs(float((b - a) @ n)) < 1e-3:
            spans = sorted(float((p - np.asarray(wall.start)) @ u) for p in (a, b))
            if min(spans[1], length) - max(spans[0], 0.0) > 1e-3:
                return wall.thickness / 2
    return 0.0


def _cells(polygon: F64, holes: list[tuple[Point, ...]]) -> list[tuple[float, float, float, float]]:
    """Returns rectangles (x0, y0, x1, y1) that tile an axis-aligned polygon minus its holes."""
    points = [polygon, *(np.asarray(hole) for hole in holes)]
    lines = []
    for axis in (0, 1):
        low, high = polygon[:, axis].min(), polygon[:, axis].max()
        values = np.unique(np.round(np.concatenate([p[:, axis] for p in points]), 6))
        lines.append(values[(values >= low - 1e-6) & (values <= high + 1e-6)])
    cells = []
    for x0, x1 in zip(lines[0][:-1], lines[0][1:], strict=True):
        for y0, y1 in zip(lines[1][:-1], lines[1][1:], strict=True):
            middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
            if _inside(polygon, middle) and not any(_inside(np.asarray(hole), middle) for hole in holes):
                cells.append((float(x0), float(y0), float(x1), float(y1)))
    return cells


def _inside(polygon: F64, point: F64) -> bool:
    a, b = polygon, np.roll(polygon, -1, axis=0)
    crosses = (a[:, 1] > point[1]) != (b[:, 1] > point[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        x = a[:, 0] + (point[1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return bool(np.count_nonzero(crosses & (point[0] < x)) % 2)


def _add_level_surface(
    solid: ObjectBuilder, polygon: F64, holes: list[tuple[Point, ...]], z: float, surface: Surface, up: bool
) -> None:
    """Adds a floor or a ceiling, in charts of limited size."""
    size = np.ptp(polygon, axis=0)
    cuts = [np.linspace(polygon[:, k].min(), polygon[:, k].max(), int(np.ceil(size[k] / _MAX_CHART)) + 1) for k in (0, 1)]
    swap_axes = size[1] > size[0]
    for x0, y0, x1, y1 in _cells(polygon, holes):
        for a0, a1 in _split_interval(x0, x1, cuts[0]):
            for b0, b1 in _split_interval(y0, y1, cuts[1]):
                quad = np.array([(a0, b0, z), (a1, b0, z), (a1, b1, z), (a0, b1, z)])
                order = [0, 1, 2, 3] if up else [3, 2, 1, 0]
                pattern = (quad[:, [1, 0, 2]] if swap_axes else quad) * [1.0, 1.0, 0.0]
                part = solid.quad(quad[order], surface, pattern[order])
                plan_corners = part.vertices[part.triangles][..., :2]
                part.uv = plan_corners
                part.chart[:] = 100 * np.searchsorted(cuts[0], (a0 + a1) / 2) + np.searchsorted(cuts[1], (b0 + b1) / 2)
    _merge_parts(solid)


def _split_interval(low: float, high: float, cuts: F64) -> list[tuple[float, float]]:
    inner = [float(c) for c in cuts if low + 1e-6 < c < high - 1e-6]
    edges = [low, *inner, high]
    return list(itertools.pairwise(edges))


def _merge_parts(solid: ObjectBuilder) -> None:
    """Merges all parts into one; they must have the same surface."""
    first = solid.parts[0]
    shift = np.cumsum([0] + [len(p.vertices) for p in solid.parts])
    first.triangles = np.concatenate([p.triangles + s for p, s in zip(solid.parts, shift[:-1], strict=True)])
    for name in ("vertices", "uv", "chart", "pattern", "importance"):
        setattr(first, name, np.concatenate([getattr(p, name) for p in solid.parts]))
    solid.parts = [first]


def _add_thresholds(solid: ObjectBuilder, room: Room, storey: Storey) -> None:
    """Adds the floor in doors and passages, with the material of the room left of the wall, else right of it."""
    for wall in storey.walls:
        if (wall.left or wall.right) != room.name:
            continue
        u, n, _ = wall_axes(wall)
        for opening in wall.openings:
            if opening.sill > 0.01:
                continue
            middle = np.asarray(wall.start) + u * opening.middle
            half, deep = u * opening.width / 2, n * wall.thickness / 2
            corners = [middle - half - deep, middle + half - deep, middle + half + deep, middle - half + deep]
            quad = np.array([(*c, storey.floor_z) for c in corners])
            solid.quad(quad, surface_of(room.floor), quad * [1.0, 1.0, 0.0])


def _add_slab_boxes(solid: ObjectBuilder, polygon: F64, holes: list[tuple[Point, ...]], z: float) -> None:
    for x0, y0, x1, y1 in _cells(offset_polygon(polygon, 0.06), holes):
        solid.collide((x0, y0, z - 0.2), (x1, y1, z))


def offset_polygon(polygon: F64, distance: float) -> F64:
    """Returns a counter-clockwise polygon, (N, 2), with its sides moved outwards by ``distance``, m."""
    sides = np.roll(polygon, -1, axis=0) - polygon
    outward = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.linalg.norm(sides, axis=1, keepdims=True)
    previous = np.roll(outward, 1, axis=0)
    straight = np.abs(np.sum(previous * outward, axis=1, keepdims=True)) > 0.5
    return np.asarray(polygon + distance * np.where(straight, outward, previous + outward))


def _add_wall(solid: ObjectBuilder, wall: Wall, storey: Storey, rooms: dict[str, Room], insets: dict[str, F64]) -> None:
    u, n, length = wall_axes(wall)
    start = np.asarray(wall.start)
    for sign, name in ((1.0, wall.left), (-1.0, wall.right)):
        room = rooms.get(name)
        low, high = -wall.thickness / 2, length + wall.thickness / 2
        if room is not None:
            low, high = _span(wall, room, insets[name])
        surface = surface_of(room.walls) if room is not None else Surface("outside", APPEARANCES["outside"][1])
        _add_wall_face(solid, wall, sign, (low, high), storey, surface)
        if room is not None and not surface.material.startswith(_TILE_PATTERNS):
            _add_skirting(solid, wall, sign, (low, high), storey.floor_z)
    for a, b, z0, z1 in _panels(wall, (-wall.thickness / 2, length + wall.thickness / 2)):
        p, q = start + u * a - n * wall.thickness / 2, start + u * b + n * wall.thickness / 2
        solid.collide((*p, storey.floor_z + z0), (*q, storey.floor_z + z1))


def _span(wall: Wall, room: Room, inner: F64) -> tuple[float, float]:
    """Returns the interval of a wall that faces a room, m along the wall."""
    u, _, length = wall_axes(wall)
    span = [0.0, length]
    for k, corner in enumerate(np.asarray(room.corners, dtype=float)):
        for end, point in enumerate((wall.start, wall.end)):
            if np.linalg.norm(corner - point) < 1e-3:
                span[end] = float((inner[k] - np.asarray(wall.start)) @ u)
    return span[0], span[1]


def _panels(wall: Wall, span: tuple[float, float]) -> list[tuple[float, float, float, float]]:
    """Returns the rectangles, (start, end, low, high), of a wall around its openings; m, heights above the floor."""
    panels, at = [], span[0]
    for opening in sorted(wall.openings, key=lambda o: o.middle):
        a, b = opening.middle - opening.width / 2, opening.middle + opening.width / 2
        panels.append((at, a, 0.0, wall.height))
        panels.append((a, b, 0.0, opening.sill))
        panels.append((a, b, opening.sill + opening.height, wall.height))
        at = b
    panels.append((at, span[1], 0.0, wall.height))
    return [p for p in panels if p[1] - p[0] > 1e-4 and p[3] - p[2] > 1e-4]


def _add_wall_face(
    solid: ObjectBuilder, wall: Wall, sign: float, span: tuple[float, float], storey: Storey, surface: Surface
) -> None:
    """Adds one side of a wall with a continuous pattern, split into charts of limited size."""
    u, n, _ = wall_axes(wall)
    origin = np.asarray(wall.start) + n * sign * wall.thickness / 2
    cuts = np.linspace(*span, int(np.ceil((span[1] - span[0]) / _MAX_CHART)) + 1)
    first = len(solid.parts)
    for low, high, z0, z1 in _panels(wall, span):
        for a, b in _split_interval(low, high, cuts):
            flat = np.array([(a, z0), (b, z0), (b, z1), (a, z1)])
            if sign > 0:
                flat = flat[::-1]
            quad = np.column_stack([origin + flat[:, :1] * u, flat[:, 1] + storey.floor_z])
            pattern = np.column_stack([flat[:, 0] + float(origin @ u) + 40.0, flat[:, 1], np.zeros(4)])
            part = solid.quad(quad, surface, pattern)
            part.uv = flat[part.triangles]
            part.chart[:] = np.searchsorted(cuts, (a + b) / 2)
    if first < len(solid.parts):
        rest, solid.parts = solid.parts[:first], solid.parts[first:]
        _merge_parts(solid)
        solid.parts = rest + solid.parts


def _add_skirting(solid: ObjectBuilder, wall: Wall, sign: float, span: tuple[float, float], z: float) -> None:
    u, n, _ = wall_axes(wall)
    inner = n * sign * wall.thickness / 2
    at = span[0]
    ends = [
        (o.middle - o.width / 2 - 0.06, o.middle + o.width / 2 + 0.06)
        for o in sorted(wall.openings, key=lambda o: o.middle)
        if o.sill < 0.01
    ]
    for a, b in [*ends, (span[1], span[1])]:
        if a - at > 0.02:
            p = np.asarray(wall.start) + u * at + inner
            q = np.asarray(wall.start) + u * a + inner + n * sign * _SKIRTING_SIZE[0]
            side = {(1, 0): "+x", (-1, 0): "-x", (0, 1): "+y", (0, -1): "-y"}[(round(-n[0] * sign), round(-n[1] * sign))]
            solid.box((*p, z), (*q, z + _SKIRTING_SIZE[1]), surface_of("wood_white"), 0.004, f"-z {side}")
        at = b


def _door_blockers(storey: Storey, rng: np.random.Generator, level: int) -> list[ShellObject]:
    """Returns blockers in outside doors; their leaves are movable bodies and not part of the bake."""
    objects = []
    for number, wall in enumerate(storey.walls):
        u, n, _ = wall_axes(wall)
        for opening in wall.openings:
            if opening.kind == "door" and not (wall.left and wall.right):
                solid, middle = ObjectBuilder(rng), np.asarray(wall.start) + u * opening.middle
                low, high = middle - u * opening.width / 2 - n * 0.01, middle + u * opening.width / 2 + n * 0.01
                solid.box(
                    (*low, storey.floor_z), (*high, storey.floor_z + opening.height), Surface("outside", (0.5, 0.5, 0.5)), 0
                )
                objects.append(ShellObject(f"shut_{level}_{number}", "", solid, exported=False))
    return objects


def _light_blockers(building: Building) -> list[ShellObject]:
    """Returns light blockers above the highest and below the lowest storey."""
    surface = Surface("outside", (0.5, 0.5, 0.5))
    ends = [(building.storeys[-1], building.storeys[-1].height + 0.3), (building.storeys[0], -0.1)]
    objects = []
    for number, (storey, height) in enumerate(ends):
        solid = ObjectBuilder(np.random.default_rng((building.seed, 13, number)))
        points = np.array([p for wall in storey.walls for p in (wall.start, wall.end)])
        (x0, y0), (x1, y1) = points.min(axis=0) - 0.3, points.max(axis=0) + 0.3
        z = storey.floor_z + height
        solid.box((x0, y0, z), (x1, y1, z + 0.05), surface, 0)
        objects.append(ShellObject(f"lid_{number}", "", solid, exported=False))
    return objects


class _OpeningFrame:
    """Local frame of an opening, m: along the wall from its centre, to the left from the wall's centre plane, up from the lower edge."""

    def __init__(self, wall: Wall, opening: Opening, floor_z: float) -> None:
        u = np.subtract(wall.end, wall.start)
        self.u = u / np.linalg.norm(u)
        self.n = np.array([-self.u[1], self.u[0]])
        self.middle = np.asarray(wall.start) + self.u * opening.middle
        self.z = floor_z + opening.sill

    def at(self, along: float, out: float, up: float) -> F64:
        return np.array([*(self.middle + self.u * along + self.n * out), self.z + up])


def _reveal(s: ObjectBuilder, frame: _OpeningFrame, wall: Wall, opening: Opening, surface: Surface, below: bool) -> None:
    """Adds the reveals of an opening."""
    a, t, h = opening.width / 2, wall.thickness / 2, opening.height
    s.quad([frame.at(-a, t, 0), frame.at(-a, -t, 0), frame.at(-a, -t, h), frame.at(-a, t, h)][::-1], surface)
    s.quad([frame.at(a, -t, 0), frame.at(a, t, 0), frame.at(a, t, h), frame.at(a, -t, h)][::-1], surface)
    s.quad([frame.at(-a, -t, h), frame.at(a, -t, h), frame.at(a, t, h), frame.at(-a, t, h)][::-1], surface)
    if below:
        s.quad([frame.at(-a, -t, 0), frame.at(a, -t, 0), frame.at(a, t, 0), frame.at(-a, t, 0)], surface)


def window(s: ObjectBuilder, wall: Wall, opening: Opening, floor_z: float) -> None:
    """Adds frame, mullions, handles and inner sill of a window; the frame is near the outside."""
    frame, a, h = _OpeningFrame(wall, opening, floor_z), opening.width / 2, opening.height
    inside = 1.0 if wall.left else -1.0
    _reveal(s, frame, wall, opening, surface_of("plaster_white"), below=True)
    if opening.sill > 0.2:
        s.box(
            frame.at(-a - 0.04, inside * wall.thickness / 2, -0.025),
            frame.at(a + 0.04, inside * (wall.thickness / 2 + 0.035), 0.004),
            surface_of("wood_white"),
            0.004,
        )
        s.box(frame.at(-a, inside * wall.thickness / 2, 0.001), frame.at(a, 0, 0.004), surface_of("wood_white"), 0)
    if opening.body:
        return
    white, out = surface_of("plastic_white"), -inside * (wall.thickness / 2 - 0.07)
    front, back = out - 0.03, out + 0.03
    s.box(frame.at(-a, front, 0), frame.at(-a + _FRAME, back, h), white, 0.005)
    s.box(frame.at(a, front, 0), frame.at(a - _FRAME, back, h), white, 0.005)
    s.box(frame.at(-a + _FRAME, front, 0), frame.at(a - _FRAME, back, _FRAME), white, 0.005)
    s.box(frame.at(-a + _FRAME, front, h - _FRAME), frame.at(a - _FRAME, back, h), white, 0.005)
    count = max(1, round(opening.width / 0.9))
    for k in range(1, count):
        x = -a + opening.width * k / count
        s.box(frame.at(x - 0.045, front, _FRAME), frame.at(x + 0.045, back, h - _FRAME), white, 0.005)
    for k in range(count):
        x0, x1 = -a + opening.width * k / count, -a + opening.width * (k + 1) / count
        handle = x1 - 0.03 if k % 2 == 0 else x0 + 0.03
        grip = out + inside * 0.05
        if opening.sill < 1.4:
            s.tube(
                [frame.at(handle, out, h * 0.45), frame.at(handle, grip, h * 0.45), frame.at(handle, grip, h * 0.45 - 0.11)],
                0.008,
                surface_of("metal_steel"),
                6,
            )
    low, high = frame.at(-a, -0.04, 0), frame.at(a, 0.04, h)
    s.collide(low, high)


def door_frame(s: ObjectBuilder, wall: Wall, opening: Opening, floor_z: float) -> None:
    """Adds the lining and the trim of a door, or the reveals of a passage; the clear opening keeps its planned width."""
    frame, a, h = _OpeningFrame(wall, opening, floor_z), opening.width / 2, opening.height
    if opening.kind == "passage":
        _reveal(s, frame, wall, opening, surface_of("plaster_white"), below=False)
        return
    white = surface_of("wood_white")
    _reveal(s, frame, wall, opening, white, below=False)
    for side, room in ((1.0, wall.left), (-1.0, wall.right)):
        if not room:
            continue
        t0, t1 = side * wall.thickness / 2, side * (wall.thickness / 2 + _TRIM[1])
        for k in (-1, 1):
            s.box(frame.at(k * a, t0, 0), frame.at(k * (a + _TRIM[0]), t1, h + _TRIM[0]), white, 0.004)
        s.box(frame.at(-a, t0, h), frame.at(a, t1, h + _TRIM[0]), white, 0.004)


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
