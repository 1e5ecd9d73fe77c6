"""Draws the base colours of surfaces: periodic tiles of plaster, planks, brick, cloth, ..., and single pictures (rugs, paintings). NumPy only.

A tile continues at its opposite edges. Its noise is filtered in the Fourier domain or drawn on a wrapped lattice, and holds little of the lowest
frequencies, so that its repetition does not strike the eye. Images have row 0 at the bottom.
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.geometry.colours import linear_from_srgb, srgb_from_linear

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Tint = tuple[float, float, float]
_BRIGHTEST = 0.97
"""Linear value of the brightest texels of a tile that is multiplied by a colour."""
_PICTURE_PX = 512
"""Edge of a painting, pixels."""


@dataclass(frozen=True, order=True)
class TileName:
    """What a tile shows."""

    pattern: str
    """Key of ``PATTERNS``."""
    tint: Tint = (1.0, 1.0, 1.0)
    """Colour, sRGB; white for patterns that are multiplied by the colour of each surface."""
    number: int = 0
    """Seed of a single picture."""

    @property
    def file(self) -> str:
        """File name without suffix, different for each tile."""
        if self.tint == (1.0, 1.0, 1.0) and not self.number:
            return f"tile_{self.pattern}"
        return f"tile_{self.pattern}_{zlib.crc32(repr((self.tint, self.number)).encode()):08x}"


@dataclass(frozen=True)
class Tile:
    """An image of base colours."""

    pixels: NDArray[np.uint8]
    """(H, W, 3) sRGB, row 0 at the bottom."""
    size: tuple[float, float]
    """Width and height, m; for single pictures in the units of their pattern coordinates, -1 to 1."""

    is_single: bool
    """Whether it is a single picture, which is not repeated."""

    @functools.cached_property
    def mean(self) -> F64:
        """Mean colour, linear, (3,)."""
        return np.asarray(linear_from_srgb(self.pixels / 255.0).mean(axis=(0, 1)))

    def coords(self, pattern_coords: F64) -> F64:
        """Returns texture coordinates, (..., 2), 1 = a whole tile, from the lower left, of pattern coordinates (..., 2 or more)."""
        if not self.is_single:
            return np.asarray(pattern_coords[..., :2] / self.size)
        # The outermost texels are not mixed with those of the opposite edge.
        inner = 1.0 - 1.0 / np.array([self.pixels.shape[1], self.pixels.shape[0]])
        return np.asarray(0.5 + pattern_coords[..., :2] / self.size * inner)


def is_tinted(pattern: str) -> bool:
    """Returns whether the tile of a pattern is multiplied by the colour of each surface."""
    return pattern not in SINGLE_PICTURES and pattern not in _OWN_COLORS


def tiles_of(patterns: list[str], pattern: I64, tint: ArrayLike, pattern_coords: ArrayLike) -> tuple[list[TileName], I64]:
    """Returns the tiles of triangles.

    Args:
        patterns: names of patterns.
        pattern: index of the pattern of each triangle, (F,).
        tint: colour of each triangle, (F, 3), sRGB.
        pattern_coords: pattern coordinates of the corners, and the number of a single picture, (F, 3, 3).

    Returns:
        The tiles, and the index of the tile of each triangle, (F,); -1 = its pattern has no tile.
    """
    has_own_color = np.array([p in PATTERNS and not is_tinted(p) for p in patterns])[pattern]
    is_single = np.array([p in SINGLE_PICTURES for p in patterns])[pattern]
    rows = np.column_stack(
        [
            pattern,
            np.where(has_own_color[:, None], np.round(np.asarray(tint, dtype=float), 4), 1.0),
            np.where(is_single, np.asarray(pattern_coords)[:, 0, 2], 0.0),
        ]
    )
    unique, index = np.unique(rows, axis=0, return_inverse=True)
    names: list[TileName] = []
    slots = np.full(len(unique), -1)
    for k, (number, r, g, b, picture) in enumerate(unique.tolist()):
        if patterns[int(number)] in PATTERNS:
            slots[k] = len(names)
            names.append(TileName(patterns[int(number)], (r, g, b), round(picture)))
    return names, slots[np.asarray(index).reshape(-1)]


def factors_of(tile: Tile, pattern: str, tint: ArrayLike) -> F64:
    """Returns the linear factors, (F, 3), 0 to 1, that give a tile the mean colours ``tint``, (F, 3), sRGB."""
    colors = linear_from_srgb(np.asarray(tint, dtype=float))
    return np.minimum(colors / tile.mean, 1.0) if is_tinted(pattern) else np.ones_like(colors)


@functools.lru_cache(maxsize=64)
def draw_tile(name: TileName) -> Tile:
    """Draws a tile; the same name gives the same image, whose pixels cannot be written."""
    canvas_size, size, draw = PATTERNS[name.pattern]
    canvas = _Canvas(canvas_size, size, np.random.default_rng((zlib.crc32(name.pattern.encode()), name.number)), name)
    color = np.broadcast_to(draw(canvas), (canvas_size[1], canvas_size[0], 3))
    if is_tinted(name.pattern):
        color = color * (_BRIGHTEST / np.percentile(color.max(axis=2), 99.5))
    pixels = np.round(srgb_from_linear(np.clip(color, 0.0, 1.0)) * 255).astype(np.uint8)
    pixels.flags.writeable = False
    return Tile(pixels, size, name.pattern in SINGLE_PICTURES)


class _Canvas:
    """Size and noise of one tile. Lengths in metres; x to the right, along the grain; y upwards."""

    def __init__(self, size_px: tuple[int, int], size: tuple[float, float], rng: np.random.Generator, name: TileName) -> None:
        self.width, self.height = size_px
        self.size = size
        self.rng = rng
        self.number = name.number
        self.tint = np.asarray(linear_from_srgb(np.asarray(name.tint)))
        """Colour, linear; 1 for tiles that are multiplied by a colour."""
        self.x = (np.arange(self.width) + 0.5) * (size[0] / self.width)
        self.y = ((np.arange(self.height) + 0.5) * (size[1] / self.height))[:, None]

    def noise(self, wave_x: float, wave_y: float | None = None, octaves: float = 1.0) -> F64:
        """Returns periodic noise, (H, W), mean 0, standard deviation 1, with wavelengths about ``wave_x`` and ``wave_y`` (m).

        ``octaves``: standard deviation of the wavelengths, octaves.
        """
        wave_y = wave_x if wave_y is None else wave_y
        fx = np.fft.rfftfreq(self.width, self.size[0] / self.width) * wave_x
        fy = np.fft.fftfreq(self.height, self.size[1] / self.height)[:, None] * wave_y
        radius = np.maximum(np.hypot(fx, fy), 1e-9)
        # Per octave, the number of frequencies grows with the square, so that the density of power falls with it.
        window = np.exp(-0.5 * (np.log2(radius) / octaves) ** 2) / radius
        window[0, 0] = 0.0
        white = np.fft.rfft2(self.rng.standard_normal((self.height, self.width), dtype=np.float32))
        result = np.fft.irfft2(white * window, (self.height, self.width))
        return np.asarray(result / result.std())

    def cells(self, cell: float, jitter: float = 0.9) -> tuple[F64, F64, I64]:
        """Returns distances (in cells, (H, W)) from the nearest and the second nearest of scattered points, and the nearest one's number."""
        nx, ny = max(3, round(self.size[0] / cell)), max(3, round(self.size[1] / cell))
        points = 0.5 + jitter * (self.rng.random((ny, nx, 2), dtype=np.float32) - 0.5)
        u = (self.x * (nx / self.size[0])).astype(np.float32)[None, :]
        v = (self.y * (ny / self.size[1])).astype(np.float32)
        column, row = np.floor(u).astype(np.int32), np.floor(v).astype(np.int32)
        first = np.full((self.height, self.width), 9.0, dtype=np.float32)
        second, number = first.copy(), np.zeros(first.shape, dtype=np.int32)
        for j in (-1, 0, 1):
            for i in (-1, 0, 1):
                r, c = (row + j) % ny, (column + i) % nx
                distance = np.hypot(column + i + points[r, c, 0] - u, row + j + points[r, c, 1] - v)
                is_nearer = distance < first
                second = np.where(is_nearer, first, np.minimum(second, distance))
                number = np.where(is_nearer, r * nx + c, number)
                first = np.where(is_nearer, distance, first)
        return first.astype(float), second.astype(float), number.astype(np.int64)

    def laid(self, columns: int, rows: int, shifts: ArrayLike) -> _Laid:
        """Lays equal rectangles in rows. ``shifts``: shift of each row to the right, (rows,), lengths of a rectangle."""
        v = self.y * (rows / self.size[1])
        row = np.minimum(np.floor(v).astype(np.int64), rows - 1)
        u = self.x[None, :] * (columns / self.size[0]) - np.asarray(shifts)[row]
        column = np.floor(u)
        length, width = self.size[0] / columns, self.size[1] / rows
        along, across = (u - column) * length, np.broadcast_to((v - row) * width, u.shape)
        number = row * columns + column.astype(np.int64) % columns
        return _Laid(number, np.stack([along, length - along, across, width - across]), columns * rows)


