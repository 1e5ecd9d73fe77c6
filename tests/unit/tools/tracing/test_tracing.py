"""Exporting scenes to Blender, its pictures and their cache, without Blender; one test runs it where it is installed."""

from __future__ import annotations

import importlib.util
import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.geometry.colours import srgb8_from_linear
from gibson_sim.resources import find_scene
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import DrawnScene, LightSpec, PointLight, SceneSpec, drawn_scene
from gibson_sim.types import CameraSpec, Pose, SceneState
from gibson_sim_tools.making.building import read_plan
from gibson_sim_tools.making.pixels import tone_map
from gibson_sim_tools.tracing.export import code_files, code_text, traced_scene, write_traced_scene
from gibson_sim_tools.tracing.pictures import Outside, curve_of, developed, exposure_samples, fit_exposure, noise_of
from gibson_sim_tools.tracing.plans import check_plan, plan_of_scene
from gibson_sim_tools.tracing.tracer import CyclesTracer, TracedPicture, check_camera, picture_key

LIGHT = LightSpec(sun=0.0, ambient=0.0, points=(PointLight((0.0, 0.0, 1.0)),), background=(0.0, 0.0, 0.0))
CAMERA = CameraSpec("eye", "", width=32, height=24, fov_y=math.radians(60.0))
STILL = np.eye(4)


@pytest.fixture(scope="module")
def linden_flat() -> SceneSpec:
    return load_scene("linden_flat")


def _scene(*visuals: VisualSpec, light: LightSpec = LIGHT) -> DrawnScene:
    links = tuple(dict.fromkeys(visual.link for visual in visuals if visual.link))
    return DrawnScene("test", 1, "hash", links, visuals, (), light)


def _box(name: str = "box", link: str = "", size: float = 0.5, z: float = 2.0) -> VisualSpec:
    return VisualSpec(name, link, Shape("box", (size, size, size)), Pose((0.0, 0.0, z)), (0.5, 0.25, 1.0, 1.0))


def _picture(rgb: Any, alpha: float = 1.0) -> TracedPicture:
    colors = np.asarray(rgb, dtype=np.float32)
    shape = colors.shape[:2]
    zeros = np.zeros(shape, dtype=np.uint8)
    return TracedPicture(
        colors, np.zeros_like(colors), np.full(shape, alpha, dtype=np.float32), np.ones(shape, dtype=np.float32), zeros > 0, zeros
    )


def _save(path: Path, picture: TracedPicture) -> None:
    path.parent.mkdir(exist_ok=True)
    np.savez(
        path, rgb=picture.rgb, spread=picture.spread, alpha=picture.alpha, depth=picture.depth, moving=picture.moving,
        material=picture.material,
    )  # fmt: skip


# Plans


def test_a_generated_scene_has_the_plan_of_its_first_line(linden_flat: SceneSpec) -> None:
    scene = drawn_scene(replace(linden_flat, bodies=()), ())
    building = plan_of_scene(scene)
    assert building is not None
    assert (building.name, building.kind, building.seed) == ("linden_flat", "flat", 14)
    assert check_plan(building, scene) == {visual.name for visual in scene.visuals}


def test_a_scene_by_hand_has_no_plan() -> None:
    assert plan_of_scene(drawn_scene(load_scene("arena"), ())) is None


def test_a_scene_of_another_plan_is_refused_with_the_object_that_differs(linden_flat: SceneSpec) -> None:
    scene = drawn_scene(replace(linden_flat, bodies=()), ())
    building = plan_of_scene(scene)
    assert building is not None
    sofa = next(piece for piece in building.pieces if piece.kind == "sofa")
    shifted = replace(sofa, position=(sofa.position[0] + 0.1, *sofa.position[1:]))
    moved = replace(building, pieces=tuple(shifted if piece == sofa else piece for piece in building.pieces))
    with pytest.raises(SceneError, match=rf"{sofa.name} is not where its plan has it"):
        check_plan(moved, scene)


@pytest.mark.parametrize(
    ("options", "error"),
    [("--kind flat", "names no --kind and --seed"), ("--name 'my flat", "is no command: No closing quotation")],
)
def test_a_first_line_that_gives_no_plan_is_refused(options: str, error: str, tmp_path: Path) -> None:
    assets = tmp_path / "assets"
    assets.mkdir()
    (tmp_path / "scene.yaml").write_text(f"# Made by: gibson-sim scene generate {options}\nname: x\n")
    visual = VisualSpec("x", "", Shape("mesh", mesh=str(assets / "x.glb")))
    with pytest.raises(SceneError, match=error):
        plan_of_scene(_scene(visual))


