"""Holes filled on the GPU: the passes give what the host gives. A software renderer draws here, and host memory stands in for CUDA's."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gibson_sim.errors import ConfigError, RenderError
from gibson_sim.filling.holes import is_hole
from gibson_sim.render import renderer as renderer_module
from gibson_sim.render.context import EglDevice, GlContext, gl as GL, open_context
from gibson_sim.render.draw.effects import Average
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.render.filling import gpu_filling
from gibson_sim.render.filling.gpu_filling import GpuFilling, levels_of
from gibson_sim.render.filling.hole_filling import HoleFilling, hole_filling_of
from gibson_sim.render.readback.cuda import CudaDevice, CudaPython
from gibson_sim.render.readback.frames import Readback, TargetImage, hole_of
from gibson_sim.render.renderer import Renderer
from gibson_sim.types import CameraSpec, Frame
from render.drawing import EYE, box, scene, state
from support.cuda import FakeCuda, fake_cuda, fetched
from support.filler_networks import network_that_cuts_rows, network_that_fails_with_holes, our_network, pipeline
from support.targets import Images, blank_images, fill, random_images

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

SIZE = (61, 47)
CAMERA = CameraSpec(
    "eye", "", width=SIZE[0], height=SIZE[1], outputs=("rgb", "depth", "hole"), fill="push_pull", fill_depth=True, near=0.1, far=20.0
)  # fmt: skip
CAMERAS = {
    "pinhole": CAMERA,
    "smooth edges": replace(CAMERA, samples=4),
    "fisheye": replace(CAMERA, projection="fisheye", fov=math.pi),
    "panorama": replace(CAMERA, projection="equirectangular"),
    "colours alone": replace(CAMERA, fill_depth=False),
    "depth alone": replace(CAMERA, outputs=("depth", "hole")),
}
MOVING, BACK, FRONT = 57344, 32768, 65535
"""Alpha of normals that are stored."""


def drawn(seed: int = 0, holes: float = 0.2, size: tuple[int, int] = SIZE) -> Images:
    """Returns a target with every kind of pixel; depth up to 50 m, so that some is beyond the camera's."""
    rng = np.random.default_rng(seed)
    images = random_images(*size, seed)
    shape = images["depth"].shape
    images["NORMALS"][..., 3] = rng.choice(
        [0, BACK, MOVING, FRONT], shape, p=[holes / 2, holes / 2, 0.1 * (holes > 0.0), 0.9 - holes + 0.1 * (holes == 0.0)]
    )
    nothing = images["NORMALS"][..., 3] == 0
    # A hole, the sky, and what is outside the lens: see outside_of().
    images["NORMALS"][..., :2][nothing] = rng.choice([0, 65535], (np.count_nonzero(nothing), 2))
    images["depth"][...] = np.where(nothing, 0.0, 0.1 / rng.uniform(0.1, 50.0, shape))
    return images


@dataclass
class Blur:
    """An ``Average`` with holes at random."""

    texture: int
    mask: np.ndarray[Any, Any]

    def holes(self) -> np.ndarray[Any, Any]:
        return self.mask


@contextmanager
def blur(context: GlContext) -> Iterator[Blur]:
    """Yields an average of the size ``SIZE``, a fifth of which are holes."""
    mask = np.random.default_rng(5).random(SIZE[::-1]) < 0.2
    sums = np.zeros((*mask.shape, 4), dtype=np.float32)
    sums[..., 3] = mask
    texture = context.gl.texture(SIZE, 4, sums.tobytes(), dtype="f4")
    yield Blur(texture.glo, mask)
    texture.release()


