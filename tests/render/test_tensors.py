"""Tensors have the values, shapes and types of frames, to the bit, and belong to the caller.

Without a GPU, ``support.cuda`` replaces CUDA: the bytes take the same path through host memory.
"""

from __future__ import annotations

import gc
import importlib.util
import warnings
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.errors import RenderError
from gibson_sim.render.context import GlContext, open_context
from gibson_sim.render.draw.target import FEATURES, RenderTarget
from gibson_sim.render.readback import tensors as tensors_module
from gibson_sim.render.readback.frames import TargetImage, rays_f32
from gibson_sim.render.readback.packing import Packer, layout
from gibson_sim.render.readback.tensors import TensorFrame, Tensors, tensors_of_frame
from gibson_sim.types import OUTPUTS, CameraSpec, Frame
from support.cuda import FakeCuda, fake_cuda
from support.targets import Images, blank_images, fill, random_images

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]
WIDTH, HEIGHT = 5, 3
EYE = CameraSpec(
    "eye",
    "",
    width=WIDTH,
    height=HEIGHT,
    near=0.05,
    far=100.0,
    outputs=OUTPUTS,
    matrix=(2.0, 0.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 1.0),
)
"""Its focal length is 2 pixels, and the middle pixel looks straight ahead."""
T_WORLD_EYE = np.eye(4)


@pytest.fixture
def context() -> Iterator[GlContext]:
    opened = open_context()
    yield opened
    opened.close()


@pytest.fixture
def without_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tensors_module, "_import_torch", lambda: None)


@pytest.fixture
def cuda(context: GlContext) -> FakeCuda:
    return fake_cuda(context)


@pytest.fixture
def tensors(context: GlContext, cuda: FakeCuda, without_torch: None) -> Iterator[Tensors]:
    made = Tensors(context, cuda)
    yield made
    made.close()


@pytest.fixture
def torch() -> Any:
    if importlib.util.find_spec("torch") is None:
        message = "SKIPPED: no PyTorch in this Python; pip install 'gibson_sim[torch]' to test its tensors"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)
    import torch

    return torch


def shown(
    context: GlContext,
    tensors: Tensors,
    images: Images,
    T_world_camera: NDArray[np.float64] = T_WORLD_EYE,
    camera: CameraSpec = EYE,
) -> TensorFrame:
    """Returns the tensors of one camera whose image fills a target."""
    target = RenderTarget(context, camera.width, camera.height, FEATURES)
    fill(context, target, images)
    return tensors.of_target(target, [TargetImage(camera, 7, T_world_camera)])[0]


def host(array: Any) -> NDArray[Any]:
    return np.from_dlpack(array).copy()


# ---- values, by hand


def test_a_frame_says_which_camera_saw_it_and_when(context: GlContext, tensors: Tensors) -> None:
    frame = shown(context, tensors, blank_images(WIDTH, HEIGHT))
    assert (frame.camera, frame.stamp_ns) == (EYE, 7)
    np.testing.assert_array_equal(frame.T_world_camera, T_WORLD_EYE)


def test_rgb_is_the_bytes_of_the_image_without_alpha(context: GlContext, tensors: Tensors) -> None:
    images = blank_images(WIDTH, HEIGHT)
    images["color"][0, 1] = (10, 128, 250, 77)
    images["color"][2, 4] = (1, 2, 3, 4)
    rgb = host(shown(context, tensors, images).rgb)
    assert (rgb.shape, rgb.dtype) == ((HEIGHT, WIDTH, 3), np.uint8)
    assert rgb[0, 1].tolist() == [10, 128, 250]
    assert rgb[2, 4].tolist() == [1, 2, 3]
    assert rgb.sum() == 10 + 128 + 250 + 1 + 2 + 3


def test_depth_is_metres_and_infinite_where_nothing_is(context: GlContext, tensors: Tensors) -> None:
    images = blank_images(WIDTH, HEIGHT)
    images["depth"][1, 2] = 0.02  # near / z: 0.05 m / 0.02 = 2.5 m
    images["depth"][1, 3] = 0.0004  # 125 m, behind the far end of 100 m
    depth = host(shown(context, tensors, images).depth)
    assert depth.dtype == np.float32
    assert depth[1, 2] == np.float32(0.05) / np.float32(0.02)
    assert np.isposinf(depth).sum() == WIDTH * HEIGHT - 1


def test_labels_are_whole_numbers_of_16_bits(context: GlContext, tensors: Tensors) -> None:
    images = blank_images(WIDTH, HEIGHT)
    images["LABELS"][2, 0] = (65535, 300)
    frame = shown(context, tensors, images)
    semantic, instance = host(frame.semantic), host(frame.instance)
    assert semantic.dtype == instance.dtype == np.uint16
    assert (semantic[2, 0], semantic.astype(int).sum()) == (65535, 65535)
    assert (instance[2, 0], instance.astype(int).sum()) == (300, 300)


