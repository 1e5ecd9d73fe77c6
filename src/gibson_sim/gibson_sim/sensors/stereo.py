"""Rectified stereo pairs: two equal cameras side by side. Pure."""

from __future__ import annotations

import math
from dataclasses import replace

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_matrix
from gibson_sim.types import CameraSpec


def stereo_pair(left: CameraSpec, baseline: float) -> tuple[CameraSpec, CameraSpec]:
    """Returns a rectified left and right camera: a point at depth z is ``fx baseline / z`` pixels farther left in the right image.

    The right camera is offset by ``baseline`` along the optical x axis, on the same link; the baseline is in ``p`` of its camera_info.
    ``left`` in the name becomes ``right``, or ``_right`` is appended.

    Args:
        left: a pinhole camera.
        baseline: distance between the cameras, metres, above 0.

    Raises:
        ConfigError: the camera is not a pinhole, or the baseline is not positive.
    """
    if not (math.isfinite(baseline) and baseline > 0.0):
        raise ConfigError(f"camera {left.name!r}: stereo baseline is {baseline:g} m, must be a finite number above 0")
    if left.projection != "pinhole":
        raise ConfigError(f"camera {left.name!r}: a stereo pair needs pinhole cameras, its projection is {left.projection}")
    T_link_left = matrix_from_pose(left.pose)
    T_link_right = T_link_left.copy()
    T_link_right[:3, 3] += baseline * T_link_left[:3, 0]
    head, found, tail = left.name.rpartition("left")
    name = f"{head}right{tail}" if found else f"{left.name}_right"
    return left, replace(left, name=name, pose=pose_from_matrix(T_link_right), stereo_baseline=baseline)
