"""Frames as tensors: on the rendering GPU if CUDA is available, without a copy through the host; else on the CPU.

The type of tensor depends on the installed packages, never on the images:

* NVIDIA GPU, ``cuda-bindings``, PyTorch with CUDA: ``torch.Tensor`` on that GPU;
* NVIDIA GPU, ``cuda-bindings``: ``DeviceArray``, which JAX, CuPy and others read by DLPack;
* else PyTorch: ``torch.Tensor`` on the CPU;
* else NumPy arrays, which support DLPack too.

All values equal those of ``Frame``. PyTorch is optional and imported lazily, because only PyTorch can allocate its tensors.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import RenderError
from gibson_sim.render.context import GlContext
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.render.readback.cuda import CudaDriver, CudaLink, cuda_of
from gibson_sim.render.readback.dlpack import DeviceArray, Memory
from gibson_sim.render.readback.frames import TargetImage
from gibson_sim.render.readback.packing import ORDER, Packer, Stack
from gibson_sim.types import CameraSpec, Frame

_log = logging.getLogger(__name__)


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
