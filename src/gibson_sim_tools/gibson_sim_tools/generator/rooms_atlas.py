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
_GUTTER_PX = 3
"""Border around each rectangle that extends its picture, for filtering and mip levels, pixels."""
_MIN_PATTERN_DENSITY = 40
"""Texel density from which patterns are painted instead of plain colours, pixels per metre."""


@dataclass(frozen=True)
class AtlasFace:
    """Size and appearance of a surface."""

    name: str
    """Name of its object."""
    semantic_class: str
    size: tuple[float, float]
    """Width and height, m."""
    pattern: str
    color: Rgb


@dataclass(frozen=True)
class AtlasLayout:
    """Positions of the surfaces in the atlas."""

    size: int
    """Width and height of the atlas, pixels."""
    px_per_m: int
    """Texel density, pixels per metre."""
    rects: list[tuple[int, int, int, int]]
    """Rectangle of each surface without its gutter, (x, y, width, height), pixels; x and y are pixel corners."""


def pack(sizes: Sequence[tuple[float, float]], atlas: int) -> AtlasLayout:
    """Packs surfaces into an atlas at the highest texel density at which all fit. ``sizes``: m; ``atlas``: edge, pixels.

    Raises:
        ConfigError: the atlas is too small for the surfaces.
    """
    low, high, best = 0, 4096, None
    while high - low > 1:
        density = (low + high) // 2
        rects = _shelves([(max(1, round(w * density)), max(1, round(h * density))) for w, h in sizes], atlas)
        if rects is None:
            high = density
        else:
            low, best = density, rects
    if best is None:
        raise ConfigError(f"an atlas of {atlas} x {atlas} pixels is too small for {len(sizes)} surfaces; use 1024 or more")
    return AtlasLayout(atlas, low, best)


def _shelves(sizes: list[tuple[int, int]], atlas: int) -> list[tuple[int, int, int, int]] | None:
    """Packs rectangles on shelves, the highest first; returns None if they do not fit."""
    rects: list[tuple[int, int, int, int]] = [(0, 0, 0, 0)] * len(sizes)
    x = y = shelf = 0
    for i in sorted(range(len(sizes)), key=lambda i: (-sizes[i][1], -sizes[i][0], i)):
        w, h = sizes[i][0] + 2 * _GUTTER_PX, sizes[i][1] + 2 * _GUTTER_PX
        if x + w > atlas:
            x, y, shelf = 0, y + shelf, 0
        if w > atlas or y + h > atlas:
            return None
        rects[i] = (x + _GUTTER_PX, y + _GUTTER_PX, sizes[i][0], sizes[i][1])
        x, shelf = x + w, max(shelf, h)
    return rects


def paint(faces: Sequence[AtlasFace], places: AtlasLayout, seed: int) -> NDArray[np.uint8]:
    """Paints the atlas, (size, size, 3) uint8 sRGB."""
    rng = np.random.default_rng([seed, 11])
    size = places.size
    grain = textures.noise(rng, size, size, (size // 64, size // 64), 6).astype(np.float32)
    out = np.full((size, size, 3), 128, dtype=np.uint8)
    for number, (face, (x, y, w, h)) in enumerate(zip(faces, places.rects, strict=True)):
        face_rng = np.random.default_rng([seed, 13, number])
        picture = _paint_face(face, (h, w), places.px_per_m, grain[y : y + h, x : x + w], face_rng)
        framed = cv2.copyMakeBorder(picture, _GUTTER_PX, _GUTTER_PX, _GUTTER_PX, _GUTTER_PX, cv2.BORDER_REPLICATE)
        out[y - _GUTTER_PX : y + h + _GUTTER_PX, x - _GUTTER_PX : x + w + _GUTTER_PX] = framed
    return out


def _paint_face(
    face: AtlasFace, shape: tuple[int, int], px_per_m: int, grain: NDArray[np.float32], rng: np.random.Generator
) -> textures.Image:
    """Paints one surface, (h, w, 3) uint8 sRGB."""
    h, w = shape
    color = np.array(face.color)
    y, x = np.mgrid[0:h, 0:w] / px_per_m
    has_patterns = px_per_m >= _MIN_PATTERN_DENSITY
    value = 1.0 + 0.06 * grain.astype(np.float64)
    base = np.broadcast_to(color, (h, w, 3))
    if has_patterns and face.pattern in ("planks", "tiles"):
        pattern = getattr(textures, face.pattern)(rng, (w / px_per_m, h / px_per_m), px_per_m, face.color)
        base = cv2.resize(pattern, (w, h))
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
    image = np.clip(base * (value * _edge_shading(x, y))[..., None] * 255.0, 0, 255).astype(np.uint8)
    if face.pattern == "decorated wall" and has_patterns:
        _add_decoration(image, px_per_m, rng)
    return image


def _edge_shading(x: F64, y: F64) -> F64:
    """Returns the shading of each pixel, (h, w), darker near the edges. ``x``, ``y``: pixel coordinates, m."""
    edge_distance = np.minimum(np.minimum(x, x[:, ::-1]), np.minimum(y, y[::-1]))
    result: F64 = 1.0 - 0.25 * np.exp(-edge_distance / 0.08)
    return result


def _add_decoration(wall: textures.Image, px_per_m: int, rng: np.random.Generator) -> None:
    """Adds a picture or a window to a wall at eye height."""
    w = wall.shape[1]
    width, height = min(round(rng.uniform(0.7, 1.4) * px_per_m), w // 2), round(rng.uniform(0.6, 0.9) * px_per_m)
    picture = textures.painting(rng) if rng.random() < 0.6 else textures.view_outside(rng)
    left, top = round(rng.uniform(0.15, 0.85) * (w - width)), round(0.65 * px_per_m)
    frame = max(1, round(0.03 * px_per_m))
    wall[top - frame : top + height + frame, max(0, left - frame) : left + width + frame] = (60, 45, 35)
    wall[top : top + height, left : left + width] = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
