"""Geometry and textures of a scene in GPU memory, updated incrementally when the scene changes.

``SceneMemory`` owns the buffers, vertex arrays and textures; ``upload_texture_with_mip_levels`` creates one texture with its mip levels.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.mesh import Filter, Sampling, TextureSource, Wrap
from gibson_sim.geometry.colours import linear_from_srgb, srgb8_from_linear
from gibson_sim.render.batching.scene_geometry import MATERIAL, PLACEMENT, VERTEX, SceneGeometry
from gibson_sim.render.context import gl as GL

Pixels = NDArray[np.uint8]

_VERTEX_ATTRIBUTES = (
    # location, number of components, type, normalised (None = integer attribute), field of VERTEX
    (0, 3, GL.FLOAT, 0, "position"),
    (1, 3, GL.SHORT, 1, "normal"),
    (2, 1, GL.UNSIGNED_SHORT, None, "material"),
    (3, 2, GL.FLOAT, 0, "uv"),
    (4, 1, GL.UNSIGNED_INT, None, "label"),
    (8, 4, GL.UNSIGNED_SHORT, 1, "uv"),  # vertices with colours store them instead of texture coordinates
)
_EXTRA_ATTRIBUTES = {"color": (9, 4), "light_uv": (10, 2)}
"""Location and number of components of the attributes of ``EXTRA_FIELDS``, normalised 16-bit integers."""
_PLACEMENT_ATTRIBUTES = ((5, "link"), (6, "label"), (7, "material"))
"""Location and field of ``PLACEMENT`` of the per-instance attributes."""
_WRAPS: dict[Wrap, int] = {"repeat": GL.REPEAT, "mirror": GL.MIRRORED_REPEAT, "clamp": GL.CLAMP_TO_EDGE}
_FILTERS: dict[tuple[Filter, Filter | None], int] = {
    ("nearest", None): GL.NEAREST,
    ("linear", None): GL.LINEAR,
    ("nearest", "nearest"): GL.NEAREST_MIPMAP_NEAREST,
    ("linear", "nearest"): GL.LINEAR_MIPMAP_NEAREST,
    ("nearest", "linear"): GL.NEAREST_MIPMAP_LINEAR,
    ("linear", "linear"): GL.LINEAR_MIPMAP_LINEAR,
}
"""Filter within a mip level and between levels -> OpenGL's."""
_ALPHA = (np.arange(256) / 255.0).astype(np.float32)
_LINEAR = linear_from_srgb(_ALPHA)
"""(256,), linear value of each sRGB byte."""


