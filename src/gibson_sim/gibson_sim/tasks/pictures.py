"""What a robot at a task sees, and what one sees of it. Draws in this process, from the first picture on."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_matrix
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.spec import drawn_scene
from gibson_sim.tasks.run import TaskRun
from gibson_sim.types import CameraSpec, Frame, Pose

FARTHEST_DEPTH = 10.0
"""Metres: depths are clipped here, and nothing is as far."""
_ABOVE, _FIELD = 9.0, math.radians(45.0)
"""Metres over the floor, and full angle, of the camera that looks down."""
_CUT = 1.9
"""Metres: what is higher, as ceilings, is left out of the view from above."""
_DOWN = np.array([[0.0, -1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""T_world_optical of a camera that looks down, x to the top of the picture."""


class TaskCamera:
    """The eyes of a task: a renderer that follows its world. One thread makes, uses and closes it.

    Args:
        run: what is drawn.
        size: width and height of the robot's pictures, pixels.
        device: EGL device, as ``Renderer`` takes it.

    Raises:
        ConfigError: the robot has no camera.
        GraphicsUnavailableError: nothing here can draw.
    """

    def __init__(self, run: TaskRun, size: tuple[int, int], device: int | str | None = None) -> None:
        cameras = run.robot.cameras
        if not cameras:
            raise ConfigError(f"robot {run.robot.name!r} has no camera; choose another one, or observation='state'")
        self._run = run
        self.camera: CameraSpec = replace(
            cameras[0], width=size[0], height=size[1], matrix=None, distortion=(), outputs=("rgb", "depth")
        )
        scene = drawn_scene(run.world.scene, run.world.links)
        self._renderer = Renderer(scene, device=device, cache=default_folder())
        self._revision = scene.revision

    def look(self) -> Frame:
        """Returns RGB and depth as the robot sees them now."""
        return self._draw(self.camera)

    def rgbd(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Returns RGB, (H, W, 3), and depth, (H, W, 1) in metres from 0 to ``FARTHEST_DEPTH``, as the robot sees them now."""
        frame = self.look()
        assert frame.rgb is not None and frame.depth is not None
        depth = np.nan_to_num(frame.depth, nan=FARTHEST_DEPTH, posinf=FARTHEST_DEPTH, neginf=0.0)
        return frame.rgb, np.clip(depth, 0.0, FARTHEST_DEPTH)[..., None]

    def above(self, size: tuple[int, int]) -> NDArray[np.uint8]:
        """Returns a picture, (H, W, 3), from above the robot; ceilings are left out."""
        x, y, z = self._run.view.base.position
        pose = pose_from_matrix(matrix_from_pose(Pose((x, y, z + _ABOVE))) @ _DOWN)
        camera = CameraSpec(
            "above", "", pose, size[0], size[1], _FIELD, near=_ABOVE - _CUT, far=_ABOVE + 20.0, outputs=("rgb",), samples=4
        )  # fmt: skip
        frame = self._draw(camera)
        assert frame.rgb is not None
        return frame.rgb

    def both(self, height: int) -> NDArray[np.uint8]:
        """Returns the robot's own view, and the one from above beside it, each a square: (height, 2 height, 3)."""
        own = self._draw(replace(self.camera, width=height, height=height, outputs=("rgb",), samples=4))
        assert own.rgb is not None
        return np.concatenate([own.rgb, self.above((height, height))], axis=1)

    def _draw(self, camera: CameraSpec) -> Frame:
        world = self._run.world
        if world.scene.revision != self._revision:
            self._renderer.update(drawn_scene(world.scene, world.links))
            self._revision = world.scene.revision
        return self._renderer.render(world.state(), [camera])[0]

    def close(self) -> None:
        """Frees what it draws with; a second call does nothing."""
        self._renderer.close()
