"""Packs charts into atlases: a rectangle in an image for each. NumPy only.

Sizes are whole pixels. The light is baked at half the density, so rectangles begin at even pixels and keep a border of one pixel of the light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gibson_sim.errors import SceneError
from gibson_sim_tools.making.blender.shapes import F64, I64

BORDER_PX = 2
_SMALLEST_PX = 2.5
"""Least side of a chart, pixels, so that every chart contains the centre of a light pixel."""


@dataclass(frozen=True)
class Placement:
    """Positions of charts in the atlases."""

    atlas: I64
    """(C,)."""
    low_px: F64
    """(C, 2): lower left corner of the chart itself, pixels."""
    size_px: F64
    """(C, 2): size of the chart in the atlas, pixels."""
    turned: I64
    """(C,): 1 = rotated by 90 degrees."""
    density: float
    """Pixels per metre of a chart of importance 1."""


def place_charts(sizes_m: F64, importance: F64, atlases: int, size_px: int, limit: float = 400.0) -> Placement:
    """Returns the densest placement that fits.

    Args:
        sizes_m: (C, 2), width and height of each chart, metres.
        importance: (C,): factor of the density of each.
        atlases: number of images.
        size_px: edge of each.
        limit: greatest density, pixels per metre.

    Raises:
        SceneError: they do not fit at any density.
    """
    scaled = sizes_m * importance[:, None]
    turned = (scaled[:, 1] > scaled[:, 0]).astype(np.int64)
    scaled = np.where(turned[:, None] == 1, scaled[:, ::-1], scaled)
    low, high, best = 4.0, limit, None
    longest = float(scaled[:, 0].max())
    high = min(high, (size_px - 2 * BORDER_PX - 2) / longest)
    for _ in range(12):
        density = (low + high) / 2 if best is not None or low > 4.0 else high
        found = _shelves(np.maximum(scaled * density, _SMALLEST_PX), atlases, size_px)
        if found is None:
            high = density
            if best is None:
                low = max(low * 0.5, 4.0) + 1e-9
        else:
            low, best = density, Placement(found[0], found[1], np.maximum(scaled * density, _SMALLEST_PX), turned, density)
            if density >= high:
                break
    if best is None:
        raise SceneError(f"{len(sizes_m)} charts do not fit into {atlases} atlases of {size_px} px; take a higher quality")
    return best


def _shelves(sizes: F64, atlases: int, size_px: int) -> tuple[I64, F64] | None:
    """Returns atlas and lower left corner of each chart, in rows of like height; None if they do not fit."""
    cells = 2 * np.ceil(sizes / 2).astype(np.int64) + 2 * BORDER_PX
    order = np.lexsort((-cells[:, 0], -cells[:, 1]))
    atlas, corner = np.zeros(len(sizes), dtype=np.int64), np.zeros((len(sizes), 2))
    shelves: list[list[int]] = []  # atlas, y, height, free x
    top = [0] * atlases
    open_from = 0
    for k in order:
        w, h = int(cells[k, 0]), int(cells[k, 1])
        shelf = next((s for s in shelves[open_from:] if s[2] >= h and s[3] + w <= size_px), None)
        if shelf is None:
            home = next((i for i in range(atlases) if top[i] + h <= size_px), None)
            if home is None:
                return None
            shelf = [home, top[home], h, 0]
            top[home] += h
            shelves.append(shelf)
            open_from = max(open_from, len(shelves) - 40)  # older rows are nearly full
        atlas[k] = shelf[0]
        corner[k] = (shelf[3] + BORDER_PX, shelf[1] + BORDER_PX)
        shelf[3] += w
    return atlas, corner


def place_corners(uv_m: F64, chart: I64, low_m: F64, sizes_m: F64, placement: Placement, size_px: int) -> F64:
    """Returns texture coordinates, (F, 3, 2), 0 to 1 from the lower left, of corners in metres within their charts."""
    local = (uv_m - low_m[chart][:, None]) / np.maximum(sizes_m[chart][:, None], 1e-9)
    flip = placement.turned[chart] == 1
    local[flip] = np.stack([local[flip][..., 1], 1.0 - local[flip][..., 0]], axis=-1)
    return np.asarray((placement.low_px[chart][:, None] + local * placement.size_px[chart][:, None]) / size_px)


def chart_extents(uv_m: F64, chart: I64, count: int) -> tuple[F64, F64]:
    """Returns the low corners (C, 2) and the sizes (C, 2) of charts, metres."""
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    for k in range(3):
        np.minimum.at(low, chart, uv_m[:, k])
        np.maximum.at(high, chart, uv_m[:, k])
    return low, high - low
