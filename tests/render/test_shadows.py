"""Shadows of the sun."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.formats.mesh import Material, TextureSource
from gibson_sim.geometry.projections import project
from gibson_sim.geometry.transforms import invert, matrix_from_pose, transform_points
from gibson_sim.render.draw.shadows import fit_sun
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.spec import LightSpec
from gibson_sim.types import Pose
from render.drawing import BLUE, RED, box, draw, eye_at, loader_of, mesh_visual, quad, scene, state, where

WHITE = (1.0, 1.0, 1.0, 1.0)
FLOOR = box((0.0, 0.0, -0.05), WHITE, (10.0, 10.0, 0.1))
SUN = LightSpec((1.0, 0.0, -1.0), 0.6, 0.1, (0.0, 0.0, 0.0), shadows=True)
ABOVE = eye_at((-0.01, 0.0, 8.0), (0.0, 0.0, 0.0), width=256, height=256)


def test_the_sun_sees_the_whole_box_and_the_nearest_corner_at_the_highest_depth() -> None:
    bounds = np.array([[-3.0, -2.0, 0.0], [5.0, 4.0, 2.5]])
    to_sun = np.array([0.6, 0.0, 0.8])
    clip, texel = fit_sun(bounds, to_sun, 512)
    corners = np.array([[bounds[i, 0], bounds[j, 1], bounds[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    seen = transform_points(clip, corners)
    assert np.abs(seen[:, :2]).max() < 1.0
    assert seen[:, 2].min() >= 0.0 and seen[:, 2].max() <= 1.0
    assert np.argmax(seen[:, 2]) == np.argmax(corners @ to_sun)
    # Texels for a metre across the rays.
    step = transform_points(clip, np.array([[0.0, 1.0, 0.0]])) - transform_points(clip, np.zeros((1, 3)))
    assert np.linalg.norm(step[0, :2]) * 256 == pytest.approx(1.0 / texel)


def test_texels_lie_still_while_the_box_grows() -> None:
    to_sun = np.array([0.6, 0.0, 0.8])
    bounds = np.array([[-3.0, -3.0, 0.0], [3.0, 3.0, 1.0]])
    wider = bounds + np.array([[0.0, 0.0, 0.0], [0.0, 0.137, 0.0]])
    texels = [transform_points(fit_sun(b, to_sun, 512)[0], np.array([[0.3, 0.2, 0.1]]))[0, :2] * 256 for b in (bounds, wider)]
    shift = texels[1] - texels[0]
    np.testing.assert_allclose(shift, np.round(shift), atol=1e-6)


@pytest.mark.egl
@pytest.mark.usefixtures("egl")
class TestDrawn:
    def test_the_shadow_of_a_box_ends_where_geometry_says(self) -> None:
        # The sun is 45 degrees above -x: the top edge at x = 0.5, z = 1 casts its shadow to x = 1.5.
        frame = draw(FLOOR, box((0.0, 0.0, 0.5), RED), camera=ABOVE, light=SUN)
        ends = np.array([[1.5, 0.0, 0.0], [1.0, 0.5, 0.0], [1.0, -0.5, 0.0]])
        pixels, _ = project(transform_points(invert(matrix_from_pose(ABOVE.pose)), ends), ABOVE)
        brightness = frame.rgb[:, :, 2].astype(float)
        middle = (brightness.max() + brightness[brightness > 0].min()) / 2.0
        (u, v), (u1, v1), (u2, _) = pixels
        dark = brightness < middle
        # x is up in this picture, y is left: one edge along the rows, two along the columns.
        assert _edge(dark[:, round(u)], v) <= 2.0
        assert _edge(dark[round(v1)], u1) <= 2.0
        assert _edge(dark[round(v1)], u2) <= 2.0

    def test_without_shadows_nothing_is_dark(self) -> None:
        frame = draw(FLOOR, box((0.0, 0.0, 0.5), RED), camera=ABOVE, light=replace(SUN, shadows=False))
        floor = where(frame, 2) | (frame.rgb.min(axis=2) > 30)
        assert np.ptp(frame.rgb[floor][:, 2].astype(int)) <= 1

    @pytest.mark.parametrize("elevation_deg", [5, 10, 15, 25, 35, 45, 55, 65, 75, 90])
    def test_a_floor_throws_no_shadow_on_itself(self, elevation_deg: float) -> None:
        e = math.radians(elevation_deg)
        light = replace(SUN, sun_direction=(-math.cos(e) * 0.8, math.cos(e) * 0.6, -math.sin(e)), ambient=0.0)
        frame = draw(FLOOR, camera=eye_at((-5.0, -1.0, 2.0), (0.0, 0.0, 0.0), width=160, height=120), light=light)
        shown = np.isfinite(frame.depth) & (frame.depth < 6.0)
        values = frame.rgb[shown][:, 0].astype(int)
        expected = 0.6 * math.sin(e)
        np.testing.assert_allclose(values, 255.0 * (1.055 * expected ** (1 / 2.4) - 0.055), atol=2.0)

    def test_a_ball_throws_no_shadow_on_its_lit_side(self) -> None:
        ball = VisualSpec("ball", "", Shape("sphere", (1.0, 0.0, 0.0)), Pose((0.0, 0.0, 1.0)), WHITE)
        light = replace(SUN, sun_direction=(1.0, 0.3, -0.5), ambient=0.0)
        camera = eye_at((-3.0, -1.0, 1.5), (0.0, 0.0, 1.0), width=128, height=128, outputs=("rgb", "instance", "normal"))
        shaded = draw(ball, FLOOR, camera=camera, light=light)
        to_sun = -np.array(light.sun_direction) / np.linalg.norm(light.sun_direction)
        facing = shaded.normal.astype(float) @ shaded.T_world_camera[:3, :3].T @ to_sun
        lit = (facing > 0.25) & (facing < 0.999) & (shaded.instance == 1)
        expected = 255.0 * (1.055 * (0.6 * facing[lit]) ** (1 / 2.4) - 0.055)
        assert np.abs(shaded.rgb[lit][:, 0] - expected).max() <= 3.0

    def test_moving_body_moves_its_shadow(self) -> None:
        moving = replace(box((0.0, 0.0, 0.5), BLUE), link="a/b", name="mover")
        spot = np.array([[1.2, 0.0, 0.0], [1.2, 3.0, 0.0]])
        pixels, _ = project(transform_points(invert(matrix_from_pose(ABOVE.pose)), spot), ABOVE)
        with Renderer(scene(FLOOR, moving, links=("a/b",), light=SUN)) as renderer:
            found = []
            for y in (0.0, 3.0, 0.0):
                rgb = renderer.render(state(("a/b",), [(0.0, y, 0.0)]), [ABOVE])[0].rgb
                found.append([int(rgb[round(v), round(u), 0]) < 120 for u, v in pixels])
        assert found == [[True, False], [False, True], [True, False]]

    def test_the_same_picture_is_not_drawn_again_when_nothing_moved(self) -> None:
        with Renderer(scene(FLOOR, light=SUN)) as renderer:
            for _ in range(3):
                renderer.render(state(), [ABOVE])
            assert renderer._scene is not None and renderer._scene._shadow is not None
            assert renderer._scene._shadow.drawn == 1

    def test_geometry_outputs_do_not_depend_on_shadows(self) -> None:
        camera = replace(ABOVE, outputs=("depth", "semantic", "instance", "normal"))
        on, off = (
            draw(FLOOR, box((0.0, 0.0, 0.5), RED), camera=camera, light=replace(SUN, shadows=shadows))
            for shadows in (True, False)
        )
        for name in camera.outputs:
            np.testing.assert_array_equal(getattr(on, name), getattr(off, name))


def _edge(dark: np.ndarray, at: float) -> float:
    """Returns the distance, pixels, of the nearest change between light and dark from a position."""
    changes = np.flatnonzero(dark[1:] != dark[:-1]) + 0.5
    return float(np.abs(changes - at).min())


@pytest.mark.egl
@pytest.mark.usefixtures("egl")
def test_masked_texels_cast_no_shadow() -> None:
    pixels = np.full((16, 16, 4), 255, dtype=np.uint8)
    pixels[:, :8, 3] = 0
    material = Material(base_color=WHITE, texture=TextureSource("test", pixels), alpha_mode="mask", unlit=True)
    # Level, 1 m high, 2 x 2 m: its left half in the texture is where y > 0.
    mesh = quad([(1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (-1.0, -1.0, 1.0), (-1.0, 1.0, 1.0)], material)
    spots = np.array([[1.5, 0.5, 0.0], [1.5, -0.5, 0.0]])
    pixel, _ = project(transform_points(invert(matrix_from_pose(ABOVE.pose)), spots), ABOVE)
    with Renderer(scene(mesh_visual(), FLOOR, light=SUN), meshes=loader_of(mesh)) as renderer:
        rgb = renderer.render(state(), [ABOVE])[0].rgb
    through, shaded = (int(rgb[round(v), round(u), 0]) for u, v in pixel)
    assert through > shaded + 50
