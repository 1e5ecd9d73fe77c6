"""Models furniture of bathrooms. NumPy only."""

from __future__ import annotations

import numpy as np

from gibson_sim_tools.making.blender.appearances import surface_of
from gibson_sim_tools.making.blender.furniture.kitchen import tap
from gibson_sim_tools.making.blender.furniture.living import choose, fronts
from gibson_sim_tools.making.blender.shapes import ObjectBuilder, pose_matrix


def toilet(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a toilet with its cistern."""
    white = surface_of("ceramic_white")
    s.cushion((-d / 2, -w / 2, 0.40), (-d / 2 + 0.17, w / 2, h), white, 9, 6)
    s.tube([(-d / 2 + 0.085, 0, h - 0.005), (-d / 2 + 0.085, 0, h)], 0.02, surface_of("metal_steel"), 10)
    long, front = d - 0.14, d / 2
    _oval(s, [(0.30, 0.0), (0.32, 0.10), (0.40, 0.25), (0.5, 0.385), (0.5, 0.40)], long, w, front)
    _oval(s, [(0.5, 0.402), (0.505, 0.41), (0.5, 0.435), (0.0, 0.437)], long, w, front)
    s.box((-d / 2, -0.10, 0.0), (-d / 2 + 0.3, 0.10, 0.40), white, 0.02, "-x -z")
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, 0.44))
    s.collide((-d / 2, -w / 2, 0.4), (-d / 2 + 0.17, w / 2, h))


def _oval(s: ObjectBuilder, profile: list[tuple[float, float]], long: float, width: float, front: float) -> None:
    part = s.lathe((0, 0, 0), profile, surface_of("ceramic_white"), 24)
    part.vertices[:, 0] = part.vertices[:, 0] * long * 0.99 + front - long / 2
    part.vertices[:, 1] *= width * 0.99
    part.uv *= 0.3


def basin(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a basin on a cabinet, with a tap."""
    white, wood = surface_of("ceramic_white"), choose(s, ("wood_oak", "wood_white", "wood_walnut"))
    x = d / 2 - 0.06
    s.box((-d / 2, -w / 2 + 0.02, 0.25), (x - 0.02, w / 2 - 0.02, h - 0.12), wood, 0.003, "-x +x +z")
    fronts(s, x - 0.02, (-w / 2 + 0.02, 0.25), (w / 2 - 0.02, h - 0.13), 1, 2, wood, surface_of("metal_steel"))
    a, b, top = (-d / 2 + 0.12, d / 2 - 0.035), w / 2 - 0.05, h
    s.box((-d / 2, -w / 2, h - 0.12), (a[0], w / 2, top), white, 0.008, "-x")
    s.box((a[1], -w / 2, h - 0.12), (d / 2, w / 2, top), white, 0.008)
    for side in (-1, 1):
        s.box((a[0], side * w / 2, h - 0.12), (a[1], side * b, top), white, 0.006)
    s.quad([(a[0], -b, h - 0.11), (a[1], -b, h - 0.11), (a[1], b, h - 0.11), (a[0], b, h - 0.11)], white)
    s.lathe((0.0, 0.0, h - 0.109), [(0.022, 0.001), (0.02, 0.003), (0, 0.003)], surface_of("metal_steel"), 10)
    tap(s, (-d / 2 + 0.06, 0, h), 0.17, 0.13)
    s.collide((-d / 2, -w / 2, 0.25), (d / 2, w / 2, h))


def bath(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a built-in bath tub with panels."""
    white, rim, depth = surface_of("ceramic_white"), 0.07, h - 0.16
    s.box((-d / 2, -w / 2, 0), (d / 2, w / 2, h - 0.04), surface_of("ceramic_white", (0.90, 0.90, 0.89)), 0.003, "-x -z +z")
    a, b, e, f = d / 2 - rim, w / 2 - rim, d / 2 - rim - 0.09, w / 2 - rim - 0.17
    for k in (-1, 1):
        s.box((k * a, -w / 2, h - 0.04), (k * d / 2, w / 2, h), white, 0.006)
        s.box((-a, k * b, h - 0.04), (a, k * w / 2, h), white, 0.006)
    top, low = [(-a, -b), (a, -b), (a, b), (-a, b)], [(-e, -f), (e, -f), (e, f), (-e, f)]
    for k in range(4):
        j = (k + 1) % 4
        s.quad([(*top[k], h - 0.003), (*top[j], h - 0.003), (*low[j], h - depth), (*low[k], h - depth)], white)
    s.quad([(*p, h - depth) for p in low], white)
    tap(s, (-a - 0.02, 0, h), 0.16, 0.14)
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


def shower(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a shower: tray, two panes, a head on a rail; its corner is at the back right."""
    steel = surface_of("metal_steel", (0.76, 0.77, 0.78))
    s.box((-d / 2, -w / 2, 0), (d / 2, w / 2, 0.05), surface_of("ceramic_white"), 0.01, "-z")
    s.box((d / 2 - 0.008, -w / 2, 0.05), (d / 2, w / 2, h), surface_of("glass"), 0)
    for z in (0.05, h - 0.02):
        s.box((d / 2 - 0.02, -w / 2, z), (d / 2, w / 2, z + 0.02), steel, 0.001)
    for y in (-w / 2, w / 2 - 0.02):
        s.box((d / 2 - 0.02, y, 0.07), (d / 2, y + 0.02, h - 0.02), steel, 0.001)
    x = -d / 2 + 0.05
    s.tube([(x, 0, 0.95), (x, 0, h - 0.08)], 0.010, steel, 8)
    s.tube([(x, 0, h - 0.1), (x + 0.15, 0, h - 0.06), (x + 0.32, 0, h - 0.08)], 0.009, steel, 8)
    s.lathe((x + 0.32, 0, h - 0.11), [(0, 0), (0.10, 0.0), (0.10, 0.012), (0.02, 0.03), (0, 0.03)], steel, 18)
    s.box((x - 0.02, -0.13, 1.02), (x + 0.03, 0.13, 1.07), steel, 0.01)
    s.lathe((0, 0, 0.05), [(0.05, 0.0), (0.05, 0.002), (0, 0.003)], steel, 14)
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, 0.05))
    s.collide((d / 2 - 0.02, -w / 2, 0), (d / 2, w / 2, h))


