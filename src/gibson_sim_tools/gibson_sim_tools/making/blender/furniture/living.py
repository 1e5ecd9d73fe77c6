"""Models furniture of living rooms and bedrooms. NumPy only."""

from __future__ import annotations

import itertools

import numpy as np

from gibson_sim_tools.making.blender.appearances import APPEARANCES, sample_vivid_color, surface_of, vary_color
from gibson_sim_tools.making.blender.shapes import ObjectBuilder, Surface, SurfacePart, pose_matrix

_FABRICS = ("fabric_grey", "fabric_beige", "fabric_blue", "fabric_green", "fabric_grey", "leather_brown")
WOODS = ("wood_oak", "wood_walnut", "wood_white", "wood_oak", "wood_pine")


def choose(s: ObjectBuilder, names: tuple[str, ...]) -> Surface:
    """Returns the surface of a random name, with a slight colour variation."""
    name = names[int(s.rng.integers(len(names)))]
    return surface_of(name, vary_color(APPEARANCES[name][1], s.rng, 0.04))


def legs(s: ObjectBuilder, d: float, w: float, h: float, surface: Surface, radius: float = 0.018, inset: float = 0.05) -> None:
    """Adds four slightly splayed legs."""
    for x in (-1, 1):
        for y in (-1, 1):
            top = np.array([x * (d / 2 - inset - 0.03), y * (w / 2 - inset - 0.03), h])
            foot = np.array([x * (d / 2 - inset), y * (w / 2 - inset), 0.0])
            s.tube([foot, top], [radius * 0.7, radius], surface, 8)


