"""Packs and paints the atlas of the scanned rooms, one rectangle per surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim_tools.generator import textures

F64 = NDArray[np.float64]
Rgb = tuple[float, float, float]
_GUTTER = 3
"""Border that extends each rectangle's picture, for filtering and small mip levels, pixels."""
_FINE = 40
"""Density from which patterns are painted instead of plain colours, pixels per metre."""


@dataclass(frozen=True)
class AtlasFace:
    """Size and appearance of a surface."""

    name: str
    """Name of its object."""
    semantic_class: str
    size: tuple[float, float]
    """Width and height, metres."""
    pattern: str
    color: Rgb


@dataclass(frozen=True)
class AtlasLayout:
    """Positions of the surfaces in the atlas."""

    size: int
    """Width and height of the atlas, pixels."""
    px_per_m: int
    rects: list[tuple[int, int, int, int]]
    """(x, y, width, height) of each surface, pixels, without its gutter; x and y are corners of pixels."""


def pack(sizes: Sequence[tuple[float, float]], atlas: int) -> AtlasLayout:
    """Packs surfaces of these sizes (metres) at the finest scale at which all fit.

    Raises:
        ConfigError: the atlas is too small for so many surfaces.
    """
    low, high, best = 0, 4096, None
    while high - low > 1:
        middle = (low + high) // 2
        rects = _shelves([(max(1, round(w * middle)), max(1, round(h * middle))) for w, h in sizes], atlas)
        if rects is None:
            high = middle
        else:
            low, best = middle, rects
    if best is None:
        raise ConfigError(f"an atlas of {atlas} x {atlas} pixels is too small for {len(sizes)} surfaces; take 1024 or more")
    return AtlasLayout(atlas, low, best)


def _shelves(sizes: list[tuple[int, int]], atlas: int) -> list[tuple[int, int, int, int]] | None:
    """Returns rectangles packed on shelves, highest first, or None if they do not fit."""
    rects: list[tuple[int, int, int, int]] = [(0, 0, 0, 0)] * len(sizes)
    x = y = shelf = 0
    for i in sorted(range(len(sizes)), key=lambda i: (-sizes[i][1], -sizes[i][0], i)):
        w, h = sizes[i][0] + 2 * _GUTTER, sizes[i][1] + 2 * _GUTTER
        if x + w > atlas:
            x, y, shelf = 0, y + shelf, 0
        if w > atlas or y + h > atlas:
            return None
        rects[i] = (x + _GUTTER, y + _GUTTER, sizes[i][0], sizes[i][1])
        x, shelf = x + w, max(shelf, h)
    return rects


def paint(faces: Sequence[AtlasFace], places: AtlasLayout, seed: int) -> NDArray[np.uint8]:
    """Returns the atlas, (size, size, 3) uint8 sRGB."""
    rng = np.random.default_rng([seed, 11])
    size = places.size
    grain = textures.noise(rng, size, size, (size // 64, size // 64), 6).astype(np.float32)
    out = np.full((size, size, 3), 128, dtype=np.uint8)
    for number, (face, (x, y, w, h)) in enumerate(zip(faces, places.rects, strict=True)):
        own = np.random.default_rng([seed, 13, number])
        picture = _picture(face, (h, w), places.px_per_m, grain[y : y + h, x : x + w], own)
        framed = cv2.copyMakeBorder(picture, _GUTTER, _GUTTER, _GUTTER, _GUTTER, cv2.BORDER_REPLICATE)
        out[y - _GUTTER : y + h + _GUTTER, x - _GUTTER : x + w + _GUTTER] = framed
    return out


def _picture(
    face: AtlasFace, shape: tuple[int, int], px_per_m: int, grain: NDArray[np.float32], rng: np.random.Generator
) -> textures.Image:
    """Returns (h, w, 3) uint8."""
    h, w = shape
    color = np.array(face.color)
    y, x = np.mgrid[0:h, 0:w] / px_per_m
    fine = px_per_m >= _FINE
    value = 1.0 + 0.06 * grain.astype(np.float64)
    base = np.broadcast_to(color, (h, w, 3))
    if fine and face.pattern in ("planks", "tiles"):
        made = getattr(textures, face.pattern)(rng, (w / px_per_m, h / px_per_m), px_per_m, face.color)
        base = cv2.resize(made, (w, h))
    elif face.pattern == "carpet":
        value = 1.0 + 0.25 * grain + 0.12 * np.sign(np.sin(x * 14.0) * np.sin(y * 14.0))
    elif face.pattern == "wood":
        value = 1.0 - 0.14 * np.sin(2 * np.pi * (x * 11.0 + 0.35 * np.sin(y * 5.0 + rng.uniform(0, 6)))) + 0.10 * grain
    elif face.pattern == "fabric":
        value = 1.0 + 0.10 * np.sin(x * 120.0) * np.sin(y * 120.0) + 0.16 * grain
    elif face.pattern == "stripes":
        value = 0.8 + 0.3 * (np.sin(x * 40.0 + rng.uniform(0, 6)) > 0) + 0.06 * grain
    elif face.pattern == "books":
        base = cv2.resize(textures.book_spines(rng, 96, 256), (w, h), interpolation=cv2.INTER_AREA) / 255.0
    elif "wall" in face.pattern:
        value = value * (1.0 - 0.25 * np.exp(-(y[::-1]) / 0.25) - 0.18 * np.exp(-y / 0.2))
    made8 = np.clip(base * (value * _edges(x, y))[..., None] * 255.0, 0, 255).astype(np.uint8)
    if face.pattern == "decorated wall" and fine:
        _decorate(made8, px_per_m, rng)
    return made8


def _edges(x: F64, y: F64) -> F64:
    """Returns the light at each pixel, (h, w), less near the edges."""
    near = np.minimum(np.minimum(x, x[:, ::-1]), np.minimum(y, y[::-1]))
    result: F64 = 1.0 - 0.25 * np.exp(-near / 0.08)
    return result


def _decorate(wall: textures.Image, px_per_m: int, rng: np.random.Generator) -> None:
    """Adds a picture or a window to a wall at eye height."""
    w = wall.shape[1]
    wide, tall = min(round(rng.uniform(0.7, 1.4) * px_per_m), w // 2), round(rng.uniform(0.6, 0.9) * px_per_m)
    made = textures.painting(rng) if rng.random() < 0.6 else textures.view_outside(rng)
    left, top = round(rng.uniform(0.15, 0.85) * (w - wide)), round(0.65 * px_per_m)
    frame = max(1, round(0.03 * px_per_m))
    wall[top - frame : top + tall + frame, max(0, left - frame) : left + wide + frame] = (60, 45, 35)
    wall[top : top + tall, left : left + wide] = cv2.resize(made, (wide, tall), interpolation=cv2.INTER_AREA)
