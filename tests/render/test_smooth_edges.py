"""Four samples a pixel antialias colours, in linear light, and change nothing else."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.errors import RenderError
from gibson_sim.formats.mesh import Material, Mesh
from gibson_sim.render.context import open_context
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.render.renderer import Renderer, RenderOptions
from gibson_sim.types import OUTPUTS, CameraSpec, Frame
from render.drawing import BLUE, EYE, RED, box, draw, draw_mesh, eye_at, loader_of, mesh_visual, quad, scene, state
from support.surfaces import bumpy_sphere, textured

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

SMOOTH = replace(EYE, width=128, height=128, samples=4, outputs=("rgb",))
"""Focal length 64 px, the middle at (63.5, 63.5)."""
CORNERS = [(2.0, 1.1, 1.3), (2.0, -1.4, 0.9), (2.0, -1.2, -1.5), (2.0, 1.5, -1.0)]
"""A quad askew, 2 m ahead."""
GREYS = [0, 137, 188, 225, 255]
"""0, 1/4, 1/2, 3/4 and all of white's light as sRGB: 255 (1.055 x^(1/2.4) - 0.055)."""


def _linear(image: NDArray[np.uint8]) -> NDArray[np.float64]:
    c = image / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def _white_on_black() -> NDArray[np.uint8]:
    mesh = quad(CORNERS, Material(base_color=(1.0, 1.0, 1.0, 1.0), unlit=True))
    return draw_mesh(mesh, camera=SMOOTH).rgb[..., 1]


