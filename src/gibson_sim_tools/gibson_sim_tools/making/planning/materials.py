"""Palettes of matching floor and wall materials, one for each building."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gibson_sim_tools.making.building import BuildingKind

_WET = ("bathroom", "toilet")
_COOKING = ("kitchen", "kitchenette")
_ENTRY = ("hall", "corridor")


@dataclass(frozen=True, slots=True)
class Palette:
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


def palette(kind: BuildingKind, rng: np.random.Generator) -> Palette:
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
    return Palette(
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


def surfaces(colours: Palette, kind: str, rng: np.random.Generator) -> tuple[str, str]:
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
