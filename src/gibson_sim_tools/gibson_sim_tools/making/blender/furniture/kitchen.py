"""Models furniture of kitchens. NumPy only."""

from __future__ import annotations

import itertools

import numpy as np

from gibson_sim_tools.making.blender.appearances import surface_of
from gibson_sim_tools.making.blender.furniture.goods import goods
from gibson_sim_tools.making.blender.furniture.living import bar, choose, fronts
from gibson_sim_tools.making.blender.shapes import ObjectBuilder, Surface

_FRONTS = ("wood_white", "wood_white", "wood_oak", "plaster_sage", "plaster_blue")
_TOPS = ("wood_oak", "stone_dark", "marble", "wood_walnut")


def kitchen_style(s: ObjectBuilder) -> tuple[Surface, Surface]:
    """Returns the surfaces of fronts and worktop, the same in the whole building."""
    rng = np.random.default_rng((s.style, 31))
    front = surface_of(_FRONTS[int(rng.integers(len(_FRONTS)))])
    top = surface_of(_TOPS[int(rng.integers(len(_TOPS)))])
    return Surface("plain" if front.material == "plaster" else front.material, front.tint), top


def _base(s: ObjectBuilder, d: float, w: float, h: float, hole: tuple[float, float] | None = None) -> tuple[float, Surface]:
    """Adds plinth, body and worktop (with a hole of depth x width); returns the x of the fronts and their surface."""
    front, top = kitchen_style(s)
    inner, thickness = d / 2 - 0.05, 0.035
    s.box((-d / 2, -w / 2, 0), (inner - 0.05, w / 2, 0.1), surface_of("metal_black", (0.16, 0.16, 0.16)), 0, "-x +z -z -y +y")
    s.box((-d / 2, -w / 2, 0.1), (inner, w / 2, h - thickness), surface_of("wood_white"), 0.001, "-x +z +x")
    if hole is None:
        s.box((-d / 2, -w / 2, h - thickness), (d / 2, w / 2, h), top, 0.004, "-x -z")
    else:
        a, b = hole[0] / 2, hole[1] / 2
        s.box((-d / 2, -w / 2, h - thickness), (d / 2, -b, h), top, 0.003, "-x -z +y")
        s.box((-d / 2, b, h - thickness), (d / 2, w / 2, h), top, 0.003, "-x -z -y")
        s.box((-d / 2, -b, h - thickness), (-a, b, h), top, 0.0, "-x -z +y -y")
        s.box((a, -b, h - thickness), (d / 2, b, h), top, 0.003, "-z +y -y")
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))
    return inner, front


