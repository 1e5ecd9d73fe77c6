"""Occlusion test of boxes against a depth image: a hierarchical z-buffer (Greene, Kass and Miller 1993).

The test is conservative: drawing a box reported as hidden would not change a pixel. It pays off where triangles are expensive, as in
software rendering; on a GPU, waiting for the depth image takes longer than drawing the hidden triangles.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.render.culling.occlusion_culling import DEPTH_MARGIN, TILE_PX

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


class DepthPyramid:
    """Minima of ``near / depth`` over tiles of an image, at increasing tile sizes: bounds of the largest depth in each tile.

    Args:
        depth: (H, W) float32, ``near / depth``, 0 = nothing.
    """

    def __init__(self, depth: F32) -> None:
        self.height, self.width = depth.shape
        levels = [_least_of_tiles(depth, TILE_PX)]
        while levels[-1].size > 1:
            levels.append(_least_of_tiles(levels[-1], 2))
        self._widths = np.array([level.shape[1] for level in levels])
        self._firsts = np.cumsum([0, *(level.size for level in levels[:-1])])
        self._values = np.concatenate([level.ravel() for level in levels])

    def least(self, x0: I64, y0: I64, x1: I64, y1: I64) -> F32:
        """Returns lower bounds, (N,), of the values in rectangles with inclusive ends inside the image."""
        x0, y0, x1, y1 = x0 // TILE_PX, y0 // TILE_PX, x1 // TILE_PX, y1 // TILE_PX
        # The level at which a rectangle touches at most two tiles per side.
        level = np.frexp(np.maximum(np.maximum(x1 - x0, y1 - y0) - 1, 0))[1]
        np.minimum(level, len(self._widths) - 1, out=level)
        first, width = self._firsts[level], self._widths[level]
        top, bottom = first + (y0 >> level) * width, first + (y1 >> level) * width
        left, right = x0 >> level, x1 >> level
        v = self._values
        least: F32 = np.minimum(np.minimum(v[top + left], v[top + right]), np.minimum(v[bottom + left], v[bottom + right]))
        return least


def _least_of_tiles(values: F32, side: int) -> F32:
    """Returns the minimum of each tile; tiles at the right and bottom edges may be cropped."""
    missing = -np.array(values.shape) % side
    if missing.any():
        values = np.pad(values, ((0, missing[0]), (0, missing[1])), mode="edge")
    rows = values[0::side]
    for k in range(1, side):
        rows = np.minimum(rows, values[k::side])
    least = rows[:, 0::side]
    for k in range(1, side):
        least = np.minimum(least, rows[:, k::side])
    return least


def pixels_from_links(T_camera_links: F64, intrinsics: F64) -> F64:
    """Returns the projection matrices, (L, 3, 4), from points in each link to (u z, v z, z), pixels and metres.

    Args:
        T_camera_links: (L, 4, 4): optical frame from the frame of each link.
        intrinsics: K, (3, 3), pixels.
    """
    pixels: F64 = np.vstack([np.asarray(intrinsics, dtype=np.float64)[:2], [0.0, 0.0, 1.0]]) @ T_camera_links[:, :3]
    return pixels


class ScreenBounds:
    """Screen-space bounds of boxes, computed while the depth image is not yet available.

    Args:
        boxes: (N, 6), centre and half extents, metres.
        pixels_from_box: (N, 3, 4), projection matrix of each box, see ``pixels_from_links``.
        size: width and height of the picture, pixels.
        near: depth of the near plane, metres.
    """

    def __init__(self, boxes: F64, pixels_from_box: F64, size: tuple[int, int], near: float) -> None:
        matrices = pixels_from_box[:, :, :3]
        centre = np.matmul(matrices, boxes[:, :3, None])[:, :, 0] + pixels_from_box[:, :, 3]
        half = np.ascontiguousarray((matrices * boxes[:, None, 3:]).transpose(1, 2, 0))
        # (3, 8, N): NumPy is fastest along the axis of the boxes, the longest one.
        corners = np.matmul(_CORNERS, half)
        corners += centre.T[:, None]
        nearest = corners[2].min(axis=0)
        self._ahead = nearest > near
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = corners[:2] / corners[2]
        # A box that is not entirely beyond the near plane is never hidden.
        low = np.floor(np.where(self._ahead, uv.min(axis=1), 0.0))
        high = np.ceil(np.where(self._ahead, uv.max(axis=1), 0.0))
        end = np.array([[size[0]], [size[1]]])
        self._outside = ((high < 0) | (low >= end)).any(axis=0)
        self._first, self._last = (np.clip(ends, 0, end - 1).astype(np.int64) for ends in (low, high))
        self._reversed_depth = near / np.maximum(nearest, near)

    def hidden(self, pyramid: DepthPyramid) -> NDArray[np.bool_]:
        """Returns a mask, (N,), of the boxes hidden behind the depth image of the picture."""
        deeper = self._reversed_depth < pyramid.least(*self._first, *self._last) * (1.0 - DEPTH_MARGIN)
        covered: NDArray[np.bool_] = self._ahead & (self._outside | deeper)
        return covered
