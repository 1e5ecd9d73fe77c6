"""Warps an earlier image onto the present one by the homography of the floor plane.

A point of the floor then lies in the same pixel of both images, whatever its texture; a point above the floor does not. Their difference shows an
obstacle that has the colour of the floor, which a single image does not (inverse perspective mapping: Mallot et al., Biological Cybernetics 64,
1991).
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import ViewError
from gibson_path_following.types import Image

F64 = NDArray[np.float64]
_HORIZON = 0.04
"""Tangent of the angle below the horizon from which on a pixel counts as floor: that of a floor 25 camera heights away."""
_FAR = 1000.0
"""Distance of all other pixels, metres: a rotation of the camera moves them, a translation does not."""
_MIN_DEPTH = 0.05
"""Least distance of a point ahead of the earlier camera that is sampled from its image, metres."""


class FloorPlane:
    """The floor plane as a level pinhole camera with square pixels and a centred axis sees it."""

    def __init__(self, width: int, height: int, hfov: float, camera_height: float) -> None:
        """Computes the point of the floor in each pixel.

        Args:
            width: width of the images, pixels.
            height: height of the images, pixels.
            hfov: horizontal field of view, radians.
            camera_height: height of the camera above the floor, metres.
        """
        self._shape = height, width, 3
        self._focal = 0.5 * width / math.tan(0.5 * hfov)
        self._centre = 0.5 * (width - 1), 0.5 * (height - 1)
        rows, columns = np.mgrid[0:height, 0:width].astype(np.float64)
        right, below = (columns - self._centre[0]) / self._focal, (rows - self._centre[1]) / self._focal
        is_floor = below > _HORIZON
        self._ahead: F64 = np.where(is_floor, camera_height / np.where(is_floor, below, 1.0), _FAR)
        """(height, width), x of each pixel's point, camera frame, metres."""
        self._left: F64 = -right * self._ahead
        """(height, width), y of each pixel's point, camera frame, metres."""
        self._below: F64 = np.where(is_floor, camera_height, below * _FAR)
        """(height, width), depth of each pixel's point below the camera, metres."""

    def warp(self, image: Image, pose: F64) -> Image:
        """Returns (height, width, 3), uint8: an earlier image warped onto the present one, as if all below the horizon were floor.

        Pixels that the earlier camera did not see are black, (0, 0, 0).

        Args:
            image: (height, width, 3), uint8, of the earlier camera.
            pose: (3,), pose of the earlier camera in the present camera's frame: x ahead, y to the left, yaw; metres and radians.

        Raises:
            ViewError: the image has another shape.
        """
        if image.shape != self._shape:
            raise ViewError(f"an earlier image has shape {image.shape}, must be {self._shape}")
        x, y, yaw = (float(value) for value in pose)
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = self._ahead - x, self._left - y
        ahead, left = c * dx + s * dy, c * dy - s * dx
        is_seen = ahead > _MIN_DEPTH
        scale = self._focal / np.where(is_seen, ahead, 1.0)
        columns = np.where(is_seen, self._centre[0] - left * scale, -10.0).astype(np.float32)
        rows = np.where(is_seen, self._centre[1] + self._below * scale, -10.0).astype(np.float32)
        return np.asarray(cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), dtype=np.uint8)
