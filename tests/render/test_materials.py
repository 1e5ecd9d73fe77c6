"""Colours, textures, light and transparency."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.errors import MeshError
from gibson_sim.formats.mesh import Material, Mesh, TextureSource
from gibson_sim.geometry.projections import project
from gibson_sim.geometry.transforms import invert, matrix_from_pose, transform_points
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.spec import LightSpec
from render.drawing import (
    BLUE,
    DARK,
    EYE,
    GREY,
    RED,
    box,
    draw,
    draw_mesh,
    eye_at,
    facing_quad,
    loader_of,
    mesh_visual,
    plate,
    scene,
    state,
    where,
)  # fmt: skip

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

CORNERS = np.array([[(255, 0, 0), (0, 255, 0)], [(0, 0, 255), (255, 255, 0)]], dtype=np.uint8)
"""Red, green; blue, yellow."""


def textured(pixels, **material) -> Material:
    return Material(base_color=(1.0, 1.0, 1.0, 1.0), texture=TextureSource("test", np.ascontiguousarray(pixels)), **material)


def half_clear(alpha: int = 0) -> np.ndarray:
    """Returns a white 16 x 16 texture whose left half has this alpha."""
    pixels = np.full((16, 16, 4), 255, dtype=np.uint8)
    pixels[:, :8, 3] = alpha
    return pixels


def test_the_top_row_of_a_texture_is_where_v_is_0():
    # The quad fills the image: 1 m at 1 m with 90 degrees. The middles of the texels come at pixels 16 and 48.
    rgb = draw_mesh(facing_quad(1.0, 1.0, textured(CORNERS, unlit=True))).rgb
    for row in (0, 1):
        for column in (0, 1):
            seen = rgb[16 + 32 * row - row, 16 + 32 * column - column].astype(int)
            assert (seen > 200).tolist() == (CORNERS[row, column] > 200).tolist(), (row, column)


def test_an_rgb_texture_with_an_odd_width_is_not_sheared():
    pixels = np.zeros((8, 5, 3), dtype=np.uint8)
    pixels[:, 0] = (255, 0, 0)
    frame = draw_mesh(facing_quad(1.0, 1.0, textured(pixels, unlit=True)))
    assert where(frame, 0)[8:56, 6].all()
    assert not where(frame, 0)[8:56, 20:50].any()


@pytest.mark.parametrize("color", [(204, 102, 51), (10, 128, 250)])
def test_unlit_colours_come_back_as_they_are(color):
    material = Material(base_color=(color[0] / 255, color[1] / 255, color[2] / 255, 1.0), unlit=True)
    rgb = draw_mesh(facing_quad(1.0, 2.0, material)).rgb
    assert np.abs(rgb.astype(int) - color).max() <= 1


@pytest.mark.parametrize("color", [(204, 102, 51), (10, 128, 250)])
def test_unlit_textures_come_back_as_they_are(color):
    rgb = draw_mesh(facing_quad(1.0, 2.0, textured(np.full((4, 4, 3), color, dtype=np.uint8), unlit=True))).rgb
    assert np.abs(rgb.astype(int) - color).max() <= 1


def test_unlit_does_not_depend_on_light():
    mesh = facing_quad(1.0, 2.0, Material(base_color=(0.5, 0.5, 0.5, 1.0), unlit=True))
    with Renderer(scene(mesh_visual(), light=LightSpec(sun=0.0, ambient=0.0)), meshes=loader_of(mesh)) as renderer:
        rgb = renderer.render(state(), [EYE])[0].rgb
    assert np.abs(rgb.astype(int) - 128).max() <= 1


def test_without_light_a_lit_surface_is_black():
    assert not draw(plate((1.0, 0.0, 0.0), side=4.0), light=LightSpec(sun=0.0, ambient=0.0)).rgb.any()


def test_the_background_has_the_colour_of_the_scene():
    rgb = draw(light=LightSpec(background=(0.2, 0.4, 0.6))).rgb
    assert np.abs(rgb.astype(int) - (51, 102, 153)).max() <= 1


def test_faces_of_a_box_turned_differently_to_the_sun_differ_in_brightness():
    camera = eye_at((-3.0, -3.0, 3.0), look_at=(0.0, 0.0, 0.0))
    # The sun stands above, before -x, and a bit to -y.
    frame = draw(box((0.0, 0.0, 0.0)), camera=camera, light=LightSpec(sun_direction=(0.5, 0.2, -0.8)))
    faces = [(0.0, 0.0, 0.5), (-0.5, 0.0, 0.0), (0.0, -0.5, 0.0)]
    pixels, _ = project(transform_points(invert(matrix_from_pose(camera.pose)), faces), camera)
    top, front, side = (int(frame.rgb[round(v), round(u), 0]) for u, v in pixels)
    assert top > front + 5
    assert front > side + 5


def test_a_surface_is_lit_alike_whichever_way_its_triangles_turn():
    mesh = facing_quad(1.0, 2.0, Material())
    part = mesh.parts[0]
    turned = Mesh((type(part)(part.vertices, -part.normals, part.uvs, part.triangles[:, ::-1].copy(), part.material),))
    np.testing.assert_array_equal(draw_mesh(mesh).rgb, draw_mesh(turned).rgb)


def test_the_colour_of_a_visual_replaces_the_material_of_the_file():
    mesh = facing_quad(1.0, 2.0, textured(CORNERS))
    visual = VisualSpec("mesh", "", Shape("mesh", mesh="/mesh"), color=BLUE)
    with Renderer(scene(visual), meshes=loader_of(mesh)) as renderer:
        assert where(renderer.render(state(), [EYE])[0], 2).all()


def test_masked_texels_are_holes_in_colour_and_depth():
    quad = facing_quad(1.0, 1.0, textured(half_clear(), alpha_mode="mask"))
    frame = draw_mesh(quad, plate((3.0, 0.0, 0.0), RED, 8.0))
    # The left half shows the red plate behind; at the seams the texture is filtered.
    assert where(frame, 0)[:, 4:28].all()
    np.testing.assert_allclose(frame.depth[:, 4:28], 2.999, atol=1e-4)
    assert not where(frame, 0)[:, 36:60].any()
    np.testing.assert_allclose(frame.depth[:, 36:60], 1.0, atol=1e-4)


def test_masked_holes_before_nothing_are_infinite_and_of_the_background():
    frame = draw_mesh(facing_quad(1.0, 1.0, textured(half_clear(), alpha_mode="mask")))
    assert np.isposinf(frame.depth[:, 4:28]).all()
    assert not frame.rgb[:, 4:28].any()


@pytest.mark.parametrize(("cutoff", "hole"), [(0.3, False), (0.5, True)])
def test_the_cutoff_decides_what_is_a_hole(cutoff, hole):
    # Alpha is 102 / 255 = 0.4.
    quad = facing_quad(1.0, 1.0, textured(half_clear(102), alpha_mode="mask", alpha_cutoff=cutoff))
    assert np.isposinf(draw_mesh(quad).depth[32, 16]) == hole


def test_an_opaque_material_ignores_alpha():
    assert np.isfinite(draw_mesh(facing_quad(1.0, 2.0, textured(half_clear()))).depth).all()


def test_a_translucent_thing_tints_what_is_behind_it_and_has_no_depth_of_its_own():
    glass = plate((1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.4), 4.0)
    wall = plate((3.0, 0.0, 0.0), RED, 8.0)
    plain, tinted = draw(wall), draw(glass, wall)
    np.testing.assert_array_equal(tinted.depth, plain.depth)
    red, green, blue = tinted.rgb[32, 32].astype(int)
    assert 0 < red < plain.rgb[32, 32, 0]
    assert blue > 50
    assert green == 0


def test_translucent_things_are_mixed_from_back_to_front():
    # In linear light half of the nearer blue covers everything, half of red what is behind: blue is twice as strong.
    near, far = plate((1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.5), 4.0), plate((2.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.5), 8.0)
    for order in ((near, far), (far, near)):
        red, _, blue = draw(*order).rgb[32, 32].astype(int)
        assert blue > red + 20


def test_a_translucent_thing_behind_a_solid_one_is_hidden():
    solid = plate((1.0, 0.0, 0.0), RED, 4.0)
    np.testing.assert_array_equal(draw(solid, plate((2.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.5), 8.0)).rgb, draw(solid).rgb)


def test_a_mesh_that_cannot_be_read_is_left_out_with_a_warning():
    def loader(shape: Shape) -> Mesh:
        raise MeshError("/lost.glb: cannot be read")

    with Renderer(scene(mesh_visual(), light=DARK), meshes=loader) as renderer:
        assert renderer.warnings == ("visual 'mesh' is not drawn: /lost.glb: cannot be read",)
        assert np.isposinf(renderer.render(state(), [EYE])[0].depth).all()


def test_a_visual_on_an_unknown_link_is_left_out_with_a_warning_and_the_rest_is_drawn():
    lost = box((3.0, 0.0, 0.0), GREY, link="no/such")
    with Renderer(scene(lost, plate((4.0, 0.0, 0.0), RED))) as renderer:
        assert "no/such" in renderer.warnings[0]
        assert renderer.render(state(), [EYE])[0].depth[32, 32] == pytest.approx(3.999, abs=1e-4)
