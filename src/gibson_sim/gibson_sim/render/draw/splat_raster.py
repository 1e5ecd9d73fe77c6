"""Compiled loops that blend projected splats on the CPU, tile by tile from near to far, as the code of Kerbl et al. 2023 does on a GPU.

A software OpenGL renderer blends from far to near and shades every pixel of every splat; these loops skip rows of a tile that are already
opaque. No OpenGL.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.compiling import compiled

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

TILE = 16
"""Side of a tile, pixels; a row fills two SIMD registers of common processors."""
COLUMNS = 16
"""Number of floats of a projected splat, ``Projected`` of shaders/splats.comp."""
_LEAST, _MOST = np.float32(1.0 / 255.0), np.float32(0.99)
_COVERED = np.float32(1.0 / 1024.0)
"""Transmittance below which a pixel counts as opaque."""
_FADED = np.float32(-5.545)
"""Exponent at which the opacity of an opaque splat is below ``_LEAST``."""
_MIDDLE, _AT_MIDDLE = np.float32(0.3466), np.float32(np.exp(-0.3466))
"""Negated expansion point, and the exponential there: exp(x) is a Taylor polynomial of x / 8 about ``-_MIDDLE``, to the eighth power."""
_ONE, _TWO, _HALF, _EIGHTH, _BYTE = (np.float32(x) for x in (1.0, 2.0, 0.5, 0.125, 255.0))
_THIRD, _FOURTH, _FIFTH = (np.float32(1.0 / x) for x in (6.0, 24.0, 120.0))


@compiled
def place_in_tiles(projected: F32, width: int, height: int) -> tuple[F32, I64, I32]:
    """Converts splats to pixels and sorts them into tiles.

    Args:
        projected: (N, COLUMNS), from far to near.
        width: width of the picture, pixels.
        height: height of the picture, pixels.

    Returns:
        Splats, nearest first, (N, 14): centre, inverse of the Cholesky factor (3), ``near / depth`` and its slopes (2), colour, opacity,
        square of the extent in standard deviations, and extent in rows. Start of each tile in the third array, tiles row by row, and the
        end of the last, (T + 1,). Indices of the splats of all tiles, nearest first within a tile.
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
    cursor, listed = starts[:-1].copy(), np.empty(starts[tiles], np.int32)
    for k in range(count):
        for row in range(bounds[k, 2], bounds[k, 3] + 1):
            for column in range(bounds[k, 0], bounds[k, 1] + 1):
                tile = row * columns + column
                listed[cursor[tile]] = k
                cursor[tile] += 1
    return splats, starts, listed


@compiled
def blend_tiles(splats: F32, starts: I64, listed: I32, depth: F32, out: F32, first: int, step: int) -> None:
    """Blends the splats of every ``step``-th tile, beginning with tile ``first``.

    Args:
        splats: first result of ``place_in_tiles``.
        starts: its second result.
        listed: its third result.
        depth: (H, W), ``near / depth`` of the occluders of splats.
        out: (H, W, 4), receives premultiplied sRGB colours and opacities.
        first: index of the first tile.
        step: increment of the tile index.
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
                # Beyond the edge of the image the occluder is infinitely near, so that nothing is drawn.
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
                    visible = (alpha >= _LEAST) & (at_centre + along_x * p + along_y * q > row_near[x])
                    weight = row_left[x] * (alpha if visible else np.float32(0.0))
                    row_red[x] += weight * r
                    row_green[x] += weight * g
                    row_blue[x] += weight * b
                    rest = row_left[x] - weight
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
