"""Adds door leaves with their opening angles. Most are open, so that a robot can reach every room."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gibson_sim_tools.making.building import Body, Storey, Wall
from gibson_sim_tools.making.planning.objects import door_body

_OPEN_ANGLES = (1.15, 1.35, 1.5, 1.55)
"""Hinge angles of open doors, radians."""
_OPEN_POSITIONS = (0.75, 0.88)
"""Joint positions of open sliding doors, m."""


def hang_doors(storeys: Sequence[Storey], rng: np.random.Generator) -> list[Body]:
    """Returns the leaves of all doors.

    Outside doors are closed, and at most one inside door per storey, if all rooms remain connected without it.
    """
    bodies: list[Body] = []
    for storey in storeys:
        doors = [(wall, opening) for wall in storey.walls for opening in wall.openings if opening.kind == "door"]
        closable = [
            wall for wall, _ in doors if wall.left and wall.right and _all_connected([w for w in storey.walls if w is not wall])
        ]
        closed = closable[int(rng.integers(len(closable)))] if closable and rng.random() < 0.5 else None
        for wall, opening in doors:
            outer = not (wall.left and wall.right)
            angle = float(rng.choice(_OPEN_POSITIONS if opening.body.startswith("sliding") else _OPEN_ANGLES))
            room = wall.left if opening.swing > 0 else wall.right
            stem = "front_door" if outer else f"{room}_door_closed" if wall is closed else f"{room}_door"
            same_names = sum(b.name == stem or b.name.startswith(f"{stem}_") for b in bodies)
            bodies.append(
                door_body(
                    f"{stem}_{same_names + 1}" if same_names else stem,
                    wall,
                    opening,
                    storey.floor_z,
                    0.0 if outer or wall is closed else angle,
                )
            )
    return bodies


def _all_connected(walls: Sequence[Wall]) -> bool:
    """Returns whether the doors and passages in these walls connect all rooms."""
    pairs = [(w.left, w.right) for w in walls if w.left and w.right and any(o.kind != "window" for o in w.openings)]
    rooms = {room for w in walls for room in (w.left, w.right) if room}
    reached = {min(rooms)}
    while new_rooms := {room for pair in pairs for room in pair if reached & set(pair)} - reached:
        reached |= new_rooms
    return reached == rooms
