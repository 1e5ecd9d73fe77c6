"""Catalogue of furniture: size ranges, placement, use as a table top. Shared by the planner and the modeller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class PieceKind:
    """A kind of furniture; ranges in metres."""

    semantic_class: str
    depth: Range
    width: Range
    height: Range
    stands: Literal["wall", "free", "corner", "ceiling", "hangs", "lies", "table"] = "wall"
    """Placement: back to a wall; anywhere on the floor; in a corner; under the ceiling; on a wall; flat on the floor, as a rug; on a table."""
    front: float = 0.6
    """Depth of free floor in front of it, m."""
    lift: Range = (0.0, 0.0)
    """Height of the underside above the floor, m; for ``ceiling``: distance of the underside below the ceiling."""
    top: bool = False
    """Whether loose objects may be placed on top of it."""


CATALOGUE: dict[str, PieceKind] = {
    # Living
    "sofa": PieceKind("sofa", (0.85, 0.98), (1.6, 2.4), (0.75, 0.88), front=0.9),
    "armchair": PieceKind("armchair", (0.8, 0.9), (0.75, 0.9), (0.8, 0.95), "free"),
    "coffee_table": PieceKind("table", (0.5, 0.7), (0.9, 1.2), (0.38, 0.45), "free", 0.4, top=True),
    "tv_board": PieceKind("cabinet", (0.38, 0.45), (1.4, 2.0), (0.4, 0.55), front=0.8, top=True),
    "television": PieceKind("television", (0.06, 0.1), (1.0, 1.4), (0.6, 0.8), "hangs", lift=(0.9, 1.1)),
    "bookshelf": PieceKind("bookshelf", (0.28, 0.35), (0.8, 1.6), (1.8, 2.1)),
    "sideboard": PieceKind("cabinet", (0.4, 0.45), (1.2, 1.8), (0.75, 0.85), top=True),
    "plant": PieceKind("plant", (0.4, 0.6), (0.4, 0.6), (0.9, 1.6), "corner", 0.1),
    "floor_lamp": PieceKind("lamp", (0.35, 0.45), (0.35, 0.45), (1.5, 1.75), "corner", 0.1),
    "rug": PieceKind("rug", (1.4, 2.0), (2.0, 3.0), (0.008, 0.012), "lies", 0.0),
    "painting": PieceKind("picture", (0.025, 0.04), (0.4, 1.0), (0.4, 0.8), "hangs", 0.0, (1.25, 1.45)),
    "curtain": PieceKind("curtain", (0.08, 0.14), (0.35, 0.6), (2.1, 2.4), "hangs", 0.0, (0.05, 0.05)),
    "radiator": PieceKind("radiator", (0.08, 0.12), (0.6, 1.4), (0.5, 0.6), "hangs", 0.2, (0.12, 0.15)),
    # Kitchen and dining
    "dining_table": PieceKind("table", (0.7, 1.0), (0.8, 2.0), (0.73, 0.76), "free", 0.7, top=True),
    "chair": PieceKind("chair", (0.45, 0.52), (0.42, 0.48), (0.82, 0.95), "free", 0.0),
    "kitchen_counter": PieceKind("counter", (0.6, 0.62), (0.3, 3.6), (0.9, 0.92), front=0.9, top=True),
    "wall_cupboard": PieceKind("cabinet", (0.32, 0.36), (0.4, 2.4), (0.6, 0.75), "hangs", 0.0, (1.4, 1.5)),
    "kitchen_sink": PieceKind("counter", (0.6, 0.62), (0.8, 1.0), (0.9, 0.92), front=0.9),
    "stove": PieceKind("stove", (0.6, 0.62), (0.6, 0.6), (0.9, 0.92), front=0.9),
    "hob": PieceKind(
        "stove", (0.6, 0.62), (0.6, 0.6), (0.29, 0.31), "hangs", 0.9, (0.61, 0.61)
    ),  # a worktop with a hob, over an ``oven_body``
    "extractor_hood": PieceKind("hood", (0.45, 0.5), (0.6, 0.6), (0.7, 0.9), "hangs", 0.0, (1.55, 1.65)),
    "fridge": PieceKind("fridge", (0.62, 0.68), (0.6, 0.7), (1.75, 1.95), front=0.9),
    # Bedroom
    "double_bed": PieceKind("bed", (2.05, 2.15), (1.5, 1.9), (0.85, 1.1), front=0.7),
    "single_bed": PieceKind("bed", (2.0, 2.1), (0.95, 1.1), (0.75, 0.95), front=0.7),
    "nightstand": PieceKind("cabinet", (0.38, 0.45), (0.4, 0.5), (0.48, 0.58), front=0.3, top=True),
    "wardrobe": PieceKind("wardrobe", (0.58, 0.65), (1.2, 2.4), (2.0, 2.25), front=0.8),
    "chest_of_drawers": PieceKind("cabinet", (0.42, 0.5), (0.8, 1.2), (0.75, 0.95), front=0.7, top=True),
    "mirror": PieceKind("mirror", (0.02, 0.03), (0.4, 0.7), (0.9, 1.5), "hangs", 0.0, (0.4, 0.6)),
    # Bathroom
    "toilet": PieceKind("toilet", (0.62, 0.7), (0.36, 0.4), (0.75, 0.82), front=0.6),
    "basin": PieceKind("basin", (0.45, 0.5), (0.55, 0.8), (0.84, 0.88), front=0.7),
    "bath": PieceKind("bath", (0.75, 0.8), (1.65, 1.75), (0.55, 0.6), front=0.7),
    "shower": PieceKind("shower", (0.85, 0.95), (0.85, 1.0), (2.0, 2.1), "corner", 0.6),
    "washing_machine": PieceKind("washing_machine", (0.58, 0.62), (0.6, 0.6), (0.84, 0.86), front=0.7, top=True),
    "bathroom_mirror": PieceKind("mirror", (0.03, 0.05), (0.5, 0.8), (0.6, 0.8), "hangs", 0.0, (1.15, 1.25)),
    # Hall
    "shoe_cabinet": PieceKind("cabinet", (0.25, 0.35), (0.7, 1.1), (0.8, 1.0), front=0.6, top=True),
    "coat_rack": PieceKind("coat_rack", (0.2, 0.28), (0.7, 1.1), (0.3, 0.4), "hangs", 0.3, (1.5, 1.6)),
    "railing": PieceKind(
        "railing", (0.05, 0.06), (0.8, 5.0), (0.95, 1.0), "free", 0.0
    ),  # around the opening above a stair; its width is along the railing
    # Office
    "desk": PieceKind("desk", (0.7, 0.8), (1.2, 1.6), (0.72, 0.75), front=0.9, top=True),
    "office_chair": PieceKind("chair", (0.6, 0.65), (0.6, 0.65), (0.95, 1.1), "free", 0.0),
    "monitor": PieceKind("monitor", (0.18, 0.22), (0.5, 0.7), (0.42, 0.5), "table", 0.0),
    "filing_cabinet": PieceKind("cabinet", (0.55, 0.62), (0.4, 0.45), (1.0, 1.35), front=0.7, top=True),
    "meeting_table": PieceKind("table", (1.0, 1.3), (2.0, 3.2), (0.73, 0.75), "free", 0.8, top=True),
    "whiteboard": PieceKind("whiteboard", (0.03, 0.05), (1.2, 2.0), (0.9, 1.2), "hangs", 0.0, (0.9, 1.0)),
    "printer": PieceKind("printer", (0.55, 0.65), (0.55, 0.65), (0.95, 1.15), front=0.7),
    "partition": PieceKind("partition", (0.05, 0.06), (1.2, 1.6), (1.2, 1.5), "free", 0.0),
    # Shop
    "gondola": PieceKind("shelf", (0.8, 0.95), (2.0, 4.0), (1.5, 1.8), "free", 1.0),
    "wall_shelf": PieceKind("shelf", (0.4, 0.5), (1.5, 3.0), (2.0, 2.2), front=1.0),
    "display_fridge": PieceKind("fridge", (0.7, 0.8), (1.2, 2.4), (1.95, 2.1), front=1.0),
    "till": PieceKind("counter", (0.7, 0.85), (1.6, 2.2), (0.9, 1.0), "free", 0.9, top=True),
    "crate_stack": PieceKind("box", (0.4, 0.5), (0.5, 0.6), (0.5, 1.2), front=0.5),
    # Lamps
    "ceiling_lamp": PieceKind("lamp", (0.3, 0.45), (0.3, 0.45), (0.08, 0.12), "ceiling", 0.0),
    "pendant_lamp": PieceKind("lamp", (0.3, 0.5), (0.3, 0.5), (0.7, 0.9), "ceiling", 0.0),
    "panel_lamp": PieceKind("lamp", (0.6, 0.6), (0.6, 1.2), (0.03, 0.05), "ceiling", 0.0),
    "desk_lamp": PieceKind("lamp", (0.15, 0.2), (0.3, 0.4), (0.4, 0.5), "table", 0.0),
}
