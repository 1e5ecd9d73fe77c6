"""Cameras of a robot that follows paths, in the conditions of a drive."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gibson_path_following.types import CameraKind
from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_matrix, pose_from_xyz_rpy
from gibson_sim.quoting import quoted
from gibson_sim.types import CameraSpec, Output, Pose
from gibson_sim_learn.path_following.domains import Conditions

_OPTICAL = Pose((0.0, 0.0, 0.0), (-0.5, 0.5, -0.5, 0.5))
"""T_camera_optical of a camera that looks along x."""
_WIDEST = math.radians(160.0)
"""Largest field of view of a pinhole camera, radians."""


@dataclass(frozen=True, slots=True)
class Rig:
    """Level cameras above the base of the robot."""

    kind: CameraKind = "pinhole"
    width: int = 96
    """Width of an image, pixels; images of fisheyes are square."""
    height: int = 64
    """Height of an image of a pinhole camera, pixels."""
    hfov: float = math.radians(100.0)
    """Horizontal field of view of a pinhole camera, radians; fisheyes have 180 degrees."""
    camera_height: float = 0.46
    """Height of the cameras above the floor, metres."""
    camera_ahead: float = 0.12
    """Distance of a pinhole camera ahead of the robot's centre, metres."""

    def __post_init__(self) -> None:
        if self.kind not in ("pinhole", "fisheye_pair"):
            raise ConfigError(f"camera is {quoted(self.kind)}, must be pinhole or fisheye_pair")

    def field_of_view(self, change: float = 0.0) -> float:
        """Returns the horizontal field of view of an image, radians; ``change`` is added to that of the rig."""
        return math.pi + change if self.kind == "fisheye_pair" else min(self.hfov + change, _WIDEST)

    def cameras(self, link: str, conditions: Conditions, outputs: tuple[Output, ...] = ("rgb",)) -> tuple[CameraSpec, ...]:
        """Returns the cameras in the order of a view's images.

        Args:
            link: ``<robot>/<link>`` of the base, on the floor.
            conditions: changes of field of view, height and pitch.
            outputs: outputs of an image.
        """
        up = self.camera_height + conditions.height_change
        tilt = conditions.pitch_change
        hfov = self.field_of_view(conditions.hfov_change)
        if self.kind == "pinhole":
            pose = _looking(self.camera_ahead, up, tilt, 0.0)
            fov_y = 2.0 * math.atan(math.tan(hfov / 2.0) * self.height / self.width)
            return (CameraSpec("path_front", link, pose, self.width, self.height, fov_y, near=0.02, outputs=outputs),)
        return tuple(
            CameraSpec(
                name,
                link,
                _looking(0.0, up, tilt if not yaw else -tilt, yaw),
                self.width,
                self.width,
                near=0.02,
                outputs=outputs,
                projection="fisheye",
                fov=hfov,
            )
            for name, yaw in (("path_front", 0.0), ("path_back", math.pi))
        )


def _looking(ahead: float, up: float, tilt: float, yaw: float) -> Pose:
    """Returns T_base_optical of a camera at (``ahead``, 0, ``up``), metres, with a heading, pitched down by ``tilt``, radians."""
    level = matrix_from_pose(pose_from_xyz_rpy((ahead, 0.0, up), (0.0, tilt, yaw)))
    return pose_from_matrix(level @ matrix_from_pose(_OPTICAL))
