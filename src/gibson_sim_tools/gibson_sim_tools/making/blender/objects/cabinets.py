"""Models cabinets, a fridge and an oven, each link in its own frame (see ``gibson_sim_tools.making.objects.catalogue``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from gibson_sim_tools.making.blender.objects.workshop import (
    BEECH,
    BLACK,
    DARK_STEEL,
    LACQUER,
    OAK,
    STEEL,
    WALNUT,
    WHITE,
    LinkModel,
    ShaderMaterial,
    label,
)
from gibson_sim_tools.making.objects.catalogue import BOARD_THICKNESS, DRAWER_HEIGHT, carcass
from gibson_sim_tools.making.objects.model import Primitive

_HANDLE = 0.03
"""Protrusion of a handle, m."""


def _boards(part: LinkModel, primitives: Sequence[Primitive], paint: ShaderMaterial, bevel: float = 0.0015) -> None:
    """Adds a board for each primitive."""
    for solid in primitives:
        low = [m - s / 2 for m, s in zip(solid.middle, solid.size, strict=True)]
        high = [m + s / 2 for m, s in zip(solid.middle, solid.size, strict=True)]
        part.box(low, high, paint, bevel, 1)


def _bar(
    part: LinkModel,
    x: float,
    ends: tuple[tuple[float, float], tuple[float, float]],
    paint: ShaderMaterial = STEEL,
    radius: float = 0.006,
) -> None:
    """Adds a bar handle in front of the plane ``x`` between two points (y, z)."""
    (y0, z0), (y1, z1) = ends
    out = x + _HANDLE - radius
    part.rod((out, y0, z0), (out, y1, z1), radius, paint, 14, 0.0015)
    for share in (0.12, 0.88):
        y, z = y0 + share * (y1 - y0), z0 + share * (z1 - z0)
        part.rod((x - 0.001, y, z), (out, y, z), 0.8 * radius, paint, 12)


def _drawers_body(part: LinkModel) -> None:
    _boards(part, carcass(-0.225, 0.177, 0.6, 0.06, 0.72, BOARD_THICKNESS), WALNUT)
    part.box((-0.2, -0.28, 0.0), (0.13, 0.28, 0.06), BLACK, 0.001, 1)
    for z in (0.282, 0.492):
        part.box((-0.207, -0.282, z - 0.006), (0.165, 0.282, z), WALNUT, 0.0, 1)


def _drawer(part: LinkModel) -> None:
    y, back, top = 0.265, -0.37, 0.16
    part.box((0.0, -0.297, 0.0), (BOARD_THICKNESS, 0.297, DRAWER_HEIGHT), LACQUER, 0.002, 2)
    part.box((back, -y, 0.015), (0.0, y, 0.024), BEECH, 0.0, 1)
    part.box((back, -y, 0.024), (back + 0.012, y, top), BEECH, 0.001, 1)
    for side in (-1, 1):
        part.box(
            (back + 0.012, min(side * y, side * (y - 0.012)), 0.024),
            (0.0, max(side * y, side * (y - 0.012)), top),
            BEECH,
            0.001,
            1,
        )
    _bar(part, BOARD_THICKNESS, ((-0.08, 0.131), (0.08, 0.131)))


def _doors_body(part: LinkModel) -> None:
    _boards(part, carcass(-0.225, 0.177, 0.8, 0.06, 0.76, BOARD_THICKNESS), OAK)
    part.box((-0.207, -0.382, 0.40), (0.16, 0.382, 0.418), OAK, 0.001, 1)
    part.box((-0.2, -0.38, 0.0), (0.13, 0.38, 0.06), BLACK, 0.001, 1)


def _cabinet_door(part: LinkModel, side: int) -> None:
    """Adds a frame with a recessed panel. ``side``: 1 = hinged at +y."""
    sage = ShaderMaterial((0.47, 0.55, 0.48), roughness=0.5)
    inner, outer, low, high, width = 0.002, 0.3985, 0.062, 0.758, 0.055
    y0, y1 = sorted((-side * inner, -side * outer))
    part.box((0.0, y0, low), (BOARD_THICKNESS, y0 + width, high), sage, 0.002, 2)
    part.box((0.0, y1 - width, low), (BOARD_THICKNESS, y1, high), sage, 0.002, 2)
    for z in (low, high - width):
        part.box((0.0, y0 + width, z), (BOARD_THICKNESS, y1 - width, z + width), sage, 0.002, 2)
    part.box((0.003, y0 + width - 0.004, low + width - 0.004), (0.010, y1 - width + 0.004, high - width + 0.004), sage, 0.0, 1)
    y = -side * 0.366
    _bar(part, BOARD_THICKNESS, ((y, 0.38), (y, 0.54)), ShaderMaterial((0.68, 0.55, 0.32), metallic=0.5, roughness=0.35))


def _fridge_body(part: LinkModel) -> None:
    steel = ShaderMaterial((0.78, 0.79, 0.80), metallic=0.12, roughness=0.42)
    x0, x1, y, z0, z1, wall = -0.34, 0.25, 0.3, 0.02, 1.78, 0.04
    part.box((x0, -y, z0), (x0 + 0.01, y, z1), DARK_STEEL, 0.002, 1)
    for side in (-1, 1):
        part.box((x0 + 0.01, min(side * y, side * (y - 0.008)), z0), (x1, max(side * y, side * (y - 0.008)), z1), steel, 0.003, 1)
        part.box(
            (x0 + wall, min(side * (y - 0.008), side * (y - wall)), z0 + 0.01),
            (x1 - 0.004, max(side * (y - 0.008), side * (y - wall)), z1 - 0.01),
            WHITE,
            0.0,
            1,
        )
    part.box((x0 + 0.01, -y + 0.008, z1 - 0.008), (x1, y - 0.008, z1), steel, 0.002, 1)
    part.box((x0 + wall, -y + wall, z1 - wall), (x1 - 0.004, y - wall, z1 - 0.008), WHITE, 0.0, 1)
    part.box((x0 + 0.01, -y + 0.008, z0), (x1, y - 0.008, z0 + wall), WHITE, 0.0, 1)
    part.box((x0 + 0.01, -y + wall, z0 + wall), (x0 + wall, y - wall, z1 - wall), WHITE, 0.0, 1)
    part.box((-0.3, -0.28, 0.0), (0.22, 0.28, 0.022), BLACK, 0.0, 1)
    shelf = ShaderMaterial((0.80, 0.90, 0.92), roughness=0.1, alpha=0.4)
    for z in (0.5, 0.85, 1.2):
        part.box((-0.29, -0.26, z), (0.19, 0.26, z + 0.006), shelf, 0.0, 1)
        part.box((0.185, -0.26, z - 0.004), (0.2, 0.26, z + 0.010), WHITE, 0.002, 1)
    crisper = ShaderMaterial((0.86, 0.92, 0.94), roughness=0.2, alpha=0.5)
    part.box((-0.28, -0.255, 0.065), (0.19, 0.255, 0.28), crisper, 0.01, 2)
    part.box((0.19, -0.255, 0.22), (0.205, 0.255, 0.28), WHITE, 0.004, 2)
    part.box((-0.1, -0.06, 1.725), (0.05, 0.06, 1.741), ShaderMaterial((1.0, 0.98, 0.92), roughness=0.4, glow=0.6), 0.004, 2)


def _fridge_door(part: LinkModel) -> None:
    """Adds the door. Its origin is on the floor, at the edge with the hinge (-y)."""
    steel = ShaderMaterial((0.82, 0.83, 0.84), metallic=0.15, roughness=0.36)
    part.box((0.012, 0.002, 0.045), (0.06, 0.598, 1.775), steel, 0.006, 3)
    part.box((0.004, 0.012, 0.055), (0.012, 0.588, 1.765), WHITE, 0.002, 1)
    part.box((0.0, 0.018, 0.061), (0.006, 0.582, 1.759), ShaderMaterial((0.55, 0.56, 0.57), roughness=0.8), 0.002, 1)
    for z in (0.35, 0.75, 1.15):
        part.box((-0.09, 0.06, z), (-0.0, 0.54, z + 0.01), WHITE, 0.002, 1)
        part.box(
            (-0.09, 0.06, z), (-0.084, 0.54, z + 0.075), ShaderMaterial((0.86, 0.92, 0.94), roughness=0.2, alpha=0.5), 0.002, 1
        )
        for y in (0.06, 0.534):
            part.box((-0.09, y, z), (0.0, y + 0.006, z + 0.075), WHITE, 0.001, 1)
    _bar(part, 0.06, ((0.55, 0.85), (0.55, 1.35)), STEEL, 0.009)
    part.box((0.0595, 0.27, 1.66), (0.0612, 0.33, 1.672), DARK_STEEL, 0.0, 1)


def _oven_body(part: LinkModel) -> None:
    enamel = ShaderMaterial((0.10, 0.10, 0.11), roughness=0.35)
    for solid in carcass(-0.3, 0.23, 0.595, 0.0, 0.6, 0.045):
        _boards(part, [solid], enamel, 0.002)
    part.box((0.225, -0.2975, 0.49), (0.263, 0.2975, 0.6), DARK_STEEL, 0.003, 2)
    y, z0, z1, x = 0.292, 0.496, 0.594, 0.2636
    part.plate([(x, -y, z1), (x, -y, z0), (x, y, z0), (x, y, z1)], label("dial", 0.35))
    for share in (0.12, 0.26, 0.74, 0.88):
        at = -y + share * 2 * y
        part.rod((0.262, at, 0.545), (0.284, at, 0.545), 0.0165, STEEL, 24, 0.003)
        part.box((0.283, at - 0.0015, 0.548), (0.2848, at + 0.0015, 0.560), BLACK, 0.0, 1)
    part.box((0.225, -0.2975, 0.0), (0.258, 0.2975, 0.06), DARK_STEEL, 0.002, 1)
    for k in range(12):
        at = -0.24 + 0.0436 * k
        part.rod((-0.255, at, 0.273), (0.2, at, 0.273), 0.0018, STEEL, 6)
    for x in (-0.25, -0.03, 0.2):
        part.rod((x, -0.248, 0.2715), (x, 0.248, 0.2715), 0.003, STEEL, 8)
    part.box((-0.2, -0.04, 0.545), (-0.1, 0.04, 0.556), ShaderMaterial((1.0, 0.93, 0.78), roughness=0.4, glow=0.5), 0.003, 1)


def _oven_door(part: LinkModel) -> None:
    """Adds the door. Its origin is the axis, at the lower front edge."""
    glass = ShaderMaterial((0.05, 0.05, 0.06), roughness=0.08)
    dark = ShaderMaterial((0.08, 0.09, 0.10), roughness=0.05, alpha=0.62)
    x0, x1, y, z0, z1 = -0.034, 0.0, 0.29, 0.005, 0.42
    width, low, high = 0.065, 0.075, 0.345
    for a, b in (((-y, z0), (y, low)), ((-y, high), (y, z1)), ((-y, low), (-y + width, high)), ((y - width, low), (y, high))):
        part.box((x0, a[0], a[1]), (x1, b[0], b[1]), glass, 0.002, 1)
    part.box((-0.010, -y + width - 0.004, low - 0.004), (-0.005, y - width + 0.004, high + 0.004), dark, 0.0, 1)
    part.box((-0.028, -y + width - 0.004, low - 0.004), (-0.024, y - width + 0.004, high + 0.004), dark, 0.0, 1)
    out = 0.035 - 0.0085
    part.rod((out, -0.24, 0.3825), (out, 0.24, 0.3825), 0.0085, STEEL, 18, 0.002)
    for at in (-0.2, 0.2):
        part.rod((-0.001, at, 0.3825), (out, at, 0.3825), 0.0065, STEEL, 12)
    for side in (-1, 1):
        part.rod((-0.012, side * (y - 0.04), 0.0), (-0.012, side * (y + 0.0005), 0.0), 0.006, DARK_STEEL, 10)


Maker = Callable[[LinkModel], None]
MAKERS: dict[str, dict[str, Maker]] = {
    "cabinet_drawers": {"body": _drawers_body, **{f"drawer_{k}": _drawer for k in (1, 2, 3)}},
    "cabinet_doors": {
        "body": _doors_body,
        "door_left": partial(_cabinet_door, side=1),
        "door_right": partial(_cabinet_door, side=-1),
    },
    "fridge_body": {"body": _fridge_body, "door": _fridge_door},
    "oven_body": {"body": _oven_body, "door": _oven_door},
}
"""Modelling function of each link, by object name and link name."""
