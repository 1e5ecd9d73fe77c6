"""Which boxes are hidden behind what is drawn already: a pyramid of farthest depths (Greene, Kass and Miller 1993). Pure numpy.

Exact in one direction: what is called hidden would not have changed a pixel. It pays where triangles are dear, as on a CPU; a GPU
would wait for the depth image longer than the hidden triangles take.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import Mat4

F64 = NDArray[np.float64]
_MARGIN = 1e-5
"""Part by which a box must lie deeper, since depths are rounded."""
_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


class DepthPyramid:
    """The least of ``near / depth`` over ever larger squares of an image: nothing in a square is farther than that.

    Args:
        depth: (H, W) float32, ``near / depth``, 0 = nothing.
    """

    def __init__(self, depth: NDArray[np.float32]) -> None:
        self.height, self.width = depth.shape
        levels = [depth]
        while levels[-1].size > 1:
            level = levels[-1]
            if level.shape[0] % 2:
                level = np.concatenate([level, level[-1:]])
            if level.shape[1] % 2:
                level = np.concatenate([level, level[:, -1:]], axis=1)
            rows = np.minimum(level[0::2], level[1::2])
            levels.append(np.minimum(rows[:, 0::2], rows[:, 1::2]))
        self._widths = np.array([level.shape[1] for level in levels])
        self._firsts = np.cumsum([0, *(level.size for level in levels[:-1])])
        self._values = np.concatenate([level.ravel() for level in levels])

    def least(
        self, x0: NDArray[np.int64], y0: NDArray[np.int64], x1: NDArray[np.int64], y1: NDArray[np.int64]
    ) -> NDArray[np.float32]:
        """Returns a bound below all values in the rectangles, (N,); all ends belong to them and lie inside the image."""
        size = np.maximum(np.maximum(x1 - x0, y1 - y0), 0)
        # The level at which a rectangle touches two squares a side at most.
        level = np.minimum(np.ceil(np.log2(size + 1)).astype(np.int64), len(self._widths) - 1)
        first, width = self._firsts[level], self._widths[level]
        top, bottom = first + (y0 >> level) * width, first + (y1 >> level) * width
        left, right = x0 >> level, x1 >> level
        v = self._values
        least: NDArray[np.float32] = np.minimum(
            np.minimum(v[top + left], v[top + right]), np.minimum(v[bottom + left], v[bottom + right])
        )
        return least


def hidden(pyramid: DepthPyramid, boxes: F64, T_camera_box: F64, intrinsics: F64, near: float) -> NDArray[np.bool_]:
    """Returns which boxes cannot be seen, (N,).

    Args:
        pyramid: of the depth image so far.
        boxes: (N, 6), centre and half the size, metres.
        T_camera_box: (4, 4), or (N, 4, 4): optical frame from the frame of the boxes.
        intrinsics: K, (3, 3), pixels.
        near: metres.
    """
    R, t = np.asarray(T_camera_box)[..., :3, :3], np.asarray(T_camera_box)[..., :3, 3]
    centre = np.einsum("...ij,...j->...i", R, boxes[:, :3]) + t
    reach = (
        np.einsum("...ij,nj,kj->nki", R, boxes[:, 3:], _CORNERS)
        if R.ndim == 2
        else np.einsum("nij,nj,kj->nki", R, boxes[:, 3:], _CORNERS)
    )
    corners = centre[:, None] + reach
    nearest = corners[:, :, 2].min(axis=1)
    ahead = nearest > near
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = (corners @ _rows(intrinsics).T) / corners[:, :, 2:]
    low = np.floor(np.where(ahead[:, None], uv.min(axis=1), 0.0)).astype(np.int64)
    high = np.ceil(np.where(ahead[:, None], uv.max(axis=1), 0.0)).astype(np.int64)
    size = np.array([pyramid.width, pyramid.height])
    outside = (high < 0).any(axis=1) | (low >= size).any(axis=1)
    low, high = np.clip(low, 0, size - 1), np.clip(high, 0, size - 1)
    least = pyramid.least(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
    with np.errstate(divide="ignore"):
        deeper = near / np.maximum(nearest, near) < least * (1.0 - _MARGIN)
    covered: NDArray[np.bool_] = ahead & (outside | deeper)
    return covered


def _rows(intrinsics: Mat4 | F64) -> F64:
    """Returns the two rows of K that give pixels, (2, 3)."""
    return np.asarray(intrinsics, dtype=np.float64)[:2]
