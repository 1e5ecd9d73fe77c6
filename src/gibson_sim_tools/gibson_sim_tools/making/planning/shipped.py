"""Lists the plans of the scenes shipped with this project."""

from __future__ import annotations

from dataclasses import dataclass

from gibson_sim_tools.making.building import Building, BuildingKind
from gibson_sim_tools.making.planning.planner import plan_building


@dataclass(frozen=True, slots=True)
class Design:
    """A selected plan."""

    name: str
    """Name of the folder under ``scenes/``."""
    kind: BuildingKind
    seed: int
    title: str
    """Short description in lists of scenes."""

    def plan(self) -> Building:
        """Returns the plan of this design."""
        return plan_building(self.kind, self.seed, self.name)


SHIPPED: tuple[Design, ...] = (
    Design("linden_flat", "flat", 14, "Flat with an open kitchen, pine floors and a brick wall, two bedrooms"),
    Design("harbour_flat", "flat", 26, "Flat around a square hall, walnut floors, sage walls, one bedroom"),
    Design("courtyard_flat", "flat", 36, "Flat in two wings, oak floors, a study"),
    Design("boulevard_flat", "flat", 11, "Large flat along a corridor, parquet, a study, two bedrooms"),
    Design("orchard_house", "house", 1, "House with a stair in its middle, oak floors, three bedrooms, a study"),
    Design("mill_house", "house", 10, "Narrow house with a stair along one side, pine floors, a sliding door, two bedrooms"),
    Design("garden_house", "house", 0, "House with a stair in its middle, walnut floors, three bedrooms, a guest room"),
    Design("print_works_office", "office", 0, "Open plan office with a meeting room"),
    Design("river_office", "office", 1, "Single offices along a corridor, a meeting room"),
    Design("corner_shop", "shop", 8, "Self-service shop with a storage room"),
)
"""Four flats, three houses, two offices, a shop."""
