"""Brings an earlier image onto the present one by the plane of the floor.

What lies in that plane then covers itself, whatever its pattern; what stands on it does not. The difference shows a box of the colour of the
floor, where one image alone shows nothing (inverse perspective mapping: Mallot et al., Biological Cybernetics 64, 1991).
"""

from __future__ import annotations

import math
from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import ViewError
from gibson_path_following.pose_filter import moved, relative
from gibson_path_following.types import Image, Step

F64 = NDArray[np.float64]
_HORIZON = 0.04
"""Tangent of the angle below the horizon from which on a pixel counts as one of the floor: that of a floor 25 camera heights away."""
_FAR = 1000.0
"""Distance of everything else, metres: the camera's turn moves it, its way does not."""
_WAY = 0.1, 0.25, 0.5
"""Distance from the present camera of an earlier one whose image is of use, metres: least, best and most."""
_TURN = 0.5
"""Largest turn in between, radians."""
_KEPT = 40
"""Views that are kept."""
_BEFORE_CAMERA = 0.05
"""Distance ahead of the earlier camera from which on it can have seen a point, metres."""


class FloorPlane:
    """The floor as a level pinhole camera with square pixels sees it."""

    def __init__(self, width: int, height: int, hfov: float, camera_height: float) -> None:
        """Computes where on the floor each pixel looks.

        Args:
            width: of the images, pixels.
            height: the same.
            hfov: horizontal field of view, radians.
            camera_height: above the floor, metres.
        """
        self._shape = height, width, 3
        self._focal = 0.5 * width / math.tan(0.5 * hfov)
        self._middle = 0.5 * (width - 1), 0.5 * (height - 1)
        rows, columns = np.mgrid[0:height, 0:width].astype(np.float64)
        right, below = (columns - self._middle[0]) / self._focal, (rows - self._middle[1]) / self._focal
        is_floor = below > _HORIZON
        self._ahead: F64 = np.where(is_floor, camera_height / np.where(is_floor, below, 1.0), _FAR)
        self._left: F64 = -right * self._ahead
        self._below: F64 = np.where(is_floor, camera_height, below * _FAR)

    def brought(self, image: Image, pose: F64) -> Image:
        """Returns (height, width, 3), uint8: an earlier image as the present camera would see it if all below the horizon were floor.

        Args:
            image: (height, width, 3), uint8, of the earlier camera.
            pose: (3,), where that camera was, in the frame of the present one: x ahead, y to the left, yaw; metres and radians.

        Returns:
            What the earlier camera did not see is black, (0, 0, 0).

        Raises:
            ViewError: the image has another shape.
        """
        if image.shape != self._shape:
            raise ViewError(f"an earlier image has shape {image.shape}, must be {self._shape}")
        x, y, yaw = (float(value) for value in pose)
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = self._ahead - x, self._left - y
        ahead, left = c * dx + s * dy, c * dy - s * dx
        seen = ahead > _BEFORE_CAMERA
        scale = self._focal / np.where(seen, ahead, 1.0)
        columns = np.where(seen, self._middle[0] - left * scale, -10.0).astype(np.float32)
        rows = np.where(seen, self._middle[1] + self._below * scale, -10.0).astype(np.float32)
        return np.asarray(cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), dtype=np.uint8)


class ViewTrack:
    """The last views, and where the camera was by what the robot is believed to have driven."""

    def __init__(self, camera_ahead: float) -> None:
        """Knows nothing.

        Args:
            camera_ahead: of the camera in front of the middle of the robot, metres.
        """
        self._ahead = camera_ahead
        self._pose = 0.0, 0.0, 0.0
        """x, y, yaw of the robot since the last ``clear``, metres and radians."""
        self._views: deque[tuple[F64, Image]] = deque(maxlen=_KEPT)
        """Poses (3,) of the camera, and what it saw; the newest last."""

    def clear(self) -> None:
        """Forgets all views."""
        self._views.clear()

    def move(self, step: Step) -> None:
        """Moves by what the robot made since the view before."""
        self._pose = moved(self._pose, step.distance, step.turn)

    def add(self, image: Image) -> None:
        """Keeps the present view."""
        self._views.append((self._camera(), image))

    def earlier(self) -> tuple[Image, F64] | None:
        """Returns the earlier view from about 0.25 m away and where its camera was, (3,), in the frame of the present one; None = there is none."""
        here = self._camera()
        least, best, most = _WAY
        found = []
        for there, image in self._views:
            pose = np.array(relative(here, there))
            away = math.hypot(pose[0], pose[1])
            if least <= away <= most and abs(pose[2]) <= _TURN:
                found.append((abs(away - best), pose, image))
        if not found:
            return None
        _, pose, image = min(found, key=lambda each: each[0])
        return image, pose

    def _camera(self) -> F64:
        return np.array(moved(self._pose, self._ahead, 0.0))
