"""Images of a task: from the robot's camera and in top view. The renderer is created with the first image."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_matrix
from gibson_sim.tasks.run import TaskRun
from gibson_sim.types import CameraSpec, Frame, Pose

FARTHEST_DEPTH = 10.0
"""Depth at which values are clipped, also for pixels without a surface, metres."""
_ABOVE, _FIELD = 9.0, math.radians(45.0)
"""Height above the floor, metres, and field of view, radians, of the top view."""
_CUT = 1.9
"""Height above which geometry, such as ceilings, is clipped in the top view, metres."""
_DOWN = np.array([[0.0, -1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""T_world_optical of a downward camera, with world x towards the top of the image."""


class TaskCamera:
    """Renders the camera images of a task's robot, and a top view. The renderer belongs to the thread that renders first.

    Args:
        run: the task to render.
        size: width and height of the robot's images, pixels.

    Raises:
        ConfigError: the robot has no camera.
    """

    def __init__(self, run: TaskRun, size: tuple[int, int]) -> None:
        cameras = run.robot.cameras
        if not cameras:
            raise ConfigError(f"robot {run.robot.name!r} has no camera; choose another one, or observation='state'")
        self._run = run
        self.camera: CameraSpec = replace(
            cameras[0], width=size[0], height=size[1], matrix=None, distortion=(), outputs=("rgb", "depth")
        )

    def rgbd(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Renders RGB, (H, W, 3), and depth, (H, W, 1), metres from 0 to ``FARTHEST_DEPTH``, from the robot's camera."""
        frame = self._draw(self.camera)
        assert frame.rgb is not None and frame.depth is not None
        depth = np.nan_to_num(frame.depth, nan=FARTHEST_DEPTH, posinf=FARTHEST_DEPTH, neginf=0.0)
        return frame.rgb, np.clip(depth, 0.0, FARTHEST_DEPTH)[..., None]

    def top_view(self, size: tuple[int, int]) -> NDArray[np.uint8]:
        """Renders a top view, (H, W, 3), centred at the robot, without ceilings."""
        x, y, z = self._run.observation.base.position
        pose = pose_from_matrix(matrix_from_pose(Pose((x, y, z + _ABOVE))) @ _DOWN)
        camera = CameraSpec(
            "above", "", pose, size[0], size[1], _FIELD, near=_ABOVE - _CUT, far=_ABOVE + 20.0, outputs=("rgb",), samples=4
        )  # fmt: skip
        frame = self._draw(camera)
        assert frame.rgb is not None
        return frame.rgb

    def camera_and_top_view(self, height: int) -> NDArray[np.uint8]:
        """Renders the robot's camera image beside a top view, both square: (height, 2 height, 3)."""
        frame = self._draw(replace(self.camera, width=height, height=height, outputs=("rgb",), samples=4))
        assert frame.rgb is not None
        return np.concatenate([frame.rgb, self.top_view((height, height))], axis=1)

    def _draw(self, camera: CameraSpec) -> Frame:
        # Not `Simulation.render`: observations have no depth noise.
        return self._run.simulation.renderer.render(self._run.world.state(), [camera])[0]
