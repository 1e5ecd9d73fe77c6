"""Copies OpenGL buffers to CUDA memory inside the GPU.

``CudaLink`` needs an NVIDIA GPU and the package ``cuda-bindings`` (``pip install gibson-sim[cuda]``); nothing else here does. CUDA is
used through ``CudaDriver``, a dozen functions, so that everything around them can be tested without a GPU.

CUDA's requirements, and where they are met: OpenGL's context is current on the calling thread (the caller does this); the CUDA device is
the one that OpenGL draws on, found by its UUID (``find_device``); a buffer is registered once and mapped for each copy, which also makes
CUDA wait for OpenGL's drawing; it is unmapped before OpenGL writes to it again (``CudaLink.copy``). The current CUDA device of the
caller's thread does not change. https://docs.nvidia.com/cuda/cuda-driver-api/group__CUDA__GL.html
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

from gibson_sim.errors import GraphicsUnavailableError, RenderError
from gibson_sim.render.context import EglDevice, GlContext, format_uuid
from gibson_sim.render.readback.pixel_buffers import GlBuffer

_log = logging.getLogger(__name__)
DLPACK_CUDA = 2
"""DLPack's number for memory of a CUDA device."""
_READ_ONLY = 1


@dataclass(frozen=True, slots=True)
class CudaDevice:
    """A GPU as CUDA numbers them; ``CUDA_VISIBLE_DEVICES`` changes the numbers but not the UUIDs."""

    ordinal: int
    name: str
    uuid: str
    """32 hexadecimal digits in the groups of a UUID."""


class CudaDriver(Protocol):
    """The part of CUDA that is needed. Every function may raise ``RenderError``."""

    dlpack_type: int
    """DLPack's number for the memory that ``allocate`` returns."""

    def devices(self) -> list[CudaDevice]:
        """Returns all GPUs that are visible to CUDA in this process."""

    def current_gl_devices(self) -> list[int]:
        """Returns the ordinals of the GPUs that the current OpenGL context draws on; empty if CUDA does not know."""

    def open(self, ordinal: int) -> None:
        """Selects the device of all further calls."""

    def register(self, buffer: int) -> Any:
        """Returns a handle for an OpenGL buffer that CUDA will read."""

    def unregister(self, handle: Any) -> None:
        """Unregisters it."""

    def map(self, handle: Any, stream: int) -> tuple[int, int]:
        """Returns address and size of the buffer; later work of ``stream`` sees all earlier work of OpenGL."""

    def unmap(self, handle: Any, stream: int) -> None:
        """Returns it to OpenGL, whose later work comes after all earlier work of ``stream``."""

    def copy(self, destination: int, source: int, nbytes: int, stream: int) -> None:
        """Copies inside the device, in the order of the stream."""

    def synchronize(self, stream: int) -> None:
        """Waits for all work of the stream."""

    def allocate(self, nbytes: int) -> int:
        """Returns the address of new memory."""

    def free(self, address: int) -> None:
        """Frees memory once all work that uses it has ended; works until the process ends."""


class CudaPython:
    """CUDA through ``cuda.bindings.driver``, in the device's primary context, which PyTorch, JAX and CuPy use too.

    Like those, it keeps the context until the process ends: tensors may outlive the renderer that made them.

    Raises:
        GraphicsUnavailableError: the package, the driver or the GPU is missing.
    """

    dlpack_type = DLPACK_CUDA

    def __init__(self) -> None:
        try:
            from cuda.bindings import driver
        except ImportError as e:
            raise GraphicsUnavailableError(f"no CUDA here: {e}; pip install gibson-sim[cuda]") from e
        self._cuda: Any = driver
        self._context: Any = None
        try:
            self._call("cuInit", 0)
        except (RenderError, RuntimeError) as e:  # the bindings raise RuntimeError without a driver
            raise GraphicsUnavailableError(f"no CUDA here: {e}; is NVIDIA's driver installed and the GPU visible?") from e

    def _call(self, name: str, *arguments: Any) -> Any:
        """Calls a function of the driver and returns its results without the status: a value, or a tuple."""
        status, *values = getattr(self._cuda, name)(*arguments)
        if status != self._cuda.CUresult.CUDA_SUCCESS:
            raise RenderError(f"CUDA refuses {name}: {getattr(status, 'name', status)}")
        return values[0] if len(values) == 1 else tuple(values)

    @contextmanager
    def _current(self) -> Iterator[None]:
        self._call("cuCtxPushCurrent", self._context)
        try:
            yield
        finally:
            self._call("cuCtxPopCurrent")

    def devices(self) -> list[CudaDevice]:
        """As in ``CudaDriver``."""
        found = []
        for ordinal in range(self._call("cuDeviceGetCount")):
            device = self._call("cuDeviceGet", ordinal)
            name = self._call("cuDeviceGetName", 256, device)
            found.append(
                CudaDevice(
                    ordinal, name.split(b"\0")[0].decode(), format_uuid(bytes(self._call("cuDeviceGetUuid", device).bytes))
                )
            )
        return found

    def current_gl_devices(self) -> list[int]:
        """As in ``CudaDriver``."""
        everything = self._cuda.CUGLDeviceList.CU_GL_DEVICE_LIST_ALL
        try:
            count, devices = self._call("cuGLGetDevices", 16, everything)
        except RenderError as e:
            _log.debug("%s", e)
            return []
        return [int(device) for device in devices[:count]]

    def open(self, ordinal: int) -> None:
        """As in ``CudaDriver``."""
        self._context = self._call("cuDevicePrimaryCtxRetain", self._call("cuDeviceGet", ordinal))

    def register(self, buffer: int) -> Any:
        """As in ``CudaDriver``."""
        with self._current():
            return self._call("cuGraphicsGLRegisterBuffer", buffer, _READ_ONLY)

    def unregister(self, handle: Any) -> None:
        """As in ``CudaDriver``."""
        with self._current():
            self._call("cuGraphicsUnregisterResource", handle)

    def map(self, handle: Any, stream: int) -> tuple[int, int]:
        """As in ``CudaDriver``."""
        with self._current():
            self._call("cuGraphicsMapResources", 1, handle, stream)
            address, size = self._call("cuGraphicsResourceGetMappedPointer", handle)
            return int(address), int(size)

    def unmap(self, handle: Any, stream: int) -> None:
        """As in ``CudaDriver``."""
        with self._current():
            self._call("cuGraphicsUnmapResources", 1, handle, stream)

    def copy(self, destination: int, source: int, nbytes: int, stream: int) -> None:
        """As in ``CudaDriver``."""
        with self._current():
            self._call("cuMemcpyDtoDAsync", destination, source, nbytes, stream)

    def synchronize(self, stream: int) -> None:
        """As in ``CudaDriver``."""
        with self._current():
            self._call("cuStreamSynchronize", stream)

    def allocate(self, nbytes: int) -> int:
        """As in ``CudaDriver``."""
        with self._current():
            return int(self._call("cuMemAlloc", nbytes))

    def free(self, address: int) -> None:
        """As in ``CudaDriver``."""
        with self._current():
            self._call("cuMemFree", address)


