"""Gibson Sim's renderer in the renderer benchmark: ``python -m gibson_sim_bench.own_renderer`` receives commands over a pipe."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np

from gibson_sim.geometry.transforms import quat_from_matrix
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import MeshFiles, Renderer, RenderOptions
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import drawn_scene
from gibson_sim.types import CameraSpec, Frame, Output, Pose, SceneState
from gibson_sim_bench.workers import Matrix, serve

NEAR, FAR = 0.05, 100.0
STILL = SceneState.still()
"""Scene state without bodies that move."""


class GibsonSim:
    """Gibson Sim's renderer with a scene loaded from its files.

    Args:
        scene: folder or file of the scene.
        detail_px: tolerance of the level-of-detail selection, pixels.
        device: EGL device; None = a GPU if there is one.
    """

    def __init__(self, scene: str, detail_px: float, device: int | str | None = None) -> None:
        logging.disable(logging.WARNING)
        spec = load_scene(Path(scene))
        meshes = MeshFiles(allowed_roots=scene_roots(spec), cache=default_folder())
        self._renderer = Renderer(drawn_scene(spec, ()), meshes, RenderOptions(device=device, detail_px=detail_px))
        info = self._renderer.info
        names = ("renderer", "version", "triangles", "textures")
        self.info = {name: str(info[name]) for name in names}
        self._camera = CameraSpec("eye", "")

    def prepare(self, width: int, height: int, fov_y: float, outputs: tuple[str, ...]) -> None:
        """Prepares for images of a size, pixels, and a vertical field of view, radians, with these outputs."""
        known = cast("tuple[Output, ...]", outputs)
        self._camera = CameraSpec("eye", "", Pose(), width, height, fov_y, near=NEAR, far=FAR, outputs=known)

    def render(self, pose: Matrix) -> Frame:
        """Renders one image with all its outputs."""
        c = self._camera
        camera = CameraSpec(c.name, c.link, pose_of(pose), c.width, c.height, c.fov_y, near=c.near, far=c.far, outputs=c.outputs)
        return self._renderer.render(STILL, [camera])[0]

    def rgb_image(self, rendered: Frame) -> tuple[bytes, int, int]:
        """Returns RGB bytes, height and width, pixels."""
        assert rendered.rgb is not None
        return rendered.rgb.tobytes(), rendered.camera.height, rendered.camera.width

    def triangles(self) -> int:
        """Returns the number of triangles drawn for the last image."""
        return self._renderer.drawn_triangles


def pose_of(matrix: Sequence[float]) -> Pose:
    """Returns the pose of a homogeneous 4x4 matrix, given as 16 numbers in row-major order."""
    T = np.array(matrix, dtype=np.float64).reshape(4, 4)
    assert math.isclose(T[3, 3], 1.0)
    return Pose((float(T[0, 3]), float(T[1, 3]), float(T[2, 3])), quat_from_matrix(T[:3, :3]))


if __name__ == "__main__":
    serve({"Gibson Sim": GibsonSim})
