"""Reads render targets back to memory and converts them to the arrays of a ``Frame``.

``Readback`` reads and waits (``pixel_buffers`` does not wait); ``frame_from_raw`` converts. Results are bit-identical to those of
``pack.comp`` on the GPU.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray

from gibson_sim.filling.holes import BACK_FACE, NOTHING, SURFACE, UNSEEN
from gibson_sim.geometry import projections
from gibson_sim.geometry.compiling import CAN_COMPILE, compiled, fixed
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.grouping import IdentityCache
from gibson_sim.render.draw.target import ATTACHMENT, RenderTarget, features_of
from gibson_sim.types import CameraSpec, Frame, Output

F32 = NDArray[np.float32]
U16 = NDArray[np.uint16]
UNIT = np.float32(2.0 / 65535.0)
"""Scale of stored normals, 16-bit normalised integers: the component is ``stored * UNIT - 1``."""
_ONE = np.float32(1.0)
BACK_BELOW = 49152
"""Alpha of normals, of 65535, below which a pixel shows the back of a surface; 0 = no surface."""
MOVING_BELOW = 61440
"""Alpha of normals, of 65535, from ``BACK_BELOW`` up to which a pixel shows a moving link."""
_MAX_ARRAYS = 64


@dataclass(frozen=True, slots=True)
class RawFormat:
    """Pixel format in which an attachment is read back."""

    gl_format: int
    gl_type: int
    dtype: DTypeLike
    channels: int


RAW_FORMATS: dict[str, RawFormat] = {
    # Drivers copy RGBA without conversion: dropping alpha on the host is far faster than a conversion by the driver.
    "color": RawFormat(GL.RGBA, GL.UNSIGNED_BYTE, np.uint8, 4),
    "depth": RawFormat(GL.DEPTH_COMPONENT, GL.FLOAT, np.float32, 1),
    "LABELS": RawFormat(GL.RG_INTEGER, GL.UNSIGNED_SHORT, np.uint16, 2),
    "NORMALS": RawFormat(GL.RGBA, GL.UNSIGNED_SHORT, np.uint16, 4),
    "FLOW": RawFormat(GL.RG, GL.FLOAT, np.float32, 2),
}
"""Format of each attachment of a ``RenderTarget``."""


@dataclass(frozen=True, slots=True, eq=False)
class TargetImage:
    """One camera's image in a target."""

    camera: CameraSpec
    stamp_ns: int
    T_world_camera: Mat4
    x: int = 0
    """Column of the image's left edge in the target."""
    y: int = 0
    """Row of the image's top edge in the target."""


class Readback:
    """Reads targets of one context into memory."""

    def __init__(self, context: GlContext) -> None:
        self._gl = GL.Gl(context)
        self._memory: dict[tuple[str, int, int], tuple[NDArray[Any], int]] = {}  # array and its address

    def frames(self, target: RenderTarget, images: Sequence[TargetImage]) -> list[Frame]:
        """Returns the frames of images in a target; the arrays belong to the caller."""
        raw = {name: self._read(target, name) for name in needed(target, images)}
        return [frame_from_raw(image, raw) for image in images]

    def _read(self, target: RenderTarget, name: str) -> NDArray[Any]:
        """Returns an attachment, (H, W, ...), in memory reused by the next call."""
        raw = RAW_FORMATS[name]
        key = (name, target.width, target.height)
        if key not in self._memory:
            if len(self._memory) > _MAX_ARRAYS:
                self._memory.clear()
            shape = (target.height, target.width) if raw.channels == 1 else (target.height, target.width, raw.channels)
            array = np.empty(shape, dtype=raw.dtype)
            self._memory[key] = array, array.ctypes.data
        out, address = self._memory[key]
        gl = self._gl
        gl.glBindFramebuffer(GL.FRAMEBUFFER, target.framebuffer)
        gl.glReadBuffer(GL.COLOR_ATTACHMENT0 + ATTACHMENT.get(name, 0))
        gl.glPixelStorei(GL.PACK_ALIGNMENT, 1)
        gl.glReadPixels(0, 0, target.width, target.height, raw.gl_format, raw.gl_type, address)
        return out


