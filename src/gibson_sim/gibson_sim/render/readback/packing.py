"""Converts render targets to the arrays of a ``Frame`` on the GPU: one compute pass for any number of cameras, into one buffer.

The values are bit-identical to those of ``frames``. The buffer holds one array after the other, each C-contiguous, row 0 = top, as tensors
require.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import RenderError
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.screen_pass import shader_text
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.render.readback.frames import TargetImage, rays_f32
from gibson_sim.render.readback.pixel_buffers import GlBuffer
from gibson_sim.types import CameraSpec, Output

ORDER: tuple[Output, ...] = ("rgb", "depth", "semantic", "instance", "normal", "normal_world", "position", "flow", "hole")
"""Order of the outputs in ``Job.first`` of shaders/pack.comp."""
DTYPES: dict[Output, tuple[type[np.generic], int]] = {
    "rgb": (np.uint8, 3), "depth": (np.float32, 1), "semantic": (np.uint16, 1), "instance": (np.uint16, 1),
    "normal": (np.float32, 3), "normal_world": (np.float32, 3), "position": (np.float32, 3), "flow": (np.float32, 2),
    "hole": (np.uint8, 1),
}  # fmt: skip
"""Element type and number of channels of each array, as in ``Frame``."""

_JOB = np.dtype(
    [
        ("rect", "<i4", 4),
        ("first", "<u4", 12),
        ("R_t", "<f4", (3, 4)),
        ("near", "<f4"),
        ("least", "<f4"),
        ("ray", "<u4"),
        ("", "<u4"),
    ]
)
_NOT_REQUESTED = 0xFFFFFFFF
_Optics = tuple[Any, ...]
_ALIGNMENT = 256
_VIEWS: dict[str, tuple[int, int]] = {
    "color": (0, GL.RGBA8UI), "depth": (1, 0), "LABELS": (2, 0), "NORMALS": (3, GL.RGBA16UI), "FLOW": (4, GL.RG32UI),
}  # fmt: skip
"""Texture unit, and integer format of a texture view of the same bytes (0 = the texture itself is bound)."""
_ALL_BARRIERS = 0xFFFFFFFF
_JOBS, _PACKED, _RAYS = 5, 6, 7
_GROUP_PIXELS = 256


@dataclass(frozen=True, slots=True)
class Stack:
    """Layout in the packed buffer of one output of equal cameras: one array for each camera, evenly spaced."""

    output: Output
    cameras: tuple[int, ...]
    """Indices of the cameras, ascending."""
    offset: int
    """Offset of the first array, bytes."""
    stride: int
    """Distance between the starts of successive arrays, bytes."""
    shape: tuple[int, ...]
    """Shape of each array."""
    steps: tuple[int, ...]
    """Strides of each axis, elements."""
    type_name: str
    """Name of the element type in NumPy and PyTorch."""
    itemsize: int
    """Size of an element, bytes."""

    @property
    def nbytes(self) -> int:
        """Size of each array, bytes."""
        return math.prod(self.shape) * self.itemsize


@lru_cache(maxsize=64)
def layout(formats: tuple[tuple[int, int, tuple[Output, ...]], ...]) -> tuple[tuple[Stack, ...], int]:
    """Returns the layout of the packed buffer, and its size in bytes.

    Args:
        formats: width, height and outputs of each camera.
    """
    by_format: dict[tuple[int, int, frozenset[Output]], list[int]] = {}
    for k, (width, height, outputs) in enumerate(formats):
        by_format.setdefault((width, height, frozenset(outputs)), []).append(k)
    stacks: list[Stack] = []
    offset = 0
    for (width, height, requested), cameras in by_format.items():
        pixels = -(-width * height // 4) * 4  # the shader writes four pixels at a time
        for output in ORDER:
            if output in requested:
                kind, channels = DTYPES[output]
                dtype = np.dtype(kind)
                shape = (height, width) if channels == 1 else (height, width, channels)
                stride = pixels * channels * dtype.itemsize
                steps = (width, 1) if channels == 1 else (width * channels, channels, 1)
                stacks.append(Stack(output, tuple(cameras), offset, stride, shape, steps, dtype.name, dtype.itemsize))
                offset += -(-stride * len(cameras) // _ALIGNMENT) * _ALIGNMENT
    return tuple(stacks), offset


class Packer:
    """The compute pass that packs images, and its buffers.

    Args:
        context: it must be current in every call.
        on_free: called with a buffer that is about to be freed.
    """

    def __init__(self, context: GlContext, on_free: Callable[[GlBuffer], None] | None = None) -> None:
        self._context, self._on_free = context, on_free
        self._gl = GL.Gl(context)
        self.limit = self._gl.integer(GL.MAX_SHADER_STORAGE_BLOCK_SIZE)
        """Maximum number of bytes packed by one call."""
        self._checked = False
        self._shader: moderngl.ComputeShader | None = context.gl.compute_shader(shader_text("pack.comp"))
        self._packed: GlBuffer | None = None
        self._jobs: GlBuffer | None = None
        self._ray_buffer: GlBuffer | None = None
        self._ray_first: dict[_Optics, int] = {}
        self._last_jobs: tuple[tuple[Any, ...], NDArray[np.void]] | None = None

    def pack(self, target: RenderTarget, images: Sequence[TargetImage]) -> tuple[GlBuffer, tuple[Stack, ...], int]:
        """Packs images without waiting for the GPU.

        Returns:
            The buffer, valid until the next call, its layout, and its size in bytes.

        Raises:
            RenderError: the packer is closed, or the driver does not have enough memory.
        """
        if self._shader is None:
            raise RenderError("the packer is closed; create a new one")
        assert target.samples == 1
        formats = tuple((s.camera.width, s.camera.height, s.camera.outputs) for s in images)
        stacks, size = layout(formats)
        if size > self.limit:
            raise RenderError(
                f"{len(images)} images take {size / 1e6:,.0f} MB as tensors, {self._context.device.renderer} packs at most "
                f"{self.limit / 1e6:,.0f} MB in one call; request fewer cameras or outputs at a time"
            )
        if self._packed is None or self._packed.size < size:
            self._free_packed()
            self._packed = GlBuffer(self._context, size, GL.DYNAMIC_COPY)
        jobs = self._table(images, stacks)
        if self._jobs is None or self._jobs.size < jobs.nbytes:
            if self._jobs is not None:
                self._jobs.close()
            self._jobs = GlBuffer(self._context, jobs.nbytes, GL.DYNAMIC_COPY)
        self._jobs.write(jobs)
        for binding, buffer in ((_JOBS, self._jobs), (_PACKED, self._packed), (_RAYS, self._ray_buffer)):
            self._gl.glBindBufferBase(GL.SHADER_STORAGE_BUFFER, binding, 0 if buffer is None else buffer.name)
        views = self._bind(target)
        max_pixels = max(width * height for width, height, _ in formats)
        self._shader.run(-(-max_pixels // _GROUP_PIXELS), len(images))
        self._gl.glMemoryBarrier(_ALL_BARRIERS)
        if not self._checked:
            # Only once: glGetError makes some drivers wait.
            error = self._gl.glGetError()
            if error:
                raise RenderError(f"{self._context.device.renderer} cannot pack images (error 0x{error:x}); update its driver")
            self._checked = True
        for view in views:
            self._gl.delete("glDeleteTextures", view)
        return self._packed, stacks, size

    def _bind(self, target: RenderTarget) -> list[int]:
        """Binds the textures, those that OpenGL would decode through integer views of their bytes; returns the names of the views."""
        gl = self._gl
        views: list[int] = []
        for name, (unit, view_format) in _VIEWS.items():
            texture = target.textures.get(name, 0)
            if texture and view_format:
                view = gl.view(texture, view_format)
                views.append(view)
                texture = view
            gl.glBindSampler(unit, 0)
            gl.glBindTextureUnit(unit, texture)
        return views

    def _table(self, images: Sequence[TargetImage], stacks: Sequence[Stack]) -> NDArray[np.void]:
        """Returns the job of each image. Everything except the poses is cached while the cameras are the same."""
        key = tuple((s.camera.width, s.camera.height, s.camera.outputs, s.camera.near, s.camera.far, s.x, s.y) for s in images)
        if self._last_jobs is None or self._last_jobs[0] != key:
            jobs = np.zeros(len(images), dtype=_JOB)
            jobs["rect"] = [(s.x, s.y, s.camera.width, s.camera.height) for s in images]
            jobs["near"] = [s.camera.near for s in images]
            jobs["least"] = jobs["near"] / np.array([s.camera.far for s in images], dtype=np.float32)
            jobs["first"] = _NOT_REQUESTED
            for stack in stacks:
                first = (stack.offset + stack.stride * np.arange(len(stack.cameras))) // 4
                jobs["first"][list(stack.cameras), ORDER.index(stack.output)] = first
            self._last_jobs = (key, jobs)
        jobs = self._last_jobs[1]
        jobs["R_t"] = np.array([s.T_world_camera for s in images])[:, :3]
        with_rays = [(k, _optics(s.camera), s.camera) for k, s in enumerate(images) if "position" in s.camera.outputs]
        if with_rays:
            self._provide_rays({optics: camera for _, optics, camera in with_rays})
            jobs["ray"][[k for k, _, _ in with_rays]] = [self._ray_first[optics] for _, optics, _ in with_rays]
        return jobs

    def _provide_rays(self, cameras: dict[_Optics, CameraSpec]) -> None:
        """Uploads the rays of cameras unless they are already on the GPU."""
        if cameras.keys() <= self._ray_first.keys():
            return
        tables = [rays_f32(camera).reshape(-1) for camera in cameras.values()]
        ends = np.cumsum([len(t) for t in tables]).tolist()
        self._ray_first = dict(zip(cameras, [0, *ends[:-1]], strict=True))
        if self._ray_buffer is not None:
            self._ray_buffer.close()
        self._ray_buffer = GlBuffer(self._context, 4 * ends[-1], GL.DYNAMIC_COPY)
        self._ray_buffer.write(np.concatenate(tables))

    def _free_packed(self) -> None:
        packed, self._packed = self._packed, None
        if packed is not None:
            if self._on_free is not None:
                self._on_free(packed)
            packed.close()

    def close(self) -> None:
        """Frees all GPU resources; a second call does nothing. The context must be current."""
        self._free_packed()
        for buffer in (self._jobs, self._ray_buffer):
            if buffer is not None:
                buffer.close()
        self._jobs = self._ray_buffer = None
        if self._shader is not None:
            self._shader.release()
            self._shader = None


def _optics(camera: CameraSpec) -> _Optics:
    """Returns the fields that the rays of a camera depend on; cameras with equal optics share rays."""
    return (camera.width, camera.height, camera.projection, camera.fov_y, camera.fov, camera.matrix, camera.distortion)
