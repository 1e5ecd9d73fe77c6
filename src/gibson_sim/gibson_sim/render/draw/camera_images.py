"""Draws camera images into targets: plain pinhole cameras directly, other cameras from pinhole views, with multisample anti-aliasing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from gibson_sim.errors import RenderError
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.culling.draw_plan import PinholePicture
from gibson_sim.render.draw.gl_scene import GlScene
from gibson_sim.render.draw.grouping import CameraGroup, CameraGrouping, IdentityCache, arrange
from gibson_sim.render.draw.pinhole_views import PinholeView, is_plain, views_of
from gibson_sim.render.draw.resample import Resampler
from gibson_sim.render.draw.splats import SplatPass
from gibson_sim.render.draw.target import Feature, RenderTarget, draws_colors
from gibson_sim.render.readback.frames import TargetImage
from gibson_sim.types import CameraSpec, Pose

_intrinsics = IdentityCache(CameraSpec.intrinsics)
_is_plain = IdentityCache(is_plain)
_MAX_TARGETS = 12
_MAX_RESAMPLERS = 32


class CameraImages:
    """Draws camera images into targets of one context; it must be current in every call.

    Args:
        context: context of the scene.
        scene: the scene to draw.
        splats: splats to draw over it; None = no splats.
        share_targets: see ``Renderer``.
    """

    def __init__(
        self, context: GlContext, scene: GlScene, splats: SplatPass | None = None, *, share_targets: bool = True
    ) -> None:
        self._context, self._scene, self._splats, self._gl = context, scene, splats, GL.Gl(context)
        self._targets: dict[tuple[int, int, tuple[Feature, ...], int, str], RenderTarget] = {}
        self._resamplers: dict[tuple[CameraSpec, tuple[tuple[int, int], ...]], Resampler] = {}
        self._largest = self._gl.integer(GL.MAX_TEXTURE_SIZE)
        grouping = CameraGrouping(self._largest, share=share_targets)
        self.groups: Callable[[Sequence[CameraSpec]], tuple[CameraGroup, ...]] = grouping.of
        """Returns the groups of cameras; each group is drawn into one target."""

    def target(self, width: int, height: int, features: tuple[Feature, ...], samples: int = 1, use: str = "") -> RenderTarget:
        """Returns a cached target; ``use`` distinguishes targets in use at the same time."""
        key = (width, height, features, samples, use)
        cached = self._targets.pop(key, None)
        if cached is None:
            if len(self._targets) >= _MAX_TARGETS:
                self._targets.pop(next(iter(self._targets))).close()  # the least recently used
            cached = RenderTarget(self._context, width, height, features, samples)
        self._targets[key] = cached
        return cached

    def draw(self, target: RenderTarget, images: Sequence[TargetImage], previous: Sequence[Mat4]) -> None:
        """Clears a target and draws images into it; the link poses of the scene must be set.

        Args:
            target: target with one sample per pixel and the features of all cameras.
            images: the images; all cameras have the same number of samples.
            previous: T_world_camera of each image in the previous state.
        """
        plain = [_picture(image, pose) for image, pose in zip(images, previous, strict=True) if _is_plain(image.camera)]
        color = any(draws_colors(image.camera) for image in images)
        samples = max((image.camera.samples for image in images), default=1)
        non_pinhole = [(image, pose) for image, pose in zip(images, previous, strict=True) if not _is_plain(image.camera)]
        if color and samples > 1 and plain:
            # Labels and depth are sampled at pixel centres, bit-identical with and without multisampling of colours.
            self._scene.draw(target, plain, color=False)
            multisampled = self.target(target.width, target.height, (), samples)
            self._scene.draw(multisampled, plain, moving_later=self._splats is not None)
            self._resolve(multisampled, target)
        else:
            self._scene.draw(target, plain, color=color, moving_later=self._splats is not None)
        if color and self._splats is not None:
            # One sample per pixel is enough: splats have soft edges.
            self._splats.draw(self._scene, target, plain)
            self._scene.draw_moving_translucent(target)
        if non_pinhole:
            self._draw_non_pinhole(target, non_pinhole, color)

    def _draw_non_pinhole(self, target: RenderTarget, images: Sequence[tuple[TargetImage, Mat4]], color: bool) -> None:
        """Draws the views of non-pinhole cameras side by side, in one target if they fit, and resamples the images from them."""
        views = [views_of(image.camera) for image, _ in images]
        sizes = [(view.width, view.height) for group in views for view in group]
        arranged = arrange(sizes, self._largest)
        if len(arranged) > 1:
            if len(images) == 1:
                camera = images[0][0].camera
                raise RenderError(
                    f"camera {camera.name!r}: a {camera.projection} image of {camera.width}x{camera.height} is resampled from views that "
                    f"exceed the driver's limit of {self._largest} pixels per side; choose a smaller image"
                )
            for one in images:
                self._draw_non_pinhole(target, [one], color)
            return
        numbers, tiles = arranged[0]
        place = dict(zip(numbers, tiles.places, strict=True))
        source = self.target(tiles.width, tiles.height, target.features, use="views")
        pictures, first = [], 0
        for (image, previous), group in zip(images, views, strict=True):
            pictures += [_view_picture(image, view, previous, place[first + k]) for k, view in enumerate(group)]
            first += len(group)
        self._scene.draw(source, pictures, color=color, moving_later=self._splats is not None)
        if color and self._splats is not None:
            self._splats.draw(self._scene, source, pictures)
            self._scene.draw_moving_translucent(source)
        first = 0
        for (image, _), group in zip(images, views, strict=True):
            places = tuple(place[first + k] for k in range(len(group)))
            self._resampler(image.camera, places).run(source, target, image.x, image.y)
            first += len(group)

    def _resampler(self, camera: CameraSpec, places: tuple[tuple[int, int], ...]) -> Resampler:
        key = (replace(camera, name="", link="", pose=Pose()), places)
        cached = self._resamplers.pop(key, None)
        if cached is None:
            if len(self._resamplers) >= _MAX_RESAMPLERS:
                self._resamplers.pop(next(iter(self._resamplers))).close()
            cached = Resampler(self._context, camera, places)
        self._resamplers[key] = cached
        return cached

    def _resolve(self, multisampled: RenderTarget, target: RenderTarget) -> None:
        """Averages the samples, in linear light, into the colours of a target."""
        gl = self._gl
        gl.glEnable(GL.FRAMEBUFFER_SRGB)
        width, height = target.width, target.height
        gl.glBlitNamedFramebuffer(
            multisampled.framebuffer,
            target.color_framebuffer,
            0,
            0,
            width,
            height,
            0,
            0,
            width,
            height,
            GL.COLOR_BUFFER_BIT,
            GL.NEAREST,
        )

    def close(self) -> None:
        """Frees all GPU resources; a second call does nothing."""
        targets, resamplers = self._targets, self._resamplers
        self._targets, self._resamplers = {}, {}
        for target in targets.values():
            target.close()
        for resampler in resamplers.values():
            resampler.close()


def _picture(image: TargetImage, previous: Mat4) -> PinholePicture:
    camera = image.camera
    return PinholePicture(
        image.T_world_camera, _intrinsics(camera), camera.width, camera.height, camera.near, image.x, image.y, previous
    )


def _view_picture(image: TargetImage, view: PinholeView, previous: Mat4, place: tuple[int, int]) -> PinholePicture:
    T_camera_view = np.eye(4)
    T_camera_view[:3, :3] = view.R_camera_view
    return PinholePicture(
        image.T_world_camera @ T_camera_view,
        view.intrinsics,
        view.width,
        view.height,
        image.camera.near,
        *place,
        previous @ T_camera_view,
    )
