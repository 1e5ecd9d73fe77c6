"""Frames as tensors: on the rendering GPU if CUDA is available, without a copy through the host; else on the CPU.

The type of tensor depends on the installed packages, never on the images:

* NVIDIA GPU, ``cuda-bindings``, PyTorch with CUDA: ``torch.Tensor`` on that GPU;
* NVIDIA GPU, ``cuda-bindings``: ``DeviceArray``, which JAX, CuPy and others read by DLPack;
* else PyTorch: ``torch.Tensor`` on the CPU;
* else NumPy arrays, which support DLPack too.

All values equal those of ``Frame``. PyTorch is optional and imported lazily, because only PyTorch can allocate its tensors.

``DeviceArray`` serves any library that reads DLPack (PyTorch, JAX, CuPy, NumPy), without depending on one of them. It uses the structures of
DLPack before version 1, which all these libraries read. https://dmlc.github.io/dlpack/latest/c_api.html
"""

from __future__ import annotations

import ctypes
import logging
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import RenderError
from gibson_sim.render.context import GlContext
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.render.readback.cuda import CudaDriver, CudaLink, cuda_of
from gibson_sim.render.readback.frames import TargetImage
from gibson_sim.render.readback.packing import ORDER, Packer, Stack
from gibson_sim.types import CameraSpec, Frame

_log = logging.getLogger(__name__)
_CODES = {"i": 0, "u": 1, "f": 2}
_NAME = b"dltensor"


@dataclass(frozen=True, slots=True, eq=False)
class TensorFrame:
    """The images of one camera at one tick, in tensors that belong to the caller. Shapes, types and values are those of ``Frame``.

    The tensors of one call share one block of memory, which is freed with the last of them.
    """

    camera: CameraSpec
    stamp_ns: int
    T_world_camera: NDArray[np.float64]
    """(4, 4), pose of the optical frame, on the host."""
    rgb: Any = None
    """(height, width, 3) uint8."""
    depth: Any = None
    """(height, width) float32, metres, +inf = nothing."""
    semantic: Any = None
    """(height, width) uint16. PyTorch supports few operations on this type; ``.long()`` converts it to indices."""
    instance: Any = None
    """(height, width) uint16."""
    normal: Any = None
    """(height, width, 3) float32, optical frame."""
    normal_world: Any = None
    """(height, width, 3) float32, world frame."""
    position: Any = None
    """(height, width, 3) float32, world frame, metres, NaN = nothing."""
    flow: Any = None
    """(height, width, 2) float32, pixels, NaN = nothing."""
    hole: Any = None
    """(height, width) uint8, see ``filling.holes``."""