def sofa(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a sofa of two or three seats with loose cushions."""
    cloth, foot, arm = choose(s, _FABRICS), 0.12, 0.16 + 0.06 * s.rng.random()
    seat = 0.42
    legs(s, d, w, foot + 0.02, surface_of("wood_oak"), inset=0.08)
    s.cushion((-d / 2, -w / 2, foot), (d / 2 - 0.02, w / 2, seat - 0.12), cloth, 12)
    s.cushion((-d / 2, -w / 2 + arm * 0.9, foot + 0.05), (-d / 2 + 0.22, w / 2 - arm * 0.9, h - 0.03), cloth, 8)
    for side in (-1, 1):
        s.cushion((-d / 2, side * w / 2, foot), (d / 2, side * (w / 2 - arm), 0.60), cloth, 7, noise=0.004)
    count = 3 if w > 1.95 else 2
    edges = np.linspace(-w / 2 + arm, w / 2 - arm, count + 1)
    for low, high in itertools.pairwise(edges):
        s.cushion((-d / 2 + 0.18, low + 0.004, seat - 0.13), (d / 2 - 0.01, high - 0.004, seat + 0.03), cloth, 6, 6, noise=0.006)
        first = len(s.parts)
        s.cushion((-0.09, low + 0.006, -0.19), (0.09, high - 0.006, 0.23), cloth, 4.5, 8, noise=0.012)
        s.transform(first, pose_matrix((-d / 2 + 0.27, 0, h - 0.25), pitch=-0.2))
    for side in (-1, 1):
        if s.rng.random() < 0.85:
            loose_cushion(s, (-d / 2 + 0.40, side * (w / 2 - arm - 0.23), seat + 0.21), s.rng.uniform(-0.5, 0.5), -0.35)
    _seat_boxes(s, d, w, h, arm)


def _seat_boxes(s: ObjectBuilder, d: float, w: float, h: float, arm: float) -> None:
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, 0.44))
    s.collide((-d / 2, -w / 2, 0), (-d / 2 + 0.3, w / 2, h))
    for side in (-1, 1):
        s.collide((-d / 2, side * w / 2, 0), (d / 2, side * (w / 2 - arm), 0.60))


def loose_cushion(s: ObjectBuilder, at: tuple[float, float, float], yaw: float, pitch: float) -> None:
    """Adds a throw cushion that leans."""
    first, half = len(s.parts), 0.2 + 0.03 * s.rng.random()
    material = ("fabric_striped", "linen", "fabric_red", "fabric_green", "fabric_blue")[int(s.rng.integers(5))]
    part = s.cushion((-0.075, -half, -half), (0.075, half, half), surface_of(material), 2.6, 8, noise=0.01)
    # The corners of a cushion are thin and pointed.
    square = (np.abs(part.vertices[:, 1:]) / half).min(axis=1)
    part.vertices[:, 0] *= 1.0 - 0.5 * square**2
    s.transform(first, pose_matrix(at, yaw, pitch))


def armchair(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds an armchair."""
    cloth = choose(s, _FABRICS)
    legs(s, d, w, 0.17, surface_of("wood_walnut"), 0.02, 0.07)
    s.cushion((-d / 2, -w / 2, 0.15), (d / 2 - 0.03, w / 2, 0.32), cloth, 9)
    for side in (-1, 1):
        s.cushion((-d / 2, side * w / 2, 0.15), (d / 2 - 0.04, side * (w / 2 - 0.12), 0.58), cloth, 5)
    s.cushion((-d / 2 + 0.1, -w / 2 + 0.125, 0.29), (d / 2, w / 2 - 0.125, 0.46), cloth, 5, 8, noise=0.006)
    first = len(s.parts)
    s.cushion((-0.1, -w / 2 + 0.1, -0.3), (0.1, w / 2 - 0.1, 0.3), cloth, 4, 8, noise=0.008)
    s.transform(first, pose_matrix((-d / 2 + 0.16, 0, h - 0.31), pitch=-0.12))
    loose_cushion(s, (-d / 2 + 0.33, s.rng.uniform(-0.06, 0.06), 0.63), 0.1, -0.3)
    _seat_boxes(s, d, w, h, 0.12)


def table(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a table with four legs and a frame, or with a round foot."""
    wood = choose(s, WOODS)
    thickness = 0.028
    s.box((-d / 2, -w / 2, h - thickness), (d / 2, w / 2, h), wood, 0.006, solid=True)
    if h < 0.5:
        legs(s, d, w, h - thickness, surface_of("metal_black") if s.rng.random() < 0.4 else wood, 0.016, 0.06)
        s.box((-d / 2 + 0.1, -w / 2 + 0.1, h * 0.36), (d / 2 - 0.1, w / 2 - 0.1, h * 0.36 + 0.015), wood)
        magazines(s, (0.0, s.rng.uniform(-0.2, 0.2), h * 0.36 + 0.015))
    else:
        for x in (-1, 1):
            for y in (-1, 1):
                a, b = np.array([x * (d / 2 - 0.03), y * (w / 2 - 0.03)]), np.array([x * (d / 2 - 0.095), y * (w / 2 - 0.095)])
                s.box((*a, 0), (*b, h - thickness), wood, 0.004, "+z -z", solid=True)
        for y in (-1, 1):
            s.box(
                (-d / 2 + 0.07, y * (w / 2 - 0.05), h - 0.11),
                (d / 2 - 0.07, y * (w / 2 - 0.072), h - thickness),
                wood,
                0.002,
                "+z",
            )
        for x in (-1, 1):
            s.box(
                (x * (d / 2 - 0.05), -w / 2 + 0.07, h - 0.11),
                (x * (d / 2 - 0.072), w / 2 - 0.07, h - thickness),
                wood,
                0.002,
                "+z",
            )
        return
    for x in (-1, 1):
        for y in (-1, 1):
            corner = (x * (d / 2 - 0.06), y * (w / 2 - 0.06))
            s.collide((corner[0] - 0.02, corner[1] - 0.02, 0), (corner[0] + 0.02, corner[1] + 0.02, h - thickness))


def magazines(s: ObjectBuilder, at: tuple[float, float, float]) -> None:
    """Adds a small stack of magazines."""
    z = at[2]
    for _ in range(int(s.rng.integers(2, 5))):
        first, thickness = len(s.parts), s.rng.uniform(0.004, 0.012)
        s.box((-0.105, -0.145, 0), (0.105, 0.145, thickness), surface_of("paper", sample_vivid_color(s.rng)), 0.001)
        s.transform(first, pose_matrix((at[0], at[1], z), s.rng.uniform(-0.3, 0.3)))
        z += thickness


def fronts(
    s: ObjectBuilder,
    x: float,
    low: tuple[float, float],
    high: tuple[float, float],
    columns: int,
    rows: int,
    surface: Surface,
    handle: Surface,
) -> None:
    """Adds doors or drawers, columns x rows, between (y, z) corners, in front of the plane at ``x``, each with a handle."""
    gap, thickness = 0.003, 0.018
    ys, zs = np.linspace(low[0], high[0], columns + 1), np.linspace(low[1], high[1], rows + 1)
    for j in range(columns):
        for k in range(rows):
            a, b = np.array([ys[j] + gap, zs[k] + gap]), np.array([ys[j + 1] - gap, zs[k + 1] - gap])
            s.box((x, a[0], a[1]), (x + thickness, b[0], b[1]), surface, 0.003, "-x")
            middle, width = (a + b) / 2, min(0.16, 0.5 * (b[0] - a[0]))
            if b[1] - a[1] > 0.45 and rows == 1:  # doors: upright handles beside the gap
                side = b[0] - 0.05 if j % 2 == 0 and columns > 1 else a[0] + 0.05
                ends = [(x + thickness, side, middle[1] - 0.08), (x + thickness, side, middle[1] + 0.08)]
            else:
                ends = [
                    (x + thickness, middle[0] - width / 2, b[1] - 0.045),
                    (x + thickness, middle[0] + width / 2, b[1] - 0.045),
                ]
            bar(s, ends, handle)


def bar(
    s: ObjectBuilder, ends: list[tuple[float, float, float]], surface: Surface, out: float = 0.02, radius: float = 0.005
) -> None:
    """Adds a bar handle that protrudes by ``out`` (m) along x."""
    (x, y0, z0), (_, y1, z1) = ends
    y, z = 0.12 * (y1 - y0), 0.12 * (z1 - z0)
    path = [(x, y0 + y, z0 + z), (x + out, y0 + y, z0 + z), (x + out, y1 - y, z1 - z), (x, y1 - y, z1 - z)]
    s.tube(path[:2], radius, surface, 6)
    s.tube(path[2:], radius, surface, 6)
    s.tube([(x + out, y0, z0), (x + out, y1, z1)], radius, surface, 6)


def cabinet(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a cabinet with drawers or doors; low ones have legs."""
    wood = choose(s, WOODS)
    front = wood if s.rng.random() < 0.6 else surface_of("wood_white")
    handle = surface_of("metal_black") if s.rng.random() < 0.5 else surface_of("metal_brass")
    foot = 0.12 if h < 0.62 and w > 1.0 else 0.05
    inner = d / 2 - 0.038
    if foot > 0.1:
        legs(s, d, w, foot + 0.02, surface_of("wood_walnut"), 0.016, 0.08)
    else:
        s.box((-d / 2 + 0.02, -w / 2 + 0.02, 0), (inner - 0.03, w / 2 - 0.02, foot), wood, 0.001, "+z -z -x")
    s.box((-d / 2, -w / 2, foot), (inner, w / 2, h - 0.02), wood, 0.002, "-x +x -z +z")
    s.box((-d / 2, -w / 2 - 0.0, h - 0.02), (inner + 0.018, w / 2, h), wood, 0.003, "-x -z")
    columns = max(1, round(w / 0.55))
    drawers = w / columns > 0.62 or s.rng.random() < 0.5 or h < 0.6
    rows = max(1, round((h - foot) / 0.22)) if drawers else 1
    fronts(s, inner, (-w / 2, foot), (w / 2, h - 0.02), columns, rows, front, handle)
    s.collide((-d / 2, -w / 2, 0), (d / 2, w / 2, h))


def wardrobe(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a wardrobe with doors."""
    wood = choose(s, ("wood_white", "wood_oak", "wood_walnut", "wood_white"))
    inner = d / 2 - 0.04
    s.box((-d / 2 + 0.02, -w / 2 + 0.01, 0), (inner - 0.02, w / 2 - 0.01, 0.07), wood, 0.001, "+z -z -x")
    s.box((-d / 2, -w / 2, 0.07), (inner, w / 2, h), wood, 0.003, "-x +x -z")
    columns = max(2, 2 * round(w / 1.0))
    fronts(s, inner, (-w / 2, 0.07), (w / 2, h), columns, 1, wood, surface_of("metal_steel"))


def bookshelf(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a bookshelf full of books."""
    wood, t = choose(s, WOODS), 0.022
    columns = max(1, round(w / 0.8))
    rows = max(4, round(h / 0.36))
    s.box((-d / 2, -w / 2, 0), (-d / 2 + 0.008, w / 2, h), wood, 0, "-x")
    for y in np.linspace(-w / 2, w / 2 - t, columns + 1):
        s.box((-d / 2 + 0.008, y, 0), (d / 2, y + t, h), wood, 0.002, "-z -x")
    levels = np.linspace(0.06, h - t, rows + 1)
    for column in range(columns):
        low, high = -w / 2 + t + column * (w - t) / columns, -w / 2 + (column + 1) * (w - t) / columns
        for level, z in enumerate(levels):
            s.box((-d / 2 + 0.008, low, z), (d / 2 - 0.004, high, z + t), wood, 0.002, "-x")
            if level < rows:
                _books(s, (-d / 2 + 0.03, low + 0.006, z + t), (d / 2 - 0.03, high - 0.006, levels[level + 1] - 0.02))
    s.box((-d / 2 + 0.008, -w / 2 + t, 0), (d / 2 - 0.03, w / 2 - t, 0.06), wood, 0, "-x -z +z")


def _books(s: ObjectBuilder, low: tuple[float, float, float], high: tuple[float, float, float]) -> None:
    """Fills a compartment with books: most upright, some lying, with gaps."""
    y, clear = low[1] + s.rng.uniform(0, 0.03), high[2] - low[2]
    stop = high[1] - (s.rng.uniform(0, 0.25) * (high[1] - low[1]) if s.rng.random() < 0.6 else 0.0)
    while y < stop - 0.05:
        if s.rng.random() < 0.08:
            z = low[2]
            for _ in range(int(s.rng.integers(2, 5))):
                thickness = s.rng.uniform(0.02, 0.04)
                _book(
                    s,
                    (high[0] - s.rng.uniform(0.14, 0.18), y, z),
                    (high[0] - s.rng.uniform(0.0, 0.02), min(y + 0.22, stop), z + thickness),
                )
                z += thickness
            y += 0.23
            continue
        thickness, height = s.rng.uniform(0.014, 0.045), clear * s.rng.uniform(0.62, 0.93)
        depth = min(high[0] - low[0], s.rng.uniform(0.13, 0.2))
        back = s.rng.uniform(0.0, 0.02)
        _book(s, (high[0] - back - depth, y, low[2]), (high[0] - back, y + thickness - 0.001, low[2] + height))
        y += thickness


def _book(s: ObjectBuilder, low: tuple[float, ...], high: tuple[float, ...]) -> None:
    kind = s.rng.random()
    color = (
        sample_vivid_color(s.rng, (0.0, 0.25), (0.55, 0.92))
        if kind < 0.4
        else sample_vivid_color(s.rng, (0.3, 0.75), (0.18, 0.7))
    )
    part = s.box(low, high, surface_of("paper", color), 0, "-x -y -z")
    part.importance[part.chart == 2] *= 0.35


def plant(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a potted plant with leaves along a stem, or with long leaves."""
    radius, pot = min(d, w) * 0.34, h * s.rng.uniform(0.2, 0.27)
    shade = choose(s, ("plaster_white", "concrete", "tile_terracotta", "metal_black"))
    outer = Surface("plain", shade.tint)
    s.lathe((0, 0, 0), [(0, 0), (radius * 0.72, 0), (radius, pot), (radius * 0.9, pot), (radius * 0.86, pot * 0.88)], outer, 18)
    s.lathe((0, 0, 0), [(radius * 0.88, pot * 0.88), (0, pot * 0.9)], surface_of("soil"), 12)
    s.collide((-radius, -radius, 0), (radius, radius, h * 0.6))
    base = APPEARANCES["leaves"][1]
    reach, style = min(d, w) / 2, s.rng.random()
    count = int(46 + 30 * s.rng.random())
    golden = 2.39996
    for k in range(count):
        level = (k + 0.5) / count
        angle = k * golden + s.rng.uniform(-0.3, 0.3)
        if style < 0.5:  # stem with leaves along its length
            root = np.array([0.02 * np.cos(angle), 0.02 * np.sin(angle), pot + (h * 0.93 - pot) * (0.15 + 0.8 * level)])
            length, droop, width = h * 0.17 * (1.25 - 0.5 * level), 0.35 - 0.5 * level, 0.42
        else:  # long leaves from the pot
            root = np.array([0.04 * np.cos(angle), 0.04 * np.sin(angle), pot * 0.9])
            length, droop, width = (h - pot) * s.rng.uniform(0.65, 1.0), 0.5 - 1.0 * level, 0.11
        _leaf(s, root, angle, length, droop, width, reach, h, surface_of("leaves", vary_color(base, s.rng, 0.09), 0.7))
    if style < 0.5:
        sway = s.rng.uniform(-0.03, 0.03, 2)
        path = [
            (sway[0] * t * (1 - t) * 4, sway[1] * t * (1 - t) * 4, pot * 0.85 + (h * 0.93 - pot * 0.85) * t)
            for t in np.linspace(0, 1, 6)
        ]
        s.tube(path, np.linspace(0.016, 0.006, 6), surface_of("wood_walnut"), 6)


def _leaf(
    s: ObjectBuilder,
    root: np.ndarray,
    angle: float,
    length: float,
    droop: float,
    width: float,
    reach: float,
    top: float,
    surface: Surface,
) -> SurfacePart:
    """Adds a leaf that bends under its weight, within ``reach`` (m) of the axis and below ``top`` (m)."""
    t = np.linspace(0, 1, 6)
    rise = (1.1 - abs(droop)) * t - (0.55 + droop) * t**2
    out = np.minimum(length * (0.55 + 0.45 * (droop > 0)) * t, reach - 0.02)
    middle = np.column_stack([np.cos(angle) * out, np.sin(angle) * out, length * rise]) + root
    middle[:, 2] = np.clip(middle[:, 2], 0.06, top)
    side = np.array([-np.sin(angle), np.cos(angle), 0.0])
    half = length * width * 0.5 * np.sin(np.pi * np.clip(t, 0.03, 0.97)) ** 0.8
    grid = np.stack(
        [middle - side * half[:, None], middle + np.array([0, 0, -0.12]) * half[:, None], middle + side * half[:, None]], axis=1
    )
    limit = np.linalg.norm(grid[..., :2], axis=2, keepdims=True)
    grid[..., :2] *= np.minimum(1.0, reach / np.maximum(limit, 1e-6))
    return s.sheet(grid, surface)


def rug(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a rug with a border."""
    color = vary_color(
        [(0.62, 0.28, 0.22), (0.72, 0.66, 0.56), (0.32, 0.38, 0.46), (0.55, 0.54, 0.50)][int(s.rng.integers(4))], s.rng, 0.05
    )
    part = s.box((-d / 2, -w / 2, 0), (d / 2, w / 2, h), Surface("rug", color, 1.0), 0.003, "-z")
    # The pattern needs normalised coordinates, -1 to 1 between the edges.
    part.pattern = part.vertices[part.triangles] / np.array([d / 2, w / 2, 1.0])
    part.pattern[..., 2] = float(s.rng.integers(3))
    s.collide((-0.01, -0.01, 0), (0.01, 0.01, 0.001))


def curtain(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a curtain in folds on a rod."""
    names = ("linen", "fabric_beige", "fabric_grey", "linen", "fabric_green", "fabric_blue")
    cloth = surface_of(names[int(np.random.default_rng((s.style, 32)).integers(len(names)))])  # same for all windows
    folds, steps, rows = max(3, round(w / 0.085)), 6, 5
    y = np.linspace(-w / 2, w / 2, folds * steps + 1)
    phase = np.linspace(0, 2 * np.pi * folds, len(y))
    grid = np.empty((len(y), rows, 3))
    for k, z in enumerate(np.linspace(0.01, h - 0.04, rows)):
        loose = 1.0 - 0.45 * (k / (rows - 1))
        swing = 0.25 * np.sin(phase * 0.37 + s.rng.uniform(0, 6)) * loose
        grid[:, k] = np.column_stack([np.clip((np.sin(phase) * loose + swing) * d * 0.42, -d / 2, d / 2), y, np.full(len(y), z)])
    s.sheet(grid, cloth)
    s.tube([(0, -w / 2 - 0.0, h - 0.02), (0, w / 2, h - 0.02)], 0.011, surface_of("metal_black"), 8)


def painting(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a picture in a frame."""
    frame = choose(s, ("wood_black", "wood_oak", "wood_white", "metal_brass"))
    rim = 0.025
    for side in (-1, 1):
        s.box((-d / 2, side * w / 2, 0), (d / 2, side * (w / 2 - rim), h), frame, 0.004, "-x")
    s.box((-d / 2, -w / 2 + rim, 0), (d / 2, w / 2 - rim, rim), frame, 0.004, "-x")
    s.box((-d / 2, -w / 2 + rim, h - rim), (d / 2, w / 2 - rim, h), frame, 0.004, "-x")
    x, board = d / 2 - 0.012, 0.06 if s.rng.random() < 0.6 else 0.0
    y, z = w / 2 - rim, h - rim
    s.quad([(x, -y, rim), (x, y, rim), (x, y, z), (x, -y, z)], surface_of("paper"))
    y, low, z = y - board, rim + board, z - board
    number = float(s.rng.integers(0, 1000))
    pattern = [(-1, -1, number), (1, -1, number), (1, 1, number), (-1, 1, number)]
    s.quad(
        [(x + 0.002, -y, low), (x + 0.002, y, low), (x + 0.002, y, z), (x + 0.002, -y, z)],
        Surface("art", sample_vivid_color(s.rng, (0.2, 0.6), (0.5, 0.9)), 1.4),
        pattern,
    )
    s.quad(
        [(-d / 2, w / 2, 0), (-d / 2, -w / 2, 0), (-d / 2, -w / 2, h), (-d / 2, w / 2, h)],
        Surface("plain", (0.5, 0.4, 0.3), 0.15),
    )


def bed(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a bed with headboard (at the back), mattress, duvet and pillows."""
    frame = choose(s, (*WOODS, "fabric_grey", "fabric_beige"))
    back, base = -d / 2 + 0.07, 0.30
    if frame.material == "fabric":
        s.cushion((-d / 2, -w / 2, 0.0), (back, w / 2, h), frame, 9, 8)
    else:
        s.box((-d / 2, -w / 2, 0.0), (back, w / 2, h), frame, 0.012, "-x -z")
    s.box((back, -w / 2, 0.10), (d / 2, w / 2, base), frame, 0.01, "-x -z +z")
    legs(s, d, w, 0.1, surface_of("wood_black"), 0.025, 0.1)
    top = 0.52
    s.cushion(
        (back, -w / 2 + 0.03, base - 0.04), (d / 2 - 0.03, w / 2 - 0.03, top), surface_of("linen", (0.92, 0.91, 0.89)), 14, 6
    )
    _duvet(s, (back + 0.62, d / 2 - 0.005), w / 2, top)
    count = 2 if w > 1.3 else 1
    for k in range(count):
        for level in range(2):
            first = len(s.parts)
            tone = vary_color((0.92, 0.91, 0.88), s.rng, 0.02) if level == 0 else vary_color((0.74, 0.76, 0.76), s.rng, 0.06)
            width = 0.33 if level == 0 else 0.27
            part = s.cushion((-0.09, -width, -0.2), (0.09, width, 0.2), surface_of("linen", tone), 2.8, 8, noise=0.012)
            part.vertices[:, 0] *= 1.0 - 0.45 * (np.abs(part.vertices[:, 1]) / width * np.abs(part.vertices[:, 2]) / 0.2)
            y = (k - (count - 1) / 2) * w * 0.47 + s.rng.uniform(-0.03, 0.03)
            s.transform(
                first,
                pose_matrix(
                    (back + 0.17 + 0.17 * level, y, top + 0.17 - 0.03 * level), s.rng.uniform(-0.08, 0.08), -0.75 + 0.1 * level
                ),
            )
    s.collide((-d / 2, -w / 2, 0), (back, w / 2, h))
    s.collide((back, -w / 2, 0), (d / 2, w / 2, top + 0.03))


def _duvet(s: ObjectBuilder, along: tuple[float, float], half: float, top: float) -> None:
    """Adds a duvet that covers the bed and hangs over its sides in soft folds."""
    names = ("fabric_blue", "fabric_beige", "linen", "fabric_striped", "fabric_green", "fabric_grey")
    cloth = choose(s, names)
    nx, ny = 22, 30
    x = np.linspace(*along, nx)
    u = np.linspace(-1, 1, ny) * (half + 0.24)
    drop = np.maximum(np.abs(u) - (half - 0.03), 0.0)
    y = np.sign(u) * np.minimum(np.abs(u), half - 0.03 + 0.028 * np.tanh(drop * 30))
    z = top + 0.035 - np.maximum(drop - 0.01, 0.0)
    grid = np.stack(
        [np.broadcast_to(x[:, None], (nx, ny)), np.broadcast_to(y, (nx, ny)), np.broadcast_to(z, (nx, ny))], axis=-1
    ).copy()
    phase = s.rng.uniform(0, 6.3, 4)
    X, U = np.meshgrid(x, u, indexing="ij")
    wrinkle = (
        0.008 * np.sin(5 * X + 3 * U + phase[0])
        + 0.006 * np.sin(9 * X - 7 * U + phase[1])
        + 0.004 * np.sin(17 * U + 4 * X + phase[2])
    )
    on_top = np.abs(U) < half - 0.03
    grid[..., 2] += np.where(on_top, wrinkle, 0)
    grid[..., 1] += np.where(
        on_top, 0, np.sign(U) * np.clip(0.012 * np.sin(16 * X + phase[3]), -0.005, 1) * np.minimum(1, drop * 8)
    )
    grid[0, :, 2] -= np.where(on_top[0], 0.03, 0)
    grid[..., 2] = np.maximum(grid[..., 2], 0.12)
    grid[..., 1] = np.clip(grid[..., 1], -half - 0.012, half + 0.012)
    s.sheet(grid, cloth)


BUILDERS = {
    "sofa": sofa, "armchair": armchair, "coffee_table": table, "dining_table": table, "meeting_table": table, "tv_board": cabinet,
    "sideboard": cabinet, "nightstand": cabinet, "chest_of_drawers": cabinet, "shoe_cabinet": cabinet, "wardrobe": wardrobe,
    "bookshelf": bookshelf, "plant": plant, "rug": rug, "curtain": curtain, "painting": painting,
    "double_bed": bed, "single_bed": bed,
}  # fmt: skip
