"""Rules of randomisation, the values that they draw, and the effect of appearances on materials."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.shapes import Appearance, Pattern, Shape, VisualSpec
from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.formats.mesh import Material
from gibson_sim.render.batching.material_table import apply_appearance, pattern_pictures, tint_matrix
from gibson_sim.scenes.randomise import ClassRules, LightRules, Rules, TextureRules, color_of_temperature, load_rules, randomise
from gibson_sim.scenes.spec import DrawnScene, LightSpec, PointLight

EVERYTHING = Rules(
    {
        "*": ClassRules((-0.1, 0.1), (0.5, 1.5), (0.8, 1.2), (0.0, 1.0), (0.3, 0.9), TextureRules(0.5)),
        "wall": ClassRules(value=(0.5, 0.6), by="class"),
        "glass": ClassRules(),
    },
    LightRules((0.0, 1.0), (0.5, 1.0), (0.1, 0.2), (0.3, 0.4), (3000.0, 9000.0), (0.5, 2.0), (0.0, 6.0), (0.5, 1.5)),
)


def _visual(name: str, semantic_class: str = "") -> VisualSpec:
    return VisualSpec(name, "", Shape("box"), semantic_class=semantic_class)


def _scene(*visuals: VisualSpec) -> DrawnScene:
    light = LightSpec(points=(PointLight((0.0, 0.0, 2.0)), PointLight((1.0, 0.0, 2.0))))
    return DrawnScene("s", 1, "abc", (), visuals, (), light)


def _appearances(scene: DrawnScene, seed: int = 7, rules: Rules = EVERYTHING) -> dict[str, Appearance | None]:
    return {v.name: v.appearance for v in randomise(scene, seed, rules).visuals}


def test_same_seed_gives_the_same_scene_and_another_seed_another() -> None:
    scene = _scene(*(_visual(f"chair_{k}", "chair") for k in range(5)))
    assert randomise(scene, 7, EVERYTHING) == randomise(scene, 7, EVERYTHING)
    assert not set(_appearances(scene, 7).values()) & set(_appearances(scene, 8).values())
    assert randomise(scene, 7, EVERYTHING).light != randomise(scene, 8, EVERYTHING).light


def test_an_object_that_is_added_changes_no_other() -> None:
    few = _appearances(_scene(_visual("a", "chair"), _visual("b", "chair")))
    many = _appearances(_scene(_visual("new", "table"), _visual("b", "chair"), _visual("a", "chair")))
    assert (few["a"], few["b"]) == (many["a"], many["b"])
    assert few["a"] != few["b"]


def test_a_rule_that_is_added_changes_nothing_of_what_others_give() -> None:
    scene = _scene(_visual("a", "chair"))
    (less,) = _appearances(scene, rules=Rules({"chair": ClassRules(hue=(-0.5, 0.5), roughness=(0.0, 1.0))})).values()
    (more,) = _appearances(
        scene,
        rules=Rules({"chair": ClassRules(hue=(-0.5, 0.5), roughness=(0.0, 1.0), metallic=(0.0, 1.0), texture=TextureRules())}),
    ).values()
    assert less is not None and more is not None
    assert (less.hue, less.roughness) == (more.hue, more.roughness)


def test_values_lie_in_their_ranges() -> None:
    for appearance in _appearances(_scene(*(_visual(f"v{k}") for k in range(200)))).values():
        assert appearance is not None and appearance.metallic is not None and appearance.roughness is not None
        assert -0.1 <= appearance.hue <= 0.1 and 0.5 <= appearance.saturation <= 1.5 and 0.8 <= appearance.value <= 1.2
        assert 0.0 <= appearance.metallic <= 1.0 and 0.3 <= appearance.roughness <= 0.9
        assert appearance.pattern is None or 0.25 <= appearance.pattern.size <= 1.0


def test_about_as_many_textures_are_replaced_as_the_chance_says() -> None:
    appearances = _appearances(_scene(*(_visual(f"v{k}") for k in range(400)))).values()
    # Half of 400, within four standard deviations of 10.
    assert 160 <= sum(appearance is not None and appearance.pattern is not None for appearance in appearances) <= 240


def test_rules_of_a_class_go_before_those_of_all() -> None:
    appearances = _appearances(_scene(_visual("w1", "wall"), _visual("w2", "wall"), _visual("g", "glass")))
    assert appearances["w1"] == appearances["w2"]  # by class
    assert appearances["w1"] is not None and 0.5 <= appearances["w1"].value <= 0.6 and appearances["w1"].roughness is None
    assert appearances["g"] == Appearance()


def test_without_rules_nothing_changes() -> None:
    scene = _scene(_visual("a", "chair"))
    assert replace(randomise(scene, 7, Rules()), content_hash="abc") == scene


def test_appearance_of_the_scene_stays_where_no_rule_applies() -> None:
    scene = _scene(replace(_visual("a", "chair"), appearance=Appearance(metallic=0.7)))
    (appearance,) = _appearances(scene, rules=Rules({"chair": ClassRules(roughness=(0.2, 0.2))})).values()
    assert appearance == Appearance(metallic=0.7, roughness=0.2)


def test_a_randomised_scene_has_another_hash() -> None:
    assert len({randomise(_scene(), seed, EVERYTHING).content_hash for seed in (1, 2)} | {"abc"}) == 3


def test_light_follows_its_rules() -> None:
    light = randomise(_scene(), 3, EVERYTHING).light
    x, y, z = light.sun_direction
    # The sun is at an azimuth of 0 to 1 rad, so its light travels towards -x, and at an elevation of 0.5 to 1 rad.
    assert 0.0 <= math.atan2(-y, -x) <= 1.0
    assert 0.5 <= math.asin(-z) <= 1.0
    assert 0.1 <= light.sun <= 0.2 and 0.3 <= light.ambient <= 0.4
    first, second = light.points
    assert 0.5 <= first.strength <= 2.0 and first.strength != second.strength and first.color != second.color
    assert first.position == (0.0, 0.0, 2.0)


def test_sun_keeps_its_azimuth_where_only_the_elevation_has_a_rule() -> None:
    scene = replace(_scene(), light=LightSpec(sun_direction=(1.0, 1.0, -1.0)))
    light = randomise(scene, 3, Rules(light=LightRules(sun_elevation=(0.3, 0.3)))).light
    c, s = math.cos(0.3) * math.sqrt(0.5), math.sin(0.3)
    np.testing.assert_allclose(light.sun_direction, (c, c, -s), atol=1e-12)


def test_warm_light_is_red_and_cold_light_is_blue() -> None:
    warm, cold = color_of_temperature(2500.0), color_of_temperature(12000.0)
    assert warm[0] == pytest.approx(1.0) and warm[2] < 0.5
    assert cold[2] == pytest.approx(1.0) and cold[0] < 0.85
    assert min(color_of_temperature(6500.0)) > 0.95


def test_a_third_of_a_turn_takes_red_to_green() -> None:
    np.testing.assert_allclose(tint_matrix(Appearance(hue=1 / 3)) @ (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), atol=1e-12)


def test_saturation_0_is_grey_of_the_same_luminance() -> None:
    np.testing.assert_allclose(tint_matrix(Appearance(saturation=0.0)) @ (1.0, 0.5, 0.0), [0.2126 + 0.5 * 0.7152] * 3)


def test_a_look_replaces_metal_and_roughness_and_tints_plain_colours() -> None:
    material = apply_appearance(Material(base_color=(1.0, 0.0, 0.0, 0.5)), Appearance(hue=2 / 3, metallic=0.2, roughness=0.3))
    assert (material.metallic, material.roughness) == (0.2, 0.3)
    assert material.base_color == pytest.approx((0.0, 0.0, 1.0, 0.5), abs=1e-6)


def test_patterns_that_differ_in_colours_alone_share_a_picture() -> None:
    kinds = [
        Pattern("noise", 1),
        Pattern("noise", 1, ((0, 0, 0), (1, 0, 0))),
        Pattern("noise", 2),
        Pattern("checker", 5),
        Pattern("checker"),
    ]
    layers, pictures = pattern_pictures(kinds, pytest.fail)
    assert [layers[k] for k in kinds] == [0, 0, 1, 2, 2]
    assert pictures.shape == (3, 256, 256, 3)


def test_clouds_repeat_without_a_seam() -> None:
    _, (picture,) = pattern_pictures([Pattern("noise", 4)], pytest.fail)
    values = picture[:, :, 0].astype(int)
    assert np.abs(values[0] - values[-1]).max() <= np.abs(np.diff(values, axis=0)).max()
    assert np.abs(values[:, 0] - values[:, -1]).max() <= np.abs(np.diff(values, axis=1)).max()
    assert np.ptp(values) > 150


def test_an_impossible_pattern_is_refused() -> None:
    with pytest.raises(ConfigError, match="must be one of noise, stripes, checker, image"):
        Pattern("dots")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="must be a finite number above 0"):
        Pattern(size=0.0)
    with pytest.raises(ConfigError, match="kind image needs a file"):
        Pattern("image")


# Files


def _write(folder: Path, text: str) -> Path:
    (folder / "rules.yaml").write_text(text)
    return folder / "rules.yaml"


def test_the_example_can_be_read(root: Path) -> None:
    rules = load_rules(root / "config" / "randomisation" / "example.yaml")
    assert rules.classes["wall"].by == "class"
    assert rules.classes["*"].hue == (-0.06, 0.06)
    assert rules.light.sun_azimuth == pytest.approx((0.0, 2.0 * math.pi))


def test_a_single_number_is_both_ends_of_a_range(tmp_path: Path) -> None:
    rules = load_rules(_write(tmp_path, "classes: {chair: {roughness: 0.4}}\nlight: {sun_elevation_deg: 90}\n"))
    assert rules.classes["chair"].roughness == (0.4, 0.4)
    assert rules.light.sun_elevation == pytest.approx((math.pi / 2, math.pi / 2))


def test_images_are_those_of_the_folder_in_alphabetical_order(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    for name in ("b.png", "a.jpg", "notes.txt"):
        (tmp_path / "images" / name).write_bytes(b"")
    rules = load_rules(_write(tmp_path, "classes: {chair: {texture: {images: images}}}\n"))
    texture = rules.classes["chair"].texture
    assert texture is not None
    assert texture.images == tuple(str(tmp_path / "images" / name) for name in ("a.jpg", "b.png"))
    assert texture.patterns == ()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("clases: {}\n", "did you mean 'classes'"),
        ("classes: {chair: {hew: 1}}\n", "did you mean 'hue'"),
        ("classes: {chair: {hue: [0.3, 0.1]}}\n", "the first must not be greater"),
        ("classes: {chair: {hue: red}}\n", "must be a finite number"),
        ("classes: {chair: {roughness: [0, 2]}}\n", "from 0 to 1"),
        ("classes: {chair: {by: room}}\n", "must be visual or class"),
        ("classes: {chair: {texture: {patterns: [dots]}}}\n", "must be of noise, stripes, checker"),
        ("classes: {chair: {texture: {images: none}}}\n", "must be a folder"),
        ("classes: {chair: {texture: {patterns: []}}}\n", "names neither patterns nor images"),
        ("classes: [chair]\n", "must be a mapping"),
        ("light: {temperature_k: 100}\n", "from 1667 to 25000"),
        ("a: [\n", "is not YAML"),
    ],
)
def test_a_mistake_is_named(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(SceneError) as caught:
        load_rules(_write(tmp_path, text))
    assert words in str(caught.value)
    assert "rules.yaml" in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="cannot be read"):
        load_rules(tmp_path / "none.yaml")
