"""A room as a scan would give it: dense, noisy triangles without any level floor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

ROOM = (6.0, 5.0, 2.4)
"""Metres; its corner is the origin."""
STEP = 0.15
"""Height of a stage of 1.5 x 1.2 m in the corner at the origin, metres: one step up."""
THRESHOLD = 0.02
"""Height of a bar across the room at x = 4, metres."""
_FURNITURE = (((2.4, 3.2, 0.0), (0.6, 1.2, 0.75)), ((4.6, 0.9, 0.0), (0.5, 0.5, 0.45)), ((1.0, 3.9, 0.0), (0.9, 0.4, 1.8)))


def noisy_room(edge: float = 0.05, noise: float = 0.005, seed: int = 0) -> tuple[F64, I64]:
    """Returns vertices (V, 3), metres, and triangles (F, 3), all facing into the room.

    Args:
        edge: of the triangles, metres.
        noise: standard deviation of all corners, metres.
        seed: of the noise.
    """
    x, y, z = ROOM
    sheets = [
        sheet((0, 0, 0), (x, 0, 0), (0, y, 0), edge),
        sheet((0, 0, z), (0, y, 0), (x, 0, 0), edge),
        sheet((0, 0, 0), (0, y, 0), (0, 0, z), edge),
        sheet((x, 0, 0), (0, 0, z), (0, y, 0), edge),
        sheet((0, 0, 0), (0, 0, z), (x, 0, 0), edge),
        sheet((0, y, 0), (x, 0, 0), (0, 0, z), edge),
        *_box((0.0, 0.0, 0.0), (1.5, 1.2, STEP), edge),
        *_box((3.95, 0.0, 0.0), (0.1, y, THRESHOLD), edge),
    ]
    for corner, size in _FURNITURE:
        sheets += _box(corner, size, edge)
    return _joined(sheets, noise, seed)


def hall(
    size: tuple[float, float, float], *, rise: float, depth: float, start: float, noise: float, edge: float = 0.15, seed: int = 0
) -> tuple[F64, I64]:
    """Returns a hall without a ceiling, whose floor rises in three platforms along x: vertices (V, 3), metres, and triangles (F, 3).

    Args:
        size: of the hall, metres; its corner is the origin.
        rise: height of each platform above the last, metres.
        depth: of the first two platforms along x, metres; the third reaches to the wall.
        start: x of the first platform, metres.
        noise: standard deviation of all corners, metres.
        edge: of the triangles, metres.
        seed: of the noise.
    """
    x, y, z = size
    sheets = [
        sheet((0, 0, 0), (start, 0, 0), (0, y, 0), edge),
        sheet((0, 0, 0), (0, y, 0), (0, 0, z), edge),
        sheet((x, 0, 0), (0, 0, z), (0, y, 0), edge),
        sheet((0, 0, 0), (0, 0, z), (x, 0, 0), edge),
        sheet((0, y, 0), (x, 0, 0), (0, 0, z), edge),
    ]
    for k, front in enumerate((start, start + depth, start + 2 * depth), 1):
        sheets.append(sheet((front, 0, k * rise), (depth if k < 3 else x - front, 0, 0), (0, y, 0), edge))
        sheets.append(sheet((front, 0, (k - 1) * rise), (0, 0, rise), (0, y, 0), edge))
    return _joined(sheets, noise, seed)


def _joined(sheets: list[tuple[F64, I64]], noise: float, seed: int) -> tuple[F64, I64]:
    """Returns sheets as one mesh with noise; those that meet move together at their common edge."""
    counts = np.cumsum([0, *(len(points) for points, _ in sheets)])
    vertices = np.concatenate([points for points, _ in sheets])
    triangles = np.concatenate([corners + count for (_, corners), count in zip(sheets, counts, strict=False)])
    same, which = np.unique(np.round(vertices, 5), axis=0, return_inverse=True)
    moved = same + np.random.default_rng(seed).normal(0.0, noise, same.shape)
    return moved, which.reshape(-1)[triangles]


def _box(corner: tuple[float, float, float], size: tuple[float, float, float], edge: float) -> list[tuple[F64, I64]]:
    """Returns the four sides and the top of a box that stands on the floor."""
    (x, y, z), (a, b, c) = corner, size
    return [
        sheet((x, y, z + c), (a, 0, 0), (0, b, 0), edge),
        sheet((x, y, z), (a, 0, 0), (0, 0, c), edge),
        sheet((x, y + b, z), (0, 0, c), (a, 0, 0), edge),
        sheet((x, y, z), (0, 0, c), (0, b, 0), edge),
        sheet((x + a, y, z), (0, b, 0), (0, 0, c), edge),
    ]


def sheet(corner: tuple[float, ...], u: tuple[float, ...], v: tuple[float, ...], edge: float) -> tuple[F64, I64]:
    """Returns a grid of triangles over a parallelogram, facing along u x v."""
    a, b, c = (np.asarray(side, dtype=np.float64) for side in (corner, u, v))
    rows, columns = (max(1, round(float(np.linalg.norm(side)) / edge)) for side in (b, c))
    s, t = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    points = a + s.reshape(-1, 1) * b + t.reshape(-1, 1) * c
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    lower = first + columns + 1
    return points, np.concatenate([np.stack([first, lower, lower + 1], 1), np.stack([first, lower + 1, first + 1], 1)])
