"""Reads images back without waiting: the GPU copies into buffers of its own while the caller goes on, and a fence says when it is done.

``start`` asks for the copy and returns at once; ``finish`` waits for its fence and returns the arrays. Each copy has buffers of its
own from a ring, so several may be under way. A software renderer has no copy engine: there it costs the same as reading at once.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gibson_sim.errors import RenderError
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.target import ATTACHMENT, Target
from gibson_sim.render.readback.frames import Shot, frame_from_raw
from gibson_sim.types import Frame

_MAP_READ, _SYNC_GPU_COMMANDS_COMPLETE, _SYNC_FLUSH_COMMANDS = 0x0001, 0x9117, 0x00000001
_ALREADY_SIGNALED, _TIMEOUT_EXPIRED, _CONDITION_SATISFIED = 0x911A, 0x911B, 0x911C
_WAIT_NS = 1_000_000_000
_WAITS = 60


@dataclass(frozen=True, slots=True)
class RawFormat:
    """How an attachment stands in memory."""

    form: int
    """OpenGL's format of the pixels."""
    kind: int
    """OpenGL's type of each channel."""
    dtype: DTypeLike
    channels: int


RAW: dict[str, RawFormat] = {
    "color": RawFormat(GL.RGBA, GL.UNSIGNED_BYTE, np.uint8, 4),
    "depth": RawFormat(GL.DEPTH_COMPONENT, GL.FLOAT, np.float32, 1),
    "LABELS": RawFormat(GL.RG_INTEGER, GL.UNSIGNED_SHORT, np.uint16, 2),
    "NORMALS": RawFormat(GL.RGBA, GL.UNSIGNED_SHORT, np.uint16, 4),
    "FLOW": RawFormat(GL.RG, GL.FLOAT, np.float32, 2),
}
"""What each attachment of a Target is read back as."""


class GlBuffer:
    """Memory of the GPU.

    Args:
        context: where; it must be current in every call.
        size: bytes.
        usage: ``GL.STREAM_READ`` for what the host reads, ``GL.DYNAMIC_COPY`` for what only the GPU touches.

    Raises:
        RenderError: the driver has not that much memory.
    """

    def __init__(self, context: GlContext, size: int, usage: int) -> None:
        self.size = size
        self._gl = GL.Gl(context)
        self._gl.glGetError()
        self.name = self._gl.create("glCreateBuffers")
        """OpenGL's name of it."""
        self._gl.glNamedBufferData(self.name, size, None, usage)
        if self._gl.glGetError():
            self.close()
            raise RenderError(f"{context.device.renderer} has no {size / 1e6:.1f} MB for images; ask for smaller or fewer ones")

    def write(self, data: NDArray[Any]) -> None:
        """Fills it from its start."""
        assert data.nbytes <= self.size
        self._gl.glNamedBufferSubData(self.name, 0, data.nbytes, np.ascontiguousarray(data).ctypes.data)

    def map(self) -> int:
        """Returns the address at which the host can read it until ``unmap``; waits for the GPU."""
        address = self._gl.glMapNamedBufferRange(self.name, 0, self.size, _MAP_READ)
        if not address:
            raise RenderError(f"the driver cannot map {self.size} bytes (error 0x{self._gl.glGetError():x})")
        return int(address)

    def unmap(self) -> None:
        """Gives it back to the GPU."""
        self._gl.glUnmapNamedBuffer(self.name)

    def close(self) -> None:
        """Frees it; a second call does nothing."""
        if self.name:
            self._gl.delete("glDeleteBuffers", self.name)
            self.name = 0


class Ticket:
    """A copy that is under way. ``PixelBuffers.finish`` takes it once."""

    def __init__(self, buffer: GlBuffer, fence: int, images: tuple[tuple[str, int, tuple[int, ...]], ...]) -> None:
        self.buffer = buffer
        self.fence: int | None = fence
        """OpenGL's fence; None once finished."""
        self.images = images
        """Name, offset in bytes and shape of each image."""