class SceneMemory:
    """Buffers, vertex arrays and textures of a scene; the context must be current in every call.

    Args:
        gl: OpenGL functions of the context.
        compress: store textures compressed.
    """

    def __init__(self, gl: GL.Gl, *, compress: bool) -> None:
        self._gl, self._compress = gl, compress
        self._sizes: dict[int, int] = {}
        self._texture_of: dict[int, tuple[int, int]] = {}
        self.textures: list[int] = []
        """OpenGL names, in the order of ``SceneGeometry.textures``."""
        self._arrays: list[int] = []
        self._dtype = VERTEX
        self._vertices, self._indices, self._occluders, self._sorted, self._placements = (self._buffer() for _ in range(5))
        self.materials, self.appearances = self._buffer(), self._buffer()
        self.array = self._array(self._indices)
        """Vertex array with the indices of the geometry."""
        self.occluder_array = self._array(self._occluders)
        """Vertex array with the indices of ``Occluders``."""
        self.sorted_array = self._array(self._sorted)
        """Vertex array with the indices sorted for each picture."""

    def _array(self, indices: int) -> int:
        """Creates a vertex array over the vertices, with the index buffer ``indices``."""
        gl = self._gl
        array = gl.create("glCreateVertexArrays")
        self._arrays.append(array)
        for location, numbers, kind, normalised, name in _VERTEX_ATTRIBUTES:
            offset = VERTEX.fields[name][1]  # type: ignore[index]
            if normalised is None:
                gl.glVertexArrayAttribIFormat(array, location, numbers, kind, offset)
            else:
                gl.glVertexArrayAttribFormat(array, location, numbers, kind, normalised, offset)
            gl.glVertexArrayAttribBinding(array, location, 0)
            gl.glEnableVertexArrayAttrib(array, location)
        # Per-instance attributes: each draw has one instance, and its base instance is the row of its placement.
        for location, name in _PLACEMENT_ATTRIBUTES:
            gl.glVertexArrayAttribIFormat(array, location, 1, GL.UNSIGNED_INT, PLACEMENT.fields[name][1])  # type: ignore[index]
            gl.glVertexArrayAttribBinding(array, location, 1)
            gl.glEnableVertexArrayAttrib(array, location)
        gl.glVertexArrayBindingDivisor(array, 1, 1)
        for location, _ in _EXTRA_ATTRIBUTES.values():
            gl.glVertexArrayAttribBinding(array, location, 0)
        gl.glVertexArrayVertexBuffer(array, 0, self._vertices, 0, VERTEX.itemsize)
        gl.glVertexArrayVertexBuffer(array, 1, self._placements, 0, PLACEMENT.itemsize)
        gl.glVertexArrayElementBuffer(array, indices)
        return array

    def load(self, geometry: SceneGeometry, same_vertices: int, same_indices: int) -> None:
        """Uploads a geometry.

        Args:
            geometry: new geometry.
            same_vertices: number of its leading vertices that are already uploaded.
            same_indices: number of its leading indices that are already uploaded.
        """
        if geometry.vertices.dtype != self._dtype:
            self._use_vertices_of(geometry.vertices.dtype)
            same_vertices = 0
        self._fill(self._vertices, geometry.vertices if len(geometry.vertices) else np.zeros(1, VERTEX), same_vertices)
        self._fill(self._indices, geometry.indices if len(geometry.indices) else np.zeros(1, np.uint32), same_indices)
        self._fill(self.materials, geometry.materials if len(geometry.materials) else np.zeros(1, MATERIAL))
        self._fill(self._placements, geometry.placements)
        if len(geometry.appearances):
            self._fill(self.appearances, geometry.appearances)
        self._load_textures(geometry.textures)

    def _use_vertices_of(self, dtype: np.dtype[np.void]) -> None:
        """Makes the vertex arrays read vertices with the fields of ``EXTRA_FIELDS`` that ``dtype`` has."""
        gl, self._dtype = self._gl, dtype
        for array in self._arrays:
            gl.glVertexArrayVertexBuffer(array, 0, self._vertices, 0, dtype.itemsize)
            for name, (location, numbers) in _EXTRA_ATTRIBUTES.items():
                if name in (dtype.names or ()):
                    offset = dtype.fields[name][1]  # type: ignore[index]
                    gl.glVertexArrayAttribFormat(array, location, numbers, GL.UNSIGNED_SHORT, 1, offset)
                    gl.glEnableVertexArrayAttrib(array, location)
                else:
                    gl.glDisableVertexArrayAttrib(array, location)

    def load_occluders(self, indices: NDArray[np.uint32]) -> None:
        """Uploads the indices of the occluders."""
        self._fill(self._occluders, indices if len(indices) else np.zeros(1, np.uint32))

    def load_sorted(self, indices: NDArray[np.uint32]) -> None:
        """Uploads the indices of translucent triangles sorted for the next pictures."""
        self._gl.glNamedBufferData(self._sorted, indices.nbytes, indices.ctypes.data, GL.STREAM_DRAW)

    def _buffer(self) -> int:
        buffer = self._gl.create("glCreateBuffers")
        self._sizes[buffer] = 0
        return buffer

    def _fill(self, buffer: int, data: NDArray[Any], same: int = 0) -> None:
        """Writes rows into a buffer that already has the first ``same`` rows; a buffer that grows gets spare capacity."""
        gl, data = self._gl, np.ascontiguousarray(data)
        if data.nbytes > self._sizes[buffer]:
            size = data.nbytes if not self._sizes[buffer] else data.nbytes * 3 // 2
            gl.glNamedBufferData(buffer, size, None, GL.STATIC_DRAW)
            self._sizes[buffer], same = size, 0
        rest = data[same:]
        if len(rest):
            gl.glNamedBufferSubData(buffer, same * data.itemsize, rest.nbytes, rest.ctypes.data)

    def _load_textures(self, sources: Sequence[TextureSource]) -> None:
        """Creates missing textures and frees unused ones."""
        needed = {id(source): source for source in sources}
        for unused in [key for key in self._texture_of if key not in needed]:
            self._gl.delete("glDeleteTextures", self._texture_of.pop(unused)[0])
        for key, source in needed.items():
            if key not in self._texture_of:
                self._texture_of[key] = upload_texture_with_mip_levels(self._gl, source.pixels, compress=self._compress)
                set_sampling(self._gl, self._texture_of[key][0], source.sampling)
        self.textures = [self._texture_of[id(source)][0] for source in sources]

    @property
    def texture_bytes(self) -> int:
        """GPU memory of the textures of materials, bytes."""
        return sum(size for _, size in self._texture_of.values())

    def close(self) -> None:
        """Frees all GPU resources; a second call does nothing."""
        textures, buffers = list(self._texture_of.values()), list(self._sizes)
        self._texture_of, self._sizes, self.textures = {}, {}, []
        for texture, _ in textures:
            self._gl.delete("glDeleteTextures", texture)
        for buffer in buffers:
            self._gl.delete("glDeleteBuffers", buffer)
        while self._arrays:
            self._gl.delete("glDeleteVertexArrays", self._arrays.pop())


