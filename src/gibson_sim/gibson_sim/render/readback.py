"""What is drawn into, and how it comes back to memory: an sRGB colour image and a float depth image of one size.

Further outputs are further colour attachments of the same framebuffer, filled in the same pass, and there only if asked for.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import RenderError
from gibson_sim.render.context import GlContext
from gibson_sim.types import Output

Feature = Literal["LABELS", "NORMALS"]
"""A further output, named as the shaders know it."""
ATTACHMENT: dict[Feature, int] = {"LABELS": 1, "NORMALS": 2}
"""Number of its colour attachment."""

_FRAMEBUFFER, _RENDERBUFFER = 0x8D40, 0x8D41
_COLOR_ATTACHMENT0, _DEPTH_ATTACHMENT = 0x8CE0, 0x8D00
_SRGB8_ALPHA8, _DEPTH_COMPONENT32F = 0x8C43, 0x8CAC
_FORMATS: dict[Feature, int] = {"LABELS": 0x823A, "NORMALS": 0x805B}  # two 16-bit integers; four 16-bit fractions
_COMPLETE = 0x8CD5
_RGBA, _DEPTH_COMPONENT, _UNSIGNED_BYTE, _FLOAT = 0x1908, 0x1902, 0x1401, 0x1406
_RG_INTEGER, _UNSIGNED_SHORT = 0x8228, 0x1403
_PACK_ALIGNMENT, _MAX_RENDERBUFFER_SIZE = 0x0D05, 0x84E8

_U, _I, _P = ctypes.c_uint, ctypes.c_int, ctypes.c_void_p
_PROTOTYPES: dict[str, tuple[Any, ...]] = {
    "glGenFramebuffers": (None, _I, _P),
    "glGenRenderbuffers": (None, _I, _P),
    "glDeleteFramebuffers": (None, _I, _P),
    "glDeleteRenderbuffers": (None, _I, _P),
    "glBindFramebuffer": (None, _U, _U),
    "glBindRenderbuffer": (None, _U, _U),
    "glRenderbufferStorage": (None, _U, _U, _I, _I),
    "glFramebufferRenderbuffer": (None, _U, _U, _U, _U),
    "glCheckFramebufferStatus": (_U, _U),
    "glGetIntegerv": (None, _U, _P),
    "glGetError": (_U,),
    "glViewport": (None, _I, _I, _I, _I),
    "glPixelStorei": (None, _U, _I),
    "glDrawBuffers": (None, _I, _P),
    "glReadBuffer": (None, _U),
    "glReadPixels": (None, _I, _I, _I, _I, _U, _U, _P),
}


def features_of(outputs: Sequence[Output]) -> tuple[Feature, ...]:
    """Returns what must be drawn beside colour and depth."""
    labels: tuple[Feature, ...] = ("LABELS",) if {"semantic", "instance"} & set(outputs) else ()
    return (*labels, "NORMALS") if "normal" in outputs else labels


class Target:
    """A framebuffer of one size. ModernGL offers neither a 32-bit float depth nor an sRGB renderbuffer, hence plain OpenGL.

    Raises:
        RenderError: the driver cannot make one so large.
    """

    def __init__(self, context: GlContext, width: int, height: int, features: tuple[Feature, ...] = ()) -> None:
        self.width, self.height = width, height
        self._framebuffer = _U(0)
        formats = [(_COLOR_ATTACHMENT0, _SRGB8_ALPHA8), (_DEPTH_ATTACHMENT, _DEPTH_COMPONENT32F)]
        formats += [(_COLOR_ATTACHMENT0 + ATTACHMENT[f], _FORMATS[f]) for f in features]
        self._buffers = (_U * len(formats))()
        self._gl = {name: context.egl.function(name, *prototype) for name, prototype in _PROTOTYPES.items()}
        gl = self._gl
        limit = _I(0)
        gl["glGetIntegerv"](_MAX_RENDERBUFFER_SIZE, ctypes.byref(limit))
        if max(width, height) > limit.value:
            raise RenderError(
                f"image size is {width}x{height}, {context.device.renderer} draws at most {limit.value} pixels a side"
            )
        try:
            gl["glGenFramebuffers"](1, ctypes.byref(self._framebuffer))
            gl["glBindFramebuffer"](_FRAMEBUFFER, self._framebuffer)
            gl["glGenRenderbuffers"](len(formats), self._buffers)
            for buffer, (attachment, form) in zip(self._buffers, formats, strict=True):
                gl["glBindRenderbuffer"](_RENDERBUFFER, buffer)
                gl["glRenderbufferStorage"](_RENDERBUFFER, form, width, height)
                gl["glFramebufferRenderbuffer"](_FRAMEBUFFER, attachment, _RENDERBUFFER, buffer)
            drawn = {a for a, _ in formats}
            outputs = [a if a in drawn else 0 for a in range(_COLOR_ATTACHMENT0, _COLOR_ATTACHMENT0 + 1 + len(ATTACHMENT))]
            gl["glDrawBuffers"](len(outputs), (_U * len(outputs))(*outputs))
            status = gl["glCheckFramebufferStatus"](_FRAMEBUFFER)
            if status != _COMPLETE or gl["glGetError"]():
                raise RenderError(
                    f"the driver cannot draw an image of {width}x{height} pixels (status 0x{status:x}); choose a smaller one"
                )
        except BaseException:
            self.close()
            raise
        self._rgba = np.empty((height, width, 4), dtype=np.uint8)

    def use(self) -> None:
        """Sends what is drawn from now on here."""
        self._gl["glBindFramebuffer"](_FRAMEBUFFER, self._framebuffer)
        self._gl["glViewport"](0, 0, self.width, self.height)

    def read_rgb(self) -> NDArray[np.uint8]:
        """Returns a new (H, W, 3) uint8 sRGB image, row 0 = top."""
        # Four bytes a pixel is what drivers store and copy at once; dropping alpha here takes far less than their conversion.
        self._read(_RGBA, _UNSIGNED_BYTE, self._rgba)
        rgb = np.empty((self.height, self.width, 3), dtype=np.uint8)
        cv2.cvtColor(self._rgba, cv2.COLOR_RGBA2RGB, dst=rgb)
        return rgb

    def read_depth(self, near: float, far: float) -> NDArray[np.float32]:
        """Returns a new (H, W) float32 depth image, metres along the axis, +inf = nothing nearer than ``far``, row 0 = top."""
        depth = np.empty((self.height, self.width), dtype=np.float32)
        self._read(_DEPTH_COMPONENT, _FLOAT, depth)
        np.copyto(depth, 0.0, where=depth < near / far)
        with np.errstate(divide="ignore"):
            np.divide(np.float32(near), depth, out=depth)
        return depth

    def read_labels(self) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
        """Returns new (H, W) uint16 images of semantic classes and of instances, 0 = nothing, row 0 = top."""
        both = np.empty((self.height, self.width, 2), dtype=np.uint16)
        self._read(_RG_INTEGER, _UNSIGNED_SHORT, both, ATTACHMENT["LABELS"])
        return np.ascontiguousarray(both[:, :, 0]), np.ascontiguousarray(both[:, :, 1])

    def read_normals(self) -> NDArray[np.float32]:
        """Returns a new (H, W, 3) float32 image of unit normals in the optical frame, 0 = nothing, row 0 = top."""
        # Fractions of 16 bits: finer than half floats where it matters, and half the bytes of whole ones.
        fractions = np.empty((self.height, self.width, 4), dtype=np.uint16)
        self._read(_RGBA, _UNSIGNED_SHORT, fractions, ATTACHMENT["NORMALS"])
        normals = np.multiply(cv2.cvtColor(fractions, cv2.COLOR_RGBA2RGB), np.float32(2.0 / 65535.0), dtype=np.float32)
        normals -= 1.0
        normals[fractions[:, :, 3] == 0] = 0.0
        return normals

    def _read(self, form: int, kind: int, out: NDArray[Any], attachment: int = 0) -> None:
        self._gl["glReadBuffer"](_COLOR_ATTACHMENT0 + attachment)
        self._gl["glPixelStorei"](_PACK_ALIGNMENT, 1)
        self._gl["glReadPixels"](0, 0, self.width, self.height, form, kind, out.ctypes.data)

    def close(self) -> None:
        """Frees it; a second call does nothing. The context must be current."""
        if self._framebuffer.value:
            self._gl["glDeleteFramebuffers"](1, ctypes.byref(self._framebuffer))
            self._gl["glDeleteRenderbuffers"](len(self._buffers), self._buffers)
            self._framebuffer = _U(0)