def test_normals_are_turned_into_the_world_and_are_0_where_nothing_is(context: GlContext, tensors: Tensors) -> None:
    images = blank_images(WIDTH, HEIGHT)
    images["NORMALS"][0, 0] = (65535, 32768, 32768, 65535)  # along +x of the camera
    T_world_camera = np.array([[0.0, 0.0, 1.0, 5.0], [-1.0, 0.0, 0.0, 6.0], [0.0, -1.0, 0.0, 7.0], [0.0, 0.0, 0.0, 1.0]])
    frame = shown(context, tensors, images, T_world_camera)
    normal, world = host(frame.normal), host(frame.normal_world)
    np.testing.assert_allclose(normal[0, 0], (1.0, 0.0, 0.0), atol=2e-5)
    np.testing.assert_allclose(world[0, 0], (0.0, -1.0, 0.0), atol=2e-5)  # right of the image is -y of the world here
    assert np.count_nonzero(normal) == np.count_nonzero(normal[0, 0])
    assert not world[0, 1:].any()


def test_positions_are_points_in_the_world_and_nan_where_nothing_is(context: GlContext, tensors: Tensors) -> None:
    images = blank_images(WIDTH, HEIGHT)
    images["depth"][1, 4] = 0.025  # 2 m ahead, ray (1, 0, 1): 2 m to the right
    T_world_camera = np.array([[0.0, 0.0, 1.0, 5.0], [-1.0, 0.0, 0.0, 6.0], [0.0, -1.0, 0.0, 7.0], [0.0, 0.0, 0.0, 1.0]])
    position = host(shown(context, tensors, images, T_world_camera).position)
    np.testing.assert_allclose(position[1, 4], (7.0, 4.0, 7.0), rtol=1e-6)
    assert np.isnan(position).sum() == 3 * (WIDTH * HEIGHT - 1)


def test_flow_is_handed_on_as_it_is(context: GlContext, tensors: Tensors) -> None:
    images = random_images(WIDTH, HEIGHT)
    assert host(shown(context, tensors, images).flow).tobytes() == images["FLOW"].tobytes()


# ---- values, to the bit


@pytest.mark.parametrize(("width", "height"), [(1, 1), (5, 3), (64, 48), (127, 61)])
def test_every_output_is_what_the_host_computes(context: GlContext, tensors: Tensors, width: int, height: int) -> None:
    images = random_images(width, height, seed=width)
    camera = replace(EYE, width=width, height=height)
    rotation, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    T_world_camera = np.eye(4)
    T_world_camera[:3] = np.column_stack([rotation, (1.5, -2.25, 0.7)])
    frame = shown(context, tensors, images, T_world_camera, camera)
    for output, expected in by_host(images, camera, T_world_camera).items():
        got = host(getattr(frame, output))
        assert (output, got.shape, got.dtype) == (output, expected.shape, expected.dtype)
        np.testing.assert_array_equal(got, expected, err_msg=output)


