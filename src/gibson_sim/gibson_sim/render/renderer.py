"""The renderer: (SceneState, CameraSpecs) -> Frames. Depends on OpenGL, not on ROS or physics."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.config import DETAIL_PX
from gibson_sim.errors import ConfigError, GibsonSimError, RenderError, SceneError, SceneMismatchError
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
from gibson_sim.render.draw.shutter import Shutter
from gibson_sim.render.draw.splats import SplatPass
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.render.filling.hole_filling import HoleFilling, hole_filling_of
from gibson_sim.render.readback.frames import Readback, TargetImage, needed
from gibson_sim.render.readback.pixel_buffers import PendingFrames, PixelBuffers
from gibson_sim.render.readback.tensors import TensorFrame, Tensors
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import DrawnScene, SceneSpec, SplatsSpec, drawn_scene
from gibson_sim.types import CameraSpec, Frame, Pose, SceneState

ReadTarget = Callable[[RenderTarget, list[TargetImage], list[int]], None]
"""Reads a target: its images, and the index of the camera of each."""


@dataclass(frozen=True, slots=True)
class MeshFiles:
    """Meshes are read from their files."""

    allowed_roots: Sequence[Path] | None = None
    """Folders that meshes and textures must lie in; None = the parents of the meshes' folders, or those of a ``SceneSpec``."""
    cache: Path | None = None
    """Folder of the scene cache (``render.cache.default_folder()``); None = no cache."""


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """Device of a renderer, and how it draws."""

    device: int | str | None = None
    """EGL device, by number or UUID (see ``gibson-sim doctor``); None = the first GPU that works, else software."""
    library: str = LIBRARY
    """Name of the EGL library."""
    detail_px: float = DETAIL_PX
    """Largest screen-space error of levels of detail, pixels, in scenes of 50,000 triangles or more; 0 = draw every triangle."""
    compress_textures: bool = False
    """Store the textures of materials compressed (S3TC): an eighth of the memory, a quarter with alpha; colours change slightly."""
    cull: bool = True
    """View-frustum and occlusion culling; False only to verify that culling changes no image."""
    share_targets: bool = True
    """Draw cameras with the same outputs side by side into one target, which is faster for small images. The position in the target changes
    the driver's rounding: False = the bits of an image do not depend on the cameras drawn with it."""