class Stage:
    """A target with known pixels, filled on the host or on the GPU."""

    def __init__(self, context: GlContext) -> None:
        self.context, self.cuda = context, fake_cuda(context)
        self.on_host, self.gpu = HoleFilling(context), GpuFilling(context, lambda _: self.cuda)
        self.on_gpu = HoleFilling(context, self.gpu)
        self._readback = Readback(context)

    def frame(
        self, filling: HoleFilling, camera: CameraSpec, images: Images, average: Any = None, at: tuple[int, int] = (0, 0)
    ) -> Frame:
        """Returns the image that is filled in a target, in which it stands at a place."""
        height, width = images["depth"].shape
        target = RenderTarget(self.context, width, height, ("NORMALS",))
        try:
            fill(self.context, target, images)
            shot = TargetImage(camera, 0, np.eye(4), *at)
            filling.fill(target, shot, average)
            return self._readback.frames(target, [shot])[0]
        finally:
            target.close()

    def both(self, camera: CameraSpec, images: Images, average: Any = None, at: tuple[int, int] = (0, 0)) -> tuple[Frame, Frame]:
        """Returns the images filled on the host and on the GPU."""
        assert self.gpu.can_fill(self.on_gpu.prepare(camera.fill), TargetImage(camera, 0, np.eye(4)))
        return self.frame(self.on_host, camera, images, average, at), self.frame(self.on_gpu, camera, images, average, at)

    def close(self) -> None:
        self.on_gpu.close()


@pytest.fixture(autouse=True)
def networks_on_the_cpu(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keeps networks in host memory, where the pretended CUDA is, even if onnxruntime supports CUDA; not in tests of a real GPU."""
    if request.node.get_closest_marker("gpu") is None:
        use_cpu(monkeypatch)


def use_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes new sessions of onnxruntime use the CPU."""
    monkeypatch.setattr("onnxruntime.get_available_providers", lambda: ["CPUExecutionProvider"])


@pytest.fixture(scope="module")
def opened(egl: object) -> Iterator[GlContext]:
    context = open_context()
    yield context
    context.close()


@pytest.fixture
def context(opened: GlContext) -> GlContext:
    """Returns a context that is current, whatever other tests have opened."""
    opened.make_current()
    return opened


@pytest.fixture
def stage(context: GlContext) -> Iterator[Stage]:
    made = Stage(context)
    yield made
    made.close()


@pytest.fixture(scope="module")
def fills(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Returns what a camera's ``fill`` may be, by what it is."""
    folder = tmp_path_factory.mktemp("networks")
    files = {"network": our_network(gain=0.7), "network with depth": our_network(gain=0.7, depth=True, offset=-0.3)}
    for name, content in files.items():
        (folder / f"{name}.onnx").write_bytes(content)
    return {"push_pull": "push_pull", **{name: str(folder / f"{name}.onnx") for name in files}}


def assert_equal(host: Frame, gpu: Frame) -> None:
    """Asserts that two images are equal up to the rounding of colours and depth."""
    assert (host.rgb is None) == (gpu.rgb is None)
    if host.rgb is not None and gpu.rgb is not None:
        assert np.abs(host.rgb.astype(int) - gpu.rgb).max() <= 1
    np.testing.assert_allclose(gpu.depth, host.depth, rtol=2e-5)
    np.testing.assert_array_equal(gpu.hole, host.hole)


@pytest.mark.parametrize("fill_of", ["push_pull", "network", "network with depth"])
@pytest.mark.parametrize("camera", CAMERAS)
def test_the_gpu_fills_as_the_host_does(stage: Stage, fills: dict[str, str], camera: str, fill_of: str) -> None:
    found = stage.both(replace(CAMERAS[camera], fill=fills[fill_of]), drawn())
    assert_equal(*found)
    assert is_hole(found[0].hole).any() and (fill_of == "push_pull" or "map" in stage.cuda.calls)


def test_corrections_fade_with_the_distance_from_a_hole_as_on_the_host(stage: Stage, fills: dict[str, str]) -> None:
    images = drawn(1, holes=0.0, size=(320, 64))
    images["color"][...] = 200
    images["NORMALS"][20:30, 30:40] = 0
    images["depth"][20:30, 30:40] = 0.0
    host, gpu = stage.both(replace(CAMERA, width=320, height=64, fill=fills["network"]), images)
    difference = np.abs(host.rgb.astype(int) - gpu.rgb)
    assert difference.max() <= 2, "OpenCV's distances are approximate"
    row = gpu.rgb[25, 40:, 0].astype(int)
    assert 140 <= row[0] < 150 and (np.diff(row) >= 0).all() and (row[200:] == 200).all()


@pytest.mark.parametrize("fill_of", ["push_pull", "network with depth"])
def test_blurred_colours_are_filled_where_a_hole_was_at_any_time(stage: Stage, fills: dict[str, str], fill_of: str) -> None:
    images = drawn(2)
    with blur(stage.context) as average:
        found = stage.both(replace(CAMERA, fill=fills[fill_of]), images, average=average)
    assert_equal(*found)
    filled = (found[1].rgb != images["color"][..., :3]).any(axis=2)
    assert filled[average.mask & (images["NORMALS"][..., 3] >= MOVING)].mean() > 0.9


def test_depth_beside_blurred_colours_follows_from_the_colours_as_drawn(stage: Stage, tmp_path: Path) -> None:
    file = tmp_path / "network.onnx"
    file.write_bytes(our_network(gain=0.7, depth=True, offset=0.1, depth_channel=0))
    with blur(stage.context) as average:
        assert_equal(*stage.both(replace(CAMERA, fill=str(file)), drawn(2, holes=0.6), average=average))


def test_an_image_beside_others_is_filled_for_itself(stage: Stage, fills: dict[str, str]) -> None:
    large = drawn(3, size=(160, 120))
    x, y = 70, 31
    part = {name: image[y : y + SIZE[1], x : x + SIZE[0]] for name, image in large.items()}
    camera = replace(CAMERA, fill=fills["network with depth"])
    beside, alone = stage.frame(stage.on_gpu, camera, large, at=(x, y)), stage.frame(stage.on_gpu, camera, part)
    assert np.array_equal(beside.rgb, alone.rgb) and np.array_equal(beside.depth, alone.depth)


@pytest.mark.parametrize("fill_of", ["push_pull", "network"])
def test_an_image_without_known_depth_keeps_infinite_depth(stage: Stage, fills: dict[str, str], fill_of: str) -> None:
    images = blank_images(*SIZE)
    images["color"][...] = 90
    host, gpu = stage.both(replace(CAMERA, fill=fills[fill_of]), images)
    assert_equal(host, gpu)
    assert np.isinf(gpu.depth).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (17, 1), (2, 3)])
