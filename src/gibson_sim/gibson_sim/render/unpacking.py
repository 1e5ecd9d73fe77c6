"""What was read of a target becomes the arrays of a frame: in NumPy, or by compiled loops that go over the pixels once; equal, to the bit."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.compiling import CAN_COMPILE, compiled, fixed

F32 = NDArray[np.float32]
U16 = NDArray[np.uint16]
UNIT = np.float32(2.0 / 65535.0)
"""Normals are stored as fractions of 65535: ``fraction * UNIT - 1``."""
_ONE = np.float32(1.0)


def depth_of(raw: F32, near: float, far: float, *, loops: bool = CAN_COMPILE) -> F32:
    """Returns depth, (H, W), metres, +inf = nothing nearer than ``far``.

    Args:
        raw: (H, W), near / depth, 0 = nothing.
        near: metres.
        far: metres.
        loops: by compiled loops.
    """
    nearest, least = np.float32(near), np.float32(near) / np.float32(far)
    if loops:
        return _depth_loop(fixed(raw), nearest, least)
    with np.errstate(divide="ignore"):
        depth: F32 = nearest / raw
    # Few images show anything beyond: to look is quicker than to choose for each pixel.
    if float(raw.min()) < least:
        depth[raw < least] = np.inf
    return depth


@compiled
def _depth_loop(raw: F32, near: np.float32, least: np.float32) -> F32:
    out = np.empty(raw.shape, dtype=np.float32)
    for v in range(raw.shape[0]):
        for u in range(raw.shape[1]):
            depth = near / raw[v, u]
            out[v, u] = np.float32(np.inf) if raw[v, u] < least else depth
    return out


def normals_of(raw: U16, *, loops: bool = CAN_COMPILE) -> F32:
    """Returns unit normals, (H, W, 3), 0 = nothing, of fractions, (H, W, 4), the last one 0 = nothing."""
    if loops:
        return _normals_loop(fixed(raw))
    # One conversion, then arithmetic in place: half the time of a multiplication that converts.
    normals = cv2.cvtColor(raw, cv2.COLOR_RGBA2RGB).astype(np.float32)
    normals *= UNIT
    normals -= _ONE
    if not raw[:, :, 3].all():
        normals[raw[:, :, 3] == 0] = 0.0
    return normals


@compiled
def _normals_loop(raw: U16) -> F32:
    out = np.zeros((raw.shape[0], raw.shape[1], 3), dtype=np.float32)
    for v in range(raw.shape[0]):
        for u in range(raw.shape[1]):
            if raw[v, u, 3]:
                for k in range(3):
                    scaled = np.float32(raw[v, u, k]) * UNIT
                    out[v, u, k] = scaled - _ONE
    return out


def turned(R: F32, vectors: F32, *, loops: bool = CAN_COMPILE) -> F32:
    """Returns ``R v`` of vectors, (H, W, 3), float32, summed from left to right: what a GPU computes, to the bit."""
    if loops:
        return _turned_loop(fixed(R), fixed(vectors))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    out = np.empty_like(vectors)
    for i in range(3):
        with np.errstate(invalid="ignore"):
            out[..., i] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z
    return out


@compiled
def _turned_loop(R: F32, vectors: F32) -> F32:
    out = np.empty(vectors.shape, dtype=np.float32)
    for v in range(vectors.shape[0]):
        for u in range(vectors.shape[1]):
            x, y, z = vectors[v, u, 0], vectors[v, u, 1], vectors[v, u, 2]
            for i in range(3):
                out[v, u, i] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z
    return out


def positions_of(rays: F32, depth: F32, R: F32, t: F32, *, loops: bool = CAN_COMPILE) -> F32:
    """Returns where pixels see something, (H, W, 3), world frame, metres, float32, summed from left to right; NaN = nothing is there.

    Args:
        rays: (H, W, 3), what a pixel's depth is multiplied with to give its point in the optical frame.
        depth: (H, W), metres, +inf = nothing.
        R: (3, 3), R_world_camera.
        t: (3,), the camera in the world, metres.
        loops: by compiled loops.
    """
    if loops:
        return _positions_loop(fixed(rays), fixed(depth), fixed(R), fixed(t))
    with np.errstate(invalid="ignore"):  # 0 times infinity: straight ahead, and nothing there
        seen = rays * depth[:, :, None]
    position = turned(R, seen, loops=False) + t
    position[~np.isfinite(depth)] = np.nan
    return position


@compiled
def _positions_loop(rays: F32, depth: F32, R: F32, t: F32) -> F32:
    out = np.empty(rays.shape, dtype=np.float32)
    for v in range(rays.shape[0]):
        for u in range(rays.shape[1]):
            z = depth[v, u]
            if np.isfinite(z):
                a, b, c = rays[v, u, 0] * z, rays[v, u, 1] * z, rays[v, u, 2] * z
                for i in range(3):
                    out[v, u, i] = R[i, 0] * a + R[i, 1] * b + R[i, 2] * c + t[i]
            else:
                for i in range(3):
                    out[v, u, i] = np.float32(np.nan)
    return out
