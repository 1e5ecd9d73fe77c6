"""Keeps recent images with the odometry poses of their camera, and selects the one with a useful baseline to the present camera."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.localisation.pose_filter import pose_after_arc, relative_pose
from gibson_path_following.types import Image, Step

F64 = NDArray[np.float64]
_BASELINE = 0.1, 0.25, 0.5
"""Least, best and largest distance between the earlier camera and the present one, metres."""
_MAX_TURN = 0.5
"""Largest turn between the two, radians."""
_MAX_VIEWS = 40
"""Images that are kept."""


class ViewHistory:
    """Recent images of one camera, with its poses by the estimated motion of the robot."""

    def __init__(self, camera_ahead: float) -> None:
        """Begins without images.

        Args:
            camera_ahead: distance of the camera ahead of the robot's centre, metres.
        """
        self._camera_ahead = camera_ahead
        self._pose = 0.0, 0.0, 0.0
        """x, y, yaw of the robot, odometry frame, metres and radians."""
        self._views: deque[tuple[F64, Image]] = deque(maxlen=_MAX_VIEWS)
        """Poses (3,) of the camera, odometry frame, and its images; the newest last."""

    def clear(self) -> None:
        """Drops all images."""
        self._views.clear()

    def move(self, step: Step) -> None:
        """Integrates the estimated motion since the previous view."""
        self._pose = pose_after_arc(self._pose, step.distance, step.turn)

    def add(self, image: Image) -> None:
        """Keeps the present image; it is not copied."""
        self._views.append((self._camera_pose(), image))

    def earlier(self) -> tuple[Image, F64] | None:
        """Returns the image whose baseline is nearest to 0.25 m, and its camera's pose (3,), x, y, yaw, in the present camera's frame.

        None = no image has a useful baseline.
        """
        present = self._camera_pose()
        least, best, largest = _BASELINE
        candidates = []
        for camera, image in self._views:
            pose = np.array(relative_pose(present, camera))
            baseline = math.hypot(pose[0], pose[1])
            if least <= baseline <= largest and abs(pose[2]) <= _MAX_TURN:
                candidates.append((abs(baseline - best), pose, image))
        if not candidates:
            return None
        _, pose, image = min(candidates, key=lambda each: each[0])
        return image, pose

    def _camera_pose(self) -> F64:
        """Returns (3,): x, y, yaw of the camera, odometry frame."""
        return np.array(pose_after_arc(self._pose, self._camera_ahead, 0.0))
