"""Material maps, the textures of roughness, normals, occlusion and emission, and the images of patterns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.render.batching.scene_geometry import SceneGeometry
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.scene_memory import set_sampling

_FIRST_UNIT, _PATTERNS = 1, 8
_NEUTRAL = ((255, 255, 255), (128, 128, 255), (255, 255, 255), (255, 255, 255))
"""Neutral texels of metallic-roughness, normals, occlusion and emission."""
_EMISSION = 3


class MaterialMaps:
    """The material maps and patterns of a scene on the GPU.

    Args:
        context: it must be current in every call.
        geometry: geometry of the scene.
    """

    def __init__(self, context: GlContext, geometry: SceneGeometry) -> None:
        self._gl = GL.Gl(context)
        self.bytes = 0
        self._textures: dict[tuple[int, bool], int] = {}
        self._neutral: dict[int, int] = {}
        self._pattern = 0
        try:
            self._sets = [[self._of(source, k) for k, source in enumerate(maps)] for maps in geometry.map_sets]
            if len(geometry.patterns):
                self._pattern = self._layers(geometry.patterns)
        except BaseException:
            self.close()
            raise

    def _of(self, source: Any, kind: int) -> int:
        """Returns the texture of an image, or a neutral one for None."""
        if source is None:
            if kind not in self._neutral:
                self._neutral[kind] = self._texture(np.array([[_NEUTRAL[kind]]], dtype=np.uint8), False)
            return self._neutral[kind]
        key = (id(source), kind == _EMISSION)
        if key not in self._textures:
            self._textures[key] = self._texture(source.pixels, kind == _EMISSION)
            set_sampling(self._gl, self._textures[key], source.sampling)
        return self._textures[key]

    def _texture(self, pixels: NDArray[np.uint8], srgb: bool) -> int:
        gl = self._gl
        height, width, channels = pixels.shape
        pixels = np.ascontiguousarray(pixels)
        texture = gl.create("glCreateTextures", GL.TEXTURE_2D)
        gl.glTextureStorage2D(texture, max(width, height).bit_length(), GL.SRGB8_ALPHA8 if srgb else GL.RGBA8, width, height)
        gl.glPixelStorei(GL.UNPACK_ALIGNMENT, 1)
        pixel_format = GL.RGB if channels == 3 else GL.RGBA
        gl.glTextureSubImage2D(texture, 0, 0, 0, width, height, pixel_format, GL.UNSIGNED_BYTE, pixels.ctypes.data)
        self._finish(texture, width * height)
        return texture

    def _layers(self, pictures: NDArray[np.uint8]) -> int:
        gl = self._gl
        layers, height, width, _ = pictures.shape
        pictures = np.ascontiguousarray(pictures)
        texture = gl.create("glCreateTextures", GL.TEXTURE_2D_ARRAY)
        gl.glTextureStorage3D(texture, max(width, height).bit_length(), GL.SRGB8_ALPHA8, width, height, layers)
        gl.glPixelStorei(GL.UNPACK_ALIGNMENT, 1)
        gl.glTextureSubImage3D(texture, 0, 0, 0, 0, width, height, layers, GL.RGB, GL.UNSIGNED_BYTE, pictures.ctypes.data)
        self._finish(texture, width * height * layers)
        return texture

    def _finish(self, texture: int, pixels: int) -> None:
        self._gl.glGenerateTextureMipmap(texture)
        self._gl.glTextureParameteri(texture, GL.TEXTURE_MIN_FILTER, GL.LINEAR_MIPMAP_LINEAR)
        self._gl.glTextureParameteri(texture, GL.TEXTURE_MAG_FILTER, GL.LINEAR)
        self.bytes += pixels * 4 * 4 // 3

    def bind(self) -> None:
        """Binds the patterns to their texture unit."""
        if self._pattern:
            self._gl.glBindTextureUnit(_PATTERNS, self._pattern)
            self._gl.glBindSampler(_PATTERNS, 0)

    def bind_maps(self, number: int) -> None:
        """Binds one of ``SceneGeometry.map_sets`` to the texture units of material maps."""
        for unit, texture in enumerate(self._sets[number], _FIRST_UNIT):
            self._gl.glBindTextureUnit(unit, texture)
            self._gl.glBindSampler(unit, 0)

    def close(self) -> None:
        """Frees the textures; a second call does nothing."""
        textures = [*self._textures.values(), *self._neutral.values(), *([self._pattern] if self._pattern else [])]
        self._textures, self._neutral, self._pattern = {}, {}, 0
        for texture in textures:
            self._gl.delete("glDeleteTextures", texture)
