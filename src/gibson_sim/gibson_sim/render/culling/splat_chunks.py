"""Splats of a scene in the world frame, in chunks of neighbours: culls and sorts them for a picture. No OpenGL.

Culling never changes a pixel. Splats are sorted by depth along the optical axis, as in the code of Kerbl et al. 2023; splats at the same
depth have a fixed order.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.splats import Splats
from gibson_sim.geometry.projections import frustum_planes
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render.culling.draw_plan import PinholePicture
from gibson_sim.render.culling.occlusion import DepthPyramid, ScreenBounds

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]

NEAREST = 0.2
"""Minimum depth of the centre of a drawn splat, metres, as in the code of the paper: nearer splats would cover the picture."""
LOW_PASS = 0.3
"""Minimum variance of a splat in the picture, square pixels."""
SPREAD = 1.3
"""Multiple of the picture's half size at which the point of linearisation is clamped: the Jacobian diverges beside the camera."""
LEAST_ALPHA = 1.0 / 255.0
"""Minimum opacity of a splat at a pixel; smaller opacities are ignored."""

_CHUNK = 256
_FADE_SIGMAS = float(np.sqrt(-2.0 * np.log(LEAST_ALPHA)))
"""Radius, in standard deviations, at which an opaque splat has faded to ``LEAST_ALPHA``."""
_LINEARISED = 1.5
"""Largest ratio of a linearised to the exact projected size, within ``SPREAD`` of a picture of 90 degrees."""
_BITS = 10
"""Bits per axis of the Morton code."""


class SplatChunks:
    """Splats in the world frame, sorted along a Morton curve.

    Args:
        splats: splats in the frame of their file.
        T_world_file: (4, 4), a rigid transform times a scale.
    """

    def __init__(self, splats: Splats, T_world_file: Mat4) -> None:
        scale = float(np.cbrt(np.linalg.det(T_world_file[:3, :3])))
        R_world_file = T_world_file[:3, :3] / scale
        positions = splats.positions.astype(np.float64) @ T_world_file[:3, :3].T + T_world_file[:3, 3]
        # Splats fainter than LEAST_ALPHA at their centre are never visible.
        visible = np.flatnonzero(splats.opacities >= LEAST_ALPHA)
        order = visible[_morton_order(positions[visible])]
        self.positions: F32 = positions[order].astype(np.float32)
        """(N, 3), world frame, metres."""
        self._columns = np.ascontiguousarray(self.positions.T)
        self.opacities: F32 = splats.opacities[order]
        """(N,), opacity at the centre."""
        self.sh: F32 = splats.sh[order]
        """(N, K, 3), spherical harmonics as in ``Splats``, for directions in the frame of the file."""
        self.R_world_file: F64 = R_world_file
        """(3, 3)."""
        self.covariances: F32 = _covariances(splats, order, R_world_file, scale)
        """(N, 6), world frame, square metres: xx, xy, xz, yy, yz, zz."""
        self._widths = splats.scales[order].max(axis=1, initial=0.0) * np.float32(scale)
        starts = np.arange(0, len(order), _CHUNK)
        self._first, self._count = starts, np.minimum(_CHUNK, len(order) - starts)
        self._boxes, self._wide_boxes = self._bounds(1.0), self._bounds(_LINEARISED)

    def __len__(self) -> int:
        return len(self.positions)

    def _bounds(self, factor: float) -> F64:
        """Returns the boxes of the chunks, (C, 6), centre and half extents, metres, with ``factor`` times the radii of their splats."""
        if not len(self):
            return np.zeros((0, 6))
        reach = (factor * _FADE_SIGMAS * self._widths)[:, None]
        low = np.minimum.reduceat(self.positions - reach, self._first).astype(np.float64)
        high = np.maximum.reduceat(self.positions + reach, self._first).astype(np.float64)
        return np.concatenate([(low + high) / 2.0, (high - low) / 2.0], axis=1)

    def select(self, picture: PinholePicture, depth: F32 | None, *, cull: bool = True) -> U32:
        """Returns the rows of the splats to draw, from far to near.

        Args:
            picture: picture whose camera pose is in the world frame.
            depth: (H, W), ``near / depth`` of occluders, 0 = nothing; None = no occluders.
            cull: frustum and occlusion culling; False only to verify that culling changes no image.
        """
        T_camera_world: Mat4 = np.linalg.inv(picture.T_world_camera).astype(np.float64)
        pyramid = None if depth is None or not cull else DepthPyramid(depth)
        if cull:
            chunks = self._chunks(picture, T_camera_world, pyramid)
            count = self._count[chunks]
            starts = np.cumsum(count) - count
            rows = np.arange(int(count.sum())) + np.repeat(self._first[chunks] - starts, count)
        else:
            rows = np.arange(len(self))
        # Written out by coordinates: a matrix product would start the threads of the BLAS library.
        world = self._columns[:, rows]
        T = T_camera_world.astype(np.float32)
        p = np.stack([T[i, 0] * world[0] + T[i, 1] * world[1] + T[i, 2] * world[2] + T[i, 3] for i in range(3)])
        keep = p[2] > NEAREST
        if cull:
            kept = np.flatnonzero(keep)
            keep[kept] = self._visible(rows[kept], p[:, kept], picture, pyramid)
        rows, z = rows[keep], p[2, keep]
        return np.ascontiguousarray(rows[_depth_order(z)[::-1]], dtype=np.uint32)

    def _chunks(self, picture: PinholePicture, T_camera_world: Mat4, pyramid: DepthPyramid | None) -> I64:
        """Returns the potentially visible chunks, (C,)."""
        # Two more pixels on each side, the reach of the low-pass filter.
        k = picture.intrinsics.astype(np.float64).copy()
        k[:2, 2] += 2.0
        planes = frustum_planes(k, picture.width + 4, picture.height + 4, NEAREST) @ T_camera_world
        ahead = (
            self._wide_boxes[:, :3] @ planes[:, :3].T + planes[:, 3] + self._wide_boxes[:, 3:] @ np.abs(planes[:, :3]).T >= 0.0
        )
        inside = np.flatnonzero(ahead.all(axis=1))
        if pyramid is None or not len(inside):
            return inside
        matrix = np.vstack([picture.intrinsics[:2], [0.0, 0.0, 1.0]]) @ T_camera_world[:3]
        bounds = ScreenBounds(
            self._wide_boxes[inside], np.repeat(matrix[None], len(inside), axis=0), (picture.width, picture.height), picture.near
        )
        return inside[~bounds.hidden(pyramid)]

    def _visible(self, rows: I64, p: F32, picture: PinholePicture, pyramid: DepthPyramid | None) -> NDArray[np.bool_]:
        """Returns a mask, (N,), of the potentially visible splats of ``rows`` (N,), whose centres are ``p`` (3, N), optical frame."""
        k, size = picture.intrinsics, (picture.width, picture.height)
        inverse = np.float32(1.0) / p[2]
        x, y = p[0] * inverse, p[1] * inverse
        u = x * np.float32(k[0, 0]) + y * np.float32(k[0, 1]) + np.float32(k[0, 2])
        v = y * np.float32(k[1, 1]) + np.float32(k[1, 2])
        reach = np.float32(_FADE_SIGMAS) * self._widths[rows]
        low, high = projected_limits(k, *size)
        x, y = np.clip(x, low[0], high[0]), np.clip(y, low[1], high[1])
        focal = np.float32(max(abs(k[0, 0]), abs(k[1, 1])))
        # The largest scale of the linearised projection; the low-pass filter adds its width.
        radius = reach * focal * inverse * np.sqrt(np.float32(1.0) + x * x + y * y) + np.float32(_FADE_SIGMAS * LOW_PASS**0.5)
        inside = (u + radius >= -0.5) & (u - radius <= size[0] - 0.5) & (v + radius >= -0.5) & (v - radius <= size[1] - 0.5)
        if pyramid is None:
            return np.asarray(inside)
        candidates = np.flatnonzero(inside)
        u, v, radius = u[candidates], v[candidates], radius[candidates]
        ends = [
            np.clip(end, 0, most - 1).astype(np.int64)
            for end, most in (
                (u - radius, size[0]),
                (v - radius, size[1]),
                (u + radius + 1.0, size[0]),
                (v + radius + 1.0, size[1]),
            )
        ]
        nearest = picture.near / np.maximum(p[2, candidates] - reach[candidates], picture.near)
        inside[candidates] = nearest > pyramid.least(ends[0], ends[1], ends[2], ends[3])
        return np.asarray(inside)