class Tensors:
    """Converts images drawn in one context to tensors.

    Args:
        context: context of the images; it must be current in every call.
        driver: CUDA functions; None = NVIDIA's CUDA if it is available.

    Raises:
        GraphicsUnavailableError: CUDA is available and the context is on an NVIDIA GPU, but CUDA does not list it.
    """

    def __init__(self, context: GlContext, driver: CudaDriver | None = None) -> None:
        self._torch = _import_torch()
        self._link: CudaLink | None = None
        self._packer: Packer | None = None
        driver = driver or cuda_of(context)
        if driver is not None:
            self._link = CudaLink(context, driver)
            self._packer = Packer(context, on_free=self._link.forget)
        cuda = self._torch is not None and driver is not None and _has_device(self._torch, self._link, driver)
        self._allocates = self._torch if cuda else None
        self.device = "cpu" if self._link is None else f"cuda:{self._link.device.ordinal}"
        """Device of the tensors, in PyTorch's notation."""

    @property
    def on_gpu(self) -> bool:
        """Whether tensors are on the GPU, so that ``of_target`` is used; otherwise ``of_frames`` is used."""
        return self._link is not None

    def of_target(self, target: RenderTarget, images: Sequence[TargetImage]) -> list[TensorFrame]:
        """Returns the images of a target as tensors on the GPU.

        With PyTorch the call does not wait for the GPU: the tensors are ready in the order of PyTorch's current stream.

        Raises:
            RenderError: the object is closed, CUDA is not available, or the GPU is out of memory.
        """
        if self._packer is None or self._link is None:
            raise RenderError("CUDA is not available, or the tensors are closed; use of_frames")
        if not images:
            return []
        buffer, stacks, size = self._packer.pack(target, images)
        arrays: list[dict[str, Any]] = [{} for _ in images]
        if self._allocates is not None:
            torch, device = self._allocates, _torch_device(self._link)
            memory = torch.empty(size, dtype=torch.uint8, device=device)
            stream = torch.cuda.current_stream(device).cuda_stream if device.type == "cuda" else 0
            self._link.copy(buffer, size, memory.data_ptr(), stream)
            for stack, tensors in _torch_views(memory, stacks, torch):
                for k, array in zip(stack.cameras, tensors, strict=True):
                    arrays[k][stack.output] = array
        else:
            driver = self._link.driver
            block = Memory(driver.allocate(size), (driver.dlpack_type, self._link.device.ordinal), driver.free)
            self._link.copy(buffer, size, block.address)
            driver.synchronize(0)
            for stack in stacks:
                for i, k in enumerate(stack.cameras):
                    arrays[k][stack.output] = DeviceArray(
                        block, stack.offset + i * stack.stride, np.dtype(stack.type_name), stack.shape
                    )
        return [TensorFrame(s.camera, s.stamp_ns, s.T_world_camera, **a) for s, a in zip(images, arrays, strict=True)]

    def of_frames(self, frames: Sequence[Frame]) -> list[TensorFrame]:
        """Returns frames as tensors on the CPU that share the frames' memory."""
        return [tensors_of_frame(frame, self._torch) for frame in frames]

    def close(self) -> None:
        """Frees everything except the callers' tensors; a second call does nothing. The context must be current."""
        packer, link, self._packer, self._link = self._packer, self._link, None, None
        if packer is not None:
            packer.close()
        if link is not None:
            link.close()


def tensors_of_frame(frame: Frame, torch: Any = None) -> TensorFrame:
    """Returns a frame as tensors on the CPU that share its memory: PyTorch tensors if ``torch`` is given, else its NumPy arrays."""
    arrays = {name: getattr(frame, name) for name in ORDER if getattr(frame, name) is not None}
    if torch is not None:
        arrays = {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in arrays.items()}
    return TensorFrame(frame.camera, frame.stamp_ns, frame.T_world_camera, **arrays)


def _import_torch() -> Any:
    """Returns PyTorch, or None if it is not installed or too old for 16-bit labels."""
    try:
        import torch
    except ImportError:
        return None
    if not hasattr(torch, "uint16"):
        _log.warning("PyTorch %s has no uint16: images are exported by DLPack instead; install 2.3 or later", torch.__version__)
        return None
    return torch


def _has_device(torch: Any, link: CudaLink | None, driver: CudaDriver) -> bool:
    """Returns whether the installed PyTorch can allocate on the CUDA device; CPU-only builds cannot."""
    return link is not None and (_torch_device(link).type == "cpu" or bool(torch.cuda.is_available()))


def _torch_device(link: CudaLink) -> Any:
    import torch

    return torch.device("cpu") if link.driver.dlpack_type == 1 else torch.device("cuda", link.device.ordinal)


