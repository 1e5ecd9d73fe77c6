"""The renderer: (SceneState, CameraSpecs) -> Frames. Knows OpenGL and nothing of ROS or physics."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError, RenderError, SceneMismatchError
from gibson_sim.geometry.transforms import Mat4, matrices_from_poses, matrix_from_pose
from gibson_sim.render.batches import Loader, build_batches
from gibson_sim.render.context import LIBRARY, GlContext, open_context
from gibson_sim.render.gl_scene import GlScene
from gibson_sim.render.readback import Feature, Target, features_of
from gibson_sim.scenes.mesh import MeshLoader
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim.types import CameraSpec, Frame, SceneState

_MAX_TARGETS = 8


class Renderer:
    """Draws a scene. One thread makes, uses and closes it; several may live side by side.

    Materials: textures are mixed in linear light; unlit ones are drawn as they are, others by the sun and the ambient light of the
    scene. Masked materials are solid where alpha reaches the cutoff. Blended ones are solid, with a depth, where alpha is at least
    0.9; elsewhere they tint what is behind them, whose depth is reported.

    Args:
        scene: what to draw.
        device: EGL device number; None = a GPU if one works, else software.
        library: name of the EGL library.
        loader: returns the mesh of a shape; None = reads the files.
        allowed_roots: folders that meshes and textures must lie in; None = the folders above those of the meshes.
        cull: leave out what is outside the image; off only to check that nothing else changes.

    Raises:
        GraphicsUnavailableError: nothing here can draw.
    """

    def __init__(
        self,
        scene: DrawnScene,
        *,
        device: int | None = None,
        library: str = LIBRARY,
        loader: Loader | None = None,
        allowed_roots: Sequence[Path] | None = None,
        cull: bool = True,
    ) -> None:
        self._context: GlContext | None = None
        self._scene: GlScene | None = None
        self._targets: dict[tuple[int, int, tuple[Feature, ...]], Target] = {}
        self._thread = threading.get_ident()
        self._links, self._revision = tuple(scene.links), scene.revision
        try:
            self._context = open_context(device, library=library)
            loader = loader or MeshLoader(_roots(scene, allowed_roots)).shape
            batches = build_batches(scene.visuals, self._links, loader, scene.labels())
            self._scene = GlScene(self._context, batches, scene.light, cull=cull)
        except BaseException:
            self.close()
            raise
        self.warnings: tuple[str, ...] = batches.warnings
        """What could not be loaded and was left out or replaced, one line each."""
        opened = self._context.device
        self.info: dict[str, Any] = {
            "renderer": opened.renderer,
            "vendor": opened.vendor,
            "version": opened.version,
            "device": opened.index,
            "software": opened.software,
            "triangles": batches.triangles,
            "batches": len(batches.batches),
            "chunks": len(batches.chunk_first),
            "textures": len(batches.textures),
            "texture_mb": round(self._scene.texture_bytes / 1e6, 1),
        }
        """What draws, and how much."""

    def render(self, state: SceneState, cameras: Sequence[CameraSpec]) -> list[Frame]:
        """Returns one frame for each camera, with the stamp of the state; the arrays belong to the caller.

        Raises:
            SceneMismatchError: the state belongs to another scene, or another revision of it.
            ConfigError: a camera sits on a link that the scene does not have.
            RenderError: closed, called from another thread, or an image too large for the driver.
        """
        if self._scene is None or self._context is None:
            raise RenderError("the renderer is closed; make a new one")
        if threading.get_ident() != self._thread:
            raise RenderError("the renderer belongs to the thread that made it; draw there, or make one for each thread")
        self._check(state)
        T_world_links = np.concatenate([np.eye(4)[None], matrices_from_poses(state.positions, state.quats_xyzw)])
        poses = [self._camera_matrix(camera, T_world_links) for camera in cameras]
        self._context.make_current()
        return [self._draw(state, camera, pose, T_world_links) for camera, pose in zip(cameras, poses, strict=True)]

    def _check(self, state: SceneState) -> None:
        if state.revision != self._revision:
            raise SceneMismatchError(
                f"the state is of scene revision {state.revision}, revision {self._revision} is loaded; load the scene again"
            )
        if state.links != self._links:
            raise SceneMismatchError(
                f"the state has {len(state.links)} links, others than the {len(self._links)} of the scene that is loaded; load its scene"
            )

    def _camera_matrix(self, camera: CameraSpec, T_world_links: NDArray[np.float64]) -> Mat4:
        """Returns T_world_camera, (4, 4)."""
        if camera.link and camera.link not in self._links:
            known = ", ".join(self._links) or "none"
            raise ConfigError(f"camera {camera.name!r}: link {camera.link!r} is not in the scene; its links: {known}")
        row = self._links.index(camera.link) + 1 if camera.link else 0
        T_world_camera: Mat4 = T_world_links[row] @ matrix_from_pose(camera.pose)
        return T_world_camera

    def _draw(self, state: SceneState, camera: CameraSpec, T_world_camera: Mat4, T_world_links: NDArray[np.float64]) -> Frame:
        assert self._scene is not None
        features = features_of(camera.outputs)
        target = self._target(camera.width, camera.height, features)
        target.use()
        self._scene.draw(camera, T_world_camera, T_world_links)
        semantic, instance = target.read_labels() if "LABELS" in features else (None, None)
        return Frame(
            camera,
            state.stamp_ns,
            T_world_camera,
            rgb=target.read_rgb() if "rgb" in camera.outputs else None,
            depth=target.read_depth(camera.near, camera.far) if "depth" in camera.outputs else None,
            semantic=semantic if "semantic" in camera.outputs else None,
            instance=instance if "instance" in camera.outputs else None,
            normal=target.read_normals() if "NORMALS" in features else None,
        )

    def _target(self, width: int, height: int, features: tuple[Feature, ...]) -> Target:
        assert self._context is not None
        size = (width, height, features)
        if size not in self._targets:
            if len(self._targets) >= _MAX_TARGETS:
                self._targets.pop(next(iter(self._targets))).close()
            self._targets[size] = Target(self._context, width, height, features)
        return self._targets[size]

    def close(self) -> None:
        """Frees everything; a second call does nothing."""
        context, scene, targets = self._context, self._scene, self._targets
        self._context, self._scene, self._targets = None, None, {}
        if context is None:
            return
        try:
            context.make_current()
            for target in targets.values():
                target.close()
            if scene is not None:
                scene.close()
        finally:
            context.close()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def _roots(scene: DrawnScene, allowed_roots: Sequence[Path] | None) -> list[Path]:
    """Returns the folders that files may lie in. Models keep ``meshes/`` and ``materials/`` side by side, so one above the mesh."""
    if allowed_roots is not None:
        return list(allowed_roots)
    folders = {Path(v.shape.mesh).parent for v in scene.visuals if v.shape.kind == "mesh"}
    return sorted({f if f.parent == f.parent.parent else f.parent for f in folders})