def projected_limits(intrinsics: NDArray[Any], width: int, height: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Returns the minimum and the maximum (x / z, y / z) at which the projection of splats is linearised."""
    k = intrinsics
    ends = [((-0.5 - k[a, 2]) / k[a, a], (size - 0.5 - k[a, 2]) / k[a, a]) for a, size in ((0, width), (1, height))]
    (left, right), (top, bottom) = ends
    more_x, more_y = (SPREAD - 1.0) * (right - left) / 2.0, (SPREAD - 1.0) * (bottom - top) / 2.0
    return (float(left - more_x), float(top - more_y)), (float(right + more_x), float(bottom + more_y))


def _depth_order(z: F32) -> I64:
    """Returns the stable sort order of positive depths (N,), nearest first, by two radix sorts of 16 bits: twice as fast as argsort."""
    keys = np.ascontiguousarray(z).view(np.uint32)  # positive floats sort like their bits
    order = np.argsort((keys & np.uint32(0xFFFF)).astype(np.uint16), kind="stable")
    return np.asarray(order[np.argsort((keys >> np.uint32(16)).astype(np.uint16)[order], kind="stable")])


def _morton_order(positions: F64) -> I64:
    """Returns the order of points (N, 3) along a Morton curve through their bounding box."""
    if not len(positions):
        return np.zeros(0, dtype=np.int64)
    # A few distant outliers must not put all other splats into one cell.
    low, high = np.percentile(positions, 1.0, axis=0), np.percentile(positions, 99.0, axis=0)
    side = max(float((high - low).max()), 1e-9)
    cells = np.clip((positions - low) / side * (1 << _BITS), 0, (1 << _BITS) - 1).astype(np.int64)
    key = np.zeros(len(positions), dtype=np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            key |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")


def _covariances(splats: Splats, order: I64, R_world_file: F64, scale: float) -> F32:
    """Returns the covariances of splats ``order``, (N, 6), world frame, square metres."""
    x, y, z, w = splats.quats_xyzw[order].T.astype(np.float64)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    sigma = splats.scales[order].T.astype(np.float64) * scale
    # Columns of the factor, in the world frame: (3, 3, N), axis of the world by axis of the splat.
    factor = np.einsum("ij,jkn->ikn", R_world_file, np.array(rows)) * sigma[None]
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    return np.stack([(factor[i] * factor[j]).sum(axis=0) for i, j in pairs], axis=1).astype(np.float32)