def upload_texture_with_mip_levels(gl: GL.Gl, pixels: Pixels, *, compress: bool) -> tuple[int, int]:
    """Creates a texture with mip levels and returns it with its size in bytes.

    Args:
        gl: OpenGL functions; the context must be current.
        pixels: (H, W, 3) or (H, W, 4) uint8, sRGB, row 0 = top, at t = 0: v points down, as in MeshPart. Scaled down if larger than the
            driver's limit.
        compress: store the texture compressed.
    """
    pixels = _fit(pixels, gl.integer(GL.MAX_TEXTURE_SIZE))
    texture = gl.create("glCreateTextures", GL.TEXTURE_2D)
    gl.glPixelStorei(GL.UNPACK_ALIGNMENT, 1)
    size = _upload_compressed(gl, texture, pixels) if compress else _upload_uncompressed(gl, texture, pixels)
    gl.glTextureParameteri(texture, GL.TEXTURE_MIN_FILTER, GL.LINEAR_MIPMAP_LINEAR)
    gl.glTextureParameteri(texture, GL.TEXTURE_MAG_FILTER, GL.LINEAR)
    return texture, size


def set_sampling(gl: GL.Gl, texture: int, sampling: Sampling) -> None:
    """Sets how a texture with mip levels is read between and beyond its pixels."""
    gl.glTextureParameteri(texture, GL.TEXTURE_MAG_FILTER, _FILTERS[sampling.magnified, None])
    gl.glTextureParameteri(texture, GL.TEXTURE_MIN_FILTER, _FILTERS[sampling.minified, sampling.between_levels])
    gl.glTextureParameteri(texture, GL.TEXTURE_WRAP_S, _WRAPS[sampling.wrap_u])
    gl.glTextureParameteri(texture, GL.TEXTURE_WRAP_T, _WRAPS[sampling.wrap_v])


def _fit(pixels: Pixels, limit: int) -> Pixels:
    """Returns pixels scaled down to at most ``limit`` per side."""
    height, width = pixels.shape[:2]
    scale = limit / max(height, width)
    if scale < 1.0:
        size = (max(1, int(width * scale)), max(1, int(height * scale)))
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return np.ascontiguousarray(pixels)


def _upload_uncompressed(gl: GL.Gl, texture: int, pixels: Pixels) -> int:
    height, width = pixels.shape[:2]
    gl.glTextureStorage2D(texture, max(width, height).bit_length(), GL.SRGB8_ALPHA8, width, height)
    gl.glTextureSubImage2D(texture, 0, 0, 0, width, height, _format(pixels), GL.UNSIGNED_BYTE, pixels.ctypes.data)
    gl.glGenerateTextureMipmap(texture)
    size: int = width * height * 4 * 4 // 3
    return size


def _upload_compressed(gl: GL.Gl, texture: int, pixels: Pixels) -> int:
    """Uploads mip levels computed in linear light, which the driver compresses; drivers do not generate mip levels of compressed textures."""
    kind = GL.COMPRESSED_SRGB_S3TC_DXT1 if pixels.shape[2] == 3 else GL.COMPRESSED_SRGB_ALPHA_S3TC_DXT5
    gl.glBindTexture(GL.TEXTURE_2D, texture)
    total, level, size = 0, 0, ctypes.c_int(0)
    while True:
        height, width = pixels.shape[:2]
        gl.glTexImage2D(GL.TEXTURE_2D, level, kind, width, height, 0, _format(pixels), GL.UNSIGNED_BYTE, pixels.ctypes.data)
        gl.glGetTextureLevelParameteriv(texture, level, GL.TEXTURE_COMPRESSED_IMAGE_SIZE, ctypes.byref(size))
        total += size.value
        if max(width, height) == 1:
            return total
        pixels = _next_mip_level(pixels)
        level += 1


def _format(pixels: Pixels) -> int:
    return GL.RGB if pixels.shape[2] == 3 else GL.RGBA


def _next_mip_level(pixels: Pixels) -> Pixels:
    """Returns the pixels at half the size, averaged in linear light."""
    height, width = pixels.shape[:2]
    linear = cv2.LUT(pixels, np.stack([_LINEAR] * 3 + [_ALPHA], axis=-1)[None, :, : pixels.shape[2]])
    smaller = cv2.resize(linear, (max(width // 2, 1), max(height // 2, 1)), interpolation=cv2.INTER_AREA)
    half = srgb8_from_linear(smaller)
    half[..., 3:] = np.rint(smaller[..., 3:] * 255.0)
    return half
