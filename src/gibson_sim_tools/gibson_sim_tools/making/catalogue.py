"""What pieces of furniture there are: how large they may be, where they belong, what lies on them. Shared by plan and modeller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of piece; sizes in metres."""

    semantic_class: str
    depth: Range
    width: Range
    height: Range
    stands: Literal["wall", "free", "corner", "ceiling", "hangs", "lies", "table"] = "wall"
    """With its back to a wall; anywhere on the floor; in a corner; under the ceiling; on a wall; flat on the floor, to be walked on; on a table."""
    front: float = 0.6
    """Room to be left free before it."""
    lift: Range = (0.0, 0.0)
    """Height of its underside above the floor; of ``ceiling``: how far its underside is below the ceiling."""
    top: bool = False
    """Whether loose things may stand on it, at its full height."""


CATALOGUE: dict[str, Kind] = {
    # Living
    "sofa": Kind("sofa", (0.85, 0.98), (1.6, 2.4), (0.75, 0.88), front=0.9),
    "armchair": Kind("armchair", (0.8, 0.9), (0.75, 0.9), (0.8, 0.95), "free"),
    "coffee_table": Kind("table", (0.5, 0.7), (0.9, 1.2), (0.38, 0.45), "free", 0.4, top=True),
    "tv_board": Kind("cabinet", (0.38, 0.45), (1.4, 2.0), (0.4, 0.55), front=0.8, top=True),
    "television": Kind("television", (0.06, 0.1), (1.0, 1.4), (0.6, 0.8), "hangs", lift=(0.9, 1.1)),
    "bookshelf": Kind("bookshelf", (0.28, 0.35), (0.8, 1.6), (1.8, 2.1)),
    "sideboard": Kind("cabinet", (0.4, 0.45), (1.2, 1.8), (0.75, 0.85), top=True),
    "plant": Kind("plant", (0.4, 0.6), (0.4, 0.6), (0.9, 1.6), "corner", 0.1),
    "floor_lamp": Kind("lamp", (0.35, 0.45), (0.35, 0.45), (1.5, 1.75), "corner", 0.1),
    "rug": Kind("rug", (1.4, 2.0), (2.0, 3.0), (0.008, 0.012), "lies", 0.0),
    "painting": Kind("picture", (0.025, 0.04), (0.4, 1.0), (0.4, 0.8), "hangs", 0.0, (1.25, 1.45)),
    "curtain": Kind("curtain", (0.08, 0.14), (0.35, 0.6), (2.1, 2.4), "hangs", 0.0, (0.05, 0.05)),
    "radiator": Kind("radiator", (0.08, 0.12), (0.6, 1.4), (0.5, 0.6), "hangs", 0.2, (0.12, 0.15)),
    # Kitchen and dining
    "dining_table": Kind("table", (0.7, 1.0), (0.8, 2.0), (0.73, 0.76), "free", 0.7, top=True),
    "chair": Kind("chair", (0.45, 0.52), (0.42, 0.48), (0.82, 0.95), "free", 0.0),
    "kitchen_counter": Kind("counter", (0.6, 0.62), (0.3, 3.6), (0.9, 0.92), front=0.9, top=True),
    "wall_cupboard": Kind("cabinet", (0.32, 0.36), (0.4, 2.4), (0.6, 0.75), "hangs", 0.0, (1.4, 1.5)),
    "kitchen_sink": Kind("counter", (0.6, 0.62), (0.8, 1.0), (0.9, 0.92), front=0.9),
    "stove": Kind("stove", (0.6, 0.62), (0.6, 0.6), (0.9, 0.92), front=0.9),
    "hob": Kind(
        "stove", (0.6, 0.62), (0.6, 0.6), (0.29, 0.31), "hangs", 0.9, (0.61, 0.61)
    ),  # a worktop with a hob, over an ``oven_body``
    "extractor_hood": Kind("hood", (0.45, 0.5), (0.6, 0.6), (0.7, 0.9), "hangs", 0.0, (1.55, 1.65)),
    "fridge": Kind("fridge", (0.62, 0.68), (0.6, 0.7), (1.75, 1.95), front=0.9),
    # Bedroom
    "double_bed": Kind("bed", (2.05, 2.15), (1.5, 1.9), (0.85, 1.1), front=0.7),
    "single_bed": Kind("bed", (2.0, 2.1), (0.95, 1.1), (0.75, 0.95), front=0.7),
    "nightstand": Kind("cabinet", (0.38, 0.45), (0.4, 0.5), (0.48, 0.58), front=0.3, top=True),
    "wardrobe": Kind("wardrobe", (0.58, 0.65), (1.2, 2.4), (2.0, 2.25), front=0.8),
    "chest_of_drawers": Kind("cabinet", (0.42, 0.5), (0.8, 1.2), (0.75, 0.95), front=0.7, top=True),
    "mirror": Kind("mirror", (0.02, 0.03), (0.4, 0.7), (0.9, 1.5), "hangs", 0.0, (0.4, 0.6)),
    # Bathroom
    "toilet": Kind("toilet", (0.62, 0.7), (0.36, 0.4), (0.75, 0.82), front=0.6),
    "basin": Kind("basin", (0.45, 0.5), (0.55, 0.8), (0.84, 0.88), front=0.7),
    "bath": Kind("bath", (0.75, 0.8), (1.65, 1.75), (0.55, 0.6), front=0.7),
    "shower": Kind("shower", (0.85, 0.95), (0.85, 1.0), (2.0, 2.1), "corner", 0.6),
    "washing_machine": Kind("washing_machine", (0.58, 0.62), (0.6, 0.6), (0.84, 0.86), front=0.7, top=True),
    "bathroom_mirror": Kind("mirror", (0.03, 0.05), (0.5, 0.8), (0.6, 0.8), "hangs", 0.0, (1.15, 1.25)),
    # Hall
    "shoe_cabinet": Kind("cabinet", (0.25, 0.35), (0.7, 1.1), (0.8, 1.0), front=0.6, top=True),
    "coat_rack": Kind("coat_rack", (0.2, 0.28), (0.7, 1.1), (0.3, 0.4), "hangs", 0.3, (1.5, 1.6)),
    "railing": Kind("railing", (0.05, 0.06), (0.8, 5.0), (0.95, 1.0), "free", 0.0),  # around the hole of a stair; width along it
    # Office
    "desk": Kind("desk", (0.7, 0.8), (1.2, 1.6), (0.72, 0.75), front=0.9, top=True),
    "office_chair": Kind("chair", (0.6, 0.65), (0.6, 0.65), (0.95, 1.1), "free", 0.0),
    "monitor": Kind("monitor", (0.18, 0.22), (0.5, 0.7), (0.42, 0.5), "table", 0.0),
    "filing_cabinet": Kind("cabinet", (0.55, 0.62), (0.4, 0.45), (1.0, 1.35), front=0.7, top=True),
    "meeting_table": Kind("table", (1.0, 1.3), (2.0, 3.2), (0.73, 0.75), "free", 0.8, top=True),
    "whiteboard": Kind("whiteboard", (0.03, 0.05), (1.2, 2.0), (0.9, 1.2), "hangs", 0.0, (0.9, 1.0)),
    "printer": Kind("printer", (0.55, 0.65), (0.55, 0.65), (0.95, 1.15), front=0.7),
    "partition": Kind("partition", (0.05, 0.06), (1.2, 1.6), (1.2, 1.5), "free", 0.0),
    # Shop
    "gondola": Kind("shelf", (0.8, 0.95), (2.0, 4.0), (1.5, 1.8), "free", 1.0),
    "wall_shelf": Kind("shelf", (0.4, 0.5), (1.5, 3.0), (2.0, 2.2), front=1.0),
    "display_fridge": Kind("fridge", (0.7, 0.8), (1.2, 2.4), (1.95, 2.1), front=1.0),
    "till": Kind("counter", (0.7, 0.85), (1.6, 2.2), (0.9, 1.0), "free", 0.9, top=True),
    "crate_stack": Kind("box", (0.4, 0.5), (0.5, 0.6), (0.5, 1.2), front=0.5),
    # Lamps
    "ceiling_lamp": Kind("lamp", (0.3, 0.45), (0.3, 0.45), (0.08, 0.12), "ceiling", 0.0),
    "pendant_lamp": Kind("lamp", (0.3, 0.5), (0.3, 0.5), (0.7, 0.9), "ceiling", 0.0),
    "panel_lamp": Kind("lamp", (0.6, 0.6), (0.6, 1.2), (0.03, 0.05), "ceiling", 0.0),
    "desk_lamp": Kind("lamp", (0.15, 0.2), (0.3, 0.4), (0.4, 0.5), "table", 0.0),
}
