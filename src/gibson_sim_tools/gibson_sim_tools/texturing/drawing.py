"""Draws triangles into images of triangle numbers, with depth or flat: what a camera sees, and where a triangle lies in a texture.

The loops are compiled if Numba is installed; else NumPy does the same, to the bit, and takes about 20 times as long.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.compiling import CAN_COMPILE, compiled
from gibson_sim.geometry.rasterise import numbered_pairs
from gibson_sim_tools.scanning.posed_rgbd import Intrinsics
from gibson_sim_tools.texturing.surface import Surface, project

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
I32 = NDArray[np.int32]
Bools = NDArray[np.bool_]

NEAR = 0.05
"""Triangles with a corner nearer than this to the plane of a camera are not drawn, metres."""
_PAIRS_AT_ONCE = 1_000_000
"""Pairs of a triangle and a pixel that are processed together, which limits memory."""
_INSIDE = -1e-9
"""Least barycentric coordinate of a pixel inside of a triangle."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceImage:
    """Which triangle each pixel shows."""

    face: I32
    """(H, W), -1 = none."""
    depth: F32
    """(H, W), metres along the axis of the camera; +inf = nothing."""


def draw(surface: Surface, intrinsics: Intrinsics, T_world_camera: F64) -> FaceImage:
    """Returns what a camera sees of a surface, of either side of its triangles. A pixel shows what its centre shows."""
    uv, z = project(surface.vertices, intrinsics, T_world_camera)
    width, height = intrinsics.width, intrinsics.height
    corners, depths = uv[surface.triangles], z[surface.triangles]
    numbers = np.flatnonzero((depths > NEAR).all(axis=1))
    nearness = np.zeros(width * height)
    face = np.full(width * height, -1, dtype=np.int32)
    if CAN_COMPILE:
        _draw(corners[numbers], depths[numbers], numbers, width, height, nearness, face, False)
    else:
        for which, pixels, weights in _covered(corners[numbers], width, height):
            # 1 / z is linear in the image.
            near = (weights / depths[numbers[which]]).sum(axis=1)
            np.maximum.at(nearness, pixels, near)
            first = near >= nearness[pixels]
            face[pixels[first]] = numbers[which[first]]
    with np.errstate(divide="ignore"):
        depth = (1.0 / nearness).astype(np.float32)
    return FaceImage(face.reshape(height, width), depth.reshape(height, width))


def draw_flat(corners: F64, width: int, height: int) -> I32:
    """Returns (H, W): the number of a triangle (F, 3, 2), pixels, that covers the centre of each pixel; -1 = none."""
    face = np.full(width * height, -1, dtype=np.int32)
    if CAN_COMPILE:
        ones = np.ones((len(corners), 3))
        nearness = np.zeros(width * height)
        _draw(np.ascontiguousarray(corners), ones, np.arange(len(corners)), width, height, nearness, face, True)
    else:
        for which, pixels, _ in _covered(corners, width, height):
            face[pixels] = which
    return face.reshape(height, width)


def barycentric(corners: F64, points: F64) -> F64:
    """Returns the weights (N, 3) of the corners (N, 3, 2) of triangles at points (N, 2); a triangle without area has weights 1/3."""
    a, b, c = (corners[:, k] for k in range(3))
    ab, ac, to = b - a, c - a, points - a
    whole = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    flat = whole == 0.0
    whole = np.where(flat, 1.0, whole)
    v = (to[:, 0] * ac[:, 1] - to[:, 1] * ac[:, 0]) / whole
    w = (ab[:, 0] * to[:, 1] - ab[:, 1] * to[:, 0]) / whole
    out = np.stack([1.0 - v - w, v, w], axis=1)
    out[flat] = 1.0 / 3.0
    return out


def true_weights(weights: F64, depths: F64) -> F64:
    """Returns the weights (N, 3) on triangles in space whose corners have depths (N, 3), from the weights (N, 3) in the image."""
    divided = weights / depths
    return np.asarray(divided / divided.sum(axis=1, keepdims=True))


def _covered(corners: F64, width: int, height: int) -> Iterator[tuple[I64, I64, F64]]:
    """Yields triangles (N,), pixels (N,) that they cover, and the weights (N, 3) of their corners there, from corners (F, 3, 2), pixels."""
    low = np.maximum(np.ceil(corners.min(axis=1) - 1e-9), 0.0)
    high = np.minimum(np.floor(corners.max(axis=1) + 1e-9), (width - 1, height - 1))
    seen = np.flatnonzero((high >= low).all(axis=1))
    first = low[seen].astype(np.int64)
    sizes = high[seen].astype(np.int64) - first + 1
    for row, number in numbered_pairs(sizes.prod(axis=1), _PAIRS_AT_ONCE):
        x = first[row, 0] + number % sizes[row, 0]
        y = first[row, 1] + number // sizes[row, 0]
        which = seen[row]
        a, b, c = (corners[which, k] for k in range(3))
        weights = barycentric(corners[which], np.stack([x, y], axis=1).astype(np.float64))
        inside = (weights >= _INSIDE).all(axis=1)
        # What is seen from its edge covers nothing.
        inside &= (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]) != 0.0
        yield which[inside], (y * width + x)[inside], weights[inside]


@compiled
def _draw(corners: F64, depths: F64, numbers: I64, width: int, height: int, nearness: F64, face: I32, over: bool) -> None:
    """Enters triangles (F, 3, 2), pixels, with depths (F, 3) and numbers (F,) into an image of 1 / depth and one of numbers, both (H * W,).

    The nearest one stays, or, if ``over``, the last one.
    """
    for k in range(len(corners)):
        ax, ay, bx, by, cx, cy = (
            corners[k, 0, 0],
            corners[k, 0, 1],
            corners[k, 1, 0],
            corners[k, 1, 1],
            corners[k, 2, 0],
            corners[k, 2, 1],
        )
        left, right = max(np.ceil(min(ax, bx, cx) - 1e-9), 0.0), min(np.floor(max(ax, bx, cx) + 1e-9), width - 1.0)
        top, bottom = max(np.ceil(min(ay, by, cy) - 1e-9), 0.0), min(np.floor(max(ay, by, cy) + 1e-9), height - 1.0)
        abx, aby, acx, acy = bx - ax, by - ay, cx - ax, cy - ay
        whole = abx * acy - aby * acx
        if whole == 0.0 or right < left or bottom < top:
            continue
        for y in range(int(top), int(bottom) + 1):
            toy = y - ay
            for x in range(int(left), int(right) + 1):
                tox = x - ax
                v = (tox * acy - toy * acx) / whole
                w = (abx * toy - aby * tox) / whole
                u = 1.0 - v - w
                if u < _INSIDE or v < _INSIDE or w < _INSIDE:
                    continue
                near = u / depths[k, 0] + v / depths[k, 1] + w / depths[k, 2]
                if over or near >= nearness[y * width + x]:
                    nearness[y * width + x] = near
                    face[y * width + x] = numbers[k]
