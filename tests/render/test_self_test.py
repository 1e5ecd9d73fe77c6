"""The self-test passes if drawing is correct, and detects each kind of error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.errors import GraphicsUnavailableError
from gibson_sim.render.self_test import compare, digest, expected, self_test
from gibson_sim.types import CameraSpec, Frame


def right() -> Frame:
    """Returns a correct frame."""
    e = expected()
    return Frame(
        CameraSpec("eye", ""),
        0,
        np.eye(4),
        rgb=e.rgb.copy(),
        depth=e.depth.copy(),
        semantic=e.semantic.copy(),
        instance=e.instance.copy(),
    )


@pytest.mark.egl
@pytest.mark.usefixtures("egl")
def test_self_test_passes_on_this_machine() -> None:
    assert self_test().startswith(f"pixel-exact ({digest(right())}) on ")


@pytest.mark.egl
@pytest.mark.usefixtures("egl")
def test_an_unknown_device_is_an_error() -> None:
    with pytest.raises(GraphicsUnavailableError, match="does not exist"):
        self_test("99")


def test_expected_values_are_at_the_plates() -> None:
    e = expected()
    assert e.rgb[8, 8].tolist() == [200, 30, 40], "the upper half of the plate at the top left"
    assert e.rgb[31, 8].tolist() == [220, 180, 20]
    assert (e.depth[8, 8], e.depth[7, 8], e.depth[55, 43]) == (2.0, np.inf, 4.25)
    assert (e.semantic[8, 8], e.instance[8, 8]) == (3, 1), "classes in alphabetical order: east, north, south, west"
    assert (e.semantic[55, 43], e.instance[55, 43]) == (1, 4)
    assert (e.semantic[56, 43], e.instance[0, 0]) == (0, 0)


def test_a_right_frame_has_no_problems() -> None:
    assert compare(right()) == []


def test_a_vertically_flipped_image_is_reported() -> None:
    frame = right()
    assert frame.rgb is not None
    flipped = {name: getattr(frame, name)[::-1] for name in ("rgb", "depth", "semantic", "instance")}
    assert "the image is upside down" in compare(replace(frame, **flipped))


@pytest.mark.parametrize(
    ("output", "change", "problem"),
    [
        ("rgb", 1, "1 of 4096 colours"),
        ("depth", 0.0002, "1 of 4096 depths"),
        ("depth", np.inf, "1 of 4096 depths"),
        ("semantic", 1, "1 of 4096 classes"),
        ("instance", 1, "1 of 4096 instances"),
    ],
)
def test_one_wrong_pixel_is_noticed(output: str, change: float, problem: str) -> None:
    frame = right()
    getattr(frame, output)[10, 10] += change
    assert compare(frame) == [problem]


def test_a_depth_may_be_a_little_off() -> None:
    frame = right()
    assert frame.depth is not None
    frame.depth[10, 10] += 0.00005
    assert compare(frame) == []
    assert digest(frame) == digest(right())