# Export


def test_walls_of_a_plan_are_not_exported_and_bodies_are(linden_flat: SceneSpec, tmp_path: Path) -> None:
    body = next(body for body in linden_flat.bodies if body.name == "front_door")
    links = tuple(f"{body.name}/{link}" for link in body.links)
    scene = traced_scene(drawn_scene(replace(linden_flat, bodies=(body,)), links))
    assert {link for _, link, _ in scene.placements} == {links.index("front_door/leaf"), links.index("front_door/handle")}
    write_traced_scene(scene, tmp_path)
    assert read_plan(tmp_path / "plan.json")[0] == scene.building
    description = json.loads((tmp_path / "scene.json").read_text())
    assert len(description["placements"]) == len(scene.placements)
    textures = [part["material"]["texture"] for part in description["parts"] if part["material"]["texture"]]
    assert textures, "the oak of the leaf"
    for texture in textures:
        assert cv2.imread(str(tmp_path / texture["file"])) is not None


def test_colours_are_exported_linear_with_their_triangles(tmp_path: Path) -> None:
    write_traced_scene(traced_scene(_scene(_box())), tmp_path)
    description = json.loads((tmp_path / "scene.json").read_text())
    assert description["parts"][0]["material"]["color"] == pytest.approx([0.2140, 0.0509, 1.0, 1.0], abs=1e-3)
    assert description["placements"] == [
        {"part": 0, "link": -1, "matrix": pytest.approx([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 2, 0, 0, 0, 1])}
    ]
    with np.load(tmp_path / "meshes.npz") as arrays:
        assert len(arrays["triangles_0"]) == 12
        assert np.abs(arrays["vertices_0"]).max() == pytest.approx(0.25)
    assert not (tmp_path / "plan.json").exists()


def test_digest_changes_with_what_a_picture_shows() -> None:
    base = traced_scene(_scene(_box())).digest
    assert traced_scene(_scene(_box())).digest == base
    changed = [
        _scene(_box(size=0.6)), _scene(_box(z=2.1)), _scene(_box(link="thing/link")), _scene(replace(_box(), color=(0.5, 0.3, 1.0, 1.0))),
        _scene(_box(), light=replace(LIGHT, sun=0.1)),
    ]  # fmt: skip
    digests = [traced_scene(scene).digest for scene in changed]
    assert len({base, *digests}) == 6


def test_digest_depends_on_the_content_of_the_backdrop_and_not_on_its_folder(tmp_path: Path) -> None:
    def digest(folder: str, level: int) -> str:
        path = tmp_path / folder / "backdrop.png"
        path.parent.mkdir()
        cv2.imwrite(str(path), np.full((4, 8, 3), level, dtype=np.uint8))
        return traced_scene(_scene(_box(), light=replace(LIGHT, backdrop=str(path)))).digest

    assert digest("a", 10) == digest("b", 10) != digest("c", 20)


def test_the_environment_of_a_bake_does_not_change_its_traced_pictures(linden_flat: SceneSpec) -> None:
    scene = drawn_scene(replace(linden_flat, bodies=()), ())
    assert scene.light.environment
    without = replace(scene, light=replace(scene.light, environment=""))
    assert traced_scene(without).digest == traced_scene(scene).digest


def test_a_visual_that_cannot_be_read_is_left_out_with_a_warning(tmp_path: Path) -> None:
    missing = VisualSpec("lost", "", Shape("mesh", mesh=str(tmp_path / "lost.glb")))
    scene = traced_scene(_scene(_box(), missing))
    assert len(scene.placements) == 1
    assert "visual 'lost' is not traced" in scene.warnings[0]


def test_comments_docstrings_and_layout_are_no_part_of_the_code() -> None:
    first = 'def f(x):\n    """Adds one."""\n    return x + 1  # one\n'
    assert code_text(first) == code_text("def f( x ):\n    return x+1\n")
    assert code_text(first) != code_text("def f(x):\n    return x + 2\n")


def test_the_code_that_draws_tiles_counts_and_that_of_the_bake_does_not() -> None:
    names = {path.name for path in code_files()}
    assert {"tiles.py", "stage.py", "trace.py", "traced_materials.py"} <= names
    assert not {"bake.py", "charts.py"} & names


