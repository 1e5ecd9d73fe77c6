"""Packs charts into light maps: a rectangle of texels for each chart. NumPy only.

The edges of a chart lie on the centres of its outermost texels, so that a bilinear sample within the chart mixes only texels of the chart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim_tools.making.blender.shapes import F64, I64

BORDER_PX = 2
"""Free border around each chart, texels."""
_OUTSET_PX = 0.03
"""Distance by which a chart is enlarged in the bake, so that the centres of its outermost texels lie within its triangles."""


@dataclass(frozen=True)
class Placement:
    """Positions of charts in the light maps."""

    atlas: I64
    """Index of the light map of each chart, (C,)."""
    low_px: I64
    """Column and row of the lower left texel of each chart, (C, 2)."""
    size_px: I64
    """Columns and rows of each chart, (C, 2), at least 2."""
    rotated: I64
    """Whether each chart is rotated by 90 degrees, 0 or 1, (C,)."""
    density: float
    """Texel density of a chart of importance 1, texels per metre."""


def place_charts(sizes_m: F64, importance: F64, atlases: int, size_px: int, limit: float = 400.0) -> Placement:
    """Returns the placement with the highest texel density that fits.

    Args:
        sizes_m: width and height of each chart, (C, 2), metres.
        importance: factor of the texel density of each chart, (C,).
        atlases: number of light maps.
        size_px: edge of each light map, texels.
        limit: maximum texel density, texels per metre.

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
        texels = np.maximum(np.round(scaled * density), 1.0).astype(np.int64) + 1
        packing = _shelves(texels, atlases, size_px)
        if packing is None:
            high = density
            if best is None:
                low = max(low * 0.5, 4.0) + 1e-9
        else:
            low, best = density, Placement(packing[0], packing[1], texels, rotated, density)
            if density >= high:
                break
    if best is None:
        raise SceneError(f"{len(sizes_m)} charts do not fit into {atlases} light maps of {size_px} px; choose a higher quality")
    return best


def _shelves(texels: I64, atlases: int, size_px: int) -> tuple[I64, I64] | None:
    """Packs charts in rows of similar height; returns light map and lower left texel of each; None if they do not fit."""
    cells = texels + 2 * BORDER_PX
    order = np.lexsort((-cells[:, 0], -cells[:, 1]))
    atlas, corner = np.zeros(len(texels), dtype=np.int64), np.zeros((len(texels), 2), dtype=np.int64)
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
    """Converts corners within their charts, (F, 3, 2), m, to coordinates in the light map, (F, 3, 2), 0 to 1 from the lower left."""
    local = (uv_m - low_m[chart][:, None]) / np.maximum(sizes_m[chart][:, None], 1e-9)
    flip = placement.rotated[chart] == 1
    local[flip] = np.stack([local[flip][..., 1], 1.0 - local[flip][..., 0]], axis=-1)
    first, steps = placement.low_px[chart][:, None] + 0.5, placement.size_px[chart][:, None] - 1
    return np.asarray((first + local * steps) / size_px)


def chart_map(charts: I64, atlas: int, size_px: int) -> NDArray[np.int32]:
    """Returns the index of the chart of each texel, (size_px, size_px), or -1, row 0 at the bottom.

    ``charts``: index of the light map, column and row of the lower left texel, columns and rows of each chart, (C, 5).
    """
    result = np.full((size_px, size_px), -1, dtype=np.int32)
    for k in np.flatnonzero(charts[:, 0] == atlas).tolist():
        x, y, width, height = charts[k, 1:].tolist()
        result[y : y + height, x : x + width] = k
    return result


def outset_corners(uv: F64, charts: I64, atlas: int, size_px: int) -> F64:
    """Returns coordinates in a light map, (F, 3, 2), with each chart slightly enlarged, for the bake."""
    pixels = uv * size_px
    middle = np.floor(pixels.mean(axis=1)).astype(np.int64)
    chart = chart_map(charts, atlas, size_px)[middle[:, 1], middle[:, 0]]
    low, size = charts[chart, 1:3] + 0.5, charts[chart, 3:5] - 1
    local = (pixels - low[:, None]) / size[:, None]
    return np.asarray((pixels + (2.0 * local - 1.0) * _OUTSET_PX) / size_px)


def chart_extents(uv_m: F64, chart: I64, count: int) -> tuple[F64, F64]:
    """Returns the lower corners, (C, 2), and the sizes, (C, 2), of charts, m."""
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    for k in range(3):
        np.minimum.at(low, chart, uv_m[:, k])
        np.maximum.at(high, chart, uv_m[:, k])
    return low, high - low