def test_small_images_are_filled(stage: Stage, fills: dict[str, str], size: tuple[int, int]) -> None:
    for fill_of in ("push_pull", "network"):
        camera = replace(CAMERA, width=size[0], height=size[1], fill=fills[fill_of])
        for seed in range(5):
            assert_equal(*stage.both(camera, drawn(seed, 0.5, size)))


def test_a_value_that_is_not_finite_is_the_same_error_as_on_the_host(stage: Stage, tmp_path: Path) -> None:
    file = tmp_path / "network.onnx"
    file.write_bytes(network_that_fails_with_holes(0.3))
    camera, errors = replace(CAMERA, fill=str(file)), []
    for filling in (stage.on_host, stage.on_gpu):
        with pytest.raises(ConfigError, match="a NaN or an infinity") as caught:
            stage.frame(filling, camera, drawn(holes=0.8))
        errors.append(str(caught.value))
    assert errors[0] == errors[1]
    assert_equal(*stage.both(camera, drawn(holes=0.0)))


def test_a_network_whose_output_has_another_size_is_an_error(stage: Stage, tmp_path: Path) -> None:
    file = tmp_path / "network.onnx"
    file.write_bytes(network_that_cuts_rows(8))
    with pytest.raises(ConfigError, match=r"holes of camera 'eye', 61x47, are not filled: .* cannot be run: .*[Ss]hape"):
        stage.frame(stage.on_gpu, replace(CAMERA, fill=str(file)), drawn())
    assert not stage.cuda.mapped
    assert_equal(*stage.both(CAMERA, drawn()))


