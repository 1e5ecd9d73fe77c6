"""Render targets: a colour image, a depth image and optional features of the same size, all as textures.

Features are further colour attachments of the same framebuffer, written in the same pass, and present only if requested.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Literal

from gibson_sim.errors import RenderError
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.types import CameraSpec, Output

Feature = Literal["LABELS", "NORMALS", "FLOW"]
"""A feature, named like its macro in the shaders."""
FEATURES: tuple[Feature, ...] = ("LABELS", "NORMALS", "FLOW")
ATTACHMENT: dict[str, int] = {"color": 0, "LABELS": 1, "NORMALS": 2, "FLOW": 3}
"""Index of the colour attachment of each output."""
FORMATS: dict[str, int] = {
    "color": GL.SRGB8_ALPHA8,
    "depth": GL.DEPTH_COMPONENT32F,
    "LABELS": GL.RG16UI,
    "NORMALS": GL.RGBA16,  # 16-bit normalised: finer than half floats near 1, and half the size of single floats
    "FLOW": GL.RG32F,
}
"""OpenGL internal format of each texture."""


def features_of(outputs: Sequence[Output], *, filled: bool = False) -> tuple[Feature, ...]:
    """Returns the features required by outputs; hole filling (``filled``) needs normals, whose alpha channel marks holes."""
    needed = {
        "LABELS": bool({"semantic", "instance"} & set(outputs)),
        "NORMALS": filled or bool({"normal", "normal_world", "hole"} & set(outputs)),
        "FLOW": "flow" in outputs,
    }
    return tuple(feature for feature in FEATURES if needed[feature])


def draws_colors(camera: CameraSpec) -> bool:
    """Returns whether colours must be drawn for a camera: they are an output, or a network needs them to fill depth."""
    by_network = camera.fill_depth and camera.fill != "push_pull" and bool({"depth", "position"} & set(camera.outputs))
    return "rgb" in camera.outputs or by_network


class RenderTarget:
    """A framebuffer whose attachments are textures; ModernGL has neither sRGB renderbuffers nor 32-bit float depth.

    Args:
        context: it must be current in every call.
        width: width, pixels.
        height: height, pixels.
        features: outputs in addition to colour and depth.
        samples: samples per pixel of all attachments; above 1 the textures are multisampled.

    Raises:
        RenderError: the driver does not support the size or the number of samples.
    """

    def __init__(self, context: GlContext, width: int, height: int, features: tuple[Feature, ...] = (), samples: int = 1) -> None:
        self.width, self.height, self.features, self.samples = width, height, features, samples
        self.textures: dict[str, int] = {}
        """OpenGL names of the textures "color", "depth" and each feature."""
        self.framebuffer = 0
        self.color_framebuffer = 0
        """Framebuffer with only the colour attachment."""
        self._depth_framebuffer = self._geometry_framebuffer = 0  # only depth; all but colour
        self._framebuffers: list[int] = []
        self._gl = GL.Gl(context)
        driver = context.device.renderer
        limit, max_samples = self._gl.integer(GL.MAX_TEXTURE_SIZE), self._gl.integer(GL.MAX_SAMPLES)
        if max(width, height) > limit:
            raise RenderError(f"image size is {width}x{height}, {driver} draws at most {limit} pixels a side")
        if samples > max_samples:
            raise RenderError(f"{samples} samples a pixel are requested, {driver} draws at most {max_samples}; request fewer")
        try:
            self._create()
        except BaseException:
            self.close()
            raise

    def _create(self) -> None:
        gl = self._gl
        gl.glGetError()
        for name in ("color", "depth", *self.features):
            self.textures[name] = self._texture(FORMATS[name])
        self.framebuffer = self._framebuffer(*self.textures)
        self.color_framebuffer = self._framebuffer("color")
        self._depth_framebuffer = self._framebuffer("depth")
        self._geometry_framebuffer = self._framebuffer("depth", *self.features)
        status = gl.glCheckNamedFramebufferStatus(self.framebuffer, GL.FRAMEBUFFER)
        if status != GL.FRAMEBUFFER_COMPLETE or gl.glGetError():
            raise RenderError(
                f"the driver cannot draw an image of {self.width}x{self.height} pixels with {self.samples} samples "
                f"(status 0x{status:x}); choose a smaller one"
            )

    def _framebuffer(self, *names: str) -> int:
        """Returns a framebuffer of some of the textures."""
        gl = self._gl
        framebuffer = gl.create("glCreateFramebuffers")
        self._framebuffers.append(framebuffer)
        for name in names:
            point = GL.DEPTH_ATTACHMENT if name == "depth" else GL.COLOR_ATTACHMENT0 + ATTACHMENT[name]
            gl.glNamedFramebufferTexture(framebuffer, point, self.textures[name], 0)
        drawn = [GL.COLOR_ATTACHMENT0 + n if name in names else 0 for name, n in ATTACHMENT.items()]
        gl.glNamedFramebufferDrawBuffers(framebuffer, len(drawn), (ctypes.c_uint * len(drawn))(*drawn))
        return framebuffer

    def _texture(self, internal_format: int) -> int:
        gl = self._gl
        if self.samples > 1:
            texture = gl.create("glCreateTextures", GL.TEXTURE_2D_MULTISAMPLE)
            gl.glTextureStorage2DMultisample(texture, self.samples, internal_format, self.width, self.height, 1)
            return texture
        texture = gl.create("glCreateTextures", GL.TEXTURE_2D)
        gl.glTextureStorage2D(texture, 1, internal_format, self.width, self.height)
        for name in (GL.TEXTURE_MIN_FILTER, GL.TEXTURE_MAG_FILTER):
            gl.glTextureParameteri(texture, name, GL.NEAREST)
        for name in (GL.TEXTURE_WRAP_S, GL.TEXTURE_WRAP_T):
            gl.glTextureParameteri(texture, name, GL.CLAMP_TO_EDGE)
        return texture

    def use(self, *, color: bool = True) -> None:
        """Binds the framebuffer, with or without the colour attachment, and sets the viewport to the whole target."""
        self._use(self.framebuffer if color else self._geometry_framebuffer)

    def use_depth(self) -> None:
        """Binds the framebuffer with only the depth attachment, and sets the viewport to the whole target."""
        self._use(self._depth_framebuffer)

    def _use(self, framebuffer: int) -> None:
        self._gl.glBindFramebuffer(GL.FRAMEBUFFER, framebuffer)
        self._gl.glViewport(0, 0, self.width, self.height)

    def close(self) -> None:
        """Frees the GPU resources; a second call does nothing. The context must be current."""
        while self._framebuffers:
            self._gl.delete("glDeleteFramebuffers", self._framebuffers.pop())
        self.framebuffer = self.color_framebuffer = self._depth_framebuffer = self._geometry_framebuffer = 0
        for texture in self.textures.values():
            self._gl.delete("glDeleteTextures", texture)
        self.textures = {}