class Renderer:
    """Renders a scene. One thread creates, uses and closes it; several renderers may exist at once.

    Textures are filtered in linear light. Unlit materials keep their colours, others are lit by the lights of the scene. Masked
    materials are opaque where alpha reaches the cutoff. Blended materials are opaque, with a depth, where alpha is at least 0.9;
    elsewhere they tint the background, whose depth is reported.

    Args:
        scene: a scene from ``load_scene``, drawn without its robots and bodies, or a scene with links (``drawn_scene``).
        meshes: files to read meshes from, or a function that returns the mesh of a shape.
        options: device, and how to draw.
        progress: called with the current stage of loading and its progress, 0 to 1.

    Raises:
        GraphicsUnavailableError: no device can draw.
    """

    def __init__(
        self,
        scene: DrawnScene | SceneSpec,
        meshes: MeshFiles | Loader = MeshFiles(),
        options: RenderOptions = RenderOptions(),
        *,
        progress: Progress | None = None,
    ) -> None:
        self._context: GlContext | None = None
        self._scene: GlScene | None = None
        self._splats: SplatPass | None = None
        self._splats_of_scene: tuple[SplatsSpec | None, str] = None, ""
        """Source of the splats: their specification, and the digest of the scene's files."""
        self._effects: EffectsPass | None = None
        self._shutter: Shutter | None = None
        self._hole_filling: HoleFilling | None = None
        self._pixel_buffers: PixelBuffers | None = None
        self._tensors: Tensors | None = None
        self._camera_images: CameraImages | None = None
        self._thread, self._process = threading.get_ident(), os.getpid()
        files = meshes if isinstance(meshes, MeshFiles) else MeshFiles()
        self._loader: Loader | None = None if isinstance(meshes, MeshFiles) else meshes
        self._allowed_roots, self._cache = files.allowed_roots, files.cache
        if isinstance(scene, SceneSpec):
            self._allowed_roots = scene_roots(scene) if self._allowed_roots is None else self._allowed_roots
            scene = drawn_scene(replace(scene, robots=(), bodies=()), ())
        self._mesh_loader: MeshLoader | None = None
        self._options = options
        self.warnings: tuple[str, ...] = ()
        """One line for each item that the last load or update could not load, and omitted or replaced."""
        self.info: dict[str, Any] = {}
        """Properties of the device, and sizes of the scene."""
        try:
            self._context = open_context(options.device, library=options.library)
            self._readback = Readback(self._context)
            self._pixel_buffers = PixelBuffers(self._context)
            self._load(scene, progress)
        except BaseException:
            self.close()
            raise

    def _load(self, scene: DrawnScene, progress: Progress | None) -> None:
        """Loads a scene and replaces the current one, if any. Reads all meshes again: their files may have changed."""
        options = self._options
        geometry = _load_geometry(scene, self._loader, self._allowed_roots, options.detail_px > 0.0, self._cache, progress)
        gl_scene = GlScene(
            self.context, geometry, scene.light, detail_px=options.detail_px, compress=options.compress_textures, cull=options.cull
        )  # fmt: skip
        try:
            splats = self._splats_of(scene)
        except BaseException:
            gl_scene.close()
            raise
        for old in (self._camera_images, self._scene, self._splats if splats is not self._splats else None):
            if old is not None:
                old.close()
        self._mesh_loader = None
        self._splats, self._splats_of_scene = splats, (scene.splats, scene.content_hash)
        self._scene = gl_scene
        self._camera_images = CameraImages(self.context, gl_scene, splats, share_targets=options.share_targets)
        self._composition = Composition(scene, geometry, self._loader_of, levels_of_detail=options.detail_px > 0.0)
        self._describe(scene, geometry, (*geometry.warnings, *gl_scene.warnings))

    def _splats_of(self, scene: DrawnScene) -> SplatPass | None:
        """Returns the splats of a scene; reuses those of the current scene if they are the same."""
        spec = scene.splats
        if spec is None or (spec, scene.content_hash) == self._splats_of_scene:
            return None if spec is None else self._splats
        path = Path(spec.file)
        if self._allowed_roots is not None and not is_inside(path, self._allowed_roots):
            raise SceneError(f"{path}: lies outside the allowed folders: {', '.join(map(str, self._allowed_roots))}")
        T_world_file = matrix_from_pose(spec.pose)
        T_world_file[:3, :3] *= spec.scale
        return SplatPass(self.context, load_splats(path), T_world_file, cull=self._options.cull)

    def update(self, scene: DrawnScene, progress: Progress | None = None) -> bool:
        """Replaces the scene by another revision and sets ``warnings``.

        A change of bodies is cheap; any other change reloads the scene.

        Args:
            scene: the new revision; later states must have its revision number.
            progress: as in the constructor, if the scene is reloaded.

        Returns:
            Whether the scene was reloaded.

        Raises:
            RenderError: the renderer is closed, or another thread calls it.
            GibsonSimError: the scene cannot be drawn; the previous revision is kept.
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
        """Returns the loader for bodies added after loading; it reads each file once."""
        if self._loader is not None:
            return self._loader
        roots = set(_roots(scene, self._allowed_roots))
        known = set(self._mesh_loader.roots or ()) if self._mesh_loader is not None else set()
        if self._mesh_loader is None or not roots <= known:
            self._mesh_loader = MeshLoader(sorted(roots | known))
        return self._mesh_loader.shape

    def render(self, state: SceneState, cameras: Sequence[CameraSpec], previous: SceneState | None = None) -> list[Frame]:
        """Returns one frame for each camera, with the stamp of the state; the arrays belong to the caller.

        Cameras with the same outputs are drawn side by side into one target and read back together, unless ``share_targets`` is False.

        Args:
            state: poses of all links.
            cameras: cameras to render.
            previous: the previous state, for optical flow, motion blur and rolling shutters; None = no motion.

        Raises:
            SceneMismatchError: a state belongs to another scene or another revision.
            ConfigError: the link of a camera is not in the scene.
            RenderError: the renderer is closed, another thread calls it, or an image is too large for the driver.
        """
        frames: dict[int, Frame] = {}

        def read(target: RenderTarget, images: list[TargetImage], numbers: list[int]) -> None:
            frames.update(zip(numbers, self._readback.frames(target, images), strict=True))

        self.draw(state, cameras, previous, read)
        return [frames[k] for k in range(len(cameras))]

    def start(self, state: SceneState, cameras: Sequence[CameraSpec], previous: SceneState | None = None) -> PendingFrames:
        """Starts rendering and reading back, without waiting. For arguments see ``render``.

        Call ``result`` on the returned object after starting the next frames, so that both overlap.
        """
        reads = []
        buffers, context = self._pixel_buffers, self.context
        assert buffers is not None

        def read(target: RenderTarget, images: list[TargetImage], numbers: list[int]) -> None:
            reads.append((buffers.start(target, needed(target, images)), images, numbers))

        try:
            self.draw(state, cameras, previous, read)
        except GibsonSimError:
            PendingFrames(context, buffers, reads).discard()
            raise
        return PendingFrames(context, buffers, reads)

    def render_tensors(
        self, state: SceneState, cameras: Sequence[CameraSpec], previous: SceneState | None = None
    ) -> list[TensorFrame]:
        """Returns the frames as tensors: on the rendering GPU if CUDA is available, else on the CPU. For arguments see ``render``."""
        tensors = self._tensors_of_context()
        if not tensors.on_gpu:
            return tensors.of_frames(self.render(state, cameras, previous))
        frames: dict[int, TensorFrame] = {}

        def read(target: RenderTarget, images: list[TargetImage], numbers: list[int]) -> None:
            frames.update(zip(numbers, tensors.of_target(target, images), strict=True))

        self.draw(state, cameras, previous, read)
        return [frames[k] for k in range(len(cameras))]

    @property
    def drawn_triangles(self) -> int:
        """Number of triangles drawn for the last image, or for the last images that share a target."""
        return 0 if self._scene is None else self._scene.drawn_triangles

    @property
    def drawn_splats(self) -> int:
        """Number of splats drawn for the last image, or for the last images that share a target."""
        return 0 if self._splats is None else self._splats.drawn

    @property
    def tensors_on(self) -> str:
        """Device of the tensors of ``render_tensors``, in PyTorch's notation: ``cuda:0`` or ``cpu``."""
        return self._tensors_of_context().device

    @property
    def context(self) -> GlContext:
        """OpenGL context, for callers that read targets themselves."""
        if self._context is None:
            raise RenderError("the renderer is closed; create a new one")
        return self._context

    def _tensors_of_context(self) -> Tensors:
        if self._tensors is None:
            self.context.make_current()
            self._tensors = Tensors(self.context)
        return self._tensors

    def draw(self, state: SceneState, cameras: Sequence[CameraSpec], previous: SceneState | None, read: ReadTarget) -> None:
        """Renders, and calls ``read`` with each target while it holds its images. For other arguments and errors see ``render``."""
        self._check_usable()
        assert self._camera_images is not None and self._context is not None
        T_world_links = self._link_matrices(state)
        T_previous = T_world_links if previous is None else self._link_matrices(previous)
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
            self._draw(target, single, T_world_links, T_previous)
            for k, image in zip(group.numbers, images, strict=True):
                self._finish_image(target, image, plans[k] if image not in single else (), T_previous)
            read(target, images, list(group.numbers))

    def _check_usable(self) -> None:
        if self._camera_images is None or self._context is None:
            raise RenderError("the renderer is closed; create a new one")
        if os.getpid() != self._process:
            raise RenderError(
                "the renderer belongs to the process that was forked, and OpenGL does not work after a fork: start processes with "
                "`spawn`, and create a renderer in each"
            )
        if threading.get_ident() != self._thread:
            raise RenderError(
                "the renderer belongs to the thread that created it; render in that thread, or create one per thread"
            )

    def _draw(
        self,
        target: RenderTarget,
        images: Sequence[TargetImage],
        T_world_links: NDArray[np.float64],
        T_previous: NDArray[np.float64],
    ) -> None:
        """Clears a target and draws images into it; ``T_previous`` is T_world_links, (L + 1, 4, 4), of the previous state."""
        assert self._scene is not None
        assert self._camera_images is not None
        self._scene.set_links(T_world_links, T_previous)
        still = T_previous is T_world_links
        poses = [image.T_world_camera if still else self._camera_matrix(image.camera, T_previous) for image in images]
        self._camera_images.draw(target, images, poses)

    def _finish_image(
        self, target: RenderTarget, image: TargetImage, plan: Sequence[Exposure], T_previous: NDArray[np.float64]
    ) -> None:
        """Finishes an image in place: draws it if it has several exposures, fills holes and applies the colour effects."""
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
                self._draw(picture, [TargetImage(rows, image.stamp_ns, self._camera_matrix(rows, links))], links, T_previous)

            average = self._shutter.image(target, camera, plan, image.x, image.y, draw)
        # Holes are filled before the effects, so that filled pixels get noise too; an averaged image exists only after the effects.
        if not average:
            self._fill_holes(target, image)
        if average or changes:
            self._effects.apply(camera, image.stamp_ns, target, image.x, image.y, average=average)
        if average and camera.fill:
            self._filling().fill(target, image, self._effects.average)

    def _fill_holes(self, target: RenderTarget, image: TargetImage) -> None:
        if image.camera.fill:
            self._filling().fill(target, image)

    def _filling(self) -> HoleFilling:
        if self._hole_filling is None:
            self._hole_filling = hole_filling_of(self.context)
        return self._hole_filling

    def prepare(self, cameras: Sequence[CameraSpec]) -> None:
        """Loads the hole-filling networks of cameras, which otherwise load at the first image.

        Raises:
            ConfigError: a network cannot be loaded, or the scene has splats.
        """
        self._check_usable()
        if self._splats is not None:
            self._check_fills(cameras)
        self.context.make_current()
        for fill in {camera.fill for camera in cameras if camera.fill}:
            self._filling().prepare(fill)

    def _check_fills(self, cameras: Sequence[CameraSpec]) -> None:
        """Raises ConfigError if a camera fills holes in a scene with splats, which have colours where the mesh has no depth."""
        for camera in cameras:
            if camera.fill:
                raise ConfigError(
                    f"camera {camera.name!r}: fill is {quoted(camera.fill)}, but this scene has splats, which show colours where its mesh has "
                    "holes; leave fill out"
                )

    def _link_matrices(self, state: SceneState) -> NDArray[np.float64]:
        """Returns T_world_links, (L + 1, 4, 4), of the world and the links of a state."""
        if state.revision != self._revision:
            raise SceneMismatchError(
                f"the state has scene revision {state.revision}, but revision {self._revision} is loaded; load the scene again"
            )
        if state.links != self._links:
            raise SceneMismatchError(
                f"the {len(state.links)} links of the state are not the {len(self._links)} of the loaded scene; load the state's scene"
            )
        return world_from_links(state.positions, state.quats_xyzw)

    def camera_matrix(self, state: SceneState, camera: CameraSpec) -> Mat4:
        """Returns T_world_camera, (4, 4), optical frame, in a state; for errors see ``render``."""
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
        """Frees all GPU resources; a second call does nothing."""
        context = self._context
        handles = (
            self._camera_images, self._effects, self._shutter, self._hole_filling, self._pixel_buffers, self._tensors, self._splats,
            self._scene,
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


def _load_geometry(
    scene: DrawnScene,
    loader: Loader | None,
    allowed_roots: Sequence[Path] | None,
    levels_of_detail: bool,
    folder: Path | None,
    progress: Progress | None,
) -> SceneGeometry:
    """Returns the geometry of a scene, from the cache in ``folder`` if it has it."""
    labels, roots = scene.labels(), _roots(scene, allowed_roots)
    cache = SceneCache(folder) if folder is not None and loader is None else None
    path = cache.path(scene.visuals, scene.links, labels, levels_of_detail, roots) if cache is not None else None
    if cache is not None and path is not None:
        cached = cache.load(path)
        if cached is not None:
            return cached
    load = loader or MeshLoader(roots).shape
    geometry = build_geometry(scene.visuals, scene.links, load, labels, levels_of_detail=levels_of_detail, progress=progress)
    if cache is not None and path is not None:
        cache.store(path, geometry)
    return geometry


def _roots(scene: DrawnScene, allowed_roots: Sequence[Path] | None) -> list[Path]:
    """Returns the folders that files may lie in: the parents of the meshes' folders, since models keep ``meshes/`` beside ``materials/``."""
    if allowed_roots is not None:
        return list(allowed_roots)
    folders = mesh_folders(visual.shape for visual in scene.visuals)
    return sorted({f if f.parent == f.parent.parent else f.parent for f in folders})
