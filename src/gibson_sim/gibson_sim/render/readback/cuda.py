"""Shares OpenGL buffers with CUDA on the same GPU: copies them to CUDA memory, or gives CUDA their addresses.

Only ``CudaPython`` needs an NVIDIA GPU and the package ``cuda-bindings`` (``pip install 'gibson_sim[cuda]'``). ``CudaLink`` uses CUDA through
``CudaDriver``, a dozen functions, so that it can be tested without a GPU.

CUDA's requirements: the OpenGL context is current on the calling thread (by the caller); the CUDA device is the one that OpenGL draws on,
found by its UUID (``find_device``); a buffer is registered once and mapped for each copy, which makes CUDA wait for OpenGL, and unmapped
before OpenGL writes to it again (``CudaLink.copy``). The current CUDA device of the caller's thread does not change.
https://docs.nvidia.com/cuda/cuda-driver-api/group__CUDA__GL.html
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

from gibson_sim.errors import GraphicsUnavailableError, RenderError
from gibson_sim.render.context import EglDevice, GlContext, format_uuid
from gibson_sim.render.readback.pixel_buffers import GlBuffer

_log = logging.getLogger(__name__)
DLPACK_CUDA = 2
"""DLPack device type ``kDLCUDA``."""
_READ_WRITE, _READ_ONLY = 0, 1


@dataclass(frozen=True, slots=True)
class CudaDevice:
    """A GPU as listed by CUDA; ``CUDA_VISIBLE_DEVICES`` changes ordinals but not UUIDs."""

    ordinal: int
    name: str
    uuid: str
    """UUID in the format of ``format_uuid``."""


class CudaDriver(Protocol):
    """The required CUDA functions. Every function may raise ``RenderError``."""

    dlpack_type: int
    """DLPack device type of the memory that ``allocate`` returns."""

    def devices(self) -> list[CudaDevice]:
        """Returns all GPUs visible to CUDA in this process."""

    def current_gl_devices(self) -> list[int]:
        """Returns the ordinals of the GPUs that the current OpenGL context draws on; empty if CUDA cannot determine them."""

    def open(self, ordinal: int) -> None:
        """Selects the device of all further calls."""

    def register(self, buffer: int, *, writable: bool) -> Any:
        """Registers an OpenGL buffer for reading, and if ``writable`` for writing, by CUDA, and returns its handle."""

    def unregister(self, handle: Any) -> None:
        """Unregisters a buffer."""

    def map(self, handle: Any, stream: int) -> tuple[int, int]:
        """Maps a buffer and returns its address and size; later work of ``stream`` waits for all earlier work of OpenGL."""

    def unmap(self, handle: Any, stream: int) -> None:
        """Unmaps a buffer; later work of OpenGL waits for all earlier work of ``stream``."""

    def copy(self, destination: int, source: int, nbytes: int, stream: int) -> None:
        """Enqueues a copy within the device in the stream."""

    def synchronize(self, stream: int) -> None:
        """Waits for all work of the stream."""

    def allocate(self, nbytes: int) -> int:
        """Allocates device memory and returns its address."""

    def free(self, address: int) -> None:
        """Frees memory after all work that uses it has ended; may be called until the process ends."""


class CudaPython:
    """CUDA through ``cuda.bindings.driver``, in the device's primary context, which PyTorch, JAX and CuPy use too.

    Like these libraries, it keeps the context until the process ends: tensors may outlive the renderer.

    Raises:
        GraphicsUnavailableError: the package, the driver or the GPU is missing.
    """

    dlpack_type = DLPACK_CUDA

    def __init__(self) -> None:
        try:
            from cuda.bindings import driver
        except ImportError as e:
            raise GraphicsUnavailableError(f"CUDA is not available: {e}; pip install 'gibson_sim[cuda]'") from e
        self._cuda: Any = driver
        self._context: Any = None
        try:
            self._call("cuInit", 0)
        except (RenderError, RuntimeError) as e:  # the bindings raise RuntimeError without a driver
            raise GraphicsUnavailableError(
                f"CUDA is not available: {e}; is NVIDIA's driver installed and the GPU visible?"
            ) from e

    def _call(self, name: str, *arguments: Any) -> Any:
        """Calls a driver function, checks its status and returns its other results: a value, or a tuple."""
        status, *values = getattr(self._cuda, name)(*arguments)
        if status != self._cuda.CUresult.CUDA_SUCCESS:
            raise RenderError(f"CUDA function {name} failed: {getattr(status, 'name', status)}")
        return values[0] if len(values) == 1 else tuple(values)

    @contextmanager
    def _current(self) -> Iterator[None]:
        self._call("cuCtxPushCurrent", self._context)
        try:
            yield
        finally:
            self._call("cuCtxPopCurrent")

    def devices(self) -> list[CudaDevice]:
        """See ``CudaDriver``."""
        devices = []
        for ordinal in range(self._call("cuDeviceGetCount")):
            device = self._call("cuDeviceGet", ordinal)
            name = self._call("cuDeviceGetName", 256, device)
            devices.append(
                CudaDevice(
                    ordinal, name.split(b"\0")[0].decode(), format_uuid(bytes(self._call("cuDeviceGetUuid", device).bytes))
                )
            )
        return devices

    def current_gl_devices(self) -> list[int]:
        """See ``CudaDriver``."""
        everything = self._cuda.CUGLDeviceList.CU_GL_DEVICE_LIST_ALL
        try:
            count, devices = self._call("cuGLGetDevices", 16, everything)
        except RenderError as e:
            _log.debug("%s", e)
            return []
        return [int(device) for device in devices[:count]]

    def open(self, ordinal: int) -> None:
        """See ``CudaDriver``."""
        self._context = self._call("cuDevicePrimaryCtxRetain", self._call("cuDeviceGet", ordinal))

    def register(self, buffer: int, *, writable: bool) -> Any:
        """See ``CudaDriver``."""
        with self._current():
            return self._call("cuGraphicsGLRegisterBuffer", buffer, _READ_WRITE if writable else _READ_ONLY)

    def unregister(self, handle: Any) -> None:
        """See ``CudaDriver``."""
        with self._current():
            self._call("cuGraphicsUnregisterResource", handle)

    def map(self, handle: Any, stream: int) -> tuple[int, int]:
        """See ``CudaDriver``."""
        with self._current():
            self._call("cuGraphicsMapResources", 1, handle, stream)
            address, size = self._call("cuGraphicsResourceGetMappedPointer", handle)
            return int(address), int(size)

    def unmap(self, handle: Any, stream: int) -> None:
        """See ``CudaDriver``."""
        with self._current():
            self._call("cuGraphicsUnmapResources", 1, handle, stream)

    def copy(self, destination: int, source: int, nbytes: int, stream: int) -> None:
        """See ``CudaDriver``."""
        with self._current():
            self._call("cuMemcpyDtoDAsync", destination, source, nbytes, stream)

    def synchronize(self, stream: int) -> None:
        """See ``CudaDriver``."""
        with self._current():
            self._call("cuStreamSynchronize", stream)

    def allocate(self, nbytes: int) -> int:
        """See ``CudaDriver``."""
        with self._current():
            return int(self._call("cuMemAlloc", nbytes))

    def free(self, address: int) -> None:
        """See ``CudaDriver``."""
        with self._current():
            self._call("cuMemFree", address)


def find_device(drawing: EglDevice, devices: Sequence[CudaDevice], gl_ordinals: Sequence[int] = ()) -> CudaDevice:
    """Returns the CUDA device that OpenGL draws on: the one with the same UUID, else the one that CUDA reports.

    Args:
        drawing: device of the OpenGL context.
        devices: all devices visible to CUDA.
        gl_ordinals: ``CudaDriver.current_gl_devices`` of the context.

    Raises:
        GraphicsUnavailableError: the device of the context is not visible to CUDA.
    """
    same = [d for d in devices if drawing.uuid and d.uuid == drawing.uuid] or [d for d in devices if d.ordinal in gl_ordinals]
    if not drawing.uuid:  # an old driver
        same = same or [d for d in devices if d.ordinal == drawing.cuda_ordinal]
    if same:
        return same[0]
    known = ", ".join(f"{d.ordinal}: {d.name} {d.uuid}" for d in devices) or "none"
    raise GraphicsUnavailableError(
        f"EGL device {drawing.index} ({drawing.renderer}, UUID {drawing.uuid or 'unknown'}) is none of CUDA's devices ({known}): draw on "
        "one of these (see `gibson-sim doctor`), or add this device to CUDA_VISIBLE_DEVICES"
    )


def cuda_of(context: GlContext) -> CudaDriver | None:
    """Returns CUDA if the context draws on an NVIDIA GPU and CUDA is installed; warns if only the package is missing."""
    if context.device.software or "nvidia" not in context.device.vendor.lower():
        return None
    try:
        return CudaPython()
    except GraphicsUnavailableError as e:
        _log.warning("tensors and hole-filling networks use the CPU: %s", e)
        return None


class CudaLink:
    """Shares OpenGL buffers with CUDA on the same GPU. A buffer is either copied or mapped, never both.

    Args:
        context: context of the buffers; it must be current in every call.
        driver: CUDA functions.

    Raises:
        GraphicsUnavailableError: the GPU that the context draws on is not visible to CUDA.
    """

    def __init__(self, context: GlContext, driver: CudaDriver) -> None:
        self.driver = driver
        self.device = find_device(context.device, driver.devices(), driver.current_gl_devices())
        self._handles: dict[int, Any] = {}
        driver.open(self.device.ordinal)

    def copy(self, buffer: GlBuffer, nbytes: int, destination: int, stream: int = 0) -> None:
        """Enqueues a copy of the first bytes of a buffer, after all earlier work of OpenGL, without waiting.

        Args:
            buffer: OpenGL buffer, registered at its first copy.
            nbytes: number of bytes.
            destination: address of CUDA memory.
            stream: CUDA stream of the copy; later OpenGL writes to the buffer wait for it.

        Raises:
            RenderError: a CUDA function fails.
        """
        handle = self._registered(buffer, writable=False)
        source, size = self.driver.map(handle, stream)
        try:
            if size < nbytes:
                raise RenderError(
                    f"CUDA sees {size} bytes of an OpenGL buffer of {buffer.size}; {nbytes} are needed: update the driver"
                )
            self.driver.copy(destination, source, nbytes, stream)
        finally:
            self.driver.unmap(handle, stream)

    @contextmanager
    def mapped(self, buffers: Sequence[GlBuffer]) -> Iterator[list[int]]:
        """Lends buffers to CUDA for reading and writing, and yields their addresses, once all earlier work of OpenGL has ended.

        CUDA's work on them must have ended at the end of the block.

        Raises:
            RenderError: a CUDA function fails.
        """
        addresses: list[int] = []
        with ExitStack() as stack:
            for buffer in buffers:
                handle = self._registered(buffer, writable=True)
                address, size = self.driver.map(handle, 0)
                stack.callback(self.driver.unmap, handle, 0)
                if size < buffer.size:
                    raise RenderError(f"CUDA sees {size} bytes of an OpenGL buffer of {buffer.size}: update the driver")
                addresses.append(address)
            self.driver.synchronize(0)
            yield addresses

    def _registered(self, buffer: GlBuffer, *, writable: bool) -> Any:
        if buffer.name not in self._handles:
            self._handles[buffer.name] = self.driver.register(buffer.name, writable=writable)
        return self._handles[buffer.name]

    def forget(self, buffer: GlBuffer) -> None:
        """Unregisters a buffer; call this before freeing it."""
        if buffer.name in self._handles:
            self.driver.unregister(self._handles.pop(buffer.name))

    def close(self) -> None:
        """Unregisters all buffers; a second call does nothing. Allocated memory remains until it is freed."""
        while self._handles:
            self.driver.unregister(self._handles.popitem()[1])