def washing_machine(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a washing machine."""
    white, x = surface_of("plastic_white"), d / 2 - 0.03
    s.box((-d / 2, -w / 2, 0.01), (x, w / 2, h), white, 0.01, "-x -z")
    first = len(s.parts)
    s.lathe((0, 0, 0), [(0.20, 0), (0.20, 0.02), (0.175, 0.03), (0.16, 0.03)], surface_of("metal_steel"), 28)
    s.lathe((0, 0, 0), [(0.16, 0.03), (0.10, 0.012), (0, 0.005)], surface_of("plastic_black", (0.16, 0.17, 0.19)), 28)
    s.transform(first, pose_matrix((x, 0, h * 0.45), pitch=np.pi / 2))
    s.box(
        (x, -w / 2 + 0.01, h - 0.13),
        (x + 0.006, w / 2 - 0.01, h - 0.02),
        surface_of("plastic_white", (0.84, 0.84, 0.84)),
        0.002,
        "-x",
    )
    s.box((x + 0.006, -w / 2 + 0.05, h - 0.105), (x + 0.008, -w / 2 + 0.2, h - 0.045), surface_of("screen"), 0, "-x")
    s.tube([(x + 0.006, 0.03, h - 0.075), (x + 0.028, 0.03, h - 0.075)], 0.03, surface_of("metal_steel"), 16)
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


BUILDERS = {"toilet": toilet, "basin": basin, "bath": bath, "shower": shower, "washing_machine": washing_machine}
