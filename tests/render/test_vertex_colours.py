"""Colours of vertices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.description.shapes import Appearance, Shape, VisualSpec
from gibson_sim.formats.mesh import Material, Mesh, Sampling, TextureSource
from gibson_sim.render.lod.clusters import build_clusters
from gibson_sim.render.renderer import Renderer
from render.drawing import EYE, draw_mesh, facing_quad, loader_of, mesh_visual, scene, state
from support.surfaces import bumpy_grid

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

WHITE = Material(base_color=(1.0, 1.0, 1.0, 1.0), unlit=True, colored=True)


def colored_quad(colors, material: Material = WHITE) -> Mesh:
    """Returns a quad that fills the image, with these colours at its corners."""
    (part,) = facing_quad(1.0, 1.0, material).parts
    return Mesh((replace(part, uvs=None, colors=np.array(colors, dtype=np.uint8)),))


def seen(mesh: Mesh, visual: VisualSpec) -> np.ndarray:
    with Renderer(scene(visual), meshes=loader_of(mesh)) as renderer:
        return renderer.render(state(), [EYE])[0].rgb[32, 32].astype(int)


def test_a_corner_has_its_colour():
    one = draw_mesh(colored_quad([(10, 120, 250)] * 4)).rgb
    np.testing.assert_allclose(one[32, 32], (10, 120, 250), atol=1)


def test_colours_are_mixed_in_linear_light_between_corners():
    (part,) = colored_quad([(0, 0, 0)] * 4).parts
    colors = np.where(part.vertices[:, 1:2] > part.vertices[:, 1:2].mean(), 255, 0).astype(np.uint8).repeat(3, axis=1)
    middle = draw_mesh(colored_quad(colors)).rgb[32, 31:33].mean()
    assert middle == pytest.approx(188, abs=3)  # half of the light


def test_the_base_colour_multiplies_them():
    rgb = draw_mesh(colored_quad([(255, 255, 255)] * 4, replace(WHITE, base_color=(1.0, 0.0, 0.0, 1.0)))).rgb
    np.testing.assert_allclose(rgb[32, 32], (255, 0, 0), atol=1)


def test_a_colour_of_the_visual_replaces_them():
    quad = colored_quad([(255, 0, 0)] * 4)
    visual = replace(mesh_visual(), color=(0.0, 1.0, 0.0, 1.0))
    red, green, _ = seen(quad, visual)
    assert red == 0 and green > 100


def test_a_tint_turns_them():
    quad = colored_quad([(255, 0, 0)] * 4)
    visual = replace(mesh_visual(), appearance=Appearance(saturation=0.0))
    rgb = seen(quad, visual)
    assert np.ptp(rgb) <= 2 and rgb[0] > 0


def test_coarser_levels_keep_the_borders_of_colours():
    part = bumpy_grid(60, height=0.02)
    fields = np.floor(part.vertices[:, :2] / 0.5).sum(axis=1, keepdims=True) % 2
    colors = fields.astype(np.float32).repeat(3, axis=1)

    def drawn(colors: np.ndarray | None) -> int:
        """Returns the number of triangles at an error of 2 cm."""
        nothing = np.zeros((len(part.vertices), 2), dtype=np.float32)
        c = build_clusters(part.vertices, part.normals, nothing, part.triangles.astype(np.int64), 256, colors=colors)
        error = np.append(c.group_error, np.inf)
        rows = ((c.group < 0) | (error[c.group] <= 0.02)) & (error[c.next_group] > 0.02)
        return int(np.diff(c.ends, prepend=0)[rows].sum())

    assert drawn(colors) > 2 * drawn(None)


def _texture(pixels, sampling: Sampling | None = None) -> TextureSource:
    return TextureSource("test", np.array(pixels, dtype=np.uint8), sampling or Sampling())


def test_vertex_colours_multiply_a_texture_in_linear_light():
    grey = _texture([[[188, 188, 188]]])  # 0.5 of the light
    (part,) = facing_quad(1.0, 1.0, replace(WHITE, texture=grey)).parts
    mesh = Mesh((replace(part, colors=np.full((4, 3), (255, 188, 0), dtype=np.uint8)),))
    np.testing.assert_allclose(draw_mesh(mesh).rgb[32, 32], (188, 137, 0), atol=2)  # 0.5, 0.25 and 0 of the light


@pytest.mark.parametrize("texture", [None, _texture([[[255, 255, 255]]])])
def test_alpha_of_vertex_colours_cuts_holes_and_blends(texture):
    colors = np.full((4, 4), 255, dtype=np.uint8)
    colors[:, 3] = 102  # 0.4
    (part,) = facing_quad(1.0, 1.0, replace(WHITE, texture=texture, alpha_mode="mask")).parts
    hole = Mesh((replace(part, uvs=part.uvs if texture else None, colors=colors),))
    assert draw_mesh(hole).rgb[32, 32].max() == 0
    pane = Mesh((replace(hole.parts[0], material=replace(part.material, alpha_mode="blend")),))
    np.testing.assert_allclose(draw_mesh(pane).rgb[32, 32], 170, atol=2)  # 0.4 of the light on black


def test_a_body_with_colours_and_a_texture_joins_a_scene_without():
    grey = _texture([[[188, 188, 188]]])
    (part,) = facing_quad(1.0, 1.0, replace(WHITE, texture=grey)).parts
    later = Mesh((replace(part, colors=np.full((4, 3), (255, 0, 0), dtype=np.uint8)),))
    first = facing_quad(2.0, 2.0, Material(texture=_texture([[[0, 0, 255]]]), unlit=True, base_color=(1, 1, 1, 1)))
    far = VisualSpec("far", "", Shape("mesh", mesh="/far"))

    def load(shape: Shape) -> Mesh:
        return first if shape.mesh == "/far" else later

    near = VisualSpec("near", "body/link", Shape("mesh", mesh="/near"))
    before, after = scene(far), scene(far, near, links=("body/link",))
    with Renderer(before, meshes=load) as renderer:
        assert renderer.render(state(), [EYE])[0].rgb[32, 32].tolist() == [0, 0, 255]
        assert not renderer.update(replace(after, revision=2))  # not reloaded
        rgb = renderer.render(state(["body/link"], [(0.0, 0.0, 0.0)], revision=2), [EYE])[0].rgb
    np.testing.assert_allclose(rgb[32, 32], (188, 0, 0), atol=2)


def test_a_cutoff_above_1_hides_everything():
    hidden = facing_quad(
        1.0, 1.0, replace(WHITE, texture=_texture([[[255, 255, 255, 255]]]), alpha_mode="mask", alpha_cutoff=1.1)
    )
    assert draw_mesh(hidden).rgb[32, 32].max() == 0
