"""A building as a plan: rooms, walls, openings, furniture, lamps. What the generator decides and the modeller builds. Plain values.

The frame is that of the scene: z up, metres, the ground floor at z = 0. A piece of furniture has its own frame: the origin in the middle of its
underside, x to its front, y to its left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from gibson_sim.types import Vec3

Point = tuple[float, float]
BuildingKind = Literal["flat", "house", "office", "shop"]
OpeningKind = Literal["door", "window", "passage"]


@dataclass(frozen=True, slots=True)
class Opening:
    """A hole in a wall."""

    kind: OpeningKind
    middle: float
    """From the start of the wall to the middle of the opening, metres along it."""
    width: float
    sill: float
    """Height of its lower edge above the floor of its storey; 0 for doors and passages."""
    height: float
    """Of the opening itself."""
    swing: int = 0
    """Of a door: 1 = it opens to the left of the wall's direction, -1 = to the right; 0 = no leaf."""
    hinge: Literal["start", "end"] = "start"
    """Side of the opening, along the wall, at which a door hangs."""
    body: str = ""
    """Name of the object (a folder of ``scenes/objects``) that hangs in a door as a body that moves; empty = none."""


@dataclass(frozen=True, slots=True)
class Wall:
    """A straight wall, by its middle line."""

    start: Point
    end: Point
    thickness: float
    height: float
    left: str = ""
    """Name of the room on the left of its direction; empty = outside."""
    right: str = ""
    openings: tuple[Opening, ...] = ()


@dataclass(frozen=True, slots=True)
class Room:
    """A room, bounded by the middle lines of its walls."""

    name: str
    kind: str
    """``living``, ``kitchen``, ``bedroom``, ``bathroom``, ``hall``, ``corridor``, ``office``, ``meeting``, ``shop``, ``storage``, ..."""
    corners: tuple[Point, ...]
    """Counter-clockwise, seen from above."""
    floor: str = "oak_planks"
    """Names of materials: see ``MATERIALS``."""
    walls: str = "plaster_white"
    ceiling: str = "plaster_white"


@dataclass(frozen=True, slots=True)
class Storey:
    """A floor of a building with what stands around it."""

    floor_z: float
    height: float
    """From the floor to the ceiling, metres."""
    rooms: tuple[Room, ...]
    walls: tuple[Wall, ...]


@dataclass(frozen=True, slots=True)
class Stair:
    """A straight flight from a storey to the one above."""

    storey: int
    foot: Point
    """Middle of the lower edge of the first step."""
    yaw: float
    """Direction in which it rises, radians."""
    width: float
    tread: float
    """Depth of a step, metres."""
    steps: int
    """Rises, all equal. There is one tread fewer, since the last rise ends on the floor above: the flight is ``(steps - 1) * tread`` long."""
    hole: tuple[Point, ...]
    """Corners of the hole in the floor above, counter-clockwise."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Furniture, or anything else that stands, hangs or lies and does not move."""

    name: str
    """Its own; unique in the building."""
    kind: str
    """What it is: a name of ``catalogue.CATALOGUE``."""
    storey: int
    room: str
    position: Vec3
    yaw: float
    size: Vec3
    """Depth (x), width (y), height (z), metres."""
    seed: int = 0
    """Decides its details and colours."""


@dataclass(frozen=True, slots=True)
class Body:
    """Something that moves: an object of ``scenes/objects``, as a body of its own."""

    name: str
    model: str
    """Name of the folder of the object."""
    position: Vec3
    yaw: float = 0.0
    joints: Mapping[str, float] = field(default_factory=dict)
    """Where its joints are at the start: radians or metres."""


@dataclass(frozen=True, slots=True)
class Lamp:
    """A source of light that the bake sees."""

    kind: Literal["ceiling", "pendant", "floor", "desk", "panel", "spot"]
    position: Vec3
    """Of the middle of what shines."""
    power: float
    """Watts of light, as Blender counts them."""
    temperature: float = 3000.0
    """Kelvin."""
    size: float = 0.2
    """Diameter, or edge, of what shines, metres."""


@dataclass(frozen=True, slots=True)
class Start:
    """A named place for a robot."""

    name: str
    position: Vec3
    yaw: float


@dataclass(frozen=True, slots=True)
class Building:
    """All of it."""

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
    """The way the sun's light travels."""
    sun: float = 3.0
    """Strength of the sun, W/m²."""
    sky: float = 1.0
    """Strength of the sky."""


MATERIALS = (
    "plaster_white", "plaster_warm", "plaster_sage", "plaster_blue", "plaster_grey", "brick_red", "brick_white", "concrete", "wallpaper_stripes",
    "oak_planks", "walnut_planks", "pine_planks", "parquet", "tile_white", "tile_grey", "tile_terracotta", "tile_checker", "tile_metro",
    "carpet_grey", "carpet_beige", "carpet_blue", "vinyl_grey", "marble", "terrazzo",
    "wood_oak", "wood_walnut", "wood_pine", "wood_white", "wood_black", "fabric_grey", "fabric_beige", "fabric_blue", "fabric_green", "fabric_red",
    "fabric_striped", "leather_brown", "leather_black", "metal_steel", "metal_black", "metal_brass", "plastic_white", "plastic_black", "plastic_red",
    "ceramic_white", "glass", "mirror", "stone_dark", "paper", "leaves", "soil", "screen", "cardboard",
)  # fmt: skip
"""Names that surfaces may have."""