def find_device(drawing: EglDevice, devices: Sequence[CudaDevice], gl_ordinals: Sequence[int] = ()) -> CudaDevice:
    """Returns the CUDA device that OpenGL draws on: the one with the same UUID, else the one that CUDA reports.

    Args:
        drawing: the device of the OpenGL context.
        devices: all that are visible to CUDA.
        gl_ordinals: ``CudaDriver.current_gl_devices`` of the context.

    Raises:
        GraphicsUnavailableError: it is none of them.
    """
    same = [d for d in devices if drawing.uuid and d.uuid == drawing.uuid] or [d for d in devices if d.ordinal in gl_ordinals]
    if not drawing.uuid:  # an old driver
        same = same or [d for d in devices if d.ordinal == drawing.cuda_ordinal]
    if same:
        return same[0]
    known = ", ".join(f"{d.ordinal}: {d.name} {d.uuid}" for d in devices) or "none"
    raise GraphicsUnavailableError(
        f"EGL device {drawing.index} ({drawing.renderer}, UUID {drawing.uuid or 'unknown'}) is none of CUDA's devices ({known}): draw on "
        "one of those (see `gibson-sim doctor`), or let CUDA_VISIBLE_DEVICES show this one"
    )


class CudaLink:
    """Copies OpenGL buffers to CUDA memory of the same GPU.

    Args:
        context: where the buffers are; it must be current in every call.
        driver: CUDA.

    Raises:
        GraphicsUnavailableError: the GPU that the context draws on is not visible to CUDA.
    """

    def __init__(self, context: GlContext, driver: CudaDriver) -> None:
        self.driver = driver
        self.device = find_device(context.device, driver.devices(), driver.current_gl_devices())
        self._handles: dict[int, Any] = {}
        driver.open(self.device.ordinal)

    def copy(self, buffer: GlBuffer, nbytes: int, destination: int, stream: int = 0) -> None:
        """Enqueues a copy of the first bytes of a buffer, after all earlier work of OpenGL, and returns at once.

        Args:
            buffer: it is registered at its first copy.
            nbytes: number of bytes.
            destination: address of CUDA memory.
            stream: CUDA stream of the copy; OpenGL writes to the buffer again only after it.
        """
        if buffer.name not in self._handles:
            self._handles[buffer.name] = self.driver.register(buffer.name)
        handle = self._handles[buffer.name]
        source, size = self.driver.map(handle, stream)
        try:
            if size < nbytes:
                raise RenderError(
                    f"CUDA sees {size} bytes of an OpenGL buffer of {buffer.size}; {nbytes} are needed: update the driver"
                )
            self.driver.copy(destination, source, nbytes, stream)
        finally:
            self.driver.unmap(handle, stream)

    def forget(self, buffer: GlBuffer) -> None:
        """Unregisters a buffer, which must happen before it is freed."""
        if buffer.name in self._handles:
            self.driver.unregister(self._handles.pop(buffer.name))

    def close(self) -> None:
        """Unregisters all buffers; a second call does nothing. Allocated memory stays until it is freed."""
        while self._handles:
            self.driver.unregister(self._handles.popitem()[1])
