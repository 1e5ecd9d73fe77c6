"""Asynchronous readback returns what the target held when the read was started, in any order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.errors import RenderError
from gibson_sim.render.context import GlContext, gl as GL, open_context
from gibson_sim.render.draw.target import FEATURES, RenderTarget
from gibson_sim.render.readback.frames import RAW_FORMATS, Readback, TargetImage
from gibson_sim.render.readback.pixel_buffers import PendingFrames, PixelBuffers
from gibson_sim.types import OUTPUTS, CameraSpec
from support.targets import blank_images, fill, random_images

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]
WIDTH, HEIGHT = 13, 7  # no multiples of four: rows are not padded
EYE = CameraSpec("eye", "", width=WIDTH, height=HEIGHT, outputs=OUTPUTS, matrix=(4.0, 0.0, 6.25, 0.0, 4.0, 3.25, 0.0, 0.0, 1.0))


@pytest.fixture
def context() -> Iterator[GlContext]:
    opened = open_context()
    yield opened
    opened.close()


@pytest.fixture
def target(context: GlContext) -> RenderTarget:
    return RenderTarget(context, WIDTH, HEIGHT, FEATURES)


@pytest.fixture
def buffers(context: GlContext) -> PixelBuffers:
    return PixelBuffers(context)


@pytest.mark.parametrize("name", list(RAW_FORMATS))
def test_every_attachment_comes_back_to_the_bit(
    context: GlContext, target: RenderTarget, buffers: PixelBuffers, name: str
) -> None:
    images = random_images(WIDTH, HEIGHT)
    fill(context, target, images)
    got = buffers.finish(buffers.start(target))[name]
    assert got.shape == images[name].shape
    assert got.dtype == images[name].dtype
    assert got.tobytes() == images[name].tobytes()


def test_only_requested_attachments_come_back(target: RenderTarget, buffers: PixelBuffers) -> None:
    assert list(buffers.finish(buffers.start(target, ("LABELS", "depth")))) == ["LABELS", "depth"]


def test_row_0_is_the_top_row(context: GlContext, target: RenderTarget, buffers: PixelBuffers) -> None:
    images = blank_images(WIDTH, HEIGHT)
    images["LABELS"][0, 2] = (7, 9)
    fill(context, target, images)
    labels = buffers.finish(buffers.start(target))["LABELS"]
    assert labels[0, 2].tolist() == [7, 9]
    assert labels.sum() == 16


def test_a_read_holds_what_was_there_when_it_was_started(context: GlContext, target: RenderTarget, buffers: PixelBuffers) -> None:
    first, second = random_images(WIDTH, HEIGHT, 1), random_images(WIDTH, HEIGHT, 2)
    fill(context, target, first)
    before = buffers.start(target)
    fill(context, target, second)
    after = buffers.start(target)
    # In reverse order, so that neither can be left over from the other.
    np.testing.assert_array_equal(buffers.finish(after)["color"], second["color"])
    np.testing.assert_array_equal(buffers.finish(before)["color"], first["color"])


def test_arrays_belong_to_the_caller(context: GlContext, target: RenderTarget, buffers: PixelBuffers) -> None:
    images = random_images(WIDTH, HEIGHT)
    fill(context, target, images)
    kept = buffers.finish(buffers.start(target))
    fill(context, target, blank_images(WIDTH, HEIGHT))
    buffers.finish(buffers.start(target))
    np.testing.assert_array_equal(kept["color"], images["color"])


def test_a_finished_read_is_done_and_cannot_be_fetched_again(target: RenderTarget, buffers: PixelBuffers) -> None:
    request = buffers.start(target)
    buffers.finish(request)
    assert buffers.done(request)
    with pytest.raises(RenderError, match="fetched already"):
        buffers.finish(request)


def test_a_buffer_is_used_again_for_the_next_read_of_its_size(target: RenderTarget, buffers: PixelBuffers) -> None:
    names = set()
    for _ in range(5):
        request = buffers.start(target)
        names.add(request.buffer.name)
        buffers.finish(request)
    assert len(names) == 1


def test_pending_reads_share_no_buffer(target: RenderTarget, buffers: PixelBuffers) -> None:
    tickets = [buffers.start(target) for _ in range(3)]
    assert len({request.buffer.name for request in tickets}) == 3


def test_a_target_can_still_be_read_into_host_memory(context: GlContext, target: RenderTarget, buffers: PixelBuffers) -> None:
    images = random_images(WIDTH, HEIGHT)
    fill(context, target, images)
    buffers.start(target, ("color",))
    out = np.zeros((HEIGHT, WIDTH, 4), dtype=np.uint8)
    gl = GL.Gl(context)
    gl.glReadPixels(0, 0, WIDTH, HEIGHT, GL.RGBA, GL.UNSIGNED_BYTE, out.ctypes.data)
    np.testing.assert_array_equal(out, images["color"])


def test_closing_drops_pending_reads(target: RenderTarget, buffers: PixelBuffers) -> None:
    request = buffers.start(target)
    buffers.close()
    buffers.close()
    with pytest.raises(RenderError, match="closed"):
        buffers.finish(request)


def test_frames_are_those_of_the_host_in_the_order_of_the_cameras(
    context: GlContext, target: RenderTarget, buffers: PixelBuffers
) -> None:
    fill(context, target, random_images(WIDTH, HEIGHT))
    left = replace(EYE, name="left", width=5)
    shots = [TargetImage(left, 3, np.eye(4)), TargetImage(replace(left, name="right", width=8), 3, np.eye(4), 5, 0)]
    pending = PendingFrames(context, buffers, [(buffers.start(target), shots, (1, 0))])
    frames = pending.result()
    assert [frame.camera.name for frame in frames] == ["right", "left"]
    for frame, expected in zip(frames, Readback(context).frames(target, shots[::-1]), strict=True):
        for output in OUTPUTS:
            np.testing.assert_array_equal(getattr(frame, output), getattr(expected, output), err_msg=output)


def test_frames_stay_when_the_target_changes_and_result_may_be_called_twice(
    context: GlContext, target: RenderTarget, buffers: PixelBuffers
) -> None:
    images = random_images(WIDTH, HEIGHT)
    fill(context, target, images)
    pending = PendingFrames(context, buffers, [(buffers.start(target), [TargetImage(EYE, 3, np.eye(4))], (0,))])
    fill(context, target, blank_images(WIDTH, HEIGHT))
    first = pending.result()
    buffers.finish(buffers.start(target))
    assert pending.done()
    assert pending.result() is first
    np.testing.assert_array_equal(first[0].rgb, images["color"][..., :3])
    np.testing.assert_array_equal(first[0].flow, images["FLOW"])


def test_joined_frames_are_in_the_order_of_their_positions(
    context: GlContext, target: RenderTarget, buffers: PixelBuffers
) -> None:
    images = random_images(WIDTH, HEIGHT)
    fill(context, target, images)
    cameras = {name: replace(EYE, name=name) for name in ("a", "b", "c")}

    def started(*names: str) -> PendingFrames:
        shots = [TargetImage(cameras[name], 3, np.eye(4)) for name in names]
        return PendingFrames(context, buffers, [(buffers.start(target), [shot], (k,)) for k, shot in enumerate(shots)])

    joined = PendingFrames.joined([(started("c", "a"), (2, 0)), (started("b"), (1,))])
    frames = joined.result()
    assert [frame.camera.name for frame in frames] == ["a", "b", "c"]
    for frame in frames:
        np.testing.assert_array_equal(frame.rgb, images["color"][..., :3])
