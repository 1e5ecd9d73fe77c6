"""Furnishes kitchens, bathrooms and toilets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from gibson_sim_tools.making.building import Point
from gibson_sim_tools.making.planning.furnishing.dressing import fill_corners, hang_pictures
from gibson_sim_tools.making.planning.furnishing.groups import (
    Group,
    far_from_doors,
    near_corner,
    place_at_wall,
    put_table,
    wall_of,
)
from gibson_sim_tools.making.planning.objects import SIZES
from gibson_sim_tools.making.planning.rooms import WallFace
from gibson_sim_tools.making.planning.space import FurnishedRoom, FurnishingItem

_RUN_DEPTH = 0.62
_RUN_HEIGHT = 0.91
_FRIDGE_WIDTH = 0.64
"""Width of the slot for a fridge, m."""
_WORK_DEPTH = 0.9
"""Depth of free floor in front of a kitchen run, m."""


@dataclass(frozen=True, slots=True)
class _Module:
    """One module of a kitchen run: an interval of the wall, m."""

    kind: str
    low: float
    high: float

    @property
    def middle(self) -> float:
        return (self.low + self.high) / 2

    @property
    def width(self) -> float:
        return round(self.high - self.low, 3)


def furnish_kitchen(room: FurnishedRoom) -> bool:
    """Furnishes a kitchen: a run of counters with sink, stove and fridge, wall cupboards, and a table if it fits."""
    if not _put_run(room):
        return False
    if room.view.area > 8.5:
        small = room.view.area < 13.0
        chair = "chair_wooden" if room.rng.random() < 0.4 else "chair"
        sizes = ((1.4, 0.8), (0.9, 0.75)) if small else ((1.7, 0.9), (1.4, 0.8), (0.9, 0.75))
        placed = any(
            put_table(
                room,
                "dining_table",
                chair,
                [((2, 2), 0)] if width > 1.0 else [((1, 1), 0)],
                _far_from_doors(room),
                at_wall=True,
                width=width,
                depth=depth,
            )
            for width, depth in sizes
        )
        if room.strict and not placed:
            return False
    hang_pictures(room, 1)
    if room.rng.random() < 0.4:
        fill_corners(room, "plant", 1)
    return True


def _far_from_doors(room: FurnishedRoom) -> Callable[[Point], float]:
    """Returns a score that is higher far from doors."""
    return lambda point: 0.5 * room.distance_to_doors(point)


def furnish_kitchenette(room: FurnishedRoom) -> bool:
    """Furnishes the kitchenette of an office."""
    if not _put_run(room):
        return False
    sizes = ((1.4, 0.8), (0.9, 0.75))
    placed = any(
        put_table(room, "dining_table", "chair", [((1, 1), 0)], _far_from_doors(room), at_wall=True, width=w, depth=d)
        for w, d in sizes
    )
    if room.strict and not placed:
        return False
    hang_pictures(room, 1)
    return True


def _put_run(room: FurnishedRoom) -> bool:
    """Places a kitchen run along the best wall, and hangs cupboards above it; returns whether it fits."""
    free_intervals = [(f, low, high) for f in room.view.sides for low, high in room.free_intervals(f, _RUN_DEPTH + 0.02, 1.0)]
    free_intervals.sort(key=lambda s: -min(s[2] - s[1], 4.3) + 0.4 * float(room.rng.random()))
    oven = bool(room.rng.random() < 0.6)
    for with_fridge in (True, False):
        for face, low, high in free_intervals:
            run = _place_run(room, face, low, high, with_fridge, oven)
            if run and not with_fridge and not _place_fridge(room):
                return False
            if run:
                _hang_cupboards(room, face, run)
                return True
    return False


def _place_run(
    room: FurnishedRoom, face: WallFace, low: float, high: float, with_fridge: bool, oven: bool
) -> list[_Module] | None:
    """Places a run in a free interval of a wall; returns its modules, None if it does not fit."""
    min_length = 0.8 + 0.6 + 0.9 + (_FRIDGE_WIDTH if with_fridge else 0.0)
    if high - low < min_length:
        return None
    length = min(high - low, 4.3 if room.kind == "kitchen" else 3.2)
    starts = [low, high - length] if low - face.low < face.high - high else [high - length, low]
    for start in starts:
        for backwards in (False, True) if room.rng.random() < 0.5 else (True, False):
            modules = _modules(room, start, length, with_fridge, backwards)
            items = [p for m in modules for p in _module_items(room, face, m, oven)]
            if room.place(items, [face.rect(start, start + length, _RUN_DEPTH + 0.07, _RUN_DEPTH + _WORK_DEPTH)]):
                return modules
    return None


def _modules(room: FurnishedRoom, start: float, length: float, with_fridge: bool, backwards: bool) -> list[_Module]:
    """Returns the modules of a run: fridge, counter, sink, counter, stove, counter."""
    sink = round(float(room.rng.uniform(0.8, 0.9)), 2)
    rest = length - sink - 0.6 - (_FRIDGE_WIDTH if with_fridge else 0.0)
    if rest < 0.9:
        sink, rest = 0.8, rest + sink - 0.8
    if room.kind == "kitchenette":
        widths = [("kitchen_counter", rest / 2 + 0.3), ("kitchen_sink", sink), ("kitchen_counter", rest / 2 + 0.3)]
    else:
        shares = [0.3 + (rest - 0.9) * item for item in (0.4, 0.35, 0.25)]
        widths = [("kitchen_counter", shares[0]), ("kitchen_sink", sink), ("kitchen_counter", shares[1])]
        widths += [("stove", 0.6), ("kitchen_counter", shares[2])]
    if with_fridge:
        widths.insert(0, ("fridge_body", _FRIDGE_WIDTH))
    modules, at = [], 0.0
    for kind, width in widths:
        low, high = (length - at - width, length - at) if backwards else (at, at + width)
        modules.append(_Module(kind, round(start + low, 4), round(start + high, 4)))
        at += width
    return modules


def _module_items(room: FurnishedRoom, face: WallFace, module: _Module, oven: bool) -> list[FurnishingItem]:
    """Returns the items of one module."""
    size = (_RUN_DEPTH, module.width, _RUN_HEIGHT)
    if module.kind == "fridge_body":
        fridge = SIZES["fridge_body"]
        return [FurnishingItem("fridge_body", face.point(module.middle, fridge[0] / 2 + 0.02), face.yaw, fridge, movable=True)]
    if module.kind != "stove":
        return [room.on_wall(module.kind, face, module.middle, size)]
    lift = 1.58
    hood = room.size("extractor_hood", width=0.6, height=round(min(0.9, room.height - lift - 0.02), 3))
    items = [room.on_wall("extractor_hood", face, module.middle, hood, lift)]
    if oven:
        # A hob in the worktop, above an oven with a movable door.
        size = SIZES["oven_body"]
        body = FurnishingItem("oven_body", face.point(module.middle, size[0] / 2 + 0.02), face.yaw, size, movable=True)
        return [*items, room.on_wall("hob", face, module.middle, (_RUN_DEPTH, 0.6, round(_RUN_HEIGHT - 0.61, 3)), 0.61), body]
    return [*items, room.on_wall("stove", face, module.middle, (_RUN_DEPTH, 0.6, _RUN_HEIGHT))]


def _place_fridge(room: FurnishedRoom) -> bool:
    """Places a fridge apart from the run, in a corner if possible; returns whether it fits."""
    size = SIZES["fridge_body"]
    return bool(
        room.place_first(
            ([item], [item.front(0.8)])
            for item in (
                FurnishingItem("fridge_body", face.point(along, size[0] / 2 + 0.02), face.yaw, size, movable=True)
                for face, along in room.wall_positions(size[1] + 0.04, score=near_corner(room, 0.64))
            )
        )
    )


def _hang_cupboards(room: FurnishedRoom, face: WallFace, modules: list[_Module]) -> None:
    """Hangs cupboards above the counters on both sides of the hood, clear of windows."""
    lift = room.lift("wall_cupboard")
    depth, _, height = room.size("wall_cupboard", height=round(min(0.72, room.height - lift - 0.05), 3))
    spans: list[list[float]] = []
    for module in sorted(modules, key=lambda m: m.low):
        if module.kind in ("fridge_body", "stove"):
            continue
        if spans and abs(spans[-1][1] - module.low) < 1e-3 and module.high - spans[-1][0] <= 2.4:
            spans[-1][1] = module.high
        else:
            spans.append([module.low, module.high])
    for low, high in spans:
        for start, end in _clear_of_windows(room, face, low, high):
            if end - start >= 0.4:
                width = round(end - start - 0.004, 3)
                room.place([room.on_wall("wall_cupboard", face, (start + end) / 2, (depth, width, height), lift)])


def _clear_of_windows(room: FurnishedRoom, face: WallFace, low: float, high: float) -> Iterator[tuple[float, float]]:
    """Yields the sub-intervals of a wall interval that are clear of windows."""
    strip, axis = face.rect(low, high, 0.0, 0.1), 0 if face.along[0] else 1
    window_zones = [w.zone.grown(0.05) for w in room.view.windows if w.zone.overlaps(strip)]
    spans = sorted(
        tuple(sorted((edge - face.start[axis]) * face.along[axis] for edge in (r[axis], r[axis + 2]))) for r in window_zones
    )
    for start, end in spans:
        if start > low:
            yield low, min(start, high)
        low = max(low, end)
    if low < high:
        yield low, high


def furnish_bathroom(room: FurnishedRoom) -> bool:
    """Furnishes a bathroom: bath or shower, basin with mirror, toilet, sometimes a washing machine."""
    is_large = room.view.area > 7.0
    prefers_bath = (room.view.area > 4.6 and room.rng.random() < 0.6) or is_large
    placed = _put_bath(room) if prefers_bath else _put_shower(room)
    if not placed and not (_put_shower(room) if prefers_bath else _put_bath(room)):
        return False
    if not _put_toilet(room) or not _put_basin(room, 0.55 if room.view.area < 4.5 else 0.7):
        return False
    if is_large and room.rng.random() < 0.7:
        _put_shower(room)
    if room.rng.random() < 0.75:
        place_at_wall(room, "washing_machine", near_corner(room, 0.6))
    return True


def furnish_toilet(room: FurnishedRoom) -> bool:
    """Furnishes a room with a toilet and a basin."""
    return _put_toilet(room) and _put_basin(room, 0.55)


def _put_bath(room: FurnishedRoom) -> bool:
    return place_at_wall(room, "bath", lambda f, a: far_from_doors(room)(f, a) - 3.0 * room.corner_gap(f, a, 1.7)) is not None


def _put_shower(room: FurnishedRoom) -> bool:
    size = room.size("shower")
    return bool(
        room.place_first(
            ([item], [item.front(0.5)])
            for face, along in room.wall_positions(size[1] + 0.02, score=far_from_doors(room), step=5.0)
            for item in [room.on_wall("shower", face, along, size)]
        )
    )


def _put_toilet(room: FurnishedRoom) -> bool:
    """Places the toilet at a wall, with space on both sides, far from doors; returns whether it fits."""
    size = room.size("toilet")
    return bool(
        room.place_first(
            ([item], [item.front(0.55)])
            for item in (
                room.on_wall("toilet", face, along, size)
                for face, along in room.wall_positions(size[1] + 0.4, score=far_from_doors(room))
            )
        )
    )


def _put_basin(room: FurnishedRoom, width: float) -> bool:
    """Places a basin at a wall without a window, with a mirror above it; returns whether both fit."""
    size = room.size("basin", width=width)
    mirror = room.size("bathroom_mirror", width=0.5 if width < 0.65 else 0.65)
    lift = room.lift("bathroom_mirror")

    def groups() -> Iterator[Group]:
        for face, along in room.wall_positions(size[1] + 0.1):
            basin = room.on_wall("basin", face, along, size)
            yield [basin, room.on_wall("bathroom_mirror", face, along, mirror, lift)], [basin.front(0.6)]

    placed = room.place_first(groups())
    return placed is not None and wall_of(room, placed[0]) is not None
