"""Light maps: base colour times light, tone-mapped, equals the formula, and no other output changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.shapes import Appearance, Pattern, Shape, VisualSpec
from gibson_sim.formats.glb import Z_UP_TO_Y_UP, GlbBuilder
from gibson_sim.formats.light_maps import light_map_png
from gibson_sim.formats.mesh import LightMapSource, Material, Mesh, MeshPart, TextureSource
from gibson_sim.geometry.colours import linear_from_srgb, srgb_from_linear
from gibson_sim.render import cache
from gibson_sim.render.batching.building import build_geometry
from gibson_sim.render.batching.scene_geometry import VERTEX
from gibson_sim.render.lod.clusters import build_clusters, weld
from gibson_sim.render.renderer import MeshFiles, Renderer, RenderOptions
from gibson_sim.scenes.spec import LightSpec
from gibson_sim.types import OUTPUTS, Frame
from gibson_sim_tools.making.pixels import tone_map
from render.drawing import DARK, EYE, box, draw_mesh, eye_at, facing_quad, loader_of, mesh_visual, scene, state
from support.surfaces import bumpy_grid, detail_from

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

WHITE = Material(base_color=(1.0, 1.0, 1.0, 1.0), unlit=True)
INTENSITY = 6.0
CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)
"""Texture coordinates of the corners of ``facing_quad``."""


def light_map(radiance: NDArray[np.floating] | float, intensity: float = INTENSITY) -> LightMapSource:
    """Returns a light map with these radiances, (H, W, 3), or one number."""
    values = np.broadcast_to(np.asarray(radiance, dtype=np.float64), np.shape(radiance) or (1, 1, 3))
    return LightMapSource("light", np.rint(np.sqrt(values / intensity) * 65535).astype(np.uint16))


def lit(mesh: Mesh, source: LightMapSource, intensity: float = INTENSITY) -> Mesh:
    """Returns a mesh whose light map lies as its base colour."""
    return Mesh(
        tuple(
            replace(part, light_uvs=part.uvs, material=replace(part.material, light_map=source, light_intensity=intensity))
            for part in mesh.parts
        )
    )


def lit_quad(radiance: NDArray[np.floating] | float, material: Material = WHITE) -> Mesh:
    """Returns a quad that fills the image of ``EYE``."""
    return lit(facing_quad(1.0, 1.0, material), light_map(radiance))


def read_linearly(image: NDArray[np.floating], size: int) -> NDArray[np.float64]:
    """Returns an image, (H, W, C), stretched over ``size`` x ``size`` pixels, interpolated linearly and clamped."""
    out = np.asarray(image, dtype=np.float64)
    for axis in (0, 1):
        at = np.clip((np.arange(size) + 0.5) / size * out.shape[axis] - 0.5, 0.0, out.shape[axis] - 1.0)
        low = np.minimum(at.astype(int), out.shape[axis] - 2)
        part = np.expand_dims(at - low, [1, 2] if axis == 0 else [0, 2])
        out = out.take(low, axis) * (1.0 - part) + out.take(low + 1, axis) * part
    return out


def rgb_of(mesh: Mesh, visual: VisualSpec | None = None, light: LightSpec = DARK, **settings: Any) -> NDArray[np.int64]:
    with Renderer(
        scene(visual or mesh_visual(), light=light), meshes=loader_of(mesh), options=RenderOptions(**settings)
    ) as renderer:
        rgb = renderer.render(state(), [EYE])[0].rgb
    assert rgb is not None
    return rgb.astype(np.int64)


def test_pixels_of_a_file_equal_the_formula(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    tile = rng.integers(0, 256, (16, 16, 3)).astype(np.uint8)  # repeats four times, so a texel covers a pixel
    radiance = rng.uniform(0.05, 3.0, (8, 8, 3)) * np.linspace(0.1, 1.9, 8)[:, None, None]
    builder = GlbBuilder()
    ok, picture = cv2.imencode(".png", tile[:, :, ::-1])
    assert ok
    base = {"baseColorTexture": {"index": builder.texture_data(picture.tobytes())}, "baseColorFactor": [1.0, 1.0, 0.5, 1.0]}
    light = builder.texture_data(light_map_png(radiance, INTENSITY))
    attributes = {
        "POSITION": builder.attribute([[1, 1, 1], [1, -1, 1], [1, -1, -1], [1, 1, -1]], bounds=True),
        "TEXCOORD_0": builder.attribute(4.0 * CORNERS),
        "TEXCOORD_1": builder.attribute(CORNERS * 65535, "u2", normalized=True),
        "COLOR_0": builder.attribute([[65535, 32768, 52428]] * 4, "u2", normalized=True),
    }
    material = builder.light_mapped_material({"pbrMetallicRoughness": base}, light, INTENSITY)
    builder.primitive(attributes, builder.indices([[0, 2, 1], [0, 3, 2]]), material)
    (tmp_path / "quad.glb").write_bytes(builder.to_bytes("quad", Z_UP_TO_Y_UP.astype(float)))
    visual = VisualSpec("quad", "", Shape("mesh", (1.0, 1.0, 1.0), str(tmp_path / "quad.glb")))
    with Renderer(scene(visual), meshes=MeshFiles(allowed_roots=[tmp_path])) as renderer:
        (frame,), (again,) = (renderer.render(state(), [EYE]) for _ in range(2))
        assert not renderer.warnings
    assert frame.rgb is not None and again.rgb is not None
    base_color = linear_from_srgb(np.tile(tile, (4, 4, 1)) / 255.0) * np.array([1.0, 0.5, 0.8 * 0.5])
    expected = tone_map(base_color * read_linearly(radiance, 64))
    assert np.abs(frame.rgb.astype(int) - expected).max() <= 2
    assert (np.abs(frame.rgb.astype(int) - expected) <= 1).mean() > 0.999
    np.testing.assert_array_equal(frame.rgb, again.rgb)


@pytest.mark.parametrize("tint", [(1.0, 1.0, 1.0), (1.0, 0.6, 0.25), (0.3, 0.5, 1.0)])
def test_the_tone_curve_is_that_of_baked_scenes(tint: tuple[float, float, float]) -> None:
    radiance = np.linspace(0.0, np.sqrt(8.0), 64)[None, :, None] ** 2 * np.array(tint)
    rgb = rgb_of(lit(facing_quad(1.0, 1.0, WHITE), light_map(np.repeat(radiance, 2, axis=0), 8.0), 8.0))
    assert np.abs(rgb[32] - tone_map(radiance[0])).max() <= 1


def test_a_surface_without_a_texture_has_its_colour_in_the_light() -> None:
    grey = srgb_from_linear([0.5, 0.5, 0.5]).tolist()
    rgb = rgb_of(lit_quad(0.4, replace(WHITE, base_color=(*grey, 1.0))))
    assert np.abs(rgb[32, 32] - tone_map([0.2] * 3)).max() <= 1


def test_a_colour_of_the_visual_replaces_base_colour_and_light_map() -> None:
    visual = replace(mesh_visual(), color=(0.0, 1.0, 0.0, 1.0))
    plain = rgb_of(facing_quad(1.0, 1.0, Material()), visual)
    np.testing.assert_array_equal(rgb_of(lit_quad(0.01), visual), plain)


def test_no_other_output_changes() -> None:
    part = bumpy_grid(40, half=1.5, material=WHITE)
    camera = eye_at((-1.5, 0.2, 1.2), look_at=(0.3, 0.0, 0.0), width=90, height=70, outputs=OUTPUTS)
    frames: list[Frame] = []
    for mesh in (Mesh((part,)), lit(Mesh((part,)), light_map(np.random.default_rng(2).uniform(0.0, 4.0, (16, 16, 3))))):
        with Renderer(scene(mesh_visual("a"), box((0.5, 0.0, 0.3)), links=("a",)), meshes=loader_of(mesh)) as renderer:
            now, before = (state(("a",), [(0.0, y, 0.0)]) for y in (0.0, 0.1))
            frames.append(renderer.render(now, [camera], before)[0])
    for name in OUTPUTS:
        same = np.array_equal(
            getattr(frames[0], name),
            getattr(frames[1], name),
            equal_nan=name != "rgb" and "float" in str(getattr(frames[0], name).dtype),
        )
        assert same == (name != "rgb"), name


def test_light_does_not_bleed_from_distant_charts() -> None:
    """A bright chart on a dark image keeps its light when it covers a few pixels: the light map has no mip levels."""
    radiance = np.zeros((64, 64, 3))
    radiance[8:24, 8:24] = 1.0
    far = facing_quad(40.0, 1.5, WHITE)
    charts = replace(far.parts[0], uvs=(10.0 + 12.0 * CORNERS).astype(np.float32) / 64.0)
    rgb = rgb_of(lit(Mesh((charts,)), light_map(radiance)))
    lit_pixels = rgb[rgb.max(axis=2) > 0]
    assert len(lit_pixels) >= 4 and np.abs(lit_pixels - tone_map([1.0] * 3)).max() <= 1


def test_charts_meet_without_a_seam() -> None:
    """Two charts at different places of the image, with equal light along their common edge and one texel beyond it."""
    ramp = np.linspace(0.2, 1.8, 17)  # light along y, at the corners of 16 texels of both halves
    middles = 0.5 * (ramp[1:] + ramp[:-1])
    radiance = np.zeros((4, 40, 3))
    radiance[:, 2:11] = middles[:9, None]  # the left half, eight texels, and one texel of the right one
    radiance[:, 20:29] = middles[7:, None]  # one texel of the left half, and the right one
    left, right = (facing_quad(1.0, 1.0, WHITE).parts[0] for _ in range(2))
    half = CORNERS * [0.5, 1.0]
    parts = []
    for part, offset, first in ((left, 0.0, 2.0), (right, 0.5, 21.0)):
        vertices = part.vertices.copy()
        vertices[:, 1] = 1.0 - 2.0 * (half[:, 0] + offset)
        uvs = np.stack([(first + 16.0 * half[:, 0]) / 40.0, np.full(4, 0.5)], axis=1).astype(np.float32)
        parts.append(replace(part, vertices=vertices, uvs=uvs))
    rgb = rgb_of(lit(Mesh(tuple(parts)), light_map(radiance)))
    row = rgb[32, 4:-4]  # without the borders of the image, where the charts end
    assert (np.diff(row, axis=0) >= 0).all() and np.diff(row, axis=0).max() <= 6  # a step to the gap would be above 50


def _charts(cells: int) -> MeshPart:
    """Returns a relief of two charts, which meet at x = 0 with vertices of their own."""
    part = bumpy_grid(cells, height=0.02, material=WHITE)
    upper = part.vertices[part.triangles].mean(axis=1)[:, 0] > 0.0
    vertices, normals, uvs, triangles, light_uvs, count = [], [], [], [], [], 0
    for side in (False, True):
        used, faces = np.unique(part.triangles[upper == side], return_inverse=True)
        assert part.uvs is not None
        vertices.append(part.vertices[used])
        normals.append(part.normals[used])
        uvs.append(part.uvs[used])
        light_uvs.append(part.uvs[used] * [0.4, 1.0] + [0.55 if side else 0.0, 0.0])
        triangles.append(faces.reshape(-1, 3) + count)
        count += len(used)
    return MeshPart(
        np.concatenate(vertices), np.concatenate(normals), np.concatenate(uvs), np.concatenate(triangles).astype(np.uint32), WHITE,
        light_uvs=np.concatenate(light_uvs).astype(np.float32),
    )  # fmt: skip


def test_coarser_levels_do_not_mix_charts() -> None:
    part = _charts(60)
    assert part.uvs is not None and part.light_uvs is not None
    clusters = build_clusters(
        part.vertices, part.normals, part.uvs, part.triangles.astype(np.int64), 256, light_uvs=part.light_uvs
    )
    assert clusters.level.max() >= 3
    chart = part.light_uvs[:, 0] > 0.5
    assert not np.ptp(chart[clusters.triangles].astype(int), axis=1).any()


def test_coarser_levels_keep_the_light() -> None:
    part = _charts(100)
    u = np.linspace(0.0, 1.0, 64)[None, :, None]
    radiance = np.broadcast_to(0.1 + 2.0 * u * np.array([1.0, 0.8, 0.6]), (8, 64, 3))
    mesh = Mesh((replace(part, material=replace(WHITE, light_map=light_map(radiance), light_intensity=INTENSITY)),))
    camera = eye_at((-3.0, 0.3, 2.0), look_at=(0.0, 0.0, 0.0), width=160, height=120)
    frames, triangles = [], []
    for detail in (0.0, 1.0):
        with (
            detail_from(1),
            Renderer(scene(mesh_visual()), meshes=loader_of(mesh), options=RenderOptions(detail_px=detail)) as renderer,
        ):
            frames.append(renderer.render(state(), [camera])[0])
            triangles.append(renderer.drawn_triangles)
    exact, coarse = (f.rgb.astype(int) for f in frames)
    both = np.isfinite(frames[0].depth) & np.isfinite(frames[1].depth)
    assert triangles[1] < 0.5 * triangles[0]
    assert np.percentile(np.abs(exact - coarse)[both], 99) <= 3


def test_culling_changes_no_byte() -> None:
    mesh = lit(Mesh((bumpy_grid(60, material=WHITE),)), light_map(np.random.default_rng(3).uniform(0.0, 4.0, (16, 16, 3))))
    camera = eye_at((0.5, 0.2, 0.4), look_at=(2.0, 0.5, 0.0), width=80, height=60)
    pictures = []
    for cull in (True, False):
        with Renderer(scene(mesh_visual()), meshes=loader_of(mesh), options=RenderOptions(cull=cull)) as renderer:
            pictures.append(renderer.render(state(), [camera])[0].rgb)
    np.testing.assert_array_equal(*pictures)


def test_scenes_without_light_maps_have_small_vertices() -> None:
    mesh, shape = facing_quad(1.0, 1.0, WHITE), mesh_visual()
    plain, with_light = (build_geometry([shape], [], loader_of(m)) for m in (mesh, lit_quad(1.0)))
    assert plain.vertices.dtype == VERTEX and not plain.light_maps
    assert with_light.vertices.dtype.itemsize == VERTEX.itemsize + 4 and len(with_light.light_maps) == 1
    assert len(np.unique(weld(with_light.vertices["position"]))) == 4


def test_a_cached_scene_draws_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "SMALLEST", 1)
    (tmp_path / "light.png").write_bytes(light_map_png(np.random.default_rng(4).uniform(0.0, 2.0, (8, 8, 3)), 2.0))
    builder = GlbBuilder()
    material = builder.light_mapped_material({}, builder.texture_file("light.png"), 2.0)
    attributes = {
        "POSITION": builder.attribute([[1, 1, 1], [1, -1, 1], [1, -1, -1], [1, 1, -1]], bounds=True),
        "TEXCOORD_1": builder.attribute(CORNERS * 65535, "u2", normalized=True),
    }
    builder.primitive(attributes, builder.indices([[0, 2, 1], [0, 3, 2]]), material)
    (tmp_path / "quad.glb").write_bytes(builder.to_bytes("quad", Z_UP_TO_Y_UP.astype(float)))
    visual = VisualSpec("quad", "", Shape("mesh", (1.0, 1.0, 1.0), str(tmp_path / "quad.glb")))
    seen = []
    for _ in range(2):
        with Renderer(scene(visual), meshes=MeshFiles(allowed_roots=[tmp_path], cache=tmp_path / "cache")) as renderer:
            seen.append(renderer.render(state(), [EYE])[0].rgb)
    assert len(list((tmp_path / "cache").glob("*.scene"))) == 1
    assert np.ptp(seen[0]) > 50
    np.testing.assert_array_equal(*seen)


def test_a_light_mapped_body_joins_a_scene_without_light_maps() -> None:
    far = VisualSpec("far", "", Shape("mesh", mesh="/far"))
    near = VisualSpec("near", "body/link", Shape("mesh", mesh="/near"))
    blue = facing_quad(2.0, 2.0, replace(WHITE, texture=TextureSource("blue", np.array([[[0, 0, 255]]], dtype=np.uint8))))
    later = lit(facing_quad(1.0, 0.5, replace(WHITE, colored=True)), light_map(0.3))
    later = Mesh((replace(later.parts[0], uvs=None, colors=np.full((4, 3), (255, 188, 0), dtype=np.uint8)),))

    def load(shape: Shape) -> Mesh:
        return blue if shape.mesh == "/far" else later

    before, after = scene(far), scene(far, near, links=("body/link",))
    with Renderer(before, meshes=load) as renderer:
        assert renderer.render(state(), [EYE])[0].rgb[32, 32].tolist() == [0, 0, 255]
        assert not renderer.update(replace(after, revision=2))  # not reloaded
        rgb = renderer.render(state(["body/link"], [(0.0, 0.0, 0.0)], revision=2), [EYE])[0].rgb.astype(int)
    assert np.abs(rgb[32, 32] - tone_map([0.3, 0.15, 0.0])).max() <= 2
    assert rgb[2, 2].tolist() == [0, 0, 255]


def test_tints_and_patterns_change_the_base_colour_and_keep_the_light() -> None:
    red = TextureSource("red", np.array([[[188, 0, 0]]], dtype=np.uint8))
    quad = lit_quad(0.5, replace(WHITE, texture=red))

    def seen(appearance: Appearance) -> NDArray[np.int64]:
        return rgb_of(quad, replace(mesh_visual(), appearance=appearance))[32, 32]

    assert np.abs(seen(Appearance()) - tone_map([0.25, 0.0, 0.0])).max() <= 2
    assert np.abs(seen(Appearance(value=0.5)) - tone_map([0.125, 0.0, 0.0])).max() <= 2
    assert np.ptp(seen(Appearance(saturation=0.0))) <= 2
    plain = Pattern("stripes", 0, ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5)), 1.0)
    grey = linear_from_srgb([0.5] * 3)
    assert np.abs(seen(Appearance(pattern=plain)) - tone_map(0.5 * grey)).max() <= 2


def test_the_strength_of_the_environment_scales_light_maps() -> None:
    half = rgb_of(lit_quad(0.8), light=LightSpec(background=(0.0, 0.0, 0.0), environment_strength=0.5))
    assert np.abs(half[32, 32] - tone_map([0.4] * 3)).max() <= 1


@pytest.mark.parametrize(("mode", "expected"), [("mask", None), ("blend", 0.4)])
def test_alpha_cuts_holes_and_blends(mode: str, expected: float | None) -> None:
    texture = TextureSource("grey", np.array([[[255, 255, 255, 102]]], dtype=np.uint8))
    rgb = rgb_of(lit_quad(0.5, replace(WHITE, texture=texture, alpha_mode=mode)))  # type: ignore[arg-type]
    opaque = linear_from_srgb(tone_map([0.5] * 3) / 255.0)
    assert np.abs(rgb[32, 32] / 255.0 - srgb_from_linear(opaque * (expected or 0.0))).max() < 0.01


def test_smooth_edges_have_the_same_colours() -> None:
    def drawn(samples: int) -> NDArray[np.int64]:
        rgb = draw_mesh(lit_quad(0.7), camera=replace(EYE, samples=samples)).rgb
        assert rgb is not None
        return rgb.astype(np.int64)

    assert np.abs(drawn(4)[32, 32] - drawn(1)[32, 32]).max() <= 1


def test_every_camera_sees_the_same_light() -> None:
    wide = replace(EYE, name="wide", projection="fisheye", fov_y=1.6, width=96, height=96)
    round_about = replace(EYE, name="round", projection="equirectangular", width=128, height=64)
    quad = lit_quad(0.9, replace(WHITE, base_color=(0.8, 0.6, 0.4, 1.0)))
    expected = tone_map(0.9 * linear_from_srgb([0.8, 0.6, 0.4]))
    for share in (True, False):
        with Renderer(scene(mesh_visual()), meshes=loader_of(quad), options=RenderOptions(share_targets=share)) as renderer:
            for frame in renderer.render(state(), [EYE, wide, round_about, replace(EYE, name="small", width=32)]):
                assert frame.rgb is not None
                height, width = frame.rgb.shape[:2]
                assert np.abs(frame.rgb[height // 2, width // 2].astype(int) - expected).max() <= 1, frame.camera
