"""Asynchronous readback: the GPU copies images into pixel buffers while the caller continues, and a fence signals the end of the copy.

``start`` requests the copy and returns immediately; ``finish`` waits for its fence and returns the arrays. Each copy has a separate buffer,
so several may be pending. A software renderer has no copy engine and gains nothing.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import RenderError
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.target import ATTACHMENT, RenderTarget
from gibson_sim.render.readback.frames import RAW_FORMATS, TargetImage, frame_from_raw
from gibson_sim.types import Frame

_MAP_READ, _SYNC_GPU_COMMANDS_COMPLETE, _SYNC_FLUSH_COMMANDS = 0x0001, 0x9117, 0x00000001
_ALREADY_SIGNALED, _TIMEOUT_EXPIRED, _CONDITION_SATISFIED = 0x911A, 0x911B, 0x911C
_WAIT_NS = 1_000_000_000
_WAITS = 60
_MAX_FREE = 8
"""Maximum number of cached free buffers."""
_ALIGNMENT = 256
"""Alignment of images in a buffer, bytes; enough for every driver."""


class GlBuffer:
    """A buffer in GPU memory.

    Args:
        context: it must be current in every call.
        size: size, bytes.
        usage: ``GL.STREAM_READ`` if the host reads it, ``GL.DYNAMIC_COPY`` if only the GPU reads it.

    Raises:
        RenderError: the driver does not have enough memory.
    """

    def __init__(self, context: GlContext, size: int, usage: int) -> None:
        self.size = size
        self._gl = GL.Gl(context)
        self._gl.glGetError()
        self.name = self._gl.create("glCreateBuffers")
        """OpenGL name of the buffer."""
        self._gl.glNamedBufferData(self.name, size, None, usage)
        if self._gl.glGetError():
            self.close()
            raise RenderError(
                f"{context.device.renderer} cannot allocate {size / 1e6:.1f} MB for images; request smaller or fewer images"
            )

    def write(self, data: NDArray[Any]) -> None:
        """Writes data to the start of the buffer."""
        assert data.nbytes <= self.size
        self._gl.glNamedBufferSubData(self.name, 0, data.nbytes, np.ascontiguousarray(data).ctypes.data)

    def map(self) -> int:
        """Maps the buffer for reading by the host until ``unmap`` and returns its address; waits for the GPU."""
        address = self._gl.glMapNamedBufferRange(self.name, 0, self.size, _MAP_READ)
        if not address:
            raise RenderError(f"the driver cannot map {self.size} bytes (error 0x{self._gl.glGetError():x})")
        return int(address)

    def unmap(self) -> None:
        """Unmaps the buffer."""
        self._gl.glUnmapNamedBuffer(self.name)

    def close(self) -> None:
        """Frees the buffer; a second call does nothing."""
        if self.name:
            self._gl.delete("glDeleteBuffers", self.name)
            self.name = 0


class ReadRequest:
    """A pending copy, to be passed to ``PixelBuffers.finish`` once."""

    def __init__(self, buffer: GlBuffer, fence: int, images: tuple[tuple[str, int, tuple[int, ...]], ...]) -> None:
        self.buffer = buffer
        self.fence: int | None = fence
        """OpenGL fence; None after the request has finished."""
        self.images = images
        """Name, offset in bytes and shape of each image."""


class PixelBuffers:
    """Reads targets back asynchronously.

    Args:
        context: it must be current in every call.
    """

    def __init__(self, context: GlContext) -> None:
        self._context = context
        self._gl = GL.Gl(context)
        self._free: list[GlBuffer] = []
        self._pending: list[ReadRequest] = []

    def start(self, target: RenderTarget, attachments: Sequence[str] | None = None) -> ReadRequest:
        """Requests a copy of the target's current content without waiting; the target may be drawn into again.

        Args:
            target: target to read, with one sample per pixel.
            attachments: names of its textures; None = all.
        """
        names = tuple(attachments) if attachments is not None else tuple(target.textures)
        missing = [name for name in names if name not in target.textures]
        assert not missing, f"the target has no {missing}"
        assert target.samples == 1
        images, size = _layout(names, target.width, target.height)
        buffer = self._acquire(size)
        gl = self._gl
        gl.glBindFramebuffer(GL.READ_FRAMEBUFFER, target.framebuffer)
        gl.glBindBuffer(GL.PIXEL_PACK_BUFFER, buffer.name)
        gl.glPixelStorei(GL.PACK_ALIGNMENT, 1)
        for name, offset, _ in images:
            raw = RAW_FORMATS[name]
            if name != "depth":
                gl.glNamedFramebufferReadBuffer(target.framebuffer, GL.COLOR_ATTACHMENT0 + ATTACHMENT[name])
            gl.glReadPixels(0, 0, target.width, target.height, raw.gl_format, raw.gl_type, offset)
        # With the buffer bound, addresses of later reads to host memory would be interpreted as offsets in it.
        gl.glBindBuffer(GL.PIXEL_PACK_BUFFER, 0)
        request = ReadRequest(buffer, int(gl.glFenceSync(_SYNC_GPU_COMMANDS_COMPLETE, 0)), images)
        self._pending.append(request)
        return request

    def done(self, request: ReadRequest) -> bool:
        """Returns whether ``finish`` would return without waiting."""
        return request.fence is None or self._wait(request.fence, 0) != _TIMEOUT_EXPIRED

    def finish(self, request: ReadRequest) -> dict[str, NDArray[Any]]:
        """Returns the images, row 0 = top, in arrays that belong to the caller.

        ``color`` (H, W, 4) uint8 sRGB and alpha; ``depth`` (H, W) float32, near / z, 0 = nothing; ``LABELS`` (H, W, 2) uint16;
        ``NORMALS`` (H, W, 4) uint16; ``FLOW`` (H, W, 2) float32.

        Raises:
            RenderError: the request has already finished, or the GPU does not respond.
        """
        with self._mapped(request) as images:
            return {name: image.copy() for name, image in images.items()}

    def frames(self, request: ReadRequest, images: Sequence[TargetImage]) -> list[Frame]:
        """Returns the frames of images whose ``needed`` attachments were read. For errors see ``finish``."""
        with self._mapped(request) as raw:
            return [frame_from_raw(image, raw) for image in images]

    def discard(self, request: ReadRequest) -> None:
        """Gives up the images of a request and frees its buffer for later ones."""
        self._retire(request)
        self._free.append(request.buffer)

    @contextmanager
    def _mapped(self, request: ReadRequest) -> Iterator[dict[str, NDArray[Any]]]:
        """Waits for the images and yields them in the mapped buffer; the request is finished."""
        if request.fence is None:
            raise RenderError("these images were fetched already, or their pixel buffers are closed; start a new read")
        self._wait_for(request.fence)
        self._retire(request)
        memory = memoryview((ctypes.c_uint8 * request.buffer.size).from_address(request.buffer.map()))
        try:
            yield {
                name: np.frombuffer(memory, RAW_FORMATS[name].dtype, math.prod(shape), offset).reshape(shape)
                for name, offset, shape in request.images
            }
        finally:
            request.buffer.unmap()
            self._free.append(request.buffer)

    def _acquire(self, size: int) -> GlBuffer:
        """Returns a free buffer of exactly this size, or a new one."""
        fitting = [b for b in self._free if b.size == size]
        if fitting:
            self._free.remove(fitting[-1])
            return fitting[-1]
        # Sizes change with the cameras, so buffers of old sizes are freed.
        while len(self._free) > _MAX_FREE:
            self._free.pop(0).close()
        return GlBuffer(self._context, size, GL.STREAM_READ)

    def _wait(self, fence: int, timeout_ns: int) -> int:
        return int(self._gl.glClientWaitSync(fence, _SYNC_FLUSH_COMMANDS, timeout_ns))

    def _wait_for(self, fence: int) -> None:
        for _ in range(_WAITS):
            status = self._wait(fence, _WAIT_NS)
            if status in (_ALREADY_SIGNALED, _CONDITION_SATISFIED):
                return
            if status != _TIMEOUT_EXPIRED:
                break
        raise RenderError(
            f"{self._context.device.renderer} does not finish drawing (status 0x{status:x}); was the GPU reset? start again"
        )

    def _retire(self, request: ReadRequest) -> None:
        if request.fence is not None:
            self._gl.glDeleteSync(request.fence)
            request.fence = None
        if request in self._pending:
            self._pending.remove(request)

    def close(self) -> None:
        """Frees all buffers, including those of pending copies; a second call does nothing."""
        for request in list(self._pending):
            self._retire(request)
            self._free.append(request.buffer)
        for buffer in self._free:
            buffer.close()
        self._free = []


class PendingFrames:
    """Frames that are being drawn and read back; start the next frames before calling ``result``.

    Args:
        context: context of the frames.
        buffers: pixel buffers that read them.
        reads: for each target, its request, its images, and the position of each image in the result.
    """

    def __init__(
        self, context: GlContext, buffers: PixelBuffers, reads: Sequence[tuple[ReadRequest, Sequence[TargetImage], Sequence[int]]]
    ) -> None:
        self._context, self._buffers, self._reads = context, buffers, tuple(reads)
        self._frames: list[Frame] | None = None

    @classmethod
    def joined(cls, parts: Sequence[tuple[PendingFrames, Sequence[int]]]) -> PendingFrames:
        """Returns frames of one renderer that were started one after the other as one; they are read through the result only.

        Args:
            parts: at least one: frames, and the position of each in the result.
        """
        reads = [
            (request, images, [positions[k] for k in numbers])
            for pending, positions in parts
            for request, images, numbers in pending._reads
        ]
        return cls(parts[0][0]._context, parts[0][0]._buffers, reads)

    def done(self) -> bool:
        """Returns whether ``result`` would return without waiting."""
        self._context.make_current()
        return self._frames is not None or all(self._buffers.done(request) for request, _, _ in self._reads)

    def result(self) -> list[Frame]:
        """Returns the frames, in the order of the cameras; waits for the GPU the first time."""
        if self._frames is None:
            self._context.make_current()
            frames: dict[int, Frame] = {}
            for request, images, numbers in self._reads:
                frames.update(zip(numbers, self._buffers.frames(request, images), strict=True))
            self._frames = [frames[k] for k in sorted(frames)]
        return self._frames

    def discard(self) -> None:
        """Gives up the frames, which are not read."""
        for request, _, _ in self._reads:
            self._buffers.discard(request)
        self._reads, self._frames = (), []


def _layout(names: Sequence[str], width: int, height: int) -> tuple[tuple[tuple[str, int, tuple[int, ...]], ...], int]:
    """Returns (name, offset, shape) of consecutive images, and their size in bytes."""
    images, offset = [], 0
    for name in names:
        raw = RAW_FORMATS[name]
        shape = (height, width) if raw.channels == 1 else (height, width, raw.channels)
        images.append((name, offset, shape))
        size = width * height * raw.channels * np.dtype(raw.dtype).itemsize
        offset += -(-size // _ALIGNMENT) * _ALIGNMENT
    return tuple(images), offset
