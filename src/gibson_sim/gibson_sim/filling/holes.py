"""Pixel values of a hole image (``Frame.hole``)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
