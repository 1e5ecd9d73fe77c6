"""Tensors and frames that are started equal the frames of ``render``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gibson_sim.errors import RenderError
from gibson_sim.render.context import GlContext
from gibson_sim.render.readback import tensors as tensors_module
from gibson_sim.render.readback.cuda import CudaPython
from gibson_sim.render.renderer import Renderer, RenderOptions
from gibson_sim.types import OUTPUTS, CameraSpec, Frame
from render.drawing import BLUE, EYE, GREEN, RED, box, eye_at, scene, state
from support.cuda import fake_cuda, fetched

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]
LINK = "robot/base"
THINGS = (box((3.0, 0.4, 0.2), RED), box((2.0, -0.8, -0.3), GREEN), box((0.0, 0.0, 0.0), BLUE, link=LINK))
NOW = state((LINK,), ((4.0, 1.0, 0.5),), stamp_ns=20)
BEFORE = state((LINK,), ((4.0, 0.8, 0.5),), stamp_ns=10)
CAMERAS = (
    replace(EYE, name="all", outputs=OUTPUTS),
    eye_at((0.0, 0.5, 0.3), (3.0, 0.0, 0.0), name="small", width=33, height=17, outputs=("depth", "position", "normal_world")),
    replace(EYE, name="fish", projection="fisheye", fov=math.pi, outputs=OUTPUTS),
    replace(EYE, name="colours", outputs=("rgb",)),
)


@pytest.fixture
def renderer() -> Any:
    with Renderer(scene(*THINGS, links=(LINK,))) as made:
        yield made


@pytest.fixture
def with_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes every renderer use a fake CUDA on its device."""
    monkeypatch.setattr(tensors_module, "cuda_of", fake_cuda)
    monkeypatch.setattr(tensors_module, "_import_torch", lambda: None)


def assert_same(got: Sequence[Any], wanted: Sequence[Frame]) -> None:
    assert [g.camera for g in got] == [w.camera for w in wanted]
    for g, w in zip(got, wanted, strict=True):
        assert g.stamp_ns == w.stamp_ns
        np.testing.assert_array_equal(g.T_world_camera, w.T_world_camera)
        for output in OUTPUTS:
            if output in w.camera.outputs:
                np.testing.assert_array_equal(
                    np.from_dlpack(getattr(g, output)), getattr(w, output), err_msg=f"{w.camera.name} {output}"
                )
            else:
                assert getattr(g, output) is None


@pytest.mark.parametrize("cameras", [CAMERAS, CAMERAS[::-1], CAMERAS[:1] * 5], ids=["mixed", "reversed", "alike"])
def test_tensors_on_the_cpu_are_the_frames(renderer: Renderer, cameras: tuple[CameraSpec, ...]) -> None:
    assert_same(renderer.render_tensors(NOW, cameras, BEFORE), renderer.render(NOW, cameras, BEFORE))


@pytest.mark.parametrize("cameras", [CAMERAS, CAMERAS[::-1], CAMERAS[:1] * 5], ids=["mixed", "reversed", "alike"])
def test_tensors_of_cuda_are_the_frames_to_the_bit(with_cuda: None, renderer: Renderer, cameras: tuple[CameraSpec, ...]) -> None:
    assert renderer.tensors_on == "cuda:0"
    assert_same(renderer.render_tensors(NOW, cameras, BEFORE), renderer.render(NOW, cameras, BEFORE))


@pytest.mark.gpu
@pytest.mark.parametrize("with_torch", [False, True])
def test_tensors_on_the_gpu_are_the_frames_to_the_bit(
    nvidia: tuple[GlContext, CudaPython], with_torch: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not with_torch:
        monkeypatch.setattr(tensors_module, "_import_torch", lambda: None)
    with Renderer(scene(*THINGS, links=(LINK,)), options=RenderOptions(device=nvidia[0].device.index)) as renderer:
        assert renderer.tensors_on.startswith("cuda:")
        wanted = renderer.render(NOW, CAMERAS, BEFORE)
        got = renderer.render_tensors(NOW, CAMERAS, BEFORE)
        on_host = [replace(g, **{o: fetched(getattr(g, o)) for o in g.camera.outputs}) for g in got]
    assert_same(on_host, wanted)


def test_tensors_of_cuda_outlive_the_renderer(with_cuda: None) -> None:
    with Renderer(scene(*THINGS, links=(LINK,))) as renderer:
        wanted = renderer.render(NOW, CAMERAS)
        kept = renderer.render_tensors(NOW, CAMERAS)
        renderer.render_tensors(BEFORE, CAMERAS)
    assert_same(kept, wanted)


def test_frames_that_were_started_are_those_of_their_own_time(renderer: Renderer) -> None:
    first, second = renderer.start(NOW, CAMERAS, BEFORE), renderer.start(BEFORE, CAMERAS, NOW)
    assert_same(second.result(), renderer.render(BEFORE, CAMERAS, NOW))
    assert_same(first.result(), renderer.render(NOW, CAMERAS, BEFORE))


def test_frames_that_were_started_are_lost_with_the_renderer() -> None:
    with Renderer(scene(*THINGS, links=(LINK,))) as renderer:
        pending = renderer.start(NOW, CAMERAS)
    with pytest.raises(RenderError, match="closed"):
        pending.result()