def frame_from_raw(image: TargetImage, raw: dict[str, NDArray[Any]]) -> Frame:
    """Returns the frame of an image, copied from raw attachments.

    Args:
        image: the image.
        raw: "color" (H, W, 4) uint8; "depth" (H, W) float32, near / depth, 0 = nothing; "LABELS" (H, W, 2) uint16; "NORMALS"
            (H, W, 4) uint16, normalised; "FLOW" (H, W, 2) float32. Row 0 = top.
    """
    camera = image.camera
    outputs = camera.outputs
    part = {name: a[image.y : image.y + camera.height, image.x : image.x + camera.width] for name, a in raw.items()}
    R = image.T_world_camera[:3, :3].astype(np.float32)
    attachments = _attachments_of(outputs)
    depth = depth_of(part["depth"], camera.near, camera.far) if "depth" in attachments else None
    normal = normals_of(part["NORMALS"]) if {"normal", "normal_world"} & set(outputs) else None
    position = None
    if "position" in outputs:
        assert depth is not None
        position = positions_of(rays_f32(camera), depth, R, image.T_world_camera[:3, 3].astype(np.float32))
    return Frame(
        camera,
        image.stamp_ns,
        image.T_world_camera,
        rgb=np.asarray(cv2.cvtColor(part["color"], cv2.COLOR_RGBA2RGB)) if "rgb" in outputs else None,
        depth=depth if "depth" in outputs else None,
        semantic=np.ascontiguousarray(part["LABELS"][:, :, 0]) if "semantic" in outputs else None,
        instance=np.ascontiguousarray(part["LABELS"][:, :, 1]) if "instance" in outputs else None,
        normal=normal if "normal" in outputs else None,
        normal_world=rotated(R, normal) if normal is not None and "normal_world" in outputs else None,
        position=position,
        flow=part["FLOW"].copy() if "flow" in outputs else None,
        hole=hole_of(part["NORMALS"]) if "hole" in outputs else None,
    )


def needed(target: RenderTarget, images: Sequence[TargetImage]) -> list[str]:
    """Returns the attachments of a target required for the frames of its images."""
    attachments = [_attachments_of(image.camera.outputs) for image in images]
    return [name for name in ("color", "depth", *target.features) if any(name in names for names in attachments)]


def _attachments(outputs: tuple[Output, ...]) -> frozenset[str]:
    color, depth = "rgb" in outputs, bool({"depth", "position"} & set(outputs))
    return frozenset([*(["color"] if color else []), *(["depth"] if depth else []), *features_of(outputs)])


_attachments_of = IdentityCache(_attachments)
"""Returns the attachments required for outputs."""


def depth_of(raw: F32, near: float, far: float, *, loops: bool = CAN_COMPILE) -> F32:
    """Returns depth, (H, W), metres, +inf = nothing nearer than ``far``.

    Args:
        raw: (H, W), near / depth, 0 = nothing.
        near: depth of the near plane, metres.
        far: largest depth, metres.
        loops: use compiled loops.
    """
    nearest, least = np.float32(near), np.float32(near) / np.float32(far)
    if loops:
        return _depth_loop(fixed(raw), nearest, least)
    with np.errstate(divide="ignore"):
        depth: F32 = nearest / raw
    # Few images have pixels beyond ``far``: testing the minimum first is faster than selecting for each pixel.
    if float(raw.min()) < least:
        depth[raw < least] = np.inf
    return depth


@compiled
def _depth_loop(raw: F32, near: np.float32, least: np.float32) -> F32:
    out = np.empty(raw.shape, dtype=np.float32)
    for v in range(raw.shape[0]):
        for u in range(raw.shape[1]):
            depth = near / raw[v, u]
            out[v, u] = np.float32(np.inf) if raw[v, u] < least else depth
    return out


def normals_of(raw: U16, *, loops: bool = CAN_COMPILE) -> F32:
    """Returns unit normals, (H, W, 3), 0 = nothing.

    Args:
        raw: (H, W, 4), normalised 16-bit integers; alpha is 0 where there is no surface.
        loops: use compiled loops.
    """
    if loops:
        return _normals_loop(fixed(raw))
    # One conversion, then in-place arithmetic, takes half the time of a multiplication that converts.
    normals = cv2.cvtColor(raw, cv2.COLOR_RGBA2RGB).astype(np.float32)
    normals *= UNIT
    normals -= _ONE
    if not raw[:, :, 3].all():
        normals[raw[:, :, 3] == 0] = 0.0
    return normals


@compiled
def _normals_loop(raw: U16) -> F32:
    out = np.zeros((raw.shape[0], raw.shape[1], 3), dtype=np.float32)
    for v in range(raw.shape[0]):
        for u in range(raw.shape[1]):
            if raw[v, u, 3]:
                for k in range(3):
                    scaled = np.float32(raw[v, u, k]) * UNIT
                    out[v, u, k] = scaled - _ONE
    return out


