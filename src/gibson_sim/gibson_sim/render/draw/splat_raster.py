"""Compiled loops that blend projected splats on a CPU, tile by tile from near to far, as the code of Kerbl et al. 2023 does on a GPU.

A software OpenGL blends from far to near and shades every pixel of every splat; here a row of a tile ends where it is covered. No OpenGL.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.compiling import compiled

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

TILE = 16
"""Side of a tile, pixels; a row of it fills the registers of common processors twice."""
COLUMNS = 16
"""Numbers of a projected splat, ``Projected`` of shaders/splats.comp."""
_LEAST, _MOST = np.float32(1.0 / 255.0), np.float32(0.99)
_COVERED = np.float32(1.0 / 1024.0)
"""Share of what is behind that is left, below which a pixel is covered."""
_FADED = np.float32(-5.545)
"""Exponent at which an opaque splat is below ``_LEAST``."""
_MIDDLE, _AT_MIDDLE = np.float32(0.3466), np.float32(np.exp(-0.3466))
"""The exponential is a polynomial about minus this, of an eighth of the exponent, to the eighth power."""
_ONE, _TWO, _HALF, _EIGHTH, _BYTE = (np.float32(x) for x in (1.0, 2.0, 0.5, 0.125, 255.0))
_THIRD, _FOURTH, _FIFTH = (np.float32(1.0 / x) for x in (6.0, 24.0, 120.0))


@compiled
def place_in_tiles(projected: F32, width: int, height: int) -> tuple[F32, I64, I32]:
    """Returns the splats in pixels, and those of each tile.

    Args:
        projected: (N, COLUMNS), from far to near.
        width: of the picture, pixels.
        height: likewise.

    Returns:
        For each splat, nearest first, (N, 14): centre, the inverse of its Cholesky factor (3), ``near / depth`` and its slopes (2), colour,
        opacity, square of its extent in standard deviations, and its extent in rows. Position in the third array of the first splat of each
        tile, row by row of tiles, and one more, (T + 1,). The splats of all tiles, nearest first.
    """
    count, columns = len(projected), (width + TILE - 1) // TILE
    tiles = columns * ((height + TILE - 1) // TILE)
    splats, bounds, starts = np.empty((count, 14), np.float32), np.empty((count, 4), np.int32), np.zeros(tiles + 1, np.int64)
    half_width, half_height = np.float32(width) * _HALF, np.float32(height) * _HALF
    for k in range(count):
        s = count - 1 - k
        x, y = (projected[s, 0] + _ONE) * half_width - _HALF, (projected[s, 1] + _ONE) * half_height - _HALF
        extent = projected[s, 3]
        a, b, c = projected[s, 4] * half_width, projected[s, 5] * half_height, projected[s, 6] * half_height
        across, down = extent * a, extent * np.sqrt(b * b + c * c)
        left, right = max(np.ceil(x - across), np.float32(0.0)), min(np.floor(x + across), np.float32(width - 1))
        top, bottom = max(np.ceil(y - down), np.float32(0.0)), min(np.floor(y + down), np.float32(height - 1))
        if not (left <= right and top <= bottom):
            bounds[k, 0], bounds[k, 1], bounds[k, 2], bounds[k, 3] = 1, 0, 1, 0
            continue
        bounds[k, 0], bounds[k, 1] = int(left) // TILE, int(right) // TILE
        bounds[k, 2], bounds[k, 3] = int(top) // TILE, int(bottom) // TILE
        for row in range(bounds[k, 2], bounds[k, 3] + 1):
            for column in range(bounds[k, 0], bounds[k, 1] + 1):
                starts[row * columns + column + 1] += 1
        splats[k, 0], splats[k, 1] = x, y
        splats[k, 2], splats[k, 3], splats[k, 4] = _ONE / a, -b / (a * c), _ONE / c
        splats[k, 5], splats[k, 6], splats[k, 7] = projected[s, 2], projected[s, 8], projected[s, 9]
        for channel in range(4):
            splats[k, 8 + channel] = projected[s, 12 + channel]
        splats[k, 12], splats[k, 13] = extent * extent, down
    for tile in range(tiles):
        starts[tile + 1] += starts[tile]
    at, listed = starts[:-1].copy(), np.empty(starts[tiles], np.int32)
    for k in range(count):
        for row in range(bounds[k, 2], bounds[k, 3] + 1):
            for column in range(bounds[k, 0], bounds[k, 1] + 1):
                tile = row * columns + column
                listed[at[tile]] = k
                at[tile] += 1
    return splats, starts, listed


@compiled
def blend_tiles(splats: F32, starts: I64, listed: I32, depth: F32, out: F32, first: int, step: int) -> None:
    """Blends the splats of every ``step``-th tile from the ``first`` one on.

    Args:
        splats: as ``place_in_tiles`` returns them, like the next two.
        starts: likewise.
        listed: likewise.
        depth: (H, W), ``near / depth`` of what hides splats.
        out: (H, W, 4), is filled with premultiplied sRGB colours and opacities.
        first: number of a tile.
        step: of these numbers.
    """
    height, width = depth.shape
    columns = (width + TILE - 1) // TILE
    left, nearest = np.empty((TILE, TILE), np.float32), np.empty((TILE, TILE), np.float32)
    red, green, blue = np.empty((TILE, TILE), np.float32), np.empty((TILE, TILE), np.float32), np.empty((TILE, TILE), np.float32)
    open_rows, u = np.empty(TILE, np.bool_), np.empty(TILE, np.float32)
    for tile in range(first, len(starts) - 1, step):
        x0, y0 = tile % columns * TILE, tile // columns * TILE
        rows, wide = min(TILE, height - y0), min(TILE, width - x0)
        for y in range(TILE):
            open_rows[y] = y < rows
            for x in range(TILE):
                left[y, x], red[y, x], green[y, x], blue[y, x] = _ONE, np.float32(0.0), np.float32(0.0), np.float32(0.0)
                # Nothing is nearer than this: what is beyond the edge is never drawn.
                nearest[y, x] = depth[y0 + y, x0 + x] if y < rows and x < wide else np.float32(np.inf)
        for x in range(TILE):
            u[x] = np.float32(x0 + x)
        still_open = rows
        for i in range(starts[tile], starts[tile + 1]):
            k = listed[i]
            cx, cy, by_x, by_xy, by_y = splats[k, 0], splats[k, 1], splats[k, 2], splats[k, 3], splats[k, 4]
            at_centre, along_x, along_y = splats[k, 5], splats[k, 6], splats[k, 7]
            r, g, b, opacity, down = splats[k, 8], splats[k, 9], splats[k, 10], splats[k, 11], splats[k, 13]
            top, bottom = max(int(np.ceil(cy - down)) - y0, 0), min(int(np.floor(cy + down)) - y0, rows - 1)
            for y in range(top, bottom + 1):
                if not open_rows[y]:
                    continue
                of_row, uncovered = by_y * (np.float32(y0 + y) - cy), 0
                row_left, row_near, row_red, row_green, row_blue = left[y], nearest[y], red[y], green[y], blue[y]
                for x in range(TILE):
                    offset = u[x] - cx
                    p, q = by_x * offset, by_xy * offset + of_row
                    z = max(-_HALF * (p * p + q * q), _FADED) * _EIGHTH + _MIDDLE
                    e = _AT_MIDDLE * (_ONE + z * (_ONE + z * (_HALF + z * (_THIRD + z * (_FOURTH + z * _FIFTH)))))
                    e *= e
                    e *= e
                    e *= e
                    alpha = min(opacity * e, _MOST)
                    seen = (alpha >= _LEAST) & (at_centre + along_x * p + along_y * q > row_near[x])
                    share = row_left[x] * (alpha if seen else np.float32(0.0))
                    row_red[x] += share * r
                    row_green[x] += share * g
                    row_blue[x] += share * b
                    rest = row_left[x] - share
                    row_left[x] = rest
                    uncovered += rest > _COVERED
                if not uncovered:
                    open_rows[y] = False
                    still_open -= 1
            if not still_open:
                break
        for y in range(rows):
            for x in range(wide):
                out[y0 + y, x0 + x, 0], out[y0 + y, x0 + x, 1] = red[y, x], green[y, x]
                out[y0 + y, x0 + x, 2], out[y0 + y, x0 + x, 3] = blue[y, x], _ONE - left[y, x]
