"""Non-pinhole cameras: resamples the image of a distorted pinhole, fisheye or equirectangular camera from its pinhole views.

The position of each pixel in the views is computed once per camera, in double precision, and stored as a table on the GPU.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import RenderError
from gibson_sim.geometry.distortion import valid_angle, valid_radius_squared
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.pinhole_views import PinholeView, lookup, tap_pixels, views_of
from gibson_sim.render.draw.screen_pass import ScreenPass
from gibson_sim.render.draw.target import FEATURES, Feature, RenderTarget
from gibson_sim.types import CameraSpec

_NOWHERE = -1.0


class Resampler:
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
        "u_reach": float(limit),
        "u_turn_px": float(camera.width) if camera.projection == "equirectangular" else 0.0,
    }
