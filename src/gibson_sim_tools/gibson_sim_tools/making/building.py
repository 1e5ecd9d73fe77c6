"""Plan of a building: rooms, walls, openings, furniture, lamps. Output of the planner, input of the modeller. Plain values; NumPy only.

The frame is that of the scene: z up, metres, the ground floor at z = 0. The frame of a piece of furniture has its origin at the centre of the
underside, x to the front, y to the left. Plans are read and written as JSON, for a process with another Python interpreter.
"""

from __future__ import annotations

import dataclasses
import json
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from gibson_sim.errors import SceneError
from gibson_sim.types import Vec3
from gibson_sim.writing import write_file

Point = tuple[float, float]
BuildingKind = Literal["flat", "house", "office", "shop"]
OpeningKind = Literal["door", "window", "passage"]


@dataclass(frozen=True, slots=True)
class Opening:
    """An opening in a wall: door, window or passage."""

    kind: OpeningKind
    middle: float
    """Distance from the start of the wall to the middle of the opening, m."""
    width: float
    """Width of the opening, m."""
    sill: float
    """Height of the lower edge above the floor, m; 0 for doors and passages."""
    height: float
    """Height of the opening, m."""
    swing: int = 0
    """Side to which a door opens: 1 = left of the wall's direction, -1 = right, 0 = no leaf."""
    hinge: Literal["start", "end"] = "start"
    """End of the opening, along the wall, with the hinge of a door."""
    body: str = ""
    """Name of the object (folder in ``scenes/objects``) for the movable leaf of a door; empty = none."""


@dataclass(frozen=True, slots=True)
class Wall:
    """A straight wall along its centre line."""

    start: Point
    end: Point
    thickness: float
    height: float
    left: str = ""
    """Name of the room to the left of its direction; empty = outside."""
    right: str = ""
    """Name of the room to the right; empty = outside."""
    openings: tuple[Opening, ...] = ()


@dataclass(frozen=True, slots=True)
class Room:
    """A room, bounded by the centre lines of its walls."""

    name: str
    kind: str
    """``living``, ``kitchen``, ``bedroom``, ``bathroom``, ``hall``, ``corridor``, ``office``, ``meeting``, ``shop``, ``storage``, ..."""
    corners: tuple[Point, ...]
    """Corners, counter-clockwise seen from above, m."""
    floor: str = "oak_planks"
    """Materials, from ``MATERIALS``."""
    walls: str = "plaster_white"
    ceiling: str = "plaster_white"


@dataclass(frozen=True, slots=True)
class Storey:
    """A storey: its rooms and walls."""

    floor_z: float
    """Height of the floor, m."""
    height: float
    """Height of the ceiling above the floor, m."""
    rooms: tuple[Room, ...]
    walls: tuple[Wall, ...]


@dataclass(frozen=True, slots=True)
class Stair:
    """A straight flight from a storey to the one above."""

    storey: int
    """Index of the lower storey."""
    foot: Point
    """Middle of the lower edge of the first step, m."""
    yaw: float
    """Direction of ascent, radians."""
    width: float
    tread: float
    """Depth of a step, m."""
    steps: int
    """Number of equal rises. The last rise ends on the floor above, so the flight is ``(steps - 1) * tread`` long."""
    hole: tuple[Point, ...]
    """Corners of the opening in the floor above, counter-clockwise, m."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A piece of furniture, or another static object."""

    name: str
    """Name, unique in the building."""
    kind: str
    """Key of ``catalogue.CATALOGUE``."""
    storey: int
    room: str
    position: Vec3
    yaw: float
    size: Vec3
    """Depth (x), width (y), height (z), m."""
    seed: int = 0
    """Seed of its details and colours."""


@dataclass(frozen=True, slots=True)
class Body:
    """A movable body: an object of ``scenes/objects``."""

    name: str
    model: str
    """Folder name of the object."""
    position: Vec3
    yaw: float = 0.0
    joints: Mapping[str, float] = field(default_factory=dict)
    """Initial joint positions, radians or m."""


@dataclass(frozen=True, slots=True)
class Lamp:
    """A light source in the bake."""

    kind: Literal["ceiling", "pendant", "floor", "desk", "panel", "spot"]
    position: Vec3
    """Centre of the light-emitting part, m."""
    power: float
    """Power, W, as defined by Blender."""
    temperature: float = 3000.0
    """Colour temperature, K."""
    size: float = 0.2
    """Diameter or edge of the light-emitting part, m."""


