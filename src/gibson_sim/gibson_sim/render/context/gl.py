"""OpenGL functions and constants that ModernGL lacks, typed for ctypes, loaded once for each context."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

from gibson_sim.render.context import GlContext

_U, _I, _F, _P, _B = ctypes.c_uint, ctypes.c_int, ctypes.c_float, ctypes.c_void_p, ctypes.c_ubyte
_N = ctypes.c_ssize_t
_PROTOTYPES: dict[str, tuple[Any, ...]] = {
    "glBindBufferBase": (None, _U, _U, _U),
    "glBindBufferRange": (None, _U, _U, _U, _N, _N),
    "glBindBuffer": (None, _U, _U),
    "glBindFramebuffer": (None, _U, _U),
    "glBindImageTexture": (None, _U, _U, _I, _B, _I, _U, _U),
    "glBindSampler": (None, _U, _U),
    "glBindTextureUnit": (None, _U, _U),
    "glBindVertexArray": (None, _U),
    "glBlendFunc": (None, _U, _U),
    "glBlitNamedFramebuffer": (None, _U, _U, _I, _I, _I, _I, _I, _I, _I, _I, _U, _U),
    "glCheckNamedFramebufferStatus": (_U, _U, _U),
    "glClearBufferfv": (None, _U, _I, _P),
    "glClearBufferuiv": (None, _U, _I, _P),
    "glClientWaitSync": (_U, _P, _U, ctypes.c_uint64),
    "glClipControl": (None, _U, _U),
    "glColorMaski": (None, _U, _B, _B, _B, _B),
    "glCopyImageSubData": (None, _U, _U, _I, _I, _I, _I, _U, _U, _I, _I, _I, _I, _I, _I, _I),
    "glCreateBuffers": (None, _I, _P),
    "glCreateFramebuffers": (None, _I, _P),
    "glCreateTextures": (None, _U, _I, _P),
    "glCreateVertexArrays": (None, _I, _P),
    "glDeleteBuffers": (None, _I, _P),
    "glDeleteFramebuffers": (None, _I, _P),
    "glDeleteSync": (None, _P),
    "glDeleteTextures": (None, _I, _P),
    "glDeleteVertexArrays": (None, _I, _P),
    "glDepthFunc": (None, _U),
    "glDepthMask": (None, _B),
    "glDisable": (None, _U),
    "glDrawArrays": (None, _U, _I, _I),
    "glDrawArraysInstanced": (None, _U, _I, _I, _I),
    "glEnable": (None, _U),
    "glEnableVertexArrayAttrib": (None, _U, _U),
    "glDisableVertexArrayAttrib": (None, _U, _U),
    "glFenceSync": (_P, _U, _U),
    "glFinish": (None,),
    "glFlush": (None,),
    "glFrontFace": (None, _U),
    "glGenTextures": (None, _I, _P),
    "glGenerateTextureMipmap": (None, _U),
    "glGetError": (_U,),
    "glGetIntegerv": (None, _U, _P),
    "glMapNamedBufferRange": (_P, _U, _N, _N, _U),
    "glMemoryBarrier": (None, _U),
    "glMultiDrawElementsIndirect": (None, _U, _U, _P, _I, _I),
    "glNamedBufferData": (None, _U, _N, _P, _U),
    "glNamedBufferSubData": (None, _U, _N, _N, _P),
    "glNamedFramebufferDrawBuffers": (None, _U, _I, _P),
    "glNamedFramebufferReadBuffer": (None, _U, _U),
    "glNamedFramebufferTexture": (None, _U, _U, _U, _I),
    "glPixelStorei": (None, _U, _I),
    "glPolygonOffset": (None, _F, _F),
    "glProgramUniform1i": (None, _U, _I, _I),
    "glProgramUniform4fv": (None, _U, _I, _I, _P),
    "glReadBuffer": (None, _U),
    "glReadPixels": (None, _I, _I, _I, _I, _U, _U, _P),
    "glScissor": (None, _I, _I, _I, _I),
    "glTexImage2D": (None, _U, _I, _I, _I, _I, _I, _U, _U, _P),
    "glBindTexture": (None, _U, _U),
    "glGetNamedBufferSubData": (None, _U, _N, _N, _P),
    "glGetTextureLevelParameteriv": (None, _U, _I, _U, _P),
    "glTextureParameteri": (None, _U, _U, _I),
    "glTextureStorage2D": (None, _U, _I, _U, _I, _I),
    "glTextureStorage3D": (None, _U, _I, _U, _I, _I, _I),
    "glTextureStorage2DMultisample": (None, _U, _I, _U, _I, _I, _B),
    "glTextureSubImage2D": (None, _U, _I, _I, _I, _I, _I, _U, _U, _P),
    "glTextureSubImage3D": (None, _U, _I, _I, _I, _I, _I, _I, _I, _U, _U, _P),
    "glTextureView": (None, _U, _U, _U, _U, _U, _U, _U, _U),
    "glUnmapNamedBuffer": (_B, _U),
    "glUseProgram": (None, _U),
    "glVertexArrayAttribBinding": (None, _U, _U, _U),
    "glVertexArrayAttribFormat": (None, _U, _U, _I, _U, _B, _U),
    "glVertexArrayAttribIFormat": (None, _U, _U, _I, _U, _U),
    "glVertexArrayBindingDivisor": (None, _U, _U, _U),
    "glVertexArrayElementBuffer": (None, _U, _U),
    "glVertexArrayVertexBuffer": (None, _U, _U, _U, _N, _I),
    "glViewport": (None, _I, _I, _I, _I),
}

# Constants of the OpenGL registry.
TRIANGLES, UNSIGNED_BYTE, UNSIGNED_SHORT, UNSIGNED_INT, SHORT, FLOAT = 0x0004, 0x1401, 0x1403, 0x1405, 0x1402, 0x1406
DEPTH_TEST, CULL_FACE, BLEND, FRAMEBUFFER_SRGB, PRIMITIVE_RESTART, SCISSOR_TEST = 0x0B71, 0x0B44, 0x0BE2, 0x8DB9, 0x8F9D, 0x0C11
POLYGON_OFFSET_FILL = 0x8037
CLOCKWISE = 0x0900
GREATER, ALWAYS, ONE, SRC_ALPHA, ONE_MINUS_SRC_ALPHA, LOWER_LEFT, ZERO_TO_ONE = 0x0204, 0x0207, 1, 0x0302, 0x0303, 0x8CA1, 0x935F
COLOR, DEPTH, COLOR_BUFFER_BIT, NEAREST, LINEAR, LINEAR_MIPMAP_LINEAR = 0x1800, 0x1801, 0x4000, 0x2600, 0x2601, 0x2703
RGB, RGBA, RG, RG_INTEGER, DEPTH_COMPONENT = 0x1907, 0x1908, 0x8227, 0x8228, 0x1902
RGBA8UI, RGBA16UI, RG32UI = 0x8D7C, 0x8D76, 0x823C
COMPRESSED_SRGB_S3TC_DXT1, COMPRESSED_SRGB_ALPHA_S3TC_DXT5 = 0x8C4C, 0x8C4F
TEXTURE_COMPRESSED_IMAGE_SIZE = 0x86A0
SRGB8_ALPHA8, DEPTH_COMPONENT32F, RG16UI, RGBA16, RG32F = 0x8C43, 0x8CAC, 0x823A, 0x805B, 0x8230
READ_FRAMEBUFFER, MAX_SHADER_STORAGE_BLOCK_SIZE = 0x8CA8, 0x90DE
FRAMEBUFFER, COLOR_ATTACHMENT0, DEPTH_ATTACHMENT, FRAMEBUFFER_COMPLETE = 0x8D40, 0x8CE0, 0x8D00, 0x8CD5
TEXTURE_2D, TEXTURE_2D_MULTISAMPLE, MAX_TEXTURE_SIZE, MAX_SAMPLES = 0x0DE1, 0x9100, 0x0D33, 0x8D57
NEAREST_MIPMAP_NEAREST, LINEAR_MIPMAP_NEAREST, NEAREST_MIPMAP_LINEAR = 0x2700, 0x2701, 0x2702
REPEAT, MIRRORED_REPEAT = 0x2901, 0x8370
TEXTURE_MIN_FILTER, TEXTURE_MAG_FILTER, TEXTURE_WRAP_S, TEXTURE_WRAP_T, CLAMP_TO_EDGE = 0x2801, 0x2800, 0x2802, 0x2803, 0x812F
TEXTURE_2D_ARRAY, TEXTURE_COMPARE_MODE, TEXTURE_COMPARE_FUNC, COMPARE_REF_TO_TEXTURE = 0x8C1A, 0x884C, 0x884D, 0x884E
GEQUAL, HALF_FLOAT, RGB16F, RG16F, RGBA8, RGB9_E5 = 0x0206, 0x140B, 0x881B, 0x822F, 0x8058, 0x8C3D
SHADER_STORAGE_BUFFER, UNIFORM_BUFFER, DRAW_INDIRECT_BUFFER, STREAM_DRAW, STATIC_DRAW = 0x90D2, 0x8A11, 0x8F3F, 0x88E0, 0x88E4
RGBA32F, ALL_BARRIERS, TRIANGLE_STRIP, READ_WRITE = 0x8814, 0xFFFFFFFF, 0x0005, 0x88BA
PACK_ALIGNMENT, UNPACK_ALIGNMENT, PIXEL_PACK_BUFFER, PIXEL_UNPACK_BUFFER = 0x0D05, 0x0CF5, 0x88EB, 0x88EC
STREAM_READ, DYNAMIC_COPY = 0x88E1, 0x88EA


class Gl:
    """The functions of ``_PROTOTYPES`` as attributes: ``gl.glViewport(0, 0, 64, 64)``; the context must be current."""

    def __init__(self, context: GlContext) -> None:
        self._context = context

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name not in _PROTOTYPES:
            raise AttributeError(name)
        function = self._context.egl.function(name, *_PROTOTYPES[name])
        setattr(self, name, function)
        return function

    def integer(self, name: int) -> int:
        """Returns a limit or state of the driver, e.g. ``MAX_TEXTURE_SIZE``."""
        value = _I(0)
        self.glGetIntegerv(name, ctypes.byref(value))
        return value.value

    def create(self, function: str, *arguments: int) -> int:
        """Creates one object with ``function``, e.g. ``glCreateBuffers``, and returns its name."""
        name = _U(0)
        getattr(self, function)(*arguments, 1, ctypes.byref(name))
        return name.value

    def view(self, texture: int, internal_format: int) -> int:
        """Returns a new view of a 2-D texture with its bytes in another format of the same size; delete it as a texture."""
        view = self.create("glGenTextures")
        self.glTextureView(view, TEXTURE_2D, texture, internal_format, 0, 1, 0, 1)
        for parameter in (TEXTURE_MIN_FILTER, TEXTURE_MAG_FILTER):
            self.glTextureParameteri(view, parameter, NEAREST)  # with the default filter an integer texture is incomplete
        return view

    def delete(self, function: str, name: int) -> None:
        """Deletes one object with ``function``, e.g. ``glDeleteBuffers``."""
        getattr(self, function)(1, ctypes.byref(_U(name)))
