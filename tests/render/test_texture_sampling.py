"""Wrap modes and filters of textures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.formats.mesh import Material, Mesh, Sampling, TextureSource
from render.drawing import draw_mesh, facing_quad

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

RED, GREEN = (255, 0, 0), (0, 255, 0)


def row(sampling: Sampling, last_u: float) -> np.ndarray:
    """Returns the middle row, (64, 3), of a picture of red and green columns over texture coordinates from 0 to ``last_u``."""
    texture = TextureSource("columns", np.array([[RED, GREEN]] * 2, dtype=np.uint8), sampling)
    (part,) = facing_quad(1.0, 1.0, Material(base_color=(1.0, 1.0, 1.0, 1.0), texture=texture, unlit=True)).parts
    uvs = np.array(part.uvs)
    uvs[:, 0] *= last_u
    rgb = draw_mesh(Mesh((replace(part, uvs=uvs),))).rgb
    assert rgb is not None
    return rgb[32].astype(int)


@pytest.mark.parametrize(
    ("wrap", "expected"),
    [("repeat", [RED, GREEN, RED, GREEN]), ("mirror", [RED, GREEN, GREEN, RED]), ("clamp", [RED, GREEN, GREEN, GREEN])],
)
def test_beyond_its_border_an_image_is_repeated_mirrored_or_held(wrap, expected) -> None:
    pixels = row(Sampling(wrap_u=wrap, magnified="nearest"), 2.0)
    assert [tuple(pixels[column]) for column in (8, 24, 40, 56)] == expected


def test_between_its_pixels_an_image_is_mixed_or_not() -> None:
    mixed, sharp = (row(Sampling(wrap_u="clamp", magnified=filter), 1.0) for filter in ("linear", "nearest"))
    assert mixed[31].min(initial=255, where=[True, True, False]) > 100
    assert sorted(set(map(tuple, sharp.tolist()))) == [GREEN, RED]


def test_without_mip_levels_a_far_image_is_not_averaged() -> None:
    averaged = row(Sampling(magnified="nearest", minified="nearest"), 640.0)
    aliased = row(Sampling(magnified="nearest", minified="nearest", between_levels=None), 640.0)
    assert set(map(tuple, aliased.tolist())) <= {RED, GREEN}
    assert averaged.max() < 200
