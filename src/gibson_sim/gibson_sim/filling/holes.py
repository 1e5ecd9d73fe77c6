"""What a pixel of a hole image (``Frame.hole``) says."""

SURFACE = 0
"""The front of a surface is seen."""
NOTHING = 1
"""Nothing is drawn: the ray meets no surface."""
BACK_FACE = 2
"""The back of an opaque surface of the world is seen: of a scan, what lies behind a wall that is missing."""
UNSEEN = 3
"""No surface and no hole: outside the lens's view, or the sky of a scene that has one."""
