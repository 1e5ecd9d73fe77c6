"""Textures keep their colours, compressed or not, and compressed ones take less memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.formats.mesh import Material, TextureSource
from gibson_sim.render.draw.scene_memory import _next_mip_level
from gibson_sim.render.renderer import Renderer, RenderOptions
from render.drawing import EYE, facing_quad, loader_of, mesh_visual, scene, state

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]


def smooth_picture(channels: int) -> np.ndarray:
    y, x = np.mgrid[:256, :256]
    layers = [x, y, (x + y) // 2, np.full_like(x, 255)]
    return np.stack(layers[:channels], axis=-1).astype(np.uint8)


def drawn(channels: int, *, compress: bool) -> tuple[np.ndarray, float]:
    material = Material(texture=TextureSource("picture", smooth_picture(channels)), unlit=True, base_color=(1, 1, 1, 1))
    mesh = facing_quad(2.0, 2.0, material)
    with Renderer(scene(mesh_visual()), meshes=loader_of(mesh), options=RenderOptions(compress_textures=compress)) as renderer:
        camera = replace(EYE, width=128, height=128)
        rgb = renderer.render(state(), [camera])[0].rgb
        assert rgb is not None
        return rgb.astype(int), renderer.info["texture_mb"]


@pytest.mark.parametrize(("channels", "part"), [(3, 1 / 8), (4, 1 / 4)])
def test_compressed_textures_look_alike_and_take_a_part_of_the_memory(channels: int, part: float) -> None:
    plain, plain_mb = drawn(channels, compress=False)
    small, small_mb = drawn(channels, compress=True)
    assert plain.std() > 40
    assert np.abs(plain - small).mean() < 3.0
    assert small_mb <= plain_mb * part + 0.1


def test_mipmaps_are_means_in_linear_light() -> None:
    checker = np.zeros((2, 2, 3), dtype=np.uint8)
    checker[0, 0] = checker[1, 1] = 255
    assert _next_mip_level(checker).tolist() == [[[188, 188, 188]]]  # 0.5 in linear light


def test_odd_sides_and_alpha_are_halved_too() -> None:
    assert _next_mip_level(np.full((5, 1, 4), 128, dtype=np.uint8)).tolist() == [[[128] * 4], [[128] * 4]]
