"""Draws triangles into images of triangle numbers, with depth or flat, in NumPy: what a camera sees, and where a triangle lies in a texture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
        weights = barycentric(corners[which], np.stack([x, y], axis=1).astype(np.float64))
        inside = (weights >= _INSIDE).all(axis=1)
        yield which[inside], (y * width + x)[inside], weights[inside]
