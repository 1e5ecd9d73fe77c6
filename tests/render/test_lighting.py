"""Metal, roughness, lamps and image-based light, compared with the same formulas in NumPy."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.shapes import Appearance, Shape, VisualSpec
from gibson_sim.errors import SceneError
from gibson_sim.formats.mesh import Material, TextureSource
from gibson_sim.render.context import open_context
from gibson_sim.render.draw.screen_pass import shader_text
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.spec import LightSpec, PointLight
from gibson_sim.types import Frame, Pose, Rgba, Vec3
from render.drawing import EYE, draw, facing_quad, loader_of, mesh_visual, plate, scene, state

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

F64 = NDArray[np.float64]
WHITE: Rgba = (1.0, 1.0, 1.0, 1.0)
CLOSE = replace(EYE, width=128, height=128, outputs=("rgb", "depth", "normal"))
ONLY_AMBIENT = LightSpec(sun=0.0, background=(0.0, 0.0, 0.0))


def linear(srgb: F64) -> F64:
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def srgb8(values: F64) -> F64:
    v = np.clip(values, 0.0, 1.0)
    return 255.0 * np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)


def ball(metallic: float, roughness: float, color: Rgba = WHITE) -> VisualSpec:
    """Returns a sphere of 0.8 m, 1.6 m ahead of the default camera."""
    appearance = Appearance(metallic=metallic, roughness=roughness)
    return VisualSpec("ball", "", Shape("sphere", (0.8, 0.0, 0.0)), Pose((1.6, 0.0, 0.0)), color, "", appearance)


def seen(frame: Frame, every: int = 7) -> tuple[NDArray[np.uint8], F64, F64]:
    """Returns colours, world normals and world positions, (N, 3) each, of some pixels that show something."""
    assert frame.rgb is not None and frame.depth is not None and frame.normal is not None
    R = frame.T_world_camera[:3, :3]
    k = frame.camera.intrinsics()
    rows, columns = np.nonzero(np.isfinite(frame.depth))
    rows, columns = rows[::every], columns[::every]
    z = frame.depth[rows, columns].astype(np.float64)
    rays = np.stack([(columns - k[0, 2]) / k[0, 0], (rows - k[1, 2]) / k[1, 1], np.ones(len(z))], axis=1)
    points = (rays * z[:, None]) @ R.T + frame.T_world_camera[:3, 3]
    return frame.rgb[rows, columns], frame.normal[rows, columns].astype(np.float64) @ R.T, points


def gltf(n: F64, v: F64, l: F64, base: F64, metallic: float, roughness: float) -> F64:  # noqa: E741
    """Returns brdf * n.l of glTF 2.0, appendix B.3.5, (N, 3), of unit vectors (N, 3)."""
    h = v + l
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    nl, nv, nh, vh = (np.clip(np.einsum("ij,ij->i", a, b), 0.0, None)[:, None] for a, b in ((n, l), (n, v), (n, h), (v, h)))
    black = 0.0
    diffuse_color = (1 - metallic) * base + metallic * black
    f0 = (1 - metallic) * 0.04 + metallic * base
    a2 = roughness**4
    fresnel = f0 + (1 - f0) * (1 - vh) ** 5
    d = a2 / (np.pi * (nh**2 * (a2 - 1) + 1) ** 2)
    visibility = 0.5 / (nl * np.sqrt(nv**2 * (1 - a2) + a2) + nv * np.sqrt(nl**2 * (1 - a2) + a2) + 1e-12)
    result: F64 = ((1 - fresnel) * diffuse_color / np.pi + fresnel * visibility * d) * nl
    return result


@pytest.mark.parametrize(("metallic", "roughness"), [(0.0, 0.35), (1.0, 0.3), (1.0, 0.7), (0.5, 0.5)])
def test_a_lamp_on_a_sphere_gives_the_values_of_gltf(metallic: float, roughness: float) -> None:
    color: Rgba = (0.8, 0.5, 0.3, 1.0)
    lamp = PointLight((-0.5, 1.0, 1.5), (1.0, 0.9, 0.8), strength=2.5)
    light = LightSpec(sun=0.0, ambient=0.0, points=(lamp,))
    rgb, n, x = seen(draw(ball(metallic, roughness, color), camera=CLOSE, light=light))
    to = np.array(lamp.position) - x
    d = np.linalg.norm(to, axis=1, keepdims=True)
    # A white matte surface that faces it at 1 m reflects its strength: the irradiance there is pi times that.
    arriving = np.pi * lamp.strength * linear(np.array(lamp.color)) / d**2
    v = -x / np.linalg.norm(x, axis=1, keepdims=True)
    expected = srgb8(gltf(n, v, to / d, linear(np.array(color[:3])), metallic, roughness) * arriving)
    facing = np.einsum("ij,ij->i", n, v) > 0.15
    assert np.abs(rgb - expected)[facing].max() <= 2.0
    assert expected.max() > 150  # the highlight is in it


def test_a_matte_surface_under_a_lamp_follows_the_cosine() -> None:
    lamp = PointLight((0.0, 1.5, 0.5), strength=2.0)
    rgb, n, x = seen(draw(ball(0.0, 1.0), camera=CLOSE, light=LightSpec(sun=0.0, ambient=0.0, points=(lamp,))))
    to = np.array(lamp.position) - x
    d = np.linalg.norm(to, axis=1)
    expected = srgb8(lamp.strength * np.clip(np.einsum("ij,ij->i", n, to / d[:, None]), 0.0, None) / d**2)
    assert np.abs(rgb[:, 0] - expected).max() <= 2.0


def _middle(light: LightSpec, distance: float = 1.0) -> F64:
    """Returns the linear colour in the middle of a white wall that faces the default camera."""
    rgb = draw(plate((distance + 0.001, 0.0, 0.0), WHITE, 8.0), light=light).rgb
    assert rgb is not None
    return linear(rgb[31:33, 31:33].reshape(-1, 3).mean(axis=0) / 255.0)


def _lamp_at_the_eye(**more: object) -> LightSpec:
    return LightSpec(sun=0.0, ambient=0.0, points=(PointLight((0.0, 0.0, 0.0), strength=0.8, **more),))  # type: ignore[arg-type]


@pytest.mark.parametrize("distance", [1.0, 2.0, 4.0])
def test_a_lamp_falls_with_the_square_of_the_distance(distance: float) -> None:
    np.testing.assert_allclose(_middle(_lamp_at_the_eye(), distance), 0.8 / distance**2, rtol=0.03)


def test_a_lamp_with_an_attenuation_of_its_own_follows_it() -> None:
    np.testing.assert_allclose(_middle(_lamp_at_the_eye(attenuation=(0.5, 0.25, 0.125)), 2.0), 0.8 / 1.5, rtol=0.02)


def test_a_lamp_ends_at_its_range() -> None:
    assert _middle(_lamp_at_the_eye(range=1.9), 2.0).max() == 0.0
    assert _middle(_lamp_at_the_eye(range=4.0), 2.0).min() > 0.15


def test_a_spot_lights_only_its_cone() -> None:
    spot = replace(
        _lamp_at_the_eye().points[0], direction=(1.0, 0.0, 0.0), inner_angle=math.radians(10), outer_angle=math.radians(20)
    )
    rgb = draw(plate((1.001, 0.0, 0.0), WHITE, 8.0), light=LightSpec(sun=0.0, ambient=0.0, points=(spot,))).rgb
    assert rgb is not None
    # The focal length is 32 px: 20 degrees end 11.6 px from the middle at 31.5.
    assert rgb[31, 31, 0] > 200
    assert rgb[31, 31 + 10, 0] > 0
    assert not rgb[31, 31 + 14 :].any()


def _surroundings(folder: Path, image: F64, name: str = "sky.hdr") -> str:
    assert cv2.imwrite(str(folder / name), image[:, :, ::-1].astype(np.float32))
    return str(folder / name)


@pytest.mark.parametrize(("metallic", "roughness"), [(0.0, 1.0), (0.0, 0.7), (0.0, 0.2), (1.0, 1.0), (1.0, 0.5), (1.0, 0.1)])
def test_a_white_ball_in_a_white_furnace_cannot_be_seen(tmp_path: Path, metallic: float, roughness: float) -> None:
    light = replace(ONLY_AMBIENT, ambient=0.0, environment=_surroundings(tmp_path, np.full((32, 64, 3), 0.5)))
    rgb, n, x = seen(draw(ball(metallic, roughness), camera=CLOSE, light=light), every=1)
    facing = np.einsum("ij,ij->i", n, -x / np.linalg.norm(x, axis=1, keepdims=True)) > 0.1
    np.testing.assert_allclose(linear(rgb[facing] / 255.0), 0.5, rtol=0.05)


def test_a_mirror_shows_the_surroundings_behind_the_viewer(tmp_path: Path) -> None:
    image = np.full((64, 128, 3), 0.05)
    image[:, 96:] = (0.0, 0.6, 0.0)  # a quarter to half a turn to the right of +x
    image[:, :32] = (0.6, 0.0, 0.0)  # and to the left
    light = replace(ONLY_AMBIENT, ambient=0.0, environment=_surroundings(tmp_path, image))
    rgb = draw(ball(1.0, 0.0), light=light).rgb
    assert rgb is not None
    # It mirrors what is behind the viewer, left on the left: +y, which is left of the image's middle.
    assert rgb[31, 25, 0] > 150 > 50 > rgb[31, 25, 1]
    assert rgb[31, 38, 1] > 150 > 50 > rgb[31, 38, 0]


def test_matte_surfaces_get_their_light_from_where_the_surroundings_are_bright(tmp_path: Path) -> None:
    image = np.zeros((64, 128, 3))
    image[:32] = 0.8  # the upper half
    light = replace(ONLY_AMBIENT, ambient=0.0, environment=_surroundings(tmp_path, image))
    rgb, n, _ = seen(draw(ball(0.0, 1.0), camera=CLOSE, light=light))
    # A half space of light, tilted by the angle between normal and up: (1 + cos) / 2.
    np.testing.assert_allclose(linear(rgb[:, 0] / 255.0), 0.8 * (1.0 + n[:, 2]) / 2.0, atol=0.05)


def test_the_surroundings_are_seen_where_nothing_is(tmp_path: Path) -> None:
    image = np.zeros((64, 128, 3))
    image[:, :64] = (0.5, 0.0, 0.0)
    image[:, 64:] = (0.0, 0.0, 0.5)
    light = replace(ONLY_AMBIENT, environment=_surroundings(tmp_path, image))
    frame = draw(plate((1.0, 0.0, 0.0)), camera=replace(EYE, outputs=("rgb", "depth", "semantic", "normal")), light=light)
    assert frame.rgb is not None and frame.depth is not None and frame.normal is not None
    np.testing.assert_allclose(frame.rgb[5, 5], [188, 0, 0], atol=1)  # left of +x is left of the middle
    np.testing.assert_allclose(frame.rgb[5, 58], [0, 0, 188], atol=1)
    assert frame.depth[5, 5] == np.inf
    assert not frame.normal[5, 5].any()
    # Turned half around, what was on the left is on the right.
    turned = draw(camera=EYE, light=replace(light, environment_yaw=math.pi)).rgb
    assert turned is not None
    assert turned[5, 5, 2] > 150 > turned[5, 5, 0]
    assert turned[5, 58, 0] > 150 > turned[5, 58, 2]


def test_an_invisible_environment_only_lights(tmp_path: Path) -> None:
    light = replace(ONLY_AMBIENT, environment=_surroundings(tmp_path, np.full((32, 64, 3), 0.5)), environment_visible=False)
    frame = draw(plate((1.0, 0.0, 0.0), WHITE), light=light)
    assert frame.rgb is not None
    assert not frame.rgb[2, 2].any()
    assert frame.rgb[31, 31].min() > 180


def test_a_backdrop_is_seen_and_lights_nothing(tmp_path: Path) -> None:
    grey = _surroundings(tmp_path, np.full((32, 64, 3), 0.5))
    green = _surroundings(tmp_path, np.full((32, 64, 3), (0.0, 1.0, 0.0)), "backdrop.hdr")
    frame = draw(plate((1.0, 0.0, 0.0), WHITE), light=replace(ONLY_AMBIENT, ambient=0.0, environment=grey, backdrop=green))
    assert frame.rgb is not None
    np.testing.assert_array_equal(frame.rgb[2, 2], [0, 255, 0])
    np.testing.assert_allclose(frame.rgb[31, 31], [188, 188, 188], atol=2)
    alone = draw(plate((1.0, 0.0, 0.0), WHITE), light=replace(ONLY_AMBIENT, ambient=0.0, backdrop=green)).rgb
    assert alone is not None
    assert alone[2, 2, 1] == 255 and not alone[31, 31].any()


def test_surroundings_of_the_wrong_shape_are_refused(tmp_path: Path) -> None:
    light = replace(ONLY_AMBIENT, environment=_surroundings(tmp_path, np.full((32, 32, 3), 0.5)))
    with pytest.raises(SceneError, match="is 32x32 pixels; an equirectangular image is twice as wide as high"):
        Renderer(scene(light=light))


def test_the_colour_of_the_sun_is_that_of_a_white_wall() -> None:
    light = LightSpec((1.0, 0.0, 0.0), 0.5, 0.0, sun_color=(1.0, 0.5, 0.25))
    np.testing.assert_allclose(_middle(light), 0.5 * linear(np.array([1.0, 0.5, 0.25])), atol=0.01)


def test_emission_is_seen_without_light() -> None:
    rgb = draw_material(Material(base_color=WHITE, emissive=(0.5, 0.25, 0.0)), LightSpec(sun=0.0, ambient=0.0))
    np.testing.assert_allclose(rgb[31, 31], srgb8(np.array([0.5, 0.25, 0.0])), atol=1.0)


def draw_material(material: Material, light: LightSpec) -> NDArray[np.uint8]:
    """Returns the picture of a wall of this material, 1 m ahead, which fills it."""
    mesh = facing_quad(1.0, 1.0, material)
    with Renderer(scene(mesh_visual(), light=light), meshes=loader_of(mesh)) as renderer:
        rgb = renderer.render(state(), [EYE])[0].rgb
    assert rgb is not None
    return rgb


def test_an_unlit_texture_comes_out_bit_for_bit_under_any_light(tmp_path: Path) -> None:
    # All 256 values, in blocks of 4 x 4 texels; one texel is one pixel.
    values = np.arange(256, dtype=np.uint8).reshape(16, 16).repeat(4, axis=0).repeat(4, axis=1)
    pixels = np.stack([values, values[::-1], values[:, ::-1]], axis=2)
    material = Material(base_color=WHITE, texture=TextureSource("test", np.ascontiguousarray(pixels)), unlit=True)
    light = LightSpec(
        sun=3.0,
        shadows=True,
        points=(PointLight((0.0, 0.0, 0.0)),),
        environment=_surroundings(tmp_path, np.full((32, 64, 3), 0.5)),
    )
    rgb = draw_material(material, light)
    inside = np.ix_([k for k in range(64) if k % 4 in (1, 2)], [k for k in range(64) if k % 4 in (1, 2)])
    np.testing.assert_array_equal(rgb[inside], pixels[inside])


def _map(rgb: Vec3) -> TextureSource:
    return TextureSource("map", np.broadcast_to(np.array(rgb, dtype=np.uint8), (4, 4, 3)).copy())


def test_a_map_of_metal_and_roughness_multiplies_the_factors() -> None:
    lamp = LightSpec(sun=0.0, ambient=0.2, points=(PointLight((0.2, 0.3, 0.4)),))
    mapped = Material(
        base_color=(0.8, 0.5, 0.3, 1.0), metallic=1.0, roughness=1.0, metallic_roughness_texture=_map((0, 102, 255))
    )
    plain = Material(base_color=(0.8, 0.5, 0.3, 1.0), metallic=1.0, roughness=0.4)
    np.testing.assert_allclose(draw_material(mapped, lamp).astype(int), draw_material(plain, lamp).astype(int), atol=1)


def test_green_of_a_normal_map_points_up_in_the_image() -> None:
    up, level = _map((128, 255, 128)), _map((128, 128, 255))
    sky = LightSpec((0.0, 0.0, -1.0), 0.8, 0.1, shadows=False)
    bright, usual, dark = (
        draw_material(Material(base_color=WHITE, roughness=1.0, normal_texture=t), sky)[31, 31, 0]
        for t in (up, level, _map((128, 0, 128)))
    )
    assert bright > usual + 20 > dark + 40


def test_red_of_a_normal_map_points_right_in_the_image() -> None:
    # The wall's right is -y, where this light comes from.
    side = LightSpec((0.0, 1.0, 0.0), 0.8, 0.1)
    right, left = (
        draw_material(Material(base_color=WHITE, roughness=1.0, normal_texture=_map(c)), side)[31, 31, 0]
        for c in ((255, 128, 128), (0, 128, 128))
    )
    assert right > left + 40


def test_occlusion_darkens_ambient_light_and_nothing_else() -> None:
    hidden = Material(base_color=WHITE, occlusion_texture=_map((0, 255, 255)), occlusion_strength=0.5)
    np.testing.assert_allclose(
        linear(draw_material(hidden, ONLY_AMBIENT)[31, 31] / 255.0),
        linear(draw_material(Material(base_color=WHITE), ONLY_AMBIENT)[31, 31] / 255.0) / 2.0,
        rtol=0.02,
    )
    sun = LightSpec((1.0, 0.0, 0.0), 0.5, 0.0)
    np.testing.assert_array_equal(draw_material(hidden, sun), draw_material(Material(base_color=WHITE), sun))


def test_normal_maps_do_not_change_normals() -> None:
    mesh = facing_quad(1.0, 1.0, Material(base_color=WHITE, normal_texture=_map((255, 128, 128))))
    with Renderer(scene(mesh_visual()), meshes=loader_of(mesh)) as renderer:
        normal = renderer.render(state(), [replace(EYE, outputs=("normal",))])[0].normal
    assert normal is not None
    np.testing.assert_allclose(normal[31, 31], (0.0, 0.0, -1.0), atol=1e-3)


def test_surroundings_turn_counter_clockwise(tmp_path: Path) -> None:
    image = np.zeros((64, 128, 3))
    image[:, 63:65] = 0.5  # along +x
    light = replace(ONLY_AMBIENT, environment=_surroundings(tmp_path, image), environment_yaw=math.radians(30))
    rgb = draw(camera=EYE, light=light).rgb
    assert rgb is not None
    # 30 degrees to the left of the middle, at a focal length of 32 px: 18.5 px.
    bright = np.flatnonzero(rgb[31, :, 0] > 90)
    assert abs(bright.mean() - (31.5 - 18.5)) < 1.0


def test_lamps_beyond_the_limit_are_left_out_with_a_warning() -> None:
    dark = PointLight((0.0, 0.0, 0.0), strength=0.0)
    light = LightSpec(sun=0.0, ambient=0.0, points=(*[dark] * 16, PointLight((0.0, 0.0, 0.0))))
    with Renderer(scene(plate((1.0, 0.0, 0.0), WHITE), light=light)) as renderer:
        frame = renderer.render(state(), [EYE])[0]
        assert renderer.warnings == ("the scene has 17 lamps; the first 16 are drawn",)
    assert frame.rgb is not None
    assert not frame.rgb[31, 31].any()


def test_every_combination_of_lights_and_materials_compiles() -> None:
    context = open_context()
    try:
        context.make_current()
        surface = ("WORLD_POSITION", "WORLD_NORMAL")
        choices = ("GLOSS", "POINT_LIGHTS 2", "ENVIRONMENT", "SHADOWS", "MATERIAL_MAPS", "APPEARANCE")
        for chosen in itertools.product((False, True), repeat=len(choices)):
            lit = [name for name, on in zip(choices, chosen, strict=True) if on]
            for others in (
                ("TEXTURED", "MATERIALS", *surface),
                ("MOVING", "ALPHA_TEST", "TEXTURED", *surface, "LABELS", "NORMALS", "FLOW"),
            ):
                defines = (*lit, *others)
                before = ("view.glsl", "lighting.glsl", *(("appearances.glsl",) if "APPEARANCE" in lit else ()))
                fragment = shader_text("scene.frag", defines, before)
                context.gl.program(
                    vertex_shader=shader_text("scene.vert", defines, ("view.glsl",)), fragment_shader=fragment
                ).release()
    finally:
        context.close()


def test_light_from_the_left_of_the_surroundings_falls_on_left_sides(tmp_path: Path) -> None:
    image = np.zeros((64, 128, 3))
    image[:, :64] = 0.8  # left of +x: towards +y
    light = replace(ONLY_AMBIENT, ambient=0.0, environment=_surroundings(tmp_path, image))
    rgb, n, _ = seen(draw(ball(0.0, 1.0), camera=CLOSE, light=light))
    np.testing.assert_allclose(linear(rgb[:, 0] / 255.0), 0.8 * (1.0 + n[:, 1]) / 2.0, atol=0.05)
