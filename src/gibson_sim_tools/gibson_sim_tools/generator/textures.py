"""Generates procedural textures: (H, W, 3) uint8 sRGB, RGB order, row 0 at the top. Each function takes a random generator."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Floats = NDArray[np.float64]
Rgb = tuple[float, float, float]


def _image(values: Floats) -> Image:
    return np.clip(np.rint(values * 255.0), 0, 255).astype(np.uint8)


def noise(rng: np.random.Generator, height: int, width: int, cells: tuple[int, int], octaves: int = 4) -> Floats:
    """Returns smooth noise, (height, width), about -1 to 1. ``cells``: cells of the coarsest octave, (down, across)."""
    total = np.zeros((height, width))
    for octave in range(octaves):
        shape = (min(height, cells[0] << octave), min(width, cells[1] << octave))
        coarse = rng.uniform(-1.0, 1.0, shape)
        total += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC) / (1 << octave)
    return total / 1.5


def plain(rng: np.random.Generator, color: Rgb, size: int = 256, roughness: float = 0.03) -> Image:
    """Returns paint or plaster: one colour with a slight, uneven grain."""
    grain = noise(rng, size, size, (4, 4), 6) * roughness
    return _image(np.array(color) * (1.0 + grain[..., None]))


def wall(rng: np.random.Generator, color: Rgb, size: int = 256) -> Image:
    """Returns painted plaster from ceiling (top row) to floor, darker towards both, as under ambient light."""
    v = np.linspace(0.0, 1.0, size)[:, None]
    shade = 1.0 - 0.22 * np.exp(-v / 0.06) - 0.26 * np.exp(-(1.0 - v) / 0.07) - 0.05 * v
    grain = noise(rng, size, size, (6, 6), 6) * 0.025
    return _image(np.array(color) * (shade * (1.0 + grain))[..., None])


def wood(rng: np.random.Generator, color: Rgb, height: int = 256, width: int = 256) -> Image:
    """Returns wood with a vertical grain."""
    wavy = noise(rng, height, width, (3, 5), 3) * 0.6
    across = np.linspace(0.0, 9.0, width)[None, :] + wavy
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * across)
    fibres = noise(rng, height, width, (2, 96), 2)
    value = 1.0 - 0.13 * rings - 0.08 * fibres - 0.05 * noise(rng, height, width, (2, 2), 3)
    tint = np.stack([value, value**1.15, value**1.35], axis=-1)
    return _image(np.array(color) * tint)


def fabric(rng: np.random.Generator, color: Rgb, size: int = 256) -> Image:
    """Returns a woven cloth."""
    y, x = np.mgrid[0:size, 0:size]
    weave = 0.06 * np.sin(x * np.pi / 2.0) * np.sin(y * np.pi / 2.0) + 0.05 * ((x // 4 + y // 4) % 2 - 0.5)
    value = 1.0 + weave + 0.08 * noise(rng, size, size, (5, 5), 5)
    return _image(np.array(color) * value[..., None])


def planks(rng: np.random.Generator, metres: tuple[float, float], px_per_m: int, color: Rgb) -> Floats:
    """Returns a wooden floor, (H, W, 3), 0 to 1, without shading; planks 0.14 m wide run along x (across the image)."""
    height, width = round(metres[1] * px_per_m), round(metres[0] * px_per_m)
    out = np.empty((height, width, 3))
    plank_px = 0.14 * px_per_m
    for row in range(int(np.ceil(height / plank_px))):
        top, bottom = round(row * plank_px), min(height, round((row + 1) * plank_px))
        if top >= bottom:
            continue
        strip = wood(rng, color, width, bottom - top).transpose(1, 0, 2).astype(np.float64) / 255.0
        edge = -rng.uniform(0.0, 1.4) * px_per_m
        while edge < width:
            length = rng.uniform(1.0, 1.8) * px_per_m
            low, high = max(0, round(edge)), min(width, round(edge + length))
            strip[:, low:high] *= rng.uniform(0.84, 1.1)
            strip[:, max(0, high - 1) : high] *= 0.6
            edge += length
        strip[:1] *= 0.62
        out[top:bottom] = strip
    return out


def tiles(rng: np.random.Generator, metres: tuple[float, float], px_per_m: int, color: Rgb, tile_size: float = 0.3) -> Floats:
    """Returns a tiled floor or wall, (H, W, 3), 0 to 1, without shading; square tiles with light joints. ``tile_size``: m."""
    height, width = round(metres[1] * px_per_m), round(metres[0] * px_per_m)
    y, x = (np.mgrid[0:height, 0:width] + 0.5) / px_per_m
    shades = rng.uniform(0.93, 1.04, (int(metres[1] / tile_size) + 2, int(metres[0] / tile_size) + 2))
    value = shades[(y / tile_size).astype(int), (x / tile_size).astype(int)] + 0.03 * noise(rng, height, width, (8, 8), 4)
    joint = (np.minimum(y % tile_size, x % tile_size) < 1.2 / px_per_m)[..., None]
    return np.where(joint, 0.72, np.clip(np.array(color) * value[..., None], 0.0, 1.0))


def shaded_floor(base: Floats, px_per_m: int, footprints: list[tuple[float, float, float, float]]) -> Image:
    """Darkens a floor along its walls and under furniture, as under ambient light.

    Args:
        base: colours, (H, W, 3), 0 to 1; row 0 is at the wall with the largest y.
        px_per_m: pixels per metre.
        footprints: footprints of furniture, (x0, y0, x1, y1), metres from the lower left corner of the room.
    """
    height, width = base.shape[:2]
    y, x = (np.mgrid[0:height, 0:width] + 0.5) / px_per_m
    to_wall = np.minimum(np.minimum(x, width / px_per_m - x), np.minimum(y, height / px_per_m - y))
    shade = 1.0 - 0.32 * np.exp(-to_wall / 0.16)
    under = np.zeros((height, width))
    for x0, y0, x1, y1 in footprints:
        rows = slice(max(0, height - round(y1 * px_per_m)), max(0, height - round(y0 * px_per_m)))
        under[rows, max(0, round(x0 * px_per_m)) : max(0, round(x1 * px_per_m))] = 1.0
    blurred = cv2.GaussianBlur(under, (0, 0), 0.09 * px_per_m)
    return _image(base * (shade * (1.0 - 0.55 * blurred))[..., None])


def ceiling(size: int = 128) -> Image:
    """Returns a white ceiling, darker towards its edges."""
    v = np.linspace(0.0, 1.0, size)
    edge = np.minimum(np.minimum(v, 1 - v)[:, None], np.minimum(v, 1 - v)[None, :])
    return _image(np.repeat((0.93 - 0.2 * np.exp(-edge / 0.05))[..., None], 3, axis=2))


def view_outside(rng: np.random.Generator, height: int = 256, width: int = 384) -> Image:
    """Returns the view through a window: sky, distant trees, a lawn."""
    v = np.linspace(0.0, 1.0, height)[:, None, None]
    sky = (1 - v) * np.array([0.55, 0.74, 0.95]) + v * np.array([0.93, 0.96, 0.98])
    out = np.repeat(sky, width, axis=1)
    clouds = np.clip(noise(rng, height, width, (3, 4), 5), 0.0, 1.0)[..., None]
    out = out * (1 - clouds) + clouds
    rows = np.linspace(0.0, 1.0, height)[:, None]
    for base, spread, color in ((0.66, 0.16, (0.45, 0.58, 0.50)), (0.76, 0.2, (0.27, 0.43, 0.24))):
        skyline = base - spread * (0.5 + 0.5 * noise(rng, 1, width, (1, 7), 5)[0])
        leaves = 1.0 + 0.25 * noise(rng, height, width, (24, 36), 3)[..., None]
        out = np.where((rows > skyline[None, :])[..., None], np.array(color) * leaves, out)
    lawn = np.array([0.42, 0.56, 0.27]) * (1.0 + 0.12 * noise(rng, height, width, (40, 20), 2)[..., None])
    out = np.where((rows > 0.86)[..., None], lawn, out)
    return _image(np.clip(out, 0.0, 1.0))


def painting(rng: np.random.Generator, height: int = 192, width: int = 256) -> Image:
    """Returns an abstract picture with a signature at the lower right, which makes mirroring visible."""
    palette = rng.uniform(0.15, 0.95, (6, 3))
    canvas = np.tile(palette[0], (height, width, 1)).copy()
    for color in palette[1:]:
        center = (int(rng.integers(0, width)), int(rng.integers(0, height)))
        axes = (int(rng.integers(20, width // 3)), int(rng.integers(15, height // 2)))
        layer = canvas.copy()
        cv2.ellipse(layer, center, axes, float(rng.uniform(0, 180)), 0, 360, tuple(map(float, color)), -1)
        canvas = 0.25 * canvas + 0.75 * layer
    canvas *= (1.0 + 0.1 * noise(rng, height, width, (20, 30), 3))[..., None]
    picture = _image(np.clip(canvas, 0.0, 1.0))
    cv2.putText(picture, "G.S.", (width - 52, height - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (20, 20, 20), 1, cv2.LINE_AA)
    return picture


def book_spines(rng: np.random.Generator, height: int = 96, width: int = 256) -> Image:
    """Returns a row of book spines."""
    out = np.full((height, width, 3), 0.1)
    x = 0
    while x < width - 4:
        width_px, height_px = int(rng.integers(6, 15)), int(rng.integers(int(height * 0.7), height))
        color = rng.uniform(0.12, 0.75, 3) * np.array([1.0, 0.85, 0.75])
        column = 1.0 - 0.35 * np.abs(np.linspace(-1, 1, width_px)) ** 2
        end = min(width, x + width_px)
        out[height - height_px :, x:end] = (color * column[:, None])[: end - x]
        band = height - height_px + int(rng.integers(8, max(9, height_px // 2)))
        out[band : band + 3, x:end] = np.clip(color * 1.8, 0, 1)
        x += width_px
    return _image(out)
