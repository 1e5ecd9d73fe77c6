"""The designs that become the scenes of this project."""

from __future__ import annotations

from dataclasses import dataclass

from gibson_sim.making.building import Building, BuildingKind
from gibson_sim.making.planning.planner import plan_building


@dataclass(frozen=True, slots=True)
class Design:
    """A plan that was looked at and kept."""

    name: str
    """Of the folder under ``scenes/``."""
    kind: BuildingKind
    seed: int
    title: str
    """What a list of scenes says of it."""

    def plan(self) -> Building:
        """Returns the plan of this design."""
        return plan_building(self.kind, self.seed, self.name)


SHIPPED: tuple[Design, ...] = (
    Design("linden_flat", "flat", 1, "Flat"),
    Design("harbour_flat", "flat", 2, "Flat"),
    Design("courtyard_flat", "flat", 0, "Flat"),
    Design("attic_flat", "flat", 3, "Flat"),
    Design("orchard_house", "house", 0, "House"),
    Design("mill_house", "house", 2, "House"),
    Design("garden_house", "house", 3, "House"),
    Design("print_works_office", "office", 0, "Office"),
    Design("river_office", "office", 1, "Office"),
    Design("corner_shop", "shop", 1, "Shop"),
)
"""Four flats, three houses, two offices, a shop."""