@dataclass(frozen=True, slots=True)
class Start:
    """A named start pose."""

    name: str
    position: Vec3
    yaw: float


@dataclass(frozen=True, slots=True)
class Building:
    """Plan of a whole building."""

    name: str
    kind: BuildingKind
    seed: int
    storeys: tuple[Storey, ...]
    pieces: tuple[Piece, ...]
    bodies: tuple[Body, ...]
    lamps: tuple[Lamp, ...]
    starts: tuple[Start, ...]
    stairs: tuple[Stair, ...] = ()
    sun_direction: Vec3 = (0.45, 0.6, -0.66)
    """Direction in which sunlight travels."""
    sun: float = 3.0
    """Strength of the sun, W/m²."""
    sky: float = 1.0
    """Strength of the sky, relative to a typical one."""


MATERIALS = (
    "plaster_white", "plaster_warm", "plaster_sage", "plaster_blue", "plaster_grey", "brick_red", "brick_white", "concrete", "wallpaper_stripes",
    "oak_planks", "walnut_planks", "pine_planks", "parquet", "tile_white", "tile_grey", "tile_terracotta", "tile_checker", "tile_metro",
    "carpet_grey", "carpet_beige", "carpet_blue", "vinyl_grey", "marble", "terrazzo",
    "wood_oak", "wood_walnut", "wood_pine", "wood_white", "wood_black", "fabric_grey", "fabric_beige", "fabric_blue", "fabric_green", "fabric_red",
    "fabric_striped", "leather_brown", "leather_black", "metal_steel", "metal_black", "metal_brass", "plastic_white", "plastic_black", "plastic_red",
    "ceramic_white", "glass", "mirror", "stone_dark", "paper", "leaves", "soil", "screen", "cardboard",
)  # fmt: skip
"""Names of surface materials."""


@dataclass(frozen=True, slots=True)
class Quality:
    """Resolution and samples of a bake."""

    atlases: int
    """Number of light maps."""
    size_px: int
    """Edge of each light map, texels."""
    samples: int
    """Samples per texel of the light."""
    jpeg: int = 85
    """JPEG quality of base colours, 1 to 100."""

    def __post_init__(self) -> None:
        if self.atlases < 1 or self.samples < 1 or self.size_px < 64 or not 1 <= self.jpeg <= 100:
            raise SceneError(f"quality is {self}; atlases and samples must be at least 1, size_px at least 64, jpeg 1 to 100")


QUALITIES = {
    "smallest": Quality(1, 1024, 1),
    "draft": Quality(2, 1024, 4),
    "normal": Quality(2, 1152, 16),
    "high": Quality(2, 1152, 64),
}


def write_plan(path: Path, building: Building, quality: Quality) -> None:
    """Writes a plan; equal plans give identical files."""
    values = {"building": dataclasses.asdict(building), "quality": dataclasses.asdict(quality)}
    write_file(path, json.dumps(values, sort_keys=True, separators=(",", ":")) + "\n")


def read_plan(path: Path) -> tuple[Building, Quality]:
    """Reads a plan that ``write_plan`` wrote.

    Raises:
        SceneError: the file is not a plan.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        return _read(Building, values["building"]), _read(Quality, values["quality"])
    except (OSError, ValueError, KeyError, TypeError) as e:
        raise SceneError(f"{path}: is not the plan of a building: {e}; write it again") from e


def _read(annotation: Any, value: Any) -> Any:
    """Converts a JSON value to an annotated type."""
    if dataclasses.is_dataclass(annotation):
        hints = typing.get_type_hints(annotation)
        return annotation(**{f.name: _read(hints[f.name], value[f.name]) for f in dataclasses.fields(annotation)})  # type: ignore[operator]
    origin, args = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is tuple:
        items = args[:1] * len(value) if args[-1] is Ellipsis else args
        return tuple(_read(item, v) for item, v in zip(items, value, strict=True))
    if origin is Mapping:
        return {str(k): _read(args[1], v) for k, v in value.items()}
    return value if origin is typing.Literal else annotation(value)