def test_other_networks_and_networks_without_cuda_are_run_on_the_host(
    context: GlContext, fills: dict[str, str], tmp_path: Path
) -> None:
    file = tmp_path / "pipeline.onnx"
    file.write_bytes(pipeline())
    shot = TargetImage(CAMERA, 0, np.eye(4))
    with_cuda, without = GpuFilling(context, fake_cuda), GpuFilling(context)
    prepare = HoleFilling(context).prepare
    assert not with_cuda.can_fill(prepare(str(file)), shot) and not without.can_fill(prepare(fills["network"]), shot)
    assert with_cuda.can_fill(prepare(fills["network"]), shot) and without.can_fill(prepare("push_pull"), shot)
    huge = TargetImage(replace(CAMERA, width=16384, height=16384), 0, np.eye(4))
    assert not with_cuda.can_fill(prepare("push_pull"), huge)
    frame = Stage(context).frame(HoleFilling(context, with_cuda), replace(CAMERA, fill=str(file)), drawn())
    assert (frame.rgb[is_hole(frame.hole)] == 7).all()


def test_buffers_that_grow_are_unregistered_and_closing_frees_everything(stage: Stage, fills: dict[str, str]) -> None:
    for size in ((16, 16), (64, 64), (32, 32)):
        camera = replace(CAMERA, width=size[0], height=size[1], fill=fills["network with depth"])
        stage.frame(stage.on_gpu, camera, drawn(size=size))
    assert stage.cuda.registrations == 6 and len(stage.cuda.registered) == 3
    stage.on_gpu.close()
    stage.on_gpu.close()
    assert not stage.cuda.registered


def test_the_gpu_fills_even_if_no_context_was_current_when_it_was_prepared(context: GlContext) -> None:
    other = open_context()
    other.make_current()
    other.close()
    gpu = GpuFilling(context)
    filler = HoleFilling(context, gpu).prepare("push_pull")
    context.make_current()
    assert gpu.can_fill(filler, TargetImage(CAMERA, 0, np.eye(4)))


