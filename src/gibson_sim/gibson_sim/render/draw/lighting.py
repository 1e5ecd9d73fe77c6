"""The lights of a scene on the GPU: uniforms, image-based lighting, and the sky."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.environment import irradiance, load_environment, reflectance, reflections
from gibson_sim.render.draw.screen_pass import shader_text
from gibson_sim.render.draw.target import ATTACHMENT, Feature
from gibson_sim.scenes.spec import LightSpec, PointLight

MAX_POINTS = 16
"""Maximum number of point lights: each takes time in every pixel."""
F32 = NDArray[np.float32]
_BINDING = 1
"""Binding of the uniform block ``Light``."""
_REFLECTIONS, _REFLECTANCE = 5, 7
_SHADOW_AT = 44  # offset in floats: after two vectors and the nine irradiance vectors


class Lighting:
    """Lighting of a scene on the GPU.

    Args:
        context: it must be current in every call.
        light: lighting and background.
        glossy: whether any material has specular highlights.

    Raises:
        SceneError: the environment image cannot be read or is not equirectangular.
    """

    def __init__(self, context: GlContext, light: LightSpec, *, glossy: bool) -> None:
        self._gl = GL.Gl(context)
        self._textures: dict[int, int] = {}
        self._buffer = 0
        self._sky: Sky | None = None
        self.warnings: tuple[str, ...] = ()
        """One line for each omitted group of lights."""
        points = light.points[:MAX_POINTS]
        if len(points) < len(light.points):
            self.warnings = (f"the scene has {len(light.points)} lamps; the first {MAX_POINTS} are drawn",)
        self.defines: tuple[str, ...] = tuple(
            name
            for name, on in (
                (f"POINT_LIGHTS {len(points)}", bool(points)), ("ENVIRONMENT", bool(light.environment)), ("SHADOWS", light.shadows),
            )
            if on
        )  # fmt: skip
        """Preprocessor macros of every program that computes lighting."""
        self.background = np.array([*linear_from_srgb(light.background), 1.0], dtype=np.float32)
        """Linear colour and alpha of the background."""
        try:
            image = _image(light)
            self._uniforms = _uniforms(light, points, image)
            self._buffer = self._gl.create("glCreateBuffers")
            self._upload()
            if image is not None and glossy:
                self._textures[_REFLECTIONS] = self._layers(reflections(image))
            if glossy:
                self._textures[_REFLECTANCE] = self._table(reflectance())
            if light.backdrop:
                self._sky = Sky(context, load_environment(Path(light.backdrop)))
            elif image is not None and light.environment_visible:
                self._sky = Sky(context, image)
        except BaseException:
            self.close()
            raise

    def bind(self) -> None:
        """Binds the uniform buffer and the textures."""
        self._gl.glBindBufferBase(GL.UNIFORM_BUFFER, _BINDING, self._buffer)
        for unit, texture in self._textures.items():
            self._gl.glBindTextureUnit(unit, texture)
            self._gl.glBindSampler(unit, 0)

    def set_shadow(self, shadow_from_world: Mat4, texel: float, size: int) -> None:
        """Sets the shadow map.

        Args:
            shadow_from_world: (4, 4), to texture coordinates and depth.
            texel: size of a texel, metres.
            size: side of the map, texels.
        """
        values = np.array([*shadow_from_world.T.ravel(), texel, 0.5 / size], dtype=np.float32)
        part = slice(_SHADOW_AT, _SHADOW_AT + len(values))
        if not np.array_equal(self._uniforms[part], values):
            self._uniforms[part] = values
            self._upload()

    @property
    def has_sky(self) -> bool:
        """Whether the scene has a sky."""
        return self._sky is not None

    def draw_sky(self, features: tuple[Feature, ...]) -> None:
        """Draws the sky into pixels without depth, if the scene has one; the view and the viewport must be set."""
        if self._sky is not None:
            self._sky.draw(features)

    def _upload(self) -> None:
        self._gl.glNamedBufferData(self._buffer, self._uniforms.nbytes, self._uniforms.ctypes.data, GL.STATIC_DRAW)

    def _layers(self, images: NDArray[np.float16]) -> int:
        gl = self._gl
        layers, height, width, _ = images.shape
        texture = gl.create("glCreateTextures", GL.TEXTURE_2D_ARRAY)
        gl.glTextureStorage3D(texture, 1, GL.RGB16F, width, height, layers)
        images = np.ascontiguousarray(images)
        gl.glPixelStorei(GL.UNPACK_ALIGNMENT, 1)
        gl.glTextureSubImage3D(texture, 0, 0, 0, 0, width, height, layers, GL.RGB, GL.HALF_FLOAT, images.ctypes.data)
        _set_linear_filter(gl, texture)
        return texture

    def _table(self, table: NDArray[np.float16]) -> int:
        texture = self._gl.create("glCreateTextures", GL.TEXTURE_2D)
        _fill(self._gl, texture, table, GL.RG16F, GL.RG)
        return texture

    def close(self) -> None:
        """Frees the GPU resources; a second call does nothing."""
        textures, self._textures = self._textures, {}
        for texture in textures.values():
            self._gl.delete("glDeleteTextures", texture)
        if self._buffer:
            self._gl.delete("glDeleteBuffers", self._buffer)
            self._buffer = 0
        if self._sky is not None:
            self._sky.close()
            self._sky = None


class Sky:
    """An environment image drawn as the background.

    Args:
        context: it must be current in every call.
        image: equirectangular, (H, 2 H, 3) float32, linear, in the world frame.
    """

    def __init__(self, context: GlContext, image: F32) -> None:
        self._gl = GL.Gl(context)
        self._texture = self._gl.create("glCreateTextures", GL.TEXTURE_2D)
        _fill(self._gl, self._texture, image.astype(np.float16), GL.RGB16F, GL.RGB)
        self._program = context.gl.program(
            vertex_shader=shader_text("sky.vert", includes=("view.glsl",)), fragment_shader=shader_text("sky.frag")
        )
        self._array = context.gl.vertex_array(self._program, [])

    def draw(self, features: tuple[Feature, ...]) -> None:
        """Fills the colours of pixels without depth; other outputs are unchanged."""
        gl = self._gl
        for feature in features:
            gl.glColorMaski(ATTACHMENT[feature], 0, 0, 0, 0)
        gl.glDepthMask(0)
        gl.glDepthFunc(GL.GEQUAL)
        gl.glBindTextureUnit(0, self._texture)
        gl.glBindSampler(0, 0)
        gl.glUseProgram(self._program.glo)
        gl.glBindVertexArray(self._array.glo)
        gl.glDrawArrays(GL.TRIANGLES, 0, 3)
        gl.glDepthFunc(GL.GREATER)
        gl.glDepthMask(1)
        for feature in features:
            gl.glColorMaski(ATTACHMENT[feature], 1, 1, 1, 1)

    def close(self) -> None:
        """Frees the GPU resources; a second call does nothing."""
        if self._texture:
            self._gl.delete("glDeleteTextures", self._texture)
            self._texture = 0
            self._array.release()
            self._program.release()


def _image(light: LightSpec) -> F32 | None:
    """Returns the environment image in the world frame, scaled by its strength, or None if the scene has none."""
    if not light.environment:
        return None
    image = load_environment(Path(light.environment)) * np.float32(light.environment_strength)
    # Left in the image is counter-clockwise, so a positive yaw rolls columns to the left.
    columns = light.environment_yaw / (2.0 * math.pi) * image.shape[1]
    whole = math.floor(columns)
    fraction = np.float32(columns - whole)
    rotated = np.roll(image, -whole, axis=1) * (1 - fraction) + np.roll(image, -whole - 1, axis=1) * fraction
    return np.ascontiguousarray(rotated, dtype=np.float32)


def _uniforms(light: LightSpec, points: tuple[PointLight, ...], image: F32 | None) -> F32:
    """Returns the content of the uniform block ``Light``."""
    rows = np.zeros((16 + 4 * len(points), 4), dtype=np.float32)
    rows[0, :3] = -_unit(light.sun_direction)
    rows[1] = (*(linear_from_srgb(light.sun_color) * light.sun), light.ambient)
    if image is not None:
        rows[2:11, :3] = irradiance(image)
    for k, point in enumerate(points):
        rows[16 + 4 * k : 20 + 4 * k] = _lamp(point)
    return rows.ravel()


def _lamp(point: PointLight) -> list[tuple[float, ...]]:
    scale, offset = 0.0, 1.0
    if point.outer_angle < math.pi:
        inner, outer = math.cos(min(point.inner_angle, point.outer_angle)), math.cos(point.outer_angle)
        scale = 1.0 / max(inner - outer, 1e-3)
        offset = -outer * scale
    color = linear_from_srgb(point.color) * point.strength
    return [
        (*point.position, point.range**-4.0 if point.range > 0.0 else 0.0),
        (*color, scale),
        (*point.attenuation, offset),
        (*_unit(point.direction).tolist(), 0.0),
    ]


def _unit(vector: Any) -> NDArray[np.float64]:
    v = np.asarray(vector, dtype=np.float64)
    return np.asarray(v / max(float(np.linalg.norm(v)), 1e-12))


def _fill(gl: GL.Gl, texture: int, pixels: NDArray[Any], internal_format: int, channels: int) -> None:
    """Allocates a texture with one level and uploads half floats, (H, W, C)."""
    height, width = pixels.shape[:2]
    pixels = np.ascontiguousarray(pixels)
    gl.glTextureStorage2D(texture, 1, internal_format, width, height)
    gl.glPixelStorei(GL.UNPACK_ALIGNMENT, 1)
    gl.glTextureSubImage2D(texture, 0, 0, 0, width, height, channels, GL.HALF_FLOAT, pixels.ctypes.data)
    _set_linear_filter(gl, texture)


def _set_linear_filter(gl: GL.Gl, texture: int) -> None:
    for name, value in (
        (GL.TEXTURE_MIN_FILTER, GL.LINEAR), (GL.TEXTURE_MAG_FILTER, GL.LINEAR),
        (GL.TEXTURE_WRAP_S, GL.CLAMP_TO_EDGE), (GL.TEXTURE_WRAP_T, GL.CLAMP_TO_EDGE),
    ):  # fmt: skip
        gl.glTextureParameteri(texture, name, value)