def by_host(images: Images, camera: CameraSpec, T_world_camera: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    """Returns the outputs as NumPy computes them, in single precision, one operation after the other."""
    depth = images["depth"].copy()
    depth[depth < np.float32(camera.near / camera.far)] = 0.0
    with np.errstate(divide="ignore"):
        depth = np.float32(camera.near) / depth
    normal = images["NORMALS"][..., :3].astype(np.float32) * np.float32(2.0 / 65535.0) - np.float32(1.0)
    normal[images["NORMALS"][..., 3] == 0] = 0.0
    R, t = T_world_camera[:3, :3].astype(np.float32), T_world_camera[:3, 3].astype(np.float32)

    def turned(v: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.stack([R[i, 0] * v[..., 0] + R[i, 1] * v[..., 1] + R[i, 2] * v[..., 2] for i in range(3)], axis=2)

    with np.errstate(invalid="ignore"):
        position = turned(rays_f32(camera) * depth[..., None]) + t
    position[np.isinf(depth)] = np.nan
    side, red = images["NORMALS"][..., 3], images["NORMALS"][..., 0]
    hole = np.select([(side == 0) & (red == 0), side == 0, side < 40000], [1, 3, 2], 0).astype(np.uint8)
    return {
        "rgb": images["color"][..., :3],
        "depth": depth,
        "semantic": images["LABELS"][..., 0],
        "instance": images["LABELS"][..., 1],
        "normal": normal,
        "normal_world": turned(normal),
        "position": position,
        "flow": images["FLOW"],
        "hole": hole,
    }


# ---- many cameras, few outputs


def test_each_camera_gets_its_own_rectangle_of_the_target(context: GlContext, tensors: Tensors) -> None:
    images = random_images(8, 6)
    target = RenderTarget(context, 8, 6, FEATURES)
    fill(context, target, images)
    wide = replace(EYE, name="wide", width=5, height=2, outputs=("rgb", "semantic"))
    tall = replace(EYE, name="tall", width=3, height=6, outputs=("depth", "rgb"), near=0.1)
    frames = tensors.of_target(target, [TargetImage(wide, 1, T_WORLD_EYE, 0, 4), TargetImage(tall, 1, T_WORLD_EYE, 5, 0)])
    np.testing.assert_array_equal(host(frames[0].rgb), images["color"][4:6, 0:5, :3])
    np.testing.assert_array_equal(host(frames[0].semantic), images["LABELS"][4:6, 0:5, 0])
    np.testing.assert_array_equal(host(frames[1].rgb), images["color"][0:6, 5:8, :3])
    assert host(frames[1].depth)[0, 0] == np.float32(0.1) / images["depth"][0, 5]


def test_only_the_outputs_of_a_camera_are_made(context: GlContext, tensors: Tensors) -> None:
    frame = shown(context, tensors, blank_images(WIDTH, HEIGHT), camera=replace(EYE, outputs=("depth",)))
    assert [name for name in OUTPUTS if getattr(frame, name) is not None] == ["depth"]


def test_a_target_without_further_outputs_will_do_for_colours(context: GlContext, tensors: Tensors) -> None:
    images = random_images(WIDTH, HEIGHT)
    target = RenderTarget(context, WIDTH, HEIGHT)
    fill(context, target, images)
    frame = tensors.of_target(target, [TargetImage(replace(EYE, outputs=("rgb",)), 0, T_WORLD_EYE)])[0]
    np.testing.assert_array_equal(host(frame.rgb), images["color"][..., :3])


def test_more_than_the_driver_packs_at_once_is_an_error_that_says_how_much(context: GlContext) -> None:
    packer = Packer(context)
    packer.limit = 10_000_000
    camera = replace(EYE, width=512, height=512, outputs=("rgb", "position"))
    with pytest.raises(RenderError, match=r"3 images take 12 MB .* at most 10 MB"):
        packer.pack(RenderTarget(context, 8, 8), [TargetImage(camera, 0, T_WORLD_EYE)] * 3)


def test_no_cameras_give_no_tensors(context: GlContext, tensors: Tensors) -> None:
    assert tensors.of_target(RenderTarget(context, WIDTH, HEIGHT), []) == []


def test_many_cameras_of_one_make_and_others_between_keep_their_images_apart(context: GlContext, tensors: Tensors) -> None:
    images = random_images(15, 9)
    target = RenderTarget(context, 15, 9, FEATURES)
    fill(context, target, images)
    other = replace(EYE, width=3, height=3, outputs=("instance", "rgb"))
    shots = [TargetImage(other if k == 4 else EYE, k, T_WORLD_EYE, 5 * (k % 3), 3 * (k // 3)) for k in range(9)]
    frames = tensors.of_target(target, shots)
    assert [frame.stamp_ns for frame in frames] == list(range(9))
    for frame, shot in zip(frames, shots, strict=True):
        rows, columns = slice(shot.y, shot.y + shot.camera.height), slice(shot.x, shot.x + shot.camera.width)
        part = {name: image[rows, columns] for name, image in images.items()}
        for output, expected in by_host(part, shot.camera, T_WORLD_EYE).items():
            if output in shot.camera.outputs:
                np.testing.assert_array_equal(host(getattr(frame, output)), expected, err_msg=f"{output} of {shot.stamp_ns}")


def test_a_camera_that_moves_takes_its_pose_along(context: GlContext, tensors: Tensors) -> None:
    images = blank_images(WIDTH, HEIGHT)
    images["depth"][1, 2] = 0.025  # 2 m straight ahead
    for x in (1.0, 5.0):
        T_world_camera = np.eye(4)
        T_world_camera[0, 3] = x
        assert host(shown(context, tensors, images, T_world_camera).position)[1, 2].tolist() == [x, 0.0, 2.0]


def test_arrays_stand_behind_each_other_without_overlap() -> None:
    stacks, size = layout(((5, 3, OUTPUTS), (7, 3, ("rgb", "depth")), (5, 3, OUTPUTS)))
    spans = sorted((s.offset + i * s.stride, s.offset + i * s.stride + s.nbytes) for s in stacks for i in range(len(s.cameras)))
    assert len(spans) == 2 * len(OUTPUTS) + 2
    assert all(end <= start for (_, end), (start, _) in pairwise(spans))
    assert all(s.offset % 256 == 0 for s in stacks)
    assert spans[-1][1] <= size


# ---- whose memory it is


def test_tensors_belong_to_the_caller(context: GlContext, tensors: Tensors) -> None:
    images = random_images(WIDTH, HEIGHT)
    kept = shown(context, tensors, images)
    shown(context, tensors, blank_images(WIDTH, HEIGHT))
    np.testing.assert_array_equal(np.from_dlpack(kept.rgb), images["color"][..., :3])


def test_memory_is_freed_with_the_last_array_that_shows_it(context: GlContext, tensors: Tensors, cuda: FakeCuda) -> None:
    frame = shown(context, tensors, blank_images(WIDTH, HEIGHT))
    view = np.from_dlpack(frame.depth)
    del frame
    gc.collect()
    assert len(cuda.memory) == 1
    del view
    gc.collect()
    assert (len(cuda.memory), len(cuda.freed)) == (0, 1)


def test_a_capsule_that_was_not_consumed_holds_nothing(context: GlContext, tensors: Tensors, cuda: FakeCuda) -> None:
    frame = shown(context, tensors, blank_images(WIDTH, HEIGHT))
    capsule = frame.rgb.__dlpack__()
    del frame, capsule
    gc.collect()
    assert cuda.memory == {}


def test_tensors_outlive_what_made_them(context: GlContext, tensors: Tensors) -> None:
    images = random_images(WIDTH, HEIGHT)
    frame = shown(context, tensors, images)
    tensors.close()
    tensors.close()
    np.testing.assert_array_equal(np.from_dlpack(frame.semantic), images["LABELS"][..., 0])


def test_after_closing_no_tensors_are_made(context: GlContext, tensors: Tensors) -> None:
    tensors.close()
    with pytest.raises(RenderError, match="closed"):
        tensors.of_target(RenderTarget(context, WIDTH, HEIGHT), [TargetImage(EYE, 0, T_WORLD_EYE)])


def test_an_array_is_not_copied_behind_the_callers_back(context: GlContext, tensors: Tensors) -> None:
    frame = shown(context, tensors, blank_images(WIDTH, HEIGHT))
    with pytest.raises(BufferError, match="copy it yourself"):
        frame.rgb.__dlpack__(copy=True)


# ---- PyTorch, and nothing


def test_frames_are_handed_on_as_they_are_where_pytorch_is_missing() -> None:
    depth = np.full((HEIGHT, WIDTH), 2.0, dtype=np.float32)
    tensors = tensors_of_frame(Frame(EYE, 3, T_WORLD_EYE, depth=depth))
    assert tensors.depth is depth
    assert tensors.rgb is None


def test_software_makes_tensors_on_the_cpu(context: GlContext) -> None:
    if not context.device.software:
        pytest.skip("a GPU draws here")
    made = Tensors(context)
    assert (made.on_gpu, made.device) == (False, "cpu")


def test_pytorch_shares_the_memory_of_frames(torch: Any) -> None:
    depth = np.full((HEIGHT, WIDTH), 2.0, dtype=np.float32)
    semantic = np.full((HEIGHT, WIDTH), 65535, dtype=np.uint16)
    tensors = tensors_of_frame(Frame(EYE, 3, T_WORLD_EYE, depth=depth, semantic=semantic), torch)
    depth[0, 0] = 3.0
    assert float(tensors.depth[0, 0]) == 3.0
    assert tensors.semantic.dtype == torch.uint16


def test_pytorch_gets_tensors_of_its_own_with_the_same_values(context: GlContext, cuda: FakeCuda, torch: Any) -> None:
    images = random_images(WIDTH, HEIGHT)
    made = Tensors(context, cuda)
    frame = shown(context, made, images)
    shown(context, made, blank_images(WIDTH, HEIGHT))
    for output, expected in by_host(images, EYE, T_WORLD_EYE).items():
        got = getattr(frame, output)
        assert isinstance(got, torch.Tensor)
        assert got.is_contiguous()
        np.testing.assert_array_equal(got.numpy(), expected, err_msg=output)
    assert cuda.memory == {}, "PyTorch allocates"


def test_pytorch_reads_arrays_by_dlpack(context: GlContext, tensors: Tensors, torch: Any) -> None:
    images = random_images(WIDTH, HEIGHT)
    rgb = torch.from_dlpack(shown(context, tensors, images).rgb)
    gc.collect()
    np.testing.assert_array_equal(rgb.numpy(), images["color"][..., :3])