def test_a_driver_that_rejects_the_passes_is_named(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(gpu_filling._STORED, "color", GL.RGBA16UI)  # a view needs a format of the same size
    with pytest.raises(RenderError, match=r"cannot fill holes \(error 0x50[0-9]\); update its driver"):
        stage.frame(stage.on_gpu, CAMERA, drawn())


def test_levels_halve_down_to_one_pixel() -> None:
    assert levels_of(5, 3) == [(0, (5, 3)), (15, (3, 2)), (21, (2, 1)), (23, (1, 1))]
    assert levels_of(1, 1) == [(0, (1, 1))]


def test_a_gpu_is_used_where_one_draws(context: GlContext, monkeypatch: pytest.MonkeyPatch) -> None:
    stage, asked = Stage(context), []
    monkeypatch.setattr(GpuFilling, "can_fill", lambda *_: asked.append(1))
    for software in (True, False):
        monkeypatch.setattr(context, "device", EglDevice(0, "a vendor", "a GPU", software=software))
        stage.frame(hole_filling_of(context), CAMERA, drawn())
    assert asked == [1]


def test_a_gpu_that_cuda_does_not_list_runs_networks_on_the_host(
    context: GlContext, fills: dict[str, str], caplog: pytest.LogCaptureFixture
) -> None:
    elsewhere = FakeCuda(context, [CudaDevice(0, "another GPU", "01234567-89ab-cdef-0123-456789abcdef")])
    gpu = GpuFilling(context, lambda _: elsewhere)
    camera = replace(CAMERA, fill=fills["network"])
    filling = HoleFilling(context, gpu)
    assert gpu.can_fill(filling.prepare("push_pull"), TargetImage(CAMERA, 0, np.eye(4))) and not caplog.text, "needs no CUDA"
    assert not gpu.can_fill(filling.prepare(camera.fill), TargetImage(camera, 0, np.eye(4)))
    assert caplog.text.count("is none of CUDA's devices (0: another GPU") == 1
    assert caplog.text.count(f"fill: {camera.fill} works on copies of the images in host memory") == 1
    filling.close()


def test_images_and_tensors_of_a_renderer_are_filled_on_the_gpu(monkeypatch: pytest.MonkeyPatch, fills: dict[str, str]) -> None:
    used: list[FakeCuda] = []

    def on_gpu(context: GlContext) -> HoleFilling:
        used.append(fake_cuda(context))
        return HoleFilling(context, GpuFilling(context, lambda _: used[-1]))

    walls = [box((2.001, side, 0.0), size=(0.002, 2.0, 6.0)) for side in (1.25, -1.25)]
    camera = replace(EYE, outputs=("rgb", "depth"), fill=fills["network with depth"], fill_depth=True)
    frames = {}
    for way in ("host", "gpu"):
        if way == "gpu":
            monkeypatch.setattr(renderer_module, "hole_filling_of", on_gpu)
        with Renderer(scene(*walls)) as made:
            frames[way] = (*made.render(state(), [camera]), *made.render_tensors(state(), [camera]))
    for host, gpu in zip(frames["host"], frames["gpu"], strict=True):
        assert np.abs(on_host(host.rgb).astype(int) - on_host(gpu.rgb)).max() <= 1
        np.testing.assert_allclose(on_host(gpu.depth), on_host(host.depth), rtol=2e-5)
    assert used and not used[0].registered, "closing the renderer frees the buffers"


def on_host(image: Any) -> np.ndarray[Any, Any]:
    """Returns an image of a frame, or a tensor wherever it is, as an array."""
    return image if isinstance(image, np.ndarray) else fetched(image)


def test_an_average_tells_its_holes_by_the_alpha_of_its_texture(context: GlContext) -> None:
    average = Average(context, 3, 2)
    average.clear()
    size = np.zeros(2, dtype=np.int32)
    for k, name in enumerate((0x1000, 0x1001)):  # GL_TEXTURE_WIDTH, GL_TEXTURE_HEIGHT
        GL.Gl(context).glGetTextureLevelParameteriv(average.texture, 0, name, size[k:].ctypes.data)
    assert tuple(size) == (3, 2) and not average.holes().any()
    average.close()


@pytest.mark.gpu
@pytest.mark.parametrize("fill_of", ["push_pull", "network", "network with depth", "learned"])
def test_on_a_real_gpu_holes_are_filled_as_on_the_host(
    nvidia: tuple[GlContext, CudaPython], fills: dict[str, str], fill_of: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    context, driver = nvidia
    gpu = GpuFilling(context, lambda _: driver)
    camera = replace(CAMERA, width=256, height=256, fill=fills.get(fill_of, fill_of))
    filling, images = HoleFilling(context, gpu), drawn(size=(256, 256))
    assert gpu.can_fill(filling.prepare(camera.fill), TargetImage(camera, 0, np.eye(4))), "onnxruntime-gpu does not run on CUDA"
    by_cpu = HoleFilling(context)
    use_cpu(monkeypatch)
    by_cpu.prepare(camera.fill)
    found, again, host = (Stage(context).frame(way, camera, images) for way in (filling, filling, by_cpu))
    difference = np.abs(host.rgb.astype(int) - found.rgb)
    assert difference.max() <= (4 if fill_of == "learned" else 1) and np.array_equal(found.rgb, again.rgb)
    np.testing.assert_allclose(found.depth, host.depth, rtol=1e-3)
    np.testing.assert_array_equal(found.hole, hole_of(images["NORMALS"]))
    filling.close()
