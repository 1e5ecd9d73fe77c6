"""Packs charts into atlases: a rectangle in an image for each chart. NumPy only.

Light is baked at half the texel density, so rectangles start at even pixels and keep a border of one light pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gibson_sim.errors import SceneError
from gibson_sim_tools.making.blender.shapes import F64, I64

BORDER_PX = 2
"""Border around each chart, pixels."""
_MIN_CHART_PX = 2.5
"""Minimum side of a chart, pixels, so that each chart contains the centre of a light pixel."""


@dataclass(frozen=True)
class Placement:
    """Positions of charts in the atlases."""

    atlas: I64
    """Index of the atlas of each chart, (C,)."""
    low_px: F64
    """Lower left corner of each chart without its border, (C, 2), pixels."""
    size_px: F64
    """Size of each chart in the atlas, (C, 2), pixels."""
    rotated: I64
    """Whether each chart is rotated by 90 degrees, 0 or 1, (C,)."""
    density: float
    """Texel density of a chart of importance 1, pixels per metre."""


def place_charts(sizes_m: F64, importance: F64, atlases: int, size_px: int, limit: float = 400.0) -> Placement:
    """Returns the placement with the highest texel density that fits.

    Args:
        sizes_m: width and height of each chart, (C, 2), metres.
        importance: factor of the texel density of each chart, (C,).
        atlases: number of atlases.
        size_px: edge of each atlas, pixels.
        limit: maximum texel density, pixels per metre.

    Raises:
        SceneError: the charts do not fit at any density.
    """
    scaled = sizes_m * importance[:, None]
    rotated = (scaled[:, 1] > scaled[:, 0]).astype(np.int64)
    scaled = np.where(rotated[:, None] == 1, scaled[:, ::-1], scaled)
    low, high, best = 4.0, limit, None
    longest = float(scaled[:, 0].max())
    high = min(high, (size_px - 2 * BORDER_PX - 2) / longest)
    for _ in range(12):
        density = (low + high) / 2 if best is not None or low > 4.0 else high
        packing = _shelves(np.maximum(scaled * density, _MIN_CHART_PX), atlases, size_px)
        if packing is None:
            high = density
            if best is None:
                low = max(low * 0.5, 4.0) + 1e-9
        else:
            low, best = density, Placement(packing[0], packing[1], np.maximum(scaled * density, _MIN_CHART_PX), rotated, density)
            if density >= high:
                break
    if best is None:
        raise SceneError(f"{len(sizes_m)} charts do not fit into {atlases} atlases of {size_px} px; choose a higher quality")
    return best


def _shelves(sizes: F64, atlases: int, size_px: int) -> tuple[I64, F64] | None:
    """Packs charts in rows of similar height; returns atlas and lower left corner of each; None if they do not fit."""
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
            free_atlas = next((i for i in range(atlases) if top[i] + h <= size_px), None)
            if free_atlas is None:
                return None
            shelf = [free_atlas, top[free_atlas], h, 0]
            top[free_atlas] += h
            shelves.append(shelf)
            open_from = max(open_from, len(shelves) - 40)  # older rows are nearly full
        atlas[k] = shelf[0]
        corner[k] = (shelf[3] + BORDER_PX, shelf[1] + BORDER_PX)
        shelf[3] += w
    return atlas, corner


def place_corners(uv_m: F64, chart: I64, low_m: F64, sizes_m: F64, placement: Placement, size_px: int) -> F64:
    """Converts corners within their charts, (F, 3, 2), m, to atlas coordinates, (F, 3, 2), 0 to 1 from the lower left."""
    local = (uv_m - low_m[chart][:, None]) / np.maximum(sizes_m[chart][:, None], 1e-9)
    flip = placement.rotated[chart] == 1
    local[flip] = np.stack([local[flip][..., 1], 1.0 - local[flip][..., 0]], axis=-1)
    return np.asarray((placement.low_px[chart][:, None] + local * placement.size_px[chart][:, None]) / size_px)


def chart_extents(uv_m: F64, chart: I64, count: int) -> tuple[F64, F64]:
    """Returns the lower corners, (C, 2), and the sizes, (C, 2), of charts, m."""
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    for k in range(3):
        np.minimum.at(low, chart, uv_m[:, k])
        np.maximum.at(high, chart, uv_m[:, k])
    return low, high - low
