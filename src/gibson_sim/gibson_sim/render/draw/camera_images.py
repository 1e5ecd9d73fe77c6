"""Draws camera images into targets: plain pinholes directly, non-pinhole cameras from pinhole views, smooth edges from multisampling."""

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
        context: of the scene.
        scene: what to draw.
        splats: what to draw over it; None = nothing.
    """

    def __init__(self, context: GlContext, scene: GlScene, splats: SplatPass | None = None) -> None:
        self._context, self._scene, self._splats, self._gl = context, scene, splats, GL.Gl(context)
        self._targets: dict[tuple[int, int, tuple[Feature, ...], int, str], RenderTarget] = {}
        self._resamplers: dict[tuple[CameraSpec, tuple[tuple[int, int], ...]], Resampler] = {}
        self._largest = self._gl.integer(GL.MAX_TEXTURE_SIZE)
        self.groups: Callable[[Sequence[CameraSpec]], tuple[CameraGroup, ...]] = CameraGrouping(self._largest).of
        """Returns the groups of cameras that are drawn into one target each."""

    def target(self, width: int, height: int, features: tuple[Feature, ...], samples: int = 1, use: str = "") -> RenderTarget:
        """Returns a cached target; ``use`` distinguishes targets that are needed at the same time."""
        key = (width, height, features, samples, use)
        found = self._targets.pop(key, None)
        if found is None:
            if len(self._targets) >= _MAX_TARGETS:
                self._targets.pop(next(iter(self._targets))).close()  # the least recently used
            found = RenderTarget(self._context, width, height, features, samples)
        self._targets[key] = found
        return found

    def draw(self, target: RenderTarget, images: Sequence[TargetImage], before: Sequence[Mat4]) -> None:
        """Clears a target and draws images into it; the link poses of the scene must be set.

        Args:
            target: with one sample a pixel and the features of all cameras.
            images: the images; all cameras have the same number of samples.
            before: T_world_camera of each at the state before.
        """
        plain = [_picture(image, pose) for image, pose in zip(images, before, strict=True) if _is_plain(image.camera)]
        color = any(draws_colors(image.camera) for image in images)
        samples = max((image.camera.samples for image in images), default=1)
        non_pinhole = [(image, pose) for image, pose in zip(images, before, strict=True) if not _is_plain(image.camera)]
        if color and samples > 1 and plain:
            # Labels and depth are those of the pixel's centre, to the bit, with and without multisampling of colours.
            self._scene.draw(target, plain, color=False)
            smooth = self.target(target.width, target.height, (), samples)
            self._scene.draw(smooth, plain, moving_later=self._splats is not None)
            self._resolve(smooth, target)
        else:
            self._scene.draw(target, plain, color=color, moving_later=self._splats is not None)
        if color and self._splats is not None:
            # With one sample a pixel: splats have soft edges.
            self._splats.draw(self._scene, target, plain)
            self._scene.draw_moving_translucent(target)
        if non_pinhole:
            self._draw_non_pinhole(target, non_pinhole, color)

    def _draw_non_pinhole(self, target: RenderTarget, images: Sequence[tuple[TargetImage, Mat4]], color: bool) -> None:
        """Draws the views of non-pinhole cameras side by side, all at once if they fit, and resamples the images from them."""
        views = [views_of(image.camera) for image, _ in images]
        sizes = [(view.width, view.height) for group in views for view in group]
        arranged = arrange(sizes, self._largest)
        if len(arranged) > 1:
            if len(images) == 1:
                camera = images[0][0].camera
                raise RenderError(
                    f"camera {camera.name!r}: a {camera.projection} image of {camera.width}x{camera.height} is made from views that do not "
                    f"fit into the {self._largest} pixels a side that can be drawn here; choose a smaller one"
                )
            for one in images:
                self._draw_non_pinhole(target, [one], color)
            return
        numbers, tiles = arranged[0]
        place = dict(zip(numbers, tiles.places, strict=True))
        source = self.target(tiles.width, tiles.height, target.features, use="views")
        pictures, first = [], 0
        for (image, before), group in zip(images, views, strict=True):
            pictures += [_view_picture(image, view, before, place[first + k]) for k, view in enumerate(group)]
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
        found = self._resamplers.pop(key, None)
        if found is None:
            if len(self._resamplers) >= _MAX_RESAMPLERS:
                self._resamplers.pop(next(iter(self._resamplers))).close()
            found = Resampler(self._context, camera, places)
        self._resamplers[key] = found
        return found

    def _resolve(self, smooth: RenderTarget, target: RenderTarget) -> None:
        """Writes the mean of the samples, in linear light, to the colours of a target."""
        gl = self._gl
        gl.glEnable(GL.FRAMEBUFFER_SRGB)
        width, height = target.width, target.height
        gl.glBlitNamedFramebuffer(
            smooth.framebuffer,
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
        """Frees everything; a second call does nothing."""
        targets, resamplers = self._targets, self._resamplers
        self._targets, self._resamplers = {}, {}
        for target in targets.values():
            target.close()
        for resampler in resamplers.values():
            resampler.close()


def _picture(image: TargetImage, before: Mat4) -> PinholePicture:
    camera = image.camera
    return PinholePicture(
        image.T_world_camera, _intrinsics(camera), camera.width, camera.height, camera.near, image.x, image.y, before
    )


def _view_picture(image: TargetImage, view: PinholeView, before: Mat4, place: tuple[int, int]) -> PinholePicture:
    T_camera_view = np.eye(4)
    T_camera_view[:3, :3] = view.R_camera_view
    return PinholePicture(
        image.T_world_camera @ T_camera_view,
        view.intrinsics,
        view.width,
        view.height,
        image.camera.near,
        *place,
        before @ T_camera_view,
    )
