"""The renderer: (SceneState, CameraSpecs) -> Frames. Knows OpenGL and nothing of ROS or physics."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.config import DETAIL_PX
from gibson_sim.errors import ConfigError, RenderError, SceneError, SceneMismatchError
from gibson_sim.formats.file_roots import is_inside
from gibson_sim.formats.load_mesh import MeshLoader, mesh_folders
from gibson_sim.formats.splats import load_splats
from gibson_sim.geometry.exposures import Exposure, exposures
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose
from gibson_sim.quoting import quoted
from gibson_sim.render.batching.building import build_geometry
from gibson_sim.render.batching.composition import Composition
from gibson_sim.render.batching.scene_geometry import Loader, Progress, SceneGeometry
from gibson_sim.render.cache import SceneCache
from gibson_sim.render.context import LIBRARY, GlContext, open_context
from gibson_sim.render.culling.visibility import world_from_links
from gibson_sim.render.draw.camera_images import CameraImages
from gibson_sim.render.draw.effects import EffectsPass, changes_colors
from gibson_sim.render.draw.gl_scene import GlScene
from gibson_sim.render.draw.grouping import IdentityCache
from gibson_sim.render.draw.hole_filling import HoleFilling
from gibson_sim.render.draw.shutter import Shutter
from gibson_sim.render.draw.splats import SplatPass
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.render.readback.frames import Readback, TargetImage, needed
from gibson_sim.render.readback.pixel_buffers import PendingFrames, PixelBuffers
from gibson_sim.render.readback.tensors import TensorFrame, Tensors
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import DrawnScene, SceneSpec, SplatsSpec, drawn_scene
from gibson_sim.types import CameraSpec, Frame, Pose, SceneState


class Renderer:
    """Draws a scene. One thread makes, uses and closes it; several may live side by side.

    Materials: textures are filtered in linear light; unlit ones are drawn as they are, others with the lights of the scene. Masked
    materials are opaque where alpha reaches the cutoff. Blended ones are opaque, with a depth, where alpha is at least 0.9; elsewhere
    they tint what is behind them, whose depth is reported.

    Args:
        scene: what to draw: a scene from ``load_scene``, whose robots and bodies are left out, or one with links (``drawn_scene``).
        device: EGL device, by number or UUID (see ``gibson-sim doctor``); None = a GPU if one works, else software.
        library: name of the EGL library.
        loader: returns the mesh of a shape; None = reads the files.
        allowed_roots: folders that meshes and textures must lie in; None = the folders above those of the meshes.
        detail_px: largest error, pixels, of levels of detail in the image, in scenes of 50,000 triangles and more; 0 = draw every
            triangle.
        compress_textures: keep the textures of materials compressed (S3TC): an eighth of the memory, a quarter with alpha; colours
            change slightly.
        cull: leave out what is outside the image; off only to check that nothing else changes.
        cache: folder of loaded scenes for the next start (``render.cache.default_folder()``); None = none. Not used with a
            ``loader``.
        progress: called with the current stage of loading and its progress, 0 to 1.

    Raises:
        GraphicsUnavailableError: no device can draw.
    """

    def __init__(
        self,
        scene: DrawnScene | SceneSpec,
        *,
        device: int | str | None = None,
        library: str = LIBRARY,
        loader: Loader | None = None,
        allowed_roots: Sequence[Path] | None = None,
        detail_px: float = DETAIL_PX,
        compress_textures: bool = False,
        cull: bool = True,
        cache: Path | None = None,
        progress: Progress | None = None,
    ) -> None:
        self._context: GlContext | None = None
        self._scene: GlScene | None = None
        self._splats: SplatPass | None = None
        self._splats_of_scene: tuple[SplatsSpec | None, str] = None, ""
        """Where the splats come from: their specification, and the digest of the scene's files."""
        self._effects: EffectsPass | None = None
        self._shutter: Shutter | None = None
        self._hole_filling: HoleFilling | None = None
        self._pixel_buffers: PixelBuffers | None = None
        self._tensors: Tensors | None = None
        self._camera_images: CameraImages | None = None
        self._thread, self._process = threading.get_ident(), os.getpid()
        if isinstance(scene, SceneSpec):
            allowed_roots = scene_roots(scene) if allowed_roots is None else allowed_roots
            scene = drawn_scene(replace(scene, robots=(), bodies=()), ())
        self._loader, self._allowed_roots, self._cache = loader, allowed_roots, cache
        self._own_loader: MeshLoader | None = None
        self._detail_px, self._compress, self._cull = detail_px, compress_textures, cull
        self.warnings: tuple[str, ...] = ()
        """What the last load or update could not load and left out or replaced, one line each."""
        self.info: dict[str, Any] = {}
        """The device, and sizes of the scene."""
        try:
            self._context = open_context(device, library=library)
            self._readback = Readback(self._context)
            self._pixel_buffers = PixelBuffers(self._context)
            self._load(scene, progress)
        except BaseException:
            self.close()
            raise

    def _load(self, scene: DrawnScene, progress: Progress | None) -> None:
        """Loads a scene and replaces the current one, if any. No mesh that was read before is used: its file may have changed."""
        geometry = _loaded(scene, self._loader, self._allowed_roots, self._detail_px > 0.0, self._cache, progress)
        made = GlScene(
            self.context, geometry, scene.light, detail_px=self._detail_px, compress=self._compress, cull=self._cull
        )  # fmt: skip
        try:
            splats = self._splats_of(scene)
        except BaseException:
            made.close()
            raise
        for old in (self._camera_images, self._scene, self._splats if splats is not self._splats else None):
            if old is not None:
                old.close()
        self._own_loader = None
        self._splats, self._splats_of_scene = splats, (scene.splats, scene.content_hash)
        self._scene, self._camera_images = made, CameraImages(self.context, made, splats)
        self._composition = Composition(scene, geometry, self._loader_of, coarser=self._detail_px > 0.0)
        self._describe(scene, geometry, (*geometry.warnings, *made.warnings))

    def _splats_of(self, scene: DrawnScene) -> SplatPass | None:
        """Returns the splats of a scene: those of the current one, if they are the same."""
        spec = scene.splats
        if spec is None or (spec, scene.content_hash) == self._splats_of_scene:
            return None if spec is None else self._splats
        path = Path(spec.file)
        if self._allowed_roots is not None and not is_inside(path, self._allowed_roots):
            raise SceneError(f"{path}: lies outside the folders that are allowed: {', '.join(map(str, self._allowed_roots))}")
        T_world_file = matrix_from_pose(spec.pose)
        T_world_file[:3, :3] *= spec.scale
        return SplatPass(self.context, load_splats(path), T_world_file, cull=self._cull)

    def update(self, scene: DrawnScene, progress: Progress | None = None) -> bool:
        """Replaces the scene by another revision. A change of bodies costs little; any other change loads it anew, and returns True.

        ``warnings`` lists what could not be loaded.

        Args:
            scene: what to draw from now on; states must be of its revision.
            progress: as in the constructor, if it is loaded anew.

        Raises:
            RenderError: closed, or called from another thread.
            GibsonSimError: the scene cannot be drawn; the previous one stays.
        """
        self._check_usable()
        assert self._scene is not None
        self.context.make_current()
        change = self._composition.change(scene)
        if change is None:
            self._load(scene, progress)
            return True
        self._scene.update(change.geometry, change.same_vertices, change.same_indices)
        self._describe(scene, change.geometry, change.warnings)
        return False

    def _describe(self, scene: DrawnScene, geometry: SceneGeometry, warnings: tuple[str, ...]) -> None:
        assert self._scene is not None
        self._links, self._revision, self.warnings = tuple(scene.links), scene.revision, warnings
        self._link_rows = {name: row for row, name in enumerate(("", *self._links))}
        opened = self.context.device
        self.info = {
            "renderer": opened.renderer,
            "vendor": opened.vendor,
            "version": opened.version,
            "device": opened.index,
            "software": opened.software,
            "triangles": geometry.triangles,
            "batches": len(geometry.batches),
            "clusters": len(geometry.cluster_first),
            "textures": len(geometry.textures),
            "texture_mb": round(self._scene.texture_bytes / 1e6, 1),
        }

    def _loader_of(self, scene: DrawnScene) -> Loader:
        """Returns the loader for bodies that come later; it reads each file once."""
        if self._loader is not None:
            return self._loader
        roots = set(_roots(scene, self._allowed_roots))
        known = set(self._own_loader.roots or ()) if self._own_loader is not None else set()
        if self._own_loader is None or not roots <= known:
            self._own_loader = MeshLoader(sorted(roots | known))
        return self._own_loader.shape

    def render(self, state: SceneState, cameras: Sequence[CameraSpec], previous: SceneState | None = None) -> list[Frame]:
        """Returns one frame for each camera, with the stamp of the state; the arrays belong to the caller.

        Cameras with the same outputs are drawn side by side and read back at once.

        Args:
            state: poses of all links.
            cameras: what to draw.
            previous: the state before, for optical flow, motion blur and rolling shutters; None = nothing has moved.

        Raises:
            SceneMismatchError: a state belongs to another scene, or another revision of it.
            ConfigError: a camera is on a link that the scene does not have.
            RenderError: closed, called from another thread, or an image too large for the driver.
        """
        frames: dict[int, Frame] = {}
        for target, images, numbers in self.drawn(state, cameras, previous):
            frames.update(zip(numbers, self._readback.frames(target, images), strict=True))
        return [frames[k] for k in range(len(cameras))]

    def start(self, state: SceneState, cameras: Sequence[CameraSpec], previous: SceneState | None = None) -> PendingFrames:
        """Draws and returns at once: call ``result`` on the returned object after the next frames are started. For arguments see ``render``."""
        reads = []
        buffers, context = self._pixel_buffers, self.context
        assert buffers is not None
        for target, images, numbers in self.drawn(state, cameras, previous):
            reads.append((buffers.start(target, needed(target, images)), images, numbers))
        return PendingFrames(context, buffers, reads)

    def render_tensors(
        self, state: SceneState, cameras: Sequence[CameraSpec], previous: SceneState | None = None
    ) -> list[TensorFrame]:
        """Returns the frames as tensors: on the GPU that drew them if CUDA is available, else on the CPU. For arguments see ``render``."""
        tensors = self._tensors_of_context()
        if not tensors.on_gpu:
            return tensors.of_frames(self.render(state, cameras, previous))
        frames: dict[int, TensorFrame] = {}
        for target, images, numbers in self.drawn(state, cameras, previous):
            frames.update(zip(numbers, tensors.of_target(target, images), strict=True))
        return [frames[k] for k in range(len(cameras))]

    @property
    def drawn_triangles(self) -> int:
        """Number of triangles drawn in the last picture, or in the last pictures that were drawn side by side."""
        return 0 if self._scene is None else self._scene.drawn_triangles

    @property
    def drawn_splats(self) -> int:
        """Number of splats drawn in the last picture, or in the last pictures that were drawn side by side."""
        return 0 if self._splats is None else self._splats.drawn

    @property
    def tensors_on(self) -> str:
        """Device of the tensors of ``render_tensors``, as PyTorch names it: ``cuda:0``, or ``cpu``."""
        return self._tensors_of_context().device

    @property
    def context(self) -> GlContext:
        """The OpenGL context, for callers that read targets themselves."""
        if self._context is None:
            raise RenderError("the renderer is closed; make a new one")
        return self._context

    def _tensors_of_context(self) -> Tensors:
        if self._tensors is None:
            self.context.make_current()
            self._tensors = Tensors(self.context)
        return self._tensors

    def drawn(
        self, state: SceneState, cameras: Sequence[CameraSpec], previous: SceneState | None = None
    ) -> Iterator[tuple[RenderTarget, list[TargetImage], list[int]]]:
        """Draws, and yields each target with its images and the numbers of their cameras. Read it before advancing to the next one.

        For arguments and errors see ``render``.
        """
        self._check_usable()
        assert self._camera_images is not None and self._context is not None
        T_world_links = self._link_matrices(state)
        before = T_world_links if previous is None else self._link_matrices(previous)
        poses = [self._camera_matrix(camera, T_world_links) for camera in cameras]
        plans = [exposures(camera, previous, state) for camera in cameras]
        if self._splats is not None:
            self._check_fills(cameras)
        self._context.make_current()
        for group in self._camera_images.groups(cameras):
            target = self._camera_images.target(group.width, group.height, group.features)
            images = [
                TargetImage(cameras[k], state.stamp_ns, poses[k], x, y)
                for k, (x, y) in zip(group.numbers, group.places, strict=True)
            ]
            single = [
                image for k, image in zip(group.numbers, images, strict=True) if len(plans[k]) == 1 and plans[k][0].state is state
            ]
            self._draw(target, single, T_world_links, before)
            for k, image in zip(group.numbers, images, strict=True):
                self._develop(target, image, plans[k] if image not in single else (), before)
            yield target, images, list(group.numbers)

    def _check_usable(self) -> None:
        if self._camera_images is None or self._context is None:
            raise RenderError("the renderer is closed; make a new one")
        if os.getpid() != self._process:
            raise RenderError(
                "the renderer belongs to the process that was forked, and no drawing works after a fork: start processes by `spawn`, "
                "and make a renderer in each"
            )
        if threading.get_ident() != self._thread:
            raise RenderError("the renderer belongs to the thread that made it; draw there, or make one for each thread")

    def _draw(
        self, target: RenderTarget, images: Sequence[TargetImage], T_world_links: NDArray[np.float64], before: NDArray[np.float64]
    ) -> None:
        """Clears a target and draws images into it."""
        assert self._scene is not None
        assert self._camera_images is not None
        self._scene.set_links(T_world_links, before)
        still = before is T_world_links
        poses = [image.T_world_camera if still else self._camera_matrix(image.camera, before) for image in images]
        self._camera_images.draw(target, images, poses)

    def _develop(self, target: RenderTarget, image: TargetImage, plan: Sequence[Exposure], before: NDArray[np.float64]) -> None:
        """Finishes an image in place: draws it, if it has several exposures, and applies the effects on colours."""
        assert self._context is not None
        camera, average = image.camera, False
        changes = "rgb" in camera.outputs and changes_colors(camera.effects)
        if not plan and not changes:
            self._fill_holes(target, image)
            return
        if self._effects is None:
            self._effects = EffectsPass(self._context)
            self._shutter = Shutter(self._context, self._effects)
        if plan:
            assert self._shutter is not None

            def draw(picture: RenderTarget, rows: CameraSpec, state: SceneState) -> None:
                links = self._link_matrices(state)
                self._draw(picture, [TargetImage(rows, image.stamp_ns, self._camera_matrix(rows, links))], links, before)

            average = self._shutter.image(target, camera, plan, image.x, image.y, draw)
        # Noise lies over what is filled, too; an average of pictures is finished by the effects, and filled after them.
        if not average:
            self._fill_holes(target, image)
        if average or changes:
            self._effects.apply(camera, image.stamp_ns, target, image.x, image.y, average=average)
        if average:
            self._fill_holes(target, image)

    def _fill_holes(self, target: RenderTarget, image: TargetImage) -> None:
        if image.camera.fill:
            self._filling().fill(target, image)

    def _filling(self) -> HoleFilling:
        if self._hole_filling is None:
            self._hole_filling = HoleFilling(self.context)
        return self._hole_filling

    def prepare(self, cameras: Sequence[CameraSpec]) -> None:
        """Loads the networks that fill the holes of cameras' images, which else happens at the first image.

        Raises:
            ConfigError: a network cannot be loaded, or the scene has splats.
        """
        self._check_usable()
        if self._splats is not None:
            self._check_fills(cameras)
        for fill in {camera.fill for camera in cameras if camera.fill}:
            self._filling().prepare(fill)

    def _check_fills(self, cameras: Sequence[CameraSpec]) -> None:
        """Raises ConfigError where pictures of splats are to be filled: their colours are seen where the mesh has no depth."""
        for camera in cameras:
            if camera.fill:
                raise ConfigError(
                    f"camera {camera.name!r}: fill is {quoted(camera.fill)}, but this scene has splats, which show colours where its mesh has "
                    "holes; leave fill out"
                )

    def _link_matrices(self, state: SceneState) -> NDArray[np.float64]:
        """Returns T_world_links, (L + 1, 4, 4), the world first."""
        if state.revision != self._revision:
            raise SceneMismatchError(
                f"the state is of scene revision {state.revision}, revision {self._revision} is loaded; load the scene again"
            )
        if state.links != self._links:
            raise SceneMismatchError(
                f"the state has {len(state.links)} links, others than the {len(self._links)} of the scene that is loaded; load its scene"
            )
        return world_from_links(state.positions, state.quats_xyzw)

    def camera_matrix(self, state: SceneState, camera: CameraSpec) -> Mat4:
        """Returns T_world_camera, (4, 4), optical frame, at a state; for errors see ``render``."""
        return self._camera_matrix(camera, self._link_matrices(state))

    def _camera_matrix(self, camera: CameraSpec, T_world_links: NDArray[np.float64]) -> Mat4:
        """Returns T_world_camera, (4, 4)."""
        row = self._link_rows.get(camera.link)
        if row is None:
            known = ", ".join(self._links) or "none"
            raise ConfigError(f"camera {camera.name!r}: link {camera.link!r} is not in the scene; its links: {known}")
        T_world_camera: Mat4 = T_world_links[row] @ _T_link_camera(camera.pose)
        return T_world_camera

    def close(self) -> None:
        """Frees everything; a second call does nothing."""
        context = self._context
        handles = (
            self._camera_images, self._effects, self._shutter, self._pixel_buffers, self._tensors, self._splats, self._scene
        )  # fmt: skip
        self._context = self._scene = self._camera_images = self._effects = self._shutter = self._pixel_buffers = (
            self._tensors
        ) = self._splats = self._hole_filling = None
        if context is None:
            return
        try:
            context.make_current()
            for handle in handles:
                if handle is not None:
                    handle.close()
        finally:
            context.close()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


