"""Input of our filling networks. Training and rendering share this code, so that a network gets the same input in both."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.filling.holes import BACK_FACE, NOTHING, SURFACE, is_hole
from gibson_sim.filling.push_pull import push_pull
from gibson_sim.geometry.compiling import CAN_COMPILE, compiled, fixed

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

CHANNELS = 9
"""Number of channels of the input."""
NEAREST_M = 0.2
"""Smaller depths are clamped to this one, metres."""
_MOST = np.float32(1.0 / NEAREST_M)
_ONE, _UNIT = np.float32(1.0), np.float32(1.0 / 255.0)


def filled_colour(colour: U8, hole: U8) -> U8:
    """Returns an image, (H, W, 3) sRGB, with its holes filled by push-pull.

    Args:
        colour: (H, W, 3), sRGB.
        hole: (H, W), as ``Frame.hole``.
    """
    return push_pull(colour, is_hole(hole), hole == SURFACE)


def network_input(colour: U8, depth: F32, normals: F32, hole: U8, *, loops: bool = CAN_COMPILE) -> F32:
    """Returns the input of a network, (1, 9, H, W).

    Channels: 0 to 2 the colours after push-pull, sRGB, 0 to 1; 3 inverse depth, 1/m, at most 5, 0 = nothing; 4 to 6 normals in the
    optical frame (x right, y down, z forward), 0 in holes; 7 hole, 1 where nothing is drawn or a back face is visible; 8 back face.

    Args:
        colour: (H, W, 3), sRGB, as rendered.
        depth: (H, W), metres, +inf = nothing.
        normals: (H, W, 3), optical frame, facing the camera, 0 = nothing.
        hole: (H, W), as ``Frame.hole``.
        loops: use compiled loops instead of NumPy; the values are the same.
    """
    return packed(filled_colour(colour, hole), depth, normals, hole, loops=loops)


def packed(filled: U8, depth: F32, normals: F32, hole: U8, *, loops: bool = CAN_COMPILE) -> F32:
    """Returns the input of a network for an image that is already filled; see ``network_input`` for the arguments."""
    if loops:
        return _packed_loop(fixed(filled), fixed(depth), fixed(normals), fixed(hole))
    out = np.zeros((1, CHANNELS, *hole.shape), dtype=np.float32)
    out[0, :3] = filled.transpose(2, 0, 1)
    out[0, :3] *= _UNIT
    seen = (depth > 0.0) & (depth < np.inf)
    np.divide(_ONE, depth, out=out[0, 3], where=seen)
    np.minimum(out[0, 3], _MOST, out=out[0, 3])
    holes = is_hole(hole)
    np.copyto(out[0, 4:7], normals.transpose(2, 0, 1), where=~holes)
    out[0, 7] = holes
    out[0, 8] = hole == BACK_FACE
    return out


@compiled
def _packed_loop(filled: U8, depth: F32, normals: F32, hole: U8) -> F32:
    height, width = hole.shape
    out = np.zeros((1, CHANNELS, height, width), dtype=np.float32)
    for v in range(height):
        for u in range(width):
            for k in range(3):
                out[0, k, v, u] = np.float32(filled[v, u, k]) * _UNIT
            z = depth[v, u]
            if z > np.float32(0.0) and z < np.float32(np.inf):
                out[0, 3, v, u] = min(_ONE / z, _MOST)
            code = hole[v, u]
            if code in (NOTHING, BACK_FACE):
                out[0, 7, v, u] = _ONE
            else:
                for k in range(3):
                    out[0, 4 + k, v, u] = normals[v, u, k]
            if code == BACK_FACE:
                out[0, 8, v, u] = _ONE
    return out