# Cameras and the cache


@pytest.mark.parametrize(
    "camera",
    [
        replace(CAMERA, projection="fisheye"),
        replace(CAMERA, distortion=(0.1, 0.0, 0.0, 0.0)),
        replace(CAMERA, matrix=(30.0, 1.0, 16.0, 0.0, 30.0, 12.0, 0.0, 0.0, 1.0)),
    ],
)
def test_a_camera_that_cycles_cannot_draw_is_refused(camera: CameraSpec) -> None:
    with pytest.raises(ConfigError, match="Cycles draws pinhole cameras without distortion and skew"):
        check_camera(camera)


def test_key_of_a_picture_is_that_of_scene_pose_camera_and_samples() -> None:
    request = {"matrix": [1.0], "k": [2.0], "samples": 4, "links": []}
    key = picture_key("a" * 64, request)
    assert picture_key("a" * 64, dict(reversed(request.items()))) == key
    for name, value in (("matrix", [1.1]), ("k", [2.1]), ("samples", 6), ("links", [[0.0]])):
        assert picture_key("a" * 64, {**request, name: value}) != key
    assert picture_key("b" * 64, request) != key


def test_cached_picture_needs_no_blender(tmp_path: Path) -> None:
    scene = traced_scene(_scene(_box()))
    saved = _picture(np.full((24, 32, 3), 0.25))
    with CyclesTracer(scene, "no-such-python", 8, cache=tmp_path) as tracer:
        state = SceneState.still()
        assert not tracer.is_cached(CAMERA, STILL, state)
        with pytest.raises(SceneError, match="no-such-python: cannot be run"):
            tracer.picture(CAMERA, STILL, state)
        _save(tmp_path / picture_key(scene.digest, tracer.request(CAMERA, STILL, state, 0)), saved)
        assert tracer.is_cached(CAMERA, STILL, state)
        assert tracer.picture(CAMERA, STILL, state).rgb == pytest.approx(saved.rgb)
    with CyclesTracer(scene, "no-such-python", 8, cache=tmp_path, repeat=True) as tracer:
        assert not tracer.is_cached(CAMERA, STILL, state)
    with CyclesTracer(scene, "no-such-python", 16, cache=tmp_path) as tracer:
        assert not tracer.is_cached(CAMERA, STILL, state)


@pytest.mark.parametrize("data", [b"", b"half a file", b"PK\x03\x04 half an archive"])
def test_a_damaged_picture_is_named(data: bytes, tmp_path: Path) -> None:
    scene = traced_scene(_scene(_box()))
    with CyclesTracer(scene, "no-such-python", 8, cache=tmp_path) as tracer:
        path = tmp_path / picture_key(scene.digest, tracer.request(CAMERA, STILL, SceneState.still(), 0))
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
        with pytest.raises(SceneError, match="is no traced picture"):
            tracer.picture(CAMERA, STILL, SceneState.still())


def test_a_state_of_another_scene_is_refused(tmp_path: Path) -> None:
    tracer = CyclesTracer(traced_scene(_scene(_box())), "no-such-python", 8, cache=tmp_path)
    with pytest.raises(ConfigError, match="the state has other links"):
        tracer.picture(CAMERA, STILL, SceneState.still(links=("other/link",)))


# Development


@pytest.mark.parametrize("generated", [True, False])
def test_fitted_exposure_is_the_one_that_the_pictures_have(generated: bool) -> None:
    rng = np.random.default_rng(1)
    traced = rng.uniform(0.02, 0.7, (4000, 3)).astype(np.float32)
    curve, factors = curve_of(generated=generated), np.array([1.3, 1.1, 0.8])
    ours = curve((traced * factors).astype(np.float32))
    assert fit_exposure(traced, ours, curve) == pytest.approx(factors, rel=0.01)


def test_tone_curve_is_that_of_the_bake_for_generated_scenes_only() -> None:
    assert curve_of(generated=True) is tone_map
    assert curve_of(generated=False) is srgb8_from_linear