class PixelBuffers:
    """Reads targets back while the caller goes on.

    Args:
        context: where; it must be current in every call.
    """

    def __init__(self, context: GlContext) -> None:
        self._context = context
        self._gl = GL.Gl(context)
        self._free: list[GlBuffer] = []
        self._under_way: list[Ticket] = []

    def start(self, target: Target, wanted: Sequence[str] | None = None) -> Ticket:
        """Asks for a copy of what has been drawn so far and returns at once; the target may be drawn into again.

        Args:
            target: what to read, with one sample a pixel.
            wanted: names of its textures; None = all.
        """
        names = tuple(wanted) if wanted is not None else tuple(target.textures)
        missing = [name for name in names if name not in target.textures]
        assert not missing, f"the target has no {missing}"
        assert target.samples == 1
        images, size = _layout(names, target.width, target.height)
        buffer = self._take(size)
        gl = self._gl
        gl.glBindFramebuffer(GL.READ_FRAMEBUFFER, target.framebuffer)
        gl.glBindBuffer(GL.PIXEL_PACK_BUFFER, buffer.name)
        gl.glPixelStorei(GL.PACK_ALIGNMENT, 1)
        for name, offset, _ in images:
            if name != "depth":
                gl.glNamedFramebufferReadBuffer(target.framebuffer, GL.COLOR_ATTACHMENT0 + ATTACHMENT[name])
            gl.glReadPixels(0, 0, target.width, target.height, RAW[name].form, RAW[name].kind, offset)
        # Left bound, later reads to host memory would take their address for an offset in this buffer.
        gl.glBindBuffer(GL.PIXEL_PACK_BUFFER, 0)
        ticket = Ticket(buffer, int(gl.glFenceSync(_SYNC_GPU_COMMANDS_COMPLETE, 0)), images)
        self._under_way.append(ticket)
        return ticket

    def done(self, ticket: Ticket) -> bool:
        """Returns whether ``finish`` would not have to wait."""
        return ticket.fence is None or self._wait(ticket.fence, 0) != _TIMEOUT_EXPIRED

    def finish(self, ticket: Ticket) -> dict[str, NDArray[Any]]:
        """Returns the images, row 0 = top, in arrays that belong to the caller.

        ``color`` (H, W, 4) uint8 sRGB and alpha; ``depth`` (H, W) float32, near / z, 0 = nothing; ``LABELS`` (H, W, 2) uint16;
        ``NORMALS`` (H, W, 4) uint16; ``FLOW`` (H, W, 2) float32.

        Raises:
            RenderError: the ticket is finished already, or the GPU does not answer.
        """
        with self._mapped(ticket) as images:
            return {name: image.copy() for name, image in images.items()}

    def frames(self, ticket: Ticket, shots: Sequence[Shot]) -> list[Frame]:
        """Returns the frames of the images in a target that was read whole or in the parts that they need, as ``finish``."""
        with self._mapped(ticket) as images:
            return [frame_from_raw(shot, images) for shot in shots]

    @contextmanager
    def _mapped(self, ticket: Ticket) -> Iterator[dict[str, NDArray[Any]]]:
        """Waits for the images and shows them where the GPU put them; the ticket is used up."""
        if ticket.fence is None:
            raise RenderError("these images were fetched already, or their pixel buffers are closed; start a new read")
        self._wait_for(ticket.fence)
        self._retire(ticket)
        memory = memoryview((ctypes.c_uint8 * ticket.buffer.size).from_address(ticket.buffer.map()))
        try:
            yield {
                name: np.frombuffer(memory, RAW[name].dtype, math.prod(shape), at).reshape(shape)
                for name, at, shape in ticket.images
            }
        finally:
            ticket.buffer.unmap()
            self._free.append(ticket.buffer)

    def _take(self, size: int) -> GlBuffer:
        """Returns a buffer of this size that nothing is using."""
        fitting = [b for b in self._free if b.size == size]
        if fitting:
            self._free.remove(fitting[-1])
            return fitting[-1]
        # Sizes change with the cameras: what waits for an old size is freed rather than hoarded.
        while len(self._free) > 8:
            self._free.pop(0).close()
        return GlBuffer(self._context, size, GL.STREAM_READ)

    def _wait(self, fence: int, timeout_ns: int) -> int:
        return int(self._gl.glClientWaitSync(fence, _SYNC_FLUSH_COMMANDS, timeout_ns))

    def _wait_for(self, fence: int) -> None:
        for _ in range(_WAITS):
            answer = self._wait(fence, _WAIT_NS)
            if answer in (_ALREADY_SIGNALED, _CONDITION_SATISFIED):
                return
            if answer != _TIMEOUT_EXPIRED:
                break
        raise RenderError(
            f"{self._context.device.renderer} does not finish drawing (0x{answer:x}); was the GPU reset? start again"
        )

    def _retire(self, ticket: Ticket) -> None:
        if ticket.fence is not None:
            self._gl.glDeleteSync(ticket.fence)
            ticket.fence = None
        if ticket in self._under_way:
            self._under_way.remove(ticket)

    def close(self) -> None:
        """Frees everything, copies that are under way too; a second call does nothing."""
        for ticket in list(self._under_way):
            self._retire(ticket)
            self._free.append(ticket.buffer)
        for buffer in self._free:
            buffer.close()
        self._free = []


class Pending:
    """Frames that are drawn and on their way: ask for the next ones before taking these.

    Args:
        context: where they were drawn.
        buffers: what reads them.
        reads: for each target, its ticket, its images, and the number of each image in the result.
    """

    def __init__(
        self, context: GlContext, buffers: PixelBuffers, reads: Sequence[tuple[Ticket, Sequence[Shot], Sequence[int]]]
    ) -> None:
        self._context, self._buffers, self._reads = context, buffers, tuple(reads)
        self._frames: list[Frame] | None = None

    def done(self) -> bool:
        """Returns whether ``result`` would not have to wait."""
        self._context.make_current()
        return self._frames is not None or all(self._buffers.done(ticket) for ticket, _, _ in self._reads)

    def result(self) -> list[Frame]:
        """Returns the frames, in the order of the cameras; waits for the GPU the first time."""
        if self._frames is None:
            self._context.make_current()
            found: dict[int, Frame] = {}
            for ticket, shots, numbers in self._reads:
                found.update(zip(numbers, self._buffers.frames(ticket, shots), strict=True))
            self._frames = [found[k] for k in sorted(found)]
        return self._frames


def _layout(names: Sequence[str], width: int, height: int) -> tuple[tuple[tuple[str, int, tuple[int, ...]], ...], int]:
    """Returns (name, offset, shape) of each image one behind the other, and how many bytes they take."""
    images, offset = [], 0
    for name in names:
        raw = RAW[name]
        shape = (height, width) if raw.channels == 1 else (height, width, raw.channels)
        images.append((name, offset, shape))
        size = width * height * raw.channels * np.dtype(raw.dtype).itemsize
        offset += -(-size // 256) * 256  # 256: what no driver finds badly aligned
    return tuple(images), offset
