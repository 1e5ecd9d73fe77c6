"""Light maps of a scene on the GPU: radiances with a shared exponent, 4 bytes a texel."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from gibson_sim.formats.light_maps import radiance_of
from gibson_sim.render.batching.scene_geometry import LightMap
from gibson_sim.render.context import GlContext, gl as GL

_UNIT = 9
_ROWS = 256
"""Number of rows that are converted to radiances at once."""


class LightMaps:
    """The light maps of a scene on the GPU.

    Args:
        context: it must be current in every call.
        light_maps: ``SceneGeometry.light_maps``.
        strength: factor on their radiances.
    """

    def __init__(self, context: GlContext, light_maps: Sequence[LightMap], strength: float) -> None:
        self._gl = GL.Gl(context)
        self._textures: list[int] = []
        self.bytes = 0
        """GPU memory, bytes."""
        try:
            for light_map in light_maps:
                self._add(light_map, strength)
        except BaseException:
            self.close()
            raise

    def _add(self, light_map: LightMap, strength: float) -> None:
        """Uploads a light map, scaled down if larger than the driver's limit."""
        gl, (source, intensity) = self._gl, light_map
        pixels, limit = source.pixels, gl.integer(GL.MAX_TEXTURE_SIZE)
        scale = limit / max(pixels.shape[:2])
        if scale < 1.0:
            size = (max(1, int(pixels.shape[1] * scale)), max(1, int(pixels.shape[0] * scale)))
            pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint16)
        height, width = pixels.shape[:2]
        texture = gl.create("glCreateTextures", GL.TEXTURE_2D)
        self._textures.append(texture)
        # Of the formats tried on llvmpipe, the fastest whose error is below 1 / 255 in sRGB; docs/renderer.md has the figures.
        gl.glTextureStorage2D(texture, 1, GL.RGB9_E5, width, height)
        gl.glPixelStorei(GL.UNPACK_ALIGNMENT, 1)
        for row in range(0, height, _ROWS):
            strip = np.ascontiguousarray(radiance_of(pixels[row : row + _ROWS], intensity * strength))
            gl.glTextureSubImage2D(texture, 0, 0, row, width, len(strip), GL.RGB, GL.FLOAT, strip.ctypes.data)
        for name, value in (
            (GL.TEXTURE_MIN_FILTER, GL.LINEAR), (GL.TEXTURE_MAG_FILTER, GL.LINEAR),
            (GL.TEXTURE_WRAP_S, GL.CLAMP_TO_EDGE), (GL.TEXTURE_WRAP_T, GL.CLAMP_TO_EDGE),
        ):  # fmt: skip
            gl.glTextureParameteri(texture, name, value)
        self.bytes += 4 * width * height

    def bind(self, number: int) -> None:
        """Binds one of the light maps to its texture unit."""
        self._gl.glBindTextureUnit(_UNIT, self._textures[number])
        self._gl.glBindSampler(_UNIT, 0)

    def close(self) -> None:
        """Frees the textures; a second call does nothing."""
        textures, self._textures = self._textures, []
        for texture in textures:
            self._gl.delete("glDeleteTextures", texture)