def test_where_the_scene_ends_a_picture_shows_the_outside() -> None:
    outside = np.full((1, 2, 3), 200.0)
    covered = developed(_picture(np.full((1, 2, 3), 0.5)), np.ones(3), srgb8_from_linear, outside)
    assert (covered == 188).all()  # 0.5 linear in sRGB
    half = developed(_picture(np.full((1, 2, 3), 0.25), alpha=0.5), np.ones(3), srgb8_from_linear, outside)
    assert (half == 194).all()
    assert (developed(_picture(np.zeros((1, 2, 3)), alpha=0.0), np.ones(3), srgb8_from_linear, outside) == 200).all()


def test_noise_is_that_of_the_mean_of_both_halves() -> None:
    picture = replace(_picture(np.full((1, 1, 3), 0.5)), spread=np.full((1, 1, 3), 0.01, dtype=np.float32))
    high, low = (float(srgb8_from_linear(value)) for value in (0.51, 0.49))
    assert noise_of(picture, np.ones(3), srgb8_from_linear, np.zeros((1, 1, 3))) == pytest.approx((high - low) ** 2 / 4)


def test_exposure_is_fitted_to_the_used_pixels() -> None:
    picture = _picture([[[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]]])
    image = np.array([[[10, 10, 10], [20, 20, 20]]], dtype=np.uint8)
    traced, ours = exposure_samples([(picture, image)], [np.array([[False, True]])])
    assert (traced.tolist(), ours.tolist()) == ([[2.0, 2.0, 2.0]], [[20, 20, 20]])


def test_outside_is_the_backdrop_in_the_direction_of_each_pixel(tmp_path: Path) -> None:
    panorama = np.zeros((64, 128, 3), dtype=np.uint8)
    panorama[:, :64, 2] = 255  # red towards +y
    path = tmp_path / "backdrop.png"
    cv2.imwrite(str(path), panorama)
    outside = Outside.of(LightSpec(backdrop=str(path)))
    T_forward = np.eye(4)
    T_forward[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]  # looks along +x, +y is to the left
    seen = outside.seen(CAMERA, T_forward)
    assert seen[12, 2] == pytest.approx([255.0, 0.0, 0.0], abs=1.0)
    assert seen[12, 29] == pytest.approx([0.0, 0.0, 0.0], abs=1.0)
    assert Outside.of(LightSpec(background=(1.0, 0.5, 0.0))).seen(CAMERA, STILL)[0, 0] == pytest.approx([255.0, 127.5, 0.0])


# Blender


def test_blender_traces_a_lit_box_where_our_camera_sees_it(tmp_path: Path) -> None:
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("SKIPPED: no Blender in this Python: pip install bpy")
    scene = _scene(_box("wall", size=1.0, z=2.0), _box("mover", link="thing/link", size=0.2, z=0.0))
    state = SceneState(
        0, 0, 1, ("thing/link",), np.array([[0.25, 0.25, 1.2]]), np.array([[0.0, 0.0, 0.0, 1.0]]), np.zeros((1, 6))
    )
    with CyclesTracer(traced_scene(scene), sys.executable, 16, cache=tmp_path) as tracer:
        picture = tracer.picture(replace(CAMERA, width=64, height=48), np.eye(4), state)
    fx = 24 / math.tan(math.radians(30.0))
    column, row = 31.5 + fx * 0.25 / 1.1, 23.5 + fx * 0.25 / 1.1
    rows, columns = np.nonzero(picture.moving)
    # Its near face is at 1.1 m; its sides, which face the axis, are seen as well.
    assert (columns.max(), rows.max()) == pytest.approx((31.5 + fx * 0.35 / 1.1, 23.5 + fx * 0.35 / 1.1), abs=1.0)
    assert picture.moving[round(row), round(column)]
    assert picture.depth[round(row), round(column)] == pytest.approx(1.1, abs=0.01)
    assert picture.depth[20, 20] == pytest.approx(1.5, abs=0.01)
    assert picture.alpha[20, 20] == pytest.approx(1.0)
    assert picture.alpha[0, 0] == 0.0
    assert math.isinf(picture.depth[0, 0])
    # White at 1 m would be 1; this wall is at 0.5 m, of blue albedo 1.
    assert picture.rgb[23, 28, 2] == pytest.approx(4.0, rel=0.25)
    assert (picture.rgb[23, 28, :2] < picture.rgb[23, 28, 2]).all()


def test_shipped_scenes_name_the_plans_that_are_in_the_package() -> None:
    line = (find_scene("corner_shop") / "scene.yaml").read_text().splitlines()[0]
    assert line == "# Made by: gibson-sim scene generate --kind shop --seed 8 --name corner_shop --quality normal"