@dataclass(frozen=True)
class _Laid:
    """Rectangles laid in rows."""

    number: I64
    """Number of the rectangle at each texel, (H, W)."""
    edges: F64
    """Distances from its left, right, lower and upper edge, (4, H, W), m."""
    count: int
    """Number of rectangles."""

    def joint(self, gap: float, soft: float, rough: ArrayLike = 0.0) -> F64:
        """Returns the share of joints of width ``gap`` at each texel, 0 to 1, with edges ``soft`` wide; ``rough``: shift of the edges, m."""
        return 1.0 - _step(self.edges.min(axis=0) + np.asarray(rough), gap / 2 - soft / 2, gap / 2 + soft / 2)

    def each(self, values: NDArray[Any]) -> NDArray[Any]:
        """Returns the value of its rectangle for each texel; ``values``: (count, ...)."""
        return np.asarray(values[self.number])


def _step(value: F64, low: float, high: float) -> F64:
    """Returns a smooth step from 0 at ``low`` to 1 at ``high``."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _mix(share: F64, a: ArrayLike, b: ArrayLike) -> F64:
    """Returns the mix of two colours, (..., 3); ``share`` (...) of ``b``."""
    first, second = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    return np.asarray(first + share[..., None] * (second - first))


def _grey(tone: F64) -> F64:
    """Returns tones, (H, W), as grey, (H, W, 1)."""
    return np.asarray(np.maximum(tone, 0.02)[..., None])


def _plaster(c: _Canvas) -> F64:
    """Returns painted plaster: the grain of a roller, lit from above, and small flaws."""
    height = c.noise(0.007, octaves=0.6) + 0.8 * c.noise(0.022, octaves=0.7)
    relief = np.roll(height, -1, axis=0) - height
    return _grey(1.0 + 0.018 * relief / relief.std() + 0.007 * c.noise(0.05) + 0.005 * c.noise(0.25, octaves=0.7))


def _concrete(c: _Canvas) -> F64:
    distance, _, number = c.cells(0.022)
    radius = 0.16 * c.rng.random(number.max() + 1) ** 6
    pores = 1.0 - _step(distance - radius[number], -0.02, 0.05)
    cloud = 0.045 * c.noise(0.14, octaves=1.1) + 0.025 * c.noise(0.4, octaves=0.6)
    return _grey((1.0 + cloud + 0.045 * c.noise(0.008, octaves=1.2)) * (1.0 - 0.3 * pores))


def _bricks(c: _Canvas) -> F64:
    """Returns bricks in half bond; edges are worn, mortar lies deeper and is shaded below each brick."""
    laid = c.laid(8, 26, np.arange(26) % 2 * 0.5)
    rough = 0.0008 * c.noise(0.018, octaves=0.8)
    joint = laid.joint(0.010, 0.004, rough)
    tone = np.exp(laid.each(c.rng.normal(0.0, 0.16, laid.count)))
    hue = laid.each(c.rng.normal(0.0, 0.05, laid.count))
    burnt = laid.each((c.rng.random(laid.count) < 0.08).astype(float)) * 0.22
    surface = 1.0 + 0.09 * c.noise(0.006, octaves=1.1) + 0.07 * c.noise(0.04)
    pits = _step(c.noise(0.005, octaves=0.5), 1.7, 2.3)
    face = (
        (tone * surface * (1.0 - 0.3 * pits) * (1.0 - burnt))[..., None]
        * c.tint
        * np.stack([1 + hue, np.ones_like(hue), 1 - hue], -1)
    )
    left, right, lower, upper = laid.edges
    face = face * (1.0 + 0.16 * (1 - _step(upper, 0.004, 0.009)) - 0.14 * (1 - _step(lower, 0.004, 0.009)))[..., None]
    is_below = 1.0 - _step(upper, 0.0, 0.005)  # the upper half of the joint belongs to the brick below it
    shade = 0.86 + 0.06 * c.noise(0.006) - 0.22 * (1.0 - is_below) * (np.minimum(left, right) > 0.004)
    mortar = linear_from_srgb(np.array([0.60, 0.57, 0.52]))
    return _mix(joint, face, shade[..., None] * mortar)


def _tiles(columns: int, rows: int, offset: float, variation: float, gap: float = 0.003) -> Callable[[_Canvas], F64]:
    def tiles(c: _Canvas) -> F64:
        laid = c.laid(columns, rows, np.arange(rows) % 2 * offset)
        joint = laid.joint(gap, 0.0022, 0.0)
        tone = 1.0 + laid.each(np.clip(c.rng.normal(0.0, 0.4 * variation, laid.count), -variation, variation))
        face = tone * (1.0 + 0.012 * c.noise(0.09, octaves=0.9) + 0.012 * c.noise(0.012, octaves=1.0))
        # Edges are rounded: lit at the top, dark at the bottom.
        _, _, lower, upper = laid.edges
        face *= 1.0 + 0.05 * (1 - _step(upper, 0.001, 0.005)) - 0.05 * (1 - _step(lower, 0.001, 0.005))
        grout = 0.36 + 0.03 * c.noise(0.008) + 0.03 * c.noise(0.2)
        return _grey(face + joint * (grout - face))

    return tiles


def _checker(c: _Canvas) -> F64:
    laid = c.laid(6, 6, np.zeros(6))
    number = np.arange(laid.count)
    dark = laid.each(((number // 6 + number % 6) % 2).astype(float))
    tone = 1.0 + laid.each(c.rng.normal(0.0, 0.03, laid.count)) + 0.02 * c.noise(0.06) + 0.015 * c.noise(0.008)
    tile = tone[..., None] * _mix(dark, c.tint, linear_from_srgb(np.array([0.22, 0.23, 0.24])))
    return _mix(laid.joint(0.003, 0.0022), tile, np.full(3, 0.10))


def _grain(c: _Canvas, rings: int, strength: float) -> F64:
    """Returns darkness of wood grain along x, (H, W), mean about 0: growth rings in long arches, fibres, pores."""
    warp = 2.0 * c.noise(1.3, 0.17, 0.6) + 0.25 * c.noise(0.5, 0.05, 0.6)
    phase = c.y * (rings / c.size[1]) + warp
    ring = phase - np.floor(phase)
    late = ring**2.5 * (1.0 - _step(ring, 0.9, 1.0))
    fibres = c.noise(0.16, 0.0045, 0.8)
    pores = _step(c.noise(0.035, 0.0028, 0.5), 1.0, 2.4)
    broad = c.noise(0.9, 0.07, 0.6)
    return np.asarray(strength * (0.34 * (late - 0.22) + 0.055 * fibres + 0.22 * (pores - 0.08) + 0.05 * broad))


def _wood_color(darkness: F64) -> F64:
    """Returns colours relative to that of the wood, (H, W, 3): dark grain is redder."""
    return np.asarray(np.exp(-darkness[..., None] * np.array([0.86, 1.0, 1.16])))


def _wood(c: _Canvas) -> F64:
    return _wood_color(_grain(c, 44, 1.0))


def _planks(columns: int, rows: int, rings: int, variation: float, gap: float) -> Callable[[_Canvas], F64]:
    def planks(c: _Canvas) -> F64:
        # No end joint lies next to that of the row below.
        shifts = np.cumsum(c.rng.uniform(0.27, 0.73, rows))
        shifts[-1] = shifts[0] + 0.5
        laid = c.laid(columns, rows, shifts)
        grain = _grain(c, rings, 0.9)
        j, i = (laid.each(c.rng.integers(0, n, laid.count)) for n in (c.height, c.width))
        y, x = np.mgrid[: c.height, : c.width]
        own = grain[(y + j) % c.height, (x + i) % c.width]  # each plank is cut from another place
        darkness = own + laid.each(c.rng.normal(0.0, variation, laid.count))
        warmth = laid.each(c.rng.normal(0.0, 0.02, laid.count))
        color = _wood_color(darkness) * np.stack([1 + warmth, np.ones_like(warmth), 1 - warmth], axis=-1)
        joint = laid.joint(gap, 0.0022)
        edge = 1.0 - 0.1 * (1.0 - _step(laid.edges.min(axis=0), 0.001, 0.0045))
        return np.asarray(color * (edge * (1.0 - 0.72 * joint))[..., None])

    return planks


def _stripes(c: _Canvas) -> F64:
    t = c.x[None, :] / 0.12
    band = _step(np.abs(t - np.floor(t) - 0.5), 0.245, 0.255)
    paper = 1.0 + 0.012 * c.noise(0.005, octaves=0.8) + 0.008 * c.noise(0.02, 0.1)
    return _grey(paper * (1.04 - 0.10 * band))


def _carpet(c: _Canvas) -> F64:
    """Returns cut pile: tufts, each lit at the top and dark around, some turned by steps."""
    distance, second, number = c.cells(0.0048)
    tuft = 1.0 - 0.5 * _step(distance, 0.1, 0.75)
    tone = np.exp(c.rng.normal(0.0, 0.10, number.max() + 1))[number]
    lay = 0.035 * c.noise(0.09, octaves=0.9) + 0.02 * c.noise(0.3, octaves=0.5)
    gap = 1.0 - 0.22 * (1.0 - _step(second - distance, 0.0, 0.25))
    return _grey(tuft * tone * gap * (1.0 + lay) + 0.03 * c.noise(0.003, octaves=0.5))


def _weave(c: _Canvas, pitch: float) -> F64:
    """Returns the tone of a plain weave, (H, W), mean about 1: warp and weft over and under, threads of uneven strength and colour."""
    nx, ny = 2 * round(c.size[0] / pitch / 2), 2 * round(c.size[1] / pitch / 2)
    u, v = c.x[None, :] * (nx / c.size[0]), c.y * (ny / c.size[1])
    i, j = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    is_warp = (i + j) % 2 == 0
    across = np.where(is_warp, u - i, v - j) - 0.5
    along = np.where(is_warp, v - j, u - i) - 0.5
    round_thread = np.sqrt(np.maximum(1.0 - (1.75 * across) ** 2, 0.05)) * (1.0 - 0.9 * along**2)
    tone_i, tone_j = (1.0 + 0.03 * c.rng.standard_normal(n) for n in (nx, ny))
    thread = np.where(is_warp, 1.03 * tone_i[i], 0.97 * tone_j[j])
    slub = 1.0 + 0.04 * np.where(is_warp, c.noise(0.003, 0.03), c.noise(0.03, 0.003))
    return np.asarray((0.68 + 0.36 * round_thread) * thread * slub * (1.0 + 0.012 * c.noise(0.07)))


def _fabric(c: _Canvas) -> F64:
    return _grey(_weave(c, 0.003))


def _cloth_stripes(c: _Canvas) -> F64:
    t = c.y / 0.09 + 0.0 * c.x
    band = _step(t - np.floor(t), 0.66, 0.68) * (1.0 - _step(t - np.floor(t), 0.98, 1.0))
    color = _mix(band, c.tint, linear_from_srgb(np.array([0.22, 0.31, 0.42])))
    weave = _weave(c, 0.003)
    return np.asarray((weave / weave.mean())[..., None] * color)


def _leather(c: _Canvas) -> F64:
    """Returns grained leather: rounded cells with creases between them."""
    first, second, number = c.cells(0.005)
    crease = 1.0 - _step(second - first, 0.0, 0.35)
    tone = (1.0 + 0.04 * c.rng.standard_normal(number.max() + 1))[number]
    return _grey(tone * (1.05 - 0.3 * crease) * (1.0 + 0.025 * c.noise(0.08, octaves=0.8) + 0.03 * c.noise(0.01)))


def _marble(c: _Canvas) -> F64:
    """Returns polished stone in slabs of 0.6 m, with veins from slab to slab in another place."""
    ridges = c.noise(0.38, 0.3, 0.8) + 0.35 * c.noise(0.07, octaves=0.7)
    fine = c.noise(0.16, octaves=0.9) + 0.25 * c.noise(0.03, octaves=0.7)
    strength = 0.55 + 0.45 * np.tanh(1.2 * c.noise(0.3, octaves=0.6))
    vein = np.exp(-((ridges / 0.09) ** 2)) * strength + 0.35 * np.exp(-((fine / 0.06) ** 2)) * strength
    halo = np.exp(-((ridges / 0.45) ** 2))
    cloud = 1.0 + 0.02 * c.noise(0.2) + 0.012 * c.noise(0.015)
    laid = c.laid(4, 4, np.zeros(4))
    j, i = (laid.each(c.rng.integers(0, n, laid.count)) for n in (c.height, c.width))
    y, x = np.mgrid[: c.height, : c.width]
    own = (0.5 * vein + 0.1 * halo)[(y + j) % c.height, (x + i) % c.width]
    stone = _mix(np.clip(own, 0.0, 0.8), cloud[..., None] * c.tint, 0.42 * c.tint * np.array([0.98, 1.0, 1.03]))
    return _mix(laid.joint(0.002, 0.0022), stone, 0.62 * c.tint)


def _terrazzo(c: _Canvas) -> F64:
    """Returns chips of stone of two sizes in a ground."""
    ground = 1.0 + 0.03 * c.noise(0.004, octaves=0.8) + 0.012 * c.noise(0.1)
    color = np.repeat(_grey(ground), 3, axis=2)
    for cell, share in ((0.006, 0.5), (0.017, 0.62)):
        first, second, number = c.cells(cell, 1.0)
        chosen = (c.rng.random(number.max() + 1) < share) * c.rng.uniform(0.12, 0.5, number.max() + 1)
        inside = (
            _step(second - first, 0.10, 0.2) * (1.0 - _step(first - chosen[number] * 1.3, -0.04, 0.04)) * (chosen[number] > 0)
        )
        tone = c.rng.choice([0.42, 0.62, 0.8, 1.12, 1.16], number.max() + 1) * c.rng.normal(1.0, 0.05, number.max() + 1)
        hue = c.rng.normal(0.0, 0.035, number.max() + 1)[number]
        chip = (tone[number] * (1.0 + 0.04 * c.noise(0.004)))[..., None] * np.stack([1 + hue, np.ones_like(hue), 1 - hue], -1)
        color = _mix(inside, color, chip)
    return color


def _leaves(c: _Canvas) -> F64:
    veins = np.abs(c.noise(0.05, 0.016, 0.5))
    return _grey((1.0 + 0.14 * c.noise(0.03) + 0.05 * c.noise(0.005)) * (1.0 + 0.15 * (1.0 - _step(veins, 0.0, 0.12))))


def _cardboard(c: _Canvas) -> F64:
    flutes = 0.012 * np.sin(2 * np.pi * c.y * (round(c.size[1] / 0.0075) / c.size[1]))
    flecks = _step(c.noise(0.005, 0.003, 0.5), 2.2, 3.0)
    return _grey((1.0 + flutes + 0.025 * c.noise(0.03, 0.008) + 0.02 * c.noise(0.004)) * (1.0 - 0.2 * flecks))


def _screen(c: _Canvas) -> F64:
    """Returns black glass with a faint reflection of the room."""
    return _mix(0.5 + 0.25 * np.tanh(c.noise(0.9, octaves=0.5)), c.tint, np.array([0.012, 0.013, 0.015]))


def _rug(c: _Canvas) -> F64:
    """Returns a knotted rug with a border, and diamonds in the field if its number is above 0."""
    x, y = np.broadcast_arrays(2.0 * c.x / c.size[0] - 1.0, 2.0 * c.y / c.size[1] - 1.0)
    knot = 2.0 / 320.0  # motifs follow the knots
    ax, ay = (np.round(np.abs(a) / knot) * knot for a in (x, y))
    edge = np.maximum(ax, ay)
    border = (edge > 0.86) & (edge < 0.93)
    line = (edge > 0.81) & (edge < 0.825)
    fold = np.abs((3.0 * ax) % 1.0 - 0.5) + np.abs((4.0 * ay) % 1.0 - 0.5)
    diamonds = (edge < 0.79) & ((3.0 * fold) % 1.0 > 0.62)
    meander = border & ((np.floor(np.where(ax > ay, y, x) * 26) + np.floor((edge - 0.86) * 30)) % 2 == 0)
    ornament = (border & ~meander) | line | (diamonds & (c.number > 0))
    wear = np.clip(0.78 + 0.1 * c.noise(0.3), 0.45, 0.95)
    color = _mix(np.where(ornament, wear, 0.0), c.tint, linear_from_srgb(np.array([0.80, 0.76, 0.68])))
    dark = meander.astype(float) * 0.55
    pile = 1.0 + 0.10 * c.noise(0.006, octaves=0.6) + 0.05 * c.noise(0.02, 0.3) + 0.03 * c.noise(0.25)
    return np.asarray(color * (pile * (1.0 - dark))[..., None])


def _art(c: _Canvas) -> F64:
    """Returns an abstract picture: layers of hills, or fields of colour, in brush strokes on canvas."""
    height = np.broadcast_to(c.y / c.size[1], (c.height, c.width))
    if c.rng.random() < 0.55:
        level = 0.12 + 0.75 * height + 0.09 * c.noise(0.9, 0.5, 0.8) * (1.0 - 0.6 * height)
    else:
        level = 0.5 + 0.24 * c.noise(0.9, octaves=0.5)
    tones = linear_from_srgb(
        np.array([(0.20, 0.25, 0.31), (0.40, 0.48, 0.53), (0.74, 0.53, 0.41), (0.87, 0.75, 0.58), (0.90, 0.88, 0.83)])
    )
    tones = 0.55 * tones + 0.45 * c.tint * np.linspace(0.25, 1.3, 5)[:, None]
    position = np.clip((level + 0.006 * c.noise(0.05)) * 5, 0.0, 4.999)
    layer = np.floor(position).astype(np.int64)
    soft = _step(position - layer, 0.94, 1.0)
    paint = _mix(soft, tones[layer], tones[np.minimum(layer + 1, 4)])
    strokes = 1.0 + 0.05 * c.noise(0.25, 0.016, 0.7) + 0.03 * c.noise(0.05, 0.008, 0.6) + 0.06 * (position - layer - 0.5)
    return np.asarray(paint * strokes[..., None])


_Draw = Callable[[_Canvas], F64]
PATTERNS: dict[str, tuple[tuple[int, int], tuple[float, float], _Draw]] = {
    "plaster": ((1024, 1024), (1.6, 1.6), _plaster),
    "concrete": ((1024, 1024), (2.0, 2.0), _concrete),
    "brick": ((1024, 1024), (2.0, 26 * 0.077), _bricks),
    "tile_30": ((1024, 1024), (1.8, 1.8), _tiles(6, 6, 0.0, 0.05)),
    "tile_60": ((1280, 1280), (2.4, 2.4), _tiles(4, 4, 0.0, 0.08)),
    "metro": ((1024, 1024), (2.0, 2.0), _tiles(10, 20, 0.5, 0.06)),
    "checker": ((1024, 1024), (1.8, 1.8), _checker),
    "planks": ((1600, 1280), (3.2, 14 * 0.145), _planks(2, 14, 90, 0.13, 0.0024)),
    "parquet": ((1152, 1024), (5 * 0.42, 28 * 0.07), _planks(5, 28, 100, 0.13, 0.002)),
    "wood": ((1024, 1024), (2.0, 1.0), _wood),
    "stripes": ((768, 768), (0.96, 0.96), _stripes),
    "carpet": ((1024, 1024), (1.024, 1.024), _carpet),
    "fabric": ((768, 768), (0.576, 0.576), _fabric),
    "cloth_stripes": ((720, 720), (0.54, 0.54), _cloth_stripes),
    "leather": ((640, 640), (0.6, 0.6), _leather),
    "marble": ((1280, 1280), (2.4, 2.4), _marble),
    "terrazzo": ((1024, 1024), (1.28, 1.28), _terrazzo),
    "leaves": ((256, 256), (0.256, 0.256), _leaves),
    "cardboard": ((512, 512), (0.6, 0.6), _cardboard),
    "screen": ((128, 128), (2.0, 2.0), _screen),
    "rug": ((1024, 1024), (2.0, 2.0), _rug),
    "art": ((_PICTURE_PX, _PICTURE_PX), (2.0, 2.0), _art),
}  # fmt: skip
"""Size in pixels, size in metres (single pictures: in pattern coordinates), and the drawing of each pattern."""
SINGLE_PICTURES = ("rug", "art")
"""Patterns that fill a surface once, from -1 to 1, each in its own colours."""
_OWN_COLORS = ("brick", "checker", "cloth_stripes", "marble", "screen")
"""Patterns with more than one colour, which need a tile for each of their colours."""
