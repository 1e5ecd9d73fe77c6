"""From OpenGL's buffers to CUDA: which GPU, and in which order. Tests marked gpu need CUDA itself, and are skipped with a warning without it."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.errors import GraphicsUnavailableError, RenderError
from gibson_sim.render.context import EglDevice, GlContext, gl as GL, open_context
from gibson_sim.render.draw.target import FEATURES, RenderTarget
from gibson_sim.render.readback.cuda import CudaDevice, CudaLink, CudaPython, find_device
from gibson_sim.render.readback.frames import Readback, TargetImage
from gibson_sim.render.readback.pixel_buffers import GlBuffer
from gibson_sim.render.readback.tensors import Tensors
from gibson_sim.types import OUTPUTS, CameraSpec
from support.cuda import FakeCuda, fake_cuda, fetched
from support.targets import fill, random_images

UUID = "01234567-89ab-cdef-0123-456789abcdef"
OTHER = "fedcba98-7654-3210-fedc-ba9876543210"
DRAWING = EglDevice(1, "NVIDIA Corporation", "NVIDIA GPU/PCIe", uuid=UUID, cuda_ordinal=0)
BYTES = 64


# ---- which GPU


def test_the_device_of_the_same_uuid_is_chosen_whatever_its_number() -> None:
    devices = [CudaDevice(0, "one", OTHER), CudaDevice(1, "two", UUID)]
    assert find_device(DRAWING, devices).ordinal == 1


def test_without_a_uuid_the_device_is_found_by_its_gl_ordinal() -> None:
    devices = [CudaDevice(0, "one", OTHER), CudaDevice(1, "two", UUID)]
    assert find_device(replace(DRAWING, uuid=""), devices, gl_ordinals=[1]).ordinal == 1


def test_without_a_uuid_and_gl_ordinals_the_device_is_found_by_its_egl_ordinal() -> None:
    devices = [CudaDevice(0, "one", OTHER), CudaDevice(1, "two", UUID)]
    assert find_device(replace(DRAWING, uuid="", cuda_ordinal=1), devices).ordinal == 1


def test_a_gpu_that_cuda_does_not_show_is_an_error_that_names_both() -> None:
    with pytest.raises(GraphicsUnavailableError) as caught:
        find_device(DRAWING, [CudaDevice(0, "another GPU", OTHER)])
    text = str(caught.value)
    assert all(part in text for part in ("EGL device 1", "NVIDIA GPU/PCIe", UUID, "another GPU", OTHER, "CUDA_VISIBLE_DEVICES"))
    assert "\n" not in text


def test_cuda_without_devices_is_an_error_that_says_none() -> None:
    with pytest.raises(GraphicsUnavailableError, match="none of CUDA's devices \\(none\\)"):
        find_device(DRAWING, [])


# ---- in which order


@pytest.fixture
def context(egl: None) -> Iterator[GlContext]:
    opened = open_context()
    yield opened
    opened.close()


@pytest.fixture
def cuda(context: GlContext) -> FakeCuda:
    return fake_cuda(context)


@pytest.fixture
def buffer(context: GlContext) -> GlBuffer:
    made = GlBuffer(context, BYTES, GL.DYNAMIC_COPY)
    made.write(np.arange(BYTES, dtype=np.uint8))
    return made


def room() -> ctypes.Array[ctypes.c_char]:
    return ctypes.create_string_buffer(BYTES)


@pytest.mark.egl
def test_a_copy_brings_the_bytes_between_map_and_unmap(context: GlContext, cuda: FakeCuda, buffer: GlBuffer) -> None:
    out = room()
    CudaLink(context, cuda).copy(buffer, 10, ctypes.addressof(out))
    assert out.raw == bytes(range(10)) + bytes(BYTES - 10)
    assert cuda.calls == ["map", "copy", "unmap"]
    assert cuda.mapped == set()


@pytest.mark.egl
def test_a_buffer_is_registered_once(context: GlContext, cuda: FakeCuda, buffer: GlBuffer) -> None:
    link, out = CudaLink(context, cuda), room()
    for _ in range(3):
        link.copy(buffer, BYTES, ctypes.addressof(out))
    assert cuda.registrations == 1


@pytest.mark.egl
def test_a_copy_that_fails_leaves_the_buffer_to_opengl(context: GlContext, cuda: FakeCuda, buffer: GlBuffer) -> None:
    link, out = CudaLink(context, cuda), room()
    with pytest.raises(RenderError, match="update the driver"):
        link.copy(buffer, BYTES + 1, ctypes.addressof(out))
    assert cuda.mapped == set()
    link.copy(buffer, BYTES, ctypes.addressof(out))


@pytest.mark.egl
def test_closing_unregisters_everything(context: GlContext, cuda: FakeCuda, buffer: GlBuffer) -> None:
    link, out = CudaLink(context, cuda), room()
    link.copy(buffer, BYTES, ctypes.addressof(out))
    link.close()
    link.close()
    assert cuda.registered == {}


@pytest.mark.egl
def test_a_buffer_that_grows_is_unregistered_before_it_is_freed(context: GlContext, cuda: FakeCuda) -> None:
    tensors = Tensors(context, driver=cuda)
    for size in (4, 64):
        camera = CameraSpec("eye", "", width=size, height=size)
        tensors.of_target(RenderTarget(context, size, size), [TargetImage(camera, 0, np.eye(4))])
    assert cuda.registrations == 2
    assert len(cuda.registered) == 1
    tensors.close()
    assert cuda.registered == {}


@pytest.mark.egl
def test_a_context_on_another_gpu_is_refused(context: GlContext) -> None:
    elsewhere = FakeCuda(context, [CudaDevice(0, "another GPU", OTHER)])
    with pytest.raises(GraphicsUnavailableError, match="another GPU"):
        CudaLink(context, elsewhere)
    assert elsewhere.opened is None


def test_without_the_package_the_error_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "cuda.bindings", None)
    with pytest.raises(GraphicsUnavailableError, match=r"pip install 'gibson_sim\[cuda\]'"):
        CudaPython()


# ---- CUDA itself


@pytest.mark.gpu
def test_opengl_and_cuda_agree_on_the_uuid_of_the_gpu(nvidia: tuple[GlContext, CudaPython]) -> None:
    context, driver = nvidia
    by_uuid = find_device(context.device, driver.devices())
    assert by_uuid.uuid == context.device.uuid
    assert driver.current_gl_devices() in ([], [by_uuid.ordinal])


@pytest.mark.gpu
@pytest.mark.parametrize("with_torch", [False, True])
@pytest.mark.parametrize("size", [(64, 48), (127, 61), (1024, 1024)])
def test_tensors_on_the_gpu_are_bit_equal_to_host_readback(
    nvidia: tuple[GlContext, CudaPython], with_torch: bool, size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    from gibson_sim.render.readback import tensors as tensors_module

    if not with_torch:
        monkeypatch.setattr(tensors_module, "_import_torch", lambda: None)
    context, driver = nvidia
    width, height = size
    matrix = (50.0, 0.0, 31.25, 0.0, 50.0, 20.25, 0.0, 0.0, 1.0)
    camera = CameraSpec("eye", "", width=width, height=height, outputs=OUTPUTS, matrix=matrix)
    rotation, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    T_world_camera = np.eye(4)
    T_world_camera[:3] = np.column_stack([rotation, (1.5, -2.25, 0.7)])
    target = RenderTarget(context, width, height, FEATURES)
    fill(context, target, random_images(width, height))
    shot = TargetImage(camera, 0, T_world_camera)
    expected = Readback(context).frames(target, [shot])[0]
    tensors = Tensors(context, driver)
    frame = tensors.of_target(target, [shot])[0]
    for output in OUTPUTS:
        np.testing.assert_array_equal(fetched(getattr(frame, output)), getattr(expected, output), err_msg=output)
    tensors.close()


@pytest.mark.gpu
def test_tensors_on_the_gpu_are_not_overwritten_by_the_next_image(nvidia: tuple[GlContext, CudaPython]) -> None:
    context, driver = nvidia
    camera = CameraSpec("eye", "", width=256, height=256, outputs=("rgb",))
    target = RenderTarget(context, 256, 256, FEATURES)
    tensors = Tensors(context, driver=driver)
    kept = []
    for seed in range(8):
        images = random_images(256, 256, seed)
        fill(context, target, images)
        kept.append((tensors.of_target(target, [TargetImage(camera, 0, np.eye(4))])[0].rgb, images["color"][..., :3]))
    for tensor, wanted in kept:
        np.testing.assert_array_equal(fetched(tensor), wanted)
    tensors.close()
