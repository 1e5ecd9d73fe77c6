"""Models doors and a window, each link in its own frame (see ``gibson_sim_tools.making.objects.catalogue``)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from gibson_sim_tools.making.blender.objects.workshop import (
    BLACK,
    DARK_STEEL,
    LACQUER,
    OAK,
    PANE,
    STEEL,
    WHITE,
    LinkModel,
    ShaderMaterial,
    mm,
)
from gibson_sim_tools.making.objects.catalogue import HANDLE_Z, LEAF_THICKNESS, door_names

_HALF = LEAF_THICKNESS / 2
_VENEER = replace(OAK, tile=1.1)
_OAK_ROUND = ShaderMaterial(OAK.color, roughness=0.55)


def _leaf(part: LinkModel, width: float) -> None:
    """Adds a door leaf with a round edge at the hinge: lacquered with two recessed panels for 0.80 m, oak for wider doors."""
    reach, painted = width - 0.026, width < 0.85
    paint = LACQUER if painted else _VENEER
    round_edge = [(_HALF * math.cos(a), _HALF * math.sin(a)) for a in (math.pi / 2 + math.pi * k / 8 for k in range(9))]
    if painted:
        _panelled(part, round_edge, reach, paint)
    else:
        part.prism([*round_edge, (reach, -_HALF), (reach, _HALF)], 0.006, 1.994, paint, 0.0015)
        groove = ShaderMaterial((0.36, 0.26, 0.16), roughness=0.8)
        for side in (-1, 1):
            y = side * (_HALF + 0.0003)
            for z in (0.5, 1.0, 1.5):
                part.box((0.0, min(y, 0.99 * y), z - 0.002), (reach, max(y, 0.99 * y), z + 0.002), groove, 0.0, 1)
    lock, z = reach - 0.06, HANDLE_Z
    for side in (-1, 1):
        y = side * _HALF
        part.rod((lock, y, z), (lock, y + side * 0.006, z), 0.026, STEEL, 24, 0.002)
        part.rod((lock, y, z - 0.085), (lock, y + side * 0.006, z - 0.085), 0.026, STEEL, 24, 0.002)
        part.rod((lock, y + side * 0.0055, z - 0.083), (lock, y + side * 0.0066, z - 0.083), 0.005, BLACK, 10)
        part.box(
            (lock - 0.0025, min(y, y + side * 0.0066), z - 0.099),
            (lock + 0.0025, max(y, y + side * 0.0066), z - 0.085),
            BLACK,
            0.0,
            1,
        )
    part.box((reach - 0.0005, -0.011, z - 0.11), (reach + 0.0006, 0.011, z + 0.09), STEEL, 0.0, 1)
    for z in (0.22, 1.78):
        part.rod((0.0, 0.0, z - 0.05), (0.0, 0.0, z + 0.05), _HALF + 0.0008, STEEL, 18, 0.001)


def _panelled(part: LinkModel, round_edge: list[tuple[float, float]], reach: float, paint: ShaderMaterial) -> None:
    """Adds stiles and rails around two thinner panels with raised centres."""
    stile, rail = 0.11, (0.006, 0.20, 0.86, 0.98, 1.88, 1.994)
    part.prism([*round_edge, (stile, -_HALF), (stile, _HALF)], 0.006, 1.994, paint, 0.0015)
    part.box((reach - stile, -_HALF, 0.006), (reach, _HALF, 1.994), paint, 0.0015, 1)
    for low, high in ((rail[0], rail[1]), (rail[2], rail[3]), (rail[4], rail[5])):
        part.box((stile, -_HALF, low), (reach - stile, _HALF, high), paint, 0.0015, 1)
    for low, high in ((rail[1], rail[2]), (rail[3], rail[4])):
        part.box((stile - 0.004, -0.009, low - 0.004), (reach - stile + 0.004, 0.009, high + 0.004), paint, 0.0, 1)
        part.box((stile + 0.035, -0.0155, low + 0.035), (reach - stile - 0.035, 0.0155, high - 0.035), paint, 0.0075, 2)
        # A moulding around the panel, on both sides.
        for side in (-1, 1):
            y0, y1 = sorted((side * 0.008, side * 0.0165))
            for x in (stile, reach - stile - 0.012):
                part.box((x, y0, low), (x + 0.012, y1, high), paint, 0.004, 1)
            for z in (low, high - 0.012):
                part.box((stile, y0, z), (reach - stile, y1, z + 0.012), paint, 0.004, 1)


def _lever(part: LinkModel) -> None:
    """Adds both levers of a door on one spindle, pointing to the hinge (-x); the origin is on the axis."""
    for side in (-1, 1):
        part.rod((0.0, side * 0.024, 0.0), (0.0, side * 0.064, 0.0), 0.0095, STEEL, 16, 0.001)
        y = side * 0.063
        part.tube([(0.003, y - side * 0.004, 0.0), (-0.002, y, 0.0), (-0.05, y, 0.0), (-0.115, y, 0.0)], 0.0088, STEEL, 3, 6)
        part.lathe(
            [(0.0, 0.0), (0.006, 0.0015), (0.0088, 0.006)][::-1], STEEL, 14, at=(-0.115, y, 0.0), turn=(0.0, math.pi / 2, 0.0)
        )


def _sliding_leaf(part: LinkModel) -> None:
    frosted = ShaderMaterial((0.88, 0.92, 0.93), roughness=0.6)
    part.box((0.0, -0.0175, 0.008), (0.94, 0.0175, 2.028), _VENEER, 0.002, 1)
    for side in (-1, 1):
        y = side * 0.0178
        for k in range(4):
            low = 0.20 + 0.44 * k
            part.box((0.14, min(y, 0.98 * y), low), (0.80, max(y, 0.98 * y), low + 0.40), frosted, 0.0, 1)
            for x in (0.128, 0.80):
                part.box((x, min(y, 1.4 * y), low - 0.012), (x + 0.012, max(y, 1.4 * y), low + 0.412), _OAK_ROUND, 0.002, 1)
            for z in (low - 0.012, low + 0.40):
                part.box((0.128, min(y, 1.4 * y), z), (0.812, max(y, 1.4 * y), z + 0.012), _OAK_ROUND, 0.002, 1)
    part.rod((0.0625, 0.045, 0.9), (0.0625, 0.045, 1.2), 0.009, DARK_STEEL, 16, 0.002)
    for z in (0.93, 1.17):
        part.rod((0.0625, 0.0175, z), (0.0625, 0.045, z), 0.006, DARK_STEEL, 12)
    for x in (0.14, 0.80):
        part.box((x - 0.02, 0.0175, 1.93), (x + 0.02, 0.0225, 2.082), DARK_STEEL, 0.002, 1)
        part.rod((x, 0.004, 2.062), (x, 0.0235, 2.062), 0.026, DARK_STEEL, 20, 0.002)


def _rail(part: LinkModel) -> None:
    part.box((0.0, -0.010, 2.05), (1.84, 0.004, 2.09), DARK_STEEL, 0.002, 1)
    for x in (0.02, 1.82):
        part.box((x - 0.015, -0.022, 2.046), (x + 0.015, 0.018, 2.0895), DARK_STEEL, 0.002, 1)
    for x in (0.3, 0.92, 1.54):
        part.rod((x, -0.022, 2.07), (x, 0.008, 2.07), 0.008, DARK_STEEL, 12)


def _window_frame(part: LinkModel) -> None:
    for low, high in (((0, 0), (0.05, 1.2)), ((0.75, 0), (0.8, 1.2)), ((0.05, 0), (0.75, 0.05)), ((0.05, 1.15), (0.75, 1.2))):
        part.box((low[0], -0.035, low[1]), (high[0], 0.035, high[1]), WHITE, 0.003, 2)
    for low, high in (
        ((0.05, 0.05), (0.058, 1.15)),
        ((0.742, 0.05), (0.75, 1.15)),
        ((0.05, 0.05), (0.75, 0.058)),
        ((0.05, 1.142), (0.75, 1.15)),
    ):
        part.box((low[0], -0.035, low[1]), (high[0], -0.024, high[1]), WHITE, 0.001, 1)


def _sash(part: LinkModel) -> None:
    """Adds the sash. Its origin is the edge with the hinge, in the front plane of the frame."""
    x0, x1, z0, z1, width = 0.004, 0.696, 0.054, 1.146, 0.062
    y0, y1 = -0.055, -0.005
    part.box((x0, y0, z0), (x0 + width, y1, z1), WHITE, 0.004, 2)
    part.box((x1 - width, y0, z0), (x1, y1, z1), WHITE, 0.004, 2)
    part.box((x0 + width, y0, z0), (x1 - width, y1, z0 + width), WHITE, 0.004, 2)
    part.box((x0 + width, y0, z1 - width), (x1 - width, y1, z1), WHITE, 0.004, 2)
    part.box((x0 + width - 0.005, -0.034, z0 + width - 0.005), (x1 - width + 0.005, -0.026, z1 - width + 0.005), PANE, 0.0, 1)
    bead = ShaderMaterial((0.30, 0.31, 0.32), roughness=0.8)
    for y in (-0.038, -0.026):
        for x in (x0 + width, x1 - width - 0.004):
            part.box((x, y, z0 + width), (x + 0.004, y + 0.004, z1 - width), bead, 0.0, 1)
        for z in (z0 + width, z1 - width - 0.004):
            part.box((x0 + width, y, z), (x1 - width, y + 0.004, z + 0.004), bead, 0.0, 1)
    for z in (0.18, 1.02):
        part.rod((0.0, -0.004, z - 0.035), (0.0, -0.004, z + 0.035), 0.0075, STEEL, 14, 0.001)


def _window_handle(part: LinkModel) -> None:
    part.box((-0.015, 0.0, -0.035), (0.015, 0.009, 0.035), STEEL, 0.003, 2)
    part.rod((0.0, 0.008, 0.0), (0.0, 0.036, 0.0), 0.0085, STEEL, 16, 0.001)
    part.tube(mm("0 30 4, 0 35 0, 0 36 -50, 0 34 -118"), 0.0078, STEEL, 3, 6, (1.0, 1.1, 1.0, 0.75))


Maker = Callable[[LinkModel], None]
MAKERS: dict[str, dict[str, Maker]] = {
    **{name: {"leaf": partial(_leaf, width=int(name[5:7]) / 100), "handle": _lever} for name in door_names()},
    "sliding_door_90": {"leaf": _sliding_leaf, "rail": _rail},
    "window_casement": {"frame": _window_frame, "sash": _sash, "handle": _window_handle},
}
"""Modelling function of each link, by object name and link name."""
