"""Models lamps, wall fixtures and railings. NumPy only."""

from __future__ import annotations

import numpy as np

from gibson_sim_tools.making.blender.appearances import surface_of
from gibson_sim_tools.making.blender.furniture.living import choose
from gibson_sim_tools.making.blender.shapes import ObjectBuilder, Surface, pose_matrix


def radiator(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a radiator of upright columns, with its valve."""
    white = surface_of("plastic_white")
    count = max(5, round(w / 0.055))
    for y in np.linspace(-w / 2 + 0.025, w / 2 - 0.025, count):
        s.cushion((-d / 2 + 0.02, y - 0.021, 0.0), (d / 2, y + 0.021, h), white, 7, 3)
    for z in (0.06, h - 0.06):
        s.tube([(0.01, -w / 2 + 0.02, z), (0.01, w / 2 - 0.02, z)], 0.014, white, 8)
    s.tube([(-d / 2, -w / 2 + 0.02, 0.05), (0.0, -w / 2 + 0.02, 0.05)], 0.01, surface_of("metal_steel"), 8)
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


def mirror(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a mirror with a narrow rim."""
    s.box((-d / 2, -w / 2, 0), (d / 2 - 0.004, w / 2, h), choose(s, ("metal_black", "wood_oak", "metal_brass")), 0.004, "-x")
    x, rim = d / 2 - 0.003, 0.018
    y = w / 2 - rim
    s.quad([(x, -y, rim), (x, y, rim), (x, y, h - rim), (x, -y, h - rim)], surface_of("mirror"))


def coat_rack(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a board with hooks and a shelf above, some coats on it."""
    wood = choose(s, ("wood_oak", "wood_walnut", "wood_white"))
    s.box((-d / 2, -w / 2, h * 0.3), (-d / 2 + 0.02, w / 2, h * 0.62), wood, 0.004, "-x")
    s.box((-d / 2, -w / 2, h - 0.02), (d / 2, w / 2, h), wood, 0.004, "-x")
    for side in (-1, 1):
        s.box((-d / 2, side * (w / 2 - 0.03), h * 0.3), (d / 2 - 0.05, side * (w / 2 - 0.05), h - 0.02), wood, 0.002, "-x +z")
    for k, y in enumerate(np.linspace(-w / 2 + 0.12, w / 2 - 0.12, 5)):
        x = -d / 2 + 0.02
        s.tube([(x, y, h * 0.45), (x + 0.05, y, h * 0.42), (x + 0.06, y, h * 0.5)], 0.006, surface_of("metal_black"), 6)
        if k in (0, 2) and s.rng.random() < 0.9:
            _coat(s, x + 0.06, y, h * 0.5)
    s.collide((-d / 2, -w / 2, h * 0.3), (d / 2, w / 2, h))


def _coat(s: ObjectBuilder, x: float, y: float, top: float) -> None:
    """Adds a coat that hangs from a hook."""
    cloth = choose(s, ("fabric_blue", "fabric_grey", "fabric_green", "leather_brown"))
    angle, rows = np.linspace(0, 2 * np.pi, 25), np.linspace(0, 1, 9)
    grid = np.empty((len(angle), len(rows), 3))
    for k, t in enumerate(rows[::-1]):
        width, depth = 0.03 + 0.15 * min(1.0, t * 3.2), 0.02 + 0.045 * min(1.0, t * 2.5)
        fold = 1 + 0.08 * np.sin(5 * angle + 1.3) * t
        grid[:, k] = np.column_stack(
            [x + depth * np.cos(angle) * fold, y + width * np.sin(angle) * fold, np.full(25, top - 0.95 * t)]
        )
    s.sheet(grid, cloth)


def floor_lamp(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a lamp with a shade of cloth on a stand."""
    metal, r = choose(s, ("metal_black", "metal_brass")), min(d, w) / 2
    s.lathe((0, 0, 0), [(0, 0), (r * 0.75, 0), (r * 0.75, 0.02), (0.02, 0.03)], metal, 24)
    s.tube([(0, 0, 0.02), (0, 0, h - 0.1)], 0.011, metal, 8)
    shade(s, (0, 0, h - 0.27), r * 0.98, r * 0.72, 0.27)
    s.collide((-r * 0.5, -r * 0.5, 0), (r * 0.5, r * 0.5, 0.05))
    s.collide((-0.03, -0.03, 0), (0.03, 0.03, h))


def shade(s: ObjectBuilder, low: tuple[float, float, float], width: float, narrow: float, height: float) -> None:
    """Adds a shade of cloth, lit from within."""
    s.lathe(low, [(width, 0), (narrow, height)], Surface("glow", (0.99, 0.90, 0.74)), 28)
    s.lathe(low, [(width * 0.5, height * 0.5), (0.001, height * 0.5)], Surface("glow", (1.0, 0.97, 0.9)), 12)


def ceiling_lamp(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a flat round lamp under the ceiling."""
    r = min(d, w) / 2
    s.lathe((0, 0, 0), [(0.0, 0.0), (r * 0.75, 0.004), (r * 0.94, 0.025), (r * 0.96, h * 0.6)], surface_of("glow"), 28)
    s.lathe((0, 0, 0), [(r * 0.97, h * 0.45), (r, h * 0.5), (r, h), (0, h)], surface_of("plastic_white"), 28)


def pendant_lamp(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a lamp that hangs on its cable."""
    r, metal = min(d, w) / 2, choose(s, ("metal_black", "metal_brass", "plastic_white", "plaster_sage"))
    skin = Surface("plain", metal.tint)
    height = r * 1.1
    outer = [
        (r, 0.0),
        (r * 0.93, height * 0.35),
        (r * 0.6, height * 0.75),
        (0.04, height),
        (0.03, height + 0.06),
        (0, height + 0.06),
    ]
    s.lathe((0, 0, 0), outer, skin, 24)
    s.lathe(
        (0, 0, 0),
        [(0.04, height * 0.97), (r * 0.58, height * 0.73), (r * 0.91, height * 0.34), (r * 0.985, 0.0)],
        Surface("plain", (0.93, 0.9, 0.84)),
        24,
    )
    s.lathe((0, 0, height * 0.35), [(0, 0.0), (0.045, 0.03), (0.05, 0.06), (0.02, 0.12), (0, 0.12)], surface_of("glow"), 12)
    s.tube([(0, 0, height + 0.05), (0, 0, h - 0.02)], 0.003, surface_of("plastic_black"), 5)
    s.lathe((0, 0, h - 0.03), [(0, 0), (0.05, 0.004), (0.05, 0.03), (0, 0.03)], skin, 16)
    s.collide((-r * 0.8, -r * 0.8, 0), (r * 0.8, r * 0.8, height))


def panel_lamp(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a flat panel under the ceiling of an office."""
    s.box((-d / 2, -w / 2, 0.005), (d / 2, w / 2, h), surface_of("plastic_white"), 0.003, "+z")
    a, b = d / 2 - 0.02, w / 2 - 0.02
    s.quad([(-a, b, 0.004), (a, b, 0.004), (a, -b, 0.004), (-a, -b, 0.004)], surface_of("glow", (1.0, 1.0, 0.98)))


def desk_lamp(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a desk lamp with two arms."""
    metal = choose(s, ("metal_black", "plastic_white", "metal_steel", "plastic_red"))
    y = -w / 2 + 0.08
    s.lathe((0, y, 0), [(0, 0), (0.075, 0), (0.075, 0.015), (0.01, 0.022)], metal, 18)
    s.tube([(0, y, 0.02), (-0.02, y + 0.02, h * 0.55), (0.0, w / 2 - 0.1, h - 0.04)], 0.007, metal, 6)
    first = len(s.parts)
    s.lathe((0, 0, -0.05), [(0.06, -0.03), (0.035, 0.03), (0.02, 0.06), (0, 0.06)], metal, 16)
    s.lathe((0, 0, -0.05), [(0, -0.012), (0.04, -0.012)], surface_of("glow"), 12)
    s.transform(first, pose_matrix((0.0, w / 2 - 0.08, h - 0.03), roll=0.25))


def railing(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a railing: posts, a handrail, upright bars."""
    wood, white = surface_of("wood_oak"), surface_of("wood_white")
    s.box((-d / 2, -w / 2, h - 0.05), (d / 2, w / 2, h), wood, 0.01)
    for y in (-1, 1):
        s.box((-0.02, y * w / 2, 0), (0.02, y * (w / 2 - 0.04), h - 0.05), wood, 0.003, "-z +z")
    for y in np.linspace(-w / 2 + 0.04, w / 2 - 0.04, max(3, round(w / 0.11) + 1))[1:-1]:
        s.box((-0.008, y - 0.008, 0.08), (0.008, y + 0.008, h - 0.05), white, 0, "-z +z")
    s.box((-0.012, -w / 2 + 0.04, 0.06), (0.012, w / 2 - 0.04, 0.085), wood, 0.002)
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


BUILDERS = {
    "radiator": radiator, "mirror": mirror, "bathroom_mirror": mirror, "coat_rack": coat_rack, "railing": railing, "floor_lamp": floor_lamp,
    "ceiling_lamp": ceiling_lamp, "pendant_lamp": pendant_lamp, "panel_lamp": panel_lamp, "desk_lamp": desk_lamp,
}  # fmt: skip
