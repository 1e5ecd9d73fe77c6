"""Hole images (``Frame.hole``): the values of their pixels, and the interface of what fills holes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

SURFACE = 0
"""The front face of a surface is visible."""
NOTHING = 1
"""Nothing is drawn: the ray meets no surface."""
BACK_FACE = 2
"""The back face of an opaque surface of the world is visible, for example through a missing wall of a scan."""
UNSEEN = 3
"""No surface and no hole: outside the field of view of the lens, or sky if the scene has one."""


OUTSIDE = 4
"""Only as input of fillers, where ``Frame.hole`` has ``UNSEEN``: outside the field of view of the lens, and not sky."""
MOVING = 5
"""Only as input of fillers, where ``Frame.hole`` has ``SURFACE``: a surface of a moving link. It is no part of a scan: it keeps its colours, and
is unknown to fillers, so that no hole is filled from it."""


def is_hole(hole: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Returns the mask of the holes in a hole image (H, W)."""
    return np.asarray((hole == NOTHING) | (hole == BACK_FACE))


@dataclass(frozen=True, slots=True, eq=False)
class Filled:
    """An image without holes."""

    colour: U8
    """(H, W, 3), sRGB."""
    depth: F32 | None = None
    """(H, W), metres, +inf = nothing; equal to the rendered depth outside holes; None = not requested."""


class Filler(Protocol):
    """Fills holes."""

    def fill(self, colour: U8, depth: F32, normals: F32, hole: U8, *, with_depth: bool) -> Filled:
        """Returns an image without holes.

        Args:
            colour: (H, W, 3), sRGB, as rendered.
            depth: (H, W), metres, +inf = nothing.
            normals: (H, W, 3), optical frame, facing the camera, 0 = nothing.
            hole: (H, W), as ``Frame.hole``, but ``OUTSIDE`` outside the lens and ``MOVING`` on moving links.
            with_depth: also fill depth.

        Raises:
            ConfigError: a network cannot be run.
        """
