"""Arrays for any library that reads DLPack (PyTorch, JAX, CuPy, NumPy), without depending on one of them.

Uses the structures of DLPack before version 1, which all these libraries read. https://dmlc.github.io/dlpack/latest/c_api.html
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np

_CODES = {"i": 0, "u": 1, "f": 2}
_NAME = b"dltensor"


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