def counter(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds kitchen base units with doors and drawers."""
    x, front = _base(s, d, w, h)
    columns = max(1, round(w / 0.6))
    edges = np.linspace(-w / 2, w / 2, columns + 1)
    for low, high in itertools.pairwise(edges):
        drawers = s.rng.random() < 0.4
        fronts(s, x, (low, 0.1), (high, h - 0.045), 1, 3 if drawers else 1, front, surface_of("metal_black"))


def sink(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a base unit with a basin of steel and a tap."""
    x, front = _base(s, d, w, h, (0.38, 0.46))
    fronts(s, x, (-w / 2, 0.1), (w / 2, h - 0.045), 2, 1, front, surface_of("metal_black"))
    steel, a, b, depth = surface_of("metal_steel"), 0.19, 0.23, 0.17
    inner = [((-a, -b), (-a, b)), ((-a, b), (a, b)), ((a, b), (a, -b)), ((a, -b), (-a, -b))]
    for (x0, y0), (x1, y1) in inner:
        s.quad([(x0, y0, h - depth), (x0, y0, h), (x1, y1, h), (x1, y1, h - depth)][::-1], steel)
    s.quad([(-a, -b, h - depth), (a, -b, h - depth), (a, b, h - depth), (-a, b, h - depth)], steel)
    s.lathe((0, 0, h - depth), [(0.035, 0.001), (0.03, 0.002), (0, 0.002)], surface_of("metal_black"), 12)
    tap(s, (-a - 0.045, 0.0, h), 0.28, 0.2)


def tap(s: ObjectBuilder, at: tuple[float, float, float], height: float, reach: float) -> None:
    """Adds a tap whose spout bends to +x, with a lever."""
    steel = surface_of("metal_steel", (0.78, 0.79, 0.80))
    t = np.linspace(0, np.pi, 9)
    bend = [(at[0] + reach / 2 - reach / 2 * np.cos(a), at[1], at[2] + height - reach / 2 + reach / 2 * np.sin(a)) for a in t]
    s.tube([at, *bend, (at[0] + reach, at[1], at[2] + height - reach * 0.7)], 0.011, steel, 8)
    s.lathe(at, [(0.026, 0), (0.026, 0.012), (0.02, 0.05), (0.0, 0.052)], steel, 12)
    s.tube([(at[0], at[1] + 0.015, at[2] + 0.04), (at[0] + 0.02, at[1] + 0.075, at[2] + 0.06)], 0.006, steel, 6)


def stove(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a cooker: oven below, glass top with four rings."""
    x, _ = _base(s, d, w, h)
    steel, black = surface_of("metal_steel"), surface_of("plastic_black")
    s.box((x, -w / 2 + 0.003, 0.1), (x + 0.02, w / 2 - 0.003, 0.24), steel, 0.003, "-x")
    s.box((x, -w / 2 + 0.003, 0.245), (x + 0.02, w / 2 - 0.003, 0.74), steel, 0.003, "-x")
    s.box((x + 0.02, -w / 2 + 0.06, 0.30), (x + 0.023, w / 2 - 0.06, 0.64), black, 0, "-x")
    bar(s, [(x + 0.02, -w / 2 + 0.06, 0.69), (x + 0.02, w / 2 - 0.06, 0.69)], steel, 0.028, 0.008)
    s.box((x, -w / 2 + 0.003, 0.745), (x + 0.02, w / 2 - 0.003, h - 0.04), steel, 0.003, "-x")
    for y in np.linspace(-0.2, 0.2, 5):
        s.tube([(x + 0.02, y, 0.81), (x + 0.045, y, 0.81)], 0.017, black, 10)
    _rings(s, d, w, h)


def hob(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a worktop with a hob, and a drawer, above an oven."""
    front, top = kitchen_style(s)
    x = d / 2 - 0.05
    s.box((-d / 2, -w / 2, 0), (x, w / 2, h - 0.035), surface_of("wood_white"), 0.001, "-x +z +x")
    s.box((-d / 2, -w / 2, h - 0.035), (d / 2, w / 2, h), top, 0.004, "-x -z")
    fronts(s, x, (-w / 2, 0), (w / 2, h - 0.045), 1, 1, front, surface_of("metal_black"))
    _rings(s, d, w, h - 0.005)
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


def _rings(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a plate of black glass with four rings."""
    s.box(
        (-d / 2 + 0.04, -w / 2 + 0.02, h - 0.001),
        (d / 2 - 0.05, w / 2 - 0.02, h + 0.005),
        surface_of("plastic_black"),
        0.002,
        "-z",
    )
    for a in (-0.14, 0.12):
        for y in (-0.14, 0.14):
            radius = 0.075 + 0.02 * (a * y > 0)
            s.lathe(
                (a, y, h + 0.005),
                [(radius, 0), (radius, 0.0012), (radius - 0.006, 0.0012)],
                Surface("plain", (0.34, 0.33, 0.33)),
                20,
            )


def wall_cupboard(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds cupboards on the wall."""
    front, _ = kitchen_style(s)
    x = d / 2 - 0.04
    s.box((-d / 2, -w / 2, 0), (x, w / 2, h), surface_of("wood_white"), 0.001, "-x +x")
    fronts(s, x, (-w / 2, 0), (w / 2, h), max(1, round(w / 0.45)), 1, front, surface_of("metal_black"))
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


def hood(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds an extractor hood with its chimney."""
    steel = surface_of("metal_steel")
    low = [(-d / 2, -w / 2), (d / 2, -w / 2), (d / 2, w / 2), (-d / 2, w / 2)]
    high = [(-d / 2, -0.13), (-d / 2 + 0.24, -0.13), (-d / 2 + 0.24, 0.13), (-d / 2, 0.13)]
    s.box((-d / 2, -w / 2, 0), (d / 2, w / 2, 0.05), steel, 0.003, "-x +z")
    for k in range(4):
        j = (k + 1) % 4
        s.quad([(*low[k], 0.05), (*low[j], 0.05), (*high[j], 0.26), (*high[k], 0.26)], steel)
    s.box((-d / 2, -0.13, 0.26), (-d / 2 + 0.24, 0.13, h), steel, 0.002, "-x -z")
    s.box((-d / 2 + 0.05, -w / 2 + 0.05, -0.0), (d / 2 - 0.05, w / 2 - 0.05, 0.002), surface_of("metal_black"), 0, "+z")
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, 0.26))
    s.collide((-d / 2, -0.13, 0.26), (-d / 2 + 0.24, 0.13, h))


def fridge(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a fridge with a freezer below."""
    tone = choose(s, ("metal_steel", "plastic_white", "metal_steel", "plaster_sage"))
    skin = Surface("plain", tone.tint)
    x = d / 2 - 0.10
    s.box((-d / 2, -w / 2, 0.02), (x, w / 2, h), skin, 0.008, "-x +x -z")
    for low, high, handle in (
        (0.06, h * 0.36, (h * 0.36 - 0.3, h * 0.36 - 0.05)),
        (h * 0.36 + 0.006, h, (h * 0.36 + 0.06, h * 0.36 + 0.4)),
    ):
        s.box((x + 0.004, -w / 2, low), (x + 0.064, w / 2, high), skin, 0.012, "-x")
        bar(
            s,
            [(x + 0.064, -w / 2 + 0.06, handle[0]), (x + 0.064, -w / 2 + 0.06, handle[1])],
            surface_of("metal_steel", (0.74, 0.75, 0.76)),
            0.03,
            0.008,
        )
    s.box((-d / 2 + 0.02, -w / 2 + 0.02, 0), (x, w / 2 - 0.02, 0.06), surface_of("metal_black"), 0, "-x -z +z")
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


def display_fridge(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a cooled shelf of a shop, open to the front, full of goods."""
    skin = surface_of("plastic_white")
    s.box((-d / 2, -w / 2, 0), (-d / 2 + 0.06, w / 2, h), skin, 0.004, "-x -z")
    for side in (-1, 1):
        s.box((-d / 2 + 0.06, side * w / 2, 0), (d / 2, side * (w / 2 - 0.05), h), skin, 0.006, "-z -x")
    s.box((-d / 2 + 0.06, -w / 2 + 0.05, h - 0.18), (d / 2, w / 2 - 0.05, h), skin, 0.006, "-x")
    s.box((-d / 2 + 0.06, -w / 2 + 0.05, 0), (d / 2, w / 2 - 0.05, 0.35), surface_of("metal_black"), 0.006, "-x -z")
    s.box(
        (d / 2 - 0.14, -w / 2 + 0.06, h - 0.195), (d / 2 - 0.08, w / 2 - 0.06, h - 0.181), surface_of("glow", (1.0, 1.0, 1.0)), 0
    )
    levels = np.linspace(0.36, h - 0.25, 5)
    for low, high in itertools.pairwise(levels):
        s.box(
            (-d / 2 + 0.06, -w / 2 + 0.05, low), (d / 2 - 0.06, w / 2 - 0.05, low + 0.015), surface_of("metal_steel"), 0.001, "-x"
        )
        goods(s, (-d / 2 + 0.2, -w / 2 + 0.06, low + 0.015), (d / 2 - 0.07, w / 2 - 0.06, high - 0.03))
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


BUILDERS = {
    "kitchen_counter": counter, "kitchen_sink": sink, "stove": stove, "hob": hob, "wall_cupboard": wall_cupboard, "extractor_hood": hood,
    "fridge": fridge, "display_fridge": display_fridge,
}  # fmt: skip