def hole_of(raw: U16, *, loops: bool = CAN_COMPILE) -> NDArray[np.uint8]:
    """Returns the class of each pixel, (H, W) uint8, a constant of ``filling.holes``.

    Args:
        raw: (H, W, 4) normals, normalised 16-bit integers; where there is no surface alpha is 0, and red is 0 in holes.
        loops: use compiled loops.
    """
    if loops:
        return _hole_loop(fixed(raw))
    side, red = raw[:, :, 3], raw[:, :, 0]
    nothing = np.where(red == 0, NOTHING, UNSEEN)
    return np.where(side == 0, nothing, np.where(side < BACK_BELOW, BACK_FACE, SURFACE)).astype(np.uint8)


@compiled
def _hole_loop(raw: U16) -> NDArray[np.uint8]:
    out = np.zeros((raw.shape[0], raw.shape[1]), dtype=np.uint8)
    for v in range(raw.shape[0]):
        for u in range(raw.shape[1]):
            side = raw[v, u, 3]
            if side == 0:
                out[v, u] = NOTHING if raw[v, u, 0] == 0 else UNSEEN
            elif side < BACK_BELOW:
                out[v, u] = BACK_FACE
    return out


def outside_of(raw: U16) -> NDArray[np.bool_]:
    """Returns the mask, (H, W), of the pixels outside the field of view of the lens; for the argument see ``hole_of``."""
    return np.asarray((raw[:, :, 3] == 0) & (raw[:, :, 0] != 0) & (raw[:, :, 1] == 0))


def moving_of(raw: U16) -> NDArray[np.bool_]:
    """Returns the mask, (H, W), of the pixels that show a moving link; for the argument see ``hole_of``."""
    side = raw[:, :, 3]
    return np.asarray((side >= BACK_BELOW) & (side < MOVING_BELOW))


def positions_of(rays: F32, depth: F32, R: F32, t: F32, *, loops: bool = CAN_COMPILE) -> F32:
    """Returns the world positions of pixels, (H, W, 3), metres, float32, summed from left to right; NaN = nothing.

    Args:
        rays: (H, W, 3), points at depth 1 in the optical frame.
        depth: (H, W), metres, +inf = nothing.
        R: (3, 3), R_world_camera.
        t: (3,), position of the camera in the world, metres.
        loops: use compiled loops.
    """
    if loops:
        return _positions_loop(fixed(rays), fixed(depth), fixed(R), fixed(t))
    with np.errstate(invalid="ignore"):  # 0 times infinity: the optical axis, and no surface
        optical = rays * depth[:, :, None]
    position = rotated(R, optical, loops=False) + t
    position[~np.isfinite(depth)] = np.nan
    return position


@compiled
def _positions_loop(rays: F32, depth: F32, R: F32, t: F32) -> F32:
    out = np.empty(rays.shape, dtype=np.float32)
    for v in range(rays.shape[0]):
        for u in range(rays.shape[1]):
            z = depth[v, u]
            if np.isfinite(z):
                a, b, c = rays[v, u, 0] * z, rays[v, u, 1] * z, rays[v, u, 2] * z
                for i in range(3):
                    out[v, u, i] = R[i, 0] * a + R[i, 1] * b + R[i, 2] * c + t[i]
            else:
                for i in range(3):
                    out[v, u, i] = np.float32(np.nan)
    return out


def rotated(R: F32, vectors: F32, *, loops: bool = CAN_COMPILE) -> F32:
    """Returns ``R v`` of vectors, (H, W, 3), float32, summed from left to right: bit-identical to the GPU."""
    if loops:
        return _rotated_loop(fixed(R), fixed(vectors))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    out = np.empty_like(vectors)
    for i in range(3):
        with np.errstate(invalid="ignore"):
            out[..., i] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z
    return out


@compiled
def _rotated_loop(R: F32, vectors: F32) -> F32:
    out = np.empty(vectors.shape, dtype=np.float32)
    for v in range(vectors.shape[0]):
        for u in range(vectors.shape[1]):
            x, y, z = vectors[v, u, 0], vectors[v, u, 1], vectors[v, u, 2]
            for i in range(3):
                out[v, u, i] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z
    return out


@lru_cache(maxsize=64)
def rays_f32(camera: CameraSpec) -> NDArray[np.float32]:
    """Returns the point at depth 1 of each pixel in the optical frame, (H, W, 3); NaN = outside the field of view."""
    return projections.rays(camera).astype(np.float32)
