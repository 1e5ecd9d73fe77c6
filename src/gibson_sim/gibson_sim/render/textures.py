"""Images of materials become textures with mipmaps."""

from __future__ import annotations

import ctypes

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.colours import linear_from_srgb, srgb8_from_linear
from gibson_sim.render import gl as GL

Pixels = NDArray[np.uint8]


def upload_texture(gl: GL.Gl, pixels: Pixels, *, compress: bool) -> tuple[int, int]:
    """Returns a texture, and the bytes that it takes.

    Args:
        gl: the context must be current.
        pixels: (H, W, 3) or (H, W, 4) uint8, sRGB, row 0 = top: where t = 0 is, so v counts downwards, as MeshPart has it. Made
            smaller if the driver cannot hold it.
        compress: keep it compressed.
    """
    pixels = _fitting(pixels, gl.integer(GL.MAX_TEXTURE_SIZE))
    texture = gl.create("glCreateTextures", GL.TEXTURE_2D)
    gl.glPixelStorei(GL.UNPACK_ALIGNMENT, 1)
    size = _compressed(gl, texture, pixels) if compress else _plain(gl, texture, pixels)
    gl.glTextureParameteri(texture, GL.TEXTURE_MIN_FILTER, GL.LINEAR_MIPMAP_LINEAR)
    gl.glTextureParameteri(texture, GL.TEXTURE_MAG_FILTER, GL.LINEAR)
    return texture, size


def _fitting(pixels: Pixels, limit: int) -> Pixels:
    height, width = pixels.shape[:2]
    shrink = limit / max(height, width)
    if shrink < 1.0:
        size = (max(1, int(width * shrink)), max(1, int(height * shrink)))
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return np.ascontiguousarray(pixels)


def _form(pixels: Pixels) -> int:
    return GL.RGB if pixels.shape[2] == 3 else GL.RGBA


def _plain(gl: GL.Gl, texture: int, pixels: Pixels) -> int:
    height, width = pixels.shape[:2]
    gl.glTextureStorage2D(texture, max(width, height).bit_length(), GL.SRGB8_ALPHA8, width, height)
    gl.glTextureSubImage2D(texture, 0, 0, 0, width, height, _form(pixels), GL.UNSIGNED_BYTE, pixels.ctypes.data)
    gl.glGenerateTextureMipmap(texture)
    size: int = width * height * 4 * 4 // 3
    return size


def _compressed(gl: GL.Gl, texture: int, pixels: Pixels) -> int:
    """Lets the driver compress each level; it makes no mipmaps of what is compressed, so they are made here, in linear light."""
    kind = GL.COMPRESSED_SRGB_S3TC_DXT1 if pixels.shape[2] == 3 else GL.COMPRESSED_SRGB_ALPHA_S3TC_DXT5
    gl.glBindTexture(GL.TEXTURE_2D, texture)
    total, level, size = 0, 0, ctypes.c_int(0)
    while True:
        height, width = pixels.shape[:2]
        gl.glTexImage2D(GL.TEXTURE_2D, level, kind, width, height, 0, _form(pixels), GL.UNSIGNED_BYTE, pixels.ctypes.data)
        gl.glGetTextureLevelParameteriv(texture, level, GL.TEXTURE_COMPRESSED_IMAGE_SIZE, ctypes.byref(size))
        total += size.value
        if max(width, height) == 1:
            return total
        pixels = _halved(pixels)
        level += 1


def _halved(pixels: Pixels) -> Pixels:
    """Returns the next level of mipmaps."""
    height, width = pixels.shape[:2]
    linear = cv2.LUT(pixels, np.stack([_LINEAR] * 3 + [_ALPHA], axis=-1)[None, :, : pixels.shape[2]])
    smaller = cv2.resize(linear, (max(width // 2, 1), max(height // 2, 1)), interpolation=cv2.INTER_AREA)
    half = srgb8_from_linear(smaller)
    half[..., 3:] = np.rint(smaller[..., 3:] * 255.0)
    return half


_ALPHA = (np.arange(256) / 255.0).astype(np.float32)
_LINEAR = linear_from_srgb(_ALPHA)
