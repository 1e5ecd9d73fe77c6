"""Rasterises triangles in top view to the cells of a grid. Cells are square, (row, column) along (y, x)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

ROUNDING = 1e-6
"""Distance from a border at which a point lies on it, cells."""
_FAR = 1e9
"""Limit to which coordinates are clipped, cells."""
_PAIRS_AT_ONCE = 200_000
"""Maximum number of pairs of a triangle and a row or cell processed at a time, to limit memory."""


@dataclass(frozen=True, slots=True)
class Grid:
    """A grid of square cells in the world frame."""

    resolution: float
    """Edge length of a cell, metres."""
    origin: tuple[float, float]
    """World x, y of the lower left corner of cell [0, 0], metres."""
    shape: tuple[int, int]
    """Number of rows (along y) and columns (along x)."""

    @staticmethod
    def around(points: ArrayLike, resolution: float) -> Grid:
        """Returns the grid around points (N, 2), metres, with a border of one cell, so that the outdoor area is connected.

        Its borders are whole multiples of the cell size, so that the grids of one scene are aligned.
        """
        box = np.asarray(points, dtype=np.float64)
        first = np.floor(box.min(axis=0) / resolution + ROUNDING) - 1
        width, height = (int(n) for n in np.ceil(box.max(axis=0) / resolution - ROUNDING) - first + 1)
        return Grid(resolution, (float(first[0] * resolution), float(first[1] * resolution)), (height, width))

    def cover(self, polygons: F64) -> Bools:
        """Returns a mask, (H, W), of the cells that overlap one of the convex polygons (P, K, 2), world metres, by more than their border."""
        return rasterise((polygons - np.asarray(self.origin)) / self.resolution, self.shape)

    def heights(self, corners: F64, chosen: np.ufunc) -> F64:
        """Returns the maximum or minimum height of triangles at the centre of each cell, (H, W), metres; -inf or +inf = no triangle.

        Args:
            corners: (F, 3, 3), world metres; none of them vertical.
            chosen: ``np.maximum`` or ``np.minimum``.
        """
        rows, columns = self.shape
        out = np.full(rows * columns, -np.inf if chosen is np.maximum else np.inf)
        # In cells, with centres at whole numbers.
        in_cells = (corners[:, :, :2] - np.asarray(self.origin)) / self.resolution - 0.5
        first = np.maximum(np.ceil(in_cells.min(axis=1) - ROUNDING), 0).astype(np.int64)
        last = np.minimum(np.floor(in_cells.max(axis=1) + ROUNDING), [columns - 1, rows - 1]).astype(np.int64)
        sizes = np.maximum(last - first + 1, 0)
        counts = sizes.prod(axis=1)
        for which, number in numbered_pairs(counts, _PAIRS_AT_ONCE):
            cells = first[which] + np.stack([number % sizes[which, 0], number // sizes[which, 0]], axis=1)
            z, inside = _interpolated_heights(corners[which, :, 2], in_cells[which], cells)
            chosen.at(out, (cells[:, 1] * columns + cells[:, 0])[inside], z[inside])
        return out.reshape(self.shape)


def numbered_pairs(counts: I64, at_once: int) -> Iterator[tuple[I64, I64]]:
    """Yields all pairs of an item and a number below its count, in order, as arrays of items (N,) and numbers (N,).

    Args:
        counts: (K,), count of each item, such as the number of pixels of a triangle's bounding box.
        at_once: maximum number of pairs yielded at a time, to limit memory.
    """
    ends = np.cumsum(counts)
    for start in range(0, int(ends[-1]) if len(ends) else 0, at_once):
        pairs = np.arange(start, min(start + at_once, int(ends[-1])))
        which = np.searchsorted(ends, pairs, side="right")
        yield which, pairs - (ends[which] - counts[which])


def clip_to_slab(corners: F64, low: float, high: float) -> F64:
    """Clips triangles (F, 3, 3) to the slab between two heights and returns polygons (P, 9, 2) in top view; unused corners repeat others."""
    if not len(corners):
        return np.zeros((0, 9, 2))
    slots, valid = [], []
    for i in range(3):
        a, b = corners[:, i], corners[:, (i + 1) % 3]
        za, zb = a[:, 2], b[:, 2]
        slots.append(a[:, :2])
        valid.append((za >= low) & (za <= high))
        # The two heights in the order in which the edge crosses them.
        up = (zb > za)[:, None]
        near, far = np.where(up[:, 0], low, high), np.where(up[:, 0], high, low)
        for z in (near, far):
            with np.errstate(divide="ignore", invalid="ignore"):
                t = (z - za) / (zb - za)
            crosses = (za != zb) & (t > 0) & (t < 1)
            slots.append(a[:, :2] + np.where(crosses, t, 0.0)[:, None] * (b - a)[:, :2])
            valid.append(crosses)
    points, used = np.stack(slots, axis=1), np.stack(valid, axis=1)
    # An unused slot repeats the preceding used one (cyclically), which adds an edge of length 0.
    order = np.where(used, np.arange(9), -1)
    preceding = np.maximum.accumulate(order, axis=1)
    preceding = np.where(preceding < 0, order.max(axis=1, keepdims=True), preceding)
    return np.asarray(np.take_along_axis(points, np.maximum(preceding, 0)[:, :, None], axis=1)[used.any(axis=1)])


def rasterise(polygons: F64, shape: tuple[int, int]) -> Bools:
    """Returns a mask, (H, W), of the cells that overlap one of the convex polygons (P, K, 2), in cells, by more than their border."""
    grid = np.zeros((shape[0], shape[1] + 1), dtype=np.int32)
    if not len(polygons):
        return np.zeros(shape, dtype=bool)
    polygons = np.clip(np.nan_to_num(polygons), -_FAR, _FAR)
    first, last = _cell_range(polygons[:, :, 1].min(axis=1), polygons[:, :, 1].max(axis=1), shape[0])
    counts = np.maximum(last - first + 1, 0)
    for which, number in numbered_pairs(counts, _PAIRS_AT_ONCE):
        rows = first[which] + number
        left, right = _extent_in_band(polygons[which], rows.astype(np.float64))
        a, b = _cell_range(left, right, shape[1])
        np.add.at(grid, (rows, a), 1)
        np.add.at(grid, (rows, np.maximum(b + 1, a)), -1)
    return np.asarray(np.cumsum(grid, axis=1)[:, :-1] > 0)


def _cell_range(low: F64, high: F64, size: int) -> tuple[I64, I64]:
    """Returns the first and last cell of closed intervals; an interval on the border of two cells belongs to the upper one."""
    first = np.floor(low + ROUNDING)
    last = np.maximum(np.ceil(high - ROUNDING) - 1, first)
    return _clipped(first, size), _clipped(last, size)


def _clipped(cells: F64, size: int) -> I64:
    """Returns cell indices clipped to the grid; values that are not finite become the first cell."""
    return np.clip(np.nan_to_num(cells, nan=0.0, posinf=0.0, neginf=0.0), 0, size - 1).astype(np.int64)


def _extent_in_band(polygons: F64, rows: F64) -> tuple[F64, F64]:
    """Returns the minimum and maximum x of convex polygons (P, K, 2) within the bands rows <= y <= rows + 1."""
    x, y = polygons[:, :, 0], polygons[:, :, 1]
    bottom, top = rows[:, None], rows[:, None] + 1.0
    inside = (y >= bottom - ROUNDING) & (y <= top + ROUNDING)
    left = np.where(inside, x, np.inf).min(axis=1)
    right = np.where(inside, x, -np.inf).max(axis=1)
    dx, dy = np.roll(x, -1, axis=1) - x, np.roll(y, -1, axis=1) - y
    for level in (bottom, top):
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (level - y) / dy
        crosses = (dy != 0) & (t >= 0) & (t <= 1)
        crossing = x + np.where(crosses, t, 0.0) * dx
        left = np.minimum(left, np.where(crosses, crossing, np.inf).min(axis=1))
        right = np.maximum(right, np.where(crosses, crossing, -np.inf).max(axis=1))
    return left, right


def _interpolated_heights(z: F64, triangles: F64, points: I64) -> tuple[F64, Bools]:
    """Returns the heights (N,) at points (N, 2) of triangles (N, 3, 2) with heights z (N, 3), and whether each point is inside (N,)."""
    a, b, c = (triangles[:, k] for k in range(3))
    ab, ac, ap = b - a, c - a, points - a
    twice_area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        v = (ap[:, 0] * ac[:, 1] - ap[:, 1] * ac[:, 0]) / twice_area
        w = (ab[:, 0] * ap[:, 1] - ab[:, 1] * ap[:, 0]) / twice_area
        inside = (v >= -ROUNDING) & (w >= -ROUNDING) & (v + w <= 1 + ROUNDING)
        return (1 - v - w) * z[:, 0] + v * z[:, 1] + w * z[:, 2], np.asarray(inside)
