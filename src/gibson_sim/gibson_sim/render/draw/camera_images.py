"""Draws camera images into targets: plain pinhole cameras directly, other cameras from pinhole views, with multisample anti-aliasing.

The image of a distorted pinhole, fisheye or equirectangular camera is resampled from its pinhole views. The position of each pixel in the views
is computed once per camera, in double precision, and stored as a table on the GPU.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import RenderError
from gibson_sim.geometry.distortion import valid_angle, valid_radius_squared
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.culling.draw_plan import PinholePicture
from gibson_sim.render.draw.gl_scene import GlScene
from gibson_sim.render.draw.grouping import CameraGroup, CameraGrouping, IdentityCache, arrange
from gibson_sim.render.draw.pinhole_views import PinholeView, is_plain, lookup, tap_pixels, views_of
from gibson_sim.render.draw.screen_pass import ScreenPass
from gibson_sim.render.draw.splats import SplatPass
from gibson_sim.render.draw.target import FEATURES, Feature, RenderTarget, draws_colors
from gibson_sim.render.readback.frames import TargetImage
from gibson_sim.types import CameraSpec, Pose

_intrinsics = IdentityCache(CameraSpec.intrinsics)
_is_plain = IdentityCache(is_plain)
_MAX_TARGETS = 12
_MAX_RESAMPLERS = 32
_NOWHERE = -1.0


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
        self._resamplers: dict[tuple[CameraSpec, tuple[tuple[int, int], ...]], _Resampler] = {}
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

    def _resampler(self, camera: CameraSpec, places: tuple[tuple[int, int], ...]) -> _Resampler:
        key = (replace(camera, name="", link="", pose=Pose()), places)
        cached = self._resamplers.pop(key, None)
        if cached is None:
            if len(self._resamplers) >= _MAX_RESAMPLERS:
                self._resamplers.pop(next(iter(self._resamplers))).close()
            cached = _Resampler(self._context, camera, places)
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


class _Resampler:
    """Resamples images of one camera from its views, drawn into tiles of a source target.

    Colours are interpolated from four texels in linear light (from sixteen, at four positions in the pixel, if the camera has 4 samples).
    Labels and normals are those of the nearest texel, at most half a pixel away. Depth and flow are extrapolated from the nearest texel
    along its surface: depth is exact on planes, and within a millimetre on a ball of 1 m at a distance of 5 m.

    Args:
        context: it must be current in every call.
        camera: camera whose optics, size and number of samples are used.
        places: (left column, top row) in the source of each of ``views_of(camera)``.

    Raises:
        ConfigError: the camera cannot be resampled from views.
    """

    def __init__(self, context: GlContext, camera: CameraSpec, places: Sequence[tuple[int, int]]) -> None:
        self._context, self._gl = context, GL.Gl(context)
        self._views = views_of(camera)
        self._places = tuple(places)
        assert len(self._places) == len(self._views)
        self._size = (camera.width, camera.height)
        self._projection = camera.projection
        self._passes: dict[tuple[Feature, ...], ScreenPass] = {}
        self._uniforms = _uniforms(camera, self._views, self._places)
        self._map: moderngl.Texture | None = None
        self._taps: moderngl.Texture | None = None
        gl = context.gl
        v, u = np.mgrid[: camera.height, : camera.width]
        number, place, scale = self._lookup(camera, np.stack([u, v], axis=-1))
        table = np.concatenate([place, scale[..., None], np.maximum(number, 0)[..., None]], axis=-1)
        self._map = gl.texture(self._size, 4, table.astype(np.float32).tobytes(), dtype="f4")
        if camera.samples > 1:
            _, place, _ = self._lookup(camera, tap_pixels(camera))
            self._taps = gl.texture((place.shape[1], place.shape[0]), 2, place.astype(np.float32).tobytes(), dtype="f4")

    def _lookup(
        self, camera: CameraSpec, pixels: NDArray[Any]
    ) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
        """Returns ``pinhole_views.lookup`` with positions in the source, in OpenGL's convention: texel centres at half-integers."""
        number, place, scale = lookup(camera, self._views, pixels)
        corners = np.array(self._places, dtype=np.float64)
        place = np.where(number[..., None] >= 0, place + corners[number] + 0.5, _NOWHERE)
        return number, place, scale

    def run(self, source: RenderTarget, out: RenderTarget, x: int = 0, y: int = 0) -> None:
        """Fills the camera's rectangle of ``out``, with all of its features; the source must have them too.

        Args:
            source: target with the views at their places, one sample per pixel; normals in each view's optical frame, flow in its pixels.
            out: a target other than the source.
            x: left column of the image in ``out``.
            y: top row of the image in ``out``.

        Raises:
            RenderError: the resampler is closed.
        """
        if self._map is None:
            raise RenderError("the resampler is closed; create a new one")
        assert source.samples == 1 and out is not source
        # In a fixed order, so that targets with equal features share a pass.
        features = tuple(f for f in FEATURES if f in out.features)
        tables = [self._map.glo] if self._taps is None else [self._map.glo, self._taps.glo]
        textures = [*tables, *(source.textures[name] for name in ("color", "depth", *features))]
        self._gl.glScissor(x, y, *self._size)
        self._gl.glEnable(GL.SCISSOR_TEST)
        self._pass(features).run(out, textures, {**self._uniforms, "u_origin": (x, y)})
        self._gl.glDisable(GL.SCISSOR_TEST)

    def _pass(self, features: tuple[Feature, ...]) -> ScreenPass:
        """Returns the pass for the given features, compiled at first use."""
        if features not in self._passes:
            taps = self._taps is not None
            samplers = ["u_map", *(["u_taps"] if taps else []), "u_color", "u_depth", *(f"u_{f.lower()}" for f in features)]
            defines = [f"TILES {len(self._views)}", self._projection.upper(), *(["TAPS 2"] if taps else []), *features]
            self._passes[features] = ScreenPass(self._context, "resample.frag", samplers, defines)
        return self._passes[features]

    def close(self) -> None:
        """Frees the GPU resources; a second call does nothing. The context must be current."""
        passes, self._passes = self._passes, {}
        for screen_pass in passes.values():
            screen_pass.close()
        for texture in (self._map, self._taps):
            if texture is not None:
                texture.release()
        self._map = self._taps = None


def _uniforms(camera: CameraSpec, views: Sequence[PinholeView], places: Sequence[tuple[int, int]]) -> dict[str, Any]:
    """Returns the uniforms for rotating normals and projecting flow; matrices are column-major."""
    rays = []
    for view, (x, y) in zip(views, places, strict=True):
        from_source = np.array([[1.0, 0.0, -x - 0.5], [0.0, 1.0, -y - 0.5], [0.0, 0.0, 1.0]])
        rays.append((view.R_camera_view @ np.linalg.inv(view.intrinsics) @ from_source).T)
    d = camera.distortion
    if camera.projection == "pinhole":
        limit = min(valid_radius_squared(d), 1e30) if any(d) else 1e30
    else:
        limit = valid_angle(d) if camera.projection == "fisheye" else 0.0
    return {
        "u_turn": np.array([view.R_camera_view.T for view in views], dtype=np.float32),
        "u_ray": np.array(rays, dtype=np.float32),
        "u_k": camera.intrinsics().T.astype(np.float32),
        "u_d": np.array((*d, *(0.0,) * 8)[: 8 if camera.projection == "pinhole" else 4], dtype=np.float32),
        "u_limit": float(limit),
        "u_turn_px": float(camera.width) if camera.projection == "equirectangular" else 0.0,
    }
