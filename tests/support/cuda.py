"""CUDA that is not there: the driver's rules, kept with host memory, so that its use can be tested without a GPU."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import RenderError
from gibson_sim.render.context import GlContext
from gibson_sim.render.readback.cuda import CudaDevice

DLPACK_CPU = 1


@dataclass
class FakeCuda:
    """Implements ``CudaDriver``. Mapping really maps the OpenGL buffer, so that copies move real bytes."""

    context: GlContext
    found: list[CudaDevice]
    gl_ordinals: list[int] = field(default_factory=list)
    dlpack_type: int = DLPACK_CPU

    def __post_init__(self) -> None:
        u, size = ctypes.c_uint, ctypes.c_ssize_t
        self._map = self.context.egl.function("glMapNamedBufferRange", ctypes.c_void_p, u, size, size, u)
        self._unmap = self.context.egl.function("glUnmapNamedBuffer", ctypes.c_ubyte, u)
        self._size_of = self.context.egl.function("glGetNamedBufferParameteriv", None, u, u, ctypes.c_void_p)
        self.opened: int | None = None
        self.registered: dict[int, int] = {}
        self.registrations = 0
        self.writable: set[int] = set()
        self.mapped: set[int] = set()
        self.memory: dict[int, ctypes.Array[ctypes.c_char]] = {}
        self.freed: list[int] = []
        self.calls: list[str] = []

    def devices(self) -> list[CudaDevice]:
        return self.found

    def current_gl_devices(self) -> list[int]:
        return self.gl_ordinals

    def open(self, ordinal: int) -> None:
        self.opened = ordinal

    def register(self, buffer: int, *, writable: bool) -> int:
        assert self.opened is not None
        assert buffer not in self.registered.values(), "registered twice"
        self.registrations += 1
        self.registered[self.registrations] = buffer
        if writable:
            self.writable.add(buffer)
        return self.registrations

    def unregister(self, handle: int) -> None:
        assert handle not in self.mapped, "unregistered while mapped"
        del self.registered[handle]

    def map(self, handle: int, stream: int) -> tuple[int, int]:
        assert handle not in self.mapped, "mapped twice"
        self.mapped.add(handle)
        self.calls.append("map")
        buffer, size = self.registered[handle], ctypes.c_int(0)
        self._size_of(buffer, 0x8764, ctypes.addressof(size))
        return int(self._map(buffer, 0, size.value, 3 if buffer in self.writable else 1)), size.value

    def unmap(self, handle: int, stream: int) -> None:
        self.mapped.remove(handle)
        self.calls.append("unmap")
        self._unmap(self.registered[handle])

    def copy(self, destination: int, source: int, nbytes: int, stream: int) -> None:
        assert self.mapped, "copied from a buffer that is not mapped"
        self.calls.append("copy")
        ctypes.memmove(destination, source, nbytes)

    def synchronize(self, stream: int) -> None:
        self.calls.append("synchronize")

    def allocate(self, nbytes: int) -> int:
        memory = ctypes.create_string_buffer(nbytes)
        self.memory[ctypes.addressof(memory)] = memory
        return ctypes.addressof(memory)

    def free(self, address: int) -> None:
        if address not in self.memory:
            raise RenderError("freed twice")
        self.freed.append(address)
        del self.memory[address]


def fake_cuda(context: GlContext, **changes: object) -> FakeCuda:
    """Returns CUDA with one device: the one that the context draws on."""
    return FakeCuda(context, [CudaDevice(0, "pretended", context.device.uuid)], **changes)  # type: ignore[arg-type]


def fetched(tensor: Any) -> NDArray[Any]:
    """Returns what stands in a tensor on the GPU, by PyTorch if it is one of its own, else by CUDA's plain copy."""
    if hasattr(tensor, "cpu"):
        return np.asarray(tensor.cpu().numpy())
    from cuda.bindings import runtime

    out = np.empty(tensor.shape, dtype=tensor.dtype)
    to_host = runtime.cudaMemcpyKind.cudaMemcpyDeviceToHost
    (status,) = runtime.cudaMemcpy(out.ctypes.data, tensor.address, out.nbytes, to_host)
    assert status == runtime.cudaError_t.cudaSuccess
    return out
