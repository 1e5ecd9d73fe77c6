"""Models furniture of offices and shops. NumPy only."""

from __future__ import annotations

import itertools

import numpy as np

from gibson_sim_tools.making.blender.appearances import sample_vivid_color, surface_of, vary_color
from gibson_sim_tools.making.blender.furniture.goods import goods
from gibson_sim_tools.making.blender.furniture.living import cabinet, choose, fronts
from gibson_sim_tools.making.blender.shapes import ObjectBuilder, Surface, pose_matrix


def chair(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a wooden chair that faces +x."""
    wood = choose(s, ("wood_oak", "wood_walnut", "wood_black", "wood_white", "wood_pine"))
    seat, a, b = 0.45, d / 2 - 0.03, w / 2 - 0.03
    padded = s.rng.random() < 0.5
    for y in (-1, 1):
        s.tube([(a, y * b, 0), (a - 0.03, y * (b - 0.02), seat)], [0.012, 0.018], wood, 8)
        s.tube(
            [(-a, y * b, 0), (-a + 0.05, y * (b - 0.02), seat), (-a + 0.012, y * (b - 0.02), h - 0.04)],
            [0.012, 0.018, 0.013],
            wood,
            8,
        )
        s.tube([(a - 0.015, y * (b - 0.012), 0.24), (-a + 0.03, y * (b - 0.012), 0.24)], 0.009, wood, 6)
    s.cushion((-a + 0.02, -w / 2, seat - 0.025), (d / 2, w / 2, seat), wood, 9, 5)
    if padded:
        fabric = choose(s, ("fabric_grey", "fabric_beige", "leather_black", "fabric_blue"))
        s.cushion((-a + 0.05, -w / 2 + 0.02, seat - 0.005), (d / 2 - 0.02, w / 2 - 0.02, seat + 0.03), fabric, 5, 6)
    for k, z in enumerate(np.linspace(seat + 0.2, h - 0.06, 3)):
        first = len(s.parts)
        bend = np.linspace(-1, 1, 7)
        height = 0.045 if k == 2 else 0.03
        grid = [[(-0.03 * (1 - v * v), v * (b - 0.02), t) for v in bend] for t in (-height, height)]
        for shift in (0.0, 0.012):
            g = np.array(grid) + np.array([shift, 0, 0])
            s.sheet(g if shift else g[::-1], wood)
        s.transform(first, pose_matrix((-a + 0.05 - 0.038 * (z - seat) / (h - seat), 0, z), pitch=-0.06))
    s.collide((-a, -w / 2, 0), (d / 2, w / 2, seat))
    s.collide((-d / 2, -w / 2, seat), (-d / 2 + 0.08, w / 2, h))


def office_chair(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a swivel chair on five castors."""
    black, cloth = surface_of("plastic_black"), choose(s, ("fabric_grey", "fabric_blue", "leather_black", "fabric_green"))
    r = min(d, w) / 2 - 0.03
    for k in range(5):
        angle = k * 2 * np.pi / 5 + 0.3
        x, y = r * np.cos(angle), r * np.sin(angle)
        s.tube([(0, 0, 0.10), (x, y, 0.075)], [0.024, 0.014], black, 6)
        s.tube(
            [
                (x - 0.02 * np.sin(angle), y + 0.02 * np.cos(angle), 0.028),
                (x + 0.02 * np.sin(angle), y - 0.02 * np.cos(angle), 0.028),
            ],
            0.028,
            black,
            10,
        )
    s.lathe((0, 0, 0.08), [(0.03, 0), (0.03, 0.16), (0.018, 0.16), (0.018, 0.33)], surface_of("metal_steel"), 10)
    s.cushion((-0.22, -0.24, 0.41), (0.25, 0.24, 0.50), cloth, 4.5, 7)
    first = len(s.parts)
    s.cushion((-0.035, -0.22, -0.27), (0.035, 0.22, 0.27), cloth, 5, 7)
    s.transform(first, pose_matrix((-d / 2 + 0.085, 0, h - 0.285), pitch=-0.12))
    s.tube([(-0.1, 0, 0.42), (-d / 2 + 0.05, 0, 0.46), (-d / 2 + 0.045, 0, 0.75)], 0.02, black, 8)
    for y in (-1, 1):
        s.tube([(0, y * 0.2, 0.43), (0, y * 0.27, 0.45), (0, y * 0.275, 0.64)], 0.013, black, 6)
        s.cushion((-0.13, y * 0.25, 0.64), (0.13, y * 0.3, 0.67), black, 5, 4)
    s.collide((-r, -r, 0), (r, r, 0.12))
    s.collide((-0.22, -0.24, 0.4), (0.25, 0.24, 0.5))
    s.collide((-d / 2, -0.22, 0.5), (-d / 2 + 0.12, 0.22, h))


def desk(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a desk with a drawer unit and a frame of steel."""
    wood, metal = choose(s, ("wood_oak", "wood_white", "wood_walnut", "wood_pine")), choose(s, ("metal_black", "metal_steel"))
    s.box((-d / 2, -w / 2, h - 0.028), (d / 2, w / 2, h), wood, 0.004, solid=True)
    for y in (-1, 1):
        side = y * (w / 2 - 0.04)
        for x in (-1, 1):
            s.box(
                (x * (d / 2 - 0.04), side - 0.02, 0),
                (x * (d / 2 - 0.08), side + 0.02, h - 0.028),
                metal,
                0.002,
                "+z -z",
                solid=True,
            )
        s.box((-d / 2 + 0.08, side - 0.02, 0.0), (d / 2 - 0.08, side + 0.02, 0.03), metal, 0.002, "-z")
    s.box((-d / 2 + 0.05, -w / 2 + 0.06, h - 0.38), (-d / 2 + 0.065, w / 2 - 0.06, h - 0.03), wood, 0.001)
    low, high = (-w / 2 + 0.08, 0.05), (-w / 2 + 0.46, h - 0.06)
    s.box((-d / 2 + 0.1, low[0], low[1]), (d / 2 - 0.1, high[0], high[1]), surface_of("wood_white"), 0.003, "+x -x", solid=True)
    fronts(s, d / 2 - 0.1, low, high, 1, 3, surface_of("wood_white"), surface_of("metal_steel"))


def monitor(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a monitor on its foot."""
    black = surface_of("plastic_black")
    s.box((-d / 2, -0.12, 0), (d / 2, 0.12, 0.012), black, 0.004, "-z")
    s.tube([(-d / 4, 0, 0.01), (-d / 4, 0, h * 0.6)], 0.017, black, 8)
    screen(s, (-d / 4 + 0.02, -w / 2, h * 0.22), (-d / 4 + 0.05, w / 2, h))


def screen(s: ObjectBuilder, low: tuple[float, float, float], high: tuple[float, float, float]) -> None:
    """Adds a flat screen with a narrow rim; the picture is at the maximum x."""
    s.box(low, high, surface_of("plastic_black"), 0.004, "-x")
    x, rim = high[0] + 0.0015, 0.012
    y0, z0, y1, z1 = low[1] + rim, low[2] + rim, high[1] - rim, high[2] - rim
    s.quad([(x, y0, z0), (x, y1, z0), (x, y1, z1), (x, y0, z1)], surface_of("screen"))


def television(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a television on the wall."""
    screen(s, (-d / 2 + 0.02, -w / 2, 0), (d / 2 - 0.002, w / 2, h))
    s.box((-d / 2, -0.2, h / 2 - 0.15), (-d / 2 + 0.02, 0.2, h / 2 + 0.15), surface_of("metal_black"), 0, "-x +x")
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


def filing_cabinet(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a filing cabinet of steel."""
    skin = Surface("plain", choose(s, ("plaster_grey", "plastic_white", "metal_black")).tint)
    x = d / 2 - 0.04
    s.box((-d / 2, -w / 2, 0), (x, w / 2, h), skin, 0.004, "-x +x -z")
    fronts(s, x, (-w / 2, 0.04), (w / 2, h - 0.01), 1, max(3, round(h / 0.33)), skin, surface_of("metal_steel"))
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


def whiteboard(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a whiteboard with a rim and a tray."""
    s.box((-d / 2, -w / 2, 0.02), (d / 2 - 0.012, w / 2, h), surface_of("metal_steel"), 0.003, "-x")
    x, rim = d / 2 - 0.011, 0.02
    y = w / 2 - rim
    s.quad(
        [(x, -y, 0.02 + rim), (x, y, 0.02 + rim), (x, y, h - rim), (x, -y, h - rim)],
        surface_of("plastic_white", (0.95, 0.95, 0.95)),
    )
    for _ in range(int(s.rng.integers(3, 7))):
        a = np.array([s.rng.uniform(-y, y - 0.3), s.rng.uniform(0.2, h - 0.15)])
        t = np.linspace(0, s.rng.uniform(0.1, 0.3), 8)
        line = [(x + 0.001, a[0] + k, a[1] + 0.02 * np.sin(k * 40 * s.rng.uniform(0.5, 1))) for k in t]
        s.tube(line, 0.003, surface_of("paper", sample_vivid_color(s.rng, (0.5, 0.9), (0.2, 0.5))), 4)
    s.box((-d / 2, -w / 4, 0), (d / 2, w / 4, 0.02), surface_of("metal_steel"), 0.002)


def printer(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds an office printer on its cabinet."""
    white, grey = surface_of("plastic_white", (0.82, 0.82, 0.81)), surface_of("plastic_black", (0.22, 0.23, 0.24))
    s.box((-d / 2, -w / 2, 0.03), (d / 2 - 0.03, w / 2, h * 0.5), grey, 0.01, "-x -z")
    fronts(s, d / 2 - 0.03, (-w / 2, 0.05), (w / 2, h * 0.5), 1, 2, white, grey)
    s.box((-d / 2, -w / 2, h * 0.5), (d / 2 - 0.02, w / 2, h * 0.68), white, 0.012, "-x")
    s.box((-d / 2, -w / 2, h * 0.68), (-d / 2 + 0.12, w / 2, h * 0.8), grey, 0.01, "-x")
    s.box((-d / 2, -w / 2, h * 0.8), (d / 2 - 0.1, w / 2, h), white, 0.015, "-x")
    s.box((d / 2 - 0.1, -0.15, h * 0.84), (d / 2 - 0.03, 0.02, h * 0.95), surface_of("screen"), 0.01)
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


def partition(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a screen between desks, covered with cloth."""
    s.box((-d / 2, -w / 2, 0.05), (d / 2, w / 2, h - 0.02), choose(s, ("fabric_grey", "fabric_blue", "fabric_green")), 0.004)
    s.box((-d / 2, -w / 2, h - 0.02), (d / 2, w / 2, h), surface_of("metal_steel"), 0.003)
    for y in (-1, 1):
        s.box((-d / 2, y * (w / 2 - 0.02), 0), (d / 2, y * (w / 2 - 0.08), 0.05), surface_of("metal_steel"), 0.003, "-z")
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


def shelf(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a shop shelf on one side, with goods."""
    metal = surface_of("plastic_white", (0.80, 0.80, 0.79))
    s.box((-d / 2, -w / 2, 0), (-d / 2 + 0.03, w / 2, h), metal, 0.002, "-x -z")
    _levels(s, -d / 2 + 0.03, d / 2, w, h, metal)
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


def gondola(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a shop shelf with goods on both sides."""
    metal = surface_of("plastic_white", (0.80, 0.80, 0.79))
    s.box((-0.02, -w / 2, 0), (0.02, w / 2, h), metal, 0.002, "-z")
    for turn in (0.0, np.pi):
        first = len(s.parts)
        _levels(s, 0.02, d / 2, w, h, metal)
        s.transform(first, pose_matrix((0, 0, 0), turn))
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


def _levels(s: ObjectBuilder, back: float, front: float, w: float, h: float, metal: Surface) -> None:
    s.box((back, -w / 2, 0), (front, w / 2, 0.12), surface_of("metal_black", (0.2, 0.2, 0.2)), 0.003, "-x -z")
    levels = np.linspace(0.12, h - 0.05, max(3, round(h / 0.38)) + 1)
    for k, (low, high) in enumerate(itertools.pairwise(levels)):
        depth = front if k == 0 else front - 0.04
        s.box((back, -w / 2, low), (depth, w / 2, low + 0.02), metal, 0.002, "-x")
        s.box(
            (depth - 0.001, -w / 2, low - 0.005),
            (depth + 0.004, w / 2, low + 0.03),
            surface_of("plastic_red", vary_color((0.75, 0.72, 0.66), s.rng)),
            0,
            "-x",
        )
        goods(s, (max(back, depth - 0.25), -w / 2 + 0.02, low + 0.02), (depth - 0.015, w / 2 - 0.02, high - 0.02))


def till(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a shop counter with a cash register."""
    cabinet(s, d, w, h * 0.94)
    s.box((-d / 2, -w / 2, h * 0.94), (d / 2, w / 2, h * 0.965), surface_of("wood_oak"), 0.004)
    s.box((-0.12, -0.2, h * 0.965), (0.1, 0.2, h), surface_of("plastic_black"), 0.006)
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


def crate_stack(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a stack of crates."""
    count = max(2, round(h / 0.28))
    edges = np.linspace(0, h, count + 1)
    for low, high in itertools.pairwise(edges):
        first, tone = len(s.parts), surface_of("cardboard", vary_color((0.70, 0.55, 0.38), s.rng, 0.05))
        s.box((-d / 2 + 0.02, -w / 2 + 0.02, 0), (d / 2 - 0.02, w / 2 - 0.02, high - low - 0.002), tone, 0.006, "-z")
        s.box(
            (-d / 2 + 0.018, -0.03, 0.0), (d / 2 - 0.018, 0.03, high - low), surface_of("cardboard", (0.62, 0.46, 0.28)), 0, "-z"
        )
        s.transform(first, pose_matrix((0, 0, low), s.rng.uniform(-0.03, 0.03)))


BUILDERS = {
    "chair": chair, "office_chair": office_chair, "desk": desk, "monitor": monitor, "television": television,
    "filing_cabinet": filing_cabinet, "whiteboard": whiteboard, "printer": printer, "partition": partition, "wall_shelf": shelf,
    "gondola": gondola, "till": till, "crate_stack": crate_stack,
}  # fmt: skip
