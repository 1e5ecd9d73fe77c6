"""Furnishes rooms of all kinds."""

from __future__ import annotations

from collections.abc import Callable

from gibson_sim_tools.making.planning.furnishing.dressing import add_lamps, hang_curtains, hang_radiators, scatter
from gibson_sim_tools.making.planning.furnishing.homes import furnish_bedroom, furnish_hall, furnish_living, furnish_study
from gibson_sim_tools.making.planning.furnishing.wet import furnish_bathroom, furnish_kitchen, furnish_kitchenette, furnish_toilet
from gibson_sim_tools.making.planning.furnishing.workplaces import (
    furnish_meeting,
    furnish_office,
    furnish_open_office,
    furnish_shop,
    furnish_storage,
)
from gibson_sim_tools.making.planning.space import FurnishedRoom

_FURNISHERS: dict[str, Callable[[FurnishedRoom], bool]] = {
    "living": furnish_living,
    "bedroom": furnish_bedroom,
    "study": furnish_study,
    "hall": furnish_hall,
    "corridor": furnish_hall,
    "kitchen": furnish_kitchen,
    "kitchenette": furnish_kitchenette,
    "bathroom": furnish_bathroom,
    "toilet": furnish_toilet,
    "office": furnish_office,
    "open_office": furnish_open_office,
    "meeting": furnish_meeting,
    "shop": furnish_shop,
    "storage": furnish_storage,
}


def furnish(room: FurnishedRoom) -> bool:
    """Furnishes and lights a room, and adds curtains, radiators and loose objects.

    Returns:
        Whether all required furniture was placed.
    """
    hang_radiators(room)
    if room.curtains:
        hang_curtains(room)
    if not _FURNISHERS[room.kind](room):
        return False
    add_lamps(room)
    scatter(room)
    return True