_T_link_camera: IdentityCache[Pose, Mat4] = IdentityCache(matrix_from_pose)
"""Returns T_link_camera, (4, 4), of the pose of a camera."""


def _loaded(
    scene: DrawnScene,
    loader: Loader | None,
    allowed_roots: Sequence[Path] | None,
    coarser: bool,
    folder: Path | None,
    progress: Progress | None,
) -> SceneGeometry:
    """Returns the geometry of a scene, from the cache if it is there."""
    labels, roots = scene.labels(), _roots(scene, allowed_roots)
    cache = SceneCache(folder) if folder is not None and loader is None else None
    path = cache.path(scene.visuals, scene.links, labels, coarser, roots) if cache is not None else None
    if cache is not None and path is not None:
        found = cache.load(path)
        if found is not None:
            return found
    load = loader or MeshLoader(roots).shape
    geometry = build_geometry(scene.visuals, scene.links, load, labels, coarser=coarser, progress=progress)
    if cache is not None and path is not None:
        cache.store(path, geometry)
    return geometry


def _roots(scene: DrawnScene, allowed_roots: Sequence[Path] | None) -> list[Path]:
    """Returns the folders that files may lie in: those above the meshes, since models have ``meshes/`` and ``materials/`` side by side."""
    if allowed_roots is not None:
        return list(allowed_roots)
    folders = mesh_folders(visual.shape for visual in scene.visuals)
    return sorted({f if f.parent == f.parent.parent else f.parent for f in folders})