def _torch_views(memory: Any, stacks: Sequence[Stack], torch: Any) -> Iterator[tuple[Stack, Sequence[Any]]]:
    """Yields the tensors of each stack, sliced in a few calls: several calls for each of many images would dominate the time."""
    whole = {name: memory.view(getattr(torch, name)) for name in {stack.type_name for stack in stacks}}
    for stack in stacks:
        item = stack.itemsize
        shape, strides = (len(stack.cameras), *stack.shape), (stack.stride // item, *stack.steps)
        yield stack, torch.as_strided(whole[stack.type_name], shape, strides, stack.offset // item).unbind(0)


class _Device(ctypes.Structure):
    _fields_ = (("type", ctypes.c_int32), ("id", ctypes.c_int32))


class _Type(ctypes.Structure):
    _fields_ = (("code", ctypes.c_uint8), ("bits", ctypes.c_uint8), ("lanes", ctypes.c_uint16))


class _Tensor(ctypes.Structure):
    _fields_ = (
        ("data", ctypes.c_void_p),
        ("device", _Device),
        ("ndim", ctypes.c_int32),
        ("dtype", _Type),
        ("shape", ctypes.POINTER(ctypes.c_int64)),
        ("strides", ctypes.POINTER(ctypes.c_int64)),
        ("byte_offset", ctypes.c_uint64),
    )


class _ManagedTensor(ctypes.Structure):
    pass


_Deleter = ctypes.CFUNCTYPE(None, ctypes.POINTER(_ManagedTensor))
_ManagedTensor._fields_ = (("tensor", _Tensor), ("context", ctypes.c_void_p), ("deleter", _Deleter))
_exported: dict[int, tuple[Any, ...]] = {}
"""Objects in use by consumers, by the address of their structure: they must not be collected before the deleter is called."""


def _forget(managed: Any) -> None:
    _exported.pop(ctypes.addressof(managed.contents), None)


_DELETER = _Deleter(_forget)
_new_capsule = ctypes.pythonapi.PyCapsule_New
_new_capsule.restype, _new_capsule.argtypes = ctypes.py_object, (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
_is_valid = ctypes.pythonapi.PyCapsule_IsValid
_is_valid.restype, _is_valid.argtypes = ctypes.c_int, (ctypes.c_void_p, ctypes.c_char_p)
_pointer = ctypes.pythonapi.PyCapsule_GetPointer
_pointer.restype, _pointer.argtypes = ctypes.c_void_p, (ctypes.c_void_p, ctypes.c_char_p)


def _forget_capsule(capsule: int) -> None:
    # A consumed capsule has been renamed, and its structure belongs to the consumer.
    if _is_valid(capsule, _NAME):
        _exported.pop(_pointer(capsule, _NAME), None)


_DROP_CAPSULE = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_forget_capsule)


class Memory:
    """Device memory, freed with the last array that refers to it.

    Args:
        address: address of the first byte.
        device: DLPack device type and id.
        free: called once with the address.
    """

    def __init__(self, address: int, device: tuple[int, int], free: Callable[[int], None]) -> None:
        self.address, self.device = address, device
        # Not at exit: the process frees all memory, and drivers may already be unloaded.
        weakref.finalize(self, free, address).atexit = False


class DeviceArray:
    """A C-contiguous array in device memory. Read it with ``torch.from_dlpack``, ``jax.dlpack.from_dlpack`` or ``cupy.from_dlpack``.

    All work that writes it has finished: readers need not wait for any stream.
    """

    def __init__(self, memory: Memory, offset: int, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
        self._memory, self._offset = memory, offset
        self.dtype, self.shape = dtype, shape

    @property
    def address(self) -> int:
        """Address of the first element; valid while the array exists."""
        return self._memory.address + self._offset

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self._memory.device

    def __dlpack__(
        self, *, stream: Any = None, max_version: Any = None, dl_device: tuple[int, int] | None = None, copy: bool | None = None
    ) -> Any:
        if copy or dl_device not in (None, self._memory.device):
            raise BufferError(
                f"an array on DLPack device {self._memory.device} can be exported only on this device and not as a copy; copy it yourself"
            )
        managed = _ManagedTensor()
        shape = (ctypes.c_int64 * self.ndim)(*self.shape)
        tensor = managed.tensor
        tensor.data = self._memory.address
        tensor.byte_offset = self._offset
        tensor.device = _Device(*self._memory.device)
        tensor.dtype = _Type(_CODES[self.dtype.kind], self.dtype.itemsize * 8, 1)
        tensor.ndim, tensor.shape, tensor.strides = self.ndim, shape, None
        managed.deleter = _DELETER
        _exported[ctypes.addressof(managed)] = (managed, shape, self._memory)
        return _new_capsule(ctypes.addressof(managed), _NAME, ctypes.cast(_DROP_CAPSULE, ctypes.c_void_p))

    def __repr__(self) -> str:
        return f"DeviceArray(shape={self.shape}, dtype={self.dtype}, dlpack_device={self._memory.device})"
