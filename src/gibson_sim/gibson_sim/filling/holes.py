"""What a pixel of a hole image (``Frame.hole``) says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SURFACE = 0
"""The front of a surface is seen."""
NOTHING = 1
"""Nothing is drawn: the ray meets no surface."""
BACK_FACE = 2
"""The back of an opaque surface of the world is seen: of a scan, what lies behind a wall that is missing."""
UNSEEN = 3
"""No surface and no hole: outside the lens's view, or the sky of a scene that has one."""


def is_hole(hole: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Returns which pixels of a hole image, (H, W), are holes."""
    return np.asarray((hole == NOTHING) | (hole == BACK_FACE))