def _coverage(parts: int = 16) -> NDArray[np.float64]:
    """Returns which part of each pixel the quad covers."""
    corners = [(63.5 - 64 * y / x, 63.5 - 64 * z / x) for x, y, z in CORNERS]  # clockwise in the image
    at = (np.arange(128 * parts) + 0.5) / parts - 0.5
    u, v = np.meshgrid(at, at)
    inside = np.ones(u.shape, dtype=bool)
    for (u0, v0), (u1, v1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        inside &= (u1 - u0) * (v - v0) - (v1 - v0) * (u - u0) > 0
    return inside.reshape(128, parts, 128, parts).mean(axis=(1, 3))


def test_an_edge_has_the_light_of_its_covered_part() -> None:
    found, expected = _linear(_white_on_black()), _coverage()
    edge = (expected > 0.0) & (expected < 1.0)
    assert edge.sum() > 250
    assert found[edge].mean() == pytest.approx(expected[edge].mean(), rel=0.02)
    # The four samples of a pixel resolve its coverage to about a quarter.
    assert np.abs(found - expected)[edge].max() < 0.3
    assert np.corrcoef(found[edge], expected[edge])[0, 1] > 0.95


def test_the_four_sides_are_all_where_they_should_be() -> None:
    difference = _linear(_white_on_black()) - _coverage()
    for half in (difference[:64], difference[64:], difference[:, :64], difference[:, 64:]):
        # An edge that is off by 0.1 px changes a sum over 90 px of edge by 9.
        assert abs(half.sum()) < 4.0


def test_samples_are_mixed_in_linear_light() -> None:
    found = np.unique(_white_on_black()).astype(int)
    assert len(found) == 5
    np.testing.assert_allclose(found, GREYS, atol=1)  # drivers round as they like


def test_covered_pixels_are_white_and_the_rest_black() -> None:
    image, expected = _white_on_black(), _coverage()
    assert (image[expected == 1.0] == 255).all()
    assert (image[expected == 0.0] == 0).all()


def test_two_colours_that_meet_mix_without_a_third() -> None:
    two = [box((3.0, y, 0.2 * y), color, (0.1, 1.0, 1.0)) for y, color in ((0.5, RED), (-0.5, BLUE))]
    camera = eye_at((0.0, 0.0, 0.0), look_at=(3.0, 0.013, 0.0), width=128, height=128, samples=4)
    smooth = _linear(draw(*two, camera=camera).rgb)
    plain = _linear(draw(*two, camera=replace(camera, samples=1)).rgb)
    red, blue = plain[..., 0].max(), plain[..., 2].max()
    # Along the border there is no black: the two coverages sum to one.
    middle = smooth[60:68, 20:108]
    parts = middle[..., 0] / red + middle[..., 2] / blue
    mixed = (middle[..., 0] > 0.1 * red) & (middle[..., 2] > 0.1 * blue)
    assert mixed.sum() >= 4
    np.testing.assert_allclose(parts[mixed], 1.0, atol=0.02)


CAMERA = eye_at((-2.2, 0.4, 0.8), look_at=(0.0, 0.0, 0.0), width=97, height=61, outputs=OUTPUTS)


def _plain_and_smooth(camera: CameraSpec) -> list[Frame]:
    drawn = scene(mesh_visual("robot/a"), box((1.0, 1.4, 0.0)), links=("robot/a",))
    now, before = (state(["robot/a"], [(0.0, y, 0.0)]) for y in (0.0, 0.05))
    with Renderer(drawn, meshes=loader_of(Mesh((bumpy_sphere(30),)))) as renderer:
        return [renderer.render(now, [replace(camera, samples=n)], before)[0] for n in (1, 4)]


def test_everything_but_colours_is_the_same_to_the_bit() -> None:
    plain, smooth = _plain_and_smooth(CAMERA)
    for output in OUTPUTS:
        if output != "rgb":
            np.testing.assert_array_equal(getattr(smooth, output), getattr(plain, output), err_msg=output)
    assert np.isfinite(plain.depth).sum() > 500
    assert not np.array_equal(smooth.rgb, plain.rgb)


def test_only_colours_are_interpolated_in_a_non_pinhole_image() -> None:
    # It is resampled from finer views, so a pixel may show another point, but it shows one point.
    plain, smooth = _plain_and_smooth(replace(CAMERA, projection="fisheye"))
    kernel = np.ones((3, 3), np.uint8)
    one = cv2.dilate(plain.instance, kernel) == cv2.erode(plain.instance, kernel)
    np.testing.assert_array_equal(smooth.instance[one], plain.instance[one])
    assert set(np.unique(smooth.instance)) == {0, 1, 2}
    nearest, farthest = (np.nanmin(np.where(one, plain.depth, np.nan)), np.nanmax(plain.depth[np.isfinite(plain.depth)]))
    there = smooth.depth[np.isfinite(smooth.depth)]
    assert nearest - 0.01 < there.min() and there.max() < farthest + 0.3
    lengths = np.linalg.norm(smooth.normal[smooth.instance > 0], axis=1)
    np.testing.assert_allclose(lengths, 1.0, atol=1e-3)


@pytest.mark.parametrize("unlit", [True, False])
def test_colours_off_edges_stay_as_they_are(unlit: bool) -> None:
    camera = replace(CAMERA, width=200, height=150)
    drawn = scene(mesh_visual(), box((1.0, 1.4, 0.0)))
    meshes = loader_of(Mesh((bumpy_sphere(30, material=textured("one", unlit)),)))
    with Renderer(drawn, meshes, RenderOptions(detail_px=0.0)) as renderer:
        plain, smooth = (renderer.render(state(), [replace(camera, samples=n)])[0] for n in (1, 4))
    kernel = np.ones((3, 3), np.uint8)
    one = cv2.dilate(plain.instance, kernel) == cv2.erode(plain.instance, kernel)
    depth = np.where(np.isfinite(plain.depth), plain.depth, 0.0).astype(np.float32)
    smooth_there = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel) < 0.1
    flat = np.einsum("ijk,ijk->ij", plain.normal[1:-1, 1:-1], plain.normal[1:-1, 2:]) > 0.9
    inside = one & smooth_there
    inside[1:-1, 1:-1] &= flat
    assert (inside & np.isfinite(plain.depth)).sum() > 3_000
    assert np.abs(smooth.rgb.astype(int) - plain.rgb)[inside].max() <= 1


def test_more_samples_than_the_driver_has_are_refused() -> None:
    context = open_context()
    try:
        with pytest.raises(RenderError, match=r"1024 samples a pixel are requested, .* draws at most \d+"):
            RenderTarget(context, 16, 16, samples=1024)
    finally:
        context.close()
